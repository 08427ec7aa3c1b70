"""Contacts: found in a restored image."""

from collections.abc import Callable
from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from tactiled.arrays import Floats, Floats32, Mask, Reals
from tactiled.contacts.felt import is_known
from tactiled.core import contacts as core
from tactiled.geometry import Array, Raster
from tactiled.units import FORCE_SCALES, PRESSURE, Unit

Labels = NDArray[np.int64]

# `python -m tests.bench contacts` measures what these bounds find and split.
BEGIN_SIGMAS = 5.0  # noise standard deviations above which a contact begins
CONTINUE_SIGMAS = 3.0  # down to which one that has begun goes on; also the least depth of a dip
NEAR_PITCHES = 8.0  # around a peak where restoration may ring: there it counts in full
FAR_PEAK_SHARE = 0.2  # part of a more distant peak that counts
SKIRT_SHARE = 0.1  # of the highest of these: a lower cell is a skirt, or rings
MAX_CONTACTS = 512  # of an image, those with the highest peaks: the time to track them grows with their square
# Of the same: depth of the dip between two contacts that were one in the image before, two, or neither,
DIP_SHARES = 0.42, 0.3, 0.31
RING_DIP_SHARES = 0.5, 0.3, 0.42  # and where they surround a hole together
DIP_DEVIATIONS, CLEAR_SHARE = 1.5, 0.5  # of the lower peak's, but of no more than this share of it: also the depth
SPECK_SHARE = 0.2  # of the highest near it: a lower peak that is less than DIP_DEVIATIONS of itself is a speck
OUTLINE_SIGMAS = 2.0  # standard deviations of a contact's pressure from its centre to the ellipse that shows it


@dataclass(frozen=True, slots=True)
class DetectedContact:
    """One contact; x to the right and y down, in the array's own coordinates."""

    id: int  # the same while it lasts
    x_mm: float  # centre of pressure
    y_mm: float
    force: float  # N, or counts mm2, as `units.FORCE_UNITS` has it for the image's unit
    area_mm2: float
    peak: float  # in the image's unit
    major_mm: float  # standard deviation of the pressure along its longer axis
    minor_mm: float
    angle_rad: float  # of the longer axis from x towards y, -pi/2 to pi/2
    cut_off: bool = False  # it reaches where the cover goes on beyond the array: what presses there is not in it
    force_deviation: float = nan  # standard deviation of the force, in its unit; NaN: unknown


