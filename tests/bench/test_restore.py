import numpy as np
import pytest

from tactiled.bench.skin import nrmse
from tactiled.restore.methods import METHODS, make
from tests.bench.presses import presses
from tests.bench.restore import OURS, speed


@pytest.mark.parametrize("method", METHODS)
def test_no_method_explodes_on_loads_far_smaller_than_its_cells(method):
    for press in presses(16, (1.0,), (0.002,)):
        image = make(method, press.blur, press.sigma)(press.frame).image
        assert np.abs(image).max() < 3 * max(press.truth.max(), press.frame.max()), press.scene


@pytest.mark.parametrize("seed", [77, 11])
def test_auto_does_not_restore_where_that_harms_a_kind_of_scene_in_the_mean(seed):
    """Under covers so thin that no frame tells where on its taxel a small load is."""
    ratios = {}
    for press in presses(16, (0.05, 0.1, 0.2, 0.35, 0.5), (0.002, 0.01), seed=seed):
        image = make("auto", press.blur, press.sigma)(press.frame).image
        ratio = nrmse(image, press.truth) / nrmse(press.frame, press.truth)
        ratios.setdefault(press.scene, []).append(ratio)
    means = {scene: np.mean(each) for scene, each in ratios.items()}
    assert max(means.values()) < 1.02
    assert np.mean(list(means.values())) < 0.85


def test_every_method_is_timed_on_a_still_scene():
    assert set(speed(16, 0.05)) == {"skimage wiener", *OURS}
