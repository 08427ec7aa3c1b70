import numpy as np
import pytest

from tactiled.calibrate.cover.contact_frames import (
    STILL_PITCHES,
    find_scenes,
    over_zeros,
    shared_noise,
    still_means,
)
from tactiled.errors import ConfigError

SIZE, NOISE = 20, 0.2


def presses(count=4, seed=1):
    """Frames (T, 8, 8) of presses on all but the outer taxels, 20 frames each, with 20 before and after."""
    random = np.random.default_rng(seed)
    frames = np.tile(np.kron([0, 1], np.ones(20)), count)[:, None, None] * np.pad(np.full((6, 6), 80.0), 1)
    frames = np.concatenate([frames, np.zeros((20, 8, 8))])
    return frames, frames + random.normal(0, NOISE, frames.shape)


def test_zeros_that_drift_are_those_around_each_contact():
    clean, frames = presses()
    drift = np.linspace(0, 6 * NOISE, len(frames))[:, None, None] * np.linspace(0.5, 1.5, 64).reshape(8, 8)
    over, variance = over_zeros((frames + drift + 500).astype(np.float32), NOISE)
    pressed = clean.max(axis=(1, 2)) > 0
    error = (over - clean)[pressed].mean(axis=0)
    assert np.abs(error).max() < 5 * NOISE / np.sqrt(pressed.sum() / 2)
    assert 1 / 50 < variance[pressed].mean() < 1 / 10


def test_what_rubber_that_creeps_leaves_after_a_lift_is_zero_and_no_scene():
    clean, frames = presses()
    residue = 0.06 * np.concatenate([np.zeros((20, 8, 8)), clean[:-20]])  # in the pause after each press
    over, _ = over_zeros((frames + residue).astype(np.float32), NOISE)
    assert [len(each) for each in find_scenes(over, NOISE)] == [20] * 4
    np.testing.assert_allclose(over[30, 3, 3] / over[70, 3, 3], 1, atol=0.05)


def test_a_recording_that_ends_pressed_has_the_zero_before():
    clean, frames = presses()
    over, variance = over_zeros((frames - 3)[:-20].astype(np.float32), NOISE)
    np.testing.assert_allclose(over[-20:].mean(axis=0), clean[-21], atol=5 * NOISE / np.sqrt(8))
    assert variance[-1] == pytest.approx(1 / 25, rel=0.5)


def test_frames_that_always_have_a_load_are_refused():
    random = np.random.default_rng(2)
    frames = random.normal(0, NOISE, (60, 64)) + 30 * np.eye(64)[np.arange(60)]
    with pytest.raises(ConfigError, match="no frame is without a load"):
        over_zeros(frames.reshape(-1, 8, 8).astype(np.float32), NOISE)


@pytest.mark.parametrize("shares", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.1, 0.2, 0.3)])
def test_noise_that_rows_columns_and_frames_share_is_measured_while_contacts_come_and_go(shares):
    _, frames = presses(8)
    random, (rows, columns, everything) = np.random.default_rng(3), shares
    frames += rows * random.normal(size=(len(frames), 8, 1)) + columns * random.normal(size=(len(frames), 1, 8))
    frames += everything * random.normal(size=(len(frames), 1, 1))
    frames[:, 2, 3] = np.nan
    noise = np.sqrt(NOISE**2 + rows**2 + columns**2 + everything**2)
    measured = np.sqrt(shared_noise(frames.astype(np.float32), noise))
    np.testing.assert_allclose(measured, shares, atol=0.05)


def test_contacts_that_come_and_go_all_the_time_are_no_shared_noise():
    frames = presses(20)[1][::7]  # three or fewer in turn are alike
    assert max(shared_noise(frames.astype(np.float32), NOISE)) < 0.1 * NOISE**2


def test_frames_are_averaged_while_the_contact_hardly_moves():
    random, shift = np.random.default_rng(7), np.array([0, 0.5, 0.9, 1.5, 3]) * STILL_PITCHES
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    clean = np.exp(-((x - 9 - shift[:, None, None]) ** 2 + (y - 9.5) ** 2) / 8).astype(np.float32) * 100
    frames = clean + random.normal(0, 0.1, clean.shape).astype(np.float32)
    means, noise = still_means(frames, [np.arange(5)], np.array([0, 4]), 0.1)
    np.testing.assert_allclose(means[0], frames[:3].mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(means[1], frames[4])
    assert noise == pytest.approx([0.1 / np.sqrt(3), 0.1])


def test_scenes_end_where_nothing_touches_and_where_all_changes():
    frames = np.random.default_rng(0).normal(0, 0.1, (9, 4, 4)).astype(np.float32)
    frames[1:4, :2] += 10
    frames[4:6, 3] += 10
    frames[8, 1] += 10
    frames[:, 0, 0] = np.nan
    assert [scene.tolist() for scene in find_scenes(frames, 0.1)] == [[1, 2, 3], [4, 5], [8]]
