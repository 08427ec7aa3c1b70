"""One file a verb, imported when that verb runs."""

from tactiled.cli.app import main

__all__ = ["main"]
