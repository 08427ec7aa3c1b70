import json
from copy import deepcopy
from dataclasses import replace
from functools import reduce
from operator import getitem
from unittest.mock import Mock

import numpy as np
import pytest

from tactiled.calibrate import calibration_file
from tactiled.calibrate.calibration_file import FILES_KEPT, kept, load, read, save
from tactiled.calibrate.sections import NEW_KEYS, GainSection
from tactiled.cover.stack import Layer, Stack
from tactiled.errors import ConfigError, StateError
from tests.calibrate.files import CREATED, STACK, cover_section, gain_section
from tests.calibrate.files import calibration_file as made

TAXELS = 8
NAN = float("nan")


@pytest.fixture
def file():
    return made(TAXELS)


def test_a_file_is_read_as_it_was_written_and_has_the_same_id(file):
    again = read(file.text)
    assert (again, again.id, again.text) == (file, file.id, file.text)
    np.testing.assert_array_equal(again.gain.curves.parameters, file.gain.curves.parameters)
    np.testing.assert_array_equal(again.no_load.values, file.no_load.values)
    assert again.cover.stack == STACK
    assert again.health.dead == (3,)
    assert np.isnan(again.gain.curves.hysteresis).all()
    changed = file.replaced(gain=gain_section(np.full(TAXELS, 0.5)))
    assert changed.id != file.id
    assert (changed.cover, changed.created) == (file.cover, CREATED)


def test_what_an_older_release_cannot_read_has_another_version(file):
    assert json.loads(file.text)["version"] == 1
    assert not NEW_KEYS & json.loads(file.text)["gain"].keys()
    curves = replace(file.gain.curves, error_kpa=np.array([NAN, *range(1, TAXELS)]), curvature=0.02)
    newer = read(file.replaced(gain=GainSection.of(curves, file.gain.origin)).text)
    assert json.loads(newer.text)["version"] == 2
    np.testing.assert_array_equal(newer.gain.curves.error_kpa, curves.error_kpa)
    assert newer.gain.curves.curvature == 0.02


def test_a_person_can_read_it_head_first_one_array_a_line(file):
    lines = [line.strip() for line in file.text.splitlines()]
    head = [line.split(":")[0].strip('"') for line in lines[1:9]]
    assert head == ["format", "version", "created", "sensor", "codec", "taxels", "unit", "checksum"]
    arrays = [line for line in lines if line.startswith(('"counts": [', '"deviation": ['))]
    assert [line.count(", ") for line in arrays] == [TAXELS - 1, TAXELS - 1]
    assert len(lines) < 75


@pytest.mark.parametrize(
    ("place", "value", "line"),
    [
        ("version", 3, "version is 3: this release reads up to 2: update tactiled"),
        ("format", "x", "format: no tactiled calibration"),
        ("unit", "psi", "unit = 'psi': Input should be 'kPa'"),
        ("extra", 1, "extra: unknown key"),
        ("created", "2020-01-01T00:00:00Z", "created is '2020-01-01T00:00:00Z': the newest section is of 2026-"),
        ("taxels", 9, "no_load has 8 taxels: the file has 9"),
        ("gain.parameters.0.2", -0.5, "gain: parameters of taxel 2 is [-0.5]: a linear curve must rise"),
        ("gain.parameters.0.2", None, "gain.parameters[0][2] = None: Input should be a valid number"),
        ("gain.parameters.0", [0.5], "gain: parameters and reach_counts have different numbers of taxels"),
        ("gain.origin.created", "today", "gain.origin.created = 'today': give a time in UTC, such as 2026-"),
        ("gain.origin.sha256", "A", "gain.origin.sha256 = 'A': give 64 digits of 0-9 and a-f, or nothing"),
        (
            "cover.interval",
            [-0.1, 1.3],
            "cover: interval is -0.1 to 1.3: it must be positive and hold factor = 1.2",
        ),
        ("cover.thickness_mm", 0.5, "cover: thickness_mm is 0.5: factor and layers give 0.96"),
        ("cover.layers.0.poisson", 0.5, "cover: layer Poisson's ratio is 0.5"),
        ("cover.kernel", [[0, 1, 2, 2], [1, 1, 1, 1]], "cover: kernel: frequencies must rise from 0"),
        ("cover.kernel", [[0, 1, 2, 3], [0.5, 1, 1, 1]], "cover: kernel: its gain at frequency 0 is 0.5"),
        ("no_load.counts.2", 1e10, "no_load.counts[2] = 10000000000.0: Input should be less than or equal to"),
        ("gain.reach_counts.1.2", 5e-324, "gain: reach_counts of taxel 2 is [0.0, 5e-324]: give 0 and the"),
        ("gain.parameters", [[1.0] * TAXELS] * 65, "gain.parameters = [[1.0, 1.0"),
        ("cover.kernel", [[0, 1, 2, 3], [1, 1, 1, 1e6]], "cover: kernel has a gain of 1e+06: give at most 10"),
        ("cover.kernel", [[*range(5000)], [1] * 5000], "cover: kernel has 5000 frequencies and 5000 gains"),
        ("health.dead", [8], "health.dead names taxel 8: the array has 0 to 7"),
    ],
)
def test_what_a_file_may_not_hold_is_refused_by_name_in_one_line(file, place, value, line):
    content = json.loads(file.text)
    del content["checksum"]
    *tables, last = [int(key) if key.isdecimal() else key for key in place.split(".")]
    reduce(getitem, tables, content)[last] = value
    with pytest.raises(ConfigError) as error:
        read(json.dumps(content | {"checksum": calibration_file._checksum(content)}))
    assert str(error.value).startswith(line)
    assert "\n" not in str(error.value)


