"""Which cells belong to which contact, compiled, against scikit-image's watershed."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.measure import label
from skimage.morphology import local_maxima
from skimage.segmentation import watershed

from tactiled.core import contacts

SHARES, SKIRT = (0.4, 0.2, 0.3), 0.1  # of peaks that were in one contact, in two, and others
HALVES = (
    (np.s_[:, :-1], np.s_[:, 1:]),
    (np.s_[:-1], np.s_[1:]),
    (np.s_[:-1, :-1], np.s_[1:, 1:]),
    (np.s_[:-1, 1:], np.s_[1:, :-1]),
)


def split(picture, pressed, high_near, least, was):
    """Number the cells by contact."""
    order, parts = np.flatnonzero(pressed), np.zeros(picture.shape, np.int64)
    order = order[np.argsort(-picture.ravel()[order], kind="stable")]
    contacts.split(picture, order, high_near, least, was, SHARES, SKIRT, parts)
    return parts


def reference(picture, pressed, high_near, least, was):
    """The same by basins of scikit-image, and all saddles between them from the highest down."""
    peaks = label(local_maxima(np.where(pressed, picture, 0)) & pressed)
    basins = watershed(-picture, peaks, connectivity=2, mask=pressed)
    cell = {number: np.flatnonzero(peaks == number)[0] for number in range(1, peaks.max() + 1)}
    joined = {number: number for number in cell}
    saddles = [
        (-min(high, low), one, other)
        for a, b in HALVES
        for one, other, high, low in zip(*(x[s].ravel() for x in (basins, picture) for s in (a, b)), strict=True)
        if one and other and one != other
    ]
    for depth, one, other in sorted(saddles):
        low, high = sorted((joined[one], joined[other]), key=lambda n: picture.flat[cell[n]])
        top, saddle, near = picture.flat[cell[low]], -depth, high_near.flat[cell[low]]
        before = was.flat[cell[low]], was.flat[cell[high]]
        share = SHARES[0 if before[0] == before[1] else 1] if all(before) else SHARES[2]
        deep = top - saddle >= max(least.flat[cell[low]], share * near)
        if low != high and not deep and not saddle < SKIRT * near < top:
            joined = {number: high if root == low else root for number, root in joined.items()}
    return np.array([0, *joined.values()])[basins]


def partition(parts):
    """The cells of each part."""
    return {tuple(np.flatnonzero(parts == number)) for number in np.unique(parts[parts > 0])}


@pytest.mark.parametrize("seed", range(60))
def test_cells_are_parted_as_watershed_and_saddles_part_them(seed):
    random = np.random.default_rng(seed)
    shape, sigma = random.integers(2, 24, 2), random.uniform(0.5, 2.5)
    picture, near = (gaussian_filter(random.uniform(0, 1, shape), each) for each in (sigma, 4))
    picture = ((picture - picture.min()) / np.ptp(picture)) ** 3
    was = random.integers(0, 3, shape)
    case = (
        picture,
        picture > np.quantile(picture, 0.1),
        random.uniform(0.3, 3) * near,
        random.uniform(0, 0.3, shape),
        was,
    )
    parts = split(*case)
    assert partition(parts) == partition(reference(*case))


def test_a_flat_top_is_one_contact_however_it_is_formed():
    picture = np.zeros((7, 9))
    picture[2:5, 1:8] = 5  # a ring of one height, with a way down on one side
    picture[3, 2:7] = 0
    picture[5, 4] = 3
    ones = np.ones_like(picture)
    parts = split(picture, picture > 0, 5 * ones, 0.1 * ones, np.zeros(picture.shape, np.int64))
    assert len(partition(parts)) == 1
    assert np.array_equal(parts > 0, picture > 0)


def test_a_cell_beside_contacts_is_of_the_higher_one():
    random = np.random.default_rng(0)
    picture, parts = random.uniform(0, 1, (12, 9)), np.where(random.uniform(0, 1, (12, 9)) > 0.7, 1, 0)
    parts *= random.integers(1, 4, parts.shape)
    skirts, (framed, around) = np.empty_like(parts), (np.pad(each, 1) for each in (picture, parts))
    contacts.widen(parts, picture, skirts)
    for (row, column), part in np.ndenumerate(parts):
        sides = [(row, column + 1), (row + 2, column + 1), (row + 1, column), (row + 1, column + 2)]
        beside = [(framed[each], around[each]) for each in sides if around[each]]
        assert skirts[row, column] == (part or (max(beside)[1] if beside else 0))


def test_other_shapes_are_refused():
    picture, labels = np.zeros((3, 4)), np.zeros((3, 4), np.int64)
    none = np.zeros(0, np.int64)
    with pytest.raises(ValueError, match="shapes do not fit"):
        contacts.split(picture, none, picture, picture[:2], labels, SHARES, SKIRT, labels)
    with pytest.raises(ValueError, match="shapes do not fit"):
        contacts.widen(labels, picture[:, :3].copy(), labels)
