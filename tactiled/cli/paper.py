"""`tactiled paper`: the paper's figures and statements, computed again."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits


def paper(out_dir: Annotated[Path, typer.Argument(help="Folder for the figures and index.html.")]) -> None:
    """Reproduce the figures of Shimojo's paper, and compare its statements with both models."""
    from tactiled.bench.paper.page import write  # matplotlib takes half a second that no other verb needs

    with threadpool_limits(1):
        print(write(out_dir))
