"""A force or pressure log beside a recording: its file, and its clock aligned with the recording's."""

import csv
from dataclasses import dataclass, replace
from math import floor, log10
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from tactiled.arrays import Floats
from tactiled.calibrate.counts.hysteresis import Plays
from tactiled.errors import ConfigError
from tactiled.units import number_text

Quantity = Literal["force_n", "pressure_kpa"]
QUANTITIES = get_args(Quantity)
ABSOLUTE_FROM_S = 1e8  # clocks that read more count from 1970, so two of them can be compared
MAX_CLOCK_OFFSET_S = 30.0  # of two such clocks; more is another zone or day
MIN_CORRELATION = 0.9  # of log and readings: of 60 unrelated pairs one reached 0.82; 20 % of hysteresis, 0.997
MIN_OVERLAP = 0.5  # of the shorter of recording and log
AMBIGUOUS = 0.97  # of the best correlation: an alignment as good as this may be the true one
MAX_SAMPLES = 20_000  # of a clock's search
MIN_ROWS = 20
MIN_CLOCK_ERROR_S = 1e-5  # of two digits: clocks that count from 1970 hold no finer one
REFINEMENTS = 6  # Gauss-Newton steps of the offset
SEARCHES = 0.03, 0.003, 0.0003  # of the recording's length, around the offset before
SEARCHED = 17  # offsets
LOOPS = 0.025, 0.1, 0.2  # half-widths of plays of the log's values, over the largest
MAX_LOOP_SAMPLES = 1500
MIN_EXPLAINED = 0.7  # residual with loops over that of a plain curve: above it there is no hysteresis
CURVE_KNOTS = np.linspace(0, 1, 9)  # of readings over the log: any smooth curve to 1 %
BLOCKS = 20  # of time, whose scatter is the offset's standard error


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A log of what pressed."""

    path: Path
    quantity: Quantity
    times: Floats  # (T,) s, ascending
    values: Floats  # (T,) N or kPa

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return "N" if self.quantity == "force_n" else "kPa"


@dataclass(frozen=True, slots=True)
class Alignment:
    """The log's clock less the recording's."""

    offset_s: float
    deviation_s: float  # standard error

    @property
    def text(self) -> str:
        """The offset, to two digits of its standard error."""
        digits = max(1 - floor(log10(max(self.deviation_s, MIN_CLOCK_ERROR_S))), 0)
        return f"{self.offset_s:+.{digits}f} s from the recording's, standard error {self.deviation_s:.2g} s"


def read_reference(path: Path) -> Reference:
    """Read a CSV file with the columns time_s and force_n or pressure_kpa; ConfigError names what is wrong."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *rows = [row for row in csv.reader(file) if row] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or 'no text'}: give a CSV file") from error
    names = [each.strip() for each in header]
    quantity = _quantity(path, names)
    values = [
        _numbers(path, line, row, (names.index("time_s"), names.index(quantity)))
        for line, row in enumerate(rows, 2)
    ]
    if len(values) < MIN_ROWS:
        raise ConfigError(f"{path}: {len(values)} rows: give {MIN_ROWS} or more")
    times, readings = np.array(values).T
    if (back := np.flatnonzero(np.diff(times) <= 0)).size:
        raise ConfigError(f"{path}: time_s does not rise at line {back[0] + 3}: {times[back[0] + 1]}")
    return Reference(path, quantity, times, readings)


def _quantity(path: Path, names: list[str]) -> Quantity:
    """The column of a known unit; ConfigError names a column of another one."""
    present: list[Quantity] = [each for each in QUANTITIES if each in names]
    if "time_s" in names and len(present) == 1:
        return present[0]
    if len(present) == 2:
        raise ConfigError(f"{path}: columns force_n and pressure_kpa: give one of them")
    stems = ("time",) if present else ("force", "pressure")
    other = [each for each in names if each.lower().startswith(stems)]
    expected = "time_s" if present else "force_n or pressure_kpa"
    if other:
        raise ConfigError(f"{path}: column {other[0]!r}: unknown unit; use {expected}")
    raise ConfigError(f"{path}: columns {', '.join(names)[:80]!r}: give time_s and force_n or pressure_kpa")


