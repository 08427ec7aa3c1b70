"""What a cover's parameters change, by the exact solution."""

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
