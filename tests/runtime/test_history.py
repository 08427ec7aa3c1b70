import sys
import threading
from dataclasses import replace

import numpy as np
import pytest

from tactiled.frames import Image
from tactiled.runtime.history import RATE_HZ, History

RAW, RESTORED = (4, 4), (8, 8)
EACH = 5 * 16 + 4 * 64 + 32  # bytes
ALL = 10**9


def image(n, sequence=None):
    return Image(
        sensor="palm", sequence=n if sequence is None else sequence, time=n / 100,
        raw=np.full(RAW, n, np.float32), restored=np.full(RESTORED, 10 * n, np.float32),
        flags=np.full(RAW, n % 2, np.uint8), method="nnls", why="", iterations=0, microseconds=0, noise_kpa=1,
        noise_gain=1, resolution_mm=1, arrived=n / 100,
    )  # fmt: skip


def ring(frames):
    return History(1e6, EACH * (frames + 1), RAW, RESTORED)


def sheared(n):
    return replace(image(n), shear=np.stack([np.full(RAW, n, np.float32), np.full(RAW, -n, np.float32)]))


def bytes_of(kept):
    held = (*kept._images.values(), kept._flags, kept._sequence, kept._time, kept._arrived)
    return sum(each.nbytes for each in held) + 8 * len(kept._method)


def test_memory_is_bounded_by_time_and_by_bytes():
    assert History(1.0, ALL, RAW, RESTORED).capacity == RATE_HZ - 1
    small = ring(20)
    assert bytes_of(small) == EACH * 21
    for nothing in (History(0, ALL, RAW, RESTORED), History(5, EACH, RAW, RESTORED)):
        nothing.add(image(0))
        assert len(nothing("raw", 10, None, 10, ALL).values) == 0


def test_shear_counts_towards_the_bound_and_is_kept_beside_the_images():
    each = EACH + 8 * 16
    kept = History(1e6, each * 21, RAW, RESTORED, shear=True)
    assert bytes_of(kept) == each * 21
    for n in range(50):
        kept.add(sheared(n))
    assert bytes_of(kept) == each * 21
    found = kept("shear", 100, None, 100, ALL)
    assert found.values.shape == (20, 2, 4, 4)
    np.testing.assert_array_equal(found.values[:, 0, 0, 0], np.arange(30, 50))
    np.testing.assert_array_equal(found.values[:, 1, 3, 3], -np.arange(30, 50))
    np.testing.assert_array_equal(kept("raw", 100, None, 100, ALL).values[:, 0, 0], np.arange(30, 50))
    assert kept("shear", 100, None, 100, 3 * 32).sequence.tolist() == [47, 48, 49]  # of 32 numbers each


def test_the_last_images_come_in_order_with_all_that_is_known_of_them():
    kept = ring(20)
    for n in range(50):
        kept.add(image(n))
    found = kept("raw", 100, None, 100, ALL)
    assert found.sequence.tolist() == list(range(30, 50))
    np.testing.assert_array_equal(found.time, np.arange(30, 50) / 100)
    assert found.values.shape == (20, 4, 4)
    np.testing.assert_array_equal(found.values[:, 0, 0], np.arange(30, 50))
    np.testing.assert_array_equal(found.flags[:, 0, 0], np.arange(30, 50) % 2)
    assert found.method == ("nnls",) * 20
    assert not found.older
    np.testing.assert_array_equal(kept("restored", 100, None, 100, ALL).values[:, 7, 7], 10.0 * np.arange(30, 50))


def test_pages_lead_back_through_a_window():
    kept = ring(40)
    for n in range(100):
        kept.add(image(n, 2 * n))
    pages, before = [], None
    while True:
        page = kept("raw", 0.245, before, 10, ALL)
        pages.append(page.sequence.tolist())
        if not page.older:
            break
        before = int(page.sequence[0])
    assert [len(page) for page in pages] == [10, 10, 5]
    assert [n for page in reversed(pages) for n in page] == list(range(150, 200, 2))
    assert kept("raw", 10, 5, 10, ALL).sequence.tolist() == []
    assert kept("raw", 10, None, 10, 16 * 3).sequence.tolist() == [194, 196, 198]  # three images of 16 numbers
    assert kept("raw", 10, None, 10, 1).sequence.tolist() == [198]


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_a_step_of_the_buss_clock_neither_widens_nor_narrows_a_window(step):
    kept = ring(400)
    for n in range(300):
        kept.add(replace(image(n), time=n / 100 + (step if n >= 250 else 0.0)))
    found = kept("raw", 0.995, None, 1000, ALL)
    assert found.sequence.tolist() == list(range(200, 300))
    assert found.time[[0, 49, 50, 99]].tolist() == [2.0, 2.49, 2.5 + step, 2.99 + step]
    page = kept("raw", 0.995, None, 30, ALL)
    assert page.older
    assert kept("raw", 0.0, int(page.sequence[0]), 1000, ALL, page.since).sequence.tolist() == list(
        range(200, 270)
    )


def test_what_a_copy_gives_while_images_are_added_is_never_mixed():
    kept, stop = ring(8), threading.Event()

    def add():
        n = 0
        while not stop.is_set():
            kept.add(image(n))
            n += 1

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    thread = threading.Thread(target=add)
    thread.start()
    seen = 0
    try:
        while seen < 2000:
            found = kept("raw", 1e9, None, 100, ALL)
            seen += len(found.sequence)
            n = found.sequence.astype(np.float32)
            assert (found.values == n[:, None, None]).all()
            np.testing.assert_array_equal(found.time, found.sequence / 100)
            assert np.diff(found.sequence).tolist() == [1] * max(len(n) - 1, 0)
    finally:
        stop.set()
        thread.join()
        sys.setswitchinterval(interval)


@pytest.mark.parametrize("kind", ["raw", "restored"])
def test_an_empty_history_has_no_images_of_the_right_shape(kind):
    found = ring(5)(kind, 1.0, None, 10, ALL)
    assert found.values.shape == (0, *(RAW if kind == "raw" else RESTORED))
    assert found.flags.shape == (0, *RAW)
