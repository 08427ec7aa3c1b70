"""Connections in every state, and their bounds."""

import asyncio
import json
import re
import socket
from contextlib import ExitStack
from unittest.mock import Mock

import pytest
import uvicorn
from uvicorn.server import ServerState
from websockets.sync.client import connect

from tactiled import logs
from tactiled.config import Server
from tactiled.errors import TactileError
from tactiled.web.app import create
from tactiled.web.http import connection_limit
from tactiled.web.http.connection import Connection
from tactiled.web.http.connection_limit import Places
from tactiled.web.http.protocols import WebSocket
from tactiled.web.http.timeouts import MAX_FRAGMENTS, MAX_HEAD, Phase
from tactiled.web.server import serve
from tests.attack.wire import CLOSE, PING, TEXT, frame
from tests.conftest import BRIDGES, BUSY_S, ask, run_apart, running
from tests.web.http.raw import UPGRADE, bound, plug, read_all, websocket_url


async def app(scope, receive, send):
    """Reads the body and answers with its length; leaves a WebSocket's handshake, and /wait, without an answer."""
    if scope["type"] == "websocket" or scope["path"] == "/wait":
        await asyncio.Event().wait()
    length, more = 0, True
    while more:
        message = await receive()
        length, more = length + len(message["body"]), message["more_body"]
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"<%d>" % length})


@pytest.fixture
def exchange():
    """Hands pieces to a connection as they are; gives its answer, and whether it is cut off or closed."""

    async def run(pieces, seconds):
        config = uvicorn.Config(app, ws=WebSocket, h11_max_incomplete_event_size=MAX_HEAD)
        made = Connection(config, ServerState(), {}, places=Places(9))
        end = Mock(asyncio.Transport)
        end.get_extra_info.return_value, end.is_closing.return_value = None, False
        made.connection_made(end)
        for piece in filter(None, pieces):
            made.data_received(piece)
            for _ in range(100):
                await asyncio.sleep(0)  # turns of the loop until it has answered, however long they take
        await asyncio.sleep(seconds)
        closed = end.close.called
        made.connection_lost(ConnectionResetError())
        return b"".join(call.args[0] for call in end.write.call_args_list), end.abort.called, closed

    return lambda *pieces, wait=0.0: run_apart(run(pieces, wait), 30)


HEAD = b"GET / HTTP/1.1\r\nHost: x\r\n"
BODY = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % (2 * MAX_HEAD) + bytes(2 * MAX_HEAD)


@pytest.mark.parametrize("before", [b"", BODY, HEAD + b"\r\n"])
def test_a_head_without_end_is_refused_and_bytes_of_a_request_before_do_not_count_for_it(exchange, before):
    piece = b"X: " + b"x" * 8000 + b"\r\n"
    assert exchange(before + HEAD, *[piece] * 8) == (exchange(before)[0], False, False)
    assert b"HTTP/1.1 431 " in exchange(before + HEAD, *[piece] * 9)[0]


def test_an_idle_connection_is_closed_after_its_last_answer_is_sent(exchange, monkeypatch):
    """An abort would throw away the end of an answer for a slow reader."""
    bound(monkeypatch, Phase.IDLE, seconds=0.1)
    _, cut, closed = exchange(HEAD + b"\r\n", wait=0.3)
    assert (cut, closed) == (False, True)


def test_frames_before_the_answer_to_a_handshake_wait_for_it(exchange):
    """The library cannot take them earlier, not even wrong ones."""
    assert exchange(f"{UPGRADE}\r\n".encode(), b"\xff" * 8) == (b"", False, False)


def test_blank_lines_are_no_request(exchange, url):
    assert b"HTTP/1.1 400 " in exchange(b"\r\n" * 4000)[0]
    with plug(url) as end:
        end.sendall(f"GET /api/v1/health HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n\r\n".encode())
        assert read_all(end).count(b"HTTP/1.1 ") == 2


