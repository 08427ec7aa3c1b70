import json
import socket
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest
from websockets.client import ClientProtocol
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.uri import parse_uri

from tactiled.web import answers
from tactiled.web.http.bounds import State
from tactiled.web.server import running
from tactiled.web.ws import feed, session
from tactiled.web.ws.feed import Feed
from tactiled.web.ws.stream import Stream, due_after
from tactiled.wire import unpack, unpack_all
from tests.conftest import BUSY_S, GAIN, NO_LOAD, pressed, until
from tests.web.http.raw import bound

FEW = 10  # messages that may be on their way to a client that does not read


def stream(url, query="", **options):
    return connect(
        f"{url.replace('http', 'ws', 1)}/api/v1/sensors/palm/stream{query}", compression=None, **options
    )


def images(client, count, timeout=BUSY_S):
    """The next binary messages; TimeoutError where one does not come, whatever is told in text meanwhile."""
    got, end = [], time.monotonic() + timeout
    while len(got) < count:
        data = client.recv(timeout=max(0.0, end - time.monotonic()))
        if isinstance(data, bytes):
            got.append(unpack(data))
            end = time.monotonic() + timeout
    return got


def unsent(message):
    """The bytes of two images of 8 x 8 but for the times at which their messages were made."""
    size = 64 + 4 * 64
    return [message[at : at + size][:32] + message[at : at + size][40:] for at in (0, size + 64)]


def texts(client, seconds):
    """The text messages of the next seconds."""
    got, end = [], time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        try:
            data = client.recv(timeout=left)
        except TimeoutError:
            break
        if isinstance(data, str):
            got.append(json.loads(data))
    return got


def told(client, true):
    """The next text message that is so."""
    while True:
        data = client.recv(timeout=BUSY_S)
        if isinstance(data, str) and true(said := json.loads(data)):
            return said


def test_from_can_messages_to_a_websocket_client(rig, url):
    with stream(url) as client:
        for force in (0, 200, 400):
            began = time.time()
            rig.send(pressed(force=force))
            raw, restored = images(client, 2)
            assert (raw.kind, restored.kind) == ("raw", "restored")
            assert raw.sequence == restored.sequence == rig.sequence
            np.testing.assert_allclose(raw.values, (pressed(force=force) - NO_LOAD) * GAIN)
            np.testing.assert_array_equal(restored.values, rig.sensor.hub.latest().restored)
            assert began <= raw.timestamp <= raw.sent <= time.time()
        assert restored.values.max() > raw.values.max()  # the cover's blur undone


def test_the_state_is_told_before_an_image_that_may_be_an_old_one(rig, url):
    rig.stale_after(0.01)
    rig.show(pressed())
    until(lambda: rig.sensor.status().state == "stale")
    with stream(url) as client:
        assert json.loads(client.recv(timeout=BUSY_S))["state"] == "stale"
        assert {each.sequence for each in images(client, 2)} == {0}


def test_the_state_of_a_silent_sensor_is_told_once_a_second(url):
    with stream(url) as client:
        times = []
        for _ in range(6):
            told(client, lambda said: said["type"] == "status")
            times.append(time.monotonic())
    assert max(np.diff(times)) < 1.2  # 1.5 where a tick comes just too early


def test_the_state_is_told_in_text_and_staleness_comes_without_frames(rig, url):
    rig.stale_after(600)
    for _ in range(3):
        rig.show(pressed())
    with stream(url) as client:
        first = told(client, lambda _: True)
        rig.stale_after(0.3)
        last = told(client, lambda said: said["state"] != "live")
    assert first["type"] == "status"
    assert first["skew_s"] >= 0
    assert first["jitter_s"] > 0
    assert (last["skew_s"], last["jitter_s"]) == (first["skew_s"], None)
    assert (first["state"], first["method"], first["ran"]) == ("live", "wiener", "wiener")
    newest = rig.sensor.hub.latest()
    assert (first["sequence"], first["timestamp"]) == (newest.sequence, newest.time)
    assert last["state"] == "stale"
    assert last["age_s"] > 0.3
    assert last["loss"]["lost"] == 0


