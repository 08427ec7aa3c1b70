"""Where something touches: contacts in a restored image, and the same contact from frame to frame."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from tactiled.geometry import Array, Cells

Floats = NDArray[np.float64]
Labels = NDArray[np.int64]

CLEAR = 5.0  # noise standard deviations from which a contact begins
HARDLY = 3.0  # down to which it may fall and go on; and of a dip that is none by chance
NEAR = 8.0  # pitches within which a peak counts whole, and restoration may ring round it
AWAY = 0.2  # of a peak that counts further off
SHARE = 0.1  # of the highest peak that counts, below which a cell is a skirt or rings
DIP = 0.2  # of the same, that two contacts must dip between them to be two

APART = 3.0  # pitches that a contact may be from where it was, or should be by its speed
STILL = 1.0  # the same of one that has become faint
SWIFT = 100.0  # pitches a second that one may go beyond that where no other is near
TURN = 0.5  # share of a look's surprise that changes the speed
LOST_S = 0.2  # that a contact may be gone and come back
FORBIDDEN = 1e6  # for more than any number of ways within reach add up to


@dataclass(frozen=True, slots=True)
class Contact:
    """One contact; x to the right and y down, in the array's own coordinates."""

    id: int  # the same while it lasts
    x_mm: float  # centre of pressure
    y_mm: float
    force_n: float
    area_mm2: float
    peak_kpa: float
    major_mm: float  # standard deviation of the pressure along its longer axis
    minor_mm: float
    angle_rad: float  # of the longer axis from x towards y, -pi/2 to pi/2


class Finder:
    """Finds the contacts in the restored images of one array, whose surface has these cells.

    Cells are neighbours where they touch, be they a grid's or not.
    """

    def __init__(self, array: Array, cells: Cells) -> None:
        self._cells = cells
        self._beside, self._near = _table(cells, 1.1), _table(cells, 1.5)  # corner to corner, too
        self._steps = round(NEAR * max(1.0, array.pitch / float(np.sqrt(np.median(cells.areas)))))

    def __call__(self, image: NDArray[np.float32], noise_kpa: float, faint: bool = False) -> list[Contact]:
        """Contacts of an image (kPa), the strongest first, all with id 0; `noise_kpa` is a cell's.

        With `faint` also those too faint to begin, which one that has begun may have become.
        """
        pressure = np.asarray(image, float).ravel()
        clear, hardly = CLEAR * noise_kpa, HARDLY * noise_kpa
        peak = float(pressure.max(initial=0.0))
        if peak <= (hardly if faint else clear):
            return []
        highest = np.maximum(pressure, AWAY * peak)
        for _ in range(self._steps):
            highest = highest[self._near].max(axis=0)
        parts = self._split(pressure, pressure > hardly, SHARE * highest, np.maximum(hardly, DIP * highest))
        tops = np.full(int(parts.max()) + 1, -np.inf)
        np.maximum.at(tops, parts, pressure)
        tops[0] = np.inf
        least = np.where(tops > clear, clear, hardly if faint else np.inf)
        parts[pressure <= np.maximum(SHARE * np.maximum(highest, tops[parts]), least[parts])] = 0
        skirts = self._skirted(pressure, parts)
        numbers = np.unique(parts[parts > 0])
        found = [
            self._measure(pressure, *(np.flatnonzero(each == n) for each in (parts, skirts))) for n in numbers
        ]
        return sorted(found, key=lambda contact: -contact.force_n)

    def _split(self, pressure: Floats, pressed: NDArray[np.bool_], skirt: Floats, dip: Floats) -> Labels:
        """Number the pressed cells by contact, from 1 on: basins that a dip or a skirt parts; all others 0."""
        cells = np.flatnonzero(pressed)
        peak = np.arange(len(pressure))
        peak[cells] = _upwards(pressure, self._near[:, cells])
        peak = _ends(peak)
        here, there = np.broadcast_to(cells, self._near[:, cells].shape), self._near[:, cells]
        meet = pressed[there] & (peak[there] != peak[here])
        here, there = here[meet], there[meet]
        ways = _ways(peak[here], peak[there], np.minimum(pressure[here], pressure[there]))
        for low, high in _merged(pressure, skirt, dip, ways):
            peak[low] = high
        parts = np.zeros(len(pressure), np.int64)
        parts[cells] = np.unique(_ends(peak)[cells], return_inverse=True)[1] + 1
        return parts

    def _skirted(self, pressure: Floats, parts: Labels) -> Labels:
        """The same with a skirt one cell wide, each cell of it to the highest that it touches."""
        touched = np.where(parts[self._beside] > 0, pressure[self._beside], -np.inf)
        nearest = self._beside[touched.argmax(axis=0), np.arange(len(parts))]
        return np.where(parts > 0, parts, parts[nearest])

    def _measure(self, pressure: Floats, pressed: Labels, skirt: Labels) -> Contact:
        """Measure a contact: force and place with the skirt round the cells that are clearly pressed."""
        areas = self._cells.areas[skirt]
        force = pressure[skirt] * areas  # kPa mm^2, 1e-3 N
        places = self._cells.positions[skirt]
        weight = np.maximum(force, 0) / np.maximum(force, 0).sum()  # what rings below zero has no place
        centre = weight @ places
        away = places - centre
        within = float(weight @ areas) / 12  # mm^2, of the even pressure inside a square cell
        spread = (weight[:, None] * away).T @ away + within * np.eye(2)
        least, most = np.linalg.eigvalsh(spread)
        angle = 0.5 * np.arctan2(2 * spread[0, 1], spread[0, 0] - spread[1, 1])
        return Contact(
            id=0,
            x_mm=float(centre[0]),
            y_mm=float(centre[1]),
            force_n=float(force.sum()) * 1e-3,
            area_mm2=float(self._cells.areas[pressed].sum()),
            peak_kpa=float(pressure[pressed].max()),
            major_mm=float(np.sqrt(max(most, 0.0))),
            minor_mm=float(np.sqrt(max(least, 0.0))),
            angle_rad=float(angle),
        )


