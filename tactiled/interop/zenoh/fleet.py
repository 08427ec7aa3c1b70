"""The sensors of all robots on a Zenoh network, as a service has them; and the way back to their readers."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING

from tactiled.config import Server, Zenoh
from tactiled.errors import ReaderError
from tactiled.interop.zenoh.intake import FORGET_S, LOOK_S, Intake
from tactiled.interop.zenoh.messages import MAX_JSON_BYTES, MAX_LINE_BYTES, MAX_STATE_BYTES
from tactiled.interop.zenoh.questions import Questions, Reply
from tactiled.interop.zenoh.robots import MAX_ASKING, Robot
from tactiled.interop.zenoh.sensor import Line
from tactiled.interop.zenoh.session import (
    HEARTBEAT_S,
    MAX_MESSAGE_BYTES,
    REQUEST_S,
    Answer,
    Request,
    connected,
    open_session,
    unpack,
)
from tactiled.threads import join_started
from tactiled.wire import PRESSURES, SHEARED

if TYPE_CHECKING:
    import zenoh

LOOK_AGAIN_S = 10.0  # for robots that had no place
CLOCK_S = 5.0  # between two comparisons with a reader's clock: 100 ppm of drift are 0.5 ms


class Fleet(Intake):
    """Every sensor that a reader publishes: what the web has of a service, by names `robot/sensor`."""

    def __init__(self, settings: Zenoh, server: Server) -> None:
        super().__init__(server)
        self._settings = settings
        self._look_at = self._ask_again_at = 0.0  # s, monotonic: when states, and tokens, are looked at next
        self._stopping = threading.Event()
        self._questions = Questions(settings)
        self._loop = asyncio.new_event_loop()  # of the questions
        self._asking = threading.Thread(target=self._loop.run_forever, name="zenoh question", daemon=True)
        self._turns = 0
        self._thread = threading.Thread(target=self._run, name="zenoh", daemon=True)

    def turns(self) -> dict[str, int | None]:
        """Turns of the thread so far; None before it has joined the network."""
        return {"zenoh": self._turns or None}

    @contextmanager
    def running(self) -> Iterator[None]:
        """Subscribe meanwhile."""
        self._asking.start()
        self._thread.start()
        try:
            yield
        finally:
            self._stopping.set()
            self.wake.set()
            join_started(self._thread)
            asyncio.run_coroutine_threadsafe(self._end_questions(), self._loop).result()
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._asking.join()
            self._loop.close()
            self.builders.shutdown(cancel_futures=True)
            for sensor in self.sensors.values():
                sensor.stop()

    async def _end_questions(self) -> None:
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for each in tasks:
            each.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def answer(self, name: str, request: Request, timeout_s: float = REQUEST_S) -> Answer:
        """Have a sensor's reader answer a request; one of the errors of a reader where it does not."""
        line = self.sensor(name).line
        if line.down:
            raise ReaderError(f"sensor {name!r}: {line.down}")
        return await self._questions.request(name, str(line.session), request, timeout_s)

    def request(self, name: str, request: Request) -> Answer:
        """The same, for a thread that may wait."""
        return asyncio.run_coroutine_threadsafe(self.answer(name, request), self._loop).result()

    def _join(self) -> "zenoh.Session | None":
        sessions: list[zenoh.Session] = []
        while not sessions and not self._stopping.is_set():
            with self.faults.turn("zenoh"):
                sessions.append(open_session(self._settings))
            if not sessions:
                self._stopping.wait(HEARTBEAT_S)
        return sessions[0] if sessions else None

    def _run(self) -> None:
        session = self._questions.session = self._join()
        if session is None:
            return
        try:
            self._subscribe(session)
            while not self._stopping.is_set():
                self.wake.wait(LOOK_S)
                self.wake.clear()
                with self.faults.turn("zenoh"):
                    self._work(time.monotonic())
                self._turns += 1
        finally:
            session.close()  # type: ignore[no-untyped-call]

    def _subscribe(self, session: "zenoh.Session") -> None:
        def subscribe(keys: str, take: Callable[[str, bytes, bytes], None]) -> None:
            session.declare_subscriber(f"{self._settings.prefix}/{keys}", partial(self._pass_on, take))

        for kind in SHEARED:
            subscribe(f"*/*/{kind}", partial(self.take_image, kind))
        subscribe("*/*/state", self.take_state)
        subscribe("*/events", self.take_event)
        tokens = f"{self._settings.prefix}/*/*/alive/*"
        session.liveliness().declare_subscriber(tokens, self._pass_on_token, history=True)

    def _ask_for_tokens(self) -> None:
        """Take the tokens of robots that had no place when they came."""

        def take(reply: "zenoh.Reply") -> None:
            if reply.ok:
                self._pass_on_token(reply.ok)

        assert self._questions.session is not None
        liveliness = self._questions.session.liveliness()
        liveliness.get(f"{self._settings.prefix}/*/*/alive/*", take, timeout=REQUEST_S)

    def _resource(self, sample: "zenoh.Sample") -> str:
        return str(sample.key_expr).removeprefix(f"{self._settings.prefix}/")

    def _pass_on(self, take: Callable[[str, bytes, bytes], None], sample: "zenoh.Sample") -> None:
        attachment = sample.attachment.to_bytes() if sample.attachment else b""
        take(self._resource(sample), sample.payload.to_bytes(), attachment)

    def _pass_on_token(self, sample: "zenoh.Sample") -> None:
        import zenoh

        self.take_token(self._resource(sample), sample.kind == zenoh.SampleKind.PUT)

    def _work(self, now: float) -> None:
        """One turn; it looks at the states after any message but images, else every LOOK_S."""
        if self.work() or now >= self._look_at:
            self._look_at = now + LOOK_S
            with self.lock:
                self._look_at_lines(now)
            self.look()
            if self.left_out and now >= self._ask_again_at:
                self._ask_again_at, self.left_out = now + LOOK_AGAIN_S, False
                self._ask_for_tokens()

    def _look_at_lines(self, now: float) -> None:
        """Ask of publishers what is not known of them yet; forget those that are long gone."""
        session, peers = self._questions.session, self._settings.connect  # without any, readers alone connect
        linked = session is not None and (not peers or connected(session))
        for line in [*self.lines.values()]:
            line.look_at_link(linked)
            robot = self.robots[line.robot]
            if line.down:
                if line.name not in self.sensors or now - line.down_at > FORGET_S:
                    self.forget(line)
            elif now >= line.due and not line.asking:
                is_described = line.described == line.session
                if is_described or line.name in self.sensors or robot.asking < MAX_ASKING:
                    line.due, line.asking = now + CLOCK_S, True
                    robot.asking += not is_described
                    work = self._compare_clock if is_described else self._describe
                    asyncio.run_coroutine_threadsafe(work(line, robot, str(line.session)), self._loop)

    async def _describe(self, line: Line, robot: Robot, session: str) -> None:
        """Ask a new publisher for its sensor's state and geometry, then for its newest frame."""
        try:
            state = await self._state(line, session)
            geometry = await self._first(f"{line.name}/{session}/rest/geometry", MAX_JSON_BYTES)
            if state is None or geometry is None:
                line.due = time.monotonic() + HEARTBEAT_S
                return
            request = partial(self.request, line.name)
            async with robot.building:
                work = partial(self.describe, line, session, (state, geometry.data), request)
                await self._loop.run_in_executor(self.builders, work)
            if line.described == session:
                await self._compare_clock(line, robot, session)
                for kind in SHEARED if self.sensors[line.name].reported.shear else PRESSURES:
                    for reply in await self._ask(f"{line.name}/{kind}", MAX_MESSAGE_BYTES):
                        self.take_image(kind, f"{line.name}/{kind}", reply.data, reply.attachment)
        finally:
            with self.lock:
                robot.asking -= 1
            line.asking = False

    async def _ask(self, resource: str, max_bytes: int) -> list[Reply]:
        replies = await asyncio.wrap_future(self._questions.ask(resource, REQUEST_S, max_bytes))
        return [each for each in replies if each.error is None]

    async def _first(self, resource: str, max_bytes: int) -> Reply | None:
        return next(iter(await self._ask(resource, max_bytes)), None)

    async def _state(self, line: Line, session: str) -> bytes | None:
        for reply in await self._ask(f"{line.name}/state", MAX_STATE_BYTES):
            with suppress(ValueError):  # another's
                if unpack(reply.attachment)[0].session == session:
                    return reply.data
        return None

    async def _compare_clock(self, line: Line, _: Robot, session: str) -> None:
        start, began = time.time(), time.monotonic()
        try:
            answer = await self._first(f"{line.name}/{session}/clock", MAX_LINE_BYTES)
            if answer is not None and session == line.session:
                if not isfinite(clock := float(answer.data)):
                    raise ValueError(f"clock: {clock}")
                line.offset.add(start, clock, start + answer.at - began)
        except ValueError as error:
            self.refuse(line, f"{error!a:.100}")
        finally:
            line.asking = False
