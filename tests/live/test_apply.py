"""A calibration is applied, and a tare undone, while frames come."""

import threading
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from tactiled.calibrate.calibration_file import load, save
from tactiled.config import parse
from tactiled.errors import ConfigError, StateError, TareStateError
from tactiled.guided.calibrations import GuidedCalibrations
from tactiled.live import service as module
from tactiled.live.pipeline import Pipeline
from tactiled.live.service import Service
from tactiled.live.state_file import StateFile
from tests.calibrate.files import calibration_file, gain_section
from tests.conftest import CONFIG, NO_LOAD, pressed
from tests.live.conftest import frame

SCALARS = "kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5"


@pytest.fixture
def make(tmp_path):
    """Services of the palm with a calibration file beside the configuration, or without one."""

    def make(file="palm.json", state=None):
        settings = f'file = "{file}", noise_kpa = 0.5' if file else SCALARS
        text = CONFIG.format(channel="none").replace(SCALARS, settings)
        return Service(parse(text, folder=tmp_path), state=StateFile(state) if state else None)

    return make


def lines(gain):
    return calibration_file(gain=gain_section(np.full(64, gain)))


def kinds(service):
    return [(each.kind, each.text) for each in service.events.after(0)]


def restored(service, n=0, **fields):
    sensor = service.sensor("palm")
    sensor.restore(frame(n, **fields))
    return sensor.hub.latest()


def test_a_file_applies_from_the_next_frame_on_and_after_a_restart(make):
    service, file = make(), lines(0.25)
    assert kinds(service) == [("calibration_missing", "palm.json: not there yet: the configuration holds")]
    before = restored(service)
    assert (before.calibration, before.unit, before.raw[3, 3]) == ("configured", "counts", 500)
    assert before.noise == pytest.approx(12**-0.5)  # the configured one is in kPa
    service.set_method("palm", "raw")
    service.apply_calibration("palm", file)
    after = restored(service, 1)
    assert (after.calibration, after.unit, after.raw[3, 3], after.method) == (file.id, "kPa", 125, "raw")
    assert kinds(service)[-1] == ("calibration_applied", f"{file.id}: gain; written to palm.json")
    again = make()
    assert restored(again).calibration == file.id
    assert kinds(again) == []


def test_without_a_configured_file_it_lasts_until_the_service_ends(make):
    service, file = make(file=None), lines(0.25)
    service.apply_calibration("palm", file)
    image = restored(service)
    assert (image.calibration, image.raw[3, 3]) == (file.id, 100)
    assert kinds(service)[-1][1].endswith("gain; until the service ends: calibration.file is not set")
    assert service.former_calibrations("palm") == {0: None}
    service.apply_calibration("palm", lines(0.5))
    assert service.former_calibrations("palm") == {1: file, 0: None}
    service.apply_calibration("palm", None)
    assert kinds(service)[-1] == ("calibration_applied", "configured: the values of the configuration hold")
    assert (restored(service, 1).calibration, [*service.former_calibrations("palm")]) == ("configured", [1, 2])
    assert restored(make(file=None)).calibration == "configured"


def test_what_cannot_be_applied_changes_nothing(make, tmp_path, monkeypatch):
    service, file = make(), lines(0.25)
    service.apply_calibration("palm", file)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(ConfigError, match=r"sensor.palm: palm.json: sensor is 'thumb'"):
        service.apply_calibration("palm", calibration_file(sensor="thumb"))
    full = OSError(28, "No space left on device")
    monkeypatch.setattr("os.fsync", Mock(side_effect=full))
    with pytest.raises(StateError, match="No space left on device: nothing was written"):
        service.apply_calibration("palm", lines(1.0))
    monkeypatch.undo()
    assert restored(service).calibration == file.id
    assert load(tmp_path / "palm.json") == file
    assert sorted(tmp_path.iterdir()) == before
    assert len(service.events.after(0)) == 2


@pytest.fixture
def solving(monkeypatch):
    """Events: a calibration is being made, and it may go on."""
    begun, done, plan = threading.Event(), threading.Event(), module.sensor_plan

    def slow_plan(name, settings, file):
        begun.set()
        assert done.wait(60)
        return plan(name, settings, file)

    monkeypatch.setattr(module, "sensor_plan", slow_plan)
    return begun, done


