import csv
import importlib.util
import json
from itertools import pairwise

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.cli.app import app
from tactiled.config.example import EXAMPLE, GRASP
from tactiled.errors import ConfigError
from tactiled.study import peers
from tactiled.study.frontier import QUICK, Effort, Mark, Panel, beaten, floor, front, panel, verdict
from tactiled.study.restore import nrmse
from tactiled.study.skin import configured, films, mistaken, rubber

TINY = Effort(covers=(1.0,), noises=(0.02,), size=12, frames=2, rounds=1, peers=1, stops=(3,))


@pytest.fixture(scope="module")
def skin():
    return rubber(1.0, 12)


def test_front_keeps_what_nothing_beats_in_both():
    points = [(3.0, 0.1), (1.0, 0.5), (2.0, 0.5), (2.0, 0.3), (5.0, 0.1), (4.0, 0.05), (2.0, 0.3)]
    assert front(points) == [1, 3, 0, 5]
    assert front([]) == []


def test_front_agrees_with_its_definition():
    points = [tuple(p) for p in np.random.default_rng(3).random((60, 2))]
    beats = [any(q[0] < p[0] and q[1] < p[1] for q in points) for p in points]
    assert sorted(front(points)) == [n for n, beat in enumerate(beats) if not beat]


def test_beaten_names_only_what_is_no_worse_in_either():
    marks = [Mark("auto", True, 0.2, 50, 60), Mark("fast", True, 0.3, 10, 10), Mark("best", True, 0.2, 40, 60)]
    assert [mark.method for mark in beaten(Panel("a", 1.0, 0.01, 0.1, tuple(marks)))] == ["best"]


def test_errors_are_the_same_in_every_run(skin):
    first, second = (panel(skin, 0.02, TINY, 7) for _ in range(2))
    assert {m.method: round(m.nrmse, 6) for m in first.marks} == {
        m.method: round(m.nrmse, 6) for m in second.marks
    }
    assert panel(skin, 0.02, TINY, 8).mark("auto").nrmse != first.mark("auto").nrmse
    assert first.floor == second.floor


def test_restoring_beats_the_raw_image_and_peers_are_there(skin):
    told = panel(skin, 0.02, TINY, 1)
    assert told.mark("nnls").nrmse < 0.9 * told.mark("raw").nrmse
    assert {m.method for m in told.marks if not m.ours} == {
        "skimage wiener 0.1",
        "skimage wiener 0.3",
        "skimage wiener 1",
        "skimage unsupervised",
        "skimage rl 3",
        "opencv wiener 0.3",
        "opencv wiener 1",
        "opencv wiener 3",
        "pyproximal nnls 3",
    }


def test_peers_that_are_not_installed_are_left_out_and_named(skin, monkeypatch):
    there = importlib.util.find_spec
    monkeypatch.setattr(peers, "find_spec", lambda name: None if name in ("cv2", "pyproximal") else there(name))
    assert peers.absent() == ["opencv", "pyproximal"]
    assert {name.split()[0] for name in peers.peers(skin.psf, (12, 12), 0.01)} == {"skimage"}


@pytest.mark.parametrize("name", ["opencv wiener 0.3", "pyproximal nnls 30"])
def test_peers_put_a_press_back_where_it_was(skin, name):
    x = np.zeros((12, 12), np.float32)
    x[3, 7], x[8, 4] = 100, 50
    frame = np.asarray(skin.blur.forward(x))
    image = peers.peers(skin.psf, (12, 12), 0.001, (3, 30))[name](frame)
    assert image.shape == x.shape
    assert nrmse(image, x) < 0.5 * nrmse(frame, x)
    assert image[3, 7] == pytest.approx(100, rel=0.1)
    assert image[8, 4] == pytest.approx(50, rel=0.1)


def test_a_verdict_says_where_auto_is_beaten_and_why():
    def told(*others):
        return Panel("a", 1.0, 0.01, 0.1, (Mark("auto", True, 0.2, 50, 60), *others))

    same, best = Mark("nnls", True, 0.2, 40, 60), Mark("tv", True, 0.1, 40, 60)
    said = list(verdict([told(), told(same), told(same, best)]))
    assert said[0] == "auto is on the Pareto front in 1 of 3 panels."
    assert "nnls, by 0.0 % of the error and 20 % of the time" in said[1]
    assert "the same image" in said[1]
    assert "not the best" in said[2]


def test_no_linear_filter_passes_the_floor_in_the_mean(skin):
    told = panel(skin, 0.02, TINY, 1)
    assert told.floor < told.mark("wiener").nrmse


def test_floor_falls_with_the_noise(skin):
    floors = [[floor(skin, film) for film in films(skin, noise, 1, 1)] for noise in (1e-4, 1e-2, 0.2)]
    assert all(np.less(*pair).all() for pair in pairwise(floors))


def test_a_film_moves_and_its_truth_has_the_taxels_shape(skin):
    film = next(films(skin, 0.01, 3, 1, ("punches",)))
    assert film.frames.shape == film.truths.shape == (3, 12, 12)
    assert not np.array_equal(film.truths[0], film.truths[2])


def test_a_wrong_cover_changes_frames_but_not_the_belief():
    as_is, other = rubber(1.0, 8), mistaken(rubber(1.0, 8), thickness=1.3)
    a, b = (next(films(skin, 1e-6, 1, 1, ("punches",))) for skin in (as_is, other))
    assert np.array_equal(a.truths, b.truths)
    assert not np.allclose(a.frames, b.frames, rtol=1e-3)
    assert np.array_equal(as_is.blur.modes.gain, other.blur.modes.gain)


def test_a_configured_skin_is_measured_grid_or_not(tmp_path):
    for text, shape in ((EXAMPLE.replace("= 32", "= 8"), (8, 8)), (GRASP, (60,))):
        path = tmp_path / "it.toml"
        path.write_text(text)
        film = next(films(configured(path), 0.01, 1, 1, ("blobs",)))
        assert film.frames.shape == film.truths.shape == (1, *shape)
        assert film.truths.max() > 10


def test_an_unknown_sensor_is_named(tmp_path):
    path = tmp_path / "it.toml"
    path.write_text(EXAMPLE)
    with pytest.raises(ConfigError, match=r"no sensor 'foot': choose one of palm"):
        configured(path, "foot")


def test_command_writes_chart_table_and_summary(tmp_path, monkeypatch):
    monkeypatch.setattr("tactiled.study.frontier.QUICK", TINY)
    told = CliRunner().invoke(app, ["bench", "frontier", "--quick", "--out", str(tmp_path / "new")])
    assert told.exit_code == 0, told.output
    assert "Seed 1" in told.output
    rows = list(csv.DictReader((tmp_path / "new/frontier.csv").read_text().splitlines()))
    summary = json.loads((tmp_path / "new/frontier.json").read_text())
    assert [row["method"] for row in rows] == [mark["method"] for mark in summary["panels"][0]["marks"]]
    assert {"seed", "machine", "threads", "panels"} <= set(summary)
    assert (tmp_path / "new/frontier.svg").read_text().startswith("<?xml")


def test_quick_is_smaller():
    assert len(QUICK.covers) < len(Effort().covers)


def test_scenes_that_fall_between_sparse_taxels_are_left_out(tmp_path):
    (tmp_path / "it.toml").write_text(GRASP)
    found = list(films(configured(tmp_path / "it.toml"), 0.01, 2, 1))
    assert 0 < len(found) < 7
    assert all(film.truths.max(axis=1).min() > 1 for film in found)
