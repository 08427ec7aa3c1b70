"""The contacts in a sensor's newest image, looked for and tracked at a steady pace while anybody asks for them."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from tactiled.arrays import Floats32
from tactiled.contacts.detection import BEGIN_SIGMAS, DetectedContact, Finder
from tactiled.contacts.tracking import Tracker
from tactiled.frames import SensorImage
from tactiled.geometry import Array, Raster
from tactiled.live.hub import Hub
from tactiled.threads import Worker

Deviation = Callable[[SensorImage], Floats32]

LOOK_S = 0.05  # from one look to the next
ASKED_S = 5.0  # looks go on for so long after a request


class ImageContacts:
    """Finds the contacts in the images of one array, one after the other, and tracks them.

    `deviation` gives that of an image's cells, in its unit; without it the forces' deviations are unknown.
    """

    def __init__(self, array: Array, cells: Raster, deviation: Deviation | None = None) -> None:
        self._finder, self._tracker = Finder(array, cells), Tracker(array.pitch)
        self._deviation = deviation

    def __call__(self, image: SensorImage, time_s: float) -> tuple[DetectedContact, ...]:
        """Contacts of one image; `time_s` on a clock that is the same for all of them."""
        noise = image.cell_noise
        find, holds = self._finder, self._tracker.holds
        spread = partial(self._deviation, image) if self._deviation else None
        raw = image.method == "raw"
        contacts = find(image.restored, noise, image.unit, holds, image.shares, find.parts, spread, raw)
        return tuple(self._tracker(contacts, time_s, BEGIN_SIGMAS * noise))


class ContactSearch(Worker):
    """Looks for contacts on request, and in between on its own thread, so that none is lost between requests."""

    def __init__(
        self, name: str, hub: Hub, array: Array, cells: Raster, deviation: Deviation | None = None
    ) -> None:
        super().__init__(f"contacts {name}", self._work)
        self._hub = hub
        self._find = ImageContacts(array, cells, deviation)
        self._looking = threading.Lock()
        self._image: SensorImage | None = None  # the one last looked at
        self._contacts: tuple[DetectedContact, ...] = ()
        self._due = self._until = 0.0  # s, monotonic: of the next look, and to which looks go on

    def contacts(self) -> tuple[SensorImage | None, tuple[DetectedContact, ...]]:
        """The newest image and the contacts in it; any thread."""
        with self._wake:
            self._until = time.monotonic() + ASKED_S
            self._wake.notify()
        return self._look()

    def _look(self) -> tuple[SensorImage | None, tuple[DetectedContact, ...]]:
        with self._looking:
            self._due = time.monotonic() + LOOK_S
            image = self._hub.latest()
            if image is not None and image is not self._image:
                self._contacts = self._find(image, image.arrived)
                self._image = image
            return image, self._contacts

    def _work(self) -> None:
        while self._wait():
            with suppress(Exception):  # the next request raises the same error
                self._look()

    def _wait(self) -> bool:
        """Wait until a look is due; False at the end."""
        with self._wake:
            while not self._stopping:
                now = time.monotonic()
                if self._due <= now < self._until:
                    return True
                self._wake.wait(self._due - now if now < self._until else None)
        return False
