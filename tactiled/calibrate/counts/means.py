"""Mean counts of each taxel over pieces of a recording, above the counts of the unloaded taxel at that time."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from warnings import catch_warnings, simplefilter

import numpy as np

from tactiled.arrays import Floats, Floats32, Mask
from tactiled.calibrate.counts.plateaus import START_FRAMES, noise
from tactiled.errors import ConfigError
from tactiled.frames import FrameSeries

MIN_RESPONSE_SIGMAS = 20.0  # of the median taxel's largest mean: less leaves over 5 % of error
DEAD_BELOW = 0.05  # of the median taxel's response
LOADED_START = 0.1  # of a typical response: a taxel that reads so much higher at the start was loaded
TYPICAL_PERCENTILE = 98.0  # of the taxels' responses: those over half of it are typical of pressed ones
MAX_LOADED_TAXELS = 0.01  # of all: more are no faults
MAX_SATURATED = 0.2  # of the readings above half the largest


@dataclass(frozen=True, slots=True)
class Rails:
    """Counts at which a taxel saturates."""

    low: float = -np.inf  # where counts fall under pressure
    high: float = np.inf  # where they rise
    sign: float = 0.0  # -1: they fall, 1: they rise, 0: not known before

    @classmethod
    def of(cls, saturation: float | None, ends: tuple[float, float], sign: float = 0.0) -> "Rails":
        """As configured, else the codec's ends."""
        low, high = ends if saturation is None else (saturation, saturation)
        return cls(low, high, sign)


@contextmanager
def unknown_taxels() -> Iterator[None]:
    """Without numpy's warnings about taxels that are always NaN, as silent ones are."""
    with catch_warnings():
        simplefilter("ignore", RuntimeWarning)
        yield


@dataclass(frozen=True, slots=True, eq=False)
class Means:
    """Mean counts over M pieces of a recording."""

    over: Floats  # (M, N) counts over no load, upwards under pressure; NaN: unknown or saturated
    no_load: Floats  # (N,) counts where the recording starts
    sign: float  # -1 where counts fall under pressure
    noise: Floats  # (M, N) standard deviation of the means, by the frames' noise
    no_load_noise: Floats  # (N,) likewise of what was taken off them
    drift: Floats  # (M, N) counts by which no load had moved upwards since the start, taken off them


def mean_counts(series: FrameSeries, pieces: Sequence[slice], unloaded: Mask, sign: float, rails: Rails) -> Means:
    """Means over `pieces` (M); the `unloaded` (M,) among them say what no load is, interpolated in time.

    ConfigError where the array is loaded at the start, or too much is saturated.
    """
    means, frames = _means(series.counts, pieces, rails.high if sign > 0 else rails.low, sign)
    at = np.array([series.times[each].mean() for each in pieces])
    runs = np.cumsum(np.diff(unloaded, prepend=False) & unloaded)[unloaded] - 1
    zeros = np.stack([np.nanmean(means[unloaded][runs == each], axis=0) for each in np.unique(runs)])
    zeros = np.where(np.isfinite(zeros), zeros, np.nanmean(zeros, axis=0))
    place = np.interp(at, [at[unloaded][runs == each].mean() for each in np.unique(runs)], np.arange(len(zeros)))
    first = np.minimum(place.astype(int), max(len(zeros) - 2, 0))
    share, last = (place - first)[:, None], np.minimum(first + 1, len(zeros) - 1)
    no_load = (1 - share) * zeros[first] + share * zeros[last]
    over = sign * (means - no_load)
    top = np.nanmax(over, axis=0)
    typical = np.median(top[top > np.nanpercentile(top, TYPICAL_PERCENTILE) / 2])
    _require_unloaded_start(sign * (zeros[0] - zeros), top, typical)
    alive = np.isfinite(zeros).any(axis=0)  # a taxel that is at its rail unloaded, too, is broken, not saturated
    saturated = np.count_nonzero(np.isnan(over[~unloaded]) & (frames[~unloaded] > 0) & alive)
    pressed = np.count_nonzero(over > typical / 2)
    if saturated > MAX_SATURATED * (saturated + pressed):
        share = 100 * saturated / (saturated + pressed)
        raise ConfigError(f"{share:.0f} % of the readings under load are saturated: press less")
    sigma = np.maximum(noise(series.counts), 12**-0.5)
    deviation = sigma / np.sqrt(np.maximum(frames, 1))
    parts = ((1 - share) ** 2 + share**2)[~unloaded].mean() / np.bincount(runs).mean()
    no_load_noise = np.median(deviation[unloaded], axis=0) * np.sqrt(parts)
    return Means(over, zeros[0], sign, deviation, no_load_noise, sign * (no_load - zeros[0]))


def require_response(what: str, over: Floats, sigma: Floats) -> None:
    """ConfigError where the largest mean of `over` (M, N), in the median, is not far above the noise (M, N)."""
    ratio = float(np.nanmedian(np.nanmax(over / sigma, axis=0)))
    if not ratio > MIN_RESPONSE_SIGMAS:
        raise ConfigError(
            f"{what} reads {max(ratio, 0):.2g} times its noise under the largest load: press more, or hold longer"
        )


def require_unsaturated(series: FrameSeries, signal: Floats, rails: Rails) -> None:
    """ConfigError where many readings saturate while `signal` (T,) is large: their levels cannot be told apart."""
    loaded = np.abs(signal) > np.abs(signal).max() / 2
    sign = float(np.sign(signal[loaded].sum()))
    full = sign * (series.counts - (rails.high if sign > 0 else rails.low)) >= 0
    share = float(full[loaded][:, ~full[:START_FRAMES].all(axis=0)].mean())
    if share > MAX_SATURATED:
        raise ConfigError(f"{100 * share:.0f} % of the readings under load are saturated: press less")


def _means(counts: Floats32, pieces: Sequence[slice], rail: float, sign: float) -> tuple[Floats, Floats]:
    """Means (M, N), NaN where a taxel saturates or is unknown, and their numbers of known frames (M, N)."""
    means, frames = np.empty((2, len(pieces), counts.shape[1]))
    for n, piece in enumerate(pieces):
        part = counts[piece]
        finite = np.isfinite(part)
        frames[n] = finite.sum(axis=0)
        with np.errstate(invalid="ignore"):
            means[n] = np.where(finite, part, 0).sum(axis=0, dtype=np.float64) / frames[n]
            means[n, (sign * (part - rail) >= 0).any(axis=0)] = np.nan
    return means, frames


def _require_unloaded_start(above: Floats, top: Floats, typical: float) -> None:
    """ConfigError where taxels start `above` (runs, N) what they read unloaded; `top` (N,): their largest."""
    loaded = np.count_nonzero(above.max(axis=0) > LOADED_START * typical)
    if loaded > max(1, MAX_LOADED_TAXELS * top.size) or loaded == top.size:
        raise ConfigError(
            f"the recording starts loaded: {loaded} of {top.size} taxels read higher there than unloaded later: "
            "start with nothing on the array"
        )
