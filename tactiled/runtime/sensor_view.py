"""What the web reads of a sensor and of a service, whether their buses are here or elsewhere."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.contacts.detection import Contact
from tactiled.frames import Image
from tactiled.geometry import Array
from tactiled.runtime.events import Events, Faults
from tactiled.runtime.history import History
from tactiled.runtime.hub import Hub
from tactiled.runtime.sensor import State, Status
from tactiled.runtime.timings import Timings
from tactiled.units import Unit


class PlanView(Protocol):
    """How a sensor is made."""

    @property
    def name(self) -> str:
        """As in the configuration, or `robot/sensor`."""

    @property
    def bus(self) -> str:
        """That it is on."""

    @property
    def codec_name(self) -> str:
        """Of its skin."""

    @property
    def shears(self) -> bool:
        """Whether the skin feels shear."""

    @property
    def unit(self) -> Unit:
        """Of its pressures."""


class SensorView(Protocol):
    """Images and health of a sensor, one of `runtime.sensor` or one whose reader is elsewhere."""

    name: str
    array: Array
    hub: Hub
    history: History
    timings: Timings

    @property
    def plan(self) -> PlanView:
        """How it is made."""

    @property
    def method(self) -> str:
        """Name of the method that is set."""

    @property
    def state(self) -> State:
        """State of `status`, at less cost."""

    @property
    def clock(self) -> str | None:
        """What gives the frames' times; None before the bus was first open."""

    @property
    def references(self) -> list[float | None] | None:
        """Counts of the newest frame's pads that feel no pressure; None: it has none."""

    def note_send(self, image: Image) -> None:
        """A client is sent an image now."""

    def status(self) -> Status:
        """Health at this moment."""

    def need_shear(self) -> None:
        """NoShearError where its skin feels none."""

    def contacts(self) -> tuple[Image | None, tuple[Contact, ...]]:
        """The newest image and the contacts in it."""

    def deviation(self, image: Image) -> NDArray[np.float32]:
        """Standard deviation of every cell of the newest restored image, in its unit."""


class ServiceView(Protocol):
    """Sensors by name, and what happens to them."""

    events: Events
    faults: Faults

    @property
    def sensors(self) -> Mapping[str, SensorView]:
        """Every sensor; another mapping where one comes or goes."""

    def sensor(self, name: str) -> SensorView:
        """The sensor of that name; UnknownSensorError if there is none."""

    def turns(self) -> dict[str, int | None]:
        """Turns by now of every thread that must move; None for one that waits."""
