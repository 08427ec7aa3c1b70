"""Recordings of the buses over REST: start, stop, list, download, delete, in one folder and nowhere else."""

import re
import stat
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Annotated, Any

from fastapi import APIRouter, FastAPI, Query
from fastapi import Path as Part
from fastapi.responses import FileResponse
from pydantic import Field

from tactiled.bus.reader import open_bus
from tactiled.bus.recorder import Recorder, record
from tactiled.errors import TactileError
from tactiled.runtime.events import Events
from tactiled.web import schemas
from tactiled.web.http.problems import Problem
from tactiled.web.rest.common import BODY, CONTROL, WRONG, Responses, documented, problem

NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,99}\.(log|asc|blf|log\.gz|asc\.gz)$"  # no slash, no other dot
GONE: Responses = {404: problem("no such recording", "recording grasp.log: no such recording")}
RUNS: Responses = {409: problem("it runs", "recording grasp.log: runs: stop it first")}
STARTED: Responses = {
    404: problem("no such bus", "bus can9: no such bus: there are can0"),
    409: problem(
        "that bus is being recorded, the name is there already, or no bus is open, as in a replay",
        "bus can0: is being recorded already",
    ),
    503: problem(
        "the bus cannot be opened, the file cannot be written, or too little room is left",
        "recording grasp.log: less than 1000 MB of its disk are free (recordings_leave_mb)",
    ),
}
BYTES = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
PART: Responses = {
    200: {"description": "the whole file", "content": BYTES},
    206: {
        "description": "the part of it that Range asks for; of several parts multipart/byteranges",
        "content": BYTES,
        "headers": documented({"Content-Range": "which bytes of how many"}),
    },
    416: {"description": "Range begins after the end", "headers": documented({"Content-Range": "its length"})},
}
Name = Annotated[str, Part(pattern=NAME, description="a recording's file name")]


class Start(schemas.Asked):
    """What to record."""

    bus: str = Field(description="a bus of the configuration", examples=["can0"])
    name: str | None = Field(
        None, pattern=NAME, description="file name; made of bus and time if left out", examples=["grasp.log"]
    )


class Recorded(schemas.Form):
    """One recording."""

    name: str = Field(examples=["grasp.log"])
    bytes: int | None = Field(
        description="null: it ran, and its file was removed or has another name by now", examples=[48231]
    )
    running: bool = Field(examples=[True])
    bus: str | None = Field(None, description="where it was started since the service was", examples=["can0"])
    messages: int | None = Field(
        None, description="on the disk so far, where it was started since the service was", examples=[1025]
    )
    unreadable: int | None = Field(
        None, description="messages that the interface could not decode, which are not in the file", examples=[0]
    )
    error: str | None = Field(None, description="why it ended early", examples=[None])


class Listed(schemas.Form):
    """Recordings in the folder, by name."""

    recordings: tuple[Recorded, ...]
    after: str | None = Field(description="ask for these next; null: there are no more", examples=[None])


After = Annotated[str | None, Query(max_length=120, description="only names after this one")]
Limit = Annotated[int, Query(ge=1, le=1000, description="recordings in one answer")]