def test_kinds_format_and_rate(rig, url):
    stop = threading.Event()
    sender = rig.play(100, stop)
    began = time.monotonic()
    with stream(url, "?kinds=restored&rate_hz=20&format=json") as client:
        frames = [told(client, lambda said: said["type"] == "frame") for _ in range(20)]
        seconds = time.monotonic() - began
    stop.set()
    sender.join()
    assert {each["kind"] for each in frames} == {"restored"}
    assert {np.shape(each["values"]) for each in frames} == {(8, 8)}
    sequences = [each["sequence"] for each in frames]
    assert sequences == sorted(set(sequences))
    assert len(frames) <= 20 * seconds + 2


def paced(made, rate_hz):
    """When images that are made at these times are sent."""
    due, sent = 0.0, []
    for at in made:
        sent.append(max(at, due))
        due = due_after(due, sent[-1], rate_hz)
    return np.array(sent)


def test_an_image_that_is_late_makes_no_other_late():
    late = np.random.default_rng(1).uniform(0, 0.006, 500)  # s
    late[100] = 0.012
    made = 1 + np.arange(500) / 75 + late
    np.testing.assert_array_equal(paced(made, 75), made)


def test_no_more_are_sent_than_asked_for_whatever_comes():
    sent = paced(1 + np.arange(2000) / 1000, 20)
    assert np.diff(sent)[2:] == pytest.approx(0.05)
    rest = np.diff(paced([1, 9, 9.001, 9.002], 20))  # a rest saves up next to nothing
    assert rest == pytest.approx([8, 0.03, 0.05])
    first = np.diff(paced([1000, 1000.01, 1000.02], 1))
    assert first == pytest.approx([0.98, 1])


def test_an_image_held_back_by_the_limit_is_sent_when_it_is_due_though_nothing_else_happens(rig, monkeypatch):
    monkeypatch.setattr(feed, "TICK_S", 10 * BUSY_S)
    with running(rig.service) as url, stream(url, "?kinds=restored&rate_hz=7") as client:
        for _ in range(8):
            sequence = rig.show(pressed()).sequence
            assert images(client, 1)[0].sequence == sequence


def test_contacts_held_back_by_the_limit_are_sent_when_they_are_due_though_nothing_else_happens(rig, monkeypatch):
    monkeypatch.setattr(feed, "TICK_S", 10 * BUSY_S)
    with running(rig.service) as url, stream(url, "?contacts=1") as client:
        for _ in range(8):
            sequence = rig.show(pressed()).sequence
            assert told(client, lambda said: said["type"] == "contacts")["sequence"] == sequence


def test_a_change_held_back_by_the_limit_is_told_when_it_is_due_though_nothing_else_happens(rig, monkeypatch):
    monkeypatch.setattr(feed, "TICK_S", 10 * BUSY_S)
    with running(rig.service) as url, stream(url) as client:
        for method in ("rl", "wiener") * 4:
            rig.sensor.pipeline.set_method(method)
            rig.show(pressed())
            told(client, lambda said, method=method: said["type"] == "status" and said["ran"] == method)


def test_contacts_on_request(rig, url):
    rig.show(pressed())
    with stream(url, "?contacts=1") as client:
        found = told(client, lambda said: said["type"] == "contacts")
        assert all(text["type"] == "status" for text in texts(client, 0.5))
    assert len(found["contacts"]) == 1
    assert found["sequence"] == 0


@pytest.mark.parametrize("shown", [True, False])
def test_a_stream_of_contacts_rests_while_no_image_comes(rig, url, monkeypatch, shown):
    turns, send = [], Stream._send_contacts

    def counted(self, line):
        turns.append(line)
        return send(self, line)

    monkeypatch.setattr(Stream, "_send_contacts", counted)
    if shown:
        rig.show(pressed())
    with stream(url, "?contacts=1") as client:
        if shown:
            assert told(client, lambda said: said["type"] == "contacts")["sequence"] == 0
        until(lambda: len(turns) > 2)
        turns.clear()
        assert all(text["type"] == "status" for text in texts(client, 2.0))
    assert len(turns) < 10  # a tick each half second


