from dataclasses import replace

import numpy as np
import pytest

from tactiled.contacts.detection import MAX_CONTACTS, DetectedContact, Finder
from tactiled.contacts.tracking import Tracker
from tactiled.geometry import grid, layout, raster
from tactiled.restore.methods import make
from tactiled.simulate.array import Surface
from tests.bench.border import hexagonal
from tests.plans import plan

SIDE, NOISE = 24, 0.3
ARRAY = grid(SIDE, SIDE, 1.0, 0.8)


@pytest.fixture(scope="module")
def find():
    return Finder(ARRAY, raster(ARRAY, 1))


def discs(x, y, *places):
    """kPa of flat punches of radius 1.6 mm at (x, y, kPa)."""
    return sum(each[2] * np.clip(4 * (1.6 - np.hypot(x - each[0], y - each[1])) + 0.5, 0, 1) for each in places)


def bumps(positions, *places, width=1.0):
    """kPa of smooth bumps at (x, y, kPa)."""
    distances = [np.hypot(positions[:, 0] - x, positions[:, 1] - y) / width for x, y, _ in places]
    return sum(kpa * np.exp(-(each**2) / 2) for each, (_, _, kpa) in zip(distances, places, strict=True))


def noisy(image, sigma, seed):
    return (image + np.random.default_rng(seed).normal(0, sigma, image.shape)).astype(np.float32)


def by_x(contacts):
    return sorted(contacts, key=lambda contact: contact.x_mm)


@pytest.fixture(scope="module")
def press():
    """Frames of punches under 2 mm of rubber, blurred exactly; their restorations, noise and force."""
    exact, restoring = (plan((SIDE, SIDE), 2.0, substrate=True, model=model) for model in ("layered", "fem"))
    surface, middle = Surface(exact.kernel, ARRAY), (SIDE - 1) / 2

    def press(*places, seed=0):
        pressure = discs(surface.x + middle, surface.y + middle, *places)
        frame = noisy(surface.sense(pressure).reshape(SIDE, SIDE), NOISE, seed)
        done = make("nnls", restoring.blur, NOISE)(frame)
        return frame, done.image.copy(), NOISE * max(done.noise_gain, 1), pressure.sum() * surface.grain**2 * 1e-3

    return press


@pytest.mark.parametrize("place", [(7.3, 12.8, 80), (15.0, 6.5, 40), (11.7, 11.2, 120)])
def test_place_and_force_of_a_contact_are_those_of_the_press(find, press, place):
    frame, restored, noise, force = press(place)
    (raw,), (contact,) = find(frame, NOISE), find(restored, noise)
    assert (contact.x_mm, contact.y_mm) == pytest.approx(place[:2], abs=0.05)
    assert contact.force == pytest.approx(force, rel=0.05)
    assert abs(contact.force - force) < abs(raw.force - force)  # the raw one loses its skirt
    assert contact.area_mm2 < raw.area_mm2
    assert contact.id == 0


def test_two_contacts_that_touch_are_two_where_the_raw_image_has_one(find, press):
    frame, restored, noise, _ = press((9.6, 12.0, 80), (13.3, 12.3, 70))
    assert len(find(frame, NOISE)) == 1
    assert [each.x_mm for each in by_x(find(restored, noise))] == pytest.approx([9.6, 13.3], abs=0.2)


def test_a_faint_contact_is_found_while_a_strong_one_presses_elsewhere(find, press):
    for seed in range(5):
        _, restored, noise, _ = press((5.3, 5.8, 100), (17.6, 16.2, 9), seed=seed)
        assert 5 * noise < 9
        _, faint = find(restored, noise)
        assert (faint.x_mm, faint.y_mm) == pytest.approx((17.6, 16.2), abs=0.2)


@pytest.mark.parametrize("noise", [0.0, NOISE])
def test_noise_is_no_contact(find, noise):
    assert find(noisy(np.zeros((SIDE, SIDE)), noise, 1), NOISE) == []


def test_of_more_peaks_than_any_skin_shows_the_highest_are_contacts():
    array, image = grid(64, 64, 1.0), np.zeros((64, 64), np.float32)
    image[::2, ::2] = np.random.default_rng(0).uniform(50.0, 100.0, (32, 32))
    contacts = Finder(array, raster(array, 1))(image, 0.01)
    assert len(contacts) == MAX_CONTACTS
    assert min(each.peak for each in contacts) == np.sort(image, axis=None)[-MAX_CONTACTS]


