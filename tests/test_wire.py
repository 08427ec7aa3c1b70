from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from tactiled.frames import MISSING, SensorImage
from tactiled.restore.methods import METHODS, OLD_NAMES
from tactiled.wire import HEADER, METHOD_NAMES, pack, unpack


def image(raw, restored):
    flags = np.where(np.isnan(raw), MISSING, 0).astype(np.uint8)
    return SensorImage(
        "palm", 2**40 + 7, 1763712000.125, raw, restored, flags, "nnls", "because", 9, 61.5, 0.25, 1.5, 0.75
    )


@pytest.fixture
def grid():
    raw = np.arange(6, dtype=np.float32).reshape(2, 3)
    raw[1, 2] = np.nan
    return image(raw, np.arange(24, dtype=np.float32).reshape(4, 6))


def test_the_bytes_are_as_documented(grid):
    data = pack(grid, "raw", 1763712000.5)
    assert HEADER.size == 64
    assert data[:6] == b"TCTL\x01\x00"
    assert data[6:12] == bytes((2, 0, 3, 0, 6, 0))
    assert int.from_bytes(data[16:24], "little") == 2**40 + 7
    assert np.frombuffer(data, "<f8", 2, 24).tolist() == [1763712000.125, 1763712000.5]
    assert np.frombuffer(data, "<f4", 4, 40).tolist() == [0.25, 1.5, 0.75, 61.5]
    assert int.from_bytes(data[56:60], "little") == 9
    assert int.from_bytes(data[60:64], "little") == 6
    assert np.frombuffer(data, "<f4", 3, 64).tolist() == [0, 1, 2]
    assert data[64 + 24 :] == bytes((0, 0, 0, 0, 0, MISSING))


def test_unpack_inverts_pack(grid):
    raw, restored = (unpack(pack(grid, kind, 2.0)) for kind in ("raw", "restored"))
    np.testing.assert_array_equal(raw.values, grid.raw)
    np.testing.assert_array_equal(raw.flags, grid.flags.ravel())
    np.testing.assert_array_equal(restored.values, grid.restored)
    assert (raw.kind, restored.kind, restored.flags.size) == ("raw", "restored", 0)
    assert (raw.timestamp, raw.made_at) == (grid.time, 2.0)
    for name in (
        "sequence",
        "method",
        "noise",
        "unit",
        "noise_gain",
        "resolution_mm",
        "microseconds",
        "iterations",
    ):
        assert getattr(raw, name) == getattr(grid, name), name
    counted = pack(replace(grid, unit="counts"), "raw", 2.0)
    assert (unpack(counted).unit, counted[:14], counted[14:16]) == ("counts", pack(grid, "raw", 2.0)[:14], b"\1\0")
    with pytest.raises(ValueError, match="unit 2"):
        unpack(counted[:14] + b"\2" + counted[15:])


def test_every_method_has_a_number_and_an_unknown_one_has_no_name(grid):
    assert {*METHOD_NAMES} == {*METHODS, *OLD_NAMES} - {"auto"} | {"", "idle"}
    for method in METHOD_NAMES[1:]:
        assert unpack(pack(replace(grid, method=method), "raw", 2.0)).method == method
    assert unpack(pack(replace(grid, method="another"), "raw", 2.0)).method == ""
    data = bytearray(pack(grid, "raw", 2.0))
    data[60:64] = len(METHOD_NAMES).to_bytes(4, "little")  # of a later version
    assert unpack(bytes(data)).method == ""


def test_shear_has_the_same_header_and_then_x_and_y(grid):
    shear = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    data, raw = (pack(replace(grid, shear=shear), kind, 3.0) for kind in ("shear", "raw"))
    assert data[:12] == b"TCTL\x01\x02" + bytes((2, 0, 3, 0, 0, 0))
    assert data[12:64] == raw[12:64]
    assert raw == pack(grid, "raw", 3.0)
    assert np.frombuffer(data, "<f4", 12, 64).tolist() == list(range(12))
    assert len(data) == 64 + 4 * 12
    got = unpack(data)
    assert (got.kind, got.flags.size) == ("shear", 0)
    np.testing.assert_array_equal(got.values, shear)
    for at, fault in ((4, "of version 1"), (5, "of kind 4")):  # as a later version may send
        with pytest.raises(ValueError, match=fault):
            unpack(data[:at] + b"\4" + data[at + 1 :])
    with pytest.raises(ValueError, match="of palm: no shear"):
        pack(grid, "shear", 3.0)
    restored = unpack(pack(replace(grid, traction=shear + 1), "traction", 3.0))
    assert restored.kind == "traction"
    np.testing.assert_array_equal(restored.values, shear + 1)
    assert np.isnan(unpack(pack(grid, "traction", 3.0)).values).all()  # not tared yet


def test_a_layout_without_a_grid_is_one_row():
    values = np.arange(5, dtype=np.float32)
    assert unpack(pack(image(values, values), "restored", 0.0)).values.shape == (1, 5)
    sheared = replace(image(values, values), shear=np.stack([values, -values]))
    got = unpack(pack(sheared, "shear", 0.0)).values
    assert got.shape == (2, 1, 5)
    np.testing.assert_array_equal(got[:, 0], sheared.shear)


@given(st.binary(max_size=200))
def test_other_bytes_are_refused(data):
    with pytest.raises(ValueError, match="bytes"):
        unpack(data)


@given(st.integers(-111, -1), st.binary(max_size=4))
@example(-1, b"\0\0")  # longer, and so short that `given` seldom makes it
def test_a_message_of_another_length_is_refused(end, more):
    assume(len(more) != -end)
    data = pack(image(np.zeros((2, 3), np.float32), np.zeros((4, 3), np.float32)), "restored", 0.0)
    with pytest.raises(ValueError, match="bytes"):
        unpack(data[:end] + more)