def _numbers(path: Path, line: int, row: list[str], columns: tuple[int, ...]) -> list[float]:
    """Numbers of a row; ConfigError names the line."""
    try:
        numbers = [float(row[each]) for each in columns]
        if not np.isfinite(numbers).all():
            raise ValueError
    except (ValueError, IndexError) as error:
        raise ConfigError(f"{path}: line {line}: {','.join(row)[:80]!r}: give numbers") from error
    return numbers


def align(times: Floats, signal: Floats, log: Reference) -> Alignment:
    """The log's clock less that of `times` (T,), at which the array reads `signal` (T,), loaded upwards.

    First by cross-correlation over all offsets, which a curve or hysteresis draws off by seconds where pressure
    rises slowly; then by a curve of the log with a loop, near that; then by Gauss-Newton, to parts of a sample.
    """
    offset, opened = _coarse(times, signal, log), _opened(log)
    for share in SEARCHES:
        around = share * np.ptp(times) * np.linspace(-1, 1, SEARCHED)
        offset, loop = _search(times, signal, log, opened, offset + around)
    plain = replace(opened, values=opened.values[:0])
    if loop > MIN_EXPLAINED * _search(times, signal, log, plain, np.array([offset]))[1]:
        opened = plain
    inside = (times + offset >= log.times[0]) & (times + offset <= log.times[-1])
    for _ in range(REFINEMENTS):
        step, deviation, correlation = _refine(times[inside] + offset, signal[inside], log, opened)
        offset += step
    if not correlation > MIN_CORRELATION:
        raise ConfigError(
            f"{log.path}: correlates with the recording by {correlation:.2f} only: give the log of this recording"
        )
    return Alignment(offset, deviation)


def _coarse(times: Floats, signal: Floats, log: Reference) -> float:
    """Offset (s) of the best cross-correlation, to one sample; ConfigError where there is none, or several."""
    ends = times[[0, -1]], log.times[[0, -1]]
    absolute = min(ends[0][0], ends[1][0]) > ABSOLUTE_FROM_S
    if absolute and (max(times[0], log.times[0]) > min(times[-1], log.times[-1]) + MAX_CLOCK_OFFSET_S):
        apart = max(log.times[0] - times[-1], times[0] - log.times[-1])
        raise ConfigError(f"{log.path}: does not overlap the recording: {number_text(apart)} s lie between them")
    span = max(np.ptp(times), np.ptp(log.times))
    step = max(float(np.median(np.diff(times))), float(span) / MAX_SAMPLES)
    series, reference = (
        np.interp(np.arange(a[0], a[-1], step), a, b - b[:MIN_ROWS].mean())
        for a, b in ((times, signal), (log.times, log.values))
    )
    shifts = np.arange(1 - series.size, reference.size)
    offsets = log.times[0] - times[0] + step * shifts
    norms = max(float(np.linalg.norm(series) * np.linalg.norm(reference)), 1e-300)
    correlation = _correlate(reference, series) / norms
    overlap = np.minimum(series.size, reference.size - shifts) - np.maximum(0, -shifts)
    correlation[overlap < MIN_OVERLAP * min(series.size, reference.size)] = -1
    if absolute:
        correlation[np.abs(offsets) > MAX_CLOCK_OFFSET_S] = -1
    return _one_peak(offsets, correlation, absolute, log.path)


def _correlate(one: Floats, other: Floats) -> Floats:
    """Cross-correlation (N + M - 1,) of (N,) and (M,), shifted by 1 - M on; scipy.signal takes 1 s to import."""
    size = one.size + other.size - 1
    padded = 1 << (size - 1).bit_length()
    product = np.fft.rfft(one, padded) * np.fft.rfft(other, padded).conj()
    return np.roll(np.fft.irfft(product, padded), other.size - 1)[:size]


def _one_peak(offsets: Floats, correlation: Floats, absolute: bool, path: Path) -> float:
    """Offset of the highest peak; of several as high, that nearest 0 if both clocks count from 1970."""
    best = int(correlation.argmax())
    high = correlation > AMBIGUOUS * correlation[best]
    starts = np.flatnonzero(high & ~np.concatenate([[False], high[:-1]]))
    ends = np.flatnonzero(high & ~np.concatenate([high[1:], [False]]))
    peaks = [a + int(correlation[a : b + 1].argmax()) for a, b in zip(starts, ends, strict=True)]
    if len(peaks) > 1 and not absolute:
        pair = f"{offsets[peaks[0]]:.1f} and {offsets[peaks[1]]:.1f} s"
        raise ConfigError(f"{path}: its clock fits the recording's at offsets of {pair}: press with uneven pauses")
    return float(offsets[min(peaks, key=lambda each: abs(offsets[each])) if absolute else best])


