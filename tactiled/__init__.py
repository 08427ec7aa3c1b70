"""tactiled gives a covered tactile array its sharpness back."""

from importlib.metadata import version

from tactiled.client import Client, Image, connect
from tactiled.errors import LoadedError, TactileError

__all__ = ["Client", "Image", "LoadedError", "TactileError", "__version__", "connect"]
__version__ = version("tactiled")