def test_images_do_not_wait_for_contacts(rig, url, monkeypatch):
    found, find = threading.Event(), answers.contacts
    monkeypatch.setattr(answers, "contacts", lambda sensor: find(sensor) if found.wait(10) else None)
    with stream(url, "?contacts=1") as client:
        for at in range(3):
            rig.show(pressed(at))
            assert [each.sequence for each in images(client, 2)] == [at, at]
        found.set()
        told(client, lambda said: said["type"] == "contacts")


def test_credit_gives_one_image_of_each_kind_at_a_time(rig, url):
    with stream(url, "?flow=credit") as client:
        rig.show(pressed())
        assert all(text["type"] == "status" for text in texts(client, 0.3))
        client.send('{"type": "next"}')
        assert [each.kind for each in images(client, 2)] == ["raw", "restored"]
        rig.show(pressed(4))
        rig.show(pressed(5))
        assert all(text["type"] == "status" for text in texts(client, 0.2))
        client.send('{"type": "next"}')
        assert [each.sequence for each in images(client, 2)] == [2, 2]  # the newest, not the one in between


def test_the_images_of_a_frame_may_come_together_byte_for_byte(rig, url):
    with stream(url, "?together=1&flow=credit") as together, stream(url) as apart:
        rig.show(pressed())
        each = b"".join([next(data for data in apart if isinstance(data, bytes)) for _ in range(2)])
        assert all(text["type"] == "status" for text in texts(together, 0.3))
        together.send('{"type": "next"}')
        both = next(data for data in together if isinstance(data, bytes))
        rig.show(pressed(4))
        assert all(text["type"] == "status" for text in texts(together, 0.3))  # one message, one credit
    assert unsent(both) == unsent(each)
    assert [(one.kind, one.sequence) for one in unpack_all(both)] == [("raw", 0), ("restored", 0)]


def test_an_image_is_framed_once_for_all_who_stream_it(rig, url, monkeypatch):
    framed = []
    frame = feed.frame
    monkeypatch.setattr(feed, "frame", lambda message: (framed.append(message), frame(message))[1])
    with ExitStack() as stack:
        clients = [stack.enter_context(stream(url)) for _ in range(4)]
        for at in range(3):
            rig.show(pressed(at))
            assert {one.sequence for client in clients for one in images(client, 2)} == {at}
    assert sum(isinstance(each, bytes) for each in framed) == 3 * 2


def test_the_state_is_worded_once_for_all_who_stream_it(url, monkeypatch):
    framed, ticks = [], []
    frame, tick = feed.frame, Feed.tick
    monkeypatch.setattr(feed, "frame", lambda message: (framed.append(message), frame(message))[1])
    monkeypatch.setattr(Feed, "tick", lambda one: (ticks.append(one), tick(one)))
    with ExitStack() as stack:
        clients = [stack.enter_context(stream(url)) for _ in range(6)]
        for _ in range(3):
            for client in clients:
                told(client, lambda said: said["type"] == "status")
    assert 3 <= len(framed) <= len(ticks) + 1


def test_two_images_may_be_asked_for_ahead_and_no_more(rig, url):
    with stream(url, "?flow=credit&kinds=raw") as client:
        for _ in range(5):
            client.send('{"type": "next"}')
        assert client.ping().wait(BUSY_S)
        texts(client, 0.3)
        for at in range(2):
            rig.show(pressed(at))
            assert images(client, 1)[0].sequence == at
        rig.show(pressed(2))
        assert all(text["type"] == "status" for text in texts(client, 0.3))
        client.send('{"type": "next"}')
        assert images(client, 1)[0].sequence == 2


@pytest.mark.parametrize(
    ("path", "code", "reason"),
    [
        ("palm/stream?kinds=raw,blurred", 4400, "kinds=raw,blurred"),
        ("palm/stream?kinds=raw&kinds=restored", 4400, "kinds: given 2 times"),
        ("palm/stream?rate_hz=nan", 4400, "rate_hz=nan"),
        ("palm/stream?rate_hz=fast", 4400, "rate_hz=fast"),
        ("palm/stream?rate_hz=٣", 4400, "rate_hz=٣"),
        ("palm/stream?format=xml", 4400, "format=xml"),
        ("palm/stream?flow=all", 4400, "flow=all"),
        ("palm/stream?contacts=yes", 4400, "contacts=yes"),
        ("palm/stream?together=yes", 4400, "together=yes"),
        ("palm/stream?together=1&format=json", 4400, "together=1"),
        ("palm/stream?kind=raw", 4400, "kind: no such parameter"),
        ("plam/stream", 4404, "no such sensor"),
    ],
)
def test_a_wrong_address_is_refused_with_the_reason(url, path, code, reason):
    with connect(f"{url.replace('http', 'ws', 1)}/api/v1/sensors/{path}") as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == code
        assert reason in caught.value.rcvd.reason


