import numpy as np
import pytest

from tactiled.calibrate.upkeep.taxel_map import check_map
from tests.plans import plan

SHAPE = 12, 9
NOISE = 1.0  # kPa


def roll(thickness=1.0, shape=SHAPE, seed=1, along="x"):
    """Pressures (T, N) on the taxels, in their right places, while a finger rolls over every row or column."""
    skin, random = plan(shape, thickness), np.random.default_rng(seed)
    x, y = skin.array.positions.T
    (rows, columns), frames = shape, []
    for line in np.arange(0, rows if along == "x" else columns, 2):
        for at in np.arange(0, columns if along == "x" else rows, 0.5):
            place = (at, line) if along == "x" else (line, at)
            pressed = random.uniform(50, 100) * (np.hypot(x - place[0], y - place[1]) < 2.2)
            frames.append(skin.blur.forward(pressed.reshape(shape).astype(float)).ravel())
    return np.array(frames) + random.normal(0, NOISE, (len(frames), rows * columns))


def one_roll(direction, shape=SHAPE):
    """Pressures (T, N) of a bar that rolls over the array once."""
    skin = plan(shape, 1.0)
    place = skin.array.positions[:, 0 if direction == "right" else 1]
    bars = [80.0 * (np.abs(place - at) < 1.2) for at in np.arange(0, place.max() + 0.1, 0.25)]
    return np.array([skin.blur.forward(each.reshape(shape)).ravel() for each in bars])


@pytest.mark.parametrize("thickness", [0.5, 1.0, 2.0])
def test_a_right_map_is_as_configured(thickness):
    for seed in range(5):
        verdict = check_map(roll(thickness, seed=seed), plan(SHAPE, thickness).array, NOISE)
        assert (verdict.text, verdict.swaps) == ("as configured", ())


def test_a_spread_of_gains_and_a_dead_taxel_are_no_wrong_map():
    for seed in range(5):
        gain = np.random.default_rng(seed).normal(1, 0.2, SHAPE[0] * SHAPE[1]).clip(0.5, 1.5)
        gain[20 + seed] = 0
        assert check_map(gain * roll(seed=seed), plan(SHAPE, 1.0).array, NOISE).text == "as configured"


@pytest.mark.parametrize(
    ("name", "wire"),
    [
        ("every other row mirrored", lambda t: np.where(np.arange(12)[:, None] % 2, t[:, ::-1], t)),
        ("every other column mirrored", lambda t: np.where(np.arange(9) % 2, t[::-1], t)),
        ("rows and columns transposed", lambda t: t.T),
    ],
)
def test_a_wrong_wiring_is_named_and_its_order_puts_it_right(name, wire):
    right = roll()
    wired = right[:, wire(np.arange(right.shape[1]).reshape(SHAPE)).ravel()]  # as the skin sends it
    verdict = check_map(wired, plan(SHAPE, 1.0).array, NOISE)
    assert verdict.text == name
    np.testing.assert_array_equal(wired[:, verdict.order], right)


@pytest.mark.parametrize("pairs", [[(3, 77)], [(40, 41)], [(3, 77), (20, 58), (0, 107)]])
@pytest.mark.parametrize("layout", [False, True])
def test_swapped_taxels_are_named(pairs, layout):
    wired = roll()
    for a, b in pairs:
        wired[:, [a, b]] = wired[:, [b, a]]
    verdict = check_map(wired, plan(SHAPE, 1.0, layout=layout).array, NOISE)
    assert sorted(verdict.swaps) == sorted(pairs)
    assert f"taxels {pairs[0][0]} and {pairs[0][1]} swapped" in verdict.text


@pytest.mark.parametrize(
    ("direction", "turn", "text"),
    [
        ("right", lambda f: f, "as configured"),
        ("right", lambda f: f[:, :, ::-1], "columns mirrored"),
        ("right", lambda f: f[:, ::-1], "as configured"),  # which a roll to the right cannot show
        ("down", lambda f: f[:, ::-1], "rows mirrored"),
        ("down", lambda f: f.transpose(0, 2, 1), "rows and columns transposed"),
    ],
)
def test_the_direction_of_a_roll_shows_a_map_that_is_turned_as_one(direction, turn, text):
    shape = (10, 10)
    wired = turn(one_roll(direction, shape).reshape(-1, *shape)).reshape(-1, 100)
    assert check_map(wired, plan(shape, 1.0).array, NOISE, direction).text == text


def test_a_roll_over_half_of_the_array_cannot_tell():
    half = roll()
    half[:, : half.shape[1] // 2] = 0
    verdict = check_map(half, plan(SHAPE, 1.0).array, NOISE)
    assert verdict.text == "cannot tell: 50% of the taxels were pressed: roll over all of them"
    assert verdict.order is None
