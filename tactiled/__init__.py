"""tactiled gives a covered tactile array its sharpness back."""

from importlib.metadata import version

__version__ = version("tactiled")
