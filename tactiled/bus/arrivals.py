"""The well-formed messages of a batch; for the assembler."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.batch import Batch
from tactiled.bus.codec import Codec, Readings

NOWHERE = np.zeros(0, np.int64)


class Arrivals(NamedTuple):
    """The messages (n) of a batch that are not malformed, in order."""

    readings: Readings
    now: float | NDArray[np.float64]  # s, arrival of all messages, or of each (n,)
    rows: NDArray[np.int64] | None  # (n,) row of each message in the batch; None: 0 to n - 1

    def row(self, at: int) -> int:
        """Row of message `at` in the batch."""
        return at if self.rows is None else int(self.rows[at])


def moment(values: float | NDArray[np.float64], at: int) -> float:
    """Time (s) of message `at`; `values` is one time for all messages, or one for each."""
    return values if isinstance(values, float) else float(values[at])


def decoded(
    codec: Codec, batch: Batch, now: float | NDArray[np.float64] | None
) -> tuple[Arrivals | None, NDArray[np.int64]]:
    """The well-formed messages of a batch that arrived at `now` (s), and the rows of the malformed ones."""
    try:
        readings = codec.readings(batch)
    except Exception:  # of another package's codec: none of ours raises here
        return None, np.arange(len(batch))
    rows, malformed = None, NOWHERE
    if np.count_nonzero(readings.good) < len(readings.good):
        rows, malformed = np.flatnonzero(readings.good), np.flatnonzero(~readings.good)
        if not rows.size:
            return None, malformed
        readings = _some(readings, rows)
    came = readings.times if now is None else now
    if isinstance(came, np.ndarray) and now is not None and rows is not None:
        came = came[rows]
    return Arrivals(readings, came, rows), malformed


def _some(readings: Readings, rows: NDArray[np.int64]) -> Readings:
    """Some rows of readings."""
    bad = {at: readings.bad[row] for at, row in enumerate(rows.tolist()) if row in readings.bad}
    sequences = None if readings.sequences is None else readings.sequences[rows]
    times, segments, payloads, good, *_ = readings
    return Readings(times[rows], segments[rows], payloads[rows], good[rows], sequences, bad)
