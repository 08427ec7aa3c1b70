import re
from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.calibrate.sections import NoLoadSection, utc
from tactiled.calibrate.upkeep.health import Fault
from tactiled.config import parse
from tactiled.config.example import SHEAR
from tactiled.contacts.regions import Region, RegionMeter
from tactiled.diagnostics.checks import CHECK_EVERY_FRAMES, CHECKS_IN_A_ROW
from tactiled.diagnostics.warning_codes import warning
from tactiled.frames import BAD, BELOW_ZERO, DEAD, FAULTY, MISSING, SATURATED, FrameWarning
from tactiled.geometry import grid, tiling
from tactiled.live.noise import NOISE_FRAMES
from tactiled.live.pipeline import Pipeline
from tactiled.live.tare import TARE_FRAMES, TARE_S
from tactiled.recorded.offline import Offline
from tactiled.recorded.playback import Playback
from tactiled.simulate.array import Surface
from tests.calibrate.files import calibration_file, origin
from tests.conftest import CONFIG, GAIN, NO_LOAD, SIDE, pressed
from tests.live.conftest import frame

SHAPE = SIDE, SIDE
FREE = Region(shape="rectangle", points_mm=[[-0.5, 5.5], [7.5, 7.5]])
UNLOADED = np.full(SHAPE, NO_LOAD)


@pytest.fixture
def make(plan):
    """Pipelines of the palm with another method or calibration."""

    def make(method="raw", warnings=(), **calibration):
        calibration = replace(plan.calibration, **calibration)
        return Pipeline(replace(plan, method=method, warnings=warnings, calibration=calibration))

    return make


def flags_of(by_taxel):
    flags = np.zeros(SHAPE)
    for taxel, flag in by_taxel.items():
        flags[taxel] = flag
    return flags


TARED_AT = 1763.0  # s


def tare(pipeline, *frames, force=False):
    """Tare by frames in turn, as many as it takes; returns the last image."""
    pipeline.tare(TARED_AT, force)
    for n in range(TARE_FRAMES):
        image = pipeline.process(replace(frames[n % len(frames)], arrived=n * TARE_S / (TARE_FRAMES - 1)))
    return image


def test_an_image_has_what_is_known_of_its_frame_and_keeps_it(make):
    pipeline = make("wiener", (warning("uncalibrated", unused=""),))
    image = pipeline.process(frame(7))
    restored = image.restored.copy()
    assert (image.sensor, image.sequence, image.time, image.loss.lost) == ("palm", 7, 12.5, 3)
    assert (image.method, image.noise, image.warnings[0].code) == ("wiener", 0.5, "uncalibrated")
    assert image.raw.shape == image.restored.shape == SHAPE
    assert image.raw[3, 3] == 200
    assert image.restored[3, 3] > image.raw[3, 3]
    assert image.microseconds > 0
    assert image.why
    pipeline.process(frame(8, UNLOADED))
    np.testing.assert_array_equal(image.restored, restored)


def test_the_deviation_is_of_the_method_that_made_the_image(make, plan):
    pipeline, surface = make("points"), Surface(plan.kernel, plan.array)
    point = 20_000.0 * (np.hypot(surface.x - 0.375, surface.y - 0.125) < 0.1)  # kPa, on one cell
    image = pipeline.process(frame(counts=np.round(NO_LOAD + surface.sense(point) / GAIN)))
    assert image.method == "points"
    deviation = pipeline.deviation(image)
    pipeline.set_method("wiener")  # of the next image, not of this one
    np.testing.assert_allclose(pipeline.deviation(image), deviation, atol=0.1 * deviation.max())


def test_the_deviation_of_an_image_that_was_cut_short_counts_what_it_lacks(make):
    pipeline = make("learned")
    cut, whole = pipeline.process(frame(), 0.0), pipeline.process(frame())
    assert [any(each.code == "cut_short" for each in image.warnings) for image in (cut, whole)] == [True, False]
    lacks, spread = whole.restored - cut.restored, pipeline.deviation(whole)
    assert np.abs(lacks).max() > 5  # kPa
    np.testing.assert_allclose(pipeline.deviation(cut), np.hypot(spread, lacks), rtol=1e-5)


