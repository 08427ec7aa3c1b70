"""Solved covers on the disk: whatever became of a file, the cover is right, and a line says what was wrong."""

import random
from pathlib import Path

import numpy as np
import pytest

from tactiled.cover import kernel
from tactiled.cover.kernel import Kernel, cached
from tactiled.cover.stack import Layer, Stack

STACK = Stack((Layer(1.0, 1.0, 0.3),))
NUMBERS = "q", "gain", "r", "g", "error_estimate", "mesh", "unknowns"
FLIPS = 4000


def tiny(stack, model, accuracy=1e-3, profile=None):
    """A kernel of few numbers, so that its file is small."""
    q, r = np.array([0.0, 0.5, 1.0]), np.array([0.0, 2.0])
    return Kernel(stack, model, q, q[::-1] - 0.125, r, r + accuracy, 3e-4, (7, 5), 350, profile)


class Cache:
    """A folder with one cover in it, and what was told and solved since."""

    def __init__(self, folder):
        self.folder, self.told, self.solved = folder, [], 0

    def solve(self, *settings):
        self.solved += 1
        return tiny(*settings)

    def ask(self, accuracy=1e-3):
        self.told, self.solved = [], 0
        return cached(STACK, "layered", accuracy, folder=self.folder, report=self.told.append)

    @property
    def path(self):
        (path,) = self.folder.iterdir()
        return path

    def damaged(self, content):
        """Ask for the cover when its file holds `content`."""
        self.path.write_bytes(content)
        right(self.ask())
        return self.solved, len(self.told)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    made = Cache(tmp_path / "cache")
    monkeypatch.setattr(kernel, "solve", made.solve)
    right(made.ask())
    assert (made.solved, made.told) == (1, [])
    return made


def right(found, accuracy=1e-3):
    expected = tiny(STACK, "layered", accuracy)
    assert all(np.array_equal(getattr(found, name), getattr(expected, name)) for name in NUMBERS)


def test_a_cover_is_solved_once_and_the_same_bits_come_back(cache):
    right(cache.ask())
    assert (cache.solved, cache.told) == (0, [])


def test_a_flipped_bit_is_seen_wherever_it_is(cache):
    content, chance = cache.path.read_bytes(), random.Random(0)
    for _ in range(FLIPS):
        flipped = bytearray(content)
        at = chance.randrange(8 * len(content))
        flipped[at // 8] ^= 1 << at % 8
        assert cache.damaged(flipped) == (1, 1)
        assert cache.path.read_bytes() == content


def test_a_file_that_is_cut_is_seen_wherever_it_is_cut(cache):
    content = cache.path.read_bytes()
    for length in range(len(content)):
        assert cache.damaged(content[:length]) == (1, 1)
    assert cache.damaged(content + b"\0") == (1, 1)
    assert "the checksum is wrong: it is computed again" in cache.told[0]


def test_numbers_of_another_kind_and_pickles_are_not_read(cache, tmp_path):
    for name, numbers in (("f4", np.ones(9, np.float32)), ("pickled", np.array([{}, print], object))):
        np.savez(tmp_path / name, q=numbers, gain=numbers, r=numbers, g=numbers, error_estimate=0.0, mesh=numbers)
        assert cache.damaged((tmp_path / f"{name}.npz").read_bytes()) == (1, 1)


def test_the_file_of_another_cover_under_this_ones_name_is_not_believed(cache):
    mine = cache.path
    right(cache.ask(accuracy=1e-2), 1e-2)
    (other,) = set(cache.folder.iterdir()) - {mine}
    other.replace(mine)
    right(cache.ask())
    assert (cache.solved, len(cache.told)) == (1, 1)


def test_the_file_of_another_release_is_left_alone(cache, monkeypatch):
    before = cache.path
    monkeypatch.setattr(kernel, "version", lambda _: "0.0.0")
    right(cache.ask())
    assert (cache.solved, cache.told) == (1, [])
    assert before in cache.folder.iterdir()
    assert len(list(cache.folder.iterdir())) == 2


def test_a_folder_in_the_files_place(cache):
    path = cache.path
    path.unlink()
    path.mkdir()
    right(cache.ask())
    assert cache.solved == 1
    assert [str(path) in line for line in cache.told] == [True, True]  # neither read nor written
    assert "Is a directory: it is computed again" in cache.told[0]
    assert list(cache.folder.iterdir()) == [path]


def test_a_file_that_may_not_be_read(cache, monkeypatch):
    monkeypatch.setattr(Path, "read_bytes", denied)
    right(cache.ask())
    assert cache.solved == 1
    assert [line.partition(f"{cache.path}: ")[2] for line in cache.told] == [
        "Permission denied: it is computed again"
    ]


def denied(*_):
    raise PermissionError(13, "Permission denied")


def test_a_full_disk_leaves_no_part_of_a_file(cache, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    cache.path.unlink()
    monkeypatch.setattr(Path, "replace", full)
    right(cache.ask())
    assert [line.partition(".kernel: ")[2] for line in cache.told] == ["No space left on device: it is not kept"]
    assert not list(cache.folder.iterdir())


def test_a_user_without_a_home(cache, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    cache.folder = None
    right(cache.ask())
    assert cache.solved == 1
    assert cache.told == ["no kernel is kept: there is no home directory: set HOME or XDG_CACHE_HOME"]


def homeless():
    raise RuntimeError("Could not determine home directory.")
