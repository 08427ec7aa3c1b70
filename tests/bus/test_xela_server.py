"""XELA's own server as a bus, played by a WebSocket that sends what public captures and clients of it show."""

import json
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from websockets.sync.server import serve

from tactiled.bus.assembler import assemble
from tactiled.bus.codecs.xela import REST, Xela
from tactiled.bus.reader import open_bus
from tactiled.bus.sniff import survey
from tactiled.errors import BusError

RNG = np.random.default_rng(2)
WELCOME = '{"message": "Welcome"}'


def module(number, axes, time_s=1763712000.25, hexadecimal=False):
    one = {"sensor": str(number), "time": time_s, "model": "uSPa46", "taxels": len(axes)}
    one |= {"temp": [0.0] * len(axes), "calibrated": [0.0] * axes.size}
    if hexadecimal:
        return one | {"data": axes.astype(">u2").tobytes().hex(",", 2).upper()}
    return one | {"integer": axes.ravel().tolist()}


def routine(**modules):
    numbers = {key.strip("_"): each for key, each in modules.items()}
    return json.dumps({"message": 1, "time": 1.0, "sensors": len(numbers), "type": "routine"} | numbers)


@contextmanager
def sending(*texts, stay=True):
    """A server that sends these to each client, and stays or closes the connection."""
    done = threading.Event()

    def client(socket):
        for each in texts:
            socket.send(each)
        if stay:
            done.wait(60)

    with serve(client, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        finally:
            done.set()
            server.shutdown()
            thread.join()


def received(reader, count):
    return [reader.receive(10.0) for _ in range(count)]


def test_modules_are_xelas_with_normal_and_shear():
    first, second = RNG.integers(0, 1 << 16, (24, 3)), RNG.integers(0, 1 << 16, (16, 3))
    again = module(1, first, hexadecimal=True)
    texts = [WELCOME, routine(_1=again, _2=module(2, second)), routine(_1=again)]
    texts.append(routine(_1=module(1, first + (first < 9), 1763712000.5)))
    with sending(*texts) as url:
        reader = open_bus(interface="websocket", channel=url)
        messages = received(reader, 24 + 16 + 24)  # the second of module 1 is none: its time is the same
        assert reader.receive(0.05) is None
        reader.close()
    (frame, after), _ = assemble(Xela(), [each for each in messages if each.id & 0xF == 1])
    np.testing.assert_array_equal(frame.counts, first[:, 2])
    np.testing.assert_array_equal(frame.shear, first[:, :2].T - REST)
    assert (frame.time, after.time) == (1763712000.25, 1763712000.5)
    small = Xela(controller=2, rows=(4, 3, 2, 1), columns=(3, 2, 1, 0))
    ((frame,), _) = assemble(small, [each for each in messages if each.id & 0xF == 2])
    np.testing.assert_array_equal(frame.counts, second[:, 2])
    found = {one.match.codec: one.match.shape for one in survey(messages).senders}
    assert found == {Xela(): (4, 6), small: (4, 4)}


@pytest.mark.parametrize(
    "text",
    [
        "x",
        "[1]",
        routine(_1={"time": 1.0, "integer": [1, 2]}),
        routine(_1={"time": 1.0, "integer": [1, 2, 65536]}),
        routine(_1={"time": 1.0, "data": "12,fg,00"}),
        routine(_1={"integer": [1, 2, 3]}),
        routine(_16={"time": 1.0, "integer": [1, 2, 3]}),
        routine(_1={"time": 1.0, "integer": [1] * 3 * 128}),
        routine(_1=None),
    ],
)
def test_what_is_no_frame_is_counted_and_ends_nothing(text):
    axes = np.arange(72).reshape(24, 3)
    with sending(text, routine(_1=module(1, axes))) as url:
        reader = open_bus(interface="websocket", channel=url)
        while (message := reader.receive(10.0)) is None:
            pass
        assert (message.id, reader.counts()["unreadable"]) == (0x451, 1)
        reader.close()


def test_a_server_that_ends_or_does_not_answer_is_one_line():
    with sending(WELCOME, stay=False) as url:
        reader = open_bus(interface="websocket", channel=url)
        with pytest.raises(BusError, match=r"^bus websocket ws://127[^\n]*: the server closed the connection"):
            received(reader, 1)
        reader.close()
    with pytest.raises(BusError, match=r"^bus websocket ws://127[^\n]*refused"):
        open_bus(interface="websocket", channel=url)
