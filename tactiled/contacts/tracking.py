"""The same contact from image to image."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from tactiled.arrays import Floats, Mask
from tactiled.contacts.detection import DetectedContact

MAX_STEP_PITCHES = 3.0  # from where a contact was, or should be by its speed
MAX_FAINT_STEP_PITCHES = 1.0  # the same if it has become faint
MAX_LONE_SPEED = 100.0  # pitches a second by which a contact may go further if no other is near
SPEED_GAIN = 0.5  # share of the difference from the predicted place that changes the speed
CHANGE_PITCHES = 0.5  # a link counts as longer by, for each factor e of area: a ring is not what it surrounds
GONE_AFTER_S = 0.2  # until then a contact may come back,
GONE_AFTER_IMAGES, MAX_GONE_S = 3, 1.0  # or in so many images within this: they may come slowly
FORBIDDEN = 1e6  # cost of a link: more than any number of links within reach


@dataclass(slots=True)
class _Track:
    """A contact from image to image."""

    id: int
    place: Floats  # (2,) mm, in the last image that had it
    speed: Floats  # (2,) mm/s
    area: float  # mm2
    age: float = 0.0  # s since then
    missed: int = 0  # images since then

    @property
    def gone(self) -> bool:
        """Whether it does not come back."""
        return self.age >= (MAX_GONE_S if self.missed <= GONE_AFTER_IMAGES else GONE_AFTER_S)

    def predicted(self) -> Floats:
        """Where it should be now, mm."""
        return self.place + self.speed * self.age if self.age <= GONE_AFTER_S else self.place

    def move(self, place: Floats, area: float) -> None:
        """It is at a place (mm) now, with an area (mm2)."""
        if self.age > GONE_AFTER_S:
            self.speed = np.zeros(2)
        elif self.age > 0:
            self.speed = self.speed + SPEED_GAIN * (place - self.predicted()) / self.age
        self.place, self.area, self.age, self.missed = place, area, 0.0, 0


class Tracker:
    """Gives a contact the same id from image to image.

    It links as many as it can within a reach of where they were or should be, by the shortest ways and the least
    changes of area; then the others, if they are alone, over the way that swift ones go.
    """

    def __init__(self, pitch_mm: float) -> None:
        self._pitch = pitch_mm
        self._tracks: list[_Track] = []
        self._time = 0.0
        self._next_id = 1

    @property
    def holds(self) -> bool:
        """Whether there is a contact that may go on."""
        return bool(self._tracks)

    def __call__(self, contacts: list[DetectedContact], time: float, begin: float) -> list[DetectedContact]:
        """The contacts of an image at `time` (s), with ids; of those with a peak below `begin` none begins."""
        elapsed, self._time = max(0.0, time - self._time), time
        for each in self._tracks:
            each.age, each.missed = each.age + elapsed, each.missed + 1
        self._tracks = [each for each in self._tracks if each.missed == 1 or not each.gone]
        clear = np.array([each.peak > begin for each in contacts], bool)
        places = np.array([(each.x_mm, each.y_mm) for each in contacts]).reshape(-1, 2)
        areas = np.array([each.area_mm2 for each in contacts])
        links = self._links(places, areas, clear, elapsed)
        named = []
        for number, contact in enumerate(contacts):
            track = links.get(number)
            if track is None and clear[number]:
                track = self._begin(places[number], contact.area_mm2)
            if track is not None:
                track.move(places[number], contact.area_mm2)
                named.append(replace(contact, id=track.id))
        self._tracks = [each for each in self._tracks if not each.gone]
        return named

    def _begin(self, place: Floats, area: float) -> _Track:
        track, self._next_id = _Track(self._next_id, place, np.zeros(2), area), self._next_id + 1
        self._tracks.append(track)
        return track

    def _links(self, places: Floats, areas: Floats, clear: Mask, elapsed: float) -> dict[int, _Track]:
        """The tracks that these contacts go on, by the contacts' numbers; `elapsed` (s) since the last image."""
        if not len(places) or not self._tracks:
            return {}
        ends = np.array([[each.place for each in self._tracks], [each.predicted() for each in self._tracks]])
        distance = np.linalg.norm(places[:, None] - ends[:, None], axis=-1).min(axis=0) / self._pitch
        within = distance <= np.where(clear, MAX_STEP_PITCHES, MAX_FAINT_STEP_PITCHES)[:, None]
        change = np.abs(np.log(areas[:, None] / np.array([each.area for each in self._tracks])))
        costs = np.where(within, distance + CHANGE_PITCHES * change, FORBIDDEN)
        pairs = zip(*linear_sum_assignment(costs), strict=True)
        links = {int(row): int(column) for row, column in pairs if within[row, column]}
        if elapsed <= GONE_AFTER_S:
            swift = (distance <= MAX_STEP_PITCHES + MAX_LONE_SPEED * elapsed) & clear[:, None]
            lone = swift & (swift.sum(axis=0) == 1) & (swift.sum(axis=1, keepdims=True) == 1)
            lone[list(links)] = False
            lone[:, list(links.values())] = False
            in_last_image = np.array([each.age <= elapsed for each in self._tracks])
            links |= {int(row): int(column) for row, column in np.argwhere(lone & in_last_image)}
        return {row: self._tracks[column] for row, column in links.items()}