class _Run:
    """One recording and the thread that reads its bus."""

    def __init__(self, bus: str, settings: Mapping[str, Any], path: Path, events: Events, leave_mb: float) -> None:
        self.bus, self._name, self._events = bus, path.name, events
        self.error: str | None = None
        self._stop = Event()
        self._reader = open_bus(**settings)
        try:
            self.recorder = Recorder(path, leave_mb=leave_mb)
        except TactileError:
            self._reader.close()
            raise
        self._thread = Thread(target=self._work, name=f"record {bus}", daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    @property
    def unreadable(self) -> int:
        return self._reader.unreadable

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()

    def _work(self) -> None:
        try:
            record(self._reader, self.recorder, self._stop)
        except TactileError as error:
            self.error = str(error).replace(f"{self.recorder.path}: ", "")  # whose name is told beside it
        finally:
            self._reader.close()
            missed = f", and {self.unreadable} that could not be decoded" if self.unreadable else ""
            ending = (self.error or f"{self.recorder.written} messages") + missed
            self._events.add("recording_ended", f"{self._name}: {ending}", bus=self.bus)


class Recordings:
    """The recordings of a folder, and those that run: one a bus at most."""

    def __init__(
        self, folder: Path, buses: Mapping[str, Mapping[str, Any]], events: Events, leave_mb: float
    ) -> None:
        self._folder, self._buses, self._events, self._leave_mb = folder, buses, events, leave_mb
        self._runs: dict[str, _Run] = {}
        self._lock = Lock()

    def listed(self, after: str | None, limit: int) -> Listed:
        """The first `limit` recordings behind `after`, by name; links and files of other kinds are none.

        One that runs is listed, whatever became of its file.
        """
        with self._lock:
            runs = {name for name, run in self._runs.items() if run.running}
            names = runs | {each.name for each in self._folder.glob("*") if _is_recording(each)}
            found = [self._folder / name for name in sorted(names) if after is None or name > after]
            page = tuple(self._told(path) for path in found[:limit])
        return Listed(recordings=page, after=page[-1].name if len(found) > limit else None)

    def start(self, bus: str, name: str | None) -> Recorded:
        """Start one; Problem where there is no such bus or none at all, or one of that bus or name is there."""
        if not self._buses:
            raise Problem(409, f"bus {bus}: is not open: this service replays a recording")
        if bus not in self._buses:
            raise Problem(404, f"bus {bus}: no such bus: there are {', '.join(self._buses)}")
        path = self._folder / (name or f"{bus}-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.log")
        with self._lock:
            if any(run.bus == bus and run.running for run in self._runs.values()):
                raise Problem(409, f"bus {bus}: is being recorded already")
            self._need_ended(path.name)
            if _is_recording(path):
                raise Problem(409, f"recording {path.name}: is there already")
            if path.exists() or path.is_symlink():
                raise Problem(409, f"recording {path.name}: something else of that name is in the folder")
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._runs[path.name] = _Run(bus, self._buses[bus], path, self._events, self._leave_mb)
            except TactileError as error:
                raise Problem(503, str(error).replace(str(path), f"recording {path.name}")) from error
            except OSError as error:
                raise Problem(503, f"recording {path.name}: {error.strerror}") from error
            self._events.add("recording_started", path.name, bus=bus)
            return self._told(path)

    def stop(self, name: str) -> Recorded:
        """Stop one, whatever became of its file; it is whole on the disk when this returns."""
        with self._lock:
            if name in self._runs:
                self._runs[name].stop()
            else:
                self.path(name)
            return self._told(self._folder / name)

    def ended(self, name: str) -> Path:
        """Where one is that does not run; Problem where it runs, whatever became of its file, or there is none."""
        self._need_ended(name)
        return self.path(name)

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

    def _need_ended(self, name: str) -> None:
        """Problem where one runs, whatever became of its file."""
        if (run := self._runs.get(name)) and run.running:
            raise Problem(409, f"recording {name}: runs: stop it first")

    def _told(self, path: Path) -> Recorded:
        run = self._runs.get(path.name)
        if run is None:
            return Recorded(name=path.name, bytes=_bytes(path), running=False)
        running, size = run.running, _bytes(path)  # in this order: it grows until it has ended
        return Recorded(
            name=path.name,
            bytes=size,
            running=running,
            bus=run.bus,
            messages=run.recorder.written,
            unreadable=run.unreadable,
            error=run.error,
        )


def _is_recording(path: Path) -> bool:
    """A file of a recording's name that is no link out of the folder."""
    return re.fullmatch(NAME, path.name) is not None and _bytes(path) is not None


def _bytes(path: Path) -> int | None:
    """The size of a file; None where there is none, or a link."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_size if stat.S_ISREG(found.st_mode) else None


def make(folder: Path, buses: Mapping[str, Mapping[str, Any]], events: Events, leave_mb: float = 0.0) -> APIRouter:
    """The routes of a folder and of buses by name, with python-can's settings of each; of none in a replay."""
    recordings = Recordings(folder, buses, events, leave_mb)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        yield
        recordings.close()

    router = APIRouter(
        prefix="/api/v1/recordings",
        tags=["recordings"],
        lifespan=lifespan,
        responses=WRONG,
    )

    @router.get("")
    def listed(after: After = None, limit: Limit = 100) -> Listed:
        """The recordings in the folder, sorted by name, in pages."""
        return recordings.listed(after, limit)

    @router.post("", status_code=201, responses=STARTED | CONTROL | BODY)
    def start(what: Start) -> Recorded:
        """Start to record a bus."""
        return recordings.start(what.bus, what.name)

    @router.post("/{name}/stop", responses=GONE | CONTROL)
    def stop(name: Name) -> Recorded:
        """Stop a recording; its file is complete when the answer comes."""
        return recordings.stop(name)

    @router.get("/{name}", response_class=FileResponse, responses=GONE | RUNS | PART)
    def download(name: Name) -> FileResponse:
        """The file of a recording that does not run, or a `Range` of it."""
        return FileResponse(recordings.ended(name), media_type="application/octet-stream", filename=name)

    @router.delete("/{name}", status_code=204, responses=GONE | RUNS | CONTROL)
    def delete(name: Name) -> None:
        """Delete a recording that does not run."""
        recordings.delete(name)

    return router