def test_a_sensor_that_was_replaced_meanwhile_is_not_calibrated_in_the_place_of_the_new_one(make, solving):
    service, (begun, done), looked = make(), solving, threading.Event()
    first = threading.Thread(target=service.apply_calibration, args=("palm", lines(0.5)))
    first.start()
    assert begun.wait(60)
    sensor = service.sensor
    service.sensor = lambda name: looked.set() or sensor(name)
    second = threading.Thread(target=service.apply_calibration, args=("palm", lines(0.25)))
    second.start()
    looked.wait(0.2)  # what looks too early does so at once
    service.sensors = make().sensors  # as after a reload
    done.set()
    first.join()
    second.join()
    assert service.sensor("palm").plan.calibration_id == lines(0.25).id


def test_a_method_that_is_set_during_a_calibration_is_the_next_frames(make, monkeypatch):
    service, take_over = make(), Pipeline.take_over
    other = threading.Thread(target=service.set_method, args=("palm", "raw"))

    def taken_over(self, before):
        take_over(self, before)
        other.start()
        other.join(0.2)  # what does not wait is done at once

    monkeypatch.setattr(Pipeline, "take_over", taken_over)
    service.apply_calibration("palm", lines(0.25))
    other.join()
    assert service.sensor("palm").method == "raw"


def test_who_asks_while_a_calibration_is_applied_does_not_wait_and_ends_nothing(make, solving):
    service, (begun, done) = make(), solving
    restored(service)
    calibrations = GuidedCalibrations(service)
    session = calibrations.start("palm", "uniform")
    session.state, session.outcome = "fitted", SimpleNamespace(file=lines(0.25))
    other = threading.Thread(target=calibrations.apply, args=("palm",))
    other.start()
    assert begun.wait(60)
    assert calibrations.way("palm") == "uniform"
    done.set()
    other.join()
    assert calibrations.way("palm") is None
    assert [text for kind, text in kinds(service) if kind == "calibration_ended"] == ["applied"]


def test_frames_go_on_while_a_cover_is_solved_and_none_is_of_two_calibrations(make, solving):
    service, (begun, done) = make(), solving
    file = lines(0.25)
    other = threading.Thread(target=service.apply_calibration, args=("palm", file))
    other.start()
    assert begun.wait(60)
    images = [restored(service, n) for n in range(3)]
    done.set()
    while images[-1].calibration != file.id:
        images.append(restored(service, len(images)))
    other.join()
    assert {(each.calibration, each.unit, float(each.raw[3, 3])) for each in images} == {
        ("configured", "counts", 500.0), (file.id, "kPa", 125.0)
    }  # fmt: skip


def tare(service, counts):
    sensor = service.sensor("palm")
    sensor.pipeline.tare(1000.0, force=True)
    for n in range(16):
        restored(service, n, counts=counts, arrived=n / 30)
    service._watch.look(0.0)


def test_a_tare_is_kept_over_a_restart_with_its_age_and_undone(make, tmp_path, monkeypatch):
    monkeypatch.setattr("time.time", lambda: 1000.0 + 3.2 * 3600)
    first = make(file=None, state=tmp_path / "state.json")
    tare(first, pressed())
    assert kinds(first)[-1] == ("tare_done", "the load of the last frames is the new zero; kept")
    again = make(file=None, state=tmp_path / "state.json")
    assert kinds(again) == [("tare_kept", "tared 3.2 h ago")]
    assert restored(again).raw[3, 3] == 0
    assert again.sensor("palm").status().tared_at == 1000.0
    again.undo_tare("palm")
    assert restored(again).raw[3, 3] == 200
    assert kinds(again)[-1] == ("tare_undone", "the zero from before the tare holds again; kept")
    with pytest.raises(TareStateError, match="sensor 'palm': no tare to undo"):
        again.undo_tare("palm")
    assert kinds(make(file=None, state=tmp_path / "state.json")) == []


def test_a_tare_of_another_array_or_older_than_the_files_no_load_is_ignored(make, tmp_path):
    state = tmp_path / "state.json"
    first = make(state=state)
    tare(first, pressed())
    text = state.read_text()
    save(tmp_path / "palm.json", calibration_file())  # its no load is of 2026
    ignored = make(state=state)
    assert kinds(ignored) == [("tare_ignored", "older than the calibration file's no load")]
    (tmp_path / "palm.json").unlink()
    for old, new in (('"packed"', '"xela"'), ('"counts": [', '"counts": [1,'), ('"time"', '"when"')):
        state.write_text(text.replace(old, new))
        assert ("tare_ignored", "sensor palm: of another array") in kinds(make(state=state))


def test_without_a_state_file_a_tare_is_not_kept_and_that_is_said(make):
    service = make(file=None)
    tare(service, np.full((8, 8), NO_LOAD + 3))
    assert kinds(service)[-1][1].endswith("a restart forgets it: this service keeps no state")
    assert service.sensor("palm").pipeline.zero.counts[0] == NO_LOAD + 3
