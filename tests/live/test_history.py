import resource
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from tactiled.frames import SensorImage
from tactiled.live.history import MAX_RATE_HZ, History

RAW, RESTORED = (4, 4), (8, 8)
FRAME_BYTES = 5 * 16 + 4 * 64 + 33
SHEAR_BYTES = 8 * 16
UNLIMITED = 10**9


def image(n, **fields):
    shear = np.stack([np.full(RAW, n, np.float32), np.full(RAW, -n, np.float32)])
    made = SensorImage(
        sensor="palm", sequence=n, time=n / 100, raw=np.full(RAW, n, np.float32),
        restored=np.full(RESTORED, 10 * n, np.float32), flags=np.full(RAW, n % 2, np.uint8), method="nnls", why="",
        iterations=0, microseconds=0, noise=1, noise_gain=1, resolution_mm=1, arrived=n / 100, shear=shear,
    )  # fmt: skip
    return replace(made, **fields)


def ring(capacity, images=()):
    history = History(1e6, FRAME_BYTES * (capacity + 1), RAW, RESTORED)
    for each in images:
        history.keep(each)
    return history


def page(history, kind="raw", seconds=100, before=None, max_frames=1000, max_values=UNLIMITED, since=None):
    return history.page(kind, seconds, before, max_frames, max_values, since)


def numbers(history, **query):
    return page(history, **query).sequence.tolist()


def test_memory_is_bounded_by_time_and_by_bytes():
    assert History(1.0, UNLIMITED, RAW, RESTORED).capacity == MAX_RATE_HZ - 1
    assert ring(20).capacity == 20
    assert History(1e6, FRAME_BYTES * 21 - 1, RAW, RESTORED).capacity == 19
    each = FRAME_BYTES + SHEAR_BYTES
    assert History(1e6, each * 21, RAW, RESTORED, shear=True).capacity == 20
    for empty in (History(0, UNLIMITED, RAW, RESTORED), History(5, FRAME_BYTES, RAW, RESTORED), ring(5)):
        if not empty.capacity:
            empty.keep(image(0))
        for kind, shape in (("raw", RAW), ("restored", RESTORED)):
            assert page(empty, kind).values.shape == (0, *shape)
        assert page(empty).flags.shape == (0, *RAW)


def test_no_image_waits_for_memory():
    images, slots = [image(n) for n in range(10)], 200_000  # of 64 MB, which the system gives in pages
    history = ring(slots)
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    for n in range(slots):
        history.keep(images[n % 10])
    assert resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before < 10


def test_the_last_images_come_in_order_with_all_that_is_known_of_them():
    history = History(1e6, (FRAME_BYTES + SHEAR_BYTES) * 21, RAW, RESTORED, shear=True)
    for n in range(50):
        history.keep(image(n))
    last = np.arange(30, 50)
    raw, restored, shear = (page(history, kind) for kind in ("raw", "restored", "shear"))
    assert raw.sequence.tolist() == last.tolist()
    np.testing.assert_array_equal(raw.time, last / 100)
    np.testing.assert_array_equal(raw.values, np.broadcast_to(last[:, None, None], (20, *RAW)))
    np.testing.assert_array_equal(raw.flags[:, 0, 0], last % 2)
    assert raw.method == ("nnls",) * 20
    assert not raw.older
    np.testing.assert_array_equal(restored.values[:, 7, 7], 10.0 * last)
    assert shear.values.shape == (20, 2, *RAW)
    np.testing.assert_array_equal(shear.values[:, 0, 0, 0], last)
    np.testing.assert_array_equal(shear.values[:, 1, 3, 3], -last)
    assert numbers(history, kind="shear", max_values=3 * 32) == [47, 48, 49]  # of 32 numbers each


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_a_step_of_the_clock_of_the_bus_neither_widens_nor_narrows_a_window(step):
    history = ring(400, (image(n, time=n / 100 + (step if n >= 250 else 0.0)) for n in range(300)))
    window = page(history, seconds=0.995)
    assert window.sequence.tolist() == list(range(200, 300))
    assert window.time[[0, 49, 50, 99]].tolist() == [2.0, 2.49, 2.5 + step, 2.99 + step]
    newest = page(history, seconds=0.995, max_frames=30)
    assert newest.older
    assert numbers(history, seconds=0.0, before=270, since=newest.since) == list(range(200, 270))


def test_a_page_that_is_copied_while_images_are_added_is_never_mixed():
    history, interval = ring(8), sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    with ThreadPoolExecutor(1) as other:
        adding = other.submit(lambda: [history.keep(image(n)) for n in range(5000)])
        while not adding.done():
            copied = page(history, seconds=1e9)
            n = copied.sequence.astype(np.float32)
            assert (copied.values == n[:, None, None]).all()
            np.testing.assert_array_equal(copied.time, copied.sequence / 100)
            assert np.diff(copied.sequence).tolist() == [1] * max(len(n) - 1, 0)
    sys.setswitchinterval(interval)


def test_images_in_another_unit_than_the_newest_are_left_out():
    counts = [image(n, unit="counts") for n in range(3)]
    history = ring(9, counts)
    assert (page(history).unit, page(ring(9)).unit, page(history).cut) == ("counts", None, False)
    history.keep(image(3))  # a calibration was applied
    got = page(history)
    assert (got.sequence.tolist(), got.unit, got.cut, got.older) == ([3], "kPa", True, False)
    assert not page(history, seconds=0.005).cut