@pytest.mark.parametrize("method", ["raw", "wiener", "auto"])
def test_a_taxel_without_data_is_nan_in_raw_inferred_in_restored_and_has_a_warning(make, method):
    flags = flags_of({(3, 3): MISSING, (0, 0): BAD})
    image = make(method, dead=(63,)).process(frame(flags=flags))
    assert np.isnan(image.raw[[3, 0, 7], [3, 0, 7]]).all()
    assert np.isfinite(image.restored).all()
    assert image.restored[3, 3] > 50
    assert image.flags[7, 7] == DEAD
    assert [(each.code, each.taxels) for each in image.warnings] == [("missing", 1), ("bad", 1), ("dead", 1)]
    assert image.warnings[2].text == "1 taxel dead: restored from its neighbours"


@pytest.mark.parametrize("method", ["raw", "auto"])
def test_what_lost_messages_leave_unknown_is_no_zero(make, method):
    flags = np.zeros(SHAPE)
    flags[:5] = MISSING  # the press is at rows 3 and 4
    pipeline = make(method)
    image = pipeline.process(frame(flags=flags))
    np.testing.assert_array_equal(np.isnan(image.restored).all(axis=1), [True] * 5 + [False] * 3)
    np.testing.assert_array_equal(np.isnan(pipeline.deviation(image)), np.isnan(image.restored))
    assert np.isnan(RegionMeter(None, pipeline._plan.cells)(image)).all()
    assert not np.isnan(RegionMeter(FREE, pipeline._plan.cells)(image)).any()
    if method == "auto":
        assert (image.method, image.why) == ("idle", "no contact above the noise where taxels have data")


def test_a_frame_without_data_says_so_and_is_neither_noise_nor_zero(make):
    pipeline, empty = make(noise_kpa=None), np.full(SHAPE, BAD)
    pipeline.tare(TARED_AT)
    images = [pipeline.process(frame(arrived=n * TARE_S, flags=empty)) for n in range(NOISE_FRAMES)]
    text = "no taxel has data, and nothing is known"
    assert images[-1].warnings == (FrameWarning("bad", f"64 taxels reported faulty by the sensor: {text}", 64),)
    assert (images[-1].why, pipeline.tares.done, pipeline.noise.settled) == (text, 0, False)


def test_after_a_tare_under_a_load_what_it_left_is_unknown_and_nothing_else(make):
    pipeline, random, loaded = make("auto"), np.random.default_rng(6), pressed(force=184)
    noisy = [loaded + random.normal(0, 1, SHAPE) for _ in range(8)]
    tare(pipeline, *(frame(counts=np.round(each)) for each in noisy), force=True)
    for counts in (UNLOADED, pressed(at=6, force=184)):  # 92 kPa elsewhere
        image = pipeline.process(frame(counts=np.round(counts + random.normal(0, 1, SHAPE))))
        assert np.argwhere(image.flags & BELOW_ZERO).tolist()[:2] == [[3, 3], [3, 4]]
        assert np.isnan(image.restored[3:5, 3:5]).all()
        assert (np.nanmax(image.restored) > 92) == (counts is not UNLOADED)
        assert np.nanmax(image.restored[:, :2]) < 5
        assert "below_zero" in {each.code for each in image.warnings}
    recording = MagicMock(frame=lambda _, number: images[number])
    images = [frame(0, np.round(UNLOADED)), frame(1, pressed(at=6, force=3000)), frame(2, pressed(force=150))]
    recording.count.return_value = len(images)
    recording.heads.side_effect = lambda _, first, count: {
        "time": np.full(count, 1e9), "position": np.arange(first, first + count), "total": np.arange(count),
    }  # fmt: skip
    playback = Playback(make("auto")._plan, replace(pipeline.zero, time=0.0), recording, ())
    for number in (2, 0):  # after a high load, a reading of a tenth of it below zero is a slow skin's
        played = playback.image(number, "auto")
        assert np.isnan(played.restored[3:5, 3:5]).all() == (number == 0)
        assert ("below_zero" in {each.code for each in played.warnings}) == (number == 0)


