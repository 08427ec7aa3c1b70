"""`tactiled paper`: the paper's figures and statements, computed again."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits


def paper(out_dir: Annotated[Path, typer.Argument(help="Folder for the figures and index.html.")]) -> None:
    """Compute Shimojo's paper again: its figures, and a page that says what agrees and what cannot be right."""
    from tactiled.bench.paper.page import write  # matplotlib takes half a second that no other verb needs

    with threadpool_limits(1):
        print(write(out_dir))
