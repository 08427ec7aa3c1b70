import re

import pytest

from tactiled.bus.codecs.packed import Packed
from tactiled.config.example import EXAMPLE
from tests.cli.commands import run, succeed

CHANNEL = "checked"
PALM = EXAMPLE.replace('"socketcan"', '"virtual"').replace('"can0"\nfd', f'"{CHANNEL}"\nfd')
PALM = re.sub(r"rows = 32\ncolumns = 32", "rows = 8\ncolumns = 8", PALM).replace('"fem"  ', '"layered"')


@pytest.fixture
def palm(tmp_path):
    def write(*change):
        path = tmp_path / "palm.toml"
        path.write_text(PALM.replace(*change) if change else PALM)
        return path

    return write


def test_a_doubtful_value_ends_a_check_with_1_and_a_run_only_prints_it(palm, monkeypatch):
    path = palm("thickness_mm = 1.2", "thickness_mm = 0.0012")
    line = (
        "doubtful: sensor.palm.cover.thickness_mm = 0.0012: thinner than a coat of paint; 1.2 mm if it was given"
    )
    done = run("check", path)
    assert done.exit_code == 1
    assert done.stdout.startswith(line)
    assert done.stdout.endswith("palm.toml is doubtful: 1 finding\n")
    served = []
    monkeypatch.setattr("tactiled.cli.run.serve", lambda *arguments: served.append(arguments))
    done = run("run", path)
    assert (done.exit_code, len(served)) == (0, 1), done.output
    assert done.stderr.startswith(f"tactiled: {line}")


def test_what_cannot_be_and_what_is_doubtful_are_told_at_once(palm):
    path = palm("thickness_mm = 1.2", "thickness_mm = 0.0012")
    path.write_text(path.read_text().replace("pitch_mm = 1.0", "pitch_mm = 0.001").replace("= 980.0", "= 980e6"))
    done = run("check", path)
    (doubt,) = done.stdout.splitlines()
    assert doubt.startswith("doubtful: sensor.palm.cover.thickness_mm = 0.0012: ")
    pitch, young = str(done.exception).splitlines()
    assert pitch.endswith("pitch_mm = 0.001: give 0.01 to 1000 mm; 1 mm if it was given in metres")
    assert young.endswith("young_mpa = 980000000.0: give 0.001 to 1e7 MPa; 980 MPa if it was given in Pa")
    path.write_text(path.read_text().replace("= 980e6", "= 980").replace("= 0.6", "= 0.0006"))
    done = run("check", path)
    assert done.stdout == f"{doubt}\n"
    assert "young_mpa = 0.0006: give 0.001 to 1e7 MPa; 0.6 MPa if it was given in GPa" in str(done.exception)


def test_only_values_of_the_file_are_called_doubtful(palm):
    path = palm("thickness_mm = 1.2", "thickness_mm = 2000")
    done = run("check", path)
    assert done.stdout == ""
    assert "thickness_mm = 2000: give " in str(done.exception)
    layers = "[[sensor.palm.cover]]\nthickness_mm = 0.5\nyoung_mpa = 0.6\n[[sensor.palm.cover]]\n"
    path = palm("[sensor.palm.cover]\n", layers)
    path.write_text(path.read_text().replace("young_mpa = 0.6\npoisson", "young_mpa = 6e-7\npoisson"))
    done = run("check", path)
    assert done.stdout == ""
    assert "cover[1].young_mpa = 6e-07: give " in str(done.exception)


def test_a_wrong_codec_or_bus_hides_nothing_that_is_doubtful(palm):
    path = palm("thickness_mm = 1.2", "thickness_mm = 0.0012")
    path.write_text(path.read_text().replace("base_id = 0x500", "base_id = 0x7fff"))
    done = run("check", path)
    assert done.stdout.startswith("doubtful: sensor.palm.cover.thickness_mm = 0.0012: ")
    assert "codec id 0x7fff (base_id + array_id) is past 0x7ff" in str(done.exception)
    path.write_text(path.read_text().replace("pitch_mm = 1.0", "pitch_mm = 0.001").replace('= "can0"', '= "can1"'))
    texts = str(run("check", path).exception).splitlines()
    assert all(each.startswith(f"{path}: ") for each in texts)
    for at, fault in enumerate(
        ("pitch_mm = 0.001: give", "sensor.palm.bus = 'can1': no such bus", "codec id 0x7fff")
    ):
        assert fault in texts[at]