def test_a_frame_gives_the_same_image_live_played_and_out_of_a_file_of_pressures(make):
    pipeline, random = make("auto", dead=(9,), saturation=3000), np.random.default_rng(3)
    lost, whole = np.zeros((2, *SHAPE))
    lost[:2] = MISSING
    counts = [np.round(each + random.normal(0, 1, SHAPE)) for each in (pressed(), UNLOADED, pressed(force=3000))]
    frames = [frame(n, counts[n], (lost, whole, whole)[n]) for n in range(3)]
    live = [pipeline.process(each) for each in frames]
    playback = Playback(pipeline._plan, pipeline.zero, MagicMock(frame=lambda _, number: frames[number]), ())
    (restored, infos), *_ = Offline(pipeline._plan, np.stack([each.raw for each in live]), "auto", 0.5)
    for number in (2, 0, 1):
        image, played = live[number], playback.image(number, "auto")
        np.testing.assert_array_equal(played.restored, image.restored)
        np.testing.assert_array_equal(restored[number], image.restored)
        assert (image.method, image.why) == (played.method, played.why) == infos[number][:2]
    assert np.isnan(live[0].restored).any()
    assert live[2].flags.max() == SATURATED


def test_what_lies_beyond_the_array_explains_a_frame(make, plan):
    """Without it the rim of a contact over the edge reads as damaged taxels."""
    surface = Surface(plan.kernel, grid(SIDE, 3 * SIDE, 1.0, plan.array.width))
    felt = surface.sense(300.0 * (np.hypot(surface.x + SIDE / 2 + 1, surface.y) < 2.4))
    pressure = felt.reshape(SIDE, 3 * SIDE)[:, SIDE : 2 * SIDE]
    counts = np.round(UNLOADED + (pressure + np.random.default_rng(7).normal(0, 0.5, SHAPE)) / GAIN)
    pipeline = make("nnls")
    for n in range(CHECK_EVERY_FRAMES * CHECKS_IN_A_ROW):
        image = pipeline.process(frame(n, counts))
    recording = MagicMock(frame=lambda _, number: frame(number, counts))
    playback = Playback(pipeline._plan, pipeline.zero, recording, ())
    for warnings in (image.warnings, playback.warnings(n, "nnls")):
        assert [each.code for each in warnings] == ["edge"]


def test_saturated_taxels_have_a_warning(make):
    image = make(saturation=500).process(frame())
    assert np.count_nonzero(image.flags & SATURATED) == 4
    text = "4 taxels saturated: their pressure is a lower bound"
    assert image.warnings == (FrameWarning("saturated", text, 4),)


@pytest.mark.parametrize("configured", [None, 0.5])
def test_noise_is_measured_and_louder_than_configured_is_a_warning(make, configured):
    pipeline, random = make(noise_kpa=configured), np.random.default_rng(3)
    noisy = np.round(pressed() + random.normal(0, 8, (NOISE_FRAMES + 1, *SHAPE)))
    images = [pipeline.process(frame(n, counts)) for n, counts in enumerate(noisy)]
    if configured is None:
        assert images[0].noise == pytest.approx(GAIN * 12**-0.5)
        assert images[-1].noise == pytest.approx(8 * GAIN, rel=0.15)
        return
    assert images[-1].noise == configured
    assert "noise_high" not in [each.code for each in images[-3].warnings]
    raised = images[-1].warnings[0]
    assert raised.code == "noise_high"
    assert re.fullmatch(r"noise is [3-5](\.\d)? kPa, and 0.5 kPa was configured", raised.text)


def test_tare_takes_the_mean_of_the_next_frames(make):
    pipeline = make()
    tilted = np.arange(64).reshape(SHAPE) + 140
    image = tare(pipeline, frame(counts=tilted), frame(counts=tilted + 1, flags=flags_of({(0, 0): MISSING})))
    np.testing.assert_array_equal(image.raw[1:], 0.5 * GAIN)  # the last frame is half a count over the mean
    assert pipeline.process(frame(counts=tilted)).raw[0, 0] == 0


