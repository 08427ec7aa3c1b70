import re
from dataclasses import replace

import numpy as np
import pytest

from tactiled.calibrate.calibration import Calibration
from tactiled.diagnostics.warning_codes import warning
from tactiled.errors import ConfigError
from tactiled.frames import BAD, DEAD, MISSING, SATURATED, FrameWarning, Loss, RawFrame
from tactiled.geometry import grid, layout, tiling
from tactiled.restore.blur import MatrixBlur
from tactiled.runtime.pipeline import NOISE_FRAMES, TARE_FRAMES, Pipeline
from tactiled.study.truth import presses
from tests.plans import plan

SHAPE = (6, 5)


@pytest.fixture
def make():
    """Pipelines of a 6 x 5 array under a thin cover."""

    def pipeline(method="wiener", warnings=(), **calibration):
        made = plan(SHAPE, 0.4)
        return Pipeline("palm", made.array, made.blur, Calibration(**calibration), method, warnings)

    return pipeline


def frame(counts, sequence=0, flags=None):
    counts = np.asarray(counts, np.uint16).ravel()
    flags = np.zeros(counts.size, np.uint8) if flags is None else np.asarray(flags, np.uint8).ravel()
    return RawFrame(sequence, 12.5, 0.001, counts, flags, Loss(lost=3))


def codes(image):
    return [each.code for each in image.warnings]


def pressed(background=100):
    counts = np.full(SHAPE, background)
    counts[2:4, 2:4] += 400
    return counts


def test_an_image_says_where_it_comes_from(make):
    image = make("wiener", (warning("uncalibrated"),), no_load=100, kpa_per_count=0.5, noise_kpa=0.5).process(
        frame(pressed(), 7)
    )
    assert (image.sensor, image.sequence, image.time, image.loss.lost) == ("palm", 7, 12.5, 3)
    assert (image.method, image.noise_kpa, codes(image)) == ("wiener", 0.5, ["uncalibrated"])
    assert image.raw.shape == image.restored.shape == SHAPE
    assert image.raw[2, 2] == 200
    assert image.restored[2, 2] > image.raw[2, 2]
    assert image.microseconds > 0
    assert image.why


def test_images_do_not_change_when_the_next_frame_comes(make):
    pipeline = make(no_load=100, noise_kpa=0.5)
    first = pipeline.process(frame(pressed()))
    kept = first.restored.copy()
    pipeline.process(frame(np.full(SHAPE, 100)))
    np.testing.assert_array_equal(first.restored, kept)


def test_the_deviation_is_of_the_method_that_made_the_image():
    press = next(each for each in presses(12, (1.0,), (0.002,), 1, seed=4) if each.scene == "points")
    scale = 60_000 / press.frame.max()
    told = Calibration(kpa_per_count=1 / scale, no_load=2000, noise_kpa=press.sigma)
    pipeline = Pipeline("palm", grid(12, 12, 1.0), press.blur, told, "points")
    image = pipeline.process(frame(2000 + scale * press.frame.clip(-2000 / scale)))
    assert image.method == "points"
    known = pipeline.deviation(image)
    pipeline.set_method("wiener")  # which makes the next image, not this one
    np.testing.assert_array_equal(pipeline.deviation(image), known)


def test_a_method_takes_effect_with_the_next_frame_and_a_wrong_one_changes_nothing(make):
    pipeline = make("wiener", no_load=100, noise_kpa=0.5)
    assert pipeline.process(frame(pressed())).method == "wiener"
    pipeline.set_method("raw")
    image = pipeline.process(frame(pressed()))
    assert image.method == "raw"
    np.testing.assert_array_equal(image.restored, image.raw)
    with pytest.raises(ConfigError, match="method = 'sharpen': no such method: choose one of "):
        pipeline.set_method("sharpen")
    assert pipeline.method == "raw"


@pytest.mark.parametrize("method", ["raw", "wiener", "auto"])
def test_a_taxel_that_is_not_known_is_null_in_raw_inferred_in_restored_and_told(make, method):
    flags = np.zeros(SHAPE)
    flags[2, 2], flags[0, 0] = MISSING, BAD
    image = make(method, no_load=100, noise_kpa=0.5, dead=(29,)).process(frame(pressed(), flags=flags))
    assert np.isnan(image.raw[[2, 0, 5], [2, 0, 4]]).all()
    assert np.isfinite(image.restored).all()
    assert image.restored[2, 2] > 50
    assert image.flags[5, 4] == DEAD
    assert [(each.code, each.taxels) for each in image.warnings] == [("missing", 1), ("bad", 1), ("dead", 1)]
    assert image.warnings[2].text == "1 taxel dead: restored from its neighbours"


def test_saturation_is_told(make):
    image = make(no_load=100, saturation=500, noise_kpa=0.5).process(frame(pressed()))
    assert np.count_nonzero(image.flags & SATURATED) == 4
    assert image.warnings == (FrameWarning("saturated", "4 taxels saturated: their pressure is a lower bound", 4),)


