import numpy as np
import pytest

from tactiled.calibrate.upkeep.map_monitor import WINDOW_FRAMES, MapMonitor
from tactiled.simulate.array import Surface
from tactiled.simulate.scenes import SCENES
from tests.bench.health import KPA_PER_COUNT, NO_LOAD, Run
from tests.plans import plan

SIDE, NOISE = 12, 0.3
TABLE = np.arange(SIDE**2).reshape(SIDE, SIDE)
RIGHT = TABLE.ravel()


def touches(thickness, seed, count=400):
    """Frames (T, N) in kPa, 0.1 s apart: a disc at ever other places, on taxels whose gains differ by 20 %."""
    skin, random = plan((SIDE, SIDE), thickness), np.random.default_rng(seed)
    surface, gain = Surface(skin.kernel, skin.array), np.exp(random.normal(0, 0.2, SIDE**2))
    for _ in range(count):
        x, y = random.uniform(-SIDE / 2, SIDE / 2, 2)
        inside = random.uniform(1.5, 3) - np.hypot(surface.x - x, surface.y - y)
        pressure = 80 * np.clip(inside / surface.grain + 0.5, 0, 1)
        yield (gain * surface.sense(pressure) + random.normal(0, NOISE, SIDE**2)).astype(np.float32)


def watched(frames, wire=RIGHT, monitor=None):
    """A monitor that has seen frames which the skin sends in the order `wire`."""
    monitor = monitor or MapMonitor(plan((SIDE, SIDE)).array)
    for n, frame in enumerate(frames):
        monitor.observe(n / 10, frame[wire], np.full(SIDE**2, NOISE, np.float32))
        monitor.judge()
    return monitor


@pytest.mark.parametrize("thickness", [0.5, 2.0])
def test_a_right_map_is_not_doubted(thickness):
    monitor = watched(touches(thickness, 1))
    assert monitor.judged
    assert monitor.wrong == ()


def exchanged(blocks, a, b):
    """The wiring of two blocks, (blocks, n) taxels, that are swapped."""
    wire = RIGHT.copy()
    wire[blocks[a]], wire[blocks[b]] = blocks[b], blocks[a]
    return wire


@pytest.mark.parametrize(
    ("wire", "wrong"),
    [
        (exchanged(RIGHT[:, None], 40, 77), "taxels 40 and 77 swapped"),
        (np.where(np.arange(SIDE)[:, None] % 2, TABLE[:, ::-1], TABLE).ravel(), "every other row mirrored"),
        (exchanged(TABLE, 3, 8), "row 3 and row 8 swapped"),
        (exchanged(TABLE.T, 5, 9), "column 5 and column 9 swapped"),
        (exchanged(RIGHT.reshape(4, -1), 1, 3), "taxels 36 to 71 and taxels 108 to 143 swapped"),
    ],
)
def test_a_wrong_map_is_named_and_withdrawn_when_it_is_put_right(wire, wrong):
    monitor = watched(touches(1.0, 2), wire)
    assert monitor.wrong == (wrong,)
    assert np.flatnonzero(monitor.swapped).tolist() == ([40, 77] if "taxels 40" in wrong else [])
    watched(touches(1.0, 3), RIGHT, monitor)
    assert monitor.wrong == ()
    assert not monitor.swapped.any()


def test_a_load_that_stands_still_or_covers_little_says_nothing():
    frame = next(touches(1.0, 4))
    still = watched(frame + np.zeros((400, 1), np.float32))
    assert len(still._frames) == 1
    quarter = watched(each * (RIGHT % SIDE < SIDE / 4) for each in touches(1.0, 5))
    assert not quarter.judged
    assert len(quarter._frames) < WINDOW_FRAMES


def test_frames_in_counts_reach_it_without_taxels_that_are_not_read():
    run, load = Run(plan((SIDE, SIDE), 1.0)), next(touches(1.0, 6)) / KPA_PER_COUNT
    for n in range(40):
        run.push(NO_LOAD + (load if n > 20 else 0 * load))
    (frame,) = run.monitor.map._frames
    np.testing.assert_allclose(frame, np.maximum(load, -NO_LOAD).round(), atol=0.5)


def test_a_tip_that_rocks_over_a_small_skin_does_not_make_its_map_doubtful():
    skin, random = plan((4, 6), 1.0), np.random.default_rng(1)
    surface, monitor = Surface(skin.kernel, skin.array), MapMonitor(skin.array)
    for n in range(1000):
        tip = SCENES["fingertip"](surface.x, surface.y, 0.13 * n, surface.size, surface.grain)
        load = surface.sense(tip).ravel() + random.normal(0, NOISE, 24)
        monitor.observe(0.13 * n, load.astype(np.float32), np.full(24, NOISE, np.float32))
        monitor.judge()
        assert monitor.wrong == ()
    assert monitor.judged
