"""Settings that can be read and cannot be true, each with the slip that would explain it; pure.

A bound here lies between what skins are made of and what a slip of units makes of that: `tests/plausibility` has
a table of real skins and one of slips.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from tactiled.bounds import slips
from tactiled.build import make_array, make_calibration, make_codec
from tactiled.bus.codec import Codec, whole_counts
from tactiled.bus.codecs.dbc import Dbc
from tactiled.calibrate.counts.calibration import Calibration, Calibrator
from tactiled.config import schema
from tactiled.errors import TactileError
from tactiled.geometry import Array, grid
from tactiled.restore.methods import named

T = TypeVar("T")

MIN_RUBBER_MM, MIN_PLASTIC_MM = 0.03, 0.003  # a coat of paint is 0.03 to 0.05 mm; parylene coats are 0.005 mm
PLASTIC_MPA = 100.0  # Young's modulus: Shore A ends at about 50 MPa (Gent 1958), polyethylene begins at 200 MPa
THIN_PITCHES = 0.05  # a cover that is thicker changes the image, so that it is worth configuring
THICK_PITCHES = 30.0  # exp(-pi 30): nothing as fine as two taxels passes; skins have 0.1 to 6
MIN_TAXELS_IN_A_PATCH = 4  # single taxels are often narrower than their cover is thick
MIN_PITCH_MM = 0.04  # fingerprint sensors have 0.05 mm (500 dots an inch)
SAME_PLACE_PITCHES = 0.02  # off its place in a grid that a taxel may be given
MIN_APERTURE_PITCHES = 0.004  # a Hall element of 0.1 mm every 15 mm has 0.007
SOFTEST_MPA = 0.004  # Sylgard 527, the softest gel in common use: 0.005 MPa (Palchesko et al. 2012)
RUBBER = 0.48, 200.0  # Poisson's ratio from which a solid is rubber, and MPa that no rubber has
INCOMPRESSIBLE = 0.45, 5000.0  # gold and lead, the metals nearest to it, have 0.42 and 0.44; plastics are softer
HARDEST_COVER_MPA = 250_000.0  # steel has 210 000 MPa
PLATE_MPA = 10_000.0  # stiffer than the plastics of Shimojo's covers, 98 to 9807 MPa
COMPRESSIBLE_RUBBER = 0.4, 20.0  # less than this ratio, softer than this (MPa): foam, or a ratio typed for rubber
SHELL_RATIO, SHELL_THICKNESS = 1000.0, 0.25  # cover over substrate; leather on an insole's foam: 200 and 0.3
MAX_RANGE_KPA = 70_000.0  # 16 bits of 1 kPa have 65 535; presses use films of 200 000, skins end near 5000
MIN_RANGE_KPA = 1.0  # a gentle touch is up to 10 kPa (Mannsfeld et al. 2010)
MIN_RANGE_FRACTION = 0.1  # of the full scale, from no load in the direction of pressure
MAX_NOISE_FRACTION = 0.2  # of the range
MAX_GAIN_RATIO = 3.0  # between kpa_per_count and what the DBC file says: taxels of one array differ less
MAX_STALE_S = 60.0  # robots react within seconds; slow surveys may want more
MESSAGE_S = 1e-4  # on the bus: 8 bytes at 1 Mbit/s are 111 bits, 64 bytes of CAN FD at 8 Mbit/s as long
KPA = {"Pa": 1e-3, "hPa": 0.1, "mbar": 0.1, "kPa": 1.0, "bar": 100.0, "MPa": 1e3}  # of units in DBC files
EDIT = re.compile(r"#\s*EDIT:")  # how `tactiled sniff` marks what a bus does not tell


@dataclass(frozen=True, slots=True)
class Finding:
    """A setting that is hard to believe, or with `hint` only worth a look."""

    place: str  # dotted key
    value: str  # as configured; "" where it is not one value
    reason: str  # why it cannot be, and the likely slip
    hint: bool = False

    def rests_on(self, places: Iterable[str]) -> bool:
        """Whether it is of one of some dotted keys, of what is in one, or of what one is in; `[0]` may lack."""
        own, *others = (each.replace("[0]", "") for each in (self.place, *places))
        return any(
            one == own or one.startswith((f"{own}.", f"{own}[")) or own.startswith(f"{one}.") for one in others
        )

    def __str__(self) -> str:
        """One line."""
        return f"{self.place}{self.value and ' = '}{self.value}: {self.reason}"


def config_findings(config: schema.Config) -> list[Finding]:
    """What is hard to believe of a configuration; a sensor that `build` refuses is left to it."""
    findings: list[Finding] = []
    if (token := config.server.read_token) is not None and token == config.server.control_token:
        reason = "the same as control_token: whoever may see images may change everything; give two"
        findings.append(Finding("server.read_token", "", reason))
    for name, sensor in config.sensor.items():
        with suppress(TactileError):
            for each in _sensor(f"sensor.{name}", sensor):
                findings.append(each)
    return findings


def refused(config: schema.Config, but: Iterable[str] = ()) -> Iterator[str]:
    """Why sensors of a configuration cannot be made, before any cover is solved; not what rests on keys `but`."""
    for name, sensor in config.sensor.items():
        wrong = {each.split(".")[2] for each in but if each.startswith(f"sensor.{name}.")}
        faults: dict[str, TactileError] = {}
        array = _attempt("array", faults, make_array, sensor)
        if array is not None:
            _attempt("codec", faults, make_codec, sensor)
            calibration = _attempt("calibration", faults, make_calibration, sensor)
            if calibration is not None:
                _attempt("calibration", faults, Calibrator, calibration, array.size)
        _attempt("method", faults, named, sensor.method)
        yield from (f"sensor.{name}: {error}" for table, error in faults.items() if table not in wrong)


def _attempt(table: str, faults: dict[str, TactileError], make: Callable[..., T], *of: Any) -> T | None:
    """What is made of settings; None, with the error in `faults` by their table, where that is refused."""
    try:
        return make(*of)
    except TactileError as error:
        faults[table] = error
        return None


def unedited(text: str) -> list[Finding]:
    """The lines of a configuration's text that still have the mark of `tactiled sniff`."""
    reason = "still marked EDIT: set what the bus does not tell, then delete the mark"
    marked = ((n, line.split(" # ")[0]) for n, line in enumerate(text.splitlines(), 1) if EDIT.search(line))
    return [Finding(f"line {n}: {line.strip('# ')}", "", reason) for n, line in marked]


