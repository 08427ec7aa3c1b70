"""The newest image of one sensor, and whoever wants to hear of the next."""

import threading
from collections.abc import Callable

from tactiled.frames import Image


class Hub:
    """Holds one image: newest wins, nothing queues. Any thread may call it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: Image | None = None
        self._listeners: tuple[Callable[[Image], None], ...] = ()

    def latest(self) -> Image | None:
        """Newest image, or None before the first."""
        return self._newest

    def publish(self, image: Image) -> None:
        """Make `image` the newest and tell the listeners, on the caller's thread."""
        self._newest = image
        for listener in self._listeners:
            listener(image)

    def subscribe(self, listener: Callable[[Image], None]) -> Callable[[], None]:
        """Call `listener` with every image from now on; it must return at once. Returns how to stop it."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

        def unsubscribe() -> None:
            with self._lock:
                self._listeners = tuple(each for each in self._listeners if each is not listener)

        return unsubscribe
