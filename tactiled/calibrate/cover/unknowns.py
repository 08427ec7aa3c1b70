"""What a person does not know exactly of a sensor and of what presses on it, each with a deviation of its own."""

from dataclasses import dataclass

import numpy as np

from tactiled.arrays import Floats
from tactiled.geometry import Array

# What presses share, in this order: logarithm of the thickness over the configured one; of the tip's radius or the
# ridge's width (mm); of the aperture over the configured one; what is added to Poisson's ratio; the bend of the
# taxels' curves at the highest reading; and how the load is spread (`touch_response`).
FACTOR, SIZE, APERTURE, POISSON, CURVATURE, PROFILE = range(6)
SHARED = 6
SENSOR = (APERTURE, POISSON)  # a thickness that makes up for these restores rightly

APERTURE_SCALES = (0.7, 1.0, 1.4)  # of tables: the response is a parabola in the scale's logarithm through them
CALIPER_ERROR_MM = 0.02  # standard deviation of a measured diameter or width
APERTURE_ERROR, DEFAULT_APERTURE_ERROR = 0.2, 0.3  # of its logarithm: where it is given, where it is the pitch
POISSON_ERROR = 0.04  # rubbers have 0.45 to 0.4999
CURVATURE_ERROR = 0.05  # of the highest reading: a curve that is taken for a line
PROFILE_ERROR = 0.5  # of the exponent: from a rigid punch (-0.5) to a cone (1), around even pressure
EDGE_BLUR_MM = 0.25  # of the edge of a soft pad


@dataclass(frozen=True, slots=True)
class Unknowns:
    """Standard deviations of what is given; None: the usual one."""

    size_mm: float | None = None  # of the tip's diameter or the ridge's width; of a pad, how blurred its edge is
    aperture_mm: float | None = None
    poisson: float = POISSON_ERROR
    curvature: float | None = None  # of all taxels' curves, over the highest reading
    profile: float = PROFILE_ERROR  # of a tip's or ridge's pressure; 0 is even, -0.5 that of a rigid punch

    def deviations(self, array: Array, size: float, profile: float) -> Floats:
        """Deviations (S,) of what presses share; `size` and `profile` are those of the load."""
        usual = DEFAULT_APERTURE_ERROR if array.width >= array.pitch * (1 - 1e-9) else APERTURE_ERROR
        aperture = usual if self.aperture_mm is None else self.aperture_mm / array.width
        bend = CURVATURE_ERROR if self.curvature is None else self.curvature
        return np.array([np.inf, size, aperture, self.poisson, bend, profile])


USUAL = Unknowns()
