"""`python -m tests.study NAME`: the measurements that only developers need."""

import typer
from threadpoolctl import threadpool_limits

from tests.study import ablation, bus, contacts, cover, false_warnings, fault_pairs, restore

app = typer.Typer(add_completion=False, no_args_is_help=True)
for measurement in (
    ablation.ablation,
    bus.bus,
    contacts.contacts,
    cover.cover,
    false_warnings.false_warnings,
    fault_pairs.fault_pairs,
    restore.restore,
):
    app.command()(measurement)

if __name__ == "__main__":
    with threadpool_limits(1):
        app()