def _sensor(place: str, sensor: schema.Sensor) -> Iterator[Finding]:
    """What needs a codec comes last: the rest does not wait for one that is refused."""
    array = make_array(sensor)
    yield from _array(f"{place}.array", array)
    yield from _listed_grid(f"{place}.array", array)
    yield from _depth(f"{place}.cover", sensor.cover, array)
    for key in ("cover", "substrate"):
        if layers := getattr(sensor, key):
            yield from _thin(f"{place}.{key}", layers, array)
            for n, layer in enumerate(layers):
                where = f"{place}.{key}" + f"[{n}]" * (len(layers) > 1)
                yield from _stiffness(where, layer, array if key == "cover" else None)
    yield from _shell(place, sensor)
    codec, calibration = make_codec(sensor), make_calibration(sensor)
    yield from _calibration(f"{place}.calibration", sensor.calibration, calibration, codec)
    yield from _age(f"{place}.stale_after_s", sensor.stale_after_s, codec)
    if isinstance(codec, Dbc) and calibration.curves is None:
        yield from _scaling(f"{place}.calibration", codec, sensor.calibration.kpa_per_count)


def _scaling(place: str, codec: Dbc, given: float | None) -> Iterator[Finding]:
    """What a DBC file says of its signals' pressure, where no setting says it, or another gain."""
    scale, offset, unit = codec.scaling or (0.0, 0.0, "")
    if not (unit in KPA and scale):
        return
    gain = scale * KPA[unit]
    values = f"kpa_per_count = {gain:g} and no_load = {0.0 - offset / scale:g}"
    if given is None:
        reason = f"counts without kpa_per_count; {values} by scale, offset and unit of the DBC file"
        yield Finding(place, "", reason, hint=True)
    elif not 1 / MAX_GAIN_RATIO < given / gain < MAX_GAIN_RATIO:
        reason = f"scale, offset and unit of the DBC file say {values}"
        yield Finding(f"{place}.kpa_per_count", f"{given:g}", reason, hint=True)


def _slip(value: float, unit: str, units: Mapping[str, float], low: float, high: float) -> str:
    return "".join(words for _, words in slips(value, unit, units, low, high))


def _array(place: str, array: Array) -> Iterator[Finding]:
    pitch = array.pitch
    if pitch < MIN_PITCH_MM:
        slip = _slip(pitch, "mm", {"metres": 1e3}, 0.5, 1000)
        yield Finding(f"{place}.pitch_mm", f"{pitch:g}", f"finer than a fingerprint sensor's taxels{slip}")
    elif array.width < MIN_APERTURE_PITCHES * pitch:
        slip = _slip(array.width, "mm", {"metres": 1e3}, 0.05 * pitch, pitch)
        yield Finding(f"{place}.aperture_mm", f"{array.width:g}", f"a point, at a pitch of {pitch:g} mm{slip}")