def test_a_tare_that_has_lapsed_takes_no_frame_and_the_next_starts_over(make):
    pipeline = make()
    pipeline.tare(TARED_AT)
    states = [pipeline.tares.state]
    for _ in range(TARE_FRAMES - 1):
        pipeline.process(frame(counts=9 * UNLOADED))
    states.append(pipeline.tares.state)
    pipeline.lapse_tare()
    pipeline.lapse_tare()  # of none
    assert [*states, pipeline.tares.state] == ["requested", "collecting", "lapsed"]
    assert pipeline.process(frame()).raw[3, 3] == 200
    tare(pipeline, frame(), force=True)
    assert pipeline.process(frame()).raw[3, 3] == 0
    assert (pipeline.tares.done, pipeline.tares.lapsed) == (1, 1)


def test_a_load_that_comes_while_a_tare_is_under_way_ends_it_unless_it_is_forced(make):
    comes, moves = (UNLOADED, pressed()), (UNLOADED, UNLOADED + 40)
    for first, then in (comes, moves, comes[::-1]):
        pipeline, frames = make(), [frame(counts=first)] * 12 + [frame(counts=then)] * 4
        before = pipeline.zero
        tare(pipeline, *frames)
        assert (pipeline.tares.done, pipeline.tares.refused, pipeline.can_undo) == (0, 1, False)
        assert pipeline.tares.state == "refused"
        assert re.match(r"contact of|readings that move by", pipeline.tares.load)
        assert pipeline.zero is before
        tare(pipeline, *frames, force=True)
        assert (pipeline.tares.done, pipeline.tares.refused, pipeline.can_undo) == (1, 1, True)


def test_noise_that_is_not_measured_yet_and_a_noisy_taxel_are_no_load(make):
    noise, pipeline = np.random.default_rng(1).normal(0, 12, (TARE_FRAMES, *SHAPE)), make(noise_kpa=None)
    noise[:, 3, 3] *= 10
    tare(pipeline, *(frame(counts=np.round(UNLOADED + each)) for each in noise))
    assert (pipeline.tares.done, pipeline.tares.refused) == (1, 0)


def test_another_calibration_starts_with_as_many_counts_of_noise_and_measures_it_again(make, plan):
    random, pipeline = np.random.default_rng(2), make(noise_kpa=None)

    def run(pipeline, noise):
        for n in range(NOISE_FRAMES):
            pipeline.process(frame(n, np.round(UNLOADED + random.normal(0, noise, SHAPE))))
        return pipeline.noise.kpa

    assert run(pipeline, 8) == pytest.approx(8 * GAIN, rel=0.15)
    calibration = replace(plan.calibration, kpa_per_count=2.0, noise_kpa=None)
    after = Pipeline(replace(plan, calibration=calibration), pipeline)
    assert after.noise.kpa == pytest.approx(pipeline.noise.kpa * 2.0 / GAIN)
    assert run(after, 3) == pytest.approx(3 * 2.0, rel=0.15)


def test_a_tare_takes_as_long_as_it_must_and_no_longer(make):
    def frames_until_tared(rate_hz):
        pipeline = make()
        pipeline.tare(TARED_AT)
        for n in range(10**4):
            pipeline.process(frame(counts=UNLOADED, arrived=n / rate_hz))
            if pipeline.tares.done:
                return n + 1
        return None

    assert [frames_until_tared(rate) for rate in (10, 100, 400, 10**4)] == [16, 51, 201, 256]


def test_a_tare_is_undone_once_and_one_under_way_is_given_up(make):
    pipeline = make()
    tare(pipeline, sheared(UNLOADED + 5, 50, -30))
    pipeline.tare(TARED_AT)
    pipeline.undo_tare()
    pipeline.process(frame())
    assert (pipeline.tares.state, pipeline.tares.done) == ("undone", 1)
    tare(pipeline, sheared(UNLOADED + 7, 50, -30))
    assert (pipeline.zero.time, pipeline.tares.state) == (TARED_AT, "done")
    pipeline.undo_tare()
    assert pipeline.tares.state == "undone"
    assert pipeline.process(frame(counts=UNLOADED + 5)).raw[0, 0] == 0
    assert not pipeline.can_undo
    pipeline.undo_tare()
    assert pipeline.zero.counts[0] == NO_LOAD + 5


