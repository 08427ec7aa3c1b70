"""`tactiled replay`: a recording in the place of the bus."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from tactiled import logs
from tactiled.bus.recording import Recording
from tactiled.bus.replay import Replay
from tactiled.bus.router import Router
from tactiled.cli import options
from tactiled.cli.app import stoppable
from tactiled.config import Config, Server, load, validated
from tactiled.errors import ConfigError
from tactiled.interop.bridges import configured
from tactiled.live.sensor import Sensor
from tactiled.live.service import Service
from tactiled.live.status import REPLAYED
from tactiled.recorded.noise import measure
from tactiled.web.app import create
from tactiled.web.server import serve


def replay(
    file: options.Recording,
    config: options.RecordedConfig,
    bus: options.Bus = None,
    speed: Annotated[
        float, typer.Option(help="1: the recorded pace; N: N times that; 0: no pauses.", min=0)
    ] = 1.0,
    host: Annotated[str | None, typer.Option(help="Address to serve on instead of the file's.")] = None,
    port: Annotated[int | None, typer.Option(help="Port instead of the file's.", min=0, max=65535)] = None,
    _: options.LogFormat = "console",
) -> None:
    """Restore every frame of a recording and serve it as `run` does; every run gives the same images."""
    settings = one_bus(load(config), bus)
    address = settings.server.model_dump(exclude_unset=True) | options.present(host=host, port=port)
    server = validated(Server, address, f"--host {host}")
    with threadpool_limits(1):
        service = replaying(settings, file, speed)
        with stoppable(), service.running():
            serve(create(service, server, configured(server)), server)


def replaying(settings: Config, file: Path, speed: float) -> Service:
    """A service whose only bus is a recording."""

    def listen(bus: str, _: object, sensors: dict[str, Sensor]) -> Replay:
        def ended(line: str, failed: bool) -> None:
            logs.announce(line)
            for each in sensors.values():
                setattr(each.health, "down" if failed else "ended", line)

        def stepped(line: str) -> None:
            logs.announce(line)
            service.events.add("replay_stepped", line, bus=bus)

        for each in sensors.values():
            each.health.clock = REPLAYED
        codecs = {name: each.codec for name, each in sensors.items()}
        plans = [each.plan for each in sensors.values()]
        logs.progress(f"measuring the noise in {file.name}")
        for name, found in measure(Recording(file, Router(codecs).ids), codecs, plans).items():
            sensors[name].pipeline.settle(*found)
        return Replay(file, codecs, lambda name, frame: sensors[name].restore(frame), speed, ended, stepped)

    service = Service(settings, listen, replayed=True, report=logs.progress)
    return service


def one_bus(settings: Config, bus: str | None) -> Config:
    """The configuration of one bus and its sensors; ConfigError where it has none."""
    name = options.choose("bus", bus, settings.bus)
    sensors = {key: each for key, each in settings.sensor.items() if each.bus == name}
    if not sensors:
        raise ConfigError(f"bus {name}: no sensor of the configuration is on it")
    return settings.model_copy(update={"bus": {name: settings.bus[name]}, "sensor": sensors})
