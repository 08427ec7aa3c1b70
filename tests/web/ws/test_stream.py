"""Streams of one sensor."""

import json
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing

import numpy as np
import pytest
import websocket
from websockets.client import ClientProtocol
from websockets.frames import Opcode

from tactiled.web import answers
from tactiled.web.http import protocols
from tactiled.web.http.timeouts import Phase
from tactiled.web.server import running
from tactiled.web.ws import feed, pacing, session
from tactiled.web.ws.feed import Feed
from tactiled.web.ws.pacing import MARK, PING_EVERY, REQUESTED
from tactiled.web.ws.stream import Stream, due_after
from tactiled.wire import unpack
from tests.conftest import BUSY_S, GAIN, NO_LOAD, pressed, until
from tests.web.http.raw import UPGRADE, bound, plug, read_all, websocket_url
from tests.web.ws.clients import NEXT, ONE, images, stream, text, text_of, texts, unpack_all

IN_FLIGHT = 10  # messages that may be on their way to a client that does not read


def test_messages_are_made_once_for_all_clients_and_the_status_comes_once_a_second(rig, url, monkeypatch):
    framed, ticks, times = [], [], []
    frame, tick = feed.frame, Feed.tick
    monkeypatch.setattr(feed, "frame", lambda message: (framed.append(message), frame(message))[1])
    monkeypatch.setattr(Feed, "tick", lambda one: (ticks.append(one), tick(one)))
    with ExitStack() as stack:
        clients = [stack.enter_context(stream(url)) for _ in range(4)]
        for _ in range(5):
            for client in clients:
                text_of(client, "status")
            times.append(time.monotonic())
        assert max(np.diff(times)) < 1.2  # 1.5 where a tick comes just too early
        assert len(times) <= len(framed) <= len(ticks) + 1
        for at in range(3):
            rig.show(pressed(at))
            assert {one.sequence for client in clients for one in images(client, 2)} == {at}
    assert sum(isinstance(each, bytes) for each in framed) == 3 * 2


def test_a_sensor_becomes_stale_without_a_frame(rig, url):
    rig.stale_after(600)
    for _ in range(3):
        rig.show(pressed())
    with stream(url) as client:
        first = text(client)
        rig.stale_after(0.3)
        last = text(client, lambda status: status["state"] != "live")
    newest = rig.sensor.hub.latest()
    assert (first["type"], first["state"], first["method"], first["ran"]) == ("status", "live", "wiener", "wiener")
    assert (first["sequence"], first["timestamp"]) == (newest.sequence, newest.time)
    assert first["skew_s"] >= 0
    assert first["jitter_s"] > 0
    assert (last["state"], last["skew_s"], last["jitter_s"]) == ("stale", first["skew_s"], None)
    assert last["age_s"] > 0.3
    assert last["loss"]["lost"] == 0
    with stream(url) as late:  # it is told the state before an image that is old
        assert json.loads(late.recv(timeout=BUSY_S))["state"] == "stale"
        assert {each.sequence for each in images(late, 2)} == {newest.sequence}


def test_kinds_format_and_rate(rig, url):
    began = time.monotonic()
    with rig.playing(100), stream(url, "?kinds=restored&rate_hz=20&format=json") as client:
        frames = [text_of(client, "frame") for _ in range(20)]
        seconds = time.monotonic() - began
    assert {each["kind"] for each in frames} == {"restored"}
    assert {np.shape(each["values"]) for each in frames} == {(8, 8)}
    sequences = [each["sequence"] for each in frames]
    assert sequences == sorted(set(sequences))
    assert len(frames) <= 20 * seconds + 2


def test_the_rate_is_kept_and_a_late_image_delays_no_other():
    def paced(made, rate_hz):
        due, times = 0.0, []
        for at in made:
            times.append(max(at, due))
            due = due_after(due, times[-1], rate_hz)
        return np.array(times)

    late = np.random.default_rng(1).uniform(0, 0.006, 500)  # s
    late[100] = 0.012
    made = 1 + np.arange(500) / 75 + late
    np.testing.assert_array_equal(paced(made, 75), made)
    assert np.diff(paced(1 + np.arange(2000) / 1000, 20))[2:] == pytest.approx(0.05)
    assert np.diff(paced([1, 9, 9.001, 9.002], 20)) == pytest.approx([8, 0.03, 0.05])  # a pause saves up little
    assert np.diff(paced([1000, 1000.01, 1000.02], 1)) == pytest.approx([0.98, 1])


@pytest.mark.parametrize("query", ["?kinds=restored&rate_hz=7", "?contacts=1", ""])
def test_what_a_limit_delays_is_sent_when_it_is_due_though_nothing_else_happens(rig, monkeypatch, query):
    monkeypatch.setattr(feed, "TICK_S", 10 * BUSY_S)
    with running(rig.service) as url, stream(url, query) as client:
        for method in ("rl", "wiener") * 4:
            if not query:
                rig.sensor.pipeline.set_method(method)
            sequence = rig.show(pressed()).sequence
            if "rate" in query:
                assert images(client, 1)[0].sequence == sequence
            elif query:
                assert text_of(client, "contacts")["sequence"] == sequence
            else:
                text(client, lambda message, own=method: (message["type"], message.get("ran")) == ("status", own))


