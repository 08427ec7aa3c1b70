"""Connections that waste the service's time, in every state that one can be in."""

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import pytest
import uvicorn
from pydantic import SecretStr
from uvicorn.server import ServerState
from websockets.sync.client import connect

from tactiled.config import Server
from tactiled.web.http import places
from tactiled.web.http.bounds import MAX_FRAGMENTS, MAX_HEAD, State
from tactiled.web.http.connection import Connection
from tactiled.web.http.places import Places
from tactiled.web.http.protocols import WebSocket
from tactiled.web.server import running
from tests.conftest import BUSY_S, ask
from tests.web.http.test_attacks import bound, closed_after, plug, said


async def app(scope, receive, send):
    """Reads the body and answers with its length; leaves a WebSocket's handshake without an answer."""
    if scope["type"] == "websocket":
        await asyncio.Event().wait()
    length, more = 0, True
    while more:
        message = await receive()
        length, more = length + len(message["body"]), message["more_body"]
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"<%d>" % length})


@pytest.fixture
def talk():
    """Hands pieces to a connection as they are; gives what it says, and whether it is cut off or closed."""

    async def go(pieces, seconds):
        config = uvicorn.Config(app, ws=WebSocket, h11_max_incomplete_event_size=MAX_HEAD)
        made = Connection(config, ServerState(), {}, places=Places(9))
        end = Mock(asyncio.Transport)
        end.get_extra_info.return_value, end.is_closing.return_value = None, False
        made.connection_made(end)
        for piece in filter(None, pieces):
            made.data_received(piece)
            await asyncio.sleep(0.02)  # the answer
        await asyncio.sleep(seconds)
        closed = end.close.called
        made.connection_lost(ConnectionResetError())
        return b"".join(call.args[0] for call in end.write.call_args_list), end.abort.called, closed

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        yield lambda *pieces, wait=0.0: other.submit(asyncio.run, go(pieces, wait)).result(30)


BODY = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % (2 * MAX_HEAD) + bytes(2 * MAX_HEAD)
HEAD = b"GET / HTTP/1.1\r\nHost: x\r\n"


def test_bytes_of_a_request_are_not_counted_to_the_head_of_the_next(talk):
    answers, cut, _ = talk(BODY + HEAD, b"\r\n")
    assert (answers.count(b"200"), answers.count(b"<%d>" % (2 * MAX_HEAD)), answers.count(b"<0>")) == (2, 1, 1)
    assert not cut


@pytest.mark.parametrize("before", [b"", BODY, HEAD + b"\r\n"])
def test_a_head_without_end_is_refused_whatever_came_before(talk, before):
    piece = b"X: " + b"x" * 8000 + b"\r\n"
    assert talk(before + HEAD, *[piece] * 8) == (talk(before)[0], False, False)
    assert b"HTTP/1.1 431 " in talk(before + HEAD, *[piece] * 9)[0]


def test_blank_lines_are_no_request(talk, url):
    assert b"HTTP/1.1 400 " in talk(b"\r\n" * 4000)[0]
    with plug(url) as end:
        end.sendall(f"GET /api/v1/health HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n\r\n".encode())
        assert said(end).count(b"HTTP/1.1 ") == 2


def test_a_head_is_not_late_while_the_service_itself_reads_nothing(rig, monkeypatch):
    bound(monkeypatch, State.HEAD, seconds=2.0)
    with running(rig.service) as url, plug(url) as end:
        slow, quick = (
            f"GET /api/v1/{path} HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n".encode()
            for path in ("events?wait=5", "health")
        )
        end.sendall(slow + quick + quick[:10])  # read no further until the first two are answered
        answers = b""
        while answers.count(b"HTTP/1.1 200") < 2 or not answers.endswith(b"}"):
            answers += (piece := end.recv(1 << 16))
            assert piece, answers
        end.sendall(quick[10:])
        assert end.recv(1 << 16).startswith(b"HTTP/1.1 200")


