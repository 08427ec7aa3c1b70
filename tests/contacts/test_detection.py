import numpy as np
import pytest

from tactiled.contacts.detection import Contact, Finder, Tracker
from tactiled.cover.kernel import solve
from tactiled.cover.stack import Layer, Stack
from tactiled.geometry import Cells, grid, layout, tiling
from tactiled.restore.methods import make
from tactiled.simulate.array import Surface
from tests.plans import plan

SIDE, NOISE = 24, 0.3


@pytest.fixture(scope="module")
def array():
    return grid(SIDE, SIDE, 1.0, 0.8)


def discs(x, y, *places):
    """kPa of flat punches of radius 1.6 mm at (x, y, kPa)."""
    return sum(each[2] * np.clip(4 * (1.6 - np.hypot(x - each[0], y - each[1])) + 0.5, 0, 1) for each in places)


@pytest.fixture(scope="module")
def press(array):
    """Frames of punches under 2 mm of rubber, blurred exactly and 4 times finer; and their restorations."""
    stack = Stack((Layer(2.0, 0.6, 0.48), Layer(1.0, 980.0, 0.3)))
    exact = solve(stack, "layered")
    surface = Surface(exact, array)
    blur = plan((SIDE, SIDE), 2.0, substrate=True, model="fem").blur

    def press(*places, seed=0):
        middle = (SIDE - 1) / 2
        pressure = discs(surface.x + middle, surface.y + middle, *places)
        noise = np.random.default_rng(seed).normal(0, NOISE, (SIDE, SIDE))
        frame = (surface.sense(pressure).reshape(SIDE, SIDE) + noise).astype(np.float32)
        done = make("nnls", blur, NOISE)(frame)
        return frame, done.image.copy(), NOISE * max(done.noise_gain, 1), pressure.sum() * surface.grain**2 * 1e-3

    return press


def test_a_contact_is_where_it_is_and_weighs_what_it_weighs(array, press):
    find = Finder(array, tiling(array))
    for seed, place in enumerate([(7.3, 12.8, 80), (15.0, 6.5, 40), (11.7, 11.2, 120)]):
        frame, restored, noise, force = press(place, seed=seed)
        (felt,), (found,) = find(frame, NOISE), find(restored, noise)
        assert found.x_mm == pytest.approx(place[0], abs=0.05)
        assert found.y_mm == pytest.approx(place[1], abs=0.05)
        assert found.force_n == pytest.approx(force, rel=0.05)
        assert abs(found.force_n - force) < abs(felt.force_n - force)  # the raw one loses its skirt
        assert found.area_mm2 < felt.area_mm2
        assert found.id == 0


def test_two_that_touch_are_told_apart_where_the_raw_image_shows_one(array, press):
    find = Finder(array, tiling(array))
    frame, restored, noise, _ = press((9.6, 12.0, 80), (13.3, 12.3, 70))
    assert len(find(frame, NOISE)) == 1
    first, second = sorted(find(restored, noise), key=lambda contact: contact.x_mm)
    assert (first.x_mm, second.x_mm) == (pytest.approx(9.6, abs=0.2), pytest.approx(13.3, abs=0.2))


@pytest.mark.parametrize("values", [np.zeros, lambda shape: np.random.default_rng(1).normal(0, NOISE, shape)])
def test_nothing_is_found_where_nothing_is(array, values):
    assert Finder(array, tiling(array))(values((SIDE, SIDE)).astype(np.float32), NOISE) == []


def test_axes_and_refined_cells(array):
    y, x = np.mgrid[: 2 * SIDE, : 2 * SIDE] * 0.5 - 0.25
    u, v = (x - 8) * np.cos(0.5) + (y - 9) * np.sin(0.5), (y - 9) * np.cos(0.5) - (x - 8) * np.sin(0.5)
    (found,) = Finder(array, tiling(array, 2))((100 * np.exp(-(u**2) / 18 - v**2 / 2)).astype(np.float32), 0.1)
    assert (found.x_mm, found.y_mm) == (pytest.approx(8, abs=0.02), pytest.approx(9, abs=0.02))
    assert found.angle_rad == pytest.approx(0.5, abs=0.02)
    assert 2 < found.major_mm / found.minor_mm < 3.5
    assert found.force_n == pytest.approx(100 * 2 * np.pi * 3 * 1 * 1e-3, rel=0.11)  # less the skirt under a tenth


