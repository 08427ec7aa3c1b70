import csv
import importlib.util
import json
from itertools import pairwise

import numpy as np
import pytest

from tactiled.bench import peers
from tactiled.bench.frontier import Effort, Mark, Panel, floor, lines, panel, verdict
from tactiled.bench.skin import clips, nrmse, rubber
from tests.cli.commands import succeed

TINY = Effort(covers=(1.0,), noises=(0.02,), size=12, frames=2, rounds=1, peer_rounds=1, stops=(3,))


@pytest.fixture(scope="module")
def skin():
    return rubber(1.0, 12)


def marks(*others):
    rivals = [Mark(name, True, 0.3, 60, 60) for name in ("raw", "wiener", "rl")]
    return Panel("a", 1.0, 0.01, 0.1, (Mark("auto", True, 0.2, 50, 60), *rivals, *others))


def test_the_table_the_front_and_the_verdict_show_where_auto_is_beaten():
    same, best, cheap = (
        Mark("nnls", True, 0.2, 40, 60),
        Mark("tv", True, 0.1, 40, 60),
        Mark("points", True, 0.3, 10, 10),
    )
    panels = [marks(cheap), marks(same), marks(same, best)]
    assert next(verdict(panels)) == "auto is on the Pareto front in 1 of 3 panels."
    assert [line[-1] for line in lines(panels)] == ["nothing", "nnls", "nnls, tv"]
    assert [[mark.method for mark in each.front] for each in panels] == [["points", "auto"], ["nnls"], ["tv"]]


def test_a_panel_has_every_method_and_the_same_errors_in_every_run(skin):
    first, second = (panel(skin, 0.02, TINY, 7) for _ in range(2))
    errors = [{mark.method: round(mark.nrmse, 6) for mark in each.marks} for each in (first, second)]
    assert errors[0] == errors[1]
    assert first.floor == second.floor < first.mark("wiener").nrmse
    assert panel(skin, 0.02, TINY, 8).mark("auto").nrmse != first.mark("auto").nrmse
    assert first.mark("nnls").nrmse < 0.9 * first.mark("raw").nrmse
    assert {mark.method for mark in first.marks if not mark.ours} == {
        *(f"skimage wiener {k}" for k in ("0.1", "0.3", "1")),
        *(f"opencv wiener {k}" for k in ("0.3", "1", "3")),
        "skimage unsupervised",
        "skimage rl 3",
        "pyproximal nnls 3",
    }


def test_libraries_that_are_not_installed_are_named(skin, monkeypatch):
    find_spec = importlib.util.find_spec
    missing = ("cv2", "pyproximal")
    monkeypatch.setattr(peers, "find_spec", lambda name: None if name in missing else find_spec(name))
    assert peers.absent() == ["opencv", "pyproximal"]
    assert {name.split()[0] for name in peers.peers(skin.psf, (12, 12), 0.01)} == {"skimage"}
    assert list(verdict([marks()]))[-1].endswith("opencv, pyproximal.")


@pytest.mark.parametrize("name", ["opencv wiener 0.3", "pyproximal nnls 30"])
def test_peers_restore_a_press_where_it_was(skin, name):
    x = np.zeros((12, 12), np.float32)
    x[3, 7], x[8, 4] = 100, 50
    frame = np.asarray(skin.blur.forward(x))
    image = peers.peers(skin.psf, (12, 12), 0.001, (3, 30))[name](frame)
    assert image.shape == x.shape
    assert nrmse(image, x) < 0.5 * nrmse(frame, x)
    assert (image[3, 7], image[8, 4]) == pytest.approx((100, 50), rel=0.1)


def test_the_bound_of_linear_filters_falls_with_the_noise(skin):
    floors = [[floor(skin, clip) for clip in clips(skin, noise, 1, 1)] for noise in (1e-4, 1e-2, 0.2)]
    assert all(np.less(*pair).all() for pair in pairwise(floors))


def test_command_writes_chart_table_and_summary(tmp_path, monkeypatch):
    monkeypatch.setattr("tactiled.bench.frontier.REDUCED", TINY)
    assert "Seed 1" in succeed("bench", "frontier", "--quick", "--out", tmp_path / "new")
    rows = list(csv.DictReader((tmp_path / "new/frontier.csv").read_text().splitlines()))
    summary = json.loads((tmp_path / "new/frontier.json").read_text())
    assert [row["method"] for row in rows] == [mark["method"] for mark in summary["panels"][0]["marks"]]
    assert {"seed", "machine", "threads", "panels"} <= set(summary)
    assert (tmp_path / "new/frontier.svg").read_text().startswith("<?xml")
