"""One file a verb: every file here is imported, which gives the command line its verb."""

from importlib import import_module
from pkgutil import iter_modules

from tactiled.cli.app import main

__all__ = ["main"]

for _found in iter_modules(__path__):
    import_module(f"{__name__}.{_found.name}")