def test_another_calibration_goes_on_with_the_tare_unless_its_no_load_is_newer(make, plan):
    def tared():
        pipeline = make("nnls")
        tare(pipeline, sheared(UNLOADED + 5, 50, -30))
        return pipeline

    def with_no_load(time):
        counts = np.full(64, 90.0)
        section = NoLoadSection.of(counts, origin("tare", utc(time)))
        calibration = replace(plan.calibration, kpa_per_count=2.0, no_loads=counts)
        return Pipeline(replace(plan, calibration=calibration, file=calibration_file(no_load=section)))

    pipeline, old = with_no_load(TARED_AT - 60), tared()
    old.set_zero(replace(old.zero, counts=old.zero.counts + 1))  # as by a second tare
    pipeline.take_over(old)
    pipeline.undo_tare()
    assert pipeline.zero.counts[0] == NO_LOAD + 5
    for after, reading in ((-60, 2.0 * 5), (60, 2.0 * 20)):
        pipeline, old = with_no_load(TARED_AT + after), tared()
        pipeline.take_over(old)
        assert pipeline.process(frame(counts=UNLOADED + 10)).raw[0, 0] == reading
        assert (pipeline.method, pipeline.tares.done, pipeline.can_undo) == ("nnls", 1, after < 0)
        assert pipeline.zero.shear[0, 0] == 50
        pipeline.undo_tare()
        assert pipeline.zero.counts[0] == 90  # of the calibration file
    pipeline, old = with_no_load(TARED_AT + 60), tared()
    old.tare(TARED_AT + 90)
    pipeline.take_over(old)  # the tare under way, too
    for n in range(TARE_FRAMES):
        pipeline.process(frame(counts=UNLOADED, arrived=n * TARE_S / (TARE_FRAMES - 1)))
    assert pipeline.zero.time == TARED_AT + 90


def sheared(counts, x, y, flags=None):
    return frame(counts=counts, flags=flags, shear=np.stack([np.full(64, x), np.full(64, y)]).astype(np.float32))


def test_forces_are_newtons_along_and_into_the_skin_above_those_of_the_tare(make):
    pipeline = make(no_load=7, shear_n_per_count=-0.01)
    load = sheared(pressed(), 60, 70)
    assert pipeline.forces(load) is None  # not tared
    tare(pipeline, sheared(UNLOADED, 50, -30))
    forces = pipeline.forces(load)
    np.testing.assert_allclose(forces[:, :2], np.broadcast_to([-0.1, -1.0], (64, 2)), rtol=1e-6)
    into = (pressed() - NO_LOAD) * GAIN * 1.0**2 * 1e-3  # kPa mm^2 are mN
    np.testing.assert_allclose(forces[:, 2].reshape(SHAPE), into, rtol=1e-6)


def test_forces_of_a_layout_are_of_the_surface_that_each_taxel_stands_for():
    row = [[2.0 * n, 0.0] for n in range(5)]
    text = CONFIG.replace("rows = 8, columns = 8, pitch_mm = 1.0", f"positions_mm = {row}")
    plan = sensor_plan("row", parse(text.format(channel="none")).sensor["palm"])
    pipeline = Pipeline(replace(plan, calibration=replace(plan.calibration, shear_n_per_count=1.0)))
    even = frame(counts=np.full(5, 100), flags=np.zeros(5), shear=np.zeros((2, 5)))
    tare(pipeline, even)
    forces = pipeline.forces(replace(even, counts=np.full(5, 300, np.uint16)))
    np.testing.assert_allclose(forces[:, 2], 200 * GAIN * tiling(plan.array).areas * 1e-3, rtol=1e-6)


