"""The sections of a calibration file, as they stand in its JSON: no load, gain, cover, health."""

from collections.abc import Callable
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from tactiled.arrays import Floats, Reals
from tactiled.bounds import Syntax, place, reason
from tactiled.calibrate.counts.curves import Curves, Form
from tactiled.calibrate.counts.hysteresis import Loop
from tactiled.calibrate.cover.fit import CoverFit, Method
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import ConfigError, TactileError

if TYPE_CHECKING:
    from tactiled.calibrate.counts.gain import GainFit

DIGITS = 7  # significant ones of a value: those of float32, and far finer than any calibration
NEW_KEYS = frozenset({"error_kpa", "curvature", "loop", "effective"})  # of version 2, where they are known
MIN_KERNEL_SIZE = 4  # frequencies, as a cubic spline needs
MAX_VALUE = 1e9  # counts, kPa, mm or MPa: past any sensor and cover
MAX_KNOTS, MAX_LAYERS, MAX_PRESSES, MAX_TAXELS = 64, 16, 1_000_000, 1 << 20
MAX_KERNEL_SIZE, MAX_GAIN = 4096, 10.0
MAX_MISMATCH = 1e-4  # of thickness_mm to factor times the stack's: more is a contradiction

SHA256 = Syntax(r"^([0-9a-f]{64})?$", "64 digits of 0-9 and a-f, or nothing")
TIME = Syntax(r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ$", "a time in UTC, such as 2026-11-22T23:31:12Z")
Size = Annotated[float, Field(ge=-MAX_VALUE, le=MAX_VALUE)]
Value = Annotated[Size, AfterValidator(lambda value: float(f"{value:.{DIGITS}g}"))]
Values = Annotated[tuple[Value, ...], Field(fail_fast=True)]
OptionalValues = Annotated[tuple[Value | None, ...], Field(fail_fast=True)]  # None: unknown
Made = TypeVar("Made", bound=BaseModel)


class Table(BaseModel):
    """A JSON object: an unknown key is refused, and so is NaN."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def utc(time: float) -> str:
    """A time (s, Unix) as `Origin.created` has it: 2026-11-22T23:31:12Z."""
    return f"{datetime.fromtimestamp(time, UTC):%Y-%m-%dT%H:%M:%SZ}"


def _check_date(text: str) -> str:
    datetime.fromisoformat(text)
    return text


class Origin(Table):
    """Where a section comes from."""

    recording: Annotated[str, Field(max_length=255)]  # name of the file, or "live"
    sha256: Annotated[str, SHA256] = ""  # of the recording; "": the frames were live
    method: Annotated[str, Field(min_length=1, max_length=200)]  # such as tare, steps, force, weight, tip, edge
    created: Annotated[str, TIME, AfterValidator(_check_date)]

    @property
    def time(self) -> float:
        """When it was created, s, Unix."""
        return datetime.fromisoformat(self.created).timestamp()


class Section(Table):
    """One part of the file, replaced as a whole."""

    origin: Origin

    @property
    def version(self) -> int:
        """Of the file that holds it."""
        return 2 if any(getattr(self, key, None) is not None for key in NEW_KEYS) else 1

    @model_serializer(mode="wrap")
    def _without_new_keys(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A section of an old file has its keys only: its checksum stays."""
        content: dict[str, Any] = handler(self)
        return {key: each for key, each in content.items() if each is not None or key not in NEW_KEYS}


class NoLoadSection(Section):
    """Counts of the unloaded array."""

    counts: OptionalValues  # of each taxel

    @classmethod
    def of(cls, counts: Reals, origin: Origin) -> Self:
        """From counts (N,), NaN where unknown."""
        return build(cls, origin=origin, counts=optional(counts))

    @property
    def values(self) -> Floats:
        """Counts (N,); NaN where unknown."""
        return np.array(self.counts, float)


class GainSection(Section):
    """From counts over no load to kPa; each array has a value a taxel, of several parameters one array each."""

    form: Form
    parameters: Annotated[tuple[Values, ...], Field(max_length=MAX_KNOTS)]
    knots: Annotated[Values, Field(max_length=MAX_KNOTS)]
    reach_counts: tuple[Values, Values]  # lower and upper end
    deviation: OptionalValues
    hysteresis: OptionalValues
    individual: tuple[bool, ...]
    error_kpa: OptionalValues | None = None  # None: unknown, as in older files
    curvature: Annotated[Value, Field(ge=0)] | None = None
    loop: tuple[Value, Value, Value] | None = None  # hysteresis: near, far, weight

    @classmethod
    def of(cls, curves: Curves, origin: Origin) -> Self:
        """From curves."""
        return build(
            cls,
            origin=origin,
            form=curves.form,
            parameters=_rows(curves.parameters.T),
            knots=tuple(curves.knots.tolist()),
            reach_counts=_rows(curves.reach_counts.T),
            deviation=optional(curves.deviation),
            hysteresis=optional(curves.hysteresis),
            individual=tuple(curves.individual.tolist()),
            error_kpa=None if curves.error_kpa is None else optional(curves.error_kpa),
            curvature=curves.curvature,
            loop=None if curves.loop is None else tuple(curves.loop),
        )

    @cached_property
    def curves(self) -> Curves:
        """The curves."""
        return Curves(
            self.form, np.array(self.parameters, float).T, np.array(self.reach_counts, float).T,
            np.array(self.deviation, float), np.array(self.hysteresis, float), np.array(self.individual),
            np.array(self.knots), None if self.error_kpa is None else np.array(self.error_kpa, float),
            self.curvature, None if self.loop is None else Loop(*self.loop),
        )  # fmt: skip

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len({len(each) for each in (*self.parameters, *self.reach_counts)}) != 1:
            raise ValueError("parameters and reach_counts have different numbers of taxels")
        _attempt(lambda: self.curves)
        return self


class LayerTable(Table):
    """A layer as configured."""

    thickness_mm: Size
    young_mpa: Size
    poisson: Size
    bonded: bool


class CoverSection(Section):
    """The fitted cover, and the layers as configured when it was fitted."""

    method: Method
    factor: Annotated[Value, Field(ge=0.01, le=100)]
    interval: tuple[Value, Value]
    thickness_mm: Value
    interval_mm: tuple[Value, Value]
    presses: Annotated[int, Field(ge=1, le=MAX_PRESSES)]
    residual: Annotated[Value, Field(ge=0)] | None = None
    effective: tuple[Value, Value] | None = None  # not in files of release 0.4.2
    layers: Annotated[tuple[LayerTable, ...], Field(min_length=1, max_length=MAX_LAYERS)]
    layers_above_taxels: Annotated[int, Field(ge=1, le=MAX_LAYERS)]
    kernel: tuple[Values, Values] | None = None  # frequency (cycles/mm) and gain

    @classmethod
    def of(cls, fit: CoverFit, stack: Stack, origin: Origin) -> Self:
        """From a fit that can tell the thickness, and the stack as configured; ConfigError for one that cannot."""
        if fit.reason:
            raise ConfigError(f"cover: {fit.reason}")
        return build(
            cls,
            origin=origin,
            **{key: getattr(fit, key) for key in ("method", "factor", "interval", "thickness_mm", "interval_mm")},
            presses=fit.presses,
            effective=fit.effective,
            residual=None if np.isnan(fit.residual) else fit.residual,
            layers=tuple(
                LayerTable(thickness_mm=each.thickness, young_mpa=each.young, poisson=each.poisson, bonded=bonded)
                for each, bonded in zip(stack.layers, stack.bonds, strict=True)
            ),
            layers_above_taxels=stack.sensing,
            kernel=None if fit.kernel is None else _rows(fit.kernel),
        )

    @cached_property
    def fit(self) -> CoverFit:
        """The fit, without its plot and its notes."""
        return CoverFit(
            self.method, self.factor, self.interval, self.thickness_mm, self.interval_mm, self.presses,
            np.nan if self.residual is None else self.residual,
            effective=self.effective, kernel=None if self.kernel is None else np.array(self.kernel),
        )  # fmt: skip

    @cached_property
    def stack(self) -> Stack:
        """The stack as configured when it was fitted."""
        layers = tuple(Layer(each.thickness_mm, each.young_mpa, each.poisson) for each in self.layers)
        return Stack(layers, self.layers_above_taxels, tuple(each.bonded for each in self.layers))

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, (low, high) in (("interval", self.interval), ("effective", self.effective or self.interval)):
            if not 0 < low <= self.factor <= high:
                raise ValueError(
                    f"{name} is {low:g} to {high:g}: it must be positive and hold factor = {self.factor:g}"
                )
        _attempt(lambda: self.stack)
        expected = self.stack.depth * np.array([self.factor, *self.interval])
        if not np.allclose([self.thickness_mm, *self.interval_mm], expected, rtol=MAX_MISMATCH, atol=0):
            raise ValueError(f"thickness_mm is {self.thickness_mm:g}: factor and layers give {expected[0]:g}")
        if self.kernel is not None:
            _check_kernel(*(np.array(each) for each in self.kernel))
        return self


class HealthSection(Section):
    """Taxels that do not work, and the noise of those that do."""

    dead: Annotated[tuple[Annotated[int, Field(ge=0, le=MAX_TAXELS)], ...], Field(fail_fast=True)]
    # Standard deviation of each taxel.
    noise_counts: Annotated[tuple[Annotated[Value, Field(ge=0)] | None, ...], Field(fail_fast=True)]

    @classmethod
    def of(cls, dead: tuple[int, ...], noise_counts: Reals, origin: Origin) -> Self:
        """From indices of dead taxels and noise (N,), NaN where unknown."""
        return build(cls, origin=origin, dead=dead, noise_counts=optional(noise_counts))


def gain_sections(fit: "GainFit", noise_counts: Reals, origin: Origin) -> dict[str, Section]:
    """All that a fitted gain tells of an array whose taxels have that noise (N,)."""
    return {
        "gain": GainSection.of(fit.curves, origin),
        "no_load": NoLoadSection.of(fit.no_load, origin),
        "health": HealthSection.of(fit.dead, noise_counts, origin),
    }


def build(table: type[Made], **values: Any) -> Made:
    """Make a table; ConfigError, one line, where a value is not valid."""
    try:
        return table(**values)
    except ValidationError as error:
        raise ConfigError(error_line(error)) from error


def error_line(error: ValidationError) -> str:
    """The first error in one line: the place, the value, what is wrong with it."""
    first = error.errors()[0]
    at = place(first["loc"])
    if first["type"] in ("value_error", "missing", "extra_forbidden"):  # of a whole table, or of none
        return f"{at}: {reason(first)}" if at else reason(first)
    return f"{at} = {first['input']!r:.60}: {reason(first)}"


def _attempt(make: Callable[[], object]) -> None:
    """ValueError, as pydantic wants it, for an error of our own."""
    try:
        make()
    except TactileError as error:
        raise ValueError(str(error)) from error


def optional(values: Reals) -> tuple[float | None, ...]:
    """Values with None for NaN."""
    return tuple(None if np.isnan(each) else float(each) for each in np.asarray(values).ravel())


def _rows(values: Reals) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, values.tolist()))


def _check_kernel(q: Floats, gain: Floats) -> None:
    """ValueError for what is no gain over frequency: 1 at 0, then of finite values over rising frequencies."""
    if len(q) != len(gain) or not MIN_KERNEL_SIZE <= len(q) <= MAX_KERNEL_SIZE:
        sizes = f"{MIN_KERNEL_SIZE} to {MAX_KERNEL_SIZE}"
        raise ValueError(f"kernel has {len(q)} frequencies and {len(gain)} gains: give {sizes}")
    if (highest := np.abs(gain).max()) > MAX_GAIN:
        raise ValueError(f"kernel has a gain of {highest:g}: give at most {MAX_GAIN:g}")
    if q[0] != 0 or (np.diff(q) <= 0).any():
        raise ValueError("kernel: frequencies must rise from 0")
    if gain[0] != 1:
        raise ValueError(f"kernel: its gain at frequency 0 is {gain[0]:g}: a uniform load arrives whole: give 1")
