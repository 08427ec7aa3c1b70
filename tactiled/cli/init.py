"""`tactiled init`: a commented configuration to start from."""

from pathlib import Path
from typing import Annotated

import typer

from tactiled.config.example import EXAMPLE
from tactiled.errors import ConfigError
from tactiled.files import whole


def init(
    path: Annotated[Path, typer.Argument(help="File to write; never overwritten.")] = Path("tactiled.toml"),
) -> None:
    """Write a commented configuration."""
    try:
        with whole(path) as part:
            part.write_text(EXAMPLE, "utf-8")
    except FileExistsError as error:
        raise ConfigError(f"{path} is there already: name another file, or remove it first") from error
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}: name a file that can be written") from error
    typer.echo(f"wrote {path}: edit it, then `tactiled check {path}` and `tactiled run {path}`")
