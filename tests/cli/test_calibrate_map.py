"""`tactiled calibrate map` on recordings of a finger that rolls over 12 x 12 taxels."""

import numpy as np

from tests.cli.commands import refusal, run
from tests.cli.recordings import write
from tests.cli.test_calibrate_cover import ARRAY, CODEC, config  # noqa: F401  # a fixture


def recording(path, order, part=1.0, rest=100, lost=None):
    """A roll to the right over `part` of the rows; place n of the array sends as order[n].

    `rest` are counts without a load; `lost` is a segment that never comes.
    """
    random = np.random.default_rng(3)
    x, y = ARRAY.positions.T
    centres = [(at, line) for line in np.arange(0, 12 * part, 2) for at in np.arange(0, 12, 0.5)]
    pressure = np.array([80 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 6) for a, b in centres])
    counts = np.zeros(pressure.shape, np.uint16)
    noisy = pressure + random.normal(0, 0.5, pressure.shape)
    counts[:, order] = np.clip(np.round(noisy / 0.05 + rest), 0, CODEC.full_scale)
    frames = [CODEC.encode(frame, n, 0.02 * n) for n, frame in enumerate(counts)]
    return write(path, (each for frame in frames for at, each in enumerate(frame) if at != lost))


def test_a_swap_is_named_and_a_right_map_is_not(config, tmp_path):  # noqa: F811
    order = np.arange(144)
    right = run("calibrate", "map", recording(tmp_path / "right.log", order), "--config", config)
    assert right.exit_code == 0, right.output
    assert right.output == "palm: as configured\n"
    order[[30, 77]] = 77, 30
    rest = 1500 + np.random.default_rng(5).normal(0, 30, 144)  # what the array rests at is no load
    wrong = run("calibrate", "map", recording(tmp_path / "wrong.log", order, rest=rest), "--config", config)
    assert wrong.exit_code == 1
    assert "palm: taxels 30 and 77 swapped" in wrong.output


def test_taxels_that_send_nothing_are_left_out(config, tmp_path):  # noqa: F811
    log = recording(tmp_path / "a.log", np.arange(144), lost=3)
    assert run("calibrate", "map", log, "--config", config).output == "palm: as configured\n"


def test_a_roll_over_half_of_the_array_is_refused(config, tmp_path):  # noqa: F811
    log = recording(tmp_path / "half.log", np.arange(144), part=0.1)
    assert "roll over all of them" in refusal("calibrate", "map", log, "--config", config)
