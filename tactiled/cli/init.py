"""`tactiled init`: a commented configuration to start from."""

from pathlib import Path
from typing import Annotated

import typer

from tactiled.cli.options import new_file
from tactiled.config.example import EXAMPLE


def init(
    path: Annotated[Path, typer.Argument(help="File to write; never overwritten.")] = Path("tactiled.toml"),
) -> None:
    """Write a commented configuration."""
    with new_file(path) as part:
        part.write_text(EXAMPLE, "utf-8")
    typer.echo(f"wrote {path}: edit it, then `tactiled check {path}` and `tactiled run {path}`")
