"""Simulated skins whose curves are known: what they count under a pressure, or under an indenter."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from tactiled.frames import FrameSeries

RATE_HZ = 100.0
FULL_KPA, FULL_COUNTS = 60.0, 3000.0
PCHIP = PchipInterpolator([0, 0.25, 0.5, 0.75, 1], [0, 0.1, 0.5, 0.6, 1])
SHAPES = {  # relative counts to relative pressure, from 0 to 1
    "linear": lambda u: u,
    "power": lambda u: np.sign(u) * np.abs(u) ** 1.4,
    "cubic": lambda u: 0.6 * u - 0.3 * u**2 + 0.7 * u**3,
    "spline": lambda u: PCHIP(np.clip(u, 0, 1)) + PCHIP(np.clip(u, 0, 1), 1) * (u - np.clip(u, 0, 1)),
}


@dataclass
class Skin:
    """Taxels with a gain each, noise of 1 % of full scale, drift, some of them dead."""

    size: int = 64
    shape: str = "linear"
    seed: int = 0
    falling: bool = False
    noise: float = 0.01
    spread: float = 0.2
    drift: float = 0.01  # of full scale, over the recording
    hysteresis: float = 0.0  # of full scale
    dead: tuple = ()

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)
        self.full = FULL_COUNTS / (1 + self.spread * self.rng.standard_normal(self.size).clip(-2.5, 2.5))
        self.full[list(self.dead)] = 0
        self.offset = 500 + self.rng.normal(0, 30, self.size)
        self.tilt = self.rng.normal(self.drift, self.drift / 2, self.size)

    def pressure(self, over):
        """kPa of counts (..., N) over no load."""
        return FULL_KPA * SHAPES[self.shape](np.abs(over) / np.maximum(self.full, 1))

    def relative(self, kpa):
        """Relative counts of a pressure, by a table of the inverse."""
        u = np.linspace(-0.2, 1.5, 20001)
        return np.interp(kpa / FULL_KPA, SHAPES[self.shape](u), u)

    def series(self, kpa, start_s=1.7e9, rounded=True):
        """What it counts under pressures (T,) or (T, N)."""
        kpa = np.asarray(kpa, float)
        kpa = kpa[:, None] if kpa.ndim == 1 else kpa
        relative = self.relative(kpa)
        if self.hysteresis:
            falling = np.gradient(kpa, axis=0) < 0
            loop = 4 * relative * (relative.max() - relative) / relative.max()
            relative = relative + self.hysteresis * loop * latched(falling, np.gradient(kpa, axis=0) > 0)
        time = np.linspace(0, 1, len(kpa))[:, None]
        counts = (
            relative * self.full
            + (time * self.tilt + self.noise * self.rng.standard_normal((len(kpa), self.size))) * FULL_COUNTS
        )
        counts = (12000 - self.offset - counts) if self.falling else self.offset + counts
        return FrameSeries(
            start_s + np.arange(len(kpa)) / RATE_HZ, (np.round(counts) if rounded else counts).astype(np.float32)
        )


def latched(on, off):
    """1 from where `on` is true until where `off` is."""
    state = np.where(on, 1.0, np.where(off, 0.0, np.nan))
    state[0] = np.where(np.isnan(state[0]), 0.0, state[0])
    for n in range(1, len(state)):
        state[n] = np.where(np.isnan(state[n]), state[n - 1], state[n])
    return state


def steps(levels, hold_s=5.0, ramp_s=1.0):
    """Pressure (T,) that is held at one level after another."""
    ends = np.cumsum([hold_s, *[ramp_s, hold_s] * (len(levels) - 1)])
    at = np.concatenate([[0], ends])
    return np.interp(np.arange(0, ends[-1], 1 / RATE_HZ), at, np.repeat(levels, 2))


def contact(places, loads_n, array, width_mm):
    """Pressure (T, N) in kPa of a round contact at places (T, 2) with forces (T,) in N; smooth over the pitch."""
    square = ((array.positions[None] - places[:, None]) ** 2).sum(axis=2)
    peak = 1e3 * loads_n / (2 * np.pi * width_mm**2)
    return peak[:, None] * np.exp(-square / (2 * width_mm**2))
