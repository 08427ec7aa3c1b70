"""Guided calibrations: one session a sensor, each by one of five ways."""

from threading import Lock
from typing import TYPE_CHECKING

from tactiled.build import make_stack
from tactiled.errors import CalibrationStateError, NoCalibrationError, NotLiveError
from tactiled.guided.cover_procedure import CoverProcedure
from tactiled.guided.gain_procedure import GainProcedure
from tactiled.guided.session import CalibrationSession, Outcome, Procedure, Way

if TYPE_CHECKING:
    from tactiled.live.service import Service

Session = CalibrationSession


class GuidedCalibrations:
    """The sessions of a service's sensors; any thread may call it."""

    def __init__(self, service: "Service") -> None:
        self._service, self._lock = service, Lock()
        self._sessions: dict[str, Session] = {}

    def start(self, name: str, way: Way, size_mm: float | None = None) -> Session:
        """Start a session; NotLiveError or CalibrationStateError where that is not possible."""
        sensor = self._service.sensor(name)
        if (status := sensor.status()).state != "live":
            raise NotLiveError(f"sensor {name!r}: {status.state}, {status.detail}: a calibration needs frames")
        with self._lock:
            if self._open(name):
                raise CalibrationStateError(f"sensor {name!r}: a calibration is open: apply or discard it first")
            procedure: Procedure
            if way == "uniform" or way == "weight":
                procedure = GainProcedure(sensor, way)
            else:
                procedure = CoverProcedure(sensor, make_stack(self._service.config.sensor[name]), way, size_mm)
            self._sessions[name] = session = Session(sensor, procedure)
        self._service.events.add("calibration_started", way, name)
        return session

    def _open(self, name: str) -> Session | None:
        """The session of a sensor that has not ended; one whose client has gone away ends here."""
        for other, each in list(self._sessions.items()):
            if each.sensor is not self._service.sensors.get(other):  # the configuration was reloaded
                self._sessions.pop(other).discard()
                self._service.events.add("calibration_ended", "its sensor has ended: nothing was changed", other)
        session = self._sessions.get(name)
        if session is not None and session.lapsed():
            del self._sessions[name]
            self._service.events.add("calibration_ended", "its client has gone away: nothing was changed", name)
            return None
        return None if session is None or session.state == "ended" else session

    def way(self, name: str) -> Way | None:
        """Way of the open session of a sensor; None where there is none."""
        with self._lock:
            session = self._open(name)
        return session.procedure.way if session else None

    def session(self, name: str) -> Session:
        """The open session of a sensor; NoCalibrationError where there is none."""
        self._service.sensor(name)
        with self._lock:
            session = self._open(name)
        if session is None:
            raise NoCalibrationError(f"sensor {name!r}: no calibration is open")
        session.touch()
        return session

    def apply(self, name: str) -> None:
        """Apply the outcome of a sensor's session from the next frame on, and end the session."""

        def apply(outcome: Outcome) -> None:
            if outcome.file is None:
                raise CalibrationStateError(f"sensor {name!r}: apply: the frames cannot tell the thickness")
            self._service.apply_calibration(name, outcome.file)

        self.session(name).apply(apply)
        self._ended(name, "applied")

    def discard(self, name: str) -> None:
        """End a sensor's session without a change."""
        if not self.session(name).discard():  # it was applied meanwhile
            raise NoCalibrationError(f"sensor {name!r}: no calibration is open")
        self._ended(name, "discarded: nothing was changed")

    def _ended(self, name: str, text: str) -> None:
        with self._lock:
            self._sessions.pop(name, None)
        self._service.events.add("calibration_ended", text, name)

    def close(self) -> None:
        """End every session without a change."""
        with self._lock:
            for session in self._sessions.values():
                session.discard()
            self._sessions.clear()