STREAM = "/api/v1/stream"
UPGRADE = (
    f"GET {STREAM} HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n"
)
BAD_UPGRADES = {
    "a length": (UPGRADE + "Content-Length: 5\r\n\r\nabcde", 400),
    "a length, and nothing behind it": (UPGRADE + "Content-Length: 5\r\n\r\n", 400),
    "chunks": (UPGRADE + "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400),
    "many headers": (UPGRADE + "".join(f"X-{n}: x\r\n" for n in range(140)) + "\r\n", 431),
    "a long header": (UPGRADE + f"X: {'x' * 9000}\r\n\r\n", 431),
    "a long address": (UPGRADE.replace("stream", f"stream?{'x' * 9000}") + "\r\n", 414),
}


@pytest.mark.parametrize("what", BAD_UPGRADES)
def test_an_upgrade_that_cannot_be_is_answered_and_closed(url, what):
    request, status = BAD_UPGRADES[what]
    with plug(url) as end:
        end.sendall(request.encode())
        head, _, body = said(end).partition(b"\r\n\r\n")
    assert head.startswith(f"HTTP/1.1 {status} ".encode())
    assert json.loads(body)["status"] == status


def masked(opcode, data=b"", fin=True):
    """A frame of a client."""
    return bytes((opcode | (0x80 if fin else 0), 0x80 | len(data))) + bytes(4) + data


@pytest.fixture
def guarded(rig):
    """A service that asks for a token."""
    with running(rig.service, Server(port=0, control_token=SecretStr("c" * 16))) as address:
        yield address


def test_who_is_refused_a_stream_cannot_go_on_sending_frames(guarded, monkeypatch):
    bound(monkeypatch, State.CLOSING, seconds=BUSY_S)
    frames = masked(0, fin=False) * (1 << 18)
    with plug(guarded) as end:
        end.sendall(f"{UPGRADE}\r\n".encode())
        assert end.recv(1 << 16).startswith(b"HTTP/1.1 101")
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            [end.sendall(frames) for _ in range(40)]
    assert ask("GET", guarded + "/api/v1/health").status_code == 401


def test_a_message_of_too_many_frames_ends_a_stream(url):
    with plug(url) as end:
        end.sendall(f"{UPGRADE}\r\n".encode() + b"")
        end.recv(1 << 16)
        end.sendall(masked(1, b"x", fin=False) + masked(0, fin=False) * MAX_FRAGMENTS)
        assert said(end).endswith(f"a message of more than {MAX_FRAGMENTS} frames".encode())


def test_who_reads_no_answers_is_not_read(url):
    """The answers to its pings would be kept for it without end."""
    with plug(url) as end:
        end.sendall(f"{UPGRADE}\r\n".encode())
        end.settimeout(3.0)
        with pytest.raises((TimeoutError, BrokenPipeError, ConnectionResetError)):
            [end.sendall(masked(9, bytes(125)) * 1000) for _ in range(2000)]


@pytest.mark.parametrize("path", ["/api/v1/sensors/palm/method", "/nothing"])
def test_trailers_without_end_are_cut_off(url, path):
    trailers = b"".join(b"X-%d: x\r\n" % n for n in range(10_000))
    with plug(url) as end:
        end.sendall(f"PUT {path} HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n".encode())
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            [end.sendall(trailers) for _ in range(300)]


def begun(state):
    """What a client sends to come into a state and stay there."""
    return {
        State.HEAD: b"GET / HTTP/1.1\r\n",
        State.BODY: b"PUT /api/v1/sensors/palm/method HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n",
        State.IDLE: b"GET /api/v1/health HTTP/1.1\r\nHost: localhost\r\n\r\n",
        State.CLOSING: b"GET /api/v1/nothing HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n",
    }[state]


@pytest.mark.parametrize("state", [State.HEAD, State.BODY, State.IDLE, State.CLOSING])
def test_every_state_that_waits_for_the_client_ends(rig, monkeypatch, state):
    for each in State:
        bound(monkeypatch, each, seconds=0.3 if each is state else 10 * BUSY_S)
    with running(rig.service) as url, plug(url) as end:
        end.sendall(begun(state))
        assert closed_after(end)[1] < BUSY_S


def test_the_control_token_gets_through_where_others_hold_every_place(rig, monkeypatch):
    monkeypatch.setattr(places, "MAX_CONNECTIONS", 20)
    at = Server(port=0, control_token=SecretStr("c" * 16), streams=1)
    with running(rig.service, at) as url:
        ends = [plug(url) for _ in range(60)]
        for n, end in enumerate(ends):
            end.sendall(UPGRADE.encode() if n % 2 else b"GET /")
        for _ in range(10):
            headers = {"Authorization": "Bearer " + "c" * 16}
            assert ask("GET", url + "/api/v1/health", headers=headers).status_code == 200
        told = ask("GET", url + "/metrics", headers=headers).text
        assert 'tactiled_connections_dropped_total{how="refused"} 0' in told
        assert int(told.split('connections_dropped_total{how="evicted"} ')[1].split()[0]) >= 40
        for end in ends:
            end.close()


def test_where_every_place_has_a_stream_a_client_is_told_so(rig, monkeypatch):
    monkeypatch.setattr(places, "MAX_CONNECTIONS", 4)
    with running(rig.service, Server(port=0, streams=2)) as url:
        address = url.replace("http", "ws", 1) + STREAM
        with connect(address), connect(address), plug(url) as one, plug(url) as two:
            for end in (one, two):
                end.sendall(b"GET /api/v1/events?wait=30 HTTP/1.1\r\nHost: localhost\r\n\r\n")
            with plug(url) as late:
                while b"503" not in (answer := said(late)):
                    late = plug(url)
            assert b"every connection is taken" in answer


def test_a_shutdown_ends_with_a_client_in_every_state(rig):
    with running(rig.service) as url:
        ends = [plug(url) for _ in range(6)]
        for end, data in zip(
            ends,
            [
                b"",
                *map(begun, (State.HEAD, State.BODY, State.IDLE)),
                UPGRADE.encode(),
                (UPGRADE + "Content-Length: 5\r\n\r\n").encode(),
            ],
            strict=True,
        ):
            end.sendall(data)
        with connect(url.replace("http", "ws", 1) + STREAM) as stream:
            stream.recv(timeout=BUSY_S)
            waits = plug(url)
            waits.sendall(b"GET /api/v1/events?wait=30 HTTP/1.1\r\nHost: localhost\r\n\r\n")
    for end in (*ends, waits):
        said(end)
        end.close()


def test_an_idle_connection_is_closed_behind_what_is_still_to_be_sent(talk, monkeypatch):
    """Who reads slowly has the end of its answer: to cut it off would throw that away."""
    bound(monkeypatch, State.IDLE, seconds=0.1)
    _, cut, closed = talk(HEAD + b"\r\n", wait=0.3)
    assert (cut, closed) == (False, True)


def test_frames_before_the_answer_to_a_handshake_wait_for_it(talk):
    """The library knows of none before, not even of one that is wrong."""
    assert talk(f"{UPGRADE}\r\n".encode(), b"\xff" * 8) == (b"", False, False)


def test_a_handshake_behind_another_request_is_one(url, caplog):
    with plug(url) as end, caplog.at_level("WARNING"):
        end.sendall(f"GET /api/v1/health HTTP/1.1\r\nHost: localhost\r\n\r\n{UPGRADE}\r\n".encode())
        for _ in range(50):
            end.sendall(b"\xff" * 8)
        answers = said(end)
    assert answers.count(b"HTTP/1.1 200") == answers.count(b"HTTP/1.1 101") == 1
    assert not caplog.records
