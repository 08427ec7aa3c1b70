"""Tells systemd how a service is, and that it lives only while each of its threads moves."""

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from tactiled import systemd
from tactiled.live.bus_thread import BACK_OFF_S

HANGS_AFTER_S = 2 * BACK_OFF_S[1]  # the longest wait of a sound thread is that of a bus that is away
LOG = logging.getLogger(__name__)


class Supervised(Protocol):
    """A service, whether its buses are here or elsewhere."""

    @property
    def sensors(self) -> Mapping[str, Any]:
        """Every sensor, with its name and state."""

    def turns(self) -> dict[str, int | None]:
        """Turns by now of every thread that must move; None for one that waits."""


class Watchdog:
    """Looks at the turns of every thread; call `look` about once a second, from a thread that must move, too."""

    def __init__(self, service: Supervised, url: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._service, self._url, self._clock = service, url, clock
        self._turns: dict[str, int | None] = {}  # by thread, when all had last moved
        self._moved_at: float | None = None  # s, by `clock`, the same; None before the first look
        self._logged: list[str] = []  # threads that hang, in the last line of the log

    def look(self) -> None:
        """Send the status, READY at the first call, and WATCHDOG if every thread has moved since it was last sent.

        A thread that waits for work needs not move: a silent bus is no fault.
        """
        turns, now = self._service.turns(), self._clock()
        unmoved = [name for name, count in turns.items() if count is not None and count == self._turns.get(name)]
        states = {"STATUS": self._status()}
        if self._moved_at is None:
            states["READY"] = "1"
        if not unmoved:
            self._turns, self._moved_at = turns, now
            states["WATCHDOG"] = "1"
        elif self._moved_at is not None and (unmoved_s := now - self._moved_at) > HANGS_AFTER_S:
            states["STATUS"] = f"{', '.join(unmoved)}: no turn for {unmoved_s:.0f} s"
            if unmoved != self._logged:
                LOG.error("threads hang: %s: systemd will restart the service (WatchdogSec)", states["STATUS"])
            self._logged = unmoved
        systemd.notify(**states)

    def _status(self) -> str:
        """What `systemctl status` shows."""
        sensors = self._service.sensors.values()
        not_live = [f"{each.name} {state}" for each in sensors if (state := each.state) != "live"]
        return f"{self._url}: {len(sensors) - len(not_live)} of {len(sensors)} sensors live" + "".join(
            f", {each}" for each in not_live
        )
