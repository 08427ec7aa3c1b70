"""The private names of python-can, held against the version that is installed."""

import inspect
from threading import Thread

from can.interfaces.socketcan import SocketcanBus

from tactiled.bus.canbus import Bus, CanMessage, can_message, filters_in_kernel, receive
from tactiled.bus.reader import open_bus
from tactiled.frames import Message
from tests.conftest import BUSY_S


def test_receive_gives_what_the_filters_pass_and_nothing_after_its_time(request):
    only = [{"can_id": 0x100, "can_mask": 0x7FF, "extended": False}]
    with (
        Bus(interface="virtual", channel=request.node.name, can_filters=only) as bus,
        Bus(interface="virtual", channel=request.node.name) as sender,
    ):
        for id_ in (0x101, 0x100):
            sender.send(CanMessage(arbitration_id=id_, is_extended_id=False))
        assert receive(bus, 5.0).arbitration_id == 0x100
        assert receive(bus, 0.01) is None
        assert not filters_in_kernel(bus)
        assert "self._is_filtered = " in inspect.getsource(SocketcanBus)


def test_a_reader_that_ends_with_a_full_queue_holds_up_no_sender(request):
    bus = {"interface": "virtual", "channel": request.node.name, "rx_queue_size": 2}
    reader = open_bus(**bus)
    with Bus(**bus) as sender:
        sending = Thread(target=lambda: [sender.send(CanMessage()) for _ in range(8)], daemon=True)
        sending.start()
        while not reader._bus.queue.full():
            sending.join(0.01)
        reader.close()
        sending.join(BUSY_S)
        assert not sending.is_alive()


def test_a_virtual_bus_passes_on_a_message_that_is_sent_without_a_copy(request):
    with (
        Bus(interface="virtual", channel=request.node.name) as bus,
        Bus(interface="virtual", channel=request.node.name) as sender,
    ):
        message = can_message(Message(1.0, 0x100, bytes(64), extended=False, fd=True))
        sender.send(message)
        assert receive(bus, 5.0) is message