def test_an_unknown_noise_is_measured_from_the_first_frames(make):
    random = np.random.default_rng(3)
    pipeline = make(no_load=100)
    images = [
        pipeline.process(frame(np.round(pressed() + random.normal(0, 4, SHAPE)), n))
        for n in range(NOISE_FRAMES + 1)
    ]
    assert images[0].noise_kpa == pytest.approx(12**-0.5)
    assert images[-1].noise_kpa == pytest.approx(4, rel=0.15)


def test_tare_takes_the_mean_of_the_next_frames(make):
    pipeline = make("raw", no_load=100, noise_kpa=0.5)
    pipeline.tare()
    tilted = np.arange(30).reshape(SHAPE) + 140
    flags = np.zeros(SHAPE)
    flags[0, 0] = MISSING
    for n in range(TARE_FRAMES):
        image = pipeline.process(frame(tilted + n % 2, n, flags if n % 2 else None))
    np.testing.assert_array_equal(image.raw[1:], 0.5)  # the last frame stands half a count over the mean
    assert pipeline.process(frame(tilted)).raw[0, 0] == 0


def test_a_tare_that_has_lapsed_takes_no_frame_and_the_next_begins_anew(make):
    pipeline = make("raw", no_load=100, noise_kpa=0.5)
    pipeline.tare()
    for _ in range(TARE_FRAMES - 1):
        pipeline.process(frame(np.full(SHAPE, 900)))
    pipeline.lapse()
    pipeline.lapse()  # of none
    assert pipeline.process(frame(pressed())).raw[2, 2] == 400
    pipeline.tare()
    for _ in range(TARE_FRAMES):
        pipeline.process(frame(pressed()))
    assert pipeline.process(frame(pressed())).raw[2, 2] == 0
    assert (pipeline.tared, pipeline.lapsed) == (1, 1)


def sheared(counts, x, y, flags=None):
    plain = frame(counts, flags=flags)
    return replace(plain, shear=np.stack([np.full(30, x), np.full(30, y)]).astype(np.float32))


def test_forces_are_newtons_along_and_into_the_skin_from_what_a_tare_took(make):
    pipeline = make("raw", kpa_per_count=0.5, no_load=7, noise_kpa=0.5, shear_n_per_count=-0.01)
    rest, load = sheared(np.full(SHAPE, 100), 50, -30), sheared(pressed(), 60, 70)
    assert pipeline.forces(load) is None  # not tared
    pipeline.tare()
    for _ in range(TARE_FRAMES):
        pipeline.process(rest)
    forces = pipeline.forces(load)
    np.testing.assert_allclose(forces[:, :2], np.broadcast_to([-0.1, -1.0], (30, 2)), rtol=1e-6)
    into = (pressed() - 100) * 0.5 * 1.0**2 * 1e-3  # kPa mm^2 are mN
    np.testing.assert_allclose(forces[:, 2].reshape(SHAPE), into, rtol=1e-6)


def test_forces_of_a_layout_are_of_the_surface_that_each_taxel_stands_for():
    row = layout(np.column_stack([np.arange(5) * 2.0, np.zeros(5)]))
    told = Calibration(kpa_per_count=1.0, no_load=0, noise_kpa=0.5, shear_n_per_count=1.0)
    pipeline = Pipeline("row", row, MatrixBlur(np.eye(5), 2.0), told, "raw")
    even = RawFrame(0, 0.0, 0.0, np.full(5, 100, np.uint16), np.zeros(5, np.uint8), Loss(), np.zeros((2, 5)))
    pipeline.tare()
    for _ in range(TARE_FRAMES):
        pipeline.process(even)
    forces = pipeline.forces(replace(even, counts=np.full(5, 300, np.uint16)))
    np.testing.assert_allclose(forces[:, 2], 200 * tiling(row).areas * 1e-3, rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "flags", "after"),
    [
        ({"shear_n_per_count": 0.1}, MISSING, True),
        ({"shear_n_per_count": 0.1}, BAD, True),
        ({"shear_n_per_count": 0.1, "dead": (3,)}, 0, False),
        ({}, 0, False),
    ],
)
def test_no_force_is_told_where_one_is_not_known(make, settings, flags, after):
    pipeline = make("raw", no_load=100, noise_kpa=0.5, **settings)
    pipeline.tare()
    for _ in range(TARE_FRAMES):
        pipeline.process(sheared(np.full(SHAPE, 100), 0, 0))
    faults = np.zeros(SHAPE)
    faults[2, 2] = flags
    assert pipeline.forces(sheared(pressed(), 1, 1, faults)) is None
    assert (pipeline.forces(sheared(pressed(), 1, 1)) is not None) == after


def test_a_skin_without_shear_has_no_forces(make):
    assert make("raw", no_load=100, shear_n_per_count=0.1).forces(frame(pressed())) is None


def test_noise_that_is_louder_than_told_is_told(make):
    random = np.random.default_rng(3)
    pipeline = make("raw", no_load=100, noise_kpa=0.5)
    for n in range(NOISE_FRAMES + 1):
        image = pipeline.process(frame(np.round(pressed() + random.normal(0, 4, SHAPE)), n))
    assert image.noise_kpa == 0.5
    raised = image.warnings[0]
    assert raised.code == "noise_high"
    assert re.fullmatch(r"noise is [3-5](\.\d)? kPa, and 0.5 kPa was configured", raised.text)
