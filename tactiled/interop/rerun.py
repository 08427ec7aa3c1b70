"""Live images in Rerun's viewer: the newest at most IMAGES_PER_S, as soon as a viewer listens."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec

from tactiled.errors import ConfigError
from tactiled.frames import SensorImage
from tactiled.live.service import Service
from tactiled.web.bridge import Bridge, Host

IMAGES_PER_S = 30.0  # of each sensor; the viewer keeps all of them in memory
FLUSH_IMAGES = 10  # from one flush to the next, which shows whether the viewer is still there
FLUSH_S = 5.0  # that the viewer may take for it
RETRY_S = 1.0  # from one look for a viewer to the next
STOP_S = 1.0  # that the thread has to end; one that waits for a viewer which hangs is left behind


class Rerun(Bridge):
    """Shows the images in the viewer that listens on a port of loopback, whenever there is one."""

    def __init__(self, port: int) -> None:
        self._port = port

    @contextmanager
    def running(self, host: Host) -> Iterator[None]:
        """Show meanwhile."""
        if not find_spec("rerun"):
            raise ConfigError("--rerun needs Rerun's SDK: pip install 'tactiled[rerun]'")
        ended = threading.Event()

        def work() -> None:
            while not ended.wait(RETRY_S):
                with host.service.faults.turn("rerun"), suppress(OSError):  # no viewer is running
                    socket.create_connection(("127.0.0.1", self._port), RETRY_S).close()
                    _show(host.service, self._port, ended)

        thread = threading.Thread(target=work, name="rerun", daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join(STOP_S)


def _show(service: Service, port: int, ended: threading.Event) -> None:
    """Send images until the viewer is gone, or sensors or their calibration have changed."""
    from tactiled.messages import rerun as rerun_images

    sensors, stream, ticks = service.sensors, rerun_images.new_stream(), 0
    plans, newest = {name: sensor.plan for name, sensor in sensors.items()}, dict[str, SensorImage]()
    screen = rerun_images.blueprint(plans.values())
    stream.connect_grpc(f"rerun+http://127.0.0.1:{port}/proxy", default_blueprint=screen)
    logs = {name: rerun_images.SensorLog(stream, plan) for name, plan in plans.items()}
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
            if ticks % FLUSH_IMAGES == 0:
                with suppress(RuntimeError):  # the viewer is gone, or hangs
                    stream.flush(timeout_sec=FLUSH_S)
                    continue
                return
    finally:
        stream.disconnect()
