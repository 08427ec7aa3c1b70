import numpy as np
import pytest

from tactiled.restore.methods import METHODS, make
from tactiled.study.skin import nrmse
from tests.study.presses import presses
from tests.study.restore import OURS, speed


@pytest.mark.parametrize("method", METHODS)
def test_no_method_explodes_on_loads_far_smaller_than_its_cells(method):
    for press in presses(16, (1.0,), (0.002,)):
        image = make(method, press.blur, press.sigma)(press.frame).image
        assert np.abs(image).max() < 3 * max(press.truth.max(), press.frame.max()), press.scene


@pytest.mark.parametrize(
    ("thicknesses", "seed", "bound"),
    [
        ((0.2, 0.35, 0.5), 77, 0.8),  # by pressure that steps from cell to cell ten were worse, up to 2.7 times
        ((0.05, 0.1, 0.35, 0.5), 11, 0.75),  # without weighing the gain of restoring, seven, up to 1.47 times
        ((0.05, 0.1, 0.35, 0.5), 14, 0.8),  # five
    ],
)
def test_auto_does_not_restore_where_that_may_harm(thicknesses, seed, bound):
    pairs = [
        (
            nrmse(make("auto", press.blur, press.sigma)(press.frame).image, press.truth),
            nrmse(press.frame, press.truth),
        )
        for press in presses(16, thicknesses, (0.002, 0.01), seed=seed)
    ]
    assert len(pairs) == 14 * len(thicknesses)
    assert max(auto / raw for auto, raw in pairs) < 1.02
    assert np.mean([auto for auto, _ in pairs]) < bound * np.mean([raw for _, raw in pairs])


def test_every_method_is_timed_on_a_still_scene():
    assert set(speed(16, 0.05)) == {"skimage wiener", "skimage rl", "FFT pair", *OURS}
