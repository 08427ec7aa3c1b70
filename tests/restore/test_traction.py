import numpy as np
import pytest

from tests.bench import shear

SKIN = 4, 6, 1.0, 0  # rows, columns, t/pitch, rubber
QUIET = np.full(3, 0.1)


@pytest.fixture(scope="module")
def traction():
    return shear.model(*SKIN)[1]


@pytest.mark.parametrize("skin", [(4, 4, 0.5), (4, 6, 1.0)])
def test_presses_with_friction_are_restored(skin):
    figures = shear.measure(*skin, 24, seed=1)
    raw, once, twice, known, *_ = np.median(figures, axis=0)
    assert max(once, twice) < 0.55 * raw
    assert known > 0.7
    pressure, less = np.mean(figures, axis=0)[5:7]
    assert less < 0.9 * pressure


def test_the_readings_tell_how_large_friction_is():
    for friction, most in ((0.01, 0.25), (0.3, 0.35)):
        raw, _, restored, *_ = shear.measure(4, 4, 2.0, 12, seed=1, friction=friction).mean(axis=0)
        assert restored < most * raw


def test_an_even_drag_under_one_press_keeps_its_force(traction):
    rows, columns = traction.coupled.shape
    x, y = traction.coupled.cells.T
    image = (60 * np.exp(-((x - 2.2) ** 2 + (y - 1.4) ** 2))).reshape(rows, columns)
    load = np.concatenate([image.ravel(), 0.4 * image.ravel(), -0.2 * image.ravel()])
    readings = (traction.coupled.felt @ load).reshape(3, -1)
    own = image[traction.coupled.own]
    restored = traction(image, readings, QUIET)
    np.testing.assert_allclose(restored.traction.sum(axis=(1, 2)), own.sum() * np.array([0.4, -0.2]), rtol=0.06)
    np.testing.assert_allclose(restored.pressure, traction.coupled.felt[:24, len(x) :] @ load[len(x) :], atol=1)
    readings[:, 9] = np.nan
    without = traction(image, readings, QUIET)
    np.testing.assert_allclose(without.traction, restored.traction, atol=3)
    readings[:, 9] = 1e25  # beyond any sensor
    np.testing.assert_array_equal(traction(image, readings, QUIET).traction, without.traction)


def test_nothing_drags_where_nothing_presses_or_nothing_is_known(traction):
    rows, columns = traction.coupled.shape
    pressed = np.full((rows, columns), 5.0)
    for image, readings in (
        (np.zeros((rows, columns)), np.full((3, 24), 7.0)),
        (pressed, np.full((3, 24), np.nan)),
    ):
        load = traction(image, readings, QUIET)
        assert not load.traction.any()
        assert np.isfinite(load.deviation).all()
        assert not load.pressure.any()
