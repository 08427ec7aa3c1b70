import numpy as np
import pytest

from tactiled.calibrate.cover.fit import CoverFit
from tests.bench.blind import DRIFT_KPA, KINDS, KPA_PER_COUNT, NOISE_KPA, ROW_NOISE_KPA, line, outcome, recording

FREE = 40  # frames before the first press, and at the end


@pytest.fixture(scope="module")
def pressure():
    """Frames (T, 20, 20) of recordings of each kind, about in kPa."""
    trials = {kind: recording(kind, np.random.default_rng(5)) for kind in KINDS}
    return {
        kind: (each.recorded.series.counts * KPA_PER_COUNT).reshape(-1, 20, 20) for kind, each in trials.items()
    }


def test_every_kind_of_recording_has_its_own_fault_alone(pressure):
    moved = {kind: np.abs(np.mean(each[-FREE:] - each[:FREE])) for kind, each in pressure.items()}
    rows = {kind: each[:FREE].mean(axis=2).std(axis=0).mean() for kind, each in pressure.items()}
    residue = {kind: (each[240:250] - each[:10]).mean(axis=0).max() for kind, each in pressure.items()}
    assert moved.pop("drift") == pytest.approx(DRIFT_KPA, rel=0.2)
    assert rows.pop("row noise") == pytest.approx(ROW_NOISE_KPA, rel=0.2)
    assert residue.pop("creep") > 2 * NOISE_KPA
    assert max(moved["clean"], moved["row noise"], *rows.values()) < NOISE_KPA / 3
    assert all(each.max() < 4096 * KPA_PER_COUNT for each in pressure.values())


def test_a_fit_is_held_against_the_truth_and_a_refusal_is_named():
    trial = recording("clean", np.random.default_rng([1, 2, 0]))

    def fit(factor, reason=""):
        ends = (factor / 1.02, factor * 1.02)
        return lambda *_: CoverFit("blind", factor, ends, 1.0, ends, 12, reason=reason)

    good, bad, none = (
        outcome("clean", [1, 2], each)
        for each in (fit(1.01 * trial.factor), fit(1.1 * trial.factor), fit(1.0, "press more coins"))
    )
    assert (good.holds, bad.holds, none.reason) == (True, False, "press more coins")
    assert bad.error == pytest.approx(0.1)
    row = line("clean", [good, bad, none])
    assert row == ("clean", "1 of 3", "7.1 / 10.0 %", row[3], "1 of 2")