def places(value, path=()):
    """The place of every value in a file's content, of a list that of its first and last."""
    items = value.items() if isinstance(value, dict) else list(enumerate(value)) if isinstance(value, list) else ()
    for key, each in items if isinstance(value, dict) or not items else (items[0], items[-1]):
        yield (*path, key)
        yield from places(each, (*path, key))


def test_what_a_hostile_file_holds_is_refused_in_one_line_or_calibrates(file):
    """Any value anywhere, with a right checksum; a warning of numpy fails as an error does."""
    content = json.loads(file.text)
    del content["checksum"]
    extremes = (0, -1, 1e9, 1e300, 5e-324, -1e308, 10**400, None, True, "x", [], {}, [[1]], NAN, [0.0] * TAXELS)
    for *tables, last in places(content):
        for value in extremes:
            changed = deepcopy(content)
            reduce(getitem, tables, changed)[last] = value
            try:
                read_again = read(json.dumps(changed | {"checksum": calibration_file._checksum(changed)}))
            except ConfigError as error:
                assert len(str(error)) < 300  # noqa: PT017
                continue
            if read_again.gain:
                assert np.isfinite(read_again.gain.curves.pressure(np.array([[-1e5], [0.0], [1e5]]))).all()


def test_a_truncated_or_altered_file_is_refused(file):
    with pytest.raises(ConfigError, match=r"truncated, or not JSON, at line \d+"):
        read(file.text[: len(file.text) // 2])
    with pytest.raises(ConfigError, match="checksum: does not match"):
        read(file.text.replace('"presses": 20', '"presses": 21'))
    for text in ("", "[]", "[" * 100_000, b"\xff\xfe\x00"):
        with pytest.raises(ConfigError):
            read(text)
    with pytest.raises(ConfigError, match="no section: give no_load, gain, cover or health"):
        made(TAXELS, gain=None)


@pytest.mark.parametrize(
    ("other", "line"),
    [
        ({"sensor": "fist"}, "sensor is 'palm', and the configuration has 'fist'"),
        ({"codec": "xela"}, "codec is 'packed', and the configuration has 'xela'"),
        ({"taxels": 9}, "taxels is 8, and the configuration has 9"),
        ({"stack": Stack((Layer(0.9, 0.6, 0.48),))}, "cover was fitted with 0.8 mm .* has 0.9 mm"),
        ({"stack": Stack(STACK.layers, bonds=(False,))}, "with 0.8 mm 0.6 MPa 0.48 ‖ .* 0.48 sliding ‖"),
    ],
)  # fmt: skip
def test_a_file_of_another_array_is_refused_by_name(file, other, line):
    mine = {"sensor": "palm", "codec": "packed", "taxels": TAXELS, "stack": STACK}
    file.need_fit(**mine)
    with pytest.raises(ConfigError, match=line):
        file.need_fit(**mine | other)


def test_a_fit_that_cannot_tell_makes_no_section():
    fit = replace(cover_section().fit, reason="nothing sharp was pressed")
    with pytest.raises(ConfigError, match="cover: nothing sharp was pressed"):
        type(cover_section()).of(fit, STACK, cover_section().origin)


def test_the_last_ten_files_are_kept_and_a_failed_write_changes_nothing(tmp_path, file, monkeypatch):
    path = tmp_path / "palm.json"
    assert load(path) is None
    files = [file.replaced(gain=gain_section(np.full(TAXELS, 0.1 * n))) for n in range(1, FILES_KEPT + 4)]
    for each in files:
        save(path, each)
    assert load(path) == files[-1]
    assert [load(each) for each in kept(path).values()] == files[-2 : -FILES_KEPT - 2 : -1]
    before = {each.name: each.read_bytes() for each in tmp_path.iterdir()}
    monkeypatch.setattr("os.fsync", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(StateError, match=r"palm.json: No space left on device: nothing was written"):
        save(path, file)
    monkeypatch.undo()
    assert load(path) == files[-1]
    assert before.keys() >= {each.name for each in tmp_path.iterdir()}
    (tmp_path / "palm.json.3").write_text("{")
    with pytest.raises(ConfigError, match=r"palm.json.3: truncated"):
        load(kept(path)[3])
