"""The scenes and skins that everything is measured on."""

import numpy as np
import pytest

from tactiled.config.example import EXAMPLE, GRASP
from tactiled.errors import ConfigError
from tactiled.study.scenes import PEAK_KPA, TEST_SCENES
from tactiled.study.skin import clips, configured, misconfigured, nrmse, rubber
from tests.study.presses import presses


def test_presses_are_blurred_truth_with_the_stated_noise():
    first, second = (list(presses(16, (1.0,), (0.01,))) for _ in range(2))
    assert [press.scene for press in first] == list(TEST_SCENES)
    for press, again in zip(first, second, strict=True):
        np.testing.assert_array_equal(press.frame, again.frame)
        assert press.frame.shape == press.truth.shape == (16, 16)
        assert 0.3 * PEAK_KPA < press.truth.max() < 12 * PEAK_KPA
        assert press.truth.min() >= 0
        assert press.sigma == pytest.approx(0.01 * press.frame.max(), rel=0.1)
        assert press.psf.shape[0] % 2 == 1
        assert np.unravel_index(press.psf.argmax(), press.psf.shape) == (press.psf.shape[0] // 2,) * 2
        within = 0.4 if press.scene == "points" else 0.08  # what lies between taxels is not in the truth's cells
        assert nrmse(press.blur.forward(press.truth), press.frame) < within


def test_a_clip_moves_and_its_truth_has_the_shape_of_the_array():
    clip = next(clips(rubber(1.0, 12), 0.01, 3, 1, ("punches",)))
    assert clip.frames.shape == clip.truths.shape == (3, 12, 12)
    assert not np.array_equal(clip.truths[0], clip.truths[2])


def test_a_misconfigured_cover_changes_frames_but_not_the_operator():
    true, other = rubber(1.0, 8), misconfigured(rubber(1.0, 8), thickness=1.3)
    a, b = (next(clips(skin, 1e-6, 1, 1, ("punches",))) for skin in (true, other))
    assert np.array_equal(a.truths, b.truths)
    assert not np.allclose(a.frames, b.frames, rtol=1e-3)
    assert np.array_equal(true.blur.modes.gain, other.blur.modes.gain)


def test_a_configured_grid_or_layout_is_measured_on_the_scenes_that_touch_it(tmp_path):
    path = tmp_path / "it.toml"
    for config, shape in ((EXAMPLE.replace("= 32", "= 8"), (8, 8)), (GRASP, (60,))):
        path.write_text(config)
        clip = next(clips(configured(path), 0.01, 1, 1, ("blobs",)))
        assert clip.frames.shape == clip.truths.shape == (1, *shape)
        assert clip.truths.max() > 10
    touching = list(clips(configured(path), 0.01, 2, 1))
    assert 0 < len(touching) < len(TEST_SCENES)
    assert all(clip.truths.max(axis=1).min() > 1 for clip in touching)
    with pytest.raises(ConfigError, match=r"no sensor 'foot': choose one of"):
        configured(path, "foot")
