"""One sensor's images for Rerun's viewer: all that knows its SDK, which is an extra, with `interop.rerun`.

Maps are in mm: x along a row, y down a column. Both have one colour scale, from 0 to the highest pressure so far.
"""

from collections.abc import Iterable, Mapping
from math import nan

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from tactiled.build import SensorPlan
from tactiled.contacts.detection import OUTLINE_SIGMAS, DetectedContact
from tactiled.contacts.regions import Measures, RegionMeter
from tactiled.frames import SensorImage
from tactiled.geometry import tiling
from tactiled.units import FORCE_UNITS, force_text

CIRCLE = np.exp(1j * np.linspace(0, 2 * np.pi, 33))  # an outline's corners, x + i y
CLASSES = [(0, "data", (0, 0, 0, 0)), (1, "no data", (70, 70, 70, 255))]  # of squares, and their colours (RGBA)
OUTLINE = 255, 255, 255  # colour
MAPS = "raw", "restored"
SCALE_SHARE = 0.05  # of a map's height: room for its scale below it


def new_stream() -> rr.RecordingStream:
    """A stream to be saved or sent, whose errors are exceptions; whoever has it disconnects it."""
    rr.set_strict_mode(True)
    rr.unregister_shutdown()  # which waits at the end of the process for a viewer that hangs
    stream = rr.RecordingStream("tactiled")
    stream.set_log_time_enabled(False)  # images have their frames' times
    return stream


class SensorLog:
    """Logs the images of one sensor, one after the other, below its name."""

    def __init__(self, stream: rr.RecordingStream, plan: SensorPlan) -> None:
        self._stream, self._plan = stream, plan
        self._taxels = tiling(plan.array)
        self._total = RegionMeter(None, plan.cells)
        self._peak = 0.0  # the highest so far
        self._unknown: dict[str, NDArray[np.bool_]] = {}  # of each map's last picture
        self._warnings: dict[str, str] = {}  # texts of the last image's, by code
        self._place("raw", self._taxels.corner, self._taxels.side)
        self._place("restored", plan.cells.corner, plan.cells.side)
        self._log("", rr.AnnotationContext(CLASSES), static=True)
        for name, unit in _series(plan):
            self._log(name, rr.SeriesLines(names=f"{name} in {unit}"), static=True)

    def _place(self, name: str, corner: NDArray[np.float64], side: float) -> None:
        """Put a map where its first square has its centre; both in mm."""
        place = [*(corner - side / 2), 0.0]
        self._log(name, rr.Transform3D(translation=place, scale=[side, side, 1.0]), static=True)

    def _log(self, name: str, content: rr.AsComponents, static: bool = False) -> None:
        self._stream.log(f"/{self._plan.name}/{name}", content, static=static)

    def add(self, image: SensorImage, contacts: Iterable[DetectedContact]) -> None:
        """Log one image and the contacts in it."""
        self._stream.set_time("time", timestamp=image.time)
        self._stream.set_time("frame", sequence=image.sequence)
        total = self._total(image)
        self._add_map("raw", self._taxels.picture(image.raw))
        self._add_map("restored", image.restored)
        self._scale(max(float(np.nanmax(each, initial=0)) for each in (image.restored, image.raw)))
        self._log("contacts", self._outlines(contacts))
        self._log("force", rr.Scalars(total.force))
        self._log("peak", rr.Scalars(total.peak))
        warnings = {each.code: each.text for each in image.warnings}
        for code in [each for each in warnings if each not in self._warnings]:
            self._log("warnings", rr.TextLog(warnings[code], level=rr.TextLogLevel.WARN))
        for code in [each for each in self._warnings if each not in warnings]:
            self._log("warnings", rr.TextLog(f"over: {code}", level=rr.TextLogLevel.INFO))
        self._warnings = warnings

    def add_regions(self, regions: Mapping[str, Measures]) -> None:
        """Log what the regions hold in the image that was added last."""
        for name, measures in regions.items():
            for key, value in measures._asdict().items():
                self._log(f"regions/{rr.escape_entity_path_part(name)}/{key}", rr.Scalars(value))

    def _add_map(self, name: str, picture: NDArray[np.float32]) -> None:
        """Log a picture (R, C) and, where it changes, what of it is unknown."""
        # The viewer takes values for depths in m and shows them twice: NaN m, and as they are.
        self._log(name, rr.DepthImage(picture, meter=nan, colormap="viridis"))
        unknown = np.isnan(picture)
        if name not in self._unknown or not np.array_equal(unknown, self._unknown[name]):
            self._unknown[name] = unknown
            self._log(f"{name}/no_data", rr.SegmentationImage(unknown.astype(np.uint8), opacity=1.0))

    def _scale(self, peak: float) -> None:
        """Have both maps end at the highest pressure so far; write it beside a length."""
        if peak <= self._peak:
            return
        self._peak = peak
        for name in MAPS:
            self._log(name, rr.DepthImage.from_fields(depth_range=[0.0, peak]), static=True)
        (low, high), (_, bottom) = _ranges(self._plan)
        length_mm = 10.0 ** np.floor(np.log10(high - low))
        text = f"{length_mm:g} mm; colours 0 to {peak:.3g} {self._plan.unit}"
        bar, width = [(low, bottom), (low + length_mm, bottom)], rr.Radius.ui_points(1.5)
        self._log("scale", rr.LineStrips2D([bar], labels=text, colors=OUTLINE, radii=width), static=True)

    def _outlines(self, contacts: Iterable[DetectedContact]) -> rr.LineStrips2D:
        """An ellipse for each contact, with its force."""
        strips, labels = [], []
        for each in contacts:
            ellipse = OUTLINE_SIGMAS * (each.major_mm * CIRCLE.real + 1j * each.minor_mm * CIRCLE.imag)
            points = each.x_mm + 1j * each.y_mm + ellipse * np.exp(1j * each.angle_rad)
            strips.append(np.column_stack([points.real, points.imag]))
            labels.append(force_text(each.force, self._plan.unit))
        return rr.LineStrips2D(strips, labels=labels, colors=OUTLINE)


