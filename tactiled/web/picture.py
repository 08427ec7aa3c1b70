"""An image as a picture for people: colours, a legend in kPa, axes in mm."""

from io import BytesIO

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from tactiled.frames import Image
from tactiled.sensor import Sensor
from tactiled.web import answers
from tactiled.web.forms import Shown

COLORS = "magma"  # even in lightness, and told apart by the colour-blind
UNKNOWN = "#8a8a8a"
GROUND = "#dfe3e6"  # between the taxels of a layout that is no grid


def colors() -> list[list[int]]:
    """The 256 colours (red, green, blue) from no pressure to the most."""
    table: list[list[int]] = np.round(mpl.colormaps[COLORS](np.arange(256))[:, :3] * 255).astype(int).tolist()
    return table


def png(sensor: Sensor, image: Image, kind: Shown, top: float | None) -> bytes:
    """Draw one image, from 0 to `top` kPa (default: its own peak)."""
    values = answers.values(sensor, image, kind)
    peak = top or max(float(np.nanmax(values, initial=0.0)), 1e-6)
    pitch = sensor.array.pitch
    low, high = sensor.array.positions.min(axis=0) - pitch / 2, sensor.array.positions.max(axis=0) + pitch / 2
    tall = float((high - low)[1] / (high - low)[0])
    wide = tall < 0.6  # the legend goes below
    figure = Figure(figsize=(6.0, min(max(5.0 * tall, 0.8), 8.0) + (1.6 if wide else 0.5)), dpi=110)
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(facecolor=UNKNOWN)
    cmap = mpl.colormaps[COLORS].with_extremes(bad=UNKNOWN)
    shown: ScalarMappable
    if values.ndim == 2:
        extent = (low[0], high[0], high[1], low[1])
        shown = axes.imshow(values, cmap, vmin=0, vmax=peak, extent=extent, interpolation="nearest")
    else:
        side = np.full(values.size, 0.9 * pitch)
        discs = EllipseCollection(
            side, side, np.zeros(values.size), units="x", offsets=sensor.array.positions, cmap=cmap,
            offset_transform=axes.transData,
        )  # fmt: skip
        discs.set_array(np.ma.masked_invalid(values))
        discs.set_clim(0, peak)
        axes.add_collection(discs)
        shown = discs
        axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]), aspect="equal", facecolor=GROUND)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title=f"{image.sensor}, {kind}, frame {image.sequence}")
    label = "standard deviation (kPa)" if kind == "deviation" else "pressure (kPa)"
    figure.colorbar(shown, label=label, location="bottom" if wide else "right")
    out = BytesIO()
    figure.savefig(out, format="png")
    return out.getvalue()