@pytest.mark.parametrize("path", ["/api/v1/streams", "/api/v1/stream/", "/xela/", "/static/app.js", "/metrics"])
def test_an_address_without_a_stream_says_so(url, path):
    with connect(url.replace("http", "ws", 1) + path) as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == 4404
        assert caught.value.rcvd.reason.startswith(f"{path}: no stream")


def test_a_message_that_means_nothing_ends_the_stream_with_the_reason(url):
    with stream(url) as client:
        client.send("more!")
        with pytest.raises(ConnectionClosed) as caught:
            images(client, 1)
        assert caught.value.rcvd.code == 4400
        assert "more!" in caught.value.rcvd.reason


def test_a_page_of_another_site_gets_no_stream(url):
    with stream(url, origin="https://elsewhere.example") as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == 4403


def handshake(url, query):
    """A client that reads nothing but the answer to its handshake."""
    host, port = url.removeprefix("http://").split(":")
    plug = socket.create_connection((host, int(port)))
    plug.sendall(
        f"GET /api/v1/sensors/palm/stream{query} HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
    )
    return plug


@pytest.mark.parametrize(("query", "mark"), [("", b"TCTL"), ("?format=json", b'"frame"')])
def test_a_client_that_stops_reading_gets_no_backlog_and_the_others_never_notice(rig, url, query, mark):
    with handshake(url, query) as stalled, stream(url, "?kinds=raw") as reading:
        sequences = []
        for at in range(300):
            rig.show(pressed(at % 6))
            sequences += [each.sequence for each in images(reading, 1)]
        waiting = 0
        stalled.settimeout(0.2)
        try:
            while data := stalled.recv(1 << 20):
                waiting += data.count(mark)
        except TimeoutError:
            pass
    assert sequences == list(range(300))
    assert 0 < waiting <= FEW


@pytest.mark.parametrize("query", ["?kinds=raw", "", "?kinds=raw&flow=credit"])
def test_a_client_that_comes_back_sees_what_was_on_its_way_and_then_nothing_old(rig, url, query):
    kinds = 1 if "raw" in query else 2
    with stream(url, query, max_queue=1) as client:

        def read():
            if "credit" in query:
                client.send('{"type": "next"}')
            (sequence,) = {each.sequence for each in images(client, kinds)}
            return sequence

        for at in range(6):
            rig.show(pressed(at % 6))
            assert read() == rig.sequence
        for at in range(200):  # of which it reads none
            rig.show(pressed(at % 6))
        old = list(iter(read, rig.sequence))
        assert len(old) * kinds <= (0 if "credit" in query else FEW)
        for at in range(50):
            rig.show(pressed(at % 6))
            assert read() == rig.sequence


@pytest.mark.parametrize(
    "said", [b"next", "", "[]", '{"type": "next", "sensor": "tip"}', '{"type": "next", "n": 2}']
)
def test_what_a_client_may_not_say(url, said):
    with stream(url) as client:
        client.send(said)
        with pytest.raises(ConnectionClosed) as caught:
            images(client, 1)
        assert caught.value.rcvd.code == 4400
        assert caught.value.rcvd.reason.startswith("message ")


def frame(opcode, data, first=0x80):
    """A WebSocket frame of a client, masked with zeros."""
    return bytes([first | opcode, 0x80 | len(data)]) + bytes(4) + data