def _series(plan: SensorPlan) -> tuple[tuple[str, str], ...]:
    """Names and units of what is drawn over time."""
    return ("force", FORCE_UNITS[plan.unit]), ("peak", plan.unit)


def _ranges(plan: SensorPlan) -> NDArray[np.float64]:
    """(2, 2) mm, what of x and of y is in view: the surface, and the line of the scale below it."""
    maps = [(cells.pieces, cells.side) for cells in (tiling(plan.array),)]
    maps += [(plan.cells.positions, plan.cells.side)]
    low = np.min([places.min(axis=0) - side / 2 for places, side in maps], axis=0)
    high = np.max([places.max(axis=0) + side / 2 for places, side in maps], axis=0)
    ranges = np.stack([low, high], axis=1)
    ranges[1, 1] += SCALE_SHARE * np.ptp(ranges[1])
    return ranges


def blueprint(plans: Iterable[SensorPlan]) -> rrb.Blueprint:
    """A tab for each sensor: both maps side by side, force and peak over time, and warnings."""
    time_panel = rrb.TimePanel(state="collapsed", timeline="time")
    return rrb.Blueprint(rrb.Tabs(*(_tab(plan) for plan in plans)), time_panel, collapse_panels=True)


def _tab(plan: SensorPlan) -> rrb.Vertical:
    root, (x, y) = f"/{plan.name}", _ranges(plan)
    maps, bounds = [], rrb.VisualBounds2D(x_range=x, y_range=y)
    for name in MAPS:
        contents = [f"{root}/{each}" for each in (f"{name}/**", "contacts", "scale")]
        title = f"{name}, {plan.unit}"
        maps.append(rrb.Spatial2DView(origin=root, contents=contents, name=title, visual_bounds=bounds))
    series = [rrb.TimeSeriesView(origin=f"{root}/{name}", name=f"{name}, {unit}") for name, unit in _series(plan)]
    log = rrb.TextLogView(origin=f"{root}/warnings", name="warnings")
    rows = rrb.Horizontal(*maps), rrb.Horizontal(*series), log
    return rrb.Vertical(*rows, row_shares=[6, 3, 2], name=plan.name)
