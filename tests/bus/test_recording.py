from dataclasses import replace
from threading import Event, Thread

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.bus import recording
from tactiled.bus.reader import open_bus
from tactiled.bus.router import Router
from tactiled.config import parse
from tactiled.config.example import GRASP
from tactiled.errors import ConfigError
from tactiled.runtime.pipeline import Pipeline

# Slices of the data set, as its files have them: rows thumb, index, middle, ring, little.
BEAR_1_FIRST = """
242 242 241 243 243 243 242 243 243 242 243 243
243 243 244 243 242 242 242 240 243 243 242 242
244 244 246 251 252 244 248 248 248 245 247 244
241 243 244 244 244 244 243 243 244 244 244 243
244 244 247 248 248 247 248 247 246 247 248 245
"""
BOOK_1_FIRST = """
243 241 236 241 241 239 240 238 242 241 238 241
243 243 243 243 243 243 246 239 243 243 242 243
243 245 243 244 248 244 238 242 244 244 245 244
242 244 245 245 245 244 245 244 244 245 244 244
244 245 249 250 249 250 251 250 248 250 251 246
"""
BOOK_2_LAST = """
242 240 234 242 241 234 239 236 241 241 236 242
242 243 242 243 242 239 233 233 240 243 241 242
243 245 243 243 247 244 240 242 244 243 243 244
241 243 244 245 245 244 245 244 244 245 244 243
244 245 249 250 249 249 251 249 248 249 249 246
"""
THUMB_LAST = [1, 2, 3, 4, 0]  # triangles are index, middle, ring, little, thumb


def taxels(rows):
    """(60,) counts in the codec's order."""
    return np.array(rows.split(), np.uint16).reshape(5, 12)[THUMB_LAST].ravel()


@pytest.fixture(scope="module")
def plan():
    return sensor_plan("hand", parse(GRASP).sensor["hand"])


@pytest.fixture
def wire(request):
    ends = [open_bus(interface="virtual", channel=request.node.name) for _ in range(2)]
    yield ends
    for each in ends:
        each.close()


def test_the_recordings_of_the_package_have_their_licence_beside_them():
    assert recording.names() == ("blue_bear_1", "blue_bear_2", "book_1", "book_2")
    for name in recording.names():
        beside = recording.path(name).parent
        assert "Copyright 2012 Harold Soh" in (beside / "DATASET.txt").read_text("utf-8")


def test_a_recording_that_is_not_there_is_refused_with_those_that_are():
    with pytest.raises(ConfigError, match="recording 'cup': no such recording: choose one of blue_bear_1, "):
        recording.path("cup")


def received(plan, wire, name):
    """Every frame of a recording that was played over a bus."""
    sender, reader = wire
    router = Router({plan.name: plan.codec})
    stop = Event()
    thread = Thread(target=recording.replay, args=(recording.path(name), sender.send, stop))
    thread.start()
    frames = []
    while (message := reader.receive(0.5)) is not None:
        frames += [frame for _, frame in router.push(message)]
    thread.join()
    return frames


@pytest.mark.parametrize(
    ("name", "slices", "place", "rows"),
    [("blue_bear_1", 12, 0, BEAR_1_FIRST), ("book_1", 15, 0, BOOK_1_FIRST), ("book_2", 14, -1, BOOK_2_LAST)],
)
def test_real_bytes_of_a_grasp_are_restored_from_the_bus_on(plan, wire, name, slices, place, rows):
    frames = received(plan, wire, name)
    assert len(frames) == slices
    assert all(not frame.flags.any() and frame.loss.lost == 0 for frame in frames)
    np.testing.assert_array_equal(frames[place].counts, taxels(rows))

    pipeline = Pipeline(replace(plan, method="wiener"))
    image = pipeline.process(frames[place])
    np.testing.assert_array_equal(image.raw, 245.0 - taxels(rows))  # pressure counts = no load - value
    assert image.raw.shape == image.restored.shape == (60,)
    assert [each.code for each in image.warnings] == ["uncalibrated"]


def test_a_restored_grasp_explains_what_was_measured(plan, wire):
    """Blurred again, it comes nearer to the raw image than that image blurred twice would."""
    frame = received(plan, wire, "book_2")[-1]
    image = Pipeline(replace(plan, method="wiener")).process(frame)
    again = np.linalg.norm(plan.blur.forward(image.restored) - image.raw)
    assert again < 0.5 * np.linalg.norm(plan.blur.forward(image.raw) - image.raw)


def test_frames_go_out_at_the_recorded_pace_and_bear_the_time_of_sending():
    times = []
    assert recording.replay(recording.path("book_1"), lambda each: times.append(each.time), Event()) == 150
    gaps = np.diff(times[::10])  # ten messages a frame
    assert gaps.sum() == pytest.approx(14 * 0.02, rel=0.05)
    times.clear()
    recording.replay(recording.path("book_1"), lambda each: times.append(each.time), Event(), speed=float("inf"))
    assert times[-1] - times[0] < 0.1


def test_a_loop_ends_by_its_stop_and_keeps_frames_whole(plan):
    stop, sent = Event(), []

    def send(message):
        sent.append(message)
        if len(sent) == 625:
            stop.set()

    assert recording.replay(recording.path("book_1"), send, stop, loop=True, speed=4) == 625
    router = Router({"hand": plan.codec})
    frames = [frame for each in sent for _, frame in router.push(each)]
    assert len(frames) == 62
    assert not any(frame.flags.any() for frame in frames)
    pauses = [sent[150 * lap].time - sent[150 * lap - 1].time for lap in (1, 2, 3, 4)]
    assert np.median(pauses) == pytest.approx((0.02 - 9 * 0.00025) / 4, rel=0.4)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("gone.log", None, "No such file"),
        ("skin.xyz", "", "give a recording in a format"),
        ("skin.log", "(0.0) can0 123", "give a recording in a format"),
    ],
)
def test_a_file_that_is_no_recording_is_refused_in_one_line(tmp_path, name, text, says):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=says) as caught:
        recording.replay(path, lambda _: None, Event())
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("speed", [0, -1, float("nan")])
def test_a_speed_that_leads_nowhere_is_refused(speed):
    with pytest.raises(ConfigError, match="speed = "):
        recording.replay(recording.path("book_1"), lambda _: None, Event(), speed=speed)
