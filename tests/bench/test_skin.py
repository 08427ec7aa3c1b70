"""The scenes and skins that everything is measured on."""

import numpy as np
import pytest

from tactiled.bench.scenes import TEST_SCENES
from tactiled.bench.skin import clips, configured, misconfigured, rubber
from tactiled.config.example import EXAMPLE, GRASP
from tactiled.errors import ConfigError


def test_a_misconfigured_cover_changes_frames_but_not_the_operator():
    true, other = rubber(1.0, 8), misconfigured(rubber(1.0, 8), thickness=1.3)
    a, b = (next(clips(skin, 1e-6, 3, 1, ("punches",))) for skin in (true, other))
    assert a.frames.shape == a.truths.shape == (3, 8, 8)
    assert not np.array_equal(a.truths[0], a.truths[2])  # the scene moves
    assert np.array_equal(a.truths, b.truths)
    assert not np.allclose(a.frames, b.frames, rtol=1e-3)
    assert np.array_equal(true.blur.modes.gain, other.blur.modes.gain)


def test_a_configured_grid_or_layout_is_measured_on_the_scenes_that_touch_it(tmp_path):
    path = tmp_path / "it.toml"
    for config, shape, cells in ((EXAMPLE.replace("= 32", "= 8"), (8, 8), (8, 8)), (GRASP, (60,), (9, 46))):
        path.write_text(config)
        clip = next(clips(configured(path), 0.01, 1, 1, ("blobs",)))
        assert (clip.frames.shape, clip.truths.shape) == ((1, *shape), (1, *cells))
        assert clip.truths.max() > 10
    touching = list(clips(configured(path), 0.01, 2, 1))
    assert 0 < len(touching) < len(TEST_SCENES)
    assert all(clip.truths.max(axis=(1, 2)).min() > 1 for clip in touching)
    with pytest.raises(ConfigError, match=r"no sensor 'foot': choose one of"):
        configured(path, "foot")
