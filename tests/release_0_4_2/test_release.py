"""Configuration, recording and client script of release 0.4.2 still work."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import BUSY_S

KIT = Path(__file__).parent
CONFIG, RECORDING = KIT / "hand.toml", KIT / "hand.log"
TACTILED = (sys.executable, "-m", "tactiled")
CLIENT_PYTHON = os.environ.get("CLIENT_PYTHON", sys.executable)  # of an environment without the service


@pytest.mark.parametrize("sensor", ["palm", "skin"])
def test_recording_has_the_same_raw_images_and_the_same_force_when_restored(sensor, tmp_path):
    out = tmp_path / "images.npz"
    export = (*TACTILED, "export", RECORDING, "--config", CONFIG, "--sensor", sensor, "--out", out)
    subprocess.run(export, check=True, timeout=BUSY_S, capture_output=True)
    with np.load(KIT / "images.npz") as old, np.load(out) as new:
        kinds = [name.removeprefix(f"{sensor}_") for name in old.files if name.startswith(sensor)]
        assert "restored" in kinds
        for kind in kinds:
            expected = old[f"{sensor}_{kind}"]
            assert new[kind].dtype == expected.dtype
            if kind == "restored":  # by other methods since: docs/decisions.md
                assert new[kind].shape == expected.shape
                known = np.isnan(old[f"{sensor}_raw"]).sum(axis=(1, 2)) < 2  # what is missing is inferred
                force, before = (each[known].sum(axis=(1, 2)) for each in (new[kind], expected))
                assert known.sum() > 0.9 * len(known)
                np.testing.assert_allclose(force, before, rtol=0.05)
                continue
            # Other processors sum in another order: single precision of the largest value.
            np.testing.assert_allclose(
                new[kind], expected, rtol=0, atol=2e-6 * np.nanmax(np.abs(expected)), err_msg=kind
            )


def lacks(new, old, path=""):
    """Where an answer does not hold what 0.4.2's did; lists of names may have grown."""
    if isinstance(old, dict):
        return [each for key in old for each in lacks(new.get(key), old[key], f"{path}/{key}")]
    if isinstance(old, list) and all(isinstance(each, str) for each in old):
        return [f"{path}: no {name}" for name in old if name not in (new or ())]
    return [] if new == old else [f"{path}: {new}, was {old}"]


def test_client_gets_the_same_answers():
    replay = (*TACTILED, "replay", RECORDING, "--config", CONFIG, "--port", "0", "--speed", "0.02")
    with subprocess.Popen(replay, stdout=subprocess.PIPE, text=True) as service:
        try:
            address = next(word for line in service.stdout for word in line.split() if word.startswith("http://"))
            client = [CLIENT_PYTHON, KIT / "client.py", address.rstrip("/")]
            answers = subprocess.run(
                client, check=True, timeout=2 * BUSY_S, stdout=subprocess.PIPE, text=True
            ).stdout
        finally:
            service.terminate()
    assert not lacks(json.loads(answers), json.loads((KIT / "answers.json").read_text()))
