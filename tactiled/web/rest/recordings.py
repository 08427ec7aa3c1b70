"""`/api/v1/recordings`: record the buses into one folder; list, download and delete what is there."""

import os
import re
import stat
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi import Path as PathParameter
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from tactiled.bounds import WORD, Syntax
from tactiled.bus.logfile import duration_s
from tactiled.bus.reader import open_bus
from tactiled.bus.recorder import Recorder, record
from tactiled.bus.recording import Recording as Recorded
from tactiled.errors import ConfigError, TactileError
from tactiled.files import atomic_write, clear_scratch
from tactiled.live.events import Events
from tactiled.web import schemas
from tactiled.web.http.body import MAX_RECORDING_BYTES
from tactiled.web.http.limits import ConcurrencyLimit
from tactiled.web.http.problems import Problem
from tactiled.web.rest.dependencies import without_path
from tactiled.web.rest.openapi import CONTROL, EVERY_RESOURCE, JSON_BODY, MEDIA, problems, success
from tactiled.web.rest.uploads import DiskReserve, while_connected

CHECKED_AT_ONCE = 2  # uploads; others wait
MAX_UPLOADS_PER_CLIENT, MAX_UPLOADS = 8, 16  # each may reserve 1 GiB of the disk for ten minutes
FILE_NAME = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,99}\.(log|asc|blf|log\.gz|asc\.gz)$"  # no slash, no other dot
FILE = success("the whole file", "file") | success(
    "the part of it that Range asks for; of several parts multipart/byteranges", "file", status=206
)
WRONG_RANGES = {400: "give bytes=FIRST-LAST", 416: "is not within the file"}
CONTENT = {MEDIA["file"]: {"schema": {"type": "string", "format": "binary"}}}
UPLOAD = (400, 408, 409, 413, 503, *CONTROL)
BODY = {"requestBody": {"required": True, "content": CONTENT}}
Name = Annotated[
    str, Syntax(FILE_NAME, f"1 to 100 {WORD}, a letter or digit first, then .log, .asc, .blf, .log.gz or .asc.gz")
]
FileName = Annotated[Name, PathParameter(description="a recording's file name")]


class Start(schemas.RequestBody):
    """What to record."""

    bus: str = Field(description="a bus of the configuration", examples=["can0"])
    name: Name | None = Field(
        None, description="file name; made of bus and time if left out", examples=["grasp.log"]
    )


class Recording(schemas.Schema):
    """One recording."""

    name: str = Field(examples=["grasp.log"])
    bytes: int | None = Field(description="null: its file was removed or renamed", examples=[48231])
    modified: float | None = Field(None, description="Unix time of its last message, or of its upload, s")
    duration_s: float | None = Field(
        None,
        description="from its first to its last message, s; null: not known without reading it all",
        examples=[12.5],
    )
    running: bool = Field(examples=[True])
    bus: str | None = Field(None, description="null: recorded before this start of the service")
    messages: int | None = Field(None, description="on the disk so far", examples=[1025])
    unreadable: int | None = Field(None, description="messages lost: not decoded by the interface", examples=[0])
    error: str | None = Field(None, description="why it ended early", examples=[None])


class RecordingPage(schemas.Schema):
    """Recordings in the folder, by name."""

    recordings: tuple[Recording, ...]
    after: str | None = Field(description="ask for these next; null: there are no more", examples=[None])


class PageQuery(BaseModel):
    """Which recordings."""

    after: str | None = Field(None, max_length=120, description="only names after this one")
    limit: int = Field(100, ge=1, le=1000, description="recordings in one answer")


class _Run(Thread):
    """One recording, which reads its bus."""

    def __init__(self, bus: str, settings: Mapping[str, Any], path: Path, events: Events, leave_mb: float) -> None:
        super().__init__(name=f"record {bus}", daemon=True)
        self.bus, self._events = bus, events
        self.error: str | None = None
        self._stopping = Event()
        self._reader = open_bus(**settings)
        try:
            self._recorder = Recorder(path, leave_mb=leave_mb)
        except TactileError:
            self._reader.close()
            raise
        self.start()

    @property
    def messages(self) -> int:
        return self._recorder.written

    @property
    def unreadable(self) -> int:
        return self._reader.unreadable

    def stop(self) -> None:
        self._stopping.set()
        self.join()

    def run(self) -> None:
        path = self._recorder.path
        try:
            record(self._reader, self._recorder, self._stopping)
        except TactileError as error:
            self.error = without_path(error, path)
        finally:
            self._reader.close()
            unreadable = f", and {self.unreadable} that could not be decoded" if self.unreadable else ""
            ending = (self.error or f"{self.messages} messages") + unreadable
            text = f"{path.name}: {ending}"
            self._events.add("recording_ended", text, bus=self.bus, failed=self.error is not None)


