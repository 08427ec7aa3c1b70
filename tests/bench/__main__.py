"""`python -m tests.bench NAME`: the measurements that only developers need."""

import typer
from threadpoolctl import threadpool_limits

from tests.bench import (
    blind,
    border,
    bus,
    contacts,
    cover,
    felt,
    frame_times,
    health,
    invented,
    judge,
    mistakes,
    restart,
    restore,
    sensors,
    shear,
    slow_clients,
    soak,
    train,
    zenoh,
)

app = typer.Typer(add_completion=False, no_args_is_help=True)
for measurement in (
    blind.blind, border.border, bus.bus, contacts.contacts, cover.cover, felt.felt,
    frame_times.frame_times, health.health, invented.invented,
    judge.judge, mistakes.mistakes, restart.restart, restore.restore,
    sensors.sensors_against, shear.shear, slow_clients.slow_clients, soak.soak, train.train, zenoh.zenoh,
):  # fmt: skip
    app.command()(measurement)

if __name__ == "__main__":
    with threadpool_limits(1):
        app()
