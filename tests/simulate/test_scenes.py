import numpy as np
import pytest

from tactiled.simulate.scenes import SCENES

SIZE = 32.0  # mm
GRAIN = 0.125  # mm


@pytest.fixture(scope="module")
def field():
    half = np.arange(-SIZE / 2 + GRAIN / 2, SIZE / 2, GRAIN)
    return np.meshgrid(half, half)


def force(pressure):
    """Total force in mN: kPa x mm^2."""
    return float(pressure.sum()) * GRAIN**2


def finger(t, side):
    """Force of one walking fingertip: a half-ellipsoid of pressure holds 2/3 peak x area."""
    step = (0.4 * t + 0.5 * side) % 1.0
    peak = 70 * np.sin(np.pi * min(step / 0.6, 1.0))
    return 2 / 3 * peak * np.pi * 1.35 * (0.11 * SIZE) ** 2


def relief(t):
    """Force of two rings and fifteen dots, pressed harder and softer."""
    area = np.pi * (2 * 1.4 * (3.0 + 7.5) + 15 * 0.8**2)
    return 100 * (0.8 + 0.2 * np.sin(t)) * area


FORCES = {
    "touch": (100, relief),
    "ring": (80, lambda _: 80 * (1.0**2 - 0.6**2) * (SIZE / 2) ** 2),
    "indenters": (120, lambda _: 2 * 120 * np.pi * (0.05 * SIZE) ** 2),
    "sphere": (100, lambda _: 2 / 3 * 100 * np.pi * (0.14 * SIZE) ** 2),
    "edge": (90, lambda _: 90 * 0.06 * SIZE * 0.7 * SIZE),
    "fingertip": (70, lambda t: finger(t, 0) + finger(t, 1)),
    "uniform": (60, lambda t: 30 * (1 + np.sin(t)) * SIZE**2),
    "empty": (0, lambda _: 0.0),
}
CALIBRATING = ("tip", "straightedge", "steps")  # how a skin is calibrated


@pytest.mark.parametrize("name", [name for name in SCENES if name not in CALIBRATING])
def test_a_scene_is_a_pressure_of_known_peak_and_total_force(field, name):
    peak, expected = FORCES[name]
    for t in (0.0, 0.7, 2.9):
        pressure = SCENES[name](*field, t, SIZE, GRAIN)
        assert pressure.shape == field[0].shape
        assert pressure.min() >= 0
        assert pressure.max() <= peak * (1 + 1e-9)
        assert force(pressure) == pytest.approx(expected(t), rel=3e-3, abs=1e-9)
    rows, columns = np.random.default_rng(0).integers(0, len(pressure), (2, 50))
    points = (each[rows, columns] for each in field)  # a scene has no grid of its own
    np.testing.assert_array_equal(SCENES[name](*points, t, SIZE, GRAIN), pressure[rows, columns])


@pytest.mark.parametrize("name", [name for name in SCENES if name not in ("uniform", "empty", *CALIBRATING)])
def test_a_moving_outline_does_not_jump_from_cell_to_cell(field, name):
    """Total force of what only moves stays the same to a fraction of one cell's."""
    forces = [force(SCENES[name](*field, t, SIZE, GRAIN)) - FORCES[name][1](t) for t in np.arange(0, 0.05, 0.002)]
    assert np.ptp(forces) < 0.002 * FORCES[name][1](0.3)


def test_a_ring_is_hollow_and_two_indenters_part():
    at = np.array([0.0, 0.2 * SIZE]), np.zeros(2)
    np.testing.assert_array_equal(SCENES["ring"](*at, 0.0, SIZE, GRAIN), [0, 80])
    x = np.linspace(-SIZE / 2, SIZE / 2, 2001)
    pressed = SCENES["indenters"](x, 0 * x, 0.0, SIZE, GRAIN) > 60
    assert np.count_nonzero(np.diff(pressed.astype(int)) == 1) == 2


def test_tips_press_everywhere_and_edges_lie_at_slants_with_pauses_between():
    fine = np.arange(-SIZE / 2 + GRAIN / 2, SIZE / 2, GRAIN)
    x, y = np.meshgrid(fine, fine)
    zones = set()
    for number in range(20):
        pressure = SCENES["tip"](x, y, 1.2 * number + 0.4, SIZE, GRAIN)
        assert force(pressure) == pytest.approx(250 * np.pi * 1.0**2, rel=0.01)  # 2 mm across, wholly inside
        zones.add(tuple(int(3 * ((each * pressure).sum() / pressure.sum() / SIZE + 0.5)) for each in (x, y)))
        assert not SCENES["tip"](x, y, 1.2 * number + 1.0, SIZE, GRAIN).any()
    assert len(zones) == 9
    for number in range(5):
        pressure = SCENES["straightedge"](x, y, 2.4 * number + 0.8, SIZE, GRAIN)
        assert 0.2 < (pressure > 30).mean() < 0.8
        down, right = np.gradient(pressure)
        slant = np.degrees(np.arctan2(abs(down).sum(), abs(right).sum()))
        assert min(slant, 90 - slant) > 5  # it crosses the rows and columns at many phases
        assert not SCENES["straightedge"](x, y, 2.4 * number + 2.0, SIZE, GRAIN).any()
    levels = [SCENES["steps"](np.zeros(1), np.zeros(1), 8 * n + 4.0, SIZE, GRAIN)[0] for n in range(6)]
    assert levels == [0, 20, 40, 60, 40, 20]