def test_a_head_is_not_late_while_the_service_itself_reads_nothing(rig, monkeypatch):
    bound(monkeypatch, Phase.HEAD, seconds=2.0)
    rig.stale_after(600)  # an event answers who waits for one
    with running(rig.service) as url, plug(url) as end:
        poll, health = (
            f"GET /api/v1/{path} HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n".encode()
            for path in ("events?wait=5", "health")
        )
        end.sendall(poll + health + health[:10])  # read no further until the first two are answered
        answers = b""
        while answers.count(b"HTTP/1.1 200") < 2 or not answers.endswith(b"}"):
            answers += (piece := end.recv(1 << 16))
            assert piece, answers
        end.sendall(health[10:])
        assert end.recv(1 << 16).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize(("size", "cut_off"), [(MAX_HEAD, False), (2 * MAX_HEAD, True)])
def test_a_client_that_sends_much_behind_a_request_that_waits_is_cut_off(exchange, size, cut_off):
    """Nothing of it is handed on before the answer: all of it would be held."""
    waiting = b"GET /wait HTTP/1.1\r\nHost: x\r\n\r\n"
    assert exchange(waiting + bytes(size), wait=0.1) == (b"", cut_off, False)


REFUSED = {
    "no request": ("FOO BAR / HTTP/1.1\r\nHost: localhost\r\n\r\n", 400, "no HTTP request: "),
    "TLS": ("\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", 400, "no HTTP request: "),
    "two lengths": ("PUT / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nx", 400, "no HTTP"),
    "wrong chunk": ("POST /x HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", 400, "no HTTP"),
    "no key": (UPGRADE.rpartition("Sec-")[0] + "\r\n", 400, "missing Sec-WebSocket-Key header"),
    "version": (UPGRADE.replace("13", "7", 1) + "\r\n", 400, "Sec-WebSocket-Version"),
    "a length": (UPGRADE + "Content-Length: 5\r\n\r\nabcde", 400, ""),
    "a length, and no body": (UPGRADE + "Content-Length: 5\r\n\r\n", 400, ""),
    "chunks": (UPGRADE + "Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400, ""),
    "many headers": (UPGRADE + "".join(f"X-{n}: x\r\n" for n in range(140)) + "\r\n", 431, ""),
    "a long header": (UPGRADE + f"X: {'x' * 9000}\r\n\r\n", 431, ""),
    "a long address": (UPGRADE.replace("stream", f"stream?{'x' * 9000}") + "\r\n", 414, ""),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_head_that_cannot_be_parsed_is_answered_with_a_problem_and_closed(url, name):
    data, status, detail = REFUSED[name]
    with plug(url) as end:
        end.sendall(data.encode("latin-1"))
        head, _, body = read_all(end).partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines)
    assert first.startswith(f"HTTP/1.1 {status} ")
    assert (headers["content-type"], headers["connection"]) == ("application/problem+json", "close")
    assert "default-src 'none'" in headers["content-security-policy"]
    assert int(headers["content-length"]) == len(body)
    problem = json.loads(body)
    assert (problem["status"], problem["title"]) == (status, first.partition(f"{status} ")[2])
    assert detail in problem["detail"]
    assert "\n" not in problem["detail"]


def test_a_message_of_too_many_frames_ends_a_stream(url):
    first = frame(TEXT, b"x", last=False) + frame(0, last=False) * (MAX_FRAGMENTS - 2)
    for last, reason in (
        (frame(0), b"the only one there is"),
        (frame(0, last=False) * 2, b"of more than 64 frames"),
    ):
        with plug(url) as end:
            end.sendall(f"{UPGRADE}\r\n".encode())
            end.recv(1 << 16)
            end.sendall(first + last)
            assert reason in read_all(end)


def test_a_client_that_reads_no_answers_is_not_read(url):
    """The answers to its pings would queue without end."""
    with plug(url) as end:
        end.sendall(f"{UPGRADE}\r\n".encode())
        end.settimeout(3.0)
        with pytest.raises((TimeoutError, BrokenPipeError, ConnectionResetError)):
            [end.sendall(frame(PING, bytes(125)) * 1000) for _ in range(2000)]


HEALTH = b"GET /api/v1/health HTTP/1.1\r\nHost: localhost\r\n\r\n"
WAITING = {  # what a client sends to come into a state and stay there
    "head": ({Phase.HEAD}, HEALTH[:16]),
    "second head": ({Phase.HEAD, Phase.IDLE}, HEALTH[:8]),  # in which uvicorn itself waits for ever
    "body": (
        {Phase.BODY},
        b"PUT /api/v1/sensors/palm/method HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n",
    ),
    "idle": ({Phase.IDLE}, HEALTH),
    "closing": ({Phase.CLOSING}, b"GET /api/v1/nothing HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n"),
}


@pytest.mark.parametrize("name", WAITING)
def test_every_state_that_waits_for_the_client_ends(rig, monkeypatch, name):
    states, data = WAITING[name]
    for each in Phase:
        bound(monkeypatch, each, seconds=0.3 if each in states else 10 * BUSY_S)
    with running(rig.service) as url, plug(url) as end:
        if name == "second head":
            end.sendall(HEALTH)
            while not end.recv(1 << 16).endswith(b"}"):
                pass
        end.sendall(data)
        read_all(end)


def test_a_request_has_a_place_where_others_without_hold_all_and_503_where_none_is_without(rig, monkeypatch):
    rig.stale_after(600)  # an event answers who waits for one
    monkeypatch.setattr(connection_limit, "MAX_CONNECTIONS", 4)
    with running(rig.service, Server(port=0, streams=2)) as url, ExitStack() as stack:
        for n in range(12):
            stack.enter_context(plug(url)).sendall(UPGRADE.encode() if n % 2 else b"GET /")
        metrics = ask("GET", url + "/metrics").text
        assert 'tactiled_connections_dropped_total{how="refused"} 0' in metrics
        assert float(metrics.split('connections_dropped_total{how="evicted"} ')[1].split()[0]) >= 8
        for _ in range(2):
            stack.enter_context(connect(websocket_url(url)))
            poll = b"GET /api/v1/events?wait=30 HTTP/1.1\r\nHost: localhost\r\n\r\n"
            stack.enter_context(plug(url)).sendall(poll)
        answer = b""
        while b"503" not in answer:
            with plug(url) as late:
                answer = read_all(late)
        assert b"every connection is taken" in answer


def test_a_handshake_after_another_request_is_accepted(url, caplog):
    with plug(url) as end, caplog.at_level("WARNING"):
        end.sendall(f"GET /api/v1/health HTTP/1.1\r\nHost: localhost\r\n\r\n{UPGRADE}\r\n".encode())
        for _ in range(50):
            end.sendall(b"\xff" * 8)
        answers = read_all(end)
    assert answers.count(b"HTTP/1.1 200") == answers.count(b"HTTP/1.1 101") == 1
    assert not [each for each in caplog.records if each.name != "tactiled.events"]


def test_frames_that_come_with_a_handshake_are_read_behind_its_answer(url):
    with plug(url) as end:
        end.sendall(f"{UPGRADE}\r\n".encode() + frame(PING, b"here") + frame(CLOSE, b"\x03\xe8"))
        head, _, frames = read_all(end).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 101 ")
    assert b"\x8a\x04here" in frames


def test_an_address_that_cannot_be_bound_is_refused_in_one_line(rig):
    def error(**address):
        with pytest.raises(TactileError) as caught:
            running(rig.service, Server(control_token="a" * 16, **address)).__enter__()
        return str(caught.value)

    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert error(port=port).startswith(f"address 127.0.0.1:{port}: in use: choose another port")
        with pytest.raises(TactileError, match=f"address 127.0.0.1:{port}: in use"):
            serve(create(rig.service, config := Server(port=0, xela=port), BRIDGES), config)
    for host in ("nowhere.invalid", "203.0.113.7", "a" * 64):
        assert host in error(host=host)
        assert "\n" not in error(host=host)


def test_a_client_that_comes_as_soon_as_the_address_is_announced_is_not_refused(rig, monkeypatch):
    def connect(text):
        socket.create_connection(("127.0.0.1", int(re.search(r":(\d+)/", text)[1]))).close()
        raise KeyboardInterrupt

    monkeypatch.setattr(logs, "announce", connect)
    with pytest.raises(KeyboardInterrupt):
        serve(create(rig.service, Server(port=0)), Server(port=0))