class Finder:
    """Finds the contacts in the restored images of one array, which have these cells."""

    def __init__(self, array: Array, cells: Raster) -> None:
        self._cells, self._felt = cells, cells.felt
        self._border = cells.rim & ~_ends(array, cells)
        self._near = 2 * round(NEAR_PITCHES * array.pitch / cells.side) + 1  # cells
        self.parts: Labels = np.zeros(
            cells.shape, np.int64
        )  # contact of each cell in the last whole image, 0: none

    def __call__(
        self,
        image: Floats32,
        noise: float,
        unit: Unit = PRESSURE,
        faint: bool = False,
        shares: Floats32 | None = None,
        before: Labels | None = None,
        deviation: Callable[[], Floats32] | None = None,
        blurred: bool = False,
    ) -> list[DetectedContact]:
        """Contacts of an image (in `unit`), the strongest first, all with id 0; `noise` is a cell's.

        With `faint` also those too faint to begin: a contact that has begun may become as faint. A contact is
        left out beside an unknown cell (NaN), or if too little of it is left by the `shares` of the cells. At a
        dip near the bound, what was one contact or two in `before`, the `parts` of the last image, stays so; what
        surrounds a hole, as a ring does, is one down to deeper dips.
        `deviation` gives the cells' (in `unit`); it is called only if something presses. No dip that is small
        beside it parts a contact, and no faint peak near a strong one that is small beside it is one, unless the
        image is `blurred`, as the raw one is: blur makes no dip and no speck.
        """
        pressure = np.where(self._felt, np.nan_to_num(np.asarray(image, float)), 0)
        begin, go_on = BEGIN_SIGMAS * noise, CONTINUE_SIGMAS * noise
        peak = float(pressure.max(initial=0.0))
        if peak <= (go_on if faint else begin):
            self._keep(np.zeros_like(self.parts), shares)
            return []
        from scipy.ndimage import maximum_filter  # the first contact imports it

        picture = np.where(self._felt, pressure, -np.inf)
        highest = maximum_filter(np.maximum(picture, FAR_PEAK_SHARE * peak), self._near)
        was = np.zeros_like(self.parts) if before is None else before
        spread = deviation() if deviation else np.full(pressure.shape, nan)
        doubt = np.zeros(pressure.shape) if blurred else DIP_DEVIATIONS * spread
        least = np.fmax(go_on, np.minimum(doubt, CLEAR_SHARE * picture))
        pressed = np.flatnonzero(picture > go_on)
        order = pressed[np.argsort(-picture.ravel()[pressed], kind="stable")]
        parts, rings = np.zeros_like(self.parts), np.zeros_like(self.parts)
        for labels, dips in ((parts, DIP_SHARES), (rings, RING_DIP_SHARES)):
            core.split(picture, order, highest, least, was, dips, SKIRT_SHARE, labels)
        _join_rings(parts, rings, picture > SKIRT_SHARE * highest)
        tops = np.full(int(parts.max()) + 1, -np.inf)
        np.maximum.at(tops, parts, picture)
        tops[0] = np.inf
        specks = picture <= np.minimum(doubt, SPECK_SHARE * highest)
        clear = np.zeros(len(tops), bool)
        clear[parts[~specks]] = True
        threshold = np.where(tops > begin, begin, go_on if faint else np.inf)
        threshold[~clear] = np.inf
        parts[picture <= np.maximum(SKIRT_SHARE * np.maximum(highest, tops[parts]), threshold[parts])] = 0
        self._keep(parts, shares)
        skirts = np.empty_like(parts)
        core.widen(parts, picture, skirts)
        skirts[~self._felt] = 0
        cut = np.unique(skirts[self._felt & np.isnan(image)])  # by an unknown cell
        numbers = np.setdiff1d(parts[parts > 0], cut)
        numbers = numbers[np.argsort(-tops[numbers], kind="stable")[:MAX_CONTACTS]]
        if shares is not None:
            numbers = np.array([n for n in numbers if is_known(shares[parts == n].mean(), summed=True)], int)
        contacts = self._measured(pressure, spread, FORCE_SCALES[unit], parts, skirts, numbers)
        return sorted(contacts, key=lambda contact: -contact.force)

    def _keep(self, parts: Labels, shares: Floats32 | None) -> None:
        """Remember the parts of an image, unless lost messages left holes in it."""
        if shares is None:
            self.parts = parts

    def _measured(
        self,
        pressure: Floats,
        deviation: Reals,
        force_scale: float,
        parts: Labels,
        skirts: Labels,
        numbers: Labels,
    ) -> list[DetectedContact]:
        """Measure contacts by number: force and place with the skirt round the cells that are clearly pressed.

        The errors of a contact's cells count as independent: in `tests.bench border` 94 % of the forces are within
        two deviations, as they are of cells. A force between none and all of the image's deviates by half of that
        at most.
        """
        area, count, of = self._cells.side**2, int(parts.max()) + 1, skirts.ravel()

        def sums(values: Reals, labels: Labels = of) -> Floats:
            """Of the cells of each contact, (contacts,)."""
            return np.asarray(np.bincount(labels, values.ravel(), count)[numbers], float)

        load = np.maximum(pressure.ravel(), 0)  # negative ringing has no part in the centre
        total, centre = sums(load), np.zeros((count, 2))
        centre[numbers] = np.transpose([sums(load * each) / total for each in self._cells.positions.T])
        x, y = (self._cells.positions - centre[of]).T
        within_cell = area / 12  # mm^2, variance of the even pressure inside a square cell
        xx, yy, xy = (sums(load * each) / total for each in (x * x, y * y, x * y))
        middle, radius = (xx + yy) / 2 + within_cell, np.hypot((xx - yy) / 2, xy)  # of Mohr's circle
        most = 0.5 * float(load.sum())
        peaks = np.zeros(count)
        np.maximum.at(peaks, parts, pressure)
        values = zip(
            centre[numbers].tolist(),
            (sums(pressure) * area * force_scale).tolist(),
            (sums(np.ones(of.shape), parts.ravel()) * area).tolist(),
            peaks[numbers].tolist(),
            np.sqrt(middle + radius).tolist(),
            np.sqrt(np.maximum(middle - radius, 0)).tolist(),
            (0.5 * np.arctan2(2 * xy, xx - yy)).tolist(),
            (sums(self._border.astype(float), parts.ravel()) > 0).tolist(),
            (np.minimum(np.sqrt(sums(np.square(deviation))), most) * area * force_scale).tolist(),
            strict=True,
        )
        return [DetectedContact(0, *centre, *others) for centre, *others in values]


def _join_rings(parts: Labels, rings: Labels, clear: Mask) -> None:
    """Join those `parts` that are one in `rings`, if it surrounds a hole in what is `clear`; all (R, C)."""
    from scipy.ndimage import binary_fill_holes

    for number in np.unique(rings[parts != rings]):
        ring = (rings == number) & clear
        if np.count_nonzero(binary_fill_holes(ring) & ~ring):
            parts[rings == number] = number


def _ends(array: Array, cells: Raster) -> Mask:
    """Cells (R, C) at a side of the array where nothing of the cover is beyond it."""
    ends = np.zeros(cells.shape, bool)
    above, below, left, right = (beyond == 0 for beyond in array.beyond or (np.inf,) * 4)
    ends[0] |= above
    ends[-1] |= below
    ends[:, 0] |= left
    ends[:, -1] |= right
    return ends
