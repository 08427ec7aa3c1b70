"""`tactiled init`: a commented configuration to start from."""

from pathlib import Path
from typing import Annotated

import typer

from tactiled.cli.options import write_configuration
from tactiled.config.example import EXAMPLE


def init(
    path: Annotated[Path, typer.Argument(help="File to write; never overwritten.")] = Path("tactiled.toml"),
) -> None:
    """Write a commented configuration."""
    write_configuration(path, EXAMPLE)
