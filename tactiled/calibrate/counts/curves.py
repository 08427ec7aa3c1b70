"""From counts over no load to kPa, one monotone curve per taxel: line, power law, cubic or monotone spline."""

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from tactiled.arrays import Floats, Mask, Reals
from tactiled.calibrate.counts.hysteresis import Loop
from tactiled.errors import ConfigError

Form = Literal["linear", "power", "cubic", "spline"]
FORMS: tuple[Form, ...] = get_args(Form)
PARAMETERS = {"linear": 1, "power": 2, "cubic": 3}  # a taxel's; of a spline, as many as it has knots
KNOTS = np.array([0.25, 0.5, 0.75, 1.0])  # relative counts of fitted splines
CHORD_TO = 0.01  # relative counts up to which a power law is its chord: its slope at 0 is 0 or infinite
MIN_REACH_COUNTS = 1e-6  # of a range, whose end the counts are divided by
BISECTIONS = 50  # of [0, 1], to below float64's resolution of the relative counts


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Monotone curves of N taxels through (0 counts, 0 kPa); u = counts over no load / the range's loaded end.

    linear: [kPa per count]; power: [a, b], p = a u^b; cubic: [k1, k2, k3], p = k1 u + k2 u² + k3 u³;
    spline: kPa at `knots`, relative counts over 0 up to 1 shared by all taxels, PCHIP between them and (0, 0).
    Below u = 0 and beyond u = 1 a curve goes on along its tangent. Counts may fall under pressure.
    """

    form: Form
    parameters: Floats  # (N, P)
    reach_counts: Floats  # (N, 2): calibrated range over no load, ascending; one end is 0
    deviation: Floats  # (N,) standard error of the gain, relative to it; NaN: unknown
    hysteresis: Floats  # (N,) % of full scale; NaN: unknown
    individual: Mask  # (N,) false: the taxel has the array's common curve, not its own
    knots: Floats = field(default_factory=lambda: np.empty(0))  # (P,), of a spline only
    error_kpa: Floats | None = None  # (N,) rms in another rise or fall of the pressure; None or NaN: unknown
    curvature: float | None = None  # relative standard error, common to all, of the mid-range gain; None: unknown
    loop: Loop | None = None  # hysteresis, which is added to the counts before they are given to a curve
    _end: Floats = field(init=False, repr=False)  # (N,) counts at u = 1, negative where counts fall
    _pieces: Floats = field(init=False, repr=False)  # (4, N, K): polynomials of each piece, highest power first

    def __post_init__(self) -> None:
        """Refuse, by name, what is no monotone curve."""
        for name in ("parameters", "reach_counts", "deviation", "hysteresis", "knots"):
            object.__setattr__(self, name, np.array(getattr(self, name), np.float64))
        object.__setattr__(self, "individual", np.array(self.individual, bool))
        if self.error_kpa is not None:
            object.__setattr__(self, "error_kpa", np.array(self.error_kpa, np.float64))
        self._check_shapes()
        _require("parameters", np.isfinite(self.parameters).all(axis=1), self.parameters, "give numbers")
        low, high = self.reach_counts.T
        valid = np.isfinite(high - low) & (low + MIN_REACH_COUNTS <= high) & ((low == 0) | (high == 0))
        _require("reach_counts", valid, self.reach_counts, "give 0 and the range's other end, ascending")
        _require("deviation", ~(self.deviation < 0), self.deviation, "give a standard error of 0 or more")
        _require("hysteresis", ~(self.hysteresis < 0), self.hysteresis, "give % of full scale, 0 or more")
        if self.loop is not None:
            self.loop.check()
        if self.error_kpa is not None:
            _require("error_kpa", ~(self.error_kpa < 0), self.error_kpa, "give kPa, 0 or more")
        object.__setattr__(self, "_end", low + high)
        _require("parameters", self._monotone(), self.parameters, f"a {self.form} curve must rise with pressure")
        object.__setattr__(self, "_pieces", self._polynomials())

    @property
    def size(self) -> int:
        """Number of taxels."""
        return len(self.parameters)

    @property
    def end(self) -> Floats:
        """Counts over no load (N,) at the range's loaded end; negative where counts fall."""
        return self._end

    @property
    def gain(self) -> Floats:
        """Pressure over counts (N,) at the range's loaded end, in kPa per count; negative where counts fall."""
        return self.pressure(self._end) / self._end

    def pressure(self, counts: Reals) -> Floats:
        """Pressure of `counts` (..., N) over no load, in kPa; NaN stays."""
        relative = counts / self._end
        inside = np.clip(relative, 0.0, 1.0)
        return self._value(inside) + self._slope(inside) * (relative - inside)

    def slope(self, counts: Reals) -> Floats:
        """Slope at `counts` (..., N) over no load, in kPa per count; negative where counts fall."""
        return self._slope(np.clip(counts / self._end, 0.0, 1.0)) / self._end

    def counts(self, pressure: Reals) -> Floats:
        """Counts over no load of `pressure` (..., N) in kPa; the inverse of `pressure`."""
        values = np.asarray(pressure, np.float64)
        low, high = np.zeros(values.shape), np.ones(values.shape)
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            below = self._value(middle) < values
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        inside = np.where(np.isnan(values), np.nan, np.where(values <= 0, 0.0, high))
        beyond = values - np.clip(values, 0.0, self._value(np.ones(values.shape)))
        return (inside + beyond / self._slope(inside)) * self._end

    def out_of_range(self, counts: Reals) -> Mask:
        """Whether `counts` (..., N) over no load lie beyond the calibrated range's loaded end."""
        return np.asarray(counts / self._end > 1.0)

    def _value(self, relative: Floats) -> Floats:
        """Pressure (kPa) at relative counts (..., N) within 0 to 1."""
        if self.form == "power":
            a, b = self.parameters.T
            chord = a * CHORD_TO ** (b - 1) * relative
            return np.asarray(np.where(relative < CHORD_TO, chord, a * relative**b))
        c3, c2, c1, c0, x = self._piece(relative)
        return np.asarray(((c3 * x + c2) * x + c1) * x + c0)

    def _slope(self, relative: Floats) -> Floats:
        """Derivative of `_value`, in kPa."""
        if self.form == "power":
            a, b = self.parameters.T
            return np.asarray(
                a
                * np.where(relative < CHORD_TO, CHORD_TO ** (b - 1), b * np.maximum(relative, CHORD_TO) ** (b - 1))
            )
        c3, c2, c1, _, x = self._piece(relative)
        return np.asarray((3 * c3 * x + 2 * c2) * x + c1)

    def _piece(self, relative: Floats) -> tuple[Any, ...]:
        """Coefficients of the polynomial at each relative count, and the distance from the start of its piece."""
        if self.form != "spline":
            return *self._pieces[..., 0], relative
        starts = np.concatenate([[0.0], self.knots[:-1]])
        at = np.clip(np.searchsorted(starts, relative, side="right") - 1, 0, len(starts) - 1)
        return *self._pieces[:, np.arange(self.size), at], relative - starts[at]

    def _polynomials(self) -> Floats:
        """Coefficients (4, N, K) of the K pieces, of the distance from each piece's start."""
        one = np.zeros((4, self.size, 1))
        if self.form == "linear":
            one[2] = self.parameters * self._end[:, None]
        elif self.form == "cubic":
            one[2], one[1], one[0] = self.parameters.T[..., None]
        elif self.form == "spline":
            from scipy.interpolate import PchipInterpolator

            values = np.column_stack([np.zeros(self.size), self.parameters])
            pieces = PchipInterpolator(np.concatenate([[0.0], self.knots]), values, axis=1).c
            return np.asarray(np.moveaxis(pieces, -1, 1), np.float64)
        return one

    def _monotone(self) -> Mask:
        """Whether pressure rises strictly with relative counts from 0 to 1, for each taxel (N,)."""
        match self.form:
            case "linear":
                return np.asarray(self.parameters[:, 0] * self._end > 0)
            case "power":
                return np.asarray((self.parameters > 0).all(axis=1))
            case "spline":
                return np.asarray((np.diff(self.parameters, prepend=0.0, axis=1) > 0).all(axis=1))
        return cubic_slope(self.parameters) > 0

    def _check_shapes(self) -> None:
        """ConfigError where an array's shape does not go with the others, or a knot is out of order."""
        if self.form not in FORMS:
            raise ConfigError(f"form is {self.form!r}: choose one of {', '.join(FORMS)}")
        size = self.parameters.shape[0] if self.parameters.ndim else 0
        knots = self.knots.size if self.form == "spline" else 0
        shapes = {
            "parameters": (size, PARAMETERS.get(self.form, knots)),
            "reach_counts": (size, 2),
            "knots": (knots,),
        }
        shapes |= dict.fromkeys(("deviation", "hysteresis", "individual"), (size,))
        shapes |= {} if self.error_kpa is None else {"error_kpa": (size,)}
        for name, shape in shapes.items():
            if (actual := getattr(self, name).shape) != shape or not size:
                raise ConfigError(f"{name} has shape {actual}: a {self.form} curve of {size} taxels needs {shape}")
        if self.form == "spline" and not (
            knots and (np.diff(self.knots, prepend=0.0) > 0).all() and self.knots[-1] == 1
        ):
            raise ConfigError(
                f"knots are {self.knots.tolist()}: give rising relative counts over 0, the last one 1"
            )


def unit_curves(form: Form, parameters: Floats) -> Curves:
    """Curves (N,) of relative counts: their range ends at 1."""
    size = len(parameters)
    zeros, knots = np.zeros(size), KNOTS if form == "spline" else np.empty(0)
    return Curves(form, parameters, np.tile([0.0, 1.0], (size, 1)), zeros, zeros, zeros.astype(bool), knots)


def cubic_slope(parameters: Floats) -> Floats:
    """Least slope (N,) over u in [0, 1] of the cubics k1 u + k2 u² + k3 u³; `parameters` (N, 3)."""
    k1, k2, k3 = parameters.T
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = np.clip(np.nan_to_num(-k2 / (3 * k3)), 0.0, 1.0)
    u = np.stack([np.zeros_like(k1), vertex, np.ones_like(k1)])
    return np.asarray((k1 + (2 * k2 + 3 * k3 * u) * u).min(axis=0))


def _require(name: str, valid: Any, values: Floats, advice: str) -> None:
    """ConfigError that names the first taxel whose value is not valid."""
    if not valid.all():
        taxel = int(np.argmin(valid))
        raise ConfigError(f"{name} of taxel {taxel} is {values[taxel].tolist()}: {advice}")
