"""The form of a blur that is soonest: timed once, then remembered."""

from pathlib import Path
from threading import Barrier, Thread

import numpy as np
import pytest

from tactiled.config.autotune import soonest
from tactiled.restore.forms import Forms

SHAPE = (4, 4)


class Timed(Forms):
    """Forms of which one is told to be the fastest, and how often that was asked."""

    told, asked = "separable", 0

    def fastest(self, clock):
        self.asked += 1
        clock()
        return self.told


def forms(told="separable", shape=SHAPE):
    random = np.random.default_rng(0)
    made = Timed([random.random((n, n)) for n in shape[:1]], [random.random((n, n)) for n in shape[1:]])
    made.told = told
    return made


@pytest.mark.parametrize("told", ["separable", "dense"])
def test_it_is_timed_once_and_remembered(tmp_path, told):
    assert soonest(forms(told), tmp_path) == told
    again = forms("dense" if told == "separable" else "separable")
    assert (soonest(again, tmp_path), again.asked) == (told, 0)
    assert [path.suffix for path in tmp_path.iterdir()] == [".form"]


def test_each_size_is_timed_for_itself(tmp_path):
    assert soonest(forms("separable"), tmp_path) == "separable"
    assert soonest(forms("dense", (3, 4)), tmp_path) == "dense"


def test_the_usual_form_where_nothing_can_be_remembered(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    made = forms("separable")
    assert soonest(made, blocked / "folder") == made.usual == "dense"


def test_the_usual_form_where_there_is_no_home(monkeypatch):
    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    made = forms("separable")
    assert soonest(made) == made.usual == "dense"


@pytest.mark.parametrize("damaged", [b"quantum", b"\xff\xfe", b""])
def test_what_names_no_form_is_not_believed_and_timed_again(tmp_path, damaged):
    soonest(forms(), tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(damaged)
    assert soonest(forms("separable"), tmp_path) == "separable"
    assert path.read_text() == "separable"


def test_of_several_at_once_all_take_the_first(tmp_path):
    """Two that time their forms at the same moment, and find otherwise, still blur alike."""
    together, found = Barrier(2), []

    class Late(Timed):
        def fastest(self, clock):
            together.wait(10)
            return super().fastest(clock)

    def go(told):
        made = forms(told)
        made.__class__ = Late
        found.append(soonest(made, tmp_path))

    threads = [Thread(target=go, args=(told,)) for told in ("dense", "separable")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(found)) == 1


def test_a_large_grid_has_one_form_and_is_not_timed(tmp_path):
    made = forms(shape=(40, 40))
    assert (soonest(made, tmp_path), made.asked) == ("separable", 0)
    assert not list(tmp_path.iterdir())