def test_axes_and_angle_on_refined_cells():
    y, x = np.mgrid[: 2 * SIDE, : 2 * SIDE] * 0.5 - 0.25
    u, v = (x - 8) * np.cos(0.5) + (y - 9) * np.sin(0.5), (y - 9) * np.cos(0.5) - (x - 8) * np.sin(0.5)
    (contact,) = Finder(ARRAY, raster(ARRAY, 2))((100 * np.exp(-(u**2) / 18 - v**2 / 2)).astype(np.float32), 0.1)
    assert (contact.x_mm, contact.y_mm) == pytest.approx((8, 9), abs=0.02)
    assert contact.angle_rad == pytest.approx(0.5, abs=0.02)
    assert 2 < contact.major_mm / contact.minor_mm < 3.5
    assert contact.force == pytest.approx(100 * 2 * np.pi * 3 * 1e-3, rel=0.11)  # less the skirt under a tenth


@pytest.mark.parametrize(("row", "beyond", "expected"), [
    (0, None, True), (5, None, False), (0, (0.0, 2.0, 2.0, 2.0), False), (SIDE - 2, (0.0, 2.0, 2.0, 2.0), True),
])  # fmt: skip
def test_a_contact_at_the_border_is_cut_off_where_the_cover_goes_on(row, beyond, expected):
    image = np.zeros((SIDE, SIDE), np.float32)
    image[row : row + 2, 6:9] = 50
    (contact,) = Finder(replace(ARRAY, beyond=beyond), raster(ARRAY, 1))(image, 0.1)
    assert contact.cut_off == expected


def test_what_rings_below_zero_around_a_contact_does_not_shrink_it(find):
    image = np.zeros((SIDE, SIDE), np.float32)
    image[9:13, 9:13] = -6
    image[10:12, 10:12] = 20
    (contact,) = find(image, 0.1)
    assert (contact.x_mm, contact.y_mm) == (10.5, 10.5)
    assert contact.major_mm == pytest.approx(2 / 12**0.5)  # of a square of 2 mm
    assert contact.force == pytest.approx(1e-3 * (4 * 20 - 8 * 6))


def test_a_force_is_known_as_its_independent_cells_are_and_an_empty_image_asks_for_none(find):
    image, asked = np.zeros((SIDE, SIDE), np.float32), []

    def deviation():
        asked.append(1)
        return np.full((SIDE, SIDE), 3.0, np.float32)

    assert (find(image, 0.1, deviation=deviation), asked) == ([], [])
    image[10:12, 10:12] = 20
    (contact,) = find(image, 0.1, deviation=deviation)
    assert contact.force_deviation == pytest.approx(3e-3 * 12**0.5)  # with the skirt, 12 squares of 1 mm
    (contact,) = find(image, 0.1, deviation=lambda: np.full((SIDE, SIDE), 1e3, np.float32))
    assert contact.force_deviation == pytest.approx(contact.force / 2)  # there is no other force
    (contact,) = find(image, 0.1)
    assert np.isnan(contact.force_deviation)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (1, 3), (4, 2)])
@pytest.mark.parametrize("refine", [1, 2])
def test_axes_of_an_even_block_are_its_sides(rows, columns, refine):
    image = np.zeros((refine * SIDE, refine * SIDE), np.float32)
    image[8 : 8 + rows * refine, 6 : 6 + columns * refine] = 50
    (contact,) = Finder(ARRAY, raster(ARRAY, refine))(image, 0.1)
    width, height = sorted((rows, columns))
    assert (contact.minor_mm, contact.major_mm) == pytest.approx((width / 12**0.5, height / 12**0.5))


def test_a_gap_between_the_parts_of_a_layout_parts_contacts_and_is_in_none():
    x, y = np.meshgrid([0, 1, 2, 3, 6, 7, 8, 9], np.arange(6))
    array = layout(np.column_stack([x.ravel(), y.ravel()]), 1.0)
    cells = raster(array, 2)
    image = np.full(cells.shape, 10, np.float32)
    for contact, centre in zip(by_x(Finder(array, cells)(image, 0.1)), (1.5, 7.5), strict=True):
        assert (contact.x_mm, contact.area_mm2, contact.force) == pytest.approx((centre, 24, 10 * 24e-3))
        assert contact.cut_off


@pytest.mark.parametrize("place", [(10.4, 5.8, 9), (17.6, 16.2, 1.5)])
def test_what_rings_near_a_strong_contact_and_far_from_it_is_no_contact(find, place):
    image = bumps(ARRAY.positions, (5.3, 5.8, 100), place).reshape(SIDE, SIDE)
    assert len(find(image.astype(np.float32), 0.02)) == 1


