import numpy as np
import pytest

from tactiled.bench.skin import rubber
from tests.bench.held_out_scenes import APPEARS, FINER, HELD_OUT_SCENES, STEP, held_out

SKIN = rubber(1.0, 16, FINER)


@pytest.mark.parametrize("scene", HELD_OUT_SCENES)
def test_scenes_press_and_differ_and_move_as_their_motion_says(scene):
    still = held_out(scene, SKIN, 1)
    assert still.shape == (16 * FINER, 16 * FINER)
    assert 0 <= still.min() < 40 < still.max() < 250
    assert not np.array_equal(still, held_out(scene, SKIN, 2))
    before, after = (held_out(scene, SKIN, 1, "appearing", n) for n in (APPEARS - 1, APPEARS))
    assert not before.any()
    assert np.array_equal(after, still)
    stuck = [np.array_equal(still, held_out(scene, SKIN, 1, "slipping", n)) for n in range(5)]
    assert stuck == [True] * 4 + [False]
    rolled = [held_out(scene, SKIN, 1, "rolling", n) for n in (0, 9)]
    assert not np.array_equal(*rolled)
    assert np.all(still >= np.maximum(*rolled))


def test_a_moving_scene_is_the_same_farther_right():
    moved, still = held_out("stone", SKIN, 4, "moving", 50), held_out("stone", SKIN, 4)
    shift = round(50 * STEP * FINER)
    assert shift == pytest.approx(50 * STEP * FINER)  # in whole cells
    assert np.allclose(moved[:, shift:], still[:, :-shift], atol=1e-6)
