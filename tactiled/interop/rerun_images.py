"""One sensor's images for Rerun's viewer: all that knows its SDK, which is an extra, with `rerun_live`.

Maps are in mm: x along a row, y down a column. Both have one colour scale, from 0 to the highest pressure so far.
"""

from collections.abc import Iterable
from math import nan

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from tactiled.build import SensorPlan
from tactiled.contacts.detection import Contact
from tactiled.frames import Image
from tactiled.geometry import tiling
from tactiled.units import FORCE_SCALES, FORCE_UNITS, PRESSURE

APPLICATION = "tactiled"
TIMELINE = "time"
DISC_SIGMAS = 2.0  # radius of a contact's outline, in standard deviations of its pressure
CIRCLE = np.linspace(0, 2 * np.pi, 33)  # of an outline's corners
CLASSES = [(0, "data", (0, 0, 0, 0)), (1, "no data", (70, 70, 70, 255))]  # of squares, and their colours (RGBA)
OUTLINE = 255, 255, 255  # colour
SCALE_SHARE = 0.1  # of a map's height: room for its scale below it


def new_stream() -> rr.RecordingStream:
    """A stream to be saved or sent, whose errors are exceptions; whoever has it disconnects it."""
    rr.set_strict_mode(True)
    rr.unregister_shutdown()  # which waits at the end of the process for a viewer that hangs
    stream = rr.RecordingStream(APPLICATION)
    stream.set_log_time_enabled(False)  # images have their frames' times
    return stream


class SensorLog:
    """Logs the images of one sensor, one after the other, below its name."""

    def __init__(self, stream: rr.RecordingStream, plan: SensorPlan) -> None:
        self._stream, self._plan = stream, plan
        self._maps = {"raw": tiling(plan.array), "restored": plan.cells}
        self._areas = FORCE_SCALES[plan.unit] * plan.cells.areas.astype(np.float32)
        self._peak = 0.0  # the highest so far
        self._unknown: dict[str, NDArray[np.bool_]] = {}  # of each map's last picture
        self._warnings: dict[str, str] = {}  # texts of the last image's, by code
        for name, cells in self._maps.items():
            corner, side = cells.corner - cells.side / 2, cells.side
            self._log(name, rr.Transform3D(translation=[*corner, 0.0], scale=[side, side, 1.0]), static=True)
        self._log("", rr.AnnotationContext(CLASSES), static=True)
        for name, unit in (("force", FORCE_UNITS[plan.unit]), ("peak", plan.unit)):
            self._log(name, rr.SeriesLines(names=f"{name} in {unit}"), static=True)

    def _log(self, name: str, *content: rr.AsComponents, static: bool = False) -> None:
        self._stream.log(f"/{self._plan.name}/{name}", *content, static=static)

    def add(self, image: Image, contacts: Iterable[Contact]) -> None:
        """Log one image and the contacts in it."""
        self._stream.set_time(TIMELINE, timestamp=image.time)
        self._stream.set_time("frame", sequence=image.sequence)
        force, peak = float(self._areas @ image.restored.ravel()), float(image.restored.max(initial=0))
        for name, values in (("raw", image.raw), ("restored", image.restored)):
            self._add_map(name, self._maps[name].picture(values))
        self._scale(max(peak, float(np.nanmax(image.raw, initial=0))))
        self._log("contacts", self._outlines(contacts))
        self._log("force", rr.Scalars(force))
        self._log("peak", rr.Scalars(peak))
        self._log_warnings({each.code: each.text for each in image.warnings})

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
        for name in self._maps:
            self._log(name, rr.DepthImage.from_fields(depth_range=[0.0, peak]), static=True)
        low, high = _corners(self._plan)
        length_mm = 10.0 ** np.floor(np.log10(high[0] - low[0]))
        y = high[1] + SCALE_SHARE / 2 * (high[1] - low[1])
        text = f"{length_mm:g} mm; colours 0 to {peak:.3g} {self._plan.unit}"
        bar = [(low[0], y), (low[0] + length_mm, y)]
        self._log(
            "scale",
            rr.LineStrips2D([bar], labels=text, colors=OUTLINE, radii=rr.Radius.ui_points(1.5)),
            static=True,
        )

    def _outlines(self, contacts: Iterable[Contact]) -> rr.LineStrips2D:
        """An ellipse for each contact, with its force."""
        strips, labels = [], []
        for each in contacts:
            along, across = (
                DISC_SIGMAS * each.major_mm * np.cos(CIRCLE),
                DISC_SIGMAS * each.minor_mm * np.sin(CIRCLE),
            )
            cos, sin = np.cos(each.angle_rad), np.sin(each.angle_rad)
            strips.append(
                np.column_stack([each.x_mm + cos * along - sin * across, each.y_mm + sin * along + cos * across])
            )
            labels.append(
                f"{each.force:.{2 if self._plan.unit == PRESSURE else 0}f} {FORCE_UNITS[self._plan.unit]}"
            )
        return rr.LineStrips2D(strips, labels=labels, colors=OUTLINE)

    def _log_warnings(self, warnings: dict[str, str]) -> None:
        """Log warnings that begin and end."""
        for code, text in warnings.items():
            if code not in self._warnings:
                self._log("warnings", rr.TextLog(text, level=rr.TextLogLevel.WARN))
        for code in self._warnings.keys() - warnings.keys():
            self._log("warnings", rr.TextLog(f"over: {code}", level=rr.TextLogLevel.INFO))
        self._warnings = warnings


def blueprint(plans: Iterable[SensorPlan]) -> rrb.Blueprint:
    """A tab for each sensor: both maps side by side, force and peak over time, and warnings."""
    tabs = rrb.Tabs(*(_tab(plan) for plan in plans))
    return rrb.Blueprint(tabs, rrb.TimePanel(state="collapsed", timeline=TIMELINE), collapse_panels=True)


def _corners(plan: SensorPlan) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two corners (2,) of the surface, mm."""
    return plan.cells.corner - plan.cells.side / 2, plan.cells.pieces.max(axis=0) + plan.cells.side / 2


def _tab(plan: SensorPlan) -> rrb.Vertical:
    root, (low, high) = f"/{plan.name}", _corners(plan)
    bottom = high[1] + SCALE_SHARE * (high[1] - low[1])
    bounds = rrb.VisualBounds2D(x_range=[low[0], high[0]], y_range=[low[1], bottom])

    def a_map(name: str) -> rrb.Spatial2DView:
        contents = [f"{root}/{each}" for each in (f"{name}/**", "contacts", "scale")]
        return rrb.Spatial2DView(origin=root, contents=contents, name=f"{name}, {plan.unit}", visual_bounds=bounds)

    series = (
        rrb.TimeSeriesView(origin=f"{root}/{name}", name=f"{name}, {unit}")
        for name, unit in (("force", FORCE_UNITS[plan.unit]), ("peak", plan.unit))
    )
    log = rrb.TextLogView(origin=f"{root}/warnings", name="warnings")
    maps = rrb.Horizontal(a_map("raw"), a_map("restored"))
    return rrb.Vertical(maps, rrb.Horizontal(*series), log, row_shares=[6, 3, 2], name=plan.name)