class _File(FileResponse):
    """A file or a part of it; Problem where `Range` cannot be met. One of another unit than bytes is ignored."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        unit, equals, _ = Headers(scope=scope).get("range", "").partition("=")
        if equals and unit.strip().lower() != "bytes":  # RFC 9110, 14.2
            scope = {**scope, "headers": [each for each in scope["headers"] if each[0] != b"range"]}

        async def send_or_refuse(message: Message) -> None:
            if message["type"] == "http.response.start" and (status := message["status"]) in WRONG_RANGES:
                value, answer = Headers(scope=scope)["range"], Headers(raw=message["headers"])
                size = {"Content-Range": answer["content-range"]} if status == 416 else None
                raise Problem(status, f"Range: {value:.80}: {WRONG_RANGES[status]}", size)
            await send(message)

        await super().__call__(scope, receive, send_or_refuse)


class Recordings:
    """The recordings of a folder, and those that run: one a bus at most.

    Buses are by name, with python-can's settings of each; of none in a replay.
    """

    def __init__(
        self, folder: Path, buses: Mapping[str, Mapping[str, Any]], events: Events, leave_mb: float
    ) -> None:
        self._folder, self._buses, self._events, self._leave_mb = folder, buses, events, leave_mb
        self._runs: dict[str, _Run] = {}
        self._lock = Lock()
        clear_scratch(folder)  # of uploads that kill -9 ended
        self._reserve = DiskReserve(folder, leave_mb)
        self._uploads = ConcurrencyLimit(MAX_UPLOADS_PER_CLIENT, MAX_UPLOADS, "uploads")
        self._checking = ThreadPoolExecutor(CHECKED_AT_ONCE, "check")

    def page(self, query: PageQuery) -> RecordingPage:
        """Recordings by name, a running one whatever became of its file; links and other files are none."""
        with self._lock:
            names = {name for name, run in self._runs.items() if run.is_alive()}
            with _failing("recordings"), suppress(FileNotFoundError):  # of a folder that nothing has made yet
                names |= {path.name for path in self._folder.iterdir() if _is_recording(path)}
            after = [name for name in sorted(names) if query.after is None or name > query.after]
            page = tuple(map(self.recording, after[: query.limit]))
        return RecordingPage(recordings=page, after=page[-1].name if len(after) > query.limit else None)

    def start(self, bus: str, name: str | None) -> Recording:
        """Start one; Problem where there is no such bus or none at all, or one of that bus or name is there."""
        if not self._buses:
            raise Problem(409, f"bus {bus}: is not open: this service replays a recording")
        if bus not in self._buses:
            raise Problem(404, f"bus {bus}: no such bus: there are {', '.join(self._buses)}")
        name = name or f"{bus}-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.log"
        path = self._folder / name
        with self._lock:
            if any(run.bus == bus and run.is_alive() for run in self._runs.values()):
                raise Problem(409, f"bus {bus}: is being recorded already")
            self._need_ended(name)
            with _failing(f"recording {name}"):
                if path.exists() or path.is_symlink():
                    other = "" if _is_recording(path) else "something else of that name "
                    raise Problem(409, f"recording {name}: {other}is there already")
                try:
                    self._folder.mkdir(parents=True, exist_ok=True)
                    self._runs[name] = _Run(bus, self._buses[bus], path, self._events, self._leave_mb)
                except TactileError as error:
                    raise Problem(503, f"recording {name}: {without_path(error, path)}") from error
            self._events.add("recording_started", name, bus=bus)
            return self.recording(name)

    async def add(self, name: str, request: Request) -> Recording:
        """Take a new one; Problem where there is one, no room for it, or its content is no recording."""
        path, size = self._folder / name, int(request.headers.get("content-length", MAX_RECORDING_BYTES))
        self._need_ended(name)  # without the lock, which others have while a bus is opened
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with self._uploads.one(request.scope), self._reserve.reserved(f"recording {name}", size) as count:
                if path.exists() or path.is_symlink():
                    raise FileExistsError
                with atomic_write(path) as part:
                    with part.open("xb") as file:
                        async for chunk in request.stream():
                            file.write(chunk)
                            file.flush()  # what is counted is no longer free
                            count(len(chunk))
                    recorded = Recorded(part)
                    check = partial(_check, part, recorded)
                    await while_connected(request, self._checking, check, recorded.cancel)
        except FileExistsError as error:
            raise Problem(409, f"recording {name}: is there already") from error
        except OSError as error:
            raise Problem(503, f"recording {name}: {error.strerror}") from error
        except ConfigError as error:
            raise Problem(422, str(error).replace(str(part), name)) from error
        self._events.add("recording_added", name)
        return self.recording(name)

    def stop(self, name: str) -> Recording:
        """Stop one, whatever became of its file; it is whole on the disk when this returns."""
        with self._lock:
            if name in self._runs:
                self._runs[name].stop()
            else:
                self._path(name)
            return self.recording(name)

    def ended(self, name: str) -> Path:
        """Where one is that does not run; Problem where it runs, whatever became of its file, or there is none."""
        self._need_ended(name)
        return self._path(name)

    def delete(self, name: str) -> None:
        """Delete one that does not run."""
        with self._lock, _failing(f"recording {name}"):
            self.ended(name).unlink(missing_ok=True)
            self._runs.pop(name, None)

    def close(self) -> None:
        """Stop all that run."""
        with self._lock:
            for run in self._runs.values():
                run.stop()
        self._checking.shutdown()

    def _path(self, name: str) -> Path:
        path = self._folder / name
        if not _is_recording(path):
            raise Problem(404, f"recording {name}: no such recording")
        return path

    def _need_ended(self, name: str) -> None:
        if (run := self._runs.get(name)) and run.is_alive():
            raise Problem(409, f"recording {name}: runs: stop it first")

    def recording(self, name: str) -> Recording:
        """One as it is now."""
        path, run = self._folder / name, self._runs.get(name)
        running = run is not None and run.is_alive()  # before its size: it grows until it has ended
        file = dict[str, object](name=name, running=running, bytes=None)
        if status := _status(path):
            file |= {"bytes": status.st_size, "modified": status.st_mtime}
            file["duration_s"] = _duration_s(path, status.st_size, status.st_mtime_ns)
        return Recording(**Recording.shared(run) | file)  # a thread has a name of its own


@contextmanager
def _failing(what: str) -> Iterator[None]:
    """Problem in the block where the disk or its rights fail."""
    try:
        yield
    except OSError as error:
        raise Problem(503, f"{what}: {error.strerror}") from error


def _check(path: Path, recorded: Recorded) -> None:
    """Have a file on the disk; ConfigError where it is no recording of data frames."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())
    if next(iter(recorded), None) is None:
        raise ConfigError(f"recording {path}: it holds no data frame")


