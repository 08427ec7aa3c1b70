import pytest

from tactiled.bus.error_frames import KINDS, kinds


def data(state):
    return bytes((0, state, 0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("id_", "data", "expected"),
    [
        (0x001, data(0), {"tx_timeout"}),
        (0x002, data(0), {"lost_arbitration"}),
        (0x004, data(0x01), {"rx_overflow"}),
        (0x004, data(0x02), {"tx_overflow"}),
        (0x004, data(0x04), {"rx_warning"}),
        (0x004, data(0x08), {"tx_warning"}),
        (0x004, data(0x10), {"rx_passive"}),
        (0x004, data(0x20), {"tx_passive"}),
        (0x004, data(0x40), {"active"}),
        (0x004, data(0), {"controller"}),
        (0x004, b"", {"controller"}),
        (0x008, data(0), {"protocol"}),
        (0x010, data(0), {"transceiver"}),
        (0x020, data(0), {"no_ack"}),
        (0x040, data(0), {"bus_off"}),
        (0x080, data(0), {"bus_error"}),
        (0x100, data(0), {"restarted"}),
        (0x000, data(0), {"other"}),
        (0x200, data(0), {"other"}),  # its counters alone
        (0x088, data(0x7F), {"protocol", "bus_error"}),  # no bit that says there is a state
        # no acknowledgement on a bus of one node, as a controller on its way to bus-off reports it
        (0x2AC, data(0x28), {"tx_warning", "tx_passive", "protocol", "no_ack", "bus_error"}),
    ],
)
def test_an_error_frame_has_its_kinds(id_, data, expected):
    assert set(kinds(id_, data)) == expected
    assert expected <= set(KINDS)
    assert len(KINDS) == len(set(KINDS)) == 17