def _table(cells: Cells, reach: float) -> Labels:
    """Give each cell (columns) itself and all whose squares lie within `reach` of their side, padded."""
    pairs = cells.owner[cKDTree(cells.pieces).query_pairs(reach * cells.side, output_type="ndarray")]
    own = np.arange(len(cells.areas))
    links = np.unique(np.concatenate([pairs, pairs[:, ::-1], np.column_stack([own, own])]), axis=0)
    first = np.searchsorted(links[:, 0], own)
    place = np.arange(len(links)) - first[links[:, 0]]
    table = np.broadcast_to(own, (place.max() + 1, len(own))).copy()
    table[place, links[:, 0]] = links[:, 1]
    return table


def _upwards(pressure: Floats, near: Labels) -> Labels:
    """Of the cells near each (columns) the highest; of equal ones one, so that no plain has two ends by chance."""
    rank = np.empty(len(pressure), np.int64)
    rank[np.argsort(pressure, kind="stable")] = np.arange(len(pressure))
    return np.asarray(near[rank[near].argmax(axis=0), np.arange(near.shape[1])])


def _ends(way: Labels) -> Labels:
    """Where each ends that goes from cell to cell by `way`, which ends where it stays."""
    while not np.array_equal(further := way[way], way):
        way = further
    return way


def _ways(one: Labels, other: Labels, saddle: Floats) -> list[tuple[int, int, float]]:
    """Of each two basins that meet the way over the highest saddle, the highest first."""
    order = np.argsort(-saddle, kind="stable")
    low, high = np.minimum(one, other)[order], np.maximum(one, other)[order]
    _, first = np.unique(low * (high.max(initial=0) + 1) + high, return_index=True)
    first.sort()
    return list(zip(low[first].tolist(), high[first].tolist(), saddle[order][first].tolist(), strict=True))