@pytest.mark.parametrize(
    ("settings", "flag_of_tare", "flag", "known_without"),
    [
        ({"shear_n_per_count": 0.1}, 0, MISSING, True),
        ({"shear_n_per_count": 0.1}, 0, BAD, True),
        ({"shear_n_per_count": 0.1}, MISSING, 0, False),
        ({"shear_n_per_count": 0.1, "dead": (3,)}, 0, 0, False),
        ({}, 0, 0, False),
    ],
)
def test_forces_are_none_unless_all_are_known(make, settings, flag_of_tare, flag, known_without):
    pipeline = make(**settings)
    tare(pipeline, sheared(UNLOADED, 0, 0, flags_of({(2, 2): flag_of_tare})))
    assert pipeline.forces(sheared(pressed(), 1, 1, flags_of({(2, 2): flag}))) is None
    assert (pipeline.forces(sheared(pressed(), 1, 1)) is not None) == known_without
    assert pipeline.forces(frame()) is None  # without shear


def dragged(plan, share):
    """A frame of the demo's 3-axis skin under a press that drags along x by a share of it; and the press."""
    coupled, shape = plan.coupled, plan.coupled.shape
    y, x = np.indices(shape)
    pressure = 60 * np.exp(-((x - shape[1] / 2) ** 2 + (y - shape[0] / 2) ** 2) / 6)
    load = np.concatenate([pressure.ravel(), share * pressure.ravel(), np.zeros(pressure.size)])
    raw, *shear = (coupled.felt @ load).reshape(3, -1)
    counts = plan.calibration.no_load + raw / plan.calibration.kpa_per_count
    flags = np.zeros(len(raw), np.uint8)
    shear = np.asarray(shear / plan.kpa_per_shear_count, np.float32)
    return replace(frame(counts=counts, flags=flags), shear=shear), pressure[coupled.own]


def test_tangential_load_is_restored_once_shear_is_tared_and_pressure_without_what_it_adds():
    config = parse(SHEAR).sensor["skin"]
    plan = replace(sensor_plan("skin", config), method="auto")
    pipeline, (load, pressure) = Pipeline(plan), dragged(plan, 0.5)
    pipeline.noise.settle(0.1)
    before = pipeline.process(load)
    assert before.traction is before.tilt is None
    tare(pipeline, replace(dragged(plan, 0)[0], counts=np.full(24, 36000, np.uint16), shear=np.zeros((2, 24))))
    pipeline.cover.observe = MagicMock()
    image = pipeline.process(load)
    x, y = image.traction
    np.testing.assert_allclose(x.sum(), 0.5 * pressure.sum(), rtol=0.1)
    assert np.linalg.norm(x - 0.5 * pressure) < 0.2 * np.linalg.norm(0.5 * pressure)
    assert np.abs(y).max() < 0.1 * x.max()
    assert image.traction_deviation.shape == image.traction.shape
    wrong = [np.linalg.norm(each.restored - pressure) for each in (before, image)]
    assert wrong[1] < 0.5 * wrong[0]
    np.testing.assert_allclose(pipeline.cover.observe.call_args.args[0], image.raw - image.tilt, rtol=1e-6)
    narrow = Pipeline(replace(plan, coupled=plan.coupled._replace(wide=False)))
    narrow.set_zero(pipeline.zero)
    narrow.noise.settle(0.1)
    alone = narrow.process(load)
    np.testing.assert_array_equal(alone.restored, before.restored)
    assert not alone.tilt.any()
    assert np.linalg.norm(alone.traction[0] - 0.5 * pressure) < 0.3 * np.linalg.norm(0.5 * pressure)
    spread = pipeline.deviation(image)
    assert np.linalg.norm(image.restored - pressure) < 3 * np.linalg.norm(spread)
    raw = Pipeline(replace(plan, method="raw"))
    raw.set_zero(pipeline.zero)
    felt = raw.calibrator(load.counts, load.flags)[0][plan.blur.taxel]
    np.testing.assert_array_equal(raw.process(load).restored.ravel(), felt.ravel())
    pipeline.noise.settle(2.0)
    assert not pipeline.process(dragged(plan, 0.05)[0]).tilt.any()  # less than noise hides


@pytest.mark.parametrize(
    ("setting", "change"),
    [
        ("shear_n_per_count = 0.00032", ""),
        ("kpa_per_count = 0.02\n", ""),
        ("poisson = 0.45", "poisson = 0.45\nbonded = false"),
    ],
)
def test_it_is_not_where_shear_or_pressure_has_no_scale_or_the_cover_slides(setting, change):
    text = SHEAR.replace(setting, change)
    assert text != SHEAR
    text = text if "kpa_per_count = " in text else text.replace("shear_n_per_count = 0.00032", "")
    assert sensor_plan("skin", parse(text).sensor["skin"]).coupled is None


