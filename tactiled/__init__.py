"""tactiled gives a covered tactile array its sharpness back."""

from importlib.metadata import version

from tactiled.client import connect

__all__ = ["__version__", "connect"]
__version__ = version("tactiled")