def _is_recording(path: Path) -> bool:
    """A file of a recording's name that is no link out of the folder."""
    return re.fullmatch(FILE_NAME, path.name) is not None and _status(path) is not None


def _status(path: Path) -> os.stat_result | None:
    """That of a file; None if it is missing, or a link."""
    try:
        status = path.lstat()
    except OSError:
        return None
    return status if stat.S_ISREG(status.st_mode) else None


@lru_cache(maxsize=1000)
def _duration_s(path: Path, _size: int, _modified_ns: int) -> float | None:
    """That of a file as it was then; None also where it cannot be read."""
    with suppress(OSError):
        return duration_s(path)
    return None


def make(recordings: Recordings) -> APIRouter:
    """The routes of a folder."""
    router = APIRouter(prefix="/api/v1/recordings", tags=["recordings"], responses=problems(*EVERY_RESOURCE))

    @router.get("", responses=problems(503))
    def page(query: Annotated[PageQuery, Query()]) -> RecordingPage:
        """Get the recordings in the folder, sorted by name, in pages."""
        return recordings.page(query)

    @router.post("", status_code=201, responses=problems(404, 409, 503, *CONTROL, *JSON_BODY))
    def start(what: Start) -> Recording:
        """Start to record a bus."""
        return recordings.start(what.bus, what.name)

    @router.post("/{name}/stop", responses=problems(404, *CONTROL))
    def stop(name: FileName) -> Recording:
        """Stop a recording; its file is complete when the answer comes."""
        return recordings.stop(name)

    @router.get("/{name}", response_class=FileResponse, responses=problems(400, 404, 409, 416) | FILE)
    def download(name: FileName) -> FileResponse:
        """Get the file of a recording that does not run, or a `Range` of it."""
        return _File(recordings.ended(name), media_type=MEDIA["file"], filename=name)

    @router.put("/{name}", status_code=201, responses=problems(*UPLOAD), openapi_extra=BODY)
    async def upload(name: FileName, request: Request) -> Recording:
        """Add a recording, in the format that its name has; nothing is overwritten."""
        if "content-range" in request.headers:
            raise Problem(400, "Content-Range: send the whole file")
        return await recordings.add(name, request)

    @router.delete("/{name}", status_code=204, responses=problems(404, 409, 503, *CONTROL))
    def delete(name: FileName) -> None:
        """Delete a recording that does not run."""
        recordings.delete(name)

    return router
