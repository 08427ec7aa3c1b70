import numpy as np

from tactiled.cover import layered
from tactiled.cover.stack import Layer, Stack
from tactiled.cover.tangential import responses
from tactiled.geometry import grid

STACK = Stack((Layer(2.0, 0.3, 0.45), Layer(1.0, 980.0, 0.3)))
SIDE, STEP, WAVES = 2.0, 0.25, 256


def test_responses_are_the_waves_of_the_gains_summed_on_a_fine_lattice():
    array, (y, x) = grid(4, 6, 4.0, 3.0), np.mgrid[-4:13, -4:15] * SIDE
    cells = np.column_stack([x.ravel(), y.ravel()]) - SIDE / 2
    felt, (n, m) = responses(STACK, array, cells, SIDE), (array.size, len(cells))
    u, v = np.meshgrid(*[np.fft.fftfreq(WAVES, STEP)] * 2)
    length = np.hypot(u, v)
    along, across, apart, tilt = layered.tangential(STACK, length)
    n_x, n_y = (each / np.where(length > 0, length, 1) for each in (u, v))
    feet = SIDE**2 * np.sinc(u * SIDE) * np.sinc(v * SIDE) * np.sinc(array.width * u) * np.sinc(array.width * v)
    column, row = np.rint((array.positions[:, None] - cells) / STEP).astype(int).T % WAVES
    for matrix, gain in (
        (felt.tangential[:n, :m], across + (along - across) * n_x**2),
        (felt.tangential[n:, :m], (along - across) * n_x * n_y),
        (felt.tangential[n:, m:], across + (along - across) * n_y**2),
        (felt.apart[:n], -1j * apart * n_x),
        (felt.apart[n:], -1j * apart * n_y),
        (felt.tilt[:, :m], 1j * tilt * n_x),
        (felt.tilt[:, m:], 1j * tilt * n_y),
    ):
        waves = np.fft.ifft2(gain * feet).real / STEP**2
        np.testing.assert_allclose(matrix, waves[row, column].T, atol=1e-5)