def _listed_grid(place: str, array: Array) -> Iterator[Finding]:
    """A grid, row by row, that is given as positions: it is restored worse (docs/measurements.md)."""
    columns, rows = (len(np.unique(np.round(each / array.pitch))) for each in array.positions.T)
    if array.shape is not None or min(rows, columns) < 2 or rows * columns != array.size:
        return
    offsets = array.positions - array.positions[0]
    if np.abs(offsets - grid(rows, columns, array.pitch).positions).max() < SAME_PLACE_PITCHES * array.pitch:
        reason = f"a grid: rows = {rows}, columns = {columns}, pitch_mm = {array.pitch:g} is restored better"
        yield Finding(f"{place}.positions_mm", "", reason, hint=True)


def _total_mm(layers: schema.Layers) -> float:
    return sum(each.thickness_mm for each in layers)


def _thickness(place: str, layers: schema.Layers) -> tuple[str, str]:
    """Place and value of the thickness of all layers together."""
    if len(layers) == 1:
        return f"{place}.thickness_mm", f"{_total_mm(layers):g}"
    return place, f"{len(layers)} layers of {_total_mm(layers):g} mm"


def _depth(place: str, layers: schema.Layers, array: Array) -> Iterator[Finding]:
    extent = float(np.ptp(array.positions, axis=0).max()) + array.width
    bound = THICK_PITCHES * array.pitch
    if array.size >= MIN_TAXELS_IN_A_PATCH:
        bound = min(bound, extent)
    if _total_mm(layers) > bound and array.pitch >= MIN_PITCH_MM:
        slip = _slip(_total_mm(layers), "mm", {"µm": 1e-3}, 0.01, bound)
        size = f"{extent:g} mm, pitch {array.pitch:g} mm"
        yield Finding(*_thickness(place, layers), f"too thick for any detail to reach this array ({size}){slip}")


def _thin(place: str, layers: schema.Layers, array: Array) -> Iterator[Finding]:
    plastic = min(each.young_mpa for each in layers) >= PLASTIC_MPA
    if _total_mm(layers) < min(MIN_PLASTIC_MM if plastic else MIN_RUBBER_MM, THIN_PITCHES * array.pitch):
        slip = _slip(_total_mm(layers), "mm", {"metres": 1e3}, 0.5, 50)
        yield Finding(*_thickness(place, layers), f"thinner than a coat of paint{slip}")


def _stiffness(place: str, layer: schema.Layer, covered: Array | None) -> Iterator[Finding]:
    """Young's modulus and Poisson's ratio of a layer; `covered` is what a layer of a cover lies on."""
    young, poisson, reason = layer.young_mpa, layer.poisson, ""
    softer = _slip(young, "MPa", {"kPa": 1e-3, "Pa": 1e-6}, 0.005, 50)
    if young < SOFTEST_MPA:
        reason = "softer than any gel" + _slip(young, "MPa", {"GPa": 1e3}, 0.1, 10)
    elif any(poisson >= ratio and young > limit for ratio, limit in (RUBBER, INCOMPRESSIBLE)):
        reason = f"stiffer than any rubber, which Poisson's ratio of {poisson:g} says it is{softer}"
    elif covered and young > HARDEST_COVER_MPA:
        reason = f"harder than steel{softer}"
    elif covered and young > PLATE_MPA and layer.thickness_mm > covered.pitch:
        reason = f"a plate that hides all detail, stiffer than any plastic{softer}"
    if reason:
        yield Finding(f"{place}.young_mpa", f"{young:g}", reason)
    elif poisson < COMPRESSIBLE_RUBBER[0] and young < COMPRESSIBLE_RUBBER[1]:
        reason = f"right for foam; solid rubber as soft as {young:g} MPa has 0.45 to 0.4999"
        yield Finding(f"{place}.poisson", f"{poisson:g}", reason, hint=True)


