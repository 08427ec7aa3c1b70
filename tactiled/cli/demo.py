"""`tactiled demo`: the whole service without hardware, over python-can's virtual bus."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from secrets import token_urlsafe
from shutil import copy
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Annotated

import typer
from pydantic import SecretStr
from threadpoolctl import threadpool_limits

from tactiled import logs
from tactiled.bus import recording
from tactiled.bus.canbus import can_message
from tactiled.bus.reader import Reader, open_bus
from tactiled.bus.recorder import Recorder
from tactiled.cli import options
from tactiled.cli.app import stoppable
from tactiled.cli.simulate import simulated
from tactiled.config import Config, Server, parse, validated
from tactiled.config.example import DEMO, GRASP, SHEAR
from tactiled.config.schema import LOOPBACK
from tactiled.errors import ConfigError
from tactiled.frames import Message
from tactiled.interop.bridges import configured
from tactiled.live.events import Event as Happening
from tactiled.live.service import Service
from tactiled.simulate import SCENES, Player, check_scene, play
from tactiled.web.app import create
from tactiled.web.server import need_address, serve

NOISE_KPA = 0.2  # of a simulated taxel
REAL_BUS, VIRTUAL_BUS = (
    f'interface = "{interface}"\nchannel = "{channel}"'
    for interface, channel in (("socketcan", "can0"), ("virtual", "demo"))
)
VIRTUAL_BUS += (
    "\nrx_queue_size = 128"  # messages: the sender waits for the service, so that none is old when it is read
)
OPENING = {"palm": "touch", "skin": "sphere"}  # the scene of each sensor, unless one is chosen
RECORDED = ("empty", 1.0), ("fingertip", 5.0)  # scenes of the recording to play, and how long, s
RECORDED_HZ, LEAVE_MB = 50.0, 100.0
# What a guided calibration asks for is what then touches the simulated array, after a pause without a load.
GUIDED = {"tip": ("tip",), "edge": ("straightedge",), "blind": ("indenters", "edge"), "uniform": ("steps",)}
UNLOADED_S = 1.0
END_S = 5.0  # that the sender may take to end
Source = Callable[[Reader, Event], object]


def demo(
    scene: Annotated[
        str | None,
        typer.Option(help=f"What touches the arrays: tour, {', '.join(SCENES)}; left out: touch and sphere."),
    ] = None,
    record: Annotated[
        str | None,
        typer.Option("--recording", help="Play a real recording instead: " + ", ".join(recording.names())),
    ] = None,
    shear: Annotated[
        bool, typer.Option("--shear", help="Simulate a 3-axis skin instead, 4 x 6 taxels; its shear is made up.")
    ] = False,
    rate_hz: Annotated[float, typer.Option(help="Frames a second.", min=0.1, max=1000)] = 60.0,
    host: Annotated[str, typer.Option(help="Address to serve on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to serve on; 0: any free one.", min=0, max=65535)] = 8000,
    foxglove: options.Foxglove = None,
    _: options.LogFormat = "console",
) -> None:
    """Simulate a covered array, or play a real recording, and serve it live; needs no hardware."""
    config = demo_config(record, shear)
    with threadpool_limits(1), TemporaryDirectory(prefix="tactiled-demo-", ignore_cleanup_errors=True) as folder:
        server = _server(host, port, foxglove, folder)
        need_address(server)
        check_scene(scene or "tour")
        service = Service(config, report=logs.progress)
        source = _source(record, service, scene, rate_hz, Path(folder))
        logs.announce(f"recordings go to {folder}, which is removed at the end")
        with stoppable(), running(service, config, source):
            serve(create(service, server, configured(server)), server)


def _source(record: str | None, service: Service, scene: str | None, rate_hz: float, folder: Path) -> Source:
    """The function that sends frames until an event is set; it puts a recording to play into `folder`."""
    if not record:
        return simulation(service, scene, rate_hz, folder)
    path = recording.path(record)
    copy(path, folder)
    return lambda sender, stop: recording.play(path, sender.send, stop, loop=True)


def simulation(service: Service, scene: str | None, rate_hz: float, folder: Path) -> Source:
    """All sensors under a scene, or each under its own; a recording of them is put into `folder`.

    Under a guided calibration a sensor has the load that this asks for.
    """
    sensors = service.config.sensor.items()
    players = {name: simulated(each, scene or OPENING[name], NOISE_KPA) for name, each in sensors}
    logs.progress("simulating a recording to play")
    _record(list(players.values()), folder / "fingertips.log")
    guided: dict[str, tuple[float, tuple[str, ...]]] = {}  # since when (s, Unix), and the scenes

    def follow(event: Happening) -> None:
        if event.kind == "calibration_started" and event.sensor and (scenes := GUIDED.get(event.text)):
            guided[event.sensor] = event.time, scenes
        elif event.kind == "calibration_ended" and event.sensor:
            guided.pop(event.sensor, None)

    def acting(name: str, t: float, now: float) -> tuple[Player, float]:
        """What plays a sensor, and how long it has, s."""
        since, scenes = guided.get(name, (now, ()))
        if not scenes:
            return players[name], t
        pressed = now - since - UNLOADED_S
        return replace(players[name], scenes=scenes if pressed >= 0 else ("empty",)), max(pressed, 0.0)

    def messages(sequence: int, t: float, now: float) -> list[Message]:
        every = [acting(name, t, now) for name in players]
        return [message for each, played in every for message in each.messages(sequence, played, now)]

    service.events.subscribe(follow)
    return lambda sender, stop: play(messages, sender.send, rate_hz, stop)


def _record(players: list[Player], path: Path) -> None:
    """Write what the arrays would send under some scenes."""
    began, at = time.time(), 0
    with closing(Recorder(path)) as recorder:
        for scene, seconds in RECORDED:
            acting = [replace(each, scenes=(scene,)) for each in players]
            for sequence in range(at, at := at + round(seconds * RECORDED_HZ)):
                t = sequence / RECORDED_HZ
                for message in (one for each in acting for one in each.messages(sequence, t, began + t)):
                    recorder.put(can_message(message))


def _server(host: str, port: int, foxglove: int | None, recordings: str) -> Server:
    """Where to serve; beyond loopback with a token made for this run."""
    token = None if host in LOOPBACK else SecretStr(token_urlsafe(12))
    if token:
        print(f"tactiled: other machines reach port {port} of this one with the token {token.get_secret_value()}")
    address = {"host": host, "port": port, "foxglove": foxglove, "control_token": token}
    kept = {"recordings": recordings, "recordings_leave_mb": LEAVE_MB}
    return validated(Server, address | kept, f"--foxglove {foxglove}")


def demo_config(record: str | None = None, shear: bool = False) -> Config:
    """The configuration of a recorded grasp, of a 3-axis skin, or of the demo's two arrays."""
    if record and shear:
        raise ConfigError(f"--shear: recording {record} has none: leave one of the two out")
    text = GRASP if record else SHEAR if shear else DEMO
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
            thread.join(END_S)  # longer only if the service reads no more, which it waits for then