def test_the_long_skirt_of_a_contact_under_a_thick_cover_is_no_contact(find):
    distance = np.hypot(*(ARRAY.positions - (6.3, 7.2)).T)
    image = (100 / (1 + (distance / 2) ** 2) ** 2).reshape(SIDE, SIDE)
    assert {len(find(noisy(image, 0.05, seed), 0.05)) for seed in range(10)} == {1}


def test_noise_does_not_split_a_weak_contact(find):
    image = discs(*ARRAY.positions.T, *[(10 + x / 2, 11.3, 6 * NOISE) for x in range(-5, 6)]).reshape(SIDE, SIDE)
    image = np.minimum(image, 8 * NOISE)
    assert {len(find(noisy(image, NOISE, seed), NOISE)) for seed in range(20)} == {1}


@pytest.mark.parametrize(
    "array", [layout(2.0 * hexagonal(12, 12), 1.6), grid(12, 12, 2.0, 1.6)], ids=["hexagons", "grid"]
)
def test_two_contacts_with_a_dip_between_are_two_on_every_layout(array):
    cells = raster(array, 2)
    find = Finder(array, cells)
    image = bumps(cells.positions, (6.3, 9.6, 80), (13.1, 10.2, 70), width=1.5)
    contacts = by_x(find(image.reshape(cells.shape).astype(np.float32), 0.1))
    assert [each.x_mm for each in contacts] == pytest.approx([6.3, 13.1], abs=0.2)
    forces = [kpa * 2 * np.pi * 1.5**2 * 1e-3 for kpa in (80, 70)]
    assert [each.force for each in contacts] == pytest.approx(forces, rel=0.05)  # with their skirts
    image = bumps(cells.positions, (8.3, 9.6, 80), (10.1, 10.2, 70), width=1.5)
    assert len(find(image.reshape(cells.shape).astype(np.float32), 0.1)) == 1


def at(x, y=5.0, kpa=10.0, area=1):
    return DetectedContact(0, x, y, 1, area, kpa, 1, 1, 0)


class Tracked:
    """A tracker that gets contacts at a steady pace, and gives their ids; those under 5 kPa are faint."""

    def __init__(self, pitch=1.0, every_s=0.05):
        self.track, self.every_s, self.time = Tracker(pitch), every_s, 100.0

    def __call__(self, *contacts, after_s=None):
        self.time += self.every_s if after_s is None else after_s
        return [each.id for each in self.track(list(contacts), self.time, 5.0)]


PAUSE = 10.0


@pytest.mark.parametrize(
    "steps",
    [
        # a contact keeps its id while it lasts, in whatever order
        [((at(0), at(10)), [1, 2]), ((at(9), at(1)), [2, 1]), ((at(8), at(1, 6), at(1, 14)), [2, 1, 3])],
        # a ring and what is within it keep their ids, though noise moves their centres past each other
        [((at(0, area=95), at(0.1, area=38)), [1, 2]), ((at(0.1, area=90), at(0, area=41)), [1, 2])],
        # a newcomer takes no id from one that has become faint
        [((at(0),), [1]), ((at(6), at(0.1, kpa=3.0)), [2, 1]), ((at(6), at(0.1, kpa=3.0)), [2, 1])],
        # one is lifted, another put down too far off
        [((at(10), at(15)), [1, 2]), ((at(10.3), at(1)), [1, 3])],
        # both go on, though 2 is nearer to 11.6
        [((at(10), at(12)), [1, 2]), ((at(11.6), at(14)), [1, 2])],
        # one that is swift is not linked where two may be it
        [((at(10),), [1]), ((at(14), at(6)), [2, 3])],
        # nor after a pause, unless it is where it was
        [((at(10),), [1]), (PAUSE, (at(14),), [2]), (PAUSE, (at(14.5),), [2])],
        # one comes back soon with its id and late with another; one that is gone does not go on
        [((at(10.2),), [1]), ((), []), ((at(10.4),), [1]), *5 * [((), [])], ((at(10.3),), [2]), ((), []),
         ((at(14),), [3])],
        # where images come slowly, one that some in turn do not show goes on, and after a second does not
        [((at(10),), [1]), (0.3, (), []), (0.3, (at(10),), [1]), (0.6, (), []), (0.6, (at(10),), [2])],
        # one that moves is awaited where it goes
        [*[((at(2.5 * n),), [1]) for n in range(5)], ((), []), ((), []), ((at(17.5),), [1])],
        # a faint one goes on nearby and does not begin
        [((at(10, kpa=4),), []), ((at(10),), [1]), ((at(10.5, kpa=4), at(4, kpa=4)), [1]),
         ((at(12.5, kpa=4),), [])],
    ],
)  # fmt: skip
def test_ids_from_image_to_image(steps):
    track = Tracked()
    for *pause, contacts, ids in steps:
        assert track(*contacts, after_s=pause[0] if pause else None) == ids


