"""Boards that answer as the public sources of their protocols say, and refuse what these do not send."""

from tactiled.bus.polling import Poller
from tactiled.bus.router import Router
from tactiled.frames import Message


def frames_of(codec, board, seconds):
    """The frames that a board sends to whoever starts and asks it as the codec says, for so long."""
    poller, router, frames, now = Poller([codec.polling]), Router({"it": codec}), [], 0.0

    def send(message):
        for each in board.receive(message):
            frames.extend(frame for _, frame in router.push(each._replace(time=now)))

    poller.start(now)
    while now <= seconds:
        poller.send_due(send, now)
        now += poller.wait_s(now)
    poller.stop(send)
    loss = router.assemblers["it"].loss
    assert (loss.malformed, loss.foreign) == (0, 0)
    return frames


class Mtb:
    """An MTB board: icub-firmware, embot/app/embot_app_application_theSkin.cpp and embot/prot/can."""

    def __init__(self, board, pressed):
        """`pressed`: how much the converter's readings (12,) of a triangle exceed those at rest."""
        self.board, self.pressed, self.sends = board, pressed, False
        self.type, self.no_load, self.shifts = 0, 245, dict.fromkeys(pressed, 2)

    def receive(self, message):
        assert (message.id, message.extended, message.fd) == (0x200 | self.board, False, False)
        command, *rest = message.data
        if command == 0x4D:
            self.type, _, self.no_load = rest
        elif command == 0x50:
            first, last, shift, enabled, _, _ = rest
            assert first <= last < 16
            assert enabled == 1
            self.shifts.update((each, shift) for each in range(first, last + 1))
            self.sends = False
        else:
            assert command == 0x07
            self.sends = rest == [0]
            return [each for triangle in self.pressed for each in self._frame(triangle)] if self.sends else []
        return []

    def _frame(self, triangle):
        shift, values, code = self.shifts[triangle], [], 0
        top, bottom = (255 - self.no_load) << shift, self.no_load << shift
        for pad, value in enumerate(self.pressed[triangle]):
            inside = 255 if value <= -top else 0 if value >= bottom else self.no_load - (value >> shift)
            values.append(inside)
            code |= (value <= -2 * top or value >= 2 * bottom) << (4 + pad)
        id_ = 0x400 | self.board << 4 | triangle
        yield Message(0.0, id_, bytes((0x40, *values[:7])))
        yield Message(0.0, id_, bytes((0xC0, *values[7:], *code.to_bytes(2))))


