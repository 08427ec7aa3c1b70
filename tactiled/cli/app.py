"""The command line's one door: a clear line and exit code 2 for every error that is the user's to mend."""

import sys

import typer
from rich.console import Console

from tactiled.errors import TactileError

app = typer.Typer(
    name="tactiled",
    help="Live deconvolution of covered tactile arrays: CAN frames in, surface pressure out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
bench = typer.Typer(help="Measure speed and accuracy on this machine.", no_args_is_help=True)
app.add_typer(bench, name="bench")


def main() -> None:
    """Run the command line."""
    try:
        app()
    except TactileError as error:
        Console(stderr=True, soft_wrap=True, highlight=False).print("tactiled:", str(error), markup=False)
        sys.exit(2)
