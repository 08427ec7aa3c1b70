from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tactiled.build import make_array, make_blur
from tactiled.config import parse
from tactiled.config.example import EXAMPLE, GRASP
from tactiled.cover import operator
from tactiled.cover.cache import kept
from tactiled.cover.kernel import solve
from tactiled.cover.operator import cached, stencil, tiled
from tactiled.geometry import grid, layout, tiling

TABLE = np.arange(6.0).reshape(2, 3) / 7


def never():
    raise AssertionError("computed again")


def test_a_table_is_computed_once_and_read_to_the_bit(tmp_path):
    first = kept(tmp_path, ("a", TABLE, 1.5), TABLE.copy)
    again = kept(tmp_path, ("a", TABLE.copy(), 1.5), never)
    np.testing.assert_array_equal(again, first)
    assert (again.dtype, again.shape, again.flags.writeable) == (TABLE.dtype, TABLE.shape, True)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:0],
        lambda content: content[:-8],
        lambda content: content + bytes(24),
        lambda content: content[:-1] + bytes([content[-1] ^ 1]),
        lambda content: content[:32] + (2).to_bytes(8, "little") + content[40:],
    ],
    ids=["empty", "cut off", "too long", "a wrong bit", "another shape"],
)
def test_a_damaged_table_is_computed_again(tmp_path, damage):
    kept(tmp_path, ("a",), TABLE.copy)
    (path,) = tmp_path.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    np.testing.assert_array_equal(kept(tmp_path, ("a",), TABLE.copy), TABLE)
    np.testing.assert_array_equal(kept(tmp_path, ("a",), never), TABLE)
    assert list(tmp_path.iterdir()) == [path]


def test_another_tables_file_is_no_answer(tmp_path):
    kept(tmp_path / "a", ("a",), TABLE.copy)
    kept(tmp_path / "b", ("b",), lambda: 2 * TABLE)
    (one,), (other,) = ((tmp_path / name).iterdir() for name in "ab")
    one.write_bytes(other.read_bytes())
    np.testing.assert_array_equal(kept(tmp_path / "a", ("a",), TABLE.copy), TABLE)


def test_a_folder_that_cannot_be_written_is_no_reason_to_stop(tmp_path):
    (tmp_path / "file").touch()
    np.testing.assert_array_equal(kept(tmp_path / "file", ("a",), TABLE.copy), TABLE)


def test_every_input_has_a_table_of_its_own(paper, tmp_path):
    kernel, array = solve(paper(), "layered"), grid(3, 4, 0.3, 0.2)
    arrays = [
        array,
        grid(3, 5, 0.3, 0.2),
        grid(3, 4, 0.31, 0.2),
        grid(3, 4, 0.3, 0.21),
        grid(3, 4, 0.3, 0.2, "round"),
    ]
    asked = [(stencil, kernel, each, 2) for each in arrays]
    asked += [(stencil, kernel, array, 1), (stencil, solve(paper(0.3), "layered"), array, 2)]
    asked.append((stencil, replace(kernel, gain=kernel.gain * 0.99), array, 2))
    loose = layout(array.positions, 0.2)
    asked += [(tiled, kernel, loose, tiling(loose)), (tiled, kernel, loose, replace(tiling(loose), side=0.02))]
    for _ in range(2):
        for make, *inputs in asked:
            np.testing.assert_array_equal(cached(make, *inputs, folder=tmp_path), make(*inputs))
    assert len(list(tmp_path.iterdir())) == len(asked)


@pytest.mark.parametrize("text", [EXAMPLE, GRASP], ids=["grid", "layout"])
def test_an_operator_is_built_once_on_a_machine(text, paper, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (sensor,) = parse(text, "example").sensor.values()
    array = make_array(sensor)
    built = partial(make_blur, solve(paper(1.0, 0.6, 0.48), "layered"), array, sensor.refine)
    pressure = np.random.default_rng(1).random(array.frame_shape)
    first = built().forward(pressure)
    monkeypatch.setattr(operator, "_response", lambda *_: never())
    np.testing.assert_array_equal(built().forward(pressure), first)