def test_every_fault_of_a_file_is_named_at_once(palm):
    path = palm("base_id = 0x500", "base_id = 0x900")
    text = path.read_text().replace('method = "auto"', 'method = "best"')
    text = text.replace("no_load = 80", "no_load = 80\ndead = [99]")
    path.write_text(f'{text}\n[sensor.tip]\nbus = "can0"\ncodec = {{ name = "packd" }}\narray = {{ rows = 4 }}\n')
    texts = str(run("check", path).exception).splitlines()
    assert all(each.startswith(f"{path}: ") for each in texts)
    faults = "unknown codec 'packd'", "codec id 0x900", "dead names taxel 99", "method = 'best': no such method"
    assert [sum(fault in each for each in texts) for fault in faults] == [1] * 4
    path.write_text(text)
    assert [each in str(run("check", path).exception) for each in faults] == [False, True, True, True]


@pytest.mark.parametrize("text", ["", "[server]\n", "[sensors.palm]\n"])
def test_a_file_without_its_tables_is_refused_by_their_names(tmp_path, text):
    (path := tmp_path / "a.toml").write_text(text)
    for command in ("check", "run"):
        texts = str(run(command, path).exception).splitlines()
        assert {f"{path}: bus: missing", f"{path}: sensor: missing"} <= {*texts}


def test_no_fault_rests_on_a_value_that_is_wrong_itself(palm):
    path = palm("base_id = 0x500", "base_id = 0x30000000")
    path.write_text(path.read_text().replace("array_id = 0 ", "array_id = 20 "))
    texts = str(run("check", path).exception).splitlines()
    assert [each.partition("codec.")[2].partition(" = ")[0] for each in texts] == ["array_id", "base_id"]
    assert str(run("check", palm("pitch_mm = 1.0", "pitch_mm = -1.0")).exception).endswith("give 0.01 to 1000 mm")
    path = palm("pitch_mm = 1.0", "pitch_mm = inf")
    path.write_text(path.read_text().replace("= 32\n", "= 8\n"))
    assert not run("check", path).stdout  # of an aperture that is a point, at the highest pitch that may be given


def test_a_hint_and_a_file_as_it_is_written_end_a_check_well(palm):
    assert "doubtful" not in succeed("check", palm())
    output = succeed("check", palm("poisson = 0.48", "poisson = 0.3"))
    assert output.startswith("hint: sensor.palm.cover.poisson = 0.3: right for foam")
    assert output.endswith("palm.toml is valid: 1 sensor, 1 bus\n")


def test_a_bus_is_listened_to(palm, playing):
    playing({"interface": "virtual", "channel": CHANNEL}, Packed(64, 12, fd=True))
    done = run("check", palm("no_load = 80", "no_load = 1000"), "--bus", "--seconds", 1)
    assert done.exit_code == 1, done.output
    assert re.search(
        r"bus can0: \d+ messages in 1 s\n  palm: \d+\.\d frames a second, 0 messages lost", done.stdout
    )
    assert "  unknown id 0x6a1: " in done.stdout
    assert "no_load = 1000: half of the taxels read 60" in done.stdout


def test_a_silent_bus_is_doubtful_and_one_that_cannot_be_opened_an_error(palm):
    done = run("check", palm(), "--bus", "--seconds", 0.1)
    assert done.exit_code == 1
    assert "doubtful: bus.can0: no message in 0.1 s: nothing sends" in done.stdout
    done = run("check", palm('"virtual"', '"socketcan"'), "--bus", "--seconds", 0.1)
    assert str(done.exception).startswith(f"bus socketcan {CHANNEL}: ")


def test_error_frames_are_doubtful(palm, monkeypatch):
    monkeypatch.setattr("tactiled.cli.check.listen", lambda *_: ([], {"bus_error": 3, "rx_passive": 1}))
    done = run("check", palm(), "--bus")
    assert "doubtful: bus.can0: error frames: 3 bus_error, 1 rx_passive: check bit rate, wiring" in done.stdout
    assert done.stdout.endswith("palm.toml is doubtful: 2 findings\n")
