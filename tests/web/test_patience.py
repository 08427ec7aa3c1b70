import asyncio
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import pytest
import uvicorn
from uvicorn.server import ServerState

from tactiled.web import patience
from tactiled.web.patience import MOST_HEAD, PatientHttp
from tactiled.web.server import running
from tests.web.test_attacks import plug


async def app(scope, receive, send):
    """Reads the body and answers with its length."""
    del scope
    length, more = 0, True
    while more:
        message = await receive()
        length, more = length + len(message["body"]), message["more_body"]
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"<%d>" % length})


@pytest.fixture
def talk():
    """Hands pieces to a connection as they are; gives what it says, and whether it was cut off."""

    async def go(pieces):
        made = PatientHttp(uvicorn.Config(app), ServerState(), {})
        end = Mock(asyncio.Transport)
        end.get_extra_info.return_value = None
        end.get_protocol.return_value, end.is_closing.return_value = made, False
        made.connection_made(end)
        for piece in pieces:
            made.data_received(piece)
            await asyncio.sleep(0.01)  # the answer
        made.connection_lost(ConnectionResetError())
        return b"".join(call.args[0] for call in end.write.call_args_list), end.abort.called

    with ThreadPoolExecutor(1) as other:  # on this thread a browser's loop may be running
        yield lambda *pieces: other.submit(asyncio.run, go(pieces)).result(30)


BODY = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % (2 * MOST_HEAD) + bytes(2 * MOST_HEAD)
HEAD = b"GET / HTTP/1.1\r\nHost: x\r\n"


def test_bytes_of_a_request_are_not_counted_to_the_head_of_the_next(talk):
    said, cut = talk(BODY + HEAD, b"\r\n")
    assert (said.count(b"200 OK"), said.count(b"<%d>" % (2 * MOST_HEAD)), said.count(b"<0>")) == (2, 1, 1)
    assert not cut


@pytest.mark.parametrize("before", [b"", BODY, HEAD + b"\r\n"])
def test_a_head_without_end_is_cut_off_whatever_came_before(talk, before):
    piece = b"X: " + b"x" * 8000 + b"\r\n"
    assert talk(before + HEAD, *[piece] * 8) == (talk(before)[0], False)
    assert talk(before + HEAD, *[piece] * 9) == (talk(before)[0], True)


def test_blank_lines_are_a_head_that_never_comes(talk, url, monkeypatch):
    piece = b"\r\n" * 4000
    for before in (b"", HEAD + b"\r\n"):
        assert not talk(before, *[piece] * 8)[1]
        assert talk(before, *[piece] * 10)[1]
    monkeypatch.setattr(patience, "HEAD_S", 0.5)
    with plug(url) as end:
        end.sendall(f"GET /api/v1/health HTTP/1.1\r\nHost: {url[7:]}\r\n\r\n".encode())
        assert end.recv(1 << 16)
        end.sendall(b"\r\n")
        assert not end.recv(1 << 16)


def test_a_head_is_not_late_while_the_service_itself_reads_nothing(rig, monkeypatch):
    monkeypatch.setattr(patience, "HEAD_S", 2.0)
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
