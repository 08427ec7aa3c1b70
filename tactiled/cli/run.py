"""`tactiled run`: the service on the buses of a configuration."""

import typer
from threadpoolctl import threadpool_limits

from tactiled.cli import options
from tactiled.cli.app import stoppable
from tactiled.cli.check import findings_of, prepared
from tactiled.web.server import serve


def run(config: options.Config, foxglove: options.Foxglove = None) -> None:
    """Run the service: read the buses, restore every frame, serve it over HTTP and WebSocket."""
    for finding in findings_of(config):
        if not finding.hint:
            typer.echo(f"tactiled: doubtful: {finding}", err=True)  # it may be true: no reason not to run
    with threadpool_limits(1):  # frames are small: a second thread costs more than it gives
        service = prepared(config)
        server = service.config.server.model_copy(update=options.present(foxglove=foxglove))
        with stoppable(), service.running():
            serve(service, server)