def test_what_rings_below_zero_around_a_contact_does_not_shrink_it(array):
    image = np.zeros((24, 24), np.float32)
    image[9:13, 9:13] = -6
    image[10:12, 10:12] = 20
    (found,) = Finder(array, tiling(array))(image, 0.1)
    assert (found.x_mm, found.y_mm) == (10.5, 10.5)
    assert found.major_mm == pytest.approx(2 / 12**0.5)  # of a square of 2 mm
    assert found.force_n == pytest.approx(1e-3 * (4 * 20 - 8 * 6))


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 3), (4, 2)])
@pytest.mark.parametrize("refine", [1, 2])
def test_an_even_block_is_as_long_and_as_wide_as_it_is(array, rows, columns, refine):
    image = np.zeros((refine * SIDE, refine * SIDE), np.float32)
    image[8 : 8 + rows * refine, 6 : 6 + columns * refine] = 50
    (found,) = Finder(array, tiling(array, refine))(image, 0.1)
    width, height = sorted((rows, columns))
    assert (found.minor_mm, found.major_mm) == pytest.approx((width / 12**0.5, height / 12**0.5))


def test_a_layout_that_is_no_grid():
    ring = np.array([(3 * np.cos(t), 3 * np.sin(t)) for t in np.linspace(0, 2 * np.pi, 7)[:-1]])
    array = layout(np.concatenate([ring, ring + np.array([20, 0])]), 1.0)
    find = Finder(array, Cells(array.positions, 3.0, np.arange(12)))
    image = np.zeros(12, np.float32)
    image[[0, 1, 8]] = 10, 10, 30
    strong, weak = find(image, 0.1)
    assert (strong.x_mm, strong.force_n) == (pytest.approx(18.5), pytest.approx(30 * 9e-3))
    assert (weak.x_mm, weak.area_mm2) == (pytest.approx(2.25), pytest.approx(18))


def bumps(positions, *places, width=1.0):
    """kPa of smooth bumps at (x, y, kPa)."""
    away = [np.hypot(positions[:, 0] - x, positions[:, 1] - y) / width for x, y, _ in places]
    return sum(kpa * np.exp(-(each**2) / 2) for each, (_, _, kpa) in zip(away, places, strict=True))


def noisy(image, sigma, seed):
    return (image + np.random.default_rng(seed).normal(0, sigma, image.shape)).astype(np.float32)


def test_a_faint_contact_is_found_while_a_strong_one_presses_elsewhere(array, press):
    find = Finder(array, tiling(array))
    for seed in range(5):
        _, restored, noise, _ = press((5.3, 5.8, 100), (17.6, 16.2, 9), seed=seed)
        assert 5 * noise < 9
        _, faint = find(restored, noise)
        assert (faint.x_mm, faint.y_mm) == (pytest.approx(17.6, abs=0.2), pytest.approx(16.2, abs=0.2))


@pytest.mark.parametrize("place", [(10.4, 5.8, 9), (17.6, 16.2, 1.5)])
def test_what_rings_round_a_strong_contact_and_far_from_it_is_none(array, place):
    image = bumps(array.positions, (5.3, 5.8, 100), place).reshape(SIDE, SIDE)
    assert len(Finder(array, tiling(array))(image.astype(np.float32), 0.02)) == 1


def test_the_long_skirt_of_a_contact_under_a_thick_cover_is_no_contact(array):
    away = np.hypot(*(array.positions - (6.3, 7.2)).T)
    image = (100 / (1 + (away / 2) ** 2) ** 2).reshape(SIDE, SIDE)
    for seed in range(10):
        assert len(Finder(array, tiling(array))(noisy(image, 0.05, seed), 0.05)) == 1


def test_noise_does_not_split_a_weak_contact(array):
    image = discs(*array.positions.T, *[(10 + x / 2, 11.3, 6 * NOISE) for x in range(-5, 6)]).reshape(SIDE, SIDE)
    image = np.minimum(image, 8 * NOISE)
    for seed in range(20):
        assert len(Finder(array, tiling(array))(noisy(image, NOISE, seed), NOISE)) == 1


def hexagons(pitch=2.0, rows=12, columns=12):
    places = [(c + r % 2 / 2, r * 3**0.5 / 2) for r in range(rows) for c in range(columns)]
    return layout(pitch * np.array(places), 0.8 * pitch)


@pytest.mark.parametrize("array", [hexagons(), grid(12, 12, 2.0, 1.6)], ids=["hexagons", "grid"])
def test_two_that_touch_are_told_apart_on_every_layout(array):
    find = Finder(array, tiling(array))
    image = bumps(array.positions, (6.3, 9.6, 80), (13.1, 10.2, 70), width=1.5)
    first, second = sorted(find(image.reshape(array.frame_shape).astype(np.float32), 0.1), key=lambda c: c.x_mm)
    for found, (x, kpa) in ((first, (6.3, 80)), (second, (13.1, 70))):
        assert found.x_mm == pytest.approx(x, abs=0.2)
        assert found.force_n == pytest.approx(kpa * 2 * np.pi * 1.5**2 * 1e-3, rel=0.05)  # with its skirt
    image = bumps(array.positions, (8.3, 9.6, 80), (10.1, 10.2, 70), width=1.5)
    assert len(find(image.reshape(array.frame_shape).astype(np.float32), 0.1)) == 1


