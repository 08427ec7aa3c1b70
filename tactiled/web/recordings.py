"""Recordings of the buses over REST: start, stop, list, download, delete, in one folder and nowhere else."""

import re
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Annotated, Any

from fastapi import APIRouter, FastAPI
from fastapi import Path as Part
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from tactiled.bus.record import Recorder, open_tap, record
from tactiled.errors import BusError, TactileError
from tactiled.web import forms
from tactiled.web.problems import Problem

NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,99}\.(log|asc|blf|log\.gz|asc\.gz)$"  # no slash, no other dot
PROBLEM = {"model": forms.Problem, "content": {"application/problem+json": {}}}
GONE: dict[int | str, dict[str, Any]] = {404: PROBLEM | {"description": "no such recording"}}
BUSY: dict[int | str, dict[str, Any]] = {409: PROBLEM | {"description": "it runs, or is there already"}}
NO_BUS: dict[int | str, dict[str, Any]] = {
    404: PROBLEM | {"description": "no such bus"},
    503: PROBLEM | {"description": "the bus cannot be opened, or the file cannot be written"},
}
Name = Annotated[str, Part(pattern=NAME, description="a recording's file name")]


class Start(BaseModel):
    """What to record."""

    bus: str = Field(description="a bus of the configuration")
    name: str | None = Field(None, pattern=NAME, description="file name; made of bus and time if left out")


class Recorded(BaseModel):
    """One recording."""

    name: str
    bytes: int
    running: bool
    bus: str | None = Field(None, description="where it was started since the service was")
    messages: int | None = Field(
        None, description="on the disk so far, where it was started since the service was"
    )
    error: str | None = Field(None, description="why it ended early")


class Listed(BaseModel):
    """Every recording in the folder."""

    recordings: tuple[Recorded, ...]


class _Run:
    """One recording and the thread that reads its bus."""

    def __init__(self, bus: str, settings: Mapping[str, Any], path: Path) -> None:
        self.bus = bus
        self.error: str | None = None
        self._stop = Event()
        self._tap = open_tap(**settings)
        try:
            self.recorder = Recorder(path)
        except TactileError:
            self._tap.close()
            raise
        self._thread = Thread(target=self._work, name=f"record {bus}", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()

    def _work(self) -> None:
        try:
            record(self._tap, self.recorder, self._stop)
        except TactileError as error:
            self.error = str(error)
        finally:
            self._tap.close()


class Recordings:
    """The recordings of a folder, and those that run: one a bus at most."""

    def __init__(self, folder: Path, buses: Mapping[str, Mapping[str, Any]]) -> None:
        self._folder, self._buses = folder, buses
        self._runs: dict[str, _Run] = {}
        self._lock = Lock()

    def listed(self) -> tuple[Recorded, ...]:
        """Every recording, by name; links and files of other kinds are none."""
        with self._lock:
            return tuple(self._told(each) for each in sorted(self._folder.glob("*")) if _is_recording(each))

    def start(self, bus: str, name: str | None) -> Recorded:
        """Start one; Problem where there is no such bus, or one of that bus or name is there."""
        if bus not in self._buses:
            raise Problem(404, f"bus {bus}: no such bus: there are {', '.join(self._buses)}")
        path = self._folder / (name or f"{bus}-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.log")
        with self._lock:
            if any(run.bus == bus and run.running for run in self._runs.values()):
                raise Problem(409, f"bus {bus}: is being recorded already")
            if path.exists() or path.is_symlink():
                raise Problem(409, f"recording {path.name}: is there already")
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._runs[path.name] = _Run(bus, self._buses[bus], path)
            except (BusError, OSError) as error:
                raise Problem(503, str(error)) from error
            return self._told(path)

    def stop(self, name: str) -> Recorded:
        """Stop one; it is whole on the disk when this returns."""
        path = self.path(name)
        with self._lock:
            if name in self._runs:
                self._runs[name].stop()
            return self._told(path)

    def ended(self, name: str) -> Path:
        """Where one is that does not run; Problem where there is none, or it runs."""
        path = self.path(name)
        if name in self._runs and self._runs[name].running:
            raise Problem(409, f"recording {name}: runs: stop it first")
        return path

    def delete(self, name: str) -> None:
        """Delete one that does not run."""
        with self._lock:
            self.ended(name).unlink(missing_ok=True)
            self._runs.pop(name, None)

    def path(self, name: str) -> Path:
        """Where one is; Problem where there is none."""
        path = self._folder / Path(name).name
        if not _is_recording(path):
            raise Problem(404, f"recording {name}: no such recording")
        return path

    def close(self) -> None:
        """Stop all that run."""
        with self._lock:
            for run in self._runs.values():
                run.stop()

    def _told(self, path: Path) -> Recorded:
        run, size = self._runs.get(path.name), path.stat().st_size
        if run is None:
            return Recorded(name=path.name, bytes=size, running=False)
        return Recorded(
            name=path.name,
            bytes=size,
            running=run.running,
            bus=run.bus,
            messages=run.recorder.written,
            error=run.error,
        )


def _is_recording(path: Path) -> bool:
    """A file of a recording's name that is no link out of the folder."""
    return re.fullmatch(NAME, path.name) is not None and path.is_file() and not path.is_symlink()


def make(folder: Path, buses: Mapping[str, Mapping[str, Any]]) -> APIRouter:
    """The routes of a folder and of buses by name, with python-can's settings of each."""
    recordings = Recordings(folder, buses)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        yield
        recordings.close()

    router = APIRouter(
        prefix="/api/v1/recordings",
        tags=["recordings"],
        lifespan=lifespan,
        responses={422: PROBLEM | {"description": "a name that no recording may have"}},
    )

    @router.get("")
    def listed() -> Listed:
        """Every recording in the folder."""
        return Listed(recordings=recordings.listed())

    @router.post("", status_code=201, responses=NO_BUS | BUSY)
    def start(what: Start) -> Recorded:
        """Record a bus from now on."""
        return recordings.start(what.bus, what.name)

    @router.post("/{name}/stop", responses=GONE)
    def stop(name: Name) -> Recorded:
        """End a recording; one that has ended already stays as it is."""
        return recordings.stop(name)

    @router.get("/{name}", response_class=FileResponse, responses=GONE | BUSY)
    def download(name: Name) -> FileResponse:
        """The file of a recording that does not run."""
        return FileResponse(recordings.ended(name), media_type="application/octet-stream", filename=name)

    @router.delete("/{name}", status_code=204, responses=GONE | BUSY)
    def delete(name: Name) -> None:
        """Delete a recording that does not run."""
        recordings.delete(name)

    return router
