"""What a cover's parameters change, by the exact solution, and Young's modulus of a Shore hardness."""

import numpy as np

from tactiled.cover.layered import gain
from tactiled.cover.stack import Layer, Stack
from tests.docs.markdown import is_table

DETAILS_MM = 5.0, 2.5  # half a wavelength
SILICONE, BOARD = (2.0, 0.5, 0.48), (1.6, 20000.0, 0.15)  # thickness (mm), Young's modulus (MPa), Poisson's ratio
CHANGES = {
    "2 mm of silicone (0.5 MPa, 0.48) on a board (20 000 MPa)": (SILICONE, BOARD),
    "silicone twice as stiff": ((2.0, 1.0, 0.48), BOARD),
    "silicone half as stiff": ((2.0, 0.25, 0.48), BOARD),
    "board half as stiff": (SILICONE, (1.6, 10000.0, 0.15)),
    "Poisson's ratio 0.3": ((2.0, 0.5, 0.3), BOARD),
    "Poisson's ratio 0.45": ((2.0, 0.5, 0.45), BOARD),
    "Poisson's ratio 0.4999": ((2.0, 0.5, 0.4999), BOARD),
    "silicone on silicone instead of the board": (SILICONE, (1.6, 0.5, 0.48)),
    "2.4 mm, 20 % more": ((2.4, 0.5, 0.48), BOARD),
    "1.6 mm, 20 % less": ((1.6, 0.5, 0.48), BOARD),
}


def gains(*layers):
    return gain(Stack(tuple(Layer(*each) for each in layers)), 1 / (2 * np.array(DETAILS_MM)))


@is_table("Cover", *(f"Gain of details of {each:g} mm" for each in DETAILS_MM), "Largest change")
def cover_sensitivity():
    base = gains(SILICONE, BOARD)
    for name, layers in CHANGES.items():
        values = gains(*layers)
        change = 100 * (values / base - 1)
        largest = change[np.abs(change).argmax()]
        text = f"{largest:+.0f} %" if abs(largest) >= 0.5 else "none"
        yield name, *(f"{each:.3f}" for each in values), "–" if layers == (SILICONE, BOARD) else text


def gent_mpa(shore_a):
    """Gent 1958: a rigid cylinder pressed in by the gauge's spring of 56 + 7.66 S grams."""
    return 0.0981 * (56 + 7.66 * shore_a) / (0.137505 * (254 - 2.54 * shore_a))


def ruess_mpa(shore_a):
    """Ruess' fit to measured rubbers: log10 E = 0.0235 S - 0.6403."""
    return 10 ** (0.0235 * shore_a - 0.6403)


@is_table("Shore A", "MPa by Gent", "MPa by Ruess", "Ruess / Gent")
def shore_a():
    for hardness in range(10, 100, 10):
        gent, ruess = gent_mpa(hardness), ruess_mpa(hardness)
        yield f"{hardness}", f"{gent:.1f}", f"{ruess:.1f}", f"{ruess / gent:.1f}"
