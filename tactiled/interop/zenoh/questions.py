"""Questions to readers over Zenoh: each is answered or given up in time, and none holds up a thread or another."""

import asyncio
import json
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic_core import from_json

from tactiled.config import Zenoh
from tactiled.errors import ReaderAnswerError, ReaderError, ReadOnlyError
from tactiled.interop.zenoh.messages import MAX_ANSWER_BYTES, MAX_HEAD_BYTES, MAX_LINE_BYTES, AnswerHead, read
from tactiled.interop.zenoh.session import REQUEST_S, Answer, Request
from tactiled.interop.zenoh.signatures import fits, robot_key, sign
from tactiled.web.http.headers import SAFE_METHODS

if TYPE_CHECKING:
    import zenoh

MAX_REPLIES = 4  # to one question: others on the network may answer, too
MAX_PENDING = 8  # requests of clients to one robot
FORBIDDEN = 403
UNSIGNED = "an answer without its reader's signature: whether it was done is unknown"
NO_KEY = "this server has no zenoh.control_key: the sensors of all robots are read-only here"


class Reply(NamedTuple):
    """What one peer answers."""

    data: bytes  # one byte longer than allowed if the answer was too long
    attachment: bytes
    error: str | None = None  # if set, there is no data and no attachment
    at: float = 0.0  # s, monotonic, when it came


class Questions:
    """Asks readers; any thread."""

    def __init__(self, settings: Zenoh) -> None:
        key = settings.control_key
        self._prefix, self._fleet_key = settings.prefix, key.get_secret_value() if key else None
        self._pending: Counter[str] = Counter()  # requests, by robot
        self._lock = threading.Lock()
        self.session: zenoh.Session | None = None

    def ask(
        self,
        resource: str,
        timeout_s: float,
        max_bytes: int,
        body: bytes = b"",
        about: dict[str, Any] | None = None,
    ) -> Future[list[Reply]]:
        """Whatever peers answer to a question below the prefix; ReaderError where there is no network yet."""
        import zenoh

        if self.session is None:
            raise ReaderError("not connected to the Zenoh network yet")
        replies: list[Reply] = []
        future: Future[list[Reply]] = Future()
        future.set_running_or_notify_cancel()  # a client that stops waiting cannot cancel it

        def take(reply: "zenoh.Reply") -> None:
            if len(replies) < MAX_REPLIES:
                replies.append(_reply(reply, max_bytes))

        handler = zenoh.handlers.Callback(take, lambda: future.set_result(replies), indirect=False)
        self.session.get(
            f"{self._prefix}/{resource}", handler, payload=body, attachment=json.dumps(about or {}),
            timeout=timeout_s, consolidation=zenoh.ConsolidationMode.NONE,
        )  # fmt: skip
        return future

    async def request(self, name: str, session: str, request: Request, timeout_s: float = REQUEST_S) -> Answer:
        """Have a sensor's reader answer a request; one of the errors of a reader where it does not."""
        robot, base = name.partition("/")[0], f"{name}/{session}"
        about: dict[str, Any] = {
            "method": request.method, "query": request.query, "headers": request.headers,
        }  # fmt: skip
        key = None
        with self._one_more(robot):
            if request.method not in SAFE_METHODS:
                key = await self._claim(name, base, about, request, timeout_s)
            began, resource = time.monotonic(), f"{base}/rest/{request.path}"
            future = self.ask(resource, timeout_s, MAX_ANSWER_BYTES, request.body, about)
            replies = await asyncio.wrap_future(future)
        answer = _answer(name, replies, key, about.get("challenge"))
        if answer is None:
            raise ReaderError(_no_answer(name, replies, time.monotonic() - began, timeout_s, key is not None))
        return answer

    async def _claim(self, name: str, base: str, about: dict[str, Any], request: Request, timeout_s: float) -> str:
        """Sign a change; gives the robot's key."""
        if self._fleet_key is None:
            raise ReadOnlyError(f"sensor {name!r}: {NO_KEY}")
        began = time.monotonic()
        replies = await asyncio.wrap_future(self.ask(f"{base}/challenge", timeout_s, MAX_LINE_BYTES))
        challenge = next((each.data for each in replies if 0 < len(each.data) <= MAX_LINE_BYTES), None)
        if challenge is None:
            raise ReaderError(_no_answer(name, replies, time.monotonic() - began, timeout_s, False))
        about["challenge"] = challenge.decode(errors="replace")
        key = robot_key(self._fleet_key, name.partition("/")[0])
        about["claim"] = sign(key, f"{self._prefix}/{base}/rest/{request.path}", about, request.body)
        return key

    @contextmanager
    def _one_more(self, robot: str) -> Iterator[None]:
        with self._lock:
            if self._pending[robot] >= MAX_PENDING:
                raise ReaderError(
                    f"robot {robot!r}: {MAX_PENDING} requests wait for its reader already: try again"
                )
            self._pending[robot] += 1
        try:
            yield
        finally:
            with self._lock:
                self._pending -= Counter((robot,))


def _reply(reply: "zenoh.Reply", max_bytes: int) -> Reply:
    if reply.ok is None:
        error = reply.err.payload.to_bytes()[:300].decode(errors="replace") if reply.err else ""
        return Reply(b"", b"", error)
    attachment = reply.ok.attachment.to_bytes()[: MAX_HEAD_BYTES + 1] if reply.ok.attachment else b""
    return Reply(reply.ok.payload.to_bytes()[: max_bytes + 1], attachment, None, time.monotonic())


def _answer(name: str, replies: list[Reply], key: str | None, challenge: str | None) -> Answer | None:
    """The first answer of a reader, of a change one with its signature; None where there is none at all."""
    fault: Exception | None = None
    refused: Answer | None = None
    for reply in replies:
        if reply.error is not None:
            continue
        try:
            if len(reply.data) > MAX_ANSWER_BYTES:
                raise ValueError(f"an answer of more than {MAX_ANSWER_BYTES} bytes")
            head = read(AnswerHead, reply.attachment, MAX_HEAD_BYTES)
        except ValueError as error:
            fault = fault or ReaderAnswerError(f"sensor {name!r}: its reader answers wrongly: {error}")
            continue
        answer = Answer(head.status, dict(head.headers), reply.data)
        if key is None or fits(key, str(challenge), from_json(reply.attachment), reply.data):
            return answer
        if head.status == FORBIDDEN:  # a reader of another key can sign nothing
            refused = answer
        else:
            fault = ReaderAnswerError(f"sensor {name!r}: {UNSIGNED}")
    if fault and not refused:
        raise fault
    return refused


def _no_answer(name: str, replies: list[Reply], waited_s: float, timeout_s: float, changes: bool) -> str:
    """Why a request has no answer."""
    unknown = ": whether it was done is unknown" if changes else ""
    for reply in replies:
        if reply.error != "Timeout":
            return f"sensor {name!r}: its reader failed: {reply.error!a:.300}{unknown}"
    if replies:
        return f"sensor {name!r}: its reader did not answer within {timeout_s:g} s{unknown}"
    lost = f"the connection to its reader was lost after {waited_s:.1f} s, before it answered"
    return f"sensor {name!r}: {lost}{unknown}"
