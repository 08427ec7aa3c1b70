"""Live images in Rerun's viewer: the newest at most IMAGES_PER_S, as soon as a viewer listens."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING

from tactiled.errors import ConfigError
from tactiled.frames import Image
from tactiled.runtime.service import Service

if TYPE_CHECKING:
    from rerun import RecordingStream

IMAGES_PER_S = 30.0  # of each sensor; the viewer keeps all of them in memory
FLUSH_IMAGES = 10  # from one flush to the next, which shows whether the viewer is still there
FLUSH_S = 5.0  # that the viewer may take for it
RETRY_S = 1.0  # from one look for a viewer to the next
STOP_S = 1.0  # that the thread has to end; one that waits for a viewer which hangs is left behind


@contextmanager
def to_viewer(service: Service, port: int | None) -> Iterator[None]:
    """Show the images meanwhile in the viewer that listens on a port of loopback; None: do not."""
    if port is not None and not find_spec("rerun"):
        raise ConfigError("--rerun needs Rerun's SDK: pip install 'tactiled[rerun]'")
    ended = threading.Event()

    def work() -> None:
        while not ended.wait(RETRY_S):
            with service.faults.turn("rerun"):
                if port is not None and _listens(port):
                    _show(service, port, ended)

    thread = threading.Thread(target=work, name="rerun", daemon=True)
    if port is not None:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if port is not None:
            thread.join(STOP_S)


def _listens(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), RETRY_S):
        return True
    return False


def _show(service: Service, port: int, ended: threading.Event) -> None:
    """Send images until the viewer is gone, or sensors or their calibration have changed."""
    from tactiled.interop import rerun_images

    sensors = service.sensors
    plans = {name: sensor.plan for name, sensor in sensors.items()}
    stream = rerun_images.new_stream()
    stream.connect_grpc(
        f"rerun+http://127.0.0.1:{port}/proxy", default_blueprint=rerun_images.blueprint(plans.values())
    )
    logs = {name: rerun_images.SensorLog(stream, plan) for name, plan in plans.items()}
    newest: dict[str, Image] = {}
    ticks = 0
    try:
        while not ended.wait(1 / IMAGES_PER_S):
            if service.sensors is not sensors or any(sensors[name].plan is not plans[name] for name in plans):
                return
            for name, log in logs.items():
                image, contacts = sensors[name].contacts()
                if image is not None and image is not newest.get(name) and image.unit == plans[name].unit:
                    newest[name] = image
                    log.add(image, contacts)
            ticks += 1
            if ticks % FLUSH_IMAGES == 0 and not _flushed(stream):
                return
    finally:
        stream.disconnect()


def _flushed(stream: "RecordingStream") -> bool:
    """Whether the viewer has taken all; False if it is gone, or hangs."""
    with suppress(RuntimeError):
        stream.flush(timeout_sec=FLUSH_S)
        return True
    return False
