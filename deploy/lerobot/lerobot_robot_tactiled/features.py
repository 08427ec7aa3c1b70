"""Names of the observations, and the arrays of the values that have these names."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from tactiled.client import Image

NAME = re.compile(r"tactile\.(.+\.(?:restored_\w+|age_s|flagged_taxels|unknown_cells))((?:\.\d+)+)")


def value_names(image: Image, frames: int) -> list[str]:
    """The names of the values of a window with such images, in the order of `values`; frame 0 is the oldest."""
    cells = (frames, *image.restored.shape)
    shapes = {f"restored_{image.unit}": cells} | dict.fromkeys(
        ("age_s", "flagged_taxels", "unknown_cells"), (frames,)
    )
    return [
        ".".join(("tactile", image.sensor, kind, *map(str, index)))
        for kind, shape in shapes.items()
        for index in np.ndindex(shape)
    ]


def values(window: Sequence[Image], age_s: float) -> list[float]:
    """The values of a window, oldest frame first; `age_s` is that of its newest frame."""
    ages = [age_s + window[-1].timestamp - image.timestamp for image in window]
    flagged = [float(np.count_nonzero(image.flags)) for image in window]
    restored = np.stack([image.restored.ravel() for image in window])
    felt = True if window[0].cells is None else window[0].cells.mask.ravel()
    unknown = (np.isnan(restored) & felt).sum(axis=1, dtype=float).tolist()
    return [*np.nan_to_num(restored).ravel().tolist(), *ages, *flagged, *unknown]


def arrays(names: Sequence[str], state: Any) -> dict[str, Any]:
    """The tactile arrays in a state, or in a batch of states, of a dataset or a policy.

    `names` are those of `observation.state`, `state` is its array or tensor (..., len(names)). The keys are
    `palm.restored_kPa` (..., frames, rows, columns), `palm.age_s`, `palm.flagged_taxels` and
    `palm.unknown_cells` (..., frames).
    """
    places: dict[str, dict[tuple[int, ...], int]] = {}
    for place, name in enumerate(names):
        if match := NAME.fullmatch(name):
            places.setdefault(match[1], {})[tuple(map(int, match[2][1:].split(".")))] = place
    shapes = {key: [last + 1 for last in max(each)] for key, each in places.items()}
    return {
        key: state[..., [each[index] for index in sorted(each)]].reshape(*state.shape[:-1], *shapes[key])
        for key, each in places.items()
    }
