import numpy as np
import pytest

from tactiled.calibrate.upkeep.blocks import Blocks, TaxelNoise


@pytest.mark.parametrize(("hz", "grows"), [(0.0, 4.0), (1.0, 1.0), (4.0, 1.0)])
def test_noise_that_grows_is_followed_and_a_finger_that_rubs_is_none(hz, grows):
    random, blocks, noise, sigma = np.random.default_rng(0), Blocks(64), TaxelNoise(64), np.ones(64)
    for n in range(12000):  # 120 s
        sigma[:8] = 1.0 if n < 3000 else grows
        load = 1000 * np.sin(2 * np.pi * hz * n / 100 + np.arange(64))
        counts = np.round(2000 + load + random.normal(0, sigma)).astype(np.float32)
        if block := blocks.collect(n / 100, counts, np.zeros(64, np.uint8)):
            noise.update(block, block.mean - 2000)
    np.testing.assert_allclose(noise.sigma, sigma, rtol=0.35)


def test_a_load_that_moves_while_frames_are_skipped_is_no_noise():
    random, blocks, noise, time_s = np.random.default_rng(5), Blocks(64), TaxelNoise(64), 0.0
    for _ in range(6000):
        time_s += 0.01 * random.choice([1, 1, 1, 4, 9])
        load = np.where(np.arange(64) < 32, 300 * (1 + np.sin(2 * np.pi * 0.5 * time_s + np.arange(64))), 0.0)
        counts = np.round(2000 + load + random.normal(0, 1, 64)).astype(np.float32)
        if block := blocks.collect(time_s, counts, np.zeros(64, np.uint8)):
            noise.update(block, block.mean - 2000)
    np.testing.assert_allclose(noise.sigma[32:], 1, rtol=0.25)
    assert noise.reliable[32:].all()
    assert not noise.reliable[:32].any()
