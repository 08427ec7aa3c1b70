"""The newest image of one sensor, and the listeners that wait for the next."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from tactiled.frames import SensorImage

T = TypeVar("T")


class Publisher(Generic[T]):
    """Calls every listener with each value, on the publisher's thread; any thread may subscribe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: tuple[Callable[[T], None], ...] = ()

    def publish(self, value: T) -> None:
        """Call every listener with `value`."""
        for listener in self._listeners:
            listener(value)

    def subscribe(self, listener: Callable[[T], None]) -> Callable[[], None]:
        """Call `listener` with every value from now on; it must return at once. Returns how to stop it."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

        def unsubscribe() -> None:
            with self._lock:
                self._listeners = tuple(each for each in self._listeners if each is not listener)

        return unsubscribe


class Hub(Publisher[SensorImage]):
    """Holds one image: newest wins, nothing queues."""

    def __init__(self) -> None:
        super().__init__()
        self._newest: SensorImage | None = None

    def latest(self) -> SensorImage | None:
        """Newest image, or None before the first."""
        return self._newest

    def publish(self, image: SensorImage) -> None:
        """Make `image` the newest and call the listeners."""
        self._newest = image
        super().publish(image)
