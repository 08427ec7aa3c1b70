"""Where methods fail: what goes wrong swept from harmless to hopeless, and whether anyone would notice."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tactiled.diagnostics.checks import NOISE_RATIO, FrameChecks
from tactiled.diagnostics.warning_codes import WarningCode
from tactiled.restore.methods import METHODS, make
from tactiled.restore.noise import estimate
from tactiled.study.faults import Case, Setting
from tactiled.study.feasible import lawful
from tactiled.study.restore import nrmse, richardson_lucy, wiener
from tactiled.study.signs import SIGNS, Signs, signs
from tactiled.study.skin import Frames, Skin, rubber
from tactiled.study.sweeps import Sweep, sweeps
from tactiled.study.truth import DRAWN

COVER = 1.5  # t/pitch, of the rubber
OURS = tuple(name for name in METHODS if name != "raw")
THEIRS = ("skimage wiener", "skimage rl")
BALANCE, LUCY = 0.3, 30  # scikit-image's: weight over the noise, iterations
WORSE = 1.02  # times the raw image's error: more is a failure
HONEST = 0.5  # of the true error: a claimed deviation of less is no warning
NOISY: WarningCode = "noise_high"
ALARMS = 0.005  # share of sound images that each sign may call doubtful


@dataclass(frozen=True, slots=True)
class Row:
    """What one method made of one frame."""

    sweep: str
    value: float
    scene: str
    method: str
    ran: str  # the method that auto chose; empty for scikit-image's
    nrmse: float
    over_raw: float
    over_wiener: float
    error: float  # kPa, root mean square
    claimed: float  # kPa, root mean square of the standard deviation that we state; NaN where none is stated
    signs: Signs
    flagged: bool  # some taxels carry flags, which the image's warnings name
    warned: tuple[WarningCode, ...] = ()  # what the service would say of such frames
    lawful: bool | None = None  # of an image of auto that fails silently: whether some press explains its frame


Limits = dict[str, float]  # of each sign
Found = Sequence[tuple[Sweep, list[Row]]]


@dataclass(frozen=True, slots=True)
class Failure:
    """Where a method stops being worth it, and what says so."""

    sweep: str
    unit: str
    method: str
    breaks_at: tuple[float, ...]  # first values, going out from the harmless one, that are worse than raw
    worst: float  # largest error over the raw image's, mean of the scenes
    worst_at: float
    scene: str  # that first is worse than raw by itself
    scene_at: float | None  # where it is; None where none ever is
    noticed: str  # "yes", "partly", "no", or "" where nothing failed
    by: str


def measure(setting: Setting, values: slice) -> Iterator[tuple[Sweep, list[Row]]]:
    """Run every sweep, at all its values or those of a slice and the harmless one."""
    for sweep in sweeps(setting):
        chosen = [v for v in sweep.values if v in sweep.values[values] or v == sweep.harmless]
        yield (
            sweep,
            [row for value in chosen for case in sweep.make(value, setting) for row in rows(sweep, value, case)],
        )


def rows(sweep: Sweep, value: float, case: Case) -> list[Row]:
    """Restore one frame by every method."""
    told: dict[str, tuple[str, Frames, float]] = {}
    for name in ("raw", *OURS):
        restorer = make(name, case.skin.blur, case.noise)
        for earlier in () if case.before is None else case.before:
            restorer(earlier, case.flags)
        done = restorer(case.frame, case.flags)
        told[name] = (done.method, done.image.copy(), _rms(restorer.deviation()))
    told |= {name: ("", image, np.nan) for name, image in _theirs(case).items()}
    errors = {name: nrmse(image, case.truth) for name, (_, image, _) in told.items()}
    flagged = case.flags is not None and bool(case.flags.any())
    found = [
        Row(
            sweep=sweep.name,
            value=value,
            scene=case.scene,
            method=name,
            ran=ran,
            nrmse=errors[name],
            over_raw=errors[name] / errors["raw"],
            over_wiener=errors[name] / errors["wiener"],
            error=_rms(image - case.truth),
            claimed=claimed,
            signs=signs(case.skin.blur, case.frame, image, case.noise, case.flags),
            flagged=flagged,
            warned=_warned(case, image, ran),
        )
        for name, (ran, image, claimed) in told.items()
    ]
    return [
        replace(row, lawful=lawful(case.skin.blur, case.frame, case.noise)) if fails_silently(row) else row
        for row in found
    ]


def _warned(case: Case, image: Frames, ran: str) -> tuple[WarningCode, ...]:
    flags = np.zeros(case.frame.shape, np.uint8) if case.flags is None else case.flags
    checks = FrameChecks(case.skin.blur, case.floor)
    said = checks.check(case.frame, flags, np.asarray(image, np.float32), case.noise, ran)
    loud = case.still is not None and estimate(case.still) > NOISE_RATIO * case.noise
    return (*said, NOISY) if loud else said


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=float))))


def _theirs(case: Case) -> dict[str, Frames]:
    """scikit-image's two, at settings that need no truth; they know nothing of flags."""
    if case.skin.psf is None:
        return {}
    psf = case.skin.psf.astype(np.float32)
    peak = max(float(case.frame.max()), case.noise)
    balance = BALANCE * case.noise / peak
    lucy = richardson_lucy(np.maximum(case.frame, 0), psf, LUCY, clip=False, filter_epsilon=1e-6 * peak)
    return {"skimage wiener": wiener(case.frame, psf, balance, clip=False), "skimage rl": lucy}


def curve(found: list[Row], method: str, over: str = "raw") -> dict[float, float]:
    """Mean error of the scenes over that of `over`, by what was swept."""
    means = _means(found, method), _means(found, over)
    return {value: means[0][value] / means[1][value] for value in means[0]}


