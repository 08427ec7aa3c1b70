"""`tactiled init`: a commented configuration to start from."""

from pathlib import Path
from typing import Annotated

import typer

from tactiled.cli.options import choose, write_configuration
from tactiled.config import icub
from tactiled.config.example import DEMO, EXAMPLE
from tactiled.config.ready import READY, configuration
from tactiled.errors import ConfigError


def init(
    path: Annotated[Path, typer.Argument(help="File to write; never overwritten.")] = Path("tactiled.toml"),
    skin: Annotated[
        str | None, typer.Option(help="Of a skin: " + ", ".join(READY) + "; demo: of the demo's two.")
    ] = None,
    from_icub: Annotated[
        Path | None, typer.Option(help="Of the boards in this file of an iCub or ergoCub (PART-skinSpec.xml).")
    ] = None,
    positions: Annotated[
        Path | None, typer.Option(help="With --from-icub: where its triangles are (skinGui's PART.ini, or .txt).")
    ] = None,
) -> None:
    """Write a commented configuration."""
    if positions is not None and from_icub is None:
        raise ConfigError(f"--positions {positions}: needs --from-icub")
    if skin is not None:
        if from_icub is not None:
            raise ConfigError(f"--skin {skin}: --from-icub says it: leave one of them out")
        text = DEMO if choose("skin", skin, (*READY, "demo")) == "demo" else configuration(skin)
    else:
        text = EXAMPLE if from_icub is None else icub.configuration(from_icub, positions)
    write_configuration(path, text)