@pytest.mark.parametrize(
    ("said", "code"),
    [
        (b"\x81\x02{}", 1002),  # not masked
        (frame(1, b"{}", first=0xC0), 1002),
        (frame(3, b"{}"), 1002),
        (frame(0, b"{}"), 1002),
        (frame(8, b"\x01"), 1002),
        (frame(1, b"\xff\xfe"), 1007),
    ],
    ids=["unmasked", "reserved", "opcode", "continued", "closed", "text"],
)
def test_what_is_no_websocket_is_closed_and_is_no_fault_of_the_service(rig, url, caplog, said, code):
    assert code in session.CLOSES
    rig.show(pressed())
    with handshake(url, "") as plug:
        plug.settimeout(BUSY_S)
        until(lambda: rig.sensor.hub._listeners)
        plug.sendall(said)
        rig.show(pressed(1))
        heard = b"".join(iter(lambda: plug.recv(1 << 16), b""))
    until(lambda: not rig.sensor.hub._listeners)
    assert code.to_bytes(2, "big") in heard[-130:]
    assert [each.message for each in caplog.records if each.levelname == "ERROR"] == []


def test_a_message_without_end_is_refused_unread(url):
    with stream(url) as client:
        client.send("x" * 70_000)
        with pytest.raises(ConnectionClosed) as caught:
            images(client, 1)
        assert caught.value.rcvd.code == 1009


def deaf(url):
    """A client that reads all that comes and answers nothing; gives how it is closed."""
    client = ClientProtocol(parse_uri(url.replace("http", "ws", 1) + "/api/v1/sensors/palm/stream"))
    client.send_request(client.connect())
    with socket.create_connection((client.uri.host, client.uri.port), timeout=30) as plug:
        plug.sendall(b"".join(client.data_to_send()))
        while client.close_rcvd is None:
            client.receive_data(plug.recv(1 << 16))
            client.data_to_send()  # pongs, which are thrown away
    return client.close_rcvd


def test_a_client_that_answers_no_ping_is_closed_and_told_why_and_one_that_does_is_not(rig, monkeypatch):
    assert f"answered no ping for {session.PING_S:g} s" in session.CLOSES[1011]
    monkeypatch.setattr(session, "PING_S", 2.0)
    with running(rig.service) as url, stream(url) as client:
        closed = deaf(url)
        assert (closed.code, closed.reason) == (1011, "keepalive ping timeout")
        assert closed.reason in session.CLOSES[1011]
        rig.show(pressed())
        assert images(client, 1)[0].sequence == 0
        client.close()
        until(lambda: not rig.sensor.hub._listeners)


def test_a_client_that_reads_nothing_of_a_lot_is_gone_when_it_answers_no_ping(rig, monkeypatch):
    monkeypatch.setattr(session, "PING_S", 0.3)
    bound(monkeypatch, State.CLOSING, seconds=0.3)
    monkeypatch.setattr(Feed, "binary", lambda *_: bytes(16 << 20))  # more than any buffer between the two
    rig.show(pressed())
    with running(rig.service) as url, handshake(url, ""):
        until(lambda: rig.sensor.hub._listeners)
        until(lambda: not rig.sensor.hub._listeners)


def test_a_service_that_ends_says_so(rig):
    with ExitStack() as stack:
        with running(rig.service) as url:
            client = stack.enter_context(stream(url))
            client.recv(timeout=BUSY_S)
        with pytest.raises(ConnectionClosed) as caught:
            images(client, 1)
    assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (1012, session.CLOSES[1012])


def test_a_fault_of_the_service_is_told_as_one(url, monkeypatch, caplog):
    monkeypatch.setattr(Feed, "status", lambda _: 1 / 0)
    with stream(url) as client:
        with pytest.raises(ConnectionClosed) as caught:
            images(client, 1)
        assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (1011, "the service failed: see its log")
    until(lambda: "ZeroDivisionError" in caplog.text)


def test_a_long_reason_is_cut_to_what_a_close_frame_holds(url):
    with stream(url, "?kinds=" + "ü" * 200) as client:
        with pytest.raises(ConnectionClosed) as caught:
            client.recv(timeout=BUSY_S)
        assert caught.value.rcvd.code == 4400
        assert caught.value.rcvd.reason.startswith("kinds=üüü")


def test_clients_that_leave_leave_nothing_behind(rig, url):
    rig.show(pressed())
    threads = threading.active_count()
    for _ in range(5):
        with stream(url) as client:
            images(client, 2)
    until(lambda: not rig.sensor.hub._listeners)
    assert threading.active_count() <= threads + 1