def test_a_stream_of_contacts_rests_while_no_image_comes(rig, url, monkeypatch):
    turns, send = [], Stream._send_contacts
    monkeypatch.setattr(Stream, "_send_contacts", lambda one, line: (turns.append(line), send(one, line)))
    rig.show(pressed())
    with stream(url, "?contacts=1") as client:
        message = text_of(client, "contacts")
        assert (message["sequence"], len(message["contacts"])) == (0, 1)
        until(lambda: len(turns) > 2)
        turns.clear()
        assert {each["type"] for each in texts(client, 2.0)} == {"status"}
    assert len(turns) < 10  # a tick each half second


def test_images_do_not_wait_for_contacts(rig, url, monkeypatch):
    release, find = threading.Event(), answers.contacts
    monkeypatch.setattr(answers, "contacts", lambda sensor: find(sensor) if release.wait(10) else None)
    with stream(url, "?contacts=1") as client:
        for at in range(3):
            rig.show(pressed(at))
            assert [each.sequence for each in images(client, 2)] == [at, at]
        release.set()
        text_of(client, "contacts")


def test_credit_gives_the_newest_image_once_and_at_most_two_ahead(rig, url):
    with stream(url, "?flow=credit") as client:
        for at in range(3):
            rig.show(pressed(at))
        assert {each["type"] for each in texts(client, 0.3)} == {"status"}
        client.send(NEXT)
        assert [(each.kind, each.sequence) for each in images(client, 2)] == [("raw", 2), ("restored", 2)]
        for _ in range(5):
            client.send(NEXT)
        assert client.ping().wait(BUSY_S)  # the service has read them
        for at in (3, 4):
            rig.show(pressed(at))
            assert [each.sequence for each in images(client, 2)] == [at, at]
        rig.show(pressed(5))
        assert {each["type"] for each in texts(client, 0.3)} <= {"status"}
        client.send(NEXT)
        assert images(client, 1)[0].sequence == 5


@pytest.mark.parametrize("query", ["", "&flow=credit"])
def test_a_ping_follows_every_image_that_nobody_requested_and_every_few_messages(rig, url, query, monkeypatch):
    frames, receive = [], ClientProtocol.recv_frame
    monkeypatch.setattr(ClientProtocol, "recv_frame", lambda own, each: (frames.append(each), receive(own, each)))
    monkeypatch.setattr(pacing, "MAX_RATE_HZ", 1.0)  # no image goes in parts

    def pings_follow():
        counts = Counter(each.opcode for each in frames if each.opcode is not Opcode.PING or MARK in each.data)
        if not query:
            return 0 <= counts[Opcode.PING] - counts[Opcode.BINARY] <= counts[Opcode.TEXT] // PING_EVERY
        return counts[Opcode.PING] == (counts[Opcode.TEXT] + counts[Opcode.BINARY] * REQUESTED) // PING_EVERY

    with stream(url, f"?kinds=raw{query}") as client:
        for at in range(40):
            if query:
                client.send(NEXT)
            rig.show(pressed(at % 6))
            assert images(client, 1)[0].sequence == at
        until(pings_follow)


def test_the_images_of_a_frame_may_come_in_one_message(rig, url):
    with stream(url, "?together=1&flow=credit") as together, stream(url) as apart:
        rig.show(pressed())
        together.send(NEXT)
        both = unpack_all(next(data for data in together if isinstance(data, bytes)))
        rig.show(pressed(4))
        assert {each["type"] for each in texts(together, 0.3)} <= {"status"}  # one message, one credit
        for one, alone in zip(both, images(apart, 2), strict=True):
            assert one._replace(values=0, flags=0, made_at=0) == alone._replace(values=0, flags=0, made_at=0)
            np.testing.assert_array_equal(one.values, alone.values)
            np.testing.assert_array_equal(one.flags, alone.flags)


def test_a_slow_client_gets_the_newest_frame_once_it_has_read_the_one_before(rig, url, monkeypatch):
    monkeypatch.setattr(pacing, "LATE_S", 0.0)
    with closing(websocket.create_connection(websocket_url(url, f"{ONE}?kinds=raw"))) as client:  # reads not ahead
        for unread in (1, 4, 4):
            for at in range(unread):
                rig.show(pressed(at))
            data = next(data for data in iter(client.recv, None) if isinstance(data, bytes))
            assert unpack(data).sequence == rig.sequence


def test_a_client_that_seems_far_away_has_few_frames_when_it_becomes_slow(rig, url, monkeypatch):
    monkeypatch.setattr(pacing, "NEAR_S", 0.0)
    monkeypatch.setattr(pacing, "LATE_S", BUSY_S)
    with closing(websocket.create_connection(websocket_url(url, f"{ONE}?kinds=raw"))) as client:  # reads not ahead
        read = lambda: next(data for data in iter(client.recv, None) if isinstance(data, bytes))  # noqa: E731
        for at in range(8):
            rig.show(pressed(at % 6))
            assert unpack(read()).sequence == rig.sequence
        for at in range(8):
            rig.show(pressed(at % 6))
            time.sleep(0.05)
        got = [unpack(read()).sequence]
        while got[-1] != rig.sequence:
            got.append(unpack(read()).sequence)
        assert len(got) <= 4  # two on their way, one that the stream had taken, and the newest