@pytest.mark.parametrize(
    ("tared", "track_drift", "tracks"), [(True, True, True), (False, True, False), (True, False, False)]
)
def test_zeros_that_were_measured_follow_drift(make, tared, track_drift, tracks):
    pipeline, random = make(track_drift=track_drift), np.random.default_rng(8)
    if tared:
        tare(pipeline, frame(counts=UNLOADED))
    for second in range(3600):  # 2 % of full scale
        counts = np.round(UNLOADED + 80 * second / 3600 + random.normal(0, 1, SHAPE))
        image = pipeline.process(frame(second, counts, time=20.0 + second))
    assert (abs(image.raw.mean()) < 2 * GAIN) == tracks
    state = pipeline.monitor.state
    assert (state.drift_counts is not None) == tracks
    assert not tracks or abs(state.drift_counts.mean() - 80) < 2
    other = make(track_drift=track_drift, kpa_per_count=2 * GAIN)
    other.take_over(pipeline)
    image = other.process(frame(3600, counts, time=3620.0))
    assert (abs(image.raw.mean()) < 4 * GAIN) == tracks


def test_a_taxel_that_becomes_noisy_is_measured_and_then_trusted_less(make, plan):
    surface, random, at = Surface(plan.kernel, plan.array), np.random.default_rng(6), (3, 4)
    felt = surface.sense(300.0 * np.exp(-(surface.x**2 + surface.y**2) / 8)).reshape(SHAPE)
    pipeline, sigma, at_taxel = make("wiener", noise_kpa=None), np.full(SHAPE, 2.0), []
    for n in range(16 * 120):  # a block a second; its measured noise has come to nine tenths of it at last
        sigma[at] = 9.0 if n >= 16 * 25 else 2.0
        counts = np.round(UNLOADED + felt / GAIN + random.normal(0, sigma))
        image = pipeline.process(frame(n, counts, time=n // 16 + n % 16 / 100))
        at_taxel.append(image.restored[at])
    np.testing.assert_allclose(pipeline.monitor.state.noise_counts.reshape(SHAPE), sigma, rtol=0.3)
    quiet, noisy, weighed = (np.std(at_taxel[start : start + 200]) for start in (200, 400, 1720))
    assert weighed - quiet < 0.3 * (noisy - quiet)
    spread = pipeline.deviation(image)
    assert spread[at] > 1.2 * spread[4, 3]
    new = make("wiener", noise_kpa=image.noise, noise_counts=sigma.ravel())  # as in a calibration file
    off = np.abs(new.process(frame(0, counts)).restored - image.restored)
    np.testing.assert_array_less(off, np.where(sigma > 2.0, spread, 1.0))  # the measured noise is lower
    unweighed = make("wiener", noise_kpa=image.noise).process(frame(0, counts)).restored
    assert off[at] < 0.5 * abs(unweighed - image.restored)[at]


def test_a_taxel_found_faulty_is_flagged_and_restored_from_its_neighbours_and_survives_another_calibration(make):
    pipeline, random = make("wiener"), np.random.default_rng(9)
    for n in range(40 * 100):
        counts = np.round(pressed() + random.normal(0, 4, SHAPE))
        if n > 2000:
            counts[3, 3] = 120
        image = pipeline.process(frame(n, counts, time=n / 100))
    assert np.argwhere(image.flags == FAULTY).tolist() == [[3, 3]]
    assert np.isnan(image.raw[3, 3])
    assert image.restored[3, 3] > 50
    assert [(each.code, each.taxels) for each in image.warnings if each.code == "faulty"] == [("faulty", 1)]
    other = make("wiener", kpa_per_count=2 * GAIN)
    other.take_over(pipeline)
    assert other.monitor.state.faults[3 * SIDE + 3] == Fault.STUCK
    assert other.process(frame(n, counts)).flags[3, 3] == FAULTY
