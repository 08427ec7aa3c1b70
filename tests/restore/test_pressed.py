"""Small contacts on a large grid, moved, grown and joined by others: restored in the box around them."""

import numpy as np
import pytest

from tactiled.bench.skin import nrmse
from tactiled.restore.auto import Auto
from tactiled.restore.pressed import Pressed
from tactiled.restore.scene import Scene

SHAPE = (30, 34)
SIGMA = 0.5


def disc(row, column, radius=3.0, peak=100.0):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return peak * np.clip(radius + 0.5 - np.hypot(y - row, x - column), 0, 1)


@pytest.fixture
def both(covered):
    """Restores a frame where it is pressed and all over; gives both and the box. The cover goes on beyond."""
    blur = covered(SHAPE, beyond=True)
    scene, alone = Scene(blur, SIGMA), Scene(blur, SIGMA)
    whole = alone.box
    alone._pressed = lambda _: whole
    restorers = Auto(scene), Auto(alone)

    def restore(frame):
        for each in (scene, alone):
            each.measure_range(frame)
        first, second = (each(frame) for each in restorers)
        return *(each._replace(image=scene.inside(each.image)) for each in (first, second)), scene.box

    return restore


@pytest.mark.parametrize("place", [(15, 17), (8, 22), (24, 10)])
def test_where_it_is_pressed_the_image_is_what_it_is_all_over(sensed, both, place):
    truth = disc(*place)
    for _ in range(5):
        done, full, part = both(sensed(truth))
        assert part[1] - part[0] < SHAPE[0] / 2
        assert done.method == full.method == "learned"
        assert nrmse(done.image, truth) < 1.05 * nrmse(full.image, truth)
        assert np.sqrt(np.mean((done.image - full.image) ** 2)) < SIGMA
        assert done.image.sum() == pytest.approx(truth.sum(), rel=0.02)


def test_a_contact_that_crosses_is_never_cut(sensed, both):
    errors = []
    for step in np.arange(0, 26, 0.25):
        truth = disc(2 + step, 3 + 1.1 * step)
        done, full, part = both(sensed(truth))
        assert part[1] - part[0] < SHAPE[0]
        errors.append((nrmse(done.image, truth), nrmse(full.image, truth)))
    some, every = np.array(errors).T
    assert some.mean() < 1.01 * every.mean()
    assert (some < 1.1 * every).all()


LEAVING = {
    "contacts at both ends": lambda contact: contact + disc(3, 3) + disc(27, 31),
    "wide and faint": lambda contact: contact + 1.0,
    "fainter": lambda contact: contact + 0.25 * SIGMA,
    "nothing": lambda contact: 0 * contact,
}


@pytest.mark.parametrize("case", LEAVING)
def test_all_is_restored_where_more_than_one_small_contact_presses(sensed, covered, case):
    pressed = Pressed(covered(SHAPE), SIGMA)
    assert pressed(sensed(disc(12, 12)))[4]
    for _ in range(8):
        assert pressed(sensed(LEAVING[case](disc(12, 12)))) == pressed.whole


def test_all_is_restored_where_there_is_power_that_no_taxel_and_no_sum_shows(sensed, covered):
    pressed = Pressed(covered(SHAPE), SIGMA)
    ripple = (-1.0) ** np.add.outer(*map(np.arange, SHAPE))
    assert pressed(sensed(disc(12, 12)) + (0.6 * SIGMA * ripple).astype(np.float32)) == pressed.whole


def test_what_nothing_tells_from_noise_is_not_left_out_of_a_faint_frame(sensed, covered):
    """A contact ten times the noise: what may hide around it is a tenth of it."""
    pressed = Pressed(covered(SHAPE), SIGMA)
    assert pressed(sensed(disc(12, 12, 3.0, 5.0))) == pressed.whole


@pytest.mark.parametrize(
    ("arguments", "place", "clear"),
    [
        ({"refine": 2}, (6, 6), True),
        ({"refine": 2}, (2, 6), False),
        ({"layout": True}, (6, 6), True),
        ({}, (6, 6), True),
        ({"beyond": True}, (6, 6), True),
        ({"beyond": True}, (1, 6), False),
    ],
    ids=["refined", "at the border", "layout", "ends with the taxels", "goes on", "goes on at the border"],
)
def test_the_box_is_in_cells_of_the_surface(covered, arguments, place, clear):
    """Around the cell of a single taxel that reads something, by two pitches and half a cell."""
    blur = covered((13, 13), **arguments)
    scene, frame = Scene(blur, SIGMA), np.zeros((13, 13), np.float32)
    frame[place] = 1000
    part = Pressed(blur, SIGMA)(frame.reshape(blur.frame_shape))
    assert part[4] == clear
    cells, own = scene.blur.surface_shape[0] // 13, 0
    if blur.wide is not None:
        cells, own = blur.refine, blur.wide.own[0].start
    left, right = own + cells * (place[1] - 2), own + cells * (place[1] + 3)
    assert abs(part[2] - left) < cells
    assert abs(part[3] - right) < cells
    assert (part[0] == 0) == (not clear)
