import pytest

from tactiled.bus.faults import KINDS, kinds


def data(state=0):
    return bytes((0, state, 0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("id_", "state", "expected"),
    [
        (0x001, 0, ("tx_timeout",)),
        (0x002, 0, ("lost_arbitration",)),
        (0x004, 0x01, ("rx_overflow",)),
        (0x004, 0x02, ("tx_overflow",)),
        (0x004, 0x04, ("rx_warning",)),
        (0x004, 0x08, ("tx_warning",)),
        (0x004, 0x10, ("rx_passive",)),
        (0x004, 0x20, ("tx_passive",)),
        (0x004, 0x40, ("active",)),
        (0x004, 0x00, ("controller",)),
        (0x008, 0, ("protocol",)),
        (0x010, 0, ("transceiver",)),
        (0x020, 0, ("no_ack",)),
        (0x040, 0, ("bus_off",)),
        (0x080, 0, ("bus_error",)),
        (0x100, 0, ("restarted",)),
        (0x000, 0, ("other",)),
        (0x200, 0, ("other",)),  # its counters alone
    ],
)
def test_every_class_of_error_has_its_kind(id_, state, expected):
    assert kinds(id_, data(state)) == expected
    assert set(expected) <= set(KINDS)


def test_a_frame_that_tells_of_several_counts_for_each():
    # no acknowledgement on a bus of one node, as a controller on its way to bus-off tells it
    assert set(kinds(0x2AC, data(0x28))) == {"tx_warning", "tx_passive", "protocol", "no_ack", "bus_error"}


def test_a_state_is_looked_for_only_where_the_frame_says_there_is_one():
    assert kinds(0x088, data(0x7F)) == ("protocol", "bus_error")


def test_a_frame_without_data_is_no_error_of_ours():
    assert kinds(0x004, b"") == ("controller",)


def test_every_kind_is_listed_once():
    assert len(KINDS) == len(set(KINDS)) == 17
