"""One file a verb; importing a file here gives the command line its verb."""

from tactiled.cli import cover as cover
from tactiled.cli.app import main

__all__ = ["main"]