class LinkerHand:
    """A hand on classic CAN: linkerbot 0.5.4, hand/l6 and hand/o6; linkerhand-ros2-sdk, linker_hand_g20_can.py."""

    def __init__(self, id_, matrices):
        """`matrices` (rows, columns) by finger; 6 is the palm of a G20."""
        self.id, self.matrices = id_, matrices

    def receive(self, message):
        assert (message.id, message.extended, message.fd) == (self.id, False, False)
        finger, request = message.data[0], message.data[1:]
        matrix = self.matrices[finger - 0xB0]
        rows, columns = matrix.shape
        if len(request) == 1:
            assert request[0] == {(12, 6): 0xC6, (10, 4): 0xA4}[matrix.shape]
            return [self._reply(finger, n << 4, *row) for n, row in enumerate(matrix)]
        assert tuple(request) == (rows, columns, 1)
        flat, total = matrix.ravel(), min(int(matrix.sum()), 0xFFFF).to_bytes(2, "little")
        starts = range(0, flat.size, 5)
        replies = [self._reply(finger, at // columns, at % columns, *flat[at : at + 5]) for at in starts]
        return [*replies, self._reply(finger, 0xFF, *total)]

    def _reply(self, *data):
        return Message(0.0, self.id, bytes(data))


class LinkerO20:
    """A hand on CAN FD: linkerhand-o20-ros2, core/canfd/linker_hand_o20_canfd.py."""

    def __init__(self, device, matrices):
        """`matrices` (12, 6) by finger."""
        self.device, self.matrices = device, matrices

    def receive(self, message):
        device, register, rest = message.id >> 21, message.id >> 13 & 0xFF, message.id & 0x1FFF
        assert (device, rest, message.data) == (self.device, 0, b"")
        assert message.extended
        assert message.fd
        finger, second = divmod(register - 0x09, 2)
        data = b"\x01" + self.matrices[finger + 1].tobytes()
        return [message._replace(data=data[64:].ljust(12, b"\0") if second else data[:64])]


class LinkerL30Hand:
    """A hand on CAN FD: linkerhand-l30-sdk, core/linker_hand_l30_v6_2_canfd.py (get_finger_touch)."""

    def __init__(self, node, matrices):
        """`matrices` (12, 6) by finger."""
        self.node, self.matrices = node, matrices

    def receive(self, message):
        priority_access_parent, finger = message.id >> 21, message.id >> 13 & 0xFF
        destination, source, reserved = message.id >> 8 & 0x1F, message.id >> 3 & 0x1F, message.id & 7
        assert (priority_access_parent, destination, source, reserved) == (2, self.node, 0, 0)
        assert (message.data, message.extended, message.fd) == (bytes(2), True, True)
        taxels = self.matrices[finger].tobytes()
        id_ = 2 << 21 | finger << 13 | self.node << 3
        for number, part in enumerate((taxels[:61], taxels[61:])):
            data = bytes((len(part), 1 << 4 | number, 0)) + part
            yield Message(0.0, id_, data.ljust(16 if number else 64, b"\0"), True, True)


class TactilePuck:
    """A pad of a BarrettHand: libbarrett, src/products/tactile_puck.cpp and include/barrett/products/detail."""

    def __init__(self, node, cells):
        """`cells` (24,) of 12 bits."""
        self.node, self.cells, self.format = node, [*cells, 0], 0

    def receive(self, message):
        assert (message.id, message.extended, message.fd) == (self.node, False, False)
        if message.data[0] & 0x80:
            assert (message.data[:2], len(message.data)) == (b"\xea\x00", 6)  # TACT is property 106
            self.format = int.from_bytes(message.data[2:], "little")
        else:
            assert message.data == b"\x6a"
        assert self.format == 2
        rows = [self.cells[5 * n : 5 * n + 5] for n in range(5)]
        words = [sum(each << 12 * (4 - at) for at, each in enumerate(row)) | n << 60 for n, row in enumerate(rows)]
        return [Message(0.0, 0x409 | self.node << 5, each.to_bytes(8)) for each in words]


class OmniHand2025:
    """A hand on CAN FD: Omnihand-2025-SDK, src/proto.h and c_agibot_hand_can.cc; replies bear the request's id."""

    def __init__(self, device, parts):
        """`parts`: the taxels of each, as they are in its message."""
        self.device, self.parts = device, parts

    def receive(self, message):
        part, kind, product, device = message.id.to_bytes(4)
        assert (kind, product, device, message.data) == (5, 1, self.device, bytes(64))
        assert message.extended
        assert message.fd
        return [message._replace(data=self.parts[part].ljust(64, b"\0"))]


class XelaOlder:
    """A 4 x 4 board of an older generation, whose ids community drivers show; it sends once it is started."""

    def __init__(self, controller, axes):
        """`axes`: X, Y and Z (16, 3) of its taxels."""
        self.controller, self.axes, self.sends = controller, axes, False

    def receive(self, message):
        assert (message.id, message.extended, message.fd) == (0x200 | self.controller, False, False)
        assert message.data in (b"\x07\x00", b"\x07\x01")
        self.sends = message.data == b"\x07\x00"
        taxels = enumerate(self.axes) if self.sends else ()
        return [Message(0.0, 0x100 | n // 4 << 4 | n % 4, b"\x83" + row.tobytes() + b"\0") for n, row in taxels]
