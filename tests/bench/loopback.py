"""`tactiled` whose SocketCAN buses are sockets of loopback, a port each, and what sends to them."""

import socket
import tempfile
import threading
import time
from contextlib import contextmanager
from pathlib import Path

from tactiled.bench.load import FrameSocket
from tactiled.bench.load_ends import CAN_FRAME
from tactiled.bench.results import machine
from tactiled.live import bus_thread
from tests.bench.sensors import SENSOR, recorded
from tests.process import Running

SIDE = 32
CONFIG = """\
[server]
port = 0
control_per_minute = 0
state = "{folder}/state.json"
[bus.b0]
interface = "socketcan"
channel = "{port}"
fd = true
"""


@contextmanager
def sending(sensors, rate_hz):
    """Send the frames of some arrays; gives the configuration file of a service that reads them."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port, config, stop = one.getsockname()[1], Path(folder) / "tactiled.toml", threading.Event()
        one.close()
        tables = [SENSOR.format(number=n, bus=0, id=0x100 + 4 * n, side=SIDE) for n in range(sensors)]
        config.write_text(CONFIG.format(folder=folder, port=port) + "".join(tables))
        sender = threading.Thread(target=_send, args=(port, sensors, rate_hz, stop), daemon=True)
        sender.start()
        try:
            yield config
        finally:
            stop.set()
            sender.join()


def heading(sensors, rate_hz):
    """What is measured, and on what."""
    return f"{machine()}; {sensors} sensors of {SIDE} x {SIDE} at {rate_hz:g} Hz"


def run(config):
    """A service of such a configuration."""
    return Running(config, module="tests.bench.loopback")


def _send(port, sensors, rate_hz, stop):
    """Send every sensor's frames, encoded once: 256 frames, and their sequence numbers begin again."""
    frames = [
        [CAN_FRAME.pack(0x100 + 4 * number, len(data), data) for data in messages]
        for number in range(sensors)
        for messages in recorded(SIDE)[:256]
    ]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        began, n = time.monotonic(), 0
        while not stop.wait(max(0.0, began + n / rate_hz / sensors - time.monotonic())):
            number, at = n % sensors, n // sensors % 256
            for each in frames[256 * number + at]:
                out.sendto(each, ("127.0.0.1", port))
            n += 1


if __name__ == "__main__":
    from tactiled.cli import main

    bus_thread.open_bus = lambda channel, **_: FrameSocket(int(channel))
    main()
