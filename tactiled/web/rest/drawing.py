"""An image as a picture for people: colours, a legend in their unit, axes in mm; without a service."""

from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # only who draws imports matplotlib
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

ColormapName = Literal["magma", "viridis", "turbo", "gray", "Greys", "RdBu_r"]  # Greys: white is no pressure
COLORS: ColormapName = "magma"  # even in lightness, and readable for the colour-blind
UNKNOWN_COLOR = "#8a8a8a"
BETWEEN_TAXELS_COLOR = "#dfe3e6"  # of a layout that is no grid
WIDE_BELOW = 0.6  # height over width, below which the legend goes under the map


@dataclass(frozen=True, slots=True)
class Picture:
    """What is drawn."""

    title: str
    legend: str
    values: NDArray[np.float32]  # (rows, columns) of a grid, (N,) of another layout; NaN: unknown
    top: float  # end of the scale, which begins at 0
    positions: NDArray[np.float64]  # (N, 2) mm
    pitch: float  # mm
    width: float  # mm, of a taxel


def colors(name: ColormapName) -> list[list[int]]:
    """The 256 colours (red, green, blue) from no pressure to the largest."""
    from matplotlib import colormaps

    table: list[list[int]] = np.round(colormaps[name](np.arange(256))[:, :3] * 255).astype(int).tolist()
    return table


def png(picture: Picture) -> bytes:
    """A picture's PNG file."""
    out = BytesIO()
    draw(picture).savefig(out, format="png")
    return out.getvalue()


def draw(picture: Picture) -> "Figure":
    """Lay a picture out; the map comes first among its axes, the legend second."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    positions, pitch = picture.positions, picture.pitch
    (west, north), (east, south) = positions.min(axis=0) - pitch / 2, positions.max(axis=0) + pitch / 2
    aspect = float((south - north) / (east - west))
    wide = aspect < WIDE_BELOW
    figure = Figure(figsize=(6.0, min(max(5.0 * aspect, 0.8), 8.0) + (1.6 if wide else 0.5)), dpi=110)
    figure.set_layout_engine("compressed")  # a legend as long as the map
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(facecolor=UNKNOWN_COLOR)
    colored = _map(axes, picture, (west, east, south, north))
    colored.set_clim(0, picture.top)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", title=picture.title)
    figure.colorbar(colored, label=picture.legend, location="bottom" if wide else "right")
    return figure


def _map(axes: "Axes", picture: Picture, extent: tuple[float, float, float, float]) -> "ScalarMappable":
    """Cells of a grid, or the apertures of another layout; extent: left, right, bottom, top, mm."""
    from matplotlib import colormaps
    from matplotlib.collections import EllipseCollection

    values, cmap = picture.values, colormaps[COLORS].with_extremes(bad=UNKNOWN_COLOR)
    if values.ndim == 2:
        return axes.imshow(values, cmap, extent=extent, interpolation="nearest")
    side = np.full(values.size, picture.width)
    discs = EllipseCollection(
        side, side, np.zeros(values.size), units="x", offsets=picture.positions, cmap=cmap,
        offset_transform=axes.transData,
    )  # fmt: skip
    discs.set_array(np.ma.masked_invalid(values))
    axes.add_collection(discs)
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", facecolor=BETWEEN_TAXELS_COLOR)
    return discs