def at(x, y, kpa=10.0):
    return Contact(0, x, y, 1, 1, kpa, 1, 1, 0)


class Looks:
    """A tracker that is shown contacts at a steady pace; those under 5 kPa are faint."""

    def __init__(self, pitch=1.0, every_s=0.05):
        self.track, self.every_s, self.time = Tracker(pitch), every_s, 100.0

    def __call__(self, *found, after_s=None):
        self.time += self.every_s if after_s is None else after_s
        return [each.id for each in self.track(list(found), self.time, 5.0)]


def test_a_contact_keeps_its_id_while_it_lasts():
    look = Looks()
    assert look(at(0, 0), at(10, 0)) == [1, 2]
    assert look(at(9, 0), at(1, 0)) == [2, 1]  # the order may change
    assert look(at(8, 0), at(1, 1), at(1, 9)) == [2, 1, 3]


@pytest.mark.parametrize("every_s", [0.01, 0.05, 0.1])
def test_a_swift_contact_keeps_its_id_and_so_do_two_that_pass_each_other(every_s):
    look = Looks(every_s=every_s)
    for time in np.arange(0, 2, every_s):
        assert look(at(16 + 12 * np.cos(8 * time), 16 + 12 * np.sin(8 * time))) == [1]
    look = Looks(every_s=every_s)
    for time in np.arange(0, 1, every_s):
        assert look(at(2 + 25 * time, 5.0), at(27 - 25 * time, 9.0)) == [1, 2]


def test_a_newcomer_takes_no_id_from_one_that_has_become_faint():
    look = Looks()
    assert look(at(0, 0)) == [1]
    assert look(at(6, 0), at(0.1, 0, kpa=3.0)) == [2, 1]
    assert look(at(6, 0), at(0.1, 0, kpa=3.0)) == [2, 1]


def test_no_link_is_made_over_a_way_too_long_and_none_is_lost_for_one_that_is():
    look = Looks()
    assert look(at(10, 5), at(15, 5)) == [1, 2]
    assert look(at(10.3, 5), at(1, 5)) == [1, 3]  # one is lifted, another put down elsewhere
    look = Looks(pitch=2.0)
    assert look(at(10, 5), at(14, 5)) == [1, 2]
    assert look(at(10.3, 5), at(2, 5)) == [1, 3]
    look = Looks()
    assert look(at(10, 5), at(12, 5)) == [1, 2]
    assert look(at(11.6, 5), at(14, 5)) == [1, 2]  # both, though 2 is nearer to 11.6


def test_a_swift_one_is_not_taken_for_another_where_two_may_be_it_or_after_a_pause():
    look = Looks()
    assert look(at(10, 5)) == [1]
    assert look(at(14, 5), at(6, 5)) == [2, 3]
    look = Looks()
    assert look(at(10, 5)) == [1]
    assert look(at(14, 5), after_s=10) == [2]
    assert look(at(14.5, 5), after_s=10) == [2]  # where it was


def test_a_contact_comes_back_soon_with_its_id_and_late_with_another():
    look = Looks()
    assert look(at(10.2, 5)) == [1]
    assert look() == []
    assert look(at(10.4, 5)) == [1]
    assert [look() for _ in range(5)] == 5 * [[]]
    assert look(at(10.3, 5)) == [2]
    assert look() == []
    assert look(at(14, 5)) == [3]  # one that is gone does not go on


def test_one_that_moves_is_awaited_where_it_goes():
    look = Looks()
    for step in range(5):
        assert look(at(2.5 * step, 5)) == [1]
    assert look() == []
    assert look() == []
    assert look(at(17.5, 5)) == [1]


def test_a_faint_contact_goes_on_and_does_not_begin():
    look = Looks()
    assert look(at(10, 5, kpa=4)) == []
    assert look(at(10, 5)) == [1]
    assert look(at(10.5, 5, kpa=4), at(4, 5, kpa=4)) == [1]
    assert look(at(12.5, 5, kpa=4)) == []  # noise, rather


def test_one_at_the_threshold_of_the_noise_has_one_id(array):
    find, track = Finder(array, tiling(array)), Tracker(1.0)
    image = bumps(array.positions, (7.3, 7.6, 5 * NOISE)).reshape(SIDE, SIDE)
    seen = [
        track(find(noisy(image, NOISE, seed), NOISE, track.holds), 0.05 * seed, 5 * NOISE) for seed in range(30)
    ]
    assert {each.id for look in seen for each in look} == {1}
    assert sum(len(look) == 1 for look in seen) > 25
