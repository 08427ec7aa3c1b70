"""Where something touches: contacts in a restored image, and the same contact from frame to frame."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skimage import measure, morphology, segmentation

from tactiled.geometry import Array, Cells

Floats = NDArray[np.float64]
Labels = NDArray[np.int64]

CLEAR = 5.0  # noise standard deviations from which a cell is pressed
SHARE = 0.1  # of the image's peak below which a cell is the skirt of a contact
DIP = 0.2  # of the image's peak that two contacts must dip between them to be two
NEAR = 1.5  # pitches between neighbours of a layout that is no grid
APART = 3.0  # pitches that a contact may move between two frames and be the same
# scikit-image has no types.
label: Callable[..., Labels] = measure.label
h_maxima: Callable[..., Labels] = morphology.h_maxima
expand_labels: Callable[..., Labels] = segmentation.expand_labels
watershed: Callable[..., Labels] = segmentation.watershed


@dataclass(frozen=True, slots=True)
class Contact:
    """One contact; x to the right and y down, in the array's own coordinates."""

    id: int  # the same while it lasts
    x_mm: float  # centre of pressure
    y_mm: float
    force_n: float
    area_mm2: float
    peak_kpa: float
    major_mm: float  # standard deviation of the pressure along its longer axis
    minor_mm: float
    angle_rad: float  # of the longer axis from x towards y, -pi/2 to pi/2


class Finder:
    """Finds the contacts in the restored images of one array, whose surface has these cells."""

    def __init__(self, array: Array, cells: Cells) -> None:
        self._array, self._cells = array, cells
        if array.shape is None:
            pairs = cKDTree(array.positions).query_pairs(NEAR * array.pitch, output_type="ndarray")
            links = np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])
            self._near = sparse.coo_array(links, shape=(array.size, array.size)).tocsr()

    def __call__(self, image: NDArray[np.float32], noise_kpa: float) -> list[Contact]:
        """Contacts of an image (kPa), the strongest first, all with id 0; `noise_kpa` is a cell's."""
        pressure = np.asarray(image, float)
        peak = float(pressure.max(initial=0.0))
        pressed = pressure > max(CLEAR * noise_kpa, SHARE * peak)
        if not pressed.any():
            return []
        if self._array.shape is None:
            parts = skirts = self._scattered(pressed)
        else:
            parts = _split(pressure, pressed, peak)
            skirts = expand_labels(parts, 1)
        numbers = range(1, int(parts.max()) + 1)
        both = parts.ravel(), skirts.ravel()
        found = [self._measure(pressure.ravel(), *(np.flatnonzero(each == n) for each in both)) for n in numbers]
        return sorted(found, key=lambda contact: -contact.force_n)

    def _scattered(self, pressed: NDArray[np.bool_]) -> Labels:
        """Number the groups of neighbouring taxels that are pressed."""
        taxels = np.flatnonzero(pressed)
        _, group = connected_components(self._near[taxels][:, taxels], directed=False)
        parts = np.zeros(pressed.shape, np.int64)
        parts[taxels] = group + 1
        return parts

    def _measure(self, pressure: Floats, pressed: Labels, skirt: Labels) -> Contact:
        """Measure a contact: force and place with the skirt round the cells that are clearly pressed."""
        areas = self._cells.areas[skirt]
        force = pressure[skirt] * areas  # kPa mm^2, 1e-3 N
        places = self._cells.positions[skirt]
        weight = np.maximum(force, 0) / np.maximum(force, 0).sum()  # what rings below zero has no place
        centre = weight @ places
        away = places - centre
        within = float(weight @ areas) / 12  # mm^2, of the even pressure inside a square cell
        spread = (weight[:, None] * away).T @ away + within * np.eye(2)
        least, most = np.linalg.eigvalsh(spread)
        angle = 0.5 * np.arctan2(2 * spread[0, 1], spread[0, 0] - spread[1, 1])
        return Contact(
            id=0,
            x_mm=float(centre[0]),
            y_mm=float(centre[1]),
            force_n=float(force.sum()) * 1e-3,
            area_mm2=float(self._cells.areas[pressed].sum()),
            peak_kpa=float(pressure[pressed].max()),
            major_mm=float(np.sqrt(max(most, 0.0))),
            minor_mm=float(np.sqrt(max(least, 0.0))),
            angle_rad=float(angle),
        )


def _split(pressure: Floats, pressed: NDArray[np.bool_], peak: float) -> Labels:
    """Number the contacts of a grid: basins round the peaks that a dip parts."""
    tops = label(h_maxima(np.where(pressed, pressure, 0.0), DIP * peak) > 0)
    reached = watershed(-pressure, tops, mask=pressed)
    rest = label(pressed & (reached == 0))  # a low contact beside a high one has no peak that stands out
    return np.asarray(np.where(rest > 0, rest + reached.max(), reached), np.int64)


class Tracker:
    """Gives a contact the same id from frame to frame, by the shortest way from the last frame's contacts."""

    def __init__(self, reach_mm: float) -> None:
        self._reach = reach_mm
        self._last: list[Contact] = []
        self._next = 1

    def __call__(self, found: list[Contact]) -> list[Contact]:
        """The contacts of the next frame, with ids."""
        ids = dict(self._pairs(found))
        named = []
        for place, contact in enumerate(found):
            if place not in ids:
                ids[place], self._next = self._next, self._next + 1
            named.append(replace(contact, id=ids[place]))
        self._last = named
        return named

    def _pairs(self, found: list[Contact]) -> list[tuple[int, int]]:
        """(place in `found`, id) of every contact that was there before."""
        if not found or not self._last:
            return []
        new = np.array([(each.x_mm, each.y_mm) for each in found])
        old = np.array([(each.x_mm, each.y_mm) for each in self._last])
        distance = np.linalg.norm(new[:, None] - old[None], axis=-1)
        rows, columns = linear_sum_assignment(distance)
        return [
            (int(row), self._last[column].id)
            for row, column in zip(rows, columns, strict=True)
            if distance[row, column] <= self._reach
        ]
