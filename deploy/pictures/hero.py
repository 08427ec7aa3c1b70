"""Draw hero.png: two rings and the word TOUCH in Braille under a cover, as pressed, as sensed and as restored."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactiled.bench.skin import Skin, rubber
from tactiled.charts.style import figure
from tactiled.restore.methods import make
from tactiled.simulate.scenes import touch

Floats = NDArray[np.float64]
THICKNESS = 2.0  # pitches; the pitch is 1 mm
NOISE = 0.01  # of the highest reading
PEAK = 100.0  # kPa


def images(skin: Skin) -> dict[str, Floats]:
    """The pressure, the raw and the restored image; restoration knows the noise and nothing of the scene."""
    pressure = touch(skin.surface.x, skin.surface.y, np.pi / 2, skin.surface.size, skin.surface.grain)
    clean = skin.surface.sense(pressure).reshape(skin.array.frame_shape)
    sigma = NOISE * float(clean.max())
    raw = (clean + np.random.default_rng(1).normal(0, sigma, clean.shape)).astype(np.float32)
    restored = make("auto", skin.blur, sigma)(raw).image
    return {"Pressure on the cover": pressure, "Raw image": raw, "Restored image": restored}


with figure(Path(__file__).with_suffix(".png"), 10, 3.5) as drawn:
    axes = drawn.subplots(1, 3)
    for axis, (title, image) in zip(axes, images(rubber(THICKNESS, 32)).items(), strict=True):
        shown = axis.imshow(image, "magma", vmin=0, vmax=PEAK, extent=(0, 32, 32, 0), interpolation="nearest")
        axis.set_title(title)
        axis.set(xticks=(), yticks=())
        axis.grid(visible=False)
    drawn.colorbar(shown, ax=axes, label="kPa", aspect=30)
