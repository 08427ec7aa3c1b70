"""One recording into one export: every frame restored, with its units and provenance."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tactiled import __version__
from tactiled.archive.arrays import LOSS_KINDS
from tactiled.archive.jobs import Job
from tactiled.archive.writers import writer
from tactiled.build import SensorPlan, make_codec
from tactiled.bus.recording import Recording
from tactiled.bus.replay import frames
from tactiled.bus.router import Router
from tactiled.contacts.regions import Measures, Region, RegionMeter, measure_units
from tactiled.errors import ConfigError
from tactiled.files import sha256
from tactiled.frames import FLAG_BITS, Message
from tactiled.live.contact_search import ImageContacts
from tactiled.live.pipeline import Pipeline
from tactiled.recorded.noise import measure
from tactiled.units import LENGTH, PRESSURE, SHEAR

UNITS = {"time": "seconds since 1970-01-01", "positions_mm": LENGTH, "cells_mm": LENGTH}  # by the CF conventions
DESCRIPTIONS = {
    "time": "time of a frame's first message, on the recording's clock",
    "sequence": "number of the frame, which does not wrap; lost frames are counted",
    "method": "method that restored the frame",
    "noise": "standard deviation of one raw taxel",
    "raw": "pressure that each taxel senses under the cover; NaN: no data",
    "restored": "pressure on the cover, of each cell; NaN: not known",
    "positions_mm": "(x, y) of the taxels, in the order of raw",
    "cells_mm": "(x, y) of the surface cells, in the order of restored",
    "flags": "what is wrong with each taxel's value: a sum of flag_masks",
    "loss": "counts so far, by kind as in loss_kind",
    "regions": "measures of each region, as in measure; NaN: not known",
    "traction": "(x, y) of the tangential load on the cover; NaN where the recording begins under a load",
    "traction_deviation": "its standard deviation",
    "shear": "(x, y) along the skin's own axes from its nominal rest, as sensed: neither restored nor tared",
}


@dataclass(frozen=True, eq=False)
class ExportJob(Job):
    """Restores every frame of a recording into a file of one format."""

    to: str | None = None  # the format; None: by the ending of the file's name
    regions: Mapping[str, Region] = field(default_factory=dict)  # of the sensor in its service, by name
    zone: str | None = None  # of recordings that do not say theirs

    def settings(self) -> dict[str, Any]:
        """Everything that outputs depend on except the input and the version (JSON's types)."""
        return super().settings() | {"regions": self._regions(), "zone": self.zone}

    def _regions(self) -> dict[str, Any]:
        return {name: each.model_dump(mode="json") for name, each in self.regions.items()}

    def make(self, source: Path, part: Path) -> str:
        """Write every frame of one recording; ConfigError where there is none, or a region has no cell."""
        plan, count = self.plan(), 0
        codecs = {name: make_codec(each) for name, each in self.sensors.items()}
        router, pipeline = Router(codecs), Pipeline(plan)
        for found in measure(Recording(source, router.ids, self.zone), codecs, [plan]).values():
            pipeline.settle(*found)
        recording = Recording(source, router.ids, self.zone)
        meters = self._meters(plan)
        with closing(writer(part.name, self.to)(part, plan)) as target:
            target.contacts = ImageContacts(plan.array, plan.cells, pipeline.deviation)
            for name, frame in frames(_tapped(recording, target.add_message), router):
                if name == plan.name:
                    image = pipeline.process(frame)
                    target.add_image(image, {each: meter(image) for each, meter in meters.items()})
                    count += 1
            if not count:
                where = f"recording {source}"
                raise ConfigError(f"{where}: holds no frame of sensor {plan.name} ({recording.summary()})")
            loss = asdict(router.assemblers[plan.name].loss)
            about = _provenance(recording, plan) | {"loss": loss, "config": self.config}
            if meters:
                about |= {"regions": self._regions(), "region_measures": Measures._fields}
                about["units"] |= {"regions": ", ".join(measure_units(plan.unit).values())}
            target.finish(about)
        return f"{count} frames of {plan.name} from {recording.summary()}"

    def _meters(self, plan: SensorPlan) -> dict[str, RegionMeter]:
        try:
            return {name: RegionMeter(each, plan.cells) for name, each in self.regions.items()}
        except ValueError as error:
            raise ConfigError(f"regions of sensor {plan.name}: {error}") from error


def _tapped(recording: Recording, tap: Callable[[Message], None]) -> Iterator[Message]:
    """A recording's messages, each of which `tap` gets first."""
    for message in recording:
        tap(message)
        yield message


def _units(plan: SensorPlan) -> dict[str, str]:
    """Unit of each array; pressure is in counts where the sensor is uncalibrated."""
    pressures = dict.fromkeys(("raw", "restored", "noise"), plan.unit)
    loads: dict[str, str] = {"shear": SHEAR} if plan.shears else {}
    loads |= dict.fromkeys(("traction", "traction_deviation"), PRESSURE) if plan.restores_shear else {}
    calibrated = {"noise_kpa": PRESSURE} if plan.unit == PRESSURE else {}
    return pressures | calibrated | UNITS | loads


def _provenance(recording: Recording, plan: SensorPlan) -> dict[str, Any]:
    """Where the arrays come from, and their units."""
    return {
        "made_by": f"tactiled {__version__}",
        "recording": {
            "file": recording.path.name,
            "sha256": sha256(recording.path),
            "messages": recording.count,
            "end_cut_off": recording.torn,
            "left_out": dict(+recording.remarks.left_out),
            "caveats": recording.remarks.caveats,
        },
        "sensor": {"name": plan.name, "bus": plan.bus, "codec": plan.codec_name, "method": plan.method},
        "calibration": plan.calibration_id,
        "cover": {"model": plan.kernel.model, "gain_error": plan.kernel.error_estimate},
        "cell_mm": plan.cells.side,
        "origin_mm": plan.cells.corner.tolist(),
        "mask": None if plan.cells.felt.all() else plan.cells.felt.tolist(),
        "units": _units(plan),
        "descriptions": DESCRIPTIONS,
        "flag_bits": FLAG_BITS,
        "loss_kinds": LOSS_KINDS,
        "warnings": [asdict(each) for each in plan.warnings],
    }
