"""What the web needs of a service and a sensor, whose bus is here or elsewhere; `live` describes each member."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tactiled.contacts.detection import DetectedContact
from tactiled.frames import SensorImage
from tactiled.geometry import Array, Raster
from tactiled.live.events import Events, Faults
from tactiled.live.history import History
from tactiled.live.hub import Hub
from tactiled.live.status import State, Status
from tactiled.live.timings import Timings
from tactiled.units import Unit


class PlanView(Protocol):
    """What the answers need of how a sensor is made."""

    @property
    def name(self) -> str: ...
    @property
    def bus(self) -> str: ...
    @property
    def codec_name(self) -> str: ...
    @property
    def shears(self) -> bool: ...
    @property
    def restores_shear(self) -> bool: ...
    @property
    def unit(self) -> Unit: ...


class SensorView(Protocol):
    """What the answers need of a sensor."""

    name: str
    hub: Hub
    history: History
    timings: Timings

    @property
    def array(self) -> Array: ...
    @property
    def cells(self) -> Raster: ...
    @property
    def areas_mm2(self) -> tuple[float, ...] | None: ...
    @property
    def plan(self) -> PlanView: ...
    @property
    def method(self) -> str: ...
    @property
    def clock(self) -> str | None: ...
    @property
    def references(self) -> list[float | None] | None: ...
    @property
    def state(self) -> State: ...
    def status(self) -> Status: ...
    def contacts(self) -> tuple[SensorImage | None, tuple[DetectedContact, ...]]: ...
    def deviation(self, image: SensorImage) -> NDArray[np.float32]: ...
    def need_shear(self) -> None: ...
    def need_traction(self) -> None: ...
    def note_send(self, image: SensorImage) -> None: ...


class ServiceView(Protocol):
    """What the web needs of a service."""

    faults: Faults
    events: Events

    @property
    def sensors(self) -> Mapping[str, SensorView]: ...
    def sensor(self, name: str) -> SensorView: ...
    def turns(self) -> dict[str, int | None]: ...
