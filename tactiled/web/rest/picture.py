"""The picture of a sensor's image: what it holds."""

import numpy as np
from numpy.typing import NDArray

from tactiled.frames import Image
from tactiled.web import answers
from tactiled.web.rest.drawing import Picture
from tactiled.web.schemas import PressureKind
from tactiled.web.views import SensorView

MIN_TOP_SIGMAS = 15.0  # the scale reaches at least so far above the noise, as in the viewer
MIN_TOP = 1e-6  # kPa, or counts


def picture(sensor: SensorView, image: Image, kind: PressureKind, top: float | None) -> Picture:
    """An image from 0 to `top`, in its unit (default: its own peak, where that stands out of the noise)."""
    values, status = answers.pressures(sensor, image, kind), sensor.status()
    age = "" if status.state == "live" else f"\n{status.state.upper()}: {status.age_s or 0.0:.1f} s old"
    return Picture(
        title=f"{image.sensor}, {kind}, frame {image.sequence}{age}",
        legend=f"{'standard deviation' if kind == 'deviation' else 'pressure'} ({image.unit})",
        values=values,
        top=top or _peak(image, kind, values),
        positions=sensor.array.positions if kind == "raw" else sensor.cells.positions,
        pitch=sensor.array.pitch if kind == "raw" else sensor.cells.side,
        width=sensor.array.width,
    )


def _peak(image: Image, kind: PressureKind, values: NDArray[np.float32]) -> float:
    """End of the scale, on which noise alone is dark."""
    peak = max(float(np.nanmax(values, initial=0.0)), MIN_TOP)
    if kind == "deviation":
        return peak
    gain = max(1.0, image.noise_gain) if np.isfinite(image.noise_gain) else 1.0
    return max(peak, MIN_TOP_SIGMAS * gain * image.noise)
