from collections.abc import Callable

import pytest

from tactiled.cover.stack import Layer, Stack

Build = Callable[..., Stack]


@pytest.fixture
def paper() -> Build:
    """Make the paper's stack: a cover on 1 mm of sensor at 980 MPa, 0.3."""

    def build(thickness: float = 0.2, young: float = 98.0, poisson: float = 0.3) -> Stack:
        return Stack((Layer(thickness, young, poisson), Layer(1.0, 980.0, 0.3)))

    return build
