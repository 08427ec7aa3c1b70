"""`tactiled run`: the service on the buses of a configuration."""

import logging
import os
import signal
import sys
from contextlib import AbstractContextManager
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits

from tactiled import logs
from tactiled.cli import options
from tactiled.cli.app import handled, stoppable
from tactiled.cli.check import findings_of, prepared
from tactiled.config import Server, validated
from tactiled.errors import ConfigError
from tactiled.interop.bridges import configured
from tactiled.interop.zenoh.reader import publish
from tactiled.live.service import Service
from tactiled.threads import limit_heaps
from tactiled.web.app import create
from tactiled.web.server import serve


def run(
    config: options.Config,
    foxglove: options.Foxglove = None,
    rerun: options.Rerun = None,
    publishes: Annotated[
        bool,
        typer.Option("--publish", help="Publish on the Zenoh network of the configuration, and serve no HTTP."),
    ] = False,
    _: options.LogFormat = "console",
) -> None:
    """Run the service: read the buses, restore every frame, serve it over HTTP and WebSocket."""
    limit_heaps()
    for finding in findings_of(config):
        if not finding.hint:
            logs.announce(f"doubtful: {finding}", logging.WARNING)  # the value may be right: run all the same
    with stoppable(), threadpool_limits(1):  # frames are small: a second thread costs more than it gives
        service = prepared(config, logs.progress)
        address = service.config.server.model_dump(exclude_unset=True) | options.present(foxglove=foxglove)
        server = validated(Server, address, f"--foxglove {foxglove}")
        zenoh = service.config.zenoh
        if publishes and (zenoh is None or zenoh.robot is None):
            raise ConfigError(f"{config}: zenoh.robot: missing: --publish needs the table [zenoh] with robot")
        if zenoh and not publishes:
            logs.announce("[zenoh] has no effect without --publish", logging.WARNING)
        bridges = configured(server, rerun)
        with _reloadable(service), service.running():
            if publishes and zenoh:
                publish(service, server, zenoh, bridges)
            else:
                serve(create(service, server, bridges), server)


def _reloadable(service: Service) -> AbstractContextManager[None]:
    """Reload the configuration at SIGHUP meanwhile, unless it comes because the terminal was closed."""
    on_terminal = sys.stdin is not None and sys.stdin.isatty()

    def reload(*_: object) -> None:
        if on_terminal and not sys.stdin.isatty():
            os.kill(os.getpid(), signal.SIGTERM)
        else:
            service.start_reload()  # the log has its outcome

    return handled(reload, signal.SIGHUP)
