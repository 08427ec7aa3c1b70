"""`tactiled demo`: the whole service without hardware, over python-can's virtual bus."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from secrets import token_urlsafe
from threading import Event, Thread
from typing import Annotated

import typer
from pydantic import SecretStr
from threadpoolctl import threadpool_limits

from tactiled.bus import recording
from tactiled.bus.reader import Reader, open_bus
from tactiled.cli import options
from tactiled.cli.app import stoppable
from tactiled.cli.simulate import simulated
from tactiled.config import Config, Server, parse, validated
from tactiled.config.example import EXAMPLE, GRASP, SHEAR
from tactiled.config.schema import LOOPBACK
from tactiled.errors import ConfigError
from tactiled.runtime.service import Service
from tactiled.simulate import play
from tactiled.web.server import serve

NOISE_KPA = 0.2  # of a simulated taxel
REAL_BUS, VIRTUAL_BUS = (
    f'interface = "{interface}"\nchannel = "{channel}"'
    for interface, channel in (("socketcan", "can0"), ("virtual", "demo"))
)
Source = Callable[[Reader, Event], object]


def demo(
    scene: Annotated[str, typer.Option(help="What touches the array: tour, or one scene.")] = "tour",
    record: Annotated[
        str | None,
        typer.Option("--recording", help="Play a real recording instead: " + ", ".join(recording.names())),
    ] = None,
    shear: Annotated[
        bool, typer.Option("--shear", help="Simulate a 3-axis skin instead, 4 x 6 taxels; its shear is made up.")
    ] = False,
    rate_hz: Annotated[float, typer.Option(help="Frames a second.", min=0.1, max=1000)] = 100.0,
    host: Annotated[str, typer.Option(help="Address to serve on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to serve on; 0: any free one.", min=0, max=65535)] = 8000,
    foxglove: options.Foxglove = None,
    _: options.LogFormat = "console",
) -> None:
    """Simulate a covered array, or play a real recording, and serve it live; needs no hardware."""
    config = demo_config(record, shear)
    with threadpool_limits(1):
        service = Service(config)
        source = _source(record, config, scene, rate_hz)
        with stoppable(), running(service, config, source):
            serve(service, _server(host, port, foxglove))


def _source(record: str | None, config: Config, scene: str, rate_hz: float) -> Source:
    """What sends frames on the bus until an event."""
    if record:
        path = recording.path(record)
        return lambda sender, stop: recording.play(path, sender.send, stop, loop=True)
    (sensor,) = config.sensor.values()
    source = simulated(sensor, scene, NOISE_KPA)
    return lambda sender, stop: play(source.messages, sender.send, rate_hz, stop)


def _server(host: str, port: int, foxglove: int | None) -> Server:
    """Where to serve; beyond loopback with a token made for this run."""
    token = None if host in LOOPBACK else SecretStr(token_urlsafe(12))
    if token:
        print(f"tactiled: other machines open http://{host}:{port}/?token={token.get_secret_value()}")
    address = {"host": host, "port": port, "foxglove": foxglove, "control_token": token}
    return validated(Server, address, f"--foxglove {foxglove}")


def demo_config(record: str | None = None, shear: bool = False) -> Config:
    """The configuration that `tactiled init` writes, of a recorded grasp or of a 3-axis skin, on a virtual bus."""
    if record and shear:
        raise ConfigError(f"--shear: recording {record} has none: leave one of the two out")
    text = GRASP if record else SHEAR if shear else EXAMPLE
    return parse(text.replace(REAL_BUS, VIRTUAL_BUS), "demo")


@contextmanager
def running(service: Service, config: Config, source: Source) -> Iterator[None]:
    """Run the service with a sender on its bus."""
    stop = Event()
    (bus,) = config.bus.values()
    sender = open_bus(**bus.settings())
    thread = Thread(target=source, args=(sender, stop), name="sender", daemon=True)
    with closing(sender), service.running():
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
