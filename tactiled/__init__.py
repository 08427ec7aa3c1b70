"""tactiled gives a covered tactile array its sharpness back."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactiled.client import Client, Image, connect
    from tactiled.errors import LoadedError, TactileError

    __version__: str

__all__ = ["Client", "Image", "LoadedError", "TactileError", "__version__", "connect"]

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Give a name of the client when it is first asked for: the command line starts without it."""
        if name == "__version__":
            return import_module("importlib.metadata").version("tactiled")
        if name in __all__:
            return getattr(import_module("tactiled.client"), name)
        raise AttributeError(f"module 'tactiled' has no attribute {name!r}")

    def __dir__() -> list[str]:
        """Give the names that are there when they are asked for."""
        return __all__
