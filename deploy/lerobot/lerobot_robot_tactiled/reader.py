"""The newest images of sensors, received in a thread of its own."""

import asyncio
import time
from collections import deque
from contextlib import aclosing
from math import inf
from threading import Condition, Thread

from lerobot_robot_tactiled.features import value_names, values
from tactiled.client import Client, Image
from tactiled.errors import TactileError


class Reader:
    """A window of the newest images of each sensor, from now until `stop`; all images are as the first."""

    def __init__(self, client: Client, first: dict[str, Image], frames: int, max_age_s: float) -> None:
        self._client, self._first, self._max_age_s = client, first, max_age_s
        self._names = [name for image in first.values() for name in value_names(image, frames)]
        self._windows: dict[str, deque[Image]] = {sensor: deque(maxlen=frames) for sensor in first}
        self._newest_at = dict.fromkeys(first, -inf)  # time.monotonic() (s) of the newest frames
        self._changed, self._error = Condition(), ""
        self._loop = asyncio.new_event_loop()
        self._task = self._loop.create_task(self._receive())
        self._thread = Thread(target=self._run, name="tactiled", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Receive no more; once."""
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join()
        self._loop.close()

    def read(self, wait_s: float) -> dict[str, float]:
        """The newest windows; TimeoutError if one is not full, or too old, for `wait_s`; else TactileError."""
        with self._changed:
            self._changed.wait_for(lambda: self._error or not self._problems(), wait_s)
            if self._error:
                raise TactileError(self._error)
            if problems := self._problems():
                raise TimeoutError(f"{self._client.url}: {problems}: max_age_s = {self._max_age_s:g}")
            windows = [(list(window), self._age_s(sensor)) for sensor, window in self._windows.items()]
        numbers = (number for images, age_s in windows for number in values(images, age_s))
        return dict(zip(self._names, numbers, strict=True))

    def _age_s(self, sensor: str) -> float:
        return time.monotonic() - self._newest_at[sensor]

    def _problems(self) -> str:
        return "; ".join(
            f"sensor {sensor!r} has {len(window)}/{window.maxlen} frames, the newest "
            + ("of unknown age" if age_s == inf else f"{age_s:.3g} s old")
            for sensor, window in self._windows.items()
            if (age_s := self._age_s(sensor)) > self._max_age_s or len(window) != window.maxlen
        )

    def _take(self, image: Image) -> None:
        """Add an image to its window, which begins again after a pause, or where time steps back."""
        window = self._windows[image.sensor]
        if window and (image.sequence, image.timestamp) == (window[-1].sequence, window[-1].timestamp):
            return  # sent again over a new connection
        if window and not 0 < image.timestamp - window[-1].timestamp <= self._max_age_s:
            window.clear()
        window.append(image)
        age_s = image.status["age_s"] if image.status.get("sequence") == image.sequence else 0.0
        self._newest_at[image.sensor] = time.monotonic() - (inf if age_s is None else age_s)  # None: unknown

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._task)
        except (Exception, asyncio.CancelledError) as error:  # for the thread that reads
            with self._changed:
                self._error = str(error) or repr(error)
                self._changed.notify_all()

    async def _receive(self) -> None:
        async with aclosing(self._client.astream(list(self._first))) as images:
            async for image in images:
                now, before = ((each.unit, each.restored.shape) for each in (image, self._first[image.sensor]))
                if now != before:
                    raise TactileError(f"sensor {image.sensor!r}: images are {now} now, and were {before}")
                with self._changed:
                    self._take(image)
                    self._changed.notify_all()