@pytest.mark.parametrize("kinds", [1, 2])
def test_a_library_that_reads_ahead_of_a_program_that_becomes_slow_has_one_frame(rig, url, kinds, monkeypatch):
    monkeypatch.setattr(pacing, "MAX_RATE_HZ", 1e6)  # a frame fills the library's queue at any rate
    began = time.time()
    with stream(url, "?kinds=raw" if kinds == 1 else "") as client:

        def read(at):
            got = images(client, kinds)
            assert began <= got[0].timestamp <= got[0].made_at <= time.time()
            np.testing.assert_allclose(got[0].values, (pressed(at) - NO_LOAD) * GAIN, atol=1e-4)
            return {each.sequence for each in got}

        for at in range(30):
            rig.show(pressed(at % 6))
            assert read(at % 6) == {at}
        for at in range(6):
            rig.show(pressed(at))
            time.sleep(0.05)  # in which a library answers pings
        assert (read(0), read(5)) == ({30}, {35})


def test_a_program_that_was_slow_gets_what_is_newest_a_while_after_it_took_the_last_image(rig, url, monkeypatch):
    for name, value in {"MAX_RATE_HZ": 1e6, "LATE_S": 0.0, "HOLD": 1e6, "MAX_HOLD_S": 2.0}.items():
        monkeypatch.setattr(pacing, name, value)
    with stream(url, "?kinds=raw") as client:
        for newest in (0, 2):
            rig.show(pressed())
            time.sleep(0.05)  # in which a library answers pings
            if newest:
                rig.show(pressed())
            assert images(client, 1)[0].sequence == newest


def unread(url):
    """A client that reads nothing, not even the answer to its handshake."""
    end = plug(url)
    end.sendall(f"{UPGRADE}\r\n".replace("/api/v1/stream", ONE).encode())
    return end


@pytest.mark.parametrize("query", ["?kinds=raw", "", "?kinds=raw&flow=credit"])
def test_a_client_that_reads_again_gets_no_backlog_and_delays_no_other(rig, url, query):
    kinds = 1 if "raw" in query else 2
    soon = {"close_timeout": 0.1}  # with images unread a client does not see the other end's close
    with stream(url, query, max_queue=1, **soon) as client, stream(url, "?kinds=raw", **soon) as other:

        def read():
            if "credit" in query:
                client.send(NEXT)
            (sequence,) = {each.sequence for each in images(client, kinds)}
            return sequence

        for at in range(206):
            rig.show(pressed(at % 6))
            assert images(other, 1)[0].sequence == rig.sequence
            if at < 6:  # of the others it reads none
                assert read() == rig.sequence
        old = list(iter(read, rig.sequence))
        assert len(old) * kinds <= (0 if "credit" in query else IN_FLIGHT)
        for at in range(50):
            rig.show(pressed(at % 6))
            assert read() == rig.sequence


def test_a_client_that_answers_no_ping_is_closed_and_no_other(rig, monkeypatch):
    assert f"answered no ping for {session.PING_S:g} s" in session.CLOSES[1011]
    assert "keepalive ping timeout" in session.CLOSES[1011]
    monkeypatch.setattr(session, "PING_S", 2.0)
    with running(rig.service) as url, stream(url) as client, unread(url) as silent:
        assert b"\x88\x18\x03\xf3keepalive ping timeout" in read_all(silent)
        rig.show(pressed())
        assert images(client, 1)[0].sequence == 0


def test_a_client_that_does_not_read_a_large_image_is_dropped_when_it_answers_no_ping(rig, monkeypatch):
    monkeypatch.setattr(session, "PING_S", 0.3)
    bound(monkeypatch, Phase.CLOSING, seconds=0.3)
    monkeypatch.setattr(Feed, "binary", lambda *_: bytes(16 << 20))  # more than any buffer between the two
    rig.show(pressed())
    with running(rig.service) as url, unread(url):
        until(lambda: rig.sensor.hub._listeners)
        until(lambda: not rig.sensor.hub._listeners)


def test_a_client_that_does_not_read_is_no_error_when_the_service_ends(rig, monkeypatch, caplog):
    monkeypatch.setattr(protocols, "SHUTDOWN_S", 0.0)  # until a client is cut off
    with ExitStack() as stack, running(rig.service) as url:
        stack.enter_context(unread(url))
        until(lambda: rig.sensor.hub._listeners)
    assert not [each for each in caplog.records if each.name == "uvicorn.error"]


def test_clients_that_leave_hold_no_listener_and_no_thread(rig, url):
    rig.show(pressed())
    threads = threading.active_count()
    for _ in range(5):
        with stream(url) as client:
            images(client, 2)
    until(lambda: not rig.sensor.hub._listeners)
    assert threading.active_count() <= threads + 1
