"""Calibration files for tests."""

import numpy as np

from tactiled.calibrate.calibration_file import CalibrationFile
from tactiled.calibrate.counts.curves import Curves
from tactiled.calibrate.cover.fit import CoverFit
from tactiled.calibrate.sections import CoverSection, GainSection, HealthSection, NoLoadSection, Origin, build
from tactiled.cover.stack import Layer, Stack

STACK = Stack((Layer(0.8, 0.6, 0.48),))
CREATED = "2026-11-22T08:30:00Z"


def origin(method="steps", created=CREATED):
    return Origin(recording="steps.log", sha256="5" * 64, method=method, created=created)


def gain_section(gains, reach=4000.0):
    """Lines of `gains` (N,), kPa per count, over a reach for all or one each (N, 2)."""
    size = len(gains)
    reaches = np.tile([0.0, reach], (size, 1)) if np.isscalar(reach) else reach
    curves = Curves(
        "linear",
        np.reshape(gains, (-1, 1)),
        reaches,
        np.full(size, 0.004),
        np.full(size, np.nan),
        np.full(size, True),
    )
    return GainSection.of(curves, origin())


def cover_section(factor=1.2, stack=STACK, kernel=None, half_width=0.03):
    interval = factor * (1 - half_width), factor * (1 + half_width)
    low, high = (each * stack.depth for each in interval)
    fit = CoverFit("tip", factor, interval, factor * stack.depth, (low, high), 20, 1.1, kernel=kernel)
    return CoverSection.of(fit, stack, origin("tip"))


def calibration_file(taxels=64, sensor="palm", codec="packed", **sections):
    """A file with a gain and a cover, or with the given sections."""
    random = np.random.default_rng(taxels)
    sections = sections or {
        "no_load": NoLoadSection.of(random.normal(100, 5, taxels), origin("tare")),
        "gain": gain_section(random.uniform(0.4, 0.6, taxels)),
        "cover": cover_section(),
        "health": HealthSection.of((3,), np.where(np.arange(taxels) == 3, np.nan, 1.5), origin("frames")),
    }
    return build(CalibrationFile, sensor=sensor, codec=codec, taxels=taxels, **sections)
