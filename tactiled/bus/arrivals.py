"""The well-formed messages of a batch, and which of them can be in one frame; for the assembler."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.batch import Batch
from tactiled.bus.codec import NO_SEQUENCE, Codec, Readings

NOWHERE, UNDIVIDED = np.zeros(0, np.int64), np.full(1, -1)
DESCENTS_PER_SEGMENT = 8  # segments: if descents are rarer, each ends a run, which is faster


class Arrivals(NamedTuple):
    """The messages (n) of a batch that are not malformed, in order."""

    readings: Readings
    now: float | NDArray[np.float64]  # s, arrival of all messages, or of each (n,)
    newest: float | NDArray[np.float64]  # s, the latest arrival up to each message (n,)
    rows: NDArray[np.int64] | None  # (n,) row of each message in the batch; None: 0 to n - 1
    # (n,) the last message before each that cannot be in the same frame: its sequence number differs, or it is of
    # the same group of ordered segments and this one is not behind it; -1: none
    divided: NDArray[np.int64]
    descents: list[int]  # messages whose segment is not behind that of the message before
    times_rise: bool  # the messages' times never step back

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
    if len(readings.times) == 1:
        return Arrivals(readings, came, newest, rows, UNDIVIDED, [], times_rise=True), malformed
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
        divided[down + 1] = down  # may end a run too early, but is found faster
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