def _shell(place: str, sensor: schema.Sensor) -> Iterator[Finding]:
    """A cover that is a shell on soft ground."""
    if not sensor.substrate:
        return
    depth = _total_mm(sensor.substrate)
    young = depth / sum(each.thickness_mm / each.young_mpa for each in sensor.substrate)
    hardest = max(sensor.cover, key=lambda layer: layer.young_mpa)
    if hardest.young_mpa > SHELL_RATIO * young and hardest.thickness_mm > SHELL_THICKNESS * depth:
        slip = _slip(young, "MPa", {"GPa": 1e3}, PLASTIC_MPA, HARDEST_COVER_MPA)
        reason = f"softer than the cover ({hardest.young_mpa:g} MPa) by far: are the two exchanged?{slip}"
        yield Finding(f"{place}.substrate.young_mpa", f"{young:g}", reason)


def _calibration(
    place: str, configured: schema.Calibration, calibration: Calibration, codec: Codec
) -> Iterator[Finding]:
    """No load and saturation within the counts of the codec, then what these say of the pressures."""
    at_fault = False
    for key, reason in _limits(calibration, codec):
        at_fault = True
        yield Finding(f"{place}.{key}", f"{getattr(calibration, key):g}", reason)
    if not at_fault:
        yield from _pressures(place, configured, calibration, codec)


def _limits(calibration: Calibration, codec: Codec) -> Iterator[tuple[str, str]]:
    """Key and reason of a limit that the counts of a codec do not have."""
    (lowest, highest), saturation = codec.ends, calibration.saturation
    scale = f"the codec's counts are {lowest:g} to {highest:g}"
    if not lowest <= calibration.no_load <= highest:
        yield "no_load", scale
    elif saturation is None:
        return
    elif (saturation - calibration.no_load) * calibration.kpa_per_count <= 0:
        side = "above" if calibration.kpa_per_count > 0 else "below"
        yield "saturation", f"a taxel at rest is saturated: must be {side} no_load = {calibration.no_load:g}"
    elif not lowest <= saturation <= highest:
        yield "saturation", f"never reached: {scale}"


def _pressures(
    place: str, configured: schema.Calibration, calibration: Calibration, codec: Codec
) -> Iterator[Finding]:
    """Highest pressure and noise; unknown where counts are wider than 16 bits, and no skin uses all of them."""
    gain, no_load = calibration.kpa_per_count, calibration.no_load
    end = calibration.saturation if calibration.saturation is not None else codec.ends[int(gain > 0)]
    if calibration.saturation is None and not (whole_counts(codec) and np.isfinite(end)):
        return
    counts = abs(end - no_load)
    if calibration.saturation is None and counts < MIN_RANGE_FRACTION * codec.full_scale:
        reason = (
            f"leaves {counts:g} counts for pressure: if counts {'fall' if gain > 0 else 'rise'} under pressure"
        )
        sign = "negative" if gain > 0 else "positive"
        yield Finding(f"{place}.no_load", f"{no_load:g}", f"{reason}, kpa_per_count is {sign}")
        return
    highest = float(f"{counts * abs(gain):.3g}")
    if configured.kpa_per_count is not None and not MIN_RANGE_KPA <= highest <= MAX_RANGE_KPA:
        units = {"Pa": 1e-3, "MPa": 1e3}
        slip = _slip(gain, "kPa", units, 10 * MIN_RANGE_KPA / counts, MAX_RANGE_KPA / counts)
        size = "more than any skin measures" if highest > MAX_RANGE_KPA else "less than a touch"
        yield Finding(f"{place}.kpa_per_count", f"{gain:g}", f"{highest:g} kPa at most, {size}{slip}")
    elif (noise := calibration.noise_kpa or 0.0) > MAX_NOISE_FRACTION * highest:
        slip = _slip(noise, "kPa", {"Pa": 1e-3}, 0, MAX_NOISE_FRACTION * highest)
        reason = f"drowns all that the array measures, {highest:g} kPa at most{slip}"
        yield Finding(f"{place}.noise_kpa", f"{noise:g}", reason)


def _age(place: str, stale_after_s: float, codec: Codec) -> Iterator[Finding]:
    polls = codec.polling.polls
    frame_s = max(each.period_s for each in polls) if polls else codec.segments * MESSAGE_S
    if stale_after_s < frame_s:
        what = "frames are polled every" if polls else f"the {codec.segments} messages of a frame take at least"
        yield Finding(place, f"{stale_after_s:g}", f"every image is stale: {what} {frame_s:.2g} s")
    if stale_after_s > MAX_STALE_S:
        slip = _slip(stale_after_s, "s", {"ms": 1e-3}, 0.01, 5)
        reason = f"a skin that fell silent passes for alive all that time{slip}"
        yield Finding(place, f"{stale_after_s:g}", reason, hint=True)