def test_reach_is_in_pitches():
    track = Tracked(pitch=2.0)
    assert track(at(10), at(14)) == [1, 2]
    assert track(at(10.3), at(2)) == [1, 3]


@pytest.mark.parametrize("every_s", [0.01, 0.05, 0.1])
def test_a_swift_contact_keeps_its_id_and_so_do_two_that_pass_each_other(every_s):
    track = Tracked(every_s=every_s)
    for time in np.arange(0, 2, every_s):
        assert track(at(16 + 12 * np.cos(8 * time), 16 + 12 * np.sin(8 * time))) == [1]
    track = Tracked(every_s=every_s)
    for time in np.arange(0, 1, every_s):
        assert track(at(2 + 25 * time, 5.0), at(27 - 25 * time, 9.0)) == [1, 2]


def test_a_contact_at_the_threshold_of_the_noise_has_one_id(find):
    track = Tracker(1.0)
    image = bumps(ARRAY.positions, (7.3, 7.6, 5 * NOISE)).reshape(SIDE, SIDE)
    named = [
        track(find(noisy(image, NOISE, seed), NOISE, faint=track.holds), 0.05 * seed, 5 * NOISE)
        for seed in range(30)
    ]
    assert {each.id for contacts in named for each in contacts} == {1}
    assert sum(len(contacts) == 1 for contacts in named) > 25


def test_a_faint_speck_near_a_strong_contact_is_none_where_it_is_in_doubt(find):
    x, y = ARRAY.positions.T
    image = np.float32(discs(x, y, (7, 7, 100), (14, 7, 15)).reshape(SIDE, SIDE))

    def found(deviation, blurred=False):
        return len(find(image, NOISE, deviation=lambda: np.full_like(image, deviation), blurred=blurred))

    assert (found(9), found(11), found(11, blurred=True)) == (2, 1, 2)


def test_a_ring_whose_dips_are_near_the_bound_keeps_its_ids_until_a_dip_is_clear(find):
    around = ARRAY.positions - (SIDE - 1) / 2
    angle = np.arctan2(around[:, 1], around[:, 0])
    ring = np.exp(-((np.hypot(*around.T) - 7.3) ** 2) / 2).reshape(SIDE, SIDE)
    wave = np.cos(4 * angle).reshape(SIDE, SIDE)
    for share, ids in ((0.0, {1}), (0.32, {1, 2, 3, 4})):
        track = Tracker(1.0)
        assert len(find(100 * ring * (1 + share * wave), NOISE)) == len(ids)
        for seed in range(20):
            image = noisy(100 * ring * (1 + 0.22 * wave), 2.0, seed)
            named = track(find(image, NOISE, before=find.parts), 0.05 * seed, 5 * NOISE)
            assert {each.id for each in named} == ids

    assert len(find(100 * ring * (1 + 0.22 * wave), NOISE)) == 1
    assert (
        len(find(np.where(angle.reshape(SIDE, SIDE) > 2.6, 0, 100 * ring * (1 + 0.22 * wave)), NOISE)) > 1
    )  # no hole

    def parted(depth, deviation, blurred=False):
        image = 100 * ring * (1 + depth * wave)
        return len(find(image, NOISE, deviation=lambda: np.full_like(ring, deviation), blurred=blurred))

    assert (parted(0.29, 33), parted(0.29, 40), parted(0.29, 40, blurred=True)) == (4, 1, 4)
    assert parted(0.4, 200) == 4  # a dip of half of the peak
    dips = 100 * ring * (1 + 0.32 * wave)
    assert len(find(dips, NOISE, before=find.parts)) == 4
    assert len(find(100 * ring, NOISE, before=find.parts)) == 1
    holes = np.where(np.arange(SIDE) < SIDE // 2, np.nan, 100 * ring).astype(np.float32)
    assert find(holes, NOISE, shares=np.isfinite(holes).astype(np.float32), before=find.parts) == []
    near = 100 * ring * (1 + 0.2 * wave)
    assert len(find(near, NOISE, before=find.parts)) == 1  # it was one where messages were not lost
