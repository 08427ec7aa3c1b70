"""Which form of a blur is soonest on this machine: timed once, and remembered beside the solved covers.

Remembered, because forms agree to rounding only: a replay is to give the same bits every time.
"""

from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from tactiled.cover.cache import cache_folder
from tactiled.files import atomic_write
from tactiled.restore.forms import Forms


def soonest(forms: Forms, folder: Path | None = None, clock: Callable[[], float] = perf_counter) -> str:
    """Name of the form that was timed to be soonest, now or before; the usual one where none can be remembered."""
    if len(forms.names) == 1:
        return forms.usual
    size = (forms.shape, forms.surface, forms.parts, forms.names, np.__version__)
    with suppress(OSError), threadpool_limits(1):
        path = (folder or cache_folder()) / f"{sha256(repr(size).encode()).hexdigest()}.form"
        if (known := _known(path, forms)) is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.unlink(missing_ok=True)
            _keep(path, forms.fastest(clock))
            known = _known(path, forms)
        return known or forms.usual
    return forms.usual


def _known(path: Path, forms: Forms) -> str | None:
    """The form that was remembered; None where there is none, or another's name."""
    with suppress(OSError, ValueError):
        found = path.read_text()
        return found if found in forms.names else None
    return None


def _keep(path: Path, name: str) -> None:
    """Write it whole or not at all; of several that do so at once the first stays."""
    with suppress(FileExistsError), atomic_write(path) as part:
        part.write_text(name)
