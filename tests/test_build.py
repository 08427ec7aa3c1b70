import json

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.calibrate.calibration_file import save
from tactiled.config import parse
from tactiled.cover.kernel import solve
from tactiled.errors import ConfigError
from tactiled.restore.blur import THICKNESS_ERROR
from tests.calibrate.files import STACK, calibration_file, cover_section, gain_section
from tests.conftest import CONFIG

SCALARS = "kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5, saturation = 4000"
Q = np.concatenate([[0.0], np.geomspace(1e-4, 3.0, 300)])
THICKER = cover_section(stack=STACK.thickened(2))
NO_KERNEL = 'kernel.model = "measured": the calibration file holds no kernel'
MEASURED = np.stack([Q, np.exp(-Q)])  # of no stack of flat layers


@pytest.fixture
def plan(tmp_path):
    """The palm planned with a calibration file, the configuration's scalars or the kernel's model replaced."""

    def plan(file=None, scalars="noise_kpa = 0.5, saturation = 4000", model="layered"):
        if file:
            save(tmp_path / "palm.json", file)
        text = CONFIG.format(channel="none").replace(SCALARS, f'file = "palm.json", {scalars}')
        text = text.replace('model = "layered"', f'model = "{model}"')
        return sensor_plan("palm", parse(text, folder=tmp_path).sensor["palm"])

    return plan


def test_a_plan_has_the_files_curves_no_load_dead_taxels_and_cover(plan):
    file = calibration_file()
    made, uncovered = plan(file), plan(calibration_file(gain=file.gain))
    np.testing.assert_array_equal(made.calibration.curves.gain, file.gain.curves.gain)
    np.testing.assert_array_equal(made.calibration.no_loads, file.no_load.values)
    assert (made.calibration.dead, made.calibration.saturation, made.calibration.noise_kpa) == ((3,), 4000, 0.5)
    np.testing.assert_array_equal(made.calibration.noise_counts, np.where(np.arange(64) == 3, np.nan, 1.5))
    assert (made.calibration_id, made.calibrated, made.warnings) == (file.id, True, ())
    assert made.blur.thickness_error == pytest.approx(0.03 / 1.96)
    np.testing.assert_array_equal(made.kernel.gain, solve(STACK.thickened(1.2), "layered").gain)
    assert uncovered.blur.thickness_error == THICKNESS_ERROR
    np.testing.assert_array_equal(uncovered.kernel.gain, solve(STACK, "layered").gain)


def test_without_its_file_a_plan_is_as_configured(plan):
    absent = plan(scalars=SCALARS)
    assert (absent.calibration_id, absent.calibrated, absent.file) == ("configured", True, None)
    assert absent.calibration.kpa_per_count == 0.5
    assert plan().calibrated is False


def test_a_measured_kernel_replaces_the_solved_one(plan):
    made = plan(calibration_file(cover=cover_section(kernel=MEASURED)), model="measured")
    np.testing.assert_allclose(made.kernel.gain_at(np.array([0.3, 1.0])), np.exp([-0.3, -1.0]), rtol=1e-5)
    flat = np.full(made.blur.surface_shape, 10.0)
    assert made.blur.forward(flat)[4, 4] == pytest.approx(10, rel=0.1)
    # The gain falls by q dG/dq per relative thickness: at most 1/e, at q = 1.
    assert made.kernel.error_estimate == pytest.approx(0.03 / 1.96 / np.e, rel=0.01)


@pytest.mark.parametrize(
    ("file", "settings", "line"),
    [
        (calibration_file(), {"scalars": SCALARS}, "calibration.kpa_per_count = 0.5: .*palm.json holds it, too"),
        (calibration_file(), {"scalars": "no_load = 9"}, "calibration.no_load = 9: .*palm.json holds it, too"),
        (calibration_file(sensor="fist"), {}, "palm.json: sensor is 'fist', and the configuration has 'palm'"),
        (calibration_file(63), {}, "palm.json: taxels is 63, and the configuration has 64"),
        (calibration_file(cover=THICKER), {}, "palm.json: cover was fitted with 1.6 mm"),
        (None, {"model": "measured"}, NO_KERNEL),
        (calibration_file(), {"model": "measured"}, NO_KERNEL),
    ],
)  # fmt: skip
def test_a_file_that_does_not_fit_is_refused_by_name(plan, file, settings, line):
    with pytest.raises(ConfigError, match=line) as error:
        plan(file, **settings)
    assert str(error.value).startswith("sensor.palm: ")


def test_the_files_path_begins_at_the_configuration_and_is_printed_without_its_folder(plan, tmp_path):
    gain = gain_section(np.full(64, 0.25))
    assert plan(calibration_file(gain=gain)).calibration.kpa_per_count == 0.25
    config = parse(CONFIG.format(channel="none").replace(SCALARS, 'file = "sub/palm.json"'), folder=tmp_path)
    assert config.sensor["palm"].calibration.file == tmp_path / "sub" / "palm.json"
    assert json.loads(config.model_dump_json())["sensor"]["palm"]["calibration"]["file"] == "palm.json"