def _opened(log: Reference) -> Reference:
    """What a loop adds to the log's values, of each of LOOPS (2, T'), at MAX_LOOP_SAMPLES times at most."""
    pieces = np.array_split(np.arange(log.times.size), min(log.times.size, MAX_LOOP_SAMPLES))
    times, values = (np.array([each[piece].mean() for piece in pieces]) for each in (log.times, log.values))
    plays = Plays(np.array(LOOPS), np.array([np.abs(values).max()]))
    narrow, *wide = np.array([plays.follow(values[[n]])[:, 0].copy() for n in range(times.size)]).T
    return replace(log, times=times, values=(narrow - np.array(wide)) / np.abs(log.values).max())


def _model(at: Floats, log: Reference, opened: Reference) -> Floats:
    """What readings at times `at` (T,) of the log's clock are a sum of: a curve of the log, loops, and drift."""
    force = np.interp(at, log.times, log.values) / np.abs(log.values).max()
    hats = [np.interp(force, CURVE_KNOTS, each) for each in np.eye(CURVE_KNOTS.size)]
    loops = [np.interp(at, opened.times, each) for each in opened.values]
    return np.column_stack([*hats, *loops, (at - at[0]) / np.ptp(at)])


def _search(
    times: Floats, signal: Floats, log: Reference, opened: Reference, offsets: Floats
) -> tuple[float, float]:
    """The offset (s) that explains the readings best, from every few of them, and the share that it leaves."""
    every = slice(None, None, max(1, times.size // MAX_LOOP_SAMPLES))
    unexplained = []
    for offset in offsets:
        at = times[every] + offset
        inside = (at >= log.times[0]) & (at <= log.times[-1])
        share = np.inf
        if np.count_nonzero(inside) >= MIN_ROWS:
            model, target = _model(at[inside], log, opened), signal[every][inside]
            share = float((target - model @ np.linalg.lstsq(model, target, rcond=None)[0]).var() / target.var())
        unexplained.append(share)
    return float(offsets[int(np.argmin(unexplained))]), min(unexplained)


def _refine(at: Floats, signal: Floats, log: Reference, opened: Reference) -> tuple[float, float, float]:
    """A step of the offset (s), its standard error, and the correlation with a curve of the log."""
    model = _model(at, log, opened)
    factors = np.linalg.lstsq(model, signal, rcond=None)[0]
    fitted = model @ factors
    slope = np.gradient(model[:, :-1] @ factors[:-1], at)
    slope -= model @ np.linalg.lstsq(model, slope, rcond=None)[0]
    residual = signal - fitted
    block = (np.arange(at.size) * BLOCKS) // at.size
    pull, weight = (np.bincount(block, each) for each in (slope * residual, slope**2))
    step = pull.sum() / max(weight.sum(), 1e-300)
    deviation = np.sqrt(((pull - step * weight) ** 2).sum()) / max(weight.sum(), 1e-300)
    explained = 1 - residual.var() / max(float(signal.var()), 1e-300)
    limit = float(np.median(np.diff(at)))
    return float(np.clip(step, -limit, limit)), float(deviation), float(np.sqrt(max(explained, 0.0)))


def resampled(log: Reference, at: Floats) -> Floats:
    """The log at times `at` (T,) of its own clock, averaged over their spacing where it is finer; NaN outside."""
    width = float(np.median(np.diff(at)))
    if np.median(np.diff(log.times)) < width:
        steps = np.diff(log.times) * (log.values[1:] + log.values[:-1]) / 2
        integral = np.concatenate([[0.0], np.cumsum(steps)])
        ends = np.clip([at - width / 2, at + width / 2], log.times[0], log.times[-1])
        before, after = np.interp(ends, log.times, integral)
        values = (after - before) / np.maximum(ends[1] - ends[0], width / 4)
    else:
        values = np.interp(at, log.times, log.values)
    return np.where((at >= log.times[0]) & (at <= log.times[-1]), values, np.nan)
