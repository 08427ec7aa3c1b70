import pytest

from tactiled.bus.socketcan import KINDS, error_kinds

# Bits of linux/can/error.h: of the id, and of byte 1 of the data.
CLASSES = {
    0: "tx_timeout", 1: "lost_arbitration", 3: "protocol", 4: "transceiver", 5: "no_ack", 6: "bus_off",
    7: "bus_error", 8: "restarted",
}  # fmt: skip
STATES = ("rx_overflow", "tx_overflow", "rx_warning", "tx_warning", "rx_passive", "tx_passive", "active")


def data(state):
    return bytes((0, state, 0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("id_", "data", "expected"),
    [
        *((1 << bit, data(0), {kind}) for bit, kind in CLASSES.items()),
        *((0x004, data(1 << bit), {kind}) for bit, kind in enumerate(STATES)),
        (0x004, data(0), {"controller"}),
        (0x004, b"", {"controller"}),
        (0x000, data(0), {"other"}),
        (0x200, data(0), {"other"}),  # its counters alone
        (0x088, data(0x7F), {"protocol", "bus_error"}),  # no bit that says there is a state
        # no acknowledgement on a bus of one node, as a controller on its way to bus-off reports it
        (0x2AC, data(0x28), {"tx_warning", "tx_passive", "protocol", "no_ack", "bus_error"}),
    ],
)
def test_an_error_frame_has_its_error_kinds(id_, data, expected):
    assert set(error_kinds(id_, data)) == expected
    assert expected <= set(KINDS)
    assert len(KINDS) == len(set(KINDS)) == 17
