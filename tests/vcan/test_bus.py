"""What only SocketCAN itself shows: the kernel's times, filters, drops, links and batches."""

import socket

import numpy as np
import pytest

from tactiled.bus.codecs.packed import Packed
from tactiled.bus.reader import BUFFER_BYTES, only, open_bus
from tactiled.bus.router import Router
from tactiled.config import load
from tactiled.errors import BusError
from tactiled.frames import Message
from tactiled.live.service import Service
from tests.skin import PALM

CODEC = Packed(10, 12)  # three messages a frame


def counts_of(codec, sequence):
    return (np.arange(codec.size) * 7 + sequence).astype(np.uint16) % 4096


def send(bus, codec, sequences):
    """Send frames; returns the number of messages."""
    messages = [each for n in sequences for each in codec.encode(counts_of(codec, n), n, 0.0)]
    for each in messages:
        bus.send(each)
    return len(messages)


def test_extended_ids_and_every_length_of_fd(bus):
    sender, reader = bus(fd=True), bus(fd=True)
    for length in (0, 1, 8, 12, 16, 20, 24, 32, 48, 64):
        message = Message(0.0, 0x18FF0000 + length, bytes(range(length)), extended=True, fd=True)
        sender.send(message)
        assert reader.receive(1.0)._replace(time=0.0) == message


def test_a_classic_interface_refuses_fd_in_one_line(bus):
    with pytest.raises(BusError, match=r"^bus socketcan vcan0: [^\n]*$"):
        bus().send(Message(0.0, 0x500, bytes(64), fd=True))


def test_the_kernel_passes_only_the_ids_of_sensors(bus):
    settings = only({"interface": "socketcan", "channel": "vcan0"}, CODEC.ids | {(0x18FF0000, True)})
    reader, sender = open_bus(**settings), bus()
    try:
        for id_, extended in ((0x123, False), (0x500, True), (0x500, False), (0x18FF0000, True)):
            sender.send(Message(0.0, id_, b"\1", extended))
        got = [reader.receive(1.0), reader.receive(1.0)]
        assert [(each.id, each.extended) for each in got] == [(0x500, False), (0x18FF0000, True)]
        assert reader.receive(0.3) is None
    finally:
        reader.close()


def test_messages_that_the_kernel_drops_are_counted_to_the_last(bus):
    reader, sender = bus(), bus()
    assert reader._bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= BUFFER_BYTES
    reader._bus.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    count = send(sender, CODEC, range(100))
    dropped, router, frames, received = reader.dropped, Router({"palm": CODEC}), [], 0

    def take():
        nonlocal frames, received
        while (message := reader.receive(0.3)) is not None:
            received += 1
            frames += [frame for _, frame in router.push(message)]

    take()
    assert dropped > 200
    assert dropped + received == count
    send(sender, CODEC, [100])  # after it the sequence numbers show what was lost before
    take()
    assert router.assemblers["palm"].loss.lost == dropped
    assert frames[-1].sequence == 100
    for frame in frames:
        arrived = frame.flags == 0
        np.testing.assert_array_equal(frame.counts[arrived], counts_of(CODEC, frame.sequence)[arrived])


@pytest.mark.parametrize("fd", [False, True])
def test_a_batch_of_messages_is_what_python_can_reads_one_by_one(bus, fd):
    sender, reader, other = bus(fd), bus(fd), bus(fd)
    for n in range(600):
        extended = n % 2 == 1
        sender.send(Message(0.0, n + (extended << 20), bytes([n % 256]) * (n % 9), extended, fd and n % 3 == 0))
    messages = []
    while batch := reader.batch(0.5):
        messages += batch
    single = [other.frame(1.0) for _ in range(600)]
    assert messages == [
        Message(each.timestamp, each.arbitration_id, bytes(each.data), each.is_extended_id, each.is_fd)
        for each in single
    ]


def test_the_kernels_filters_follow_a_reload(bus, until, tmp_path):
    def write(*ids):
        sensors = [PALM.replace("palm", f"s{each}").replace("fd = true", f"array_id = {each}") for each in ids]
        path.write_text('[bus.can0]\ninterface = "socketcan"\nchannel = "vcan0"\n' + "".join(sensors))

    path = tmp_path / "palm.toml"
    write(0)
    service, sender = Service(load(path), path=path), bus()

    def show(number):
        sensor = service.sensor(f"s{number}")
        before = sensor.hub.latest()
        send(sender, sensor.codec, [before.sequence + 1 if before else 0])
        until(lambda: sensor.hub.latest() is not before)

    with service.running():
        show(0)
        write(0, 1)
        service.reload()
        until(lambda: service.sensor("s1").clock == "kernel")  # the bus's thread has taken it
        show(1)
        write(0)
        service.reload()
        until(lambda: len(service._sources["can0"]._router.ids) == 1)
        send(sender, Packed(16, array_id=1), range(3))
        show(0)
        loss = service.sensor("s0").status().loss
        assert (loss.foreign, loss.lost, loss.unsent) == (0, 0, 0)
