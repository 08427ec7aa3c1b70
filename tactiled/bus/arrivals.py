"""The messages of a batch as the assembler takes them: which are sound, and how far they go into one frame."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.batch import Batch
from tactiled.bus.codec import NO_SEQUENCE, Codec, Readings

NOWHERE = np.zeros(0, np.int64)
DESCENTS_PER_SEGMENT = 8  # segments to a descent at least where each may end a run: `python -m tests.study bus`


class Arrivals(NamedTuple):
    """The messages (n) of a batch that are not malformed, in order."""

    readings: Readings
    now: float | NDArray[np.float64]  # s, when all came, or each (n,)
    newest: float | NDArray[np.float64]  # s, the largest of these, so far (n,)
    rows: NDArray[np.int64] | None  # (n,) numbers in the batch; None: their own
    # (n,) the last one before each with which it shares no frame by itself: of another sequence number, or of
    # the same group of ordered segments and not behind it; -1: none
    divided: NDArray[np.int64]
    descents: list[int]  # those of a segment that is not behind the one before
    times_rise: bool  # the messages' times never step back

    def row(self, at: int) -> int:
        """The number of a message in its batch."""
        return at if self.rows is None else int(self.rows[at])


def moment(values: float | NDArray[np.float64], at: int) -> float:
    """One of the times (s) of messages, which may all have the same."""
    return values if isinstance(values, float) else float(values[at])


def decoded(
    codec: Codec, batch: Batch, now: float | NDArray[np.float64] | None
) -> tuple[Arrivals | None, NDArray[np.int64]]:
    """The messages of a batch, come at `now` (s), that are not malformed, and the numbers of the others."""
    try:
        readings = codec.readings(batch)
    except Exception:  # of another package's codec: none of ours raises here
        return None, np.arange(len(batch))
    rows, malformed = None, NOWHERE
    if not np.logical_and.reduce(readings.good):
        rows, malformed = np.flatnonzero(readings.good), np.flatnonzero(~readings.good)
        if not rows.size:
            return None, malformed
        readings = _some(readings, rows)
    came = readings.times if now is None else now
    newest = came
    if isinstance(came, np.ndarray):
        came = came if now is None or rows is None else came[rows]
        newest = np.maximum.accumulate(came)
    divided, descents = _divided(readings, codec)
    times_rise = bool(np.logical_and.reduce(readings.times[1:] >= readings.times[:-1]))
    return Arrivals(readings, came, newest, rows, divided, descents, times_rise), malformed


def _some(readings: Readings, rows: NDArray[np.int64]) -> Readings:
    """Some rows of readings."""
    bad = {at: readings.bad[row] for at, row in enumerate(rows.tolist()) if row in readings.bad}
    sequences = None if readings.sequences is None else readings.sequences[rows]
    times, segments, payloads, good, *_ = readings
    return Readings(times[rows], segments[rows], payloads[rows], good[rows], sequences, bad)


def _divided(readings: Readings, codec: Codec) -> tuple[NDArray[np.int64], list[int]]:
    """`Arrivals.divided` and `descents`."""
    segments, sequences = readings.segments, readings.sequences
    divided = np.full(len(segments), -1)
    down = (segments[1:] <= segments[:-1]).nonzero()[0]
    if 0 < down.size * DESCENTS_PER_SEGMENT <= len(segments):
        divided[down + 1] = down  # ends a run earlier than it must, and costs less to find
    elif down.size:
        groups = (segments // codec.ordered).astype(np.uint16)
        order = np.argsort(groups, kind="stable")
        before, after = order[:-1], order[1:]
        same = (groups[before] == groups[after]) & (segments[before] >= segments[after])
        divided[after[same]] = before[same]
    if codec.modulus is not None and sequences is not None:
        changes = ((sequences[1:] != sequences[:-1]) | (sequences[1:] == NO_SEQUENCE)).nonzero()[0]
        if changes.size:
            divided[changes + 1] = changes
    return divided, (down + 1).tolist()
