"""How large a request's body may be, and how long it may take to come."""

import asyncio

from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive, Scope

from tactiled.calibrate.calibration_file import MAX_BYTES
from tactiled.threads import give_back_heaps
from tactiled.web.http.headers import SAFE_METHODS
from tactiled.web.http.problems import SOON, Problem

MAX_BODY_BYTES = 64 << 10  # no request but an upload needs as much
MAX_UPLOAD_BYTES = 64 << 20
BODY_TIMEOUT_S = 60.0
MAX_HELD_BYTES = 32 << 20  # of all bodies that are held until they are complete and answered
MANY_HELD_BYTES = 8 << 20  # at once: after more, the heaps keep free memory between blocks in use
FREED_S = 1.0  # from the last body's end until nothing refers to them any more
UPLOAD_PATH = "/api/v1/restore"
MAX_RECORDING_BYTES = 1 << 30  # 44 min of 32 x 32 taxels at 100 Hz as .log
RECORDING_TIMEOUT_S = 600.0  # 1.8 MB/s
RECORDINGS_PATH = "/api/v1/recordings/"
FILE_PATH_END = "/calibration/file"  # of a calibration file, which may be longer than other bodies


def is_recording(scope: Scope) -> bool:
    """Whether a request uploads a recording."""
    path: str = scope["path"]
    return scope["method"] == "PUT" and path.startswith(RECORDINGS_PATH)


class HeldBodies:
    """The bytes of bodies, of which the largest that is incomplete gives way when they are too many.

    After the last of many their memory goes back to the system.
    """

    def __init__(self) -> None:
        self._sizes: dict[Body, int] = {}
        self._many = False  # were held since memory was given back

    def add(self, body: "Body", size: int) -> None:
        """Count more bytes of one."""
        self._sizes[body] = self._sizes.get(body, 0) + size
        self._many |= sum(self._sizes.values()) > MANY_HELD_BYTES
        while sum(self._sizes.values()) > MAX_HELD_BYTES:
            if not (incomplete := [each for each in self._sizes if not each.complete]):
                return
            largest = max(incomplete, key=self._sizes.__getitem__)
            self.free(largest)
            largest.give_way()

    def free(self, body: "Body") -> None:
        """Forget one."""
        self._sizes.pop(body, None)
        if self._many and not self._sizes:
            self._many = False
            asyncio.get_running_loop().call_later(FREED_S, give_back_heaps)


class Body:
    """The body of a request: Problem 413 as soon as it is too large, 408 where it is too late.

    503 where it must give way. Where none belongs, it is dropped, and `unwanted` replaces a success.
    """

    def __init__(self, scope: Scope, receive: Receive, bodies: HeldBodies) -> None:
        headers, method = Headers(scope=scope), scope["method"]
        path, self._timeout_s = scope["path"], BODY_TIMEOUT_S
        self._receive, self._upload, self._bodies = receive, method == "POST" and path == UPLOAD_PATH, bodies
        is_file = method == "PUT" and path.endswith(FILE_PATH_END)
        self._limit = MAX_UPLOAD_BYTES if self._upload else MAX_BYTES if is_file else MAX_BODY_BYTES
        if is_recording(scope):
            self._upload, self._limit, self._timeout_s = True, MAX_RECORDING_BYTES, RECORDING_TIMEOUT_S
        self._length, self._size = headers.get("content-length", "0"), 0
        self._deadline = asyncio.get_running_loop().time() + self._timeout_s
        self._reading: asyncio.Timeout | None = None  # while a part is waited for
        self._gives_way = self._began = False
        self.complete = self._length == "0" and "transfer-encoding" not in headers
        # None of it is read; a path that has no such method says so first.
        takes_none = method in SAFE_METHODS and not self.complete
        self.unwanted = Problem(422, f"body: {method} takes none") if takes_none else None

    def give_way(self) -> None:
        """Refuse it, if it is not complete by now."""
        self._gives_way = True
        if self._reading is not None:
            self._reading.reschedule(0.0)

    async def receiver(self) -> Receive:
        """Read the body, unless it is an upload; gives its ASGI receiver. ClientDisconnect if it breaks off."""
        if self.unwanted:
            return self._no_body
        if self.complete or self._upload:
            return self._next
        body, more = bytearray(), True
        while more:
            message = await self._next()
            if message["type"] == "http.disconnect":
                raise ClientDisconnect
            body += message["body"]
            self._bodies.add(self, len(message["body"]))
            more = message["more_body"]
        messages: list[Message] = [{"type": "http.request", "body": bytes(body), "more_body": False}]

        async def replay() -> Message:
            return messages.pop() if messages else await self._receive()

        return replay

    async def _no_body(self) -> Message:
        """An empty body, then the client's disconnection; what comes until then is dropped."""
        if not self._began:
            self._began = True
            return {"type": "http.request", "body": b"", "more_body": False}
        while (message := await self._receive())["type"] != "http.disconnect":
            pass
        return message

    async def _next(self) -> Message:
        """The next part of the body; after the last, the client's disconnection."""
        if self.complete:
            return await self._receive()
        if self._gives_way:
            raise _give_way()
        if self._length.isdecimal() and int(self._length) > self._limit:
            raise self._too_large()
        try:
            async with asyncio.timeout_at(self._deadline) as self._reading:
                message = await self._receive()
        except TimeoutError as error:
            if self._gives_way:
                raise _give_way() from error
            raise Problem(408, f"the body did not come within {self._timeout_s:g} s") from error
        finally:
            self._reading = None
        self._size += len(message.get("body", b""))
        if self._size > self._limit:
            raise self._too_large()
        self.complete = not message.get("more_body", False)
        return message

    def _too_large(self) -> Problem:
        return Problem(413, f"a body of more than {self._limit >> 10} KiB: send it in parts")


def _give_way() -> Problem:
    return Problem(503, f"bodies of more than {MAX_HELD_BYTES >> 20} MiB are on their way: come again", SOON)