def _means(found: list[Row], method: str) -> dict[float, float]:
    values = dict.fromkeys(row.value for row in found)
    return {
        value: float(np.mean([row.nrmse for row in found if (row.value, row.method) == (value, method)]))
        for value in values
    }


def breaks(ratios: dict[float, float], harmless: float, limit: float = WORSE) -> tuple[float, ...]:
    """The first value over the limit on either side of the harmless one, itself if it is over."""
    if ratios.get(harmless, 0.0) > limit:
        return (harmless,)
    sides = (sorted((v for v in ratios if v < harmless), reverse=True), sorted(v for v in ratios if v > harmless))
    firsts = (next((value for value in side if ratios[value] > limit), None) for side in sides)
    return tuple(value for value in firsts if value is not None)


def failure(sweep: Sweep, found: list[Row], method: str, limits: Limits | None = None) -> Failure:
    """Judge one method on one sweep; a sign over its limit would show a fault."""
    ratios = curve(found, method)
    worst_at = max(ratios, key=lambda value: ratios[value])
    scenes = {row.scene for row in found}
    alone = {
        scene: breaks(
            {r.value: r.over_raw for r in found if (r.scene, r.method) == (scene, method)}, sweep.harmless
        )
        for scene in sorted(scenes)
    }
    firsts = [
        (abs(_place(sweep, value) - _place(sweep, sweep.harmless)), scene, value)
        for scene, values in alone.items()
        for value in values
    ]
    _, scene, scene_at = min(firsts, default=(0.0, "", None))
    failed = [row for row in found if row.method == method and row.over_raw > WORSE]
    noticed, by = _noticed(failed, limits or {})
    return Failure(
        sweep=sweep.name,
        unit=sweep.unit,
        method=method,
        breaks_at=breaks(ratios, sweep.harmless),
        worst=ratios[worst_at],
        worst_at=worst_at,
        scene=scene,
        scene_at=scene_at,
        noticed=noticed,
        by=by,
    )


def _place(sweep: Sweep, value: float) -> float:
    return float(np.log(value)) if sweep.logarithmic else value


def noticed(row: Row) -> bool:
    """Whether the image itself says that it may be wrong: by a warning, or by the deviation it claims."""
    return row.flagged or bool(row.warned) or row.claimed >= HONEST * row.error


def fails_silently(row: Row) -> bool:
    """Whether an image of `auto` is worse than raw, and nothing tells of it."""
    return row.method == "auto" and row.over_raw > WORSE and not noticed(row)


def _noticed(failed: list[Row], limits: Limits) -> tuple[str, str]:
    if not failed:
        return "", ""
    seen = [row for row in failed if noticed(row)]
    names = {
        "flags": any(row.flagged for row in seen),
        "warning": any(row.warned for row in seen),
        "claimed deviation": any(not row.flagged and not row.warned for row in seen),
    }
    by = [name for name, there in names.items() if there]
    silent_ = [row for row in failed if not noticed(row)]
    if found := sum(bool(shown(row, limits)) for row in silent_):
        by.append(f"signs would show {found} of {len(silent_)} silent")
    word = "yes" if len(seen) == len(failed) else "partly" if seen else "no"
    count = "" if word == "yes" else f" ({len(seen)} of {len(failed)})"
    return word + count, "; ".join(by)


def sound(found: Found, method: str) -> list[Row]:
    """Rows of a method where restoration is told the truth about the array: what must raise no alarm."""
    told = ("cover", "white noise")
    return [row for sweep, all_ in found if sweep.name in told for row in all_ if row.method == method]


def false_warnings(found: Found, method: str) -> list[WarningCode]:
    """What the service would say of sound images that are no worse than raw."""
    return sorted(said for row in sound(found, method) if row.over_raw <= WORSE for said in row.warned)


def limits(found: Found, method: str) -> Limits:
    """What each sign stays under on sound images, but for the share of `ALARMS`."""
    return _limits(sound(found, method))


def _limits(rows_: list[Row]) -> Limits:
    told = [asdict(row.signs) for row in rows_]
    values = {name: np.array([each[name] for each in told]) for name in SIGNS}
    return {
        name: float(np.nanquantile(value, 1 - ALARMS, method="higher"))
        for name, value in values.items()
        if np.isfinite(value).any()
    }


def alarms(found: Found, method: str) -> list[str]:
    """Signs that sound images of each scene give, by limits taken from the other scenes."""
    fine = sound(found, method)
    given = []
    for scene in {row.scene for row in fine}:
        known = _limits([row for row in fine if row.scene != scene])
        given += [sign for row in fine if row.scene == scene for sign in shown(row, known)]
    return sorted(given)


def shown(row: Row, limits: Limits) -> list[str]:
    """The signs over their limits."""
    return [name for name, value in asdict(row.signs).items() if value > limits.get(name, np.inf)]


def table(found: Found) -> list[Failure]:
    """Every method on every sweep, sweep by sweep."""
    present = list(dict.fromkeys(row.method for row in found[0][1] if row.method != "raw"))
    known = {method: limits(found, method) for method in present}
    return [failure(sweep, rows_, method, known[method]) for sweep, rows_ in found for method in present]


def silent(found: Found, method: str = "auto") -> list[Row]:
    """Images of a method that are over twice as wrong as claimed, and that no warning comes with."""
    return [row for _, all_ in found for row in all_ if row.method == method and not noticed(row)]


def setting(quick: bool, seed: int, skin: Skin | None = None) -> tuple[Setting, slice]:
    """What to run, on rubber if no skin is given, and which of each sweep's values."""
    if quick:
        return Setting(skin or rubber(COVER, 16), seed, ("blobs", "punches", "points")), slice(None, None, 3)
    return Setting(skin or rubber(COVER, 32), seed, tuple(DRAWN)), slice(None)