def _merged(
    pressure: Floats, skirt: Floats, dip: Floats, ways: list[tuple[int, int, float]]
) -> Iterator[tuple[int, int]]:
    """Give each peak that neither a dip nor a skirt (kPa, at it) parts from a higher one, and that one."""
    into: dict[int, int] = {}
    for one, other, saddle in ways:
        while one in into:
            one = into[one]
        while other in into:
            other = into[other]
        low, high = (one, other) if (pressure[one], one) < (pressure[other], other) else (other, one)
        parted = pressure[low] - saddle >= dip[low] or saddle < skirt[low] < pressure[low]
        if low != high and not parted:
            into[low] = high
            yield low, high


@dataclass(slots=True)
class _Track:
    """A contact from look to look."""

    id: int
    place: Floats  # (2,) mm, where it was last seen
    speed: Floats  # (2,) mm/s
    age: float = 0.0  # s since then

    def ahead(self) -> Floats:
        """Where it should be now, mm."""
        return self.place + self.speed * self.age if self.age <= LOST_S else self.place

    def move(self, place: Floats) -> None:
        """It is seen again."""
        if self.age > LOST_S:
            self.speed = np.zeros(2)
        elif self.age > 0:
            self.speed = self.speed + TURN * (place - self.ahead()) / self.age
        self.place, self.age = place, 0.0


class Tracker:
    """Gives a contact the same id from look to look.

    Linked are as many as can be within a reach of where they were or should be, by the shortest ways; what is
    left, and alone, over the way that swift ones go. A contact that is gone may come back for LOST_S.
    """

    def __init__(self, pitch: float) -> None:
        """`pitch` (mm) is the array's."""
        self._pitch = pitch
        self._tracks: list[_Track] = []
        self._time = 0.0
        self._next = 1

    @property
    def holds(self) -> bool:
        """Whether there is a contact that may go on."""
        return bool(self._tracks)

    def __call__(self, found: list[Contact], time: float, clear_kpa: float) -> list[Contact]:
        """The contacts of a look at `time` (s), with ids; of those with a peak below `clear_kpa` none begins."""
        gone, self._time = max(0.0, time - self._time), time
        for each in self._tracks:
            each.age += gone
        clear = np.array([contact.peak_kpa > clear_kpa for contact in found], bool)
        places = np.array([(contact.x_mm, contact.y_mm) for contact in found]).reshape(-1, 2)
        linked = self._linked(places, clear, gone)
        named = []
        for number in range(len(found)):
            track = linked.get(number)
            if track is None and clear[number]:
                track = self._begin(places[number])
            if track is not None:
                track.move(places[number])
                named.append(replace(found[number], id=track.id))
        self._tracks = [each for each in self._tracks if each.age < LOST_S]
        return named

    def _begin(self, place: Floats) -> _Track:
        track, self._next = _Track(self._next, place, np.zeros(2)), self._next + 1
        self._tracks.append(track)
        return track

    def _linked(self, places: Floats, clear: NDArray[np.bool_], gone: float) -> dict[int, _Track]:
        """The tracks that these contacts go on, by the contacts' numbers; `gone` (s) since the last look."""
        if not len(places) or not self._tracks:
            return {}
        ways = [[each.place for each in self._tracks], [each.ahead() for each in self._tracks]]
        away = np.linalg.norm(places[:, None] - np.array(ways)[:, None], axis=-1).min(axis=0) / self._pitch
        within = away <= np.where(clear, APART, STILL)[:, None]
        pairs = zip(*linear_sum_assignment(np.where(within, away, FORBIDDEN)), strict=True)
        linked = {int(row): int(column) for row, column in pairs if within[row, column]}
        if gone <= LOST_S:
            swift = (away <= APART + SWIFT * gone) & clear[:, None]
            lone = swift & (swift.sum(axis=0) == 1) & (swift.sum(axis=1, keepdims=True) == 1)
            seen = np.array([each.age <= gone for each in self._tracks])
            linked |= {int(row): int(column) for row, column in np.argwhere(lone & seen)}
        return {row: self._tracks[column] for row, column in linked.items()}
