"""Every skin that must be asked or started, on SocketCAN, by boards that check what they are sent."""

import threading
from contextlib import contextmanager

import numpy as np

from tactiled.config import parse
from tactiled.live.service import Service
from tests.bus.boards import LinkerHand, LinkerL30Hand, LinkerO20, Mtb, OmniHand2025, TactilePuck, XelaOlder

CODECS = {
    "icub": ("vcan0", 'name = "icub", board = 13, triangles = [5], start = true, shift = 1', ""),
    "barrett": ("vcan0", 'name = "barrett", node = 11, poll_hz = 10', "rows = 8, columns = 3, pitch_mm = 3.0"),
    "l6": ("vcan0", 'name = "linker", hand = "right", poll_hz = 5', "rows = 12, columns = 6, pitch_mm = 2.0"),
    "o6": (
        "vcan0",
        'name = "linker", hand = "left", poll_hz = 5, layout = "10x4"',
        "rows = 10, columns = 4, pitch_mm = 2.0",
    ),
    "xela": (
        "vcan0",
        'name = "xela", profile = "4x4-old", controller = 3, start = true',
        "rows = 4, columns = 4, pitch_mm = 4.0",
    ),
    "o20": (
        "vcan1",
        'name = "linker", hand = "right", poll_hz = 5, layout = "o20"',
        "rows = 12, columns = 6, pitch_mm = 2.0",
    ),
    "l30": ("vcan1", 'name = "linker_l30", node = 2, poll_hz = 5', "rows = 12, columns = 6, pitch_mm = 2.0"),
    "omnihand": ("vcan1", 'name = "omnihand", device = 3, poll_hz = 5', "rows = 8, columns = 2, pitch_mm = 3.0"),
}
BUSES = """
[bus.vcan0]
interface = "socketcan"
channel = "vcan0"
[bus.vcan1]
interface = "socketcan"
channel = "vcan1"
fd = true
"""
SENSOR = """
[sensor.{name}]
bus = "{bus}"
method = "raw"
codec = {{ {codec} }}
array = {{ {array} }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
"""
CONFIG = BUSES + "".join(
    SENSOR.format(name=name, bus=bus, codec=codec, array=array) for name, (bus, codec, array) in CODECS.items()
)


@contextmanager
def answering(reader, boards):
    """Boards by the id of what they are sent answer meanwhile; what fails in one of them is raised."""
    stop, errors = threading.Event(), []

    def work():
        try:
            while not stop.is_set():
                if message := reader.receive(0.05):
                    for each in boards[message.id].receive(message._replace(time=0.0)):
                        reader.send(each)
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
    if errors:
        raise errors[0]


def test_every_board_gets_what_its_source_says_and_its_frame_is_read(bus, until):
    rng = np.random.default_rng(7)
    l6, o20, l30 = rng.integers(0, 256, (3, 12, 6), np.uint8)
    o6, finger = rng.integers(0, 256, (10, 4), np.uint8), rng.integers(0, 256, 16, np.uint8)
    cells, axes = rng.integers(0, 0x1000, 24), rng.integers(0, 1 << 16, (16, 3)).astype(">u2")
    mtb, xela = Mtb(13, {5: [200, 100, 50, *[0] * 9]}), XelaOlder(3, axes)
    classic = {
        0x20D: mtb,
        0x0B: TactilePuck(11, cells.tolist()),
        0x27: LinkerHand(0x27, {1: l6}),
        0x28: LinkerHand(0x28, {1: o6}),
        0x203: xela,
    }
    device = 1  # of a right hand
    fd = {device << 21 | register << 13: LinkerO20(device, {1: o20}) for register in (9, 10)}
    fd[2 << 21 | 1 << 13 | 2 << 8] = LinkerL30Hand(2, {1: l30})
    fd[1 << 24 | 5 << 16 | 1 << 8 | 3] = OmniHand2025(3, {1: finger.tobytes()})
    expected = {
        "icub": [140, 190, 215, *[240] * 7],
        "barrett": cells,
        "l6": l6.ravel(),
        "o6": o6.ravel(),
        "xela": axes[:, 2],
        "o20": o20.ravel(),
        "l30": l30.ravel(),
        "omnihand": finger.reshape(8, 2)[::-1].ravel(),  # the last row comes first
    }
    service = Service(parse(CONFIG))
    with answering(bus(), classic), answering(bus(fd=True), fd):
        with service.running():
            for name, counts in expected.items():
                sensor = service.sensor(name)
                until(lambda sensor=sensor: sensor.newest is not None and not sensor.newest.flags.any(), 30.0)
                np.testing.assert_array_equal(sensor.newest.counts, counts, name)
                assert sensor.status().loss.malformed == 0
        until(lambda: not (mtb.sends or xela.sends), 10.0)
