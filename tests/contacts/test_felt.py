import numpy as np
import pytest

from tactiled.contacts.detection import Finder
from tactiled.contacts.felt import is_known, shares
from tactiled.frames import DEAD, MISSING, SATURATED
from tests.plans import plan

SIDE = 12


def lost(*rows, flag=MISSING):
    flags = np.zeros((SIDE, SIDE), np.uint8)
    flags[list(rows)] = flag
    return flags


@pytest.mark.parametrize("thickness", [0.25, 1.0, 2.0])
def test_what_neighbours_feel_is_known_and_what_none_feels_is_not(thickness):
    blur = plan((SIDE, SIDE), thickness).blur
    for flags in (lost(), lost(4, flag=SATURATED), lost(4, flag=DEAD)):
        assert shares(flags, blur) is None
    half = shares(lost(*range(6)), blur)
    assert not is_known(half[:4]).any()
    assert is_known(half[8:]).all()
    assert is_known(shares(lost(4), blur)[4]).all() == (thickness > 1)
    assert not shares(lost(*range(SIDE), flag=DEAD), blur).any()


def test_a_contact_of_which_too_little_is_left_is_not_known():
    sensor = plan((SIDE, SIDE), 0.25)
    find, image = Finder(sensor.array, sensor.cells), np.zeros((SIDE, SIDE), np.float32)
    image[1:4, 1:4] = image[4:8, 7:10] = 50
    flags = lost(6, 7, 8)
    share = shares(flags, sensor.blur)
    assert len(find(image, 0.1)) == 2
    left = find(image, 0.1, shares=share)
    image[~is_known(share)] = np.nan
    for (contact,) in (left, find(image, 0.1)):
        assert (contact.x_mm, contact.y_mm) == pytest.approx((2, 2), abs=0.1)
