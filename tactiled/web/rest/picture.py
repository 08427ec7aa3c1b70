"""An image as a picture for people: colours, a legend in kPa, axes in mm."""

from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import Image
from tactiled.runtime.sensor import Sensor
from tactiled.web import answers
from tactiled.web.schemas import Shown

if TYPE_CHECKING:  # a service starts without matplotlib: the first picture imports it
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

COLORS = "magma"  # even in lightness, and told apart by the colour-blind
UNKNOWN = "#8a8a8a"
OF_NOISE = 15.0  # standard deviations of noise that the scale reaches at least, as in the viewer
LEAST_KPA = 1e-6
Extent = tuple[float, float, float, float]  # left, right, bottom and top, mm
GROUND = "#dfe3e6"  # between the taxels of a layout that is no grid


def colors() -> list[list[int]]:
    """The 256 colours (red, green, blue) from no pressure to the most."""
    from matplotlib import colormaps

    table: list[list[int]] = np.round(colormaps[COLORS](np.arange(256))[:, :3] * 255).astype(int).tolist()
    return table


def _peak(image: Image, kind: Shown, values: NDArray[np.float32]) -> float:
    """End of the scale, kPa, on which noise alone is dark."""
    peak = float(np.nanmax(values, initial=0.0))
    if kind == "deviation":
        return max(peak, LEAST_KPA)
    gain = max(1.0, image.noise_gain) if np.isfinite(image.noise_gain) else 1.0
    return max(peak, OF_NOISE * gain * image.noise_kpa, LEAST_KPA)


def _title(sensor: Sensor, image: Image, kind: Shown) -> str:
    """What is seen, and that it is not the present where it is not."""
    status = sensor.status()
    age = "" if status.state == "live" else f"\n{status.state.upper()}: {status.age_s or 0.0:.1f} s old"
    return f"{image.sensor}, {kind}, frame {image.sequence}{age}"


def png(sensor: Sensor, image: Image, kind: Shown, top: float | None) -> bytes:
    """Draw one image, from 0 to `top` kPa (default: its own peak, where that stands out of the noise)."""
    out = BytesIO()
    draw(sensor, image, kind, top).savefig(out, format="png")
    return out.getvalue()


def draw(sensor: Sensor, image: Image, kind: Shown, top: float | None) -> "Figure":
    """Lay the picture out; the map comes first among its axes, the legend second."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    values = answers.values(sensor, image, kind)
    pitch = sensor.array.pitch
    low, high = sensor.array.positions.min(axis=0) - pitch / 2, sensor.array.positions.max(axis=0) + pitch / 2
    tall = float((high - low)[1] / (high - low)[0])
    wide = tall < 0.6  # the legend goes below
    figure = Figure(figsize=(6.0, min(max(5.0 * tall, 0.8), 8.0) + (1.6 if wide else 0.5)), dpi=110)
    figure.set_layout_engine("compressed")  # a legend as long as the map
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(facecolor=UNKNOWN)
    shown = _map(axes, sensor, values, (low[0], high[0], high[1], low[1]))
    shown.set_clim(0, top or _peak(image, kind, values))
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title=_title(sensor, image, kind))
    label = "standard deviation (kPa)" if kind == "deviation" else "pressure (kPa)"
    figure.colorbar(shown, label=label, location="bottom" if wide else "right")
    return figure


def _map(axes: "Axes", sensor: Sensor, values: NDArray[np.float32], extent: Extent) -> "ScalarMappable":
    """Cells of a grid, or the apertures of a layout that is none; kPa."""
    from matplotlib import colormaps
    from matplotlib.collections import EllipseCollection

    cmap = colormaps[COLORS].with_extremes(bad=UNKNOWN)
    if values.ndim == 2:
        return axes.imshow(values, cmap, extent=extent, interpolation="nearest")
    side = np.full(values.size, sensor.array.width)
    discs = EllipseCollection(
        side, side, np.zeros(values.size), units="x", offsets=sensor.array.positions, cmap=cmap,
        offset_transform=axes.transData,
    )  # fmt: skip
    discs.set_array(np.ma.masked_invalid(values))
    axes.add_collection(discs)
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", facecolor=GROUND)
    return discs
