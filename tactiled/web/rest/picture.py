"""An image as a picture for people: colours, a legend in their unit, axes in mm."""

from io import BytesIO
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import Image
from tactiled.runtime.sensor_view import SensorView
from tactiled.web import answers
from tactiled.web.schemas import PressureKind

if TYPE_CHECKING:  # a service starts without matplotlib: the first picture imports it
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

ColormapName = Literal["magma", "viridis", "turbo", "gray", "Greys", "RdBu_r"]  # Greys: white is no pressure
COLORS: ColormapName = "magma"  # even in lightness, and readable for the colour-blind
UNKNOWN_COLOR = "#8a8a8a"
BETWEEN_TAXELS_COLOR = "#dfe3e6"  # of a layout that is no grid
MIN_TOP_SIGMAS = 15.0  # the scale reaches at least so far above the noise, as in the viewer
MIN_TOP = 1e-6  # kPa, or counts
WIDE_BELOW = 0.6  # height over width, below which the legend goes under the map


def colors(name: ColormapName) -> list[list[int]]:
    """The 256 colours (red, green, blue) from no pressure to the largest."""
    from matplotlib import colormaps

    table: list[list[int]] = np.round(colormaps[name](np.arange(256))[:, :3] * 255).astype(int).tolist()
    return table


def png(sensor: SensorView, image: Image, kind: PressureKind, top: float | None) -> bytes:
    """Draw one image, from 0 to `top`, in its unit (default: its own peak, where that stands out of the noise)."""
    out = BytesIO()
    draw(sensor, image, kind, top).savefig(out, format="png")
    return out.getvalue()


def draw(sensor: SensorView, image: Image, kind: PressureKind, top: float | None) -> "Figure":
    """Lay the picture out; the map comes first among its axes, the legend second."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    values = answers.pressures(sensor, image, kind)
    positions, pitch = sensor.array.positions, sensor.array.pitch
    (west, north), (east, south) = positions.min(axis=0) - pitch / 2, positions.max(axis=0) + pitch / 2
    aspect = float((south - north) / (east - west))
    wide = aspect < WIDE_BELOW
    figure = Figure(figsize=(6.0, min(max(5.0 * aspect, 0.8), 8.0) + (1.6 if wide else 0.5)), dpi=110)
    figure.set_layout_engine("compressed")  # a legend as long as the map
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(facecolor=UNKNOWN_COLOR)
    colored = _map(axes, sensor, values, (west, east, south, north))
    colored.set_clim(0, top or _peak(image, kind, values))
    status = sensor.status()
    age = "" if status.state == "live" else f"\n{status.state.upper()}: {status.age_s or 0.0:.1f} s old"
    title = f"{image.sensor}, {kind}, frame {image.sequence}{age}"
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title=title)
    label = f"{'standard deviation' if kind == 'deviation' else 'pressure'} ({image.unit})"
    figure.colorbar(colored, label=label, location="bottom" if wide else "right")
    return figure


def _peak(image: Image, kind: PressureKind, values: NDArray[np.float32]) -> float:
    """End of the scale, on which noise alone is dark."""
    peak = max(float(np.nanmax(values, initial=0.0)), MIN_TOP)
    if kind == "deviation":
        return peak
    gain = max(1.0, image.noise_gain) if np.isfinite(image.noise_gain) else 1.0
    return max(peak, MIN_TOP_SIGMAS * gain * image.noise)


def _map(
    axes: "Axes", sensor: SensorView, values: NDArray[np.float32], extent: tuple[float, float, float, float]
) -> "ScalarMappable":
    """Cells of a grid, or the apertures of another layout; extent: left, right, bottom, top, mm."""
    from matplotlib import colormaps
    from matplotlib.collections import EllipseCollection

    cmap = colormaps[COLORS].with_extremes(bad=UNKNOWN_COLOR)
    if values.ndim == 2:
        return axes.imshow(values, cmap, extent=extent, interpolation="nearest")
    side = np.full(values.size, sensor.array.width)
    discs = EllipseCollection(
        side, side, np.zeros(values.size), units="x", offsets=sensor.array.positions, cmap=cmap,
        offset_transform=axes.transData,
    )  # fmt: skip
    discs.set_array(np.ma.masked_invalid(values))
    axes.add_collection(discs)
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", facecolor=BETWEEN_TAXELS_COLOR)
    return discs
