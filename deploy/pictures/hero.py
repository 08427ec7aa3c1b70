"""Draw hero.png: two rings and the word TOUCH in Braille under a cover, as pressed, as sensed and as restored."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactiled.restore.methods import make
from tactiled.study.charts import figure
from tactiled.study.skin import Skin, rubber

Floats = NDArray[np.float64]
THICKNESS = 2.0  # pitches; the pitch is 1 mm
NOISE = 0.01  # of the highest reading
PEAK = 100.0  # kPa
LETTERS = {"T": (2, 3, 4, 5), "O": (1, 3, 5), "U": (1, 3, 6), "C": (1, 4), "H": (1, 2, 5)}  # Braille dots
DOT, CELL, DOT_RADIUS = 2.5, 6.1, 0.8  # mm: between dots, between letters


def scene(x: Floats, y: Floats) -> Floats:
    """Pressure in kPa at places in mm from the middle."""
    radius = np.hypot(x, y - 5.5)
    pressed = np.maximum(np.abs(radius - 3) < 0.7, np.abs(radius - 7.5) < 0.7).astype(float)
    for number, letter in enumerate(LETTERS):
        for dot in LETTERS[letter]:
            column, row = divmod(dot - 1, 3)
            at = CELL * (number - 2) + DOT * (column - 0.5), DOT * row - 12
            pressed[np.hypot(x - at[0], y - at[1]) < DOT_RADIUS] = 1
    return PEAK * pressed


def images(skin: Skin) -> dict[str, Floats]:
    """The pressure, the raw and the restored image; restoration knows the noise and nothing of the scene."""
    pressure = scene(skin.surface.x, skin.surface.y)
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
