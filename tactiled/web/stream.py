"""`WS /api/v1/sensors/{name}/stream`: newest wins, nothing queues for a client that does not read."""

import asyncio
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

from fastapi import WebSocket, WebSocketDisconnect

from tactiled.frames import Image
from tactiled.web import forms
from tactiled.web.feed import Feed
from tactiled.web.wire import KINDS, Kind

BAD_REQUEST, NOT_FOUND = 4400, 4404  # close codes, after HTTP's
STATUS_S = 1.0  # a client hears of the sensor's state at least this often
CONTACTS_S = 0.05  # between two messages on contacts
CHANGE_S = 0.1  # and of a change no more often than this
MOST = 64 * 1024  # bytes of a client's message


@dataclass(frozen=True, slots=True)
class Wish:
    """What a client asked for in the address."""

    kinds: tuple[Kind, ...] = KINDS
    rate_hz: float = 0.0  # 0: every frame
    form: Literal["binary", "json"] = "binary"
    contacts: bool = False  # as text messages
    credit: bool = False  # one image of each kind for each {"type": "next"}


def wish(query: Mapping[str, str]) -> Wish:
    """Read the address's query; ValueError that names the parameter and its value."""
    unknown = set(query) - {"kinds", "rate_hz", "format", "flow", "contacts", "token"}
    if unknown:
        raise ValueError(f"{min(unknown)}: no such parameter: there are kinds, rate_hz, format, flow, contacts")
    kinds = tuple(query.get("kinds", "raw,restored").split(","))
    if not set(kinds) <= set(KINDS):
        raise ValueError(f"kinds={query['kinds']}: give raw, restored or raw,restored")
    try:
        rate_hz = float(query.get("rate_hz", "0"))
    except ValueError:
        rate_hz = -1.0
    if not 0 <= rate_hz <= 1e4:
        raise ValueError(f"rate_hz={query['rate_hz']}: give 0 (every frame) to 10000")
    form, flow = query.get("format", "binary"), query.get("flow", "newest")
    if form not in ("binary", "json"):
        raise ValueError(f"format={form}: give binary or json")
    if flow not in ("newest", "credit"):
        raise ValueError(f"flow={flow}: give newest or credit")
    if (contacts := query.get("contacts", "0")) not in ("0", "1"):
        raise ValueError(f"contacts={contacts}: give 0 or 1")
    return Wish(
        cast(tuple[Kind, ...], kinds),
        rate_hz,
        cast(Literal["binary", "json"], form),
        contacts == "1",
        flow == "credit",
    )


class Stream:
    """One client of one sensor."""

    def __init__(self, socket: WebSocket, feed: Feed, asked: Wish) -> None:
        self._socket, self._feed, self._wish = socket, feed, asked
        self._credit = 0 if asked.credit else 1
        self._sent: Image | None = None
        self._told: tuple[object, ...] = ()
        self._told_at = 0.0
        self._due = 0.0
        self._touched = -1
        self._touched_at = 0.0

    async def run(self) -> None:
        """Serve until the client leaves, or says something that means nothing."""
        with self._feed.listen() as self._wake:
            tasks = [asyncio.create_task(each) for each in (self._listen(), self._talk())]
            try:
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
            except WebSocketDisconnect:
                return
            except ValueError as error:
                await self._socket.close(BAD_REQUEST, str(error)[:120])
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)

    async def _listen(self) -> None:
        while True:
            text = await self._socket.receive_text()
            if len(text) > MOST or not _asks_for_next(text):
                raise ValueError(f'message {text[:40]!r}: the only one there is: {{"type": "next"}}')
            if self._wish.credit:
                self._credit = 1
                self._wake.set()

    async def _talk(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await self._wake.wait()
            if (early := self._due - loop.time()) > 0:
                await asyncio.sleep(early)
            self._wake.clear()
            await self._send_image()
            await self._send_status(loop.time())
            if self._wish.contacts:
                await self._send_contacts(loop.time())

    async def _send_image(self) -> None:
        image = self._feed.image
        if image is None or image is self._sent or not self._credit:
            return
        self._sent = image
        if self._wish.credit:
            self._credit = 0
        if self._wish.rate_hz:
            self._due = asyncio.get_running_loop().time() + 1 / self._wish.rate_hz
        if self._wish.form == "binary":
            for message in [self._feed.message(kind) for kind in self._wish.kinds]:
                await self._socket.send_bytes(message)
            return
        for kind in self._wish.kinds:
            frame = forms.frame(self._feed.sensor, image, kind)
            await self._socket.send_text(frame.model_dump_json())

    async def _send_status(self, now: float) -> None:
        image = self._sent or self._feed.image
        status = self._feed.sensor.status()
        ran = () if image is None else (image.method, image.warnings)
        told = (status.state, self._feed.sensor.method, *ran)
        if now - self._told_at < (STATUS_S if told == self._told else CHANGE_S):
            return
        self._told, self._told_at = told, now
        await self._socket.send_text(forms.stream_status(self._feed.sensor, image, status).model_dump_json())

    async def _send_contacts(self, now: float) -> None:
        if now - self._touched_at < CONTACTS_S:
            return
        found = await asyncio.to_thread(forms.contacts, self._feed.sensor)
        if found is not None and found.sequence != self._touched:
            self._touched, self._touched_at = found.sequence, now
            await self._socket.send_text(found.model_dump_json())


def _asks_for_next(text: str) -> bool:
    try:
        said: Any = json.loads(text)
    except ValueError:
        return False
    return isinstance(said, dict) and said == {"type": "next"}
