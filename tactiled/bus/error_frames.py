"""What SocketCAN's error frames report, by the kernel's `linux/can/error.h`; pure."""

BUS_OFF, RESTARTED = "bus_off", "restarted"
CLASSES = {
    0x001: "tx_timeout",
    0x002: "lost_arbitration",
    0x008: "protocol",
    0x010: "transceiver",
    0x020: "no_ack",
    0x040: BUS_OFF,
    0x080: "bus_error",
    0x100: RESTARTED,
}  # bits of the id
CONTROLLER = 0x004  # the bit of the id with which byte 1 of the data reports more
STATES = {
    0x01: "rx_overflow",
    0x02: "tx_overflow",
    0x04: "rx_warning",
    0x08: "tx_warning",
    0x10: "rx_passive",
    0x20: "tx_passive",
    0x40: "active",
}  # bits of that byte
OTHER = "other"  # none of these, or the interface does not report which
KINDS = (*CLASSES.values(), *STATES.values(), "controller", OTHER)


def kinds(id_: int, data: bytes) -> tuple[str, ...]:
    """Every kind, of KINDS, that an error frame reports."""
    reported = [kind for bit, kind in CLASSES.items() if id_ & bit]
    if id_ & CONTROLLER:
        states = data[1] if len(data) > 1 else 0
        reported += [kind for bit, kind in STATES.items() if states & bit] or ["controller"]
    return tuple(reported) or (OTHER,)
