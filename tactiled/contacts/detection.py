"""Where something touches: contacts in a restored image, and the same contact from frame to frame."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

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

    They are looked for in a picture of the surface, each cell of which is one square of a grid, or several of a
    layout that is none.
    """

    def __init__(self, array: Array, cells: Cells) -> None:
        self._cells = cells
        column, row = np.rint((cells.pieces - cells.pieces.min(axis=0)) / cells.side).astype(np.int64).T
        self._cell = np.full(
            (row.max() + 1, column.max() + 1), len(cells.areas)
        )  # of each square; the last is none
        self._cell[row, column] = cells.owner
        away = np.linalg.norm(cells.pieces - cells.positions[cells.owner], axis=1)
        order = np.lexsort((away, cells.owner))
        first = order[np.searchsorted(cells.owner[order], np.arange(len(cells.areas)))]
        self._middle = row[first], column[first]  # of each cell
        self._wide = max(1, round(float(np.sqrt(np.median(cells.areas))) / cells.side))  # squares a cell
        self._near = 2 * round(NEAR * array.pitch / cells.side) + 1

    def __call__(self, image: NDArray[np.float32], noise_kpa: float, faint: bool = False) -> list[Contact]:
        """Contacts of an image (kPa), the strongest first, all with id 0; `noise_kpa` is a cell's.

        With `faint` also those too faint to begin, which one that has begun may have become.
        """
        pressure = np.asarray(image, float).ravel()
        clear, hardly = CLEAR * noise_kpa, HARDLY * noise_kpa
        peak = float(pressure.max(initial=0.0))
        if peak <= (hardly if faint else clear):
            return []
        from scipy.ndimage import maximum_filter  # the first contact imports it, and scikit-image
        from skimage.segmentation import expand_labels

        picture = np.append(pressure, -np.inf)[self._cell]
        highest = maximum_filter(np.maximum(picture, AWAY * peak), self._near)
        parts = _split(picture, picture > hardly, SHARE * highest, np.maximum(hardly, DIP * highest))
        tops = np.full(int(parts.max()) + 1, -np.inf)
        np.maximum.at(tops, parts, picture)
        tops[0] = np.inf
        least = np.where(tops > clear, clear, hardly if faint else np.inf)
        parts[picture <= np.maximum(SHARE * np.maximum(highest, tops[parts]), least[parts])] = 0
        pressed, skirts = parts[self._middle], expand_labels(parts, self._wide)[self._middle]
        found = [
            self._measure(pressure, *(np.flatnonzero(each == n) for each in (pressed, skirts)))
            for n in np.unique(pressed[pressed > 0])
        ]
        return sorted(found, key=lambda contact: -contact.force_n)

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


def _split(picture: Floats, pressed: NDArray[np.bool_], skirt: Floats, dip: Floats) -> Labels:
    """Number the pressed squares by contact: basins round the peaks that a dip or a skirt parts; all others 0."""
    from skimage.measure import label
    from skimage.morphology import local_maxima
    from skimage.segmentation import watershed

    peaks: Labels = label(local_maxima(np.where(pressed, picture, 0.0)) & pressed)
    basins: Labels = watershed(-picture, peaks, connectivity=2, mask=pressed)
    square = np.zeros(int(peaks.max()) + 1, np.int64)  # of each peak
    square[peaks.ravel()] = np.arange(peaks.size)
    into = np.arange(len(square))
    top, skirts, dips = (each.ravel()[square] for each in (picture, skirt, dip))
    for one, other, saddle in _ways(picture, basins):
        low, high = sorted((into[one], into[other]), key=lambda each: (top[each], each))
        parted = top[low] - saddle >= dips[low] or saddle < skirts[low] < top[low]
        if low != high and not parted:
            into[into == low] = high
    return into[basins]


def _ways(picture: Floats, basins: Labels) -> list[tuple[int, int, float]]:
    """Of each two basins that meet the way over the highest saddle, the highest first."""
    sides = [
        (basins[here], basins[there], np.minimum(picture[here], picture[there]))
        for here, there in (
            (np.s_[:, :-1], np.s_[:, 1:]),
            (np.s_[:-1], np.s_[1:]),
            (np.s_[:-1, :-1], np.s_[1:, 1:]),
            (np.s_[:-1, 1:], np.s_[1:, :-1]),
        )
    ]
    one, other, saddle = (np.concatenate([each[n].ravel() for each in sides]) for n in range(3))
    low, high = np.minimum(one, other), np.maximum(one, other)
    meet = np.flatnonzero((low > 0) & (low < high))
    order = meet[np.argsort(-saddle[meet], kind="stable")]
    _, first = np.unique(low[order] * (basins.max() + 1) + high[order], return_index=True)
    kept = order[np.sort(first)]
    return list(zip(low[kept].tolist(), high[kept].tolist(), saddle[kept].tolist(), strict=True))


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
            lone[list(linked)] = False
            lone[:, list(linked.values())] = False
            seen = np.array([each.age <= gone for each in self._tracks])
            linked |= {int(row): int(column) for row, column in np.argwhere(lone & seen)}
        return {row: self._tracks[column] for row, column in linked.items()}
