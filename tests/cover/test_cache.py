"""Solved covers and operators on the disk: whatever became of a file, they are right, and a line says why."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from tactiled import surface
from tactiled.build import make_array
from tactiled.config import parse
from tactiled.config.example import EXAMPLE, GRASP
from tactiled.cover import kernel as kernels
from tactiled.cover import operator
from tactiled.cover.cache import cached_table
from tactiled.cover.kernel import solve
from tactiled.cover.operator import cached, stencil, surface_matrix
from tactiled.cover.stack import Layer, Profile, Stack
from tactiled.geometry import grid, layout, raster

TABLE = np.arange(6.0).reshape(2, 3) / 7


class Cache:
    """A folder with one table in it, and what was computed and reported since."""

    def __init__(self, folder):
        self.folder, self.computed, self.lines = folder, 0, []

    def make(self):
        self.computed += 1
        return TABLE.copy()

    def ask(self, *inputs):
        self.computed, self.lines = 0, []
        table = cached_table(self.folder, inputs or ("a", TABLE), self.make, self.lines.append)
        np.testing.assert_array_equal(table, TABLE)
        return table

    @property
    def path(self):
        (path,) = self.folder.iterdir()
        return path


@pytest.fixture
def cache(tmp_path):
    cache = Cache(tmp_path / "cache")
    cache.ask()
    assert (cache.computed, cache.lines) == (1, [])
    return cache


def test_a_table_is_computed_once_and_read_to_the_bit(cache):
    table = cache.ask("a", TABLE.copy())
    assert (cache.computed, cache.lines) == (0, [])
    assert (table.dtype, table.shape, table.flags.writeable) == (TABLE.dtype, TABLE.shape, True)


def flip(at, content):
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:0],
        lambda content: content[:31],
        lambda content: content[:-8],
        lambda content: content + bytes(24),
        *(partial(flip, at) for at in (0, 33, 87)),
        lambda content: content[:32] + (2).to_bytes(8, "little") + content[40:],
    ],
    ids=["empty", "within the checksum", "cut off", "too long", "checksum", "columns", "numbers", "another shape"],
)
def test_a_damaged_file_is_computed_again(cache, damage):
    content = cache.path.read_bytes()
    cache.path.write_bytes(damage(content))
    cache.ask()
    assert (cache.computed, cache.lines) == (1, [f"{cache.path}: the checksum is wrong: it is computed again"])
    assert cache.path.read_bytes() == content


def test_another_tables_file_is_no_answer(cache, tmp_path):
    other = Cache(tmp_path / "other")
    other.ask("b")
    cache.path.write_bytes(other.path.read_bytes())
    cache.ask()
    assert (cache.computed, len(cache.lines)) == (1, 1)


def test_a_folder_in_the_files_place(cache):
    path = cache.path
    path.unlink()
    path.mkdir()
    cache.ask()
    assert cache.lines[0] == f"{path}: Is a directory: it is computed again"
    assert cache.lines[1].endswith("it is not kept")
    assert list(cache.folder.iterdir()) == [path]


def test_a_file_that_may_not_be_read(cache, monkeypatch):
    monkeypatch.setattr(Path, "read_bytes", Mock(side_effect=PermissionError(13, "Permission denied")))
    cache.ask()
    assert cache.lines == [f"{cache.path}: Permission denied: it is computed again"]


def test_a_full_disk_leaves_no_part_of_a_file(cache, monkeypatch):
    cache.path.unlink()
    monkeypatch.setattr(Path, "replace", Mock(side_effect=OSError(28, "No space left on device")))
    cache.ask()
    assert [line.partition(".table: ")[2] for line in cache.lines] == ["No space left on device: it is not kept"]
    assert not list(cache.folder.iterdir())


def test_a_user_without_a_home(cache, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", Mock(side_effect=RuntimeError("Could not determine home directory.")))
    cache.folder = None
    cache.ask()
    assert cache.lines == ["no table is kept: there is no home directory: set HOME or XDG_CACHE_HOME"]


def test_every_cover_is_solved_once(tmp_path, monkeypatch):
    stack, profile = Stack((Layer(1.0, 1.0, 0.3),)), Profile((0.0, 0.5), (0.1, 0.0))
    settings = [(stack,), (stack, "layered"), (stack, "fem", 1e-2), (stack, "fem", 1e-3, profile)]
    solved = []

    def tiny(stack, model, accuracy, profile):
        solved.append(stack)
        q, r = np.array([0.0, 0.5, 1.0]), np.array([0.0, 2.0])
        return kernels.Kernel(stack, model, q, q[::-1] - 0.125, r, r + accuracy, 3e-4, (7, 5), 350, profile)

    monkeypatch.setattr(kernels, "solve", tiny)
    first, again = ([kernels.cached(*each, folder=tmp_path) for each in settings] for _ in range(2))
    assert len(solved) == len(list(tmp_path.iterdir())) == len(settings)
    for made, read in zip(first, again, strict=True):
        for name in ("q", "gain", "r", "g", "error_estimate", "mesh", "unknowns", "stack", "model", "profile"):
            assert np.array_equal(getattr(made, name), getattr(read, name)), name
        assert made is read  # one for all arrays under this cover
    monkeypatch.setattr(kernels, "version", lambda _: "0.0.0")
    kernels.cached(stack, folder=tmp_path)
    assert len(list(tmp_path.iterdir())) == len(settings) + 1  # another release has files of its own


def test_every_operator_has_a_table_of_its_own(paper, tmp_path):
    kernel, array = solve(paper(), "layered"), grid(3, 4, 0.3, 0.2)
    sizes = [(3, 5, 0.3, 0.2), (3, 4, 0.31, 0.2), (3, 4, 0.3, 0.21), (3, 4, 0.3, 0.2, "round")]
    loose = layout(array.positions, 0.2)
    inputs = [
        *((stencil, kernel, each, 2) for each in (array, *(grid(*size) for size in sizes))),
        (stencil, kernel, array, 1),
        (stencil, solve(paper(0.3), "layered"), array, 2),
        (stencil, replace(kernel, gain=kernel.gain * 0.99), array, 2),
        (surface_matrix, kernel, loose, raster(loose, 2)),
        (surface_matrix, kernel, loose, replace(raster(loose, 2), side=0.02)),
    ]
    for _ in range(2):
        for make, *each in inputs:
            np.testing.assert_array_equal(cached(make, *each, folder=tmp_path), make(*each))
    assert len(list(tmp_path.iterdir())) == len(inputs)


@pytest.mark.parametrize("text", [EXAMPLE, GRASP], ids=["grid", "layout"])
def test_an_operator_is_built_once_on_a_machine(text, paper, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (sensor,) = parse(text, "example").sensor.values()
    array = make_array(sensor)
    refine = surface.cells_a_pitch(array, None)
    built = partial(surface.make, solve(paper(1.0, 0.6, 0.48), "layered"), array, refine)
    pressure = np.random.default_rng(1).random(raster(array, refine).shape)
    first = built().forward(pressure)
    monkeypatch.setattr(operator, "_response", Mock(side_effect=AssertionError("computed again")))
    np.testing.assert_array_equal(built().forward(pressure), first)
