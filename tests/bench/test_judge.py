import numpy as np
import pytest

from tactiled.bench.peers import skimage_rl
from tactiled.bench.skin import nrmse, rubber
from tactiled.restore.methods import make
from tests.bench import tuned_peers
from tests.bench.judge import Result, own, score, show, summary, verdict
from tests.bench.presses import FAMILIES, presses
from tests.bench.tuned_peers import PEERS, by_matrix, by_modes, peer_errors, tikhonov, total_variation


def a_press(scene="letters", noise=0.05):
    return next(presses(16, (1.0,), (noise,), scenes=(scene,)))


def test_auto_is_nearer_the_truth_than_skimage_that_knows_it():
    methods = {"auto": own("auto"), "same": lambda press: press.frame}
    results = score(presses(16, (1.0,), (0.01,)), methods)
    assert all(each.errors["same"] == each.errors["raw"] for each in results)
    better = np.mean([min(each.errors["W*"], each.errors["RL*"]) for each in results])
    assert verdict(results, "auto").mean < better < verdict(results, "raw").mean
    assert max(verdict(results, "auto").over_raw) < 1.02


def test_tuned_peers_are_better_than_untuned_and_looked_up_when_judged_again(tmp_path, monkeypatch):
    press = a_press()
    errors = peer_errors(press, tmp_path)
    assert set(errors) == set(PEERS)
    for count in (5, 30):
        assert errors["RL*"] <= nrmse(skimage_rl(press.psf, count, press.frame), press.truth)
    assert errors["TV*"] < 1.02 * nrmse(make("tv", press.blur, press.sigma)(press.frame).image, press.truth)
    monkeypatch.delattr(tuned_peers, "tuned")
    assert peer_errors(press, tmp_path) == errors
    with pytest.raises(NameError):
        peer_errors(a_press(noise=0.01), tmp_path)


@pytest.mark.parametrize(("operator", "wrong"), [(by_modes, 0.03), (by_matrix, 1e-6)])
def test_peers_minimise_what_they_claim_to(operator, wrong):
    blur, weights = rubber(1.0, 16).blur, np.array([0.01, 0.1])
    H, random = operator(blur), np.random.default_rng(3)
    x = np.zeros((1, 16, 16), np.float32)
    x[:, 4:12, 4:12] = np.maximum(random.normal(0, 1, (8, 8)), 0)
    assert nrmse(H.synthesise(H.squares * H.analyse(x)), blur.adjoint(blur.forward(x))) < wrong
    y = blur.forward(x[0]) + random.normal(0, 0.05, (16, 16)).astype(np.float32)
    of_data = H.synthesise(H.of_data(y)[None])
    ridge = tikhonov(H, y, weights, 300)[0]
    slope = H.synthesise(H.squares * H.analyse(ridge)) - of_data + weights[:, None, None] * ridge
    assert np.abs(slope[ridge > 0]).max() < 1e-4 < 1e-2 < slope[ridge == 0].max()
    assert slope.min() > -1e-4

    def objective(x):
        right, down = (np.diff(x, axis=axis, append=x.take([-1], axis)) for axis in (2, 1))
        square = x * (H.synthesise(H.squares * H.analyse(x)) / 2 - of_data)
        return (square + weights[:, None, None] * np.hypot(right, down)).sum((1, 2))

    flat, ahead, *_ = total_variation(H, y, weights, 2000)
    assert ahead.min() > -1e-3
    others = [flat + random.normal(0, 0.03, flat.shape) for _ in range(50)]
    for each in (*np.maximum(others, 0).astype(np.float32), ridge, 0.97 * flat, 1.03 * flat):
        assert (objective(flat) < objective(each)).all()


def test_ratios_are_those_of_a_cells_means_and_counted(capsys):
    peers = {"W*": 0.4, "RL*": 0.3, "NNT*": 0.2, "TV*": 0.5}
    cells = [("a", 1.0, 0.01), ("a", 1.0, 0.01), ("b", 2.0, 0.05)]
    own_errors, raws = (0.2, 0.3, 0.42), (0.5, 0.25, 0.42)
    varied = [peers, peers | {"NNT*": 0.6, "RL*": 0.2}, peers | {"RL*": 0.35, "NNT*": 0.3}]
    results = [
        Result(cell, {"raw": raw, "auto": error} | each)
        for cell, raw, error, each in zip(cells, raws, own_errors, varied, strict=True)
    ]
    one = verdict(results, "auto")
    assert one.ratios == pytest.approx({cells[0]: 0.25 / 0.25, cells[2]: 0.42 / 0.3})
    assert one.over_raw == pytest.approx([0.4, 1.2, 1.0])
    assert summary(results, "auto") == (
        "auto", "0.3067", "1.200", "1", "0", "1.40", "b, 2, 5 %", "1, at worst 1.20",
    )  # fmt: skip
    show(results, ["auto"])
    printed = capsys.readouterr().out
    assert "a             1    1   0.375   0.250" in printed
    assert "1.40 !\n" in printed
    assert "every press: 0.2333" in printed


def test_the_second_family_is_blurred_finer_by_two_covers_and_shares_no_kind_with_the_first():
    assert not set(FAMILIES["first"]) & set(FAMILIES["second"])
    rubbery, papery = (
        list(presses(16, (2.0,), (1e-6,), repeat + 1, scenes=FAMILIES["second"]))[repeat :: repeat + 1]
        for repeat in range(2)
    )
    for a, b in zip(rubbery, papery, strict=True):
        assert not np.array_equal(a.truth, b.truth)
        assert a.blur is not b.blur
        for press in (a, b):  # taxels feel hardly anything of what is finer than cells, under this cover
            assert nrmse(press.blur.forward(press.truth), press.frame) < 0.04
            assert nrmse(press.truth, press.frame) > 0.2
