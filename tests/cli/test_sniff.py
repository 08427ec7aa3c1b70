import pytest

from tactiled.build import make_array, make_codec, sensor_plans
from tactiled.bus import recording
from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.sniff import survey
from tactiled.cli.sniff import configuration, report
from tactiled.config import load, parse
from tactiled.frames import Message
from tests.bus.skins import CODECS, traffic
from tests.cli.commands import refusal, succeed


def test_a_bus_is_listened_to_and_a_configuration_written(tmp_path, playing, multicast):
    bus, path = {"interface": "udp_multicast", "channel": multicast}, tmp_path / "a.toml"
    playing(bus, Packed(64, 12, fd=True, array_id=2), Icub(3, (1, 4)))
    output = succeed(
        "sniff", "--interface", "udp_multicast", "--channel", multicast, "--seconds", 0.8, "--write", path
    )
    for line in (
        "packed layout, CAN FD, array 2 at 0x500, 12 bits a taxel: 64 taxels, 2 messages a frame on id",
        "iCub MTB, class 0x400, board 3, triangles 1, 4: 20 taxels, 4 messages a frame on ids 0x431 to",
        "unknown id 0x6a1: ",
        "wrote ",
    ):
        assert line in output
    plans = {plan.name: plan for plan in sensor_plans(load(path))}
    assert plans["packed1"].codec == Packed(64, 12, fd=True, array_id=2)
    assert plans["packed1"].calibration.no_load == 60
    assert plans["icub1"].codec == Icub(3, (1, 4))
    assert plans["icub1"].calibration.kpa_per_count == -1
    assert load(path).bus.popitem()[1].settings() == bus


def test_a_bus_of_a_file_without_sensors_is_listened_to_and_recorded(tmp_path, request, playing):
    bus = {"interface": "virtual", "channel": request.node.name}
    file = tmp_path / "bus.toml"
    file.write_text(
        f'[bus.other]\ninterface = "virtual"\n[bus.mine]\n{chr(10).join(f"{k} = {v!r}" for k, v in bus.items())}\n'
    )
    playing(bus, Packed(64, 12))
    of_file = ("--config", file, "--bus", "mine", "--seconds", 0.8)
    assert "packed layout, classic, " in succeed("sniff", *of_file)
    assert "recording to " in succeed("record", tmp_path / "a.log", *of_file)


SKINS = (
    "barrett", "cyskin", "linker", "linker-o6", "linker-g20-5", "linker-o20", "linker_l30", "omnihand", "poweron",
    "xela", "xela-4x6-old",
)  # fmt: skip


@pytest.mark.parametrize(
    "codec", [Packed(100, 10, base_id=0x18000000, extended=True), Icub(3, (0, 2)), *map(CODECS.get, SKINS)]
)
def test_a_written_configuration_makes_the_codec_that_was_recognised(codec):
    text = configuration(survey(traffic(codec, 30)), {"interface": "virtual", "channel": "a b"})
    (sensor,) = parse(text).sensor.values()
    assert make_codec(sensor) == codec
    assert make_array(sensor).size == codec.size
    gain = -0.05 if isinstance(codec, Icub) else 0.05  # an iCub's counts fall under pressure
    assert f"# kpa_per_count = {gain}  # EDIT" in text
    assert "base_id" not in text or f"base_id = {codec.base_id:#x}" in text


def test_two_of_a_kind_have_names_of_their_own():
    result = survey([*traffic(Packed(64, 12)), *traffic(Packed(64, 12, array_id=3))])
    assert list(parse(configuration(result, {"interface": "virtual"})).sensor) == ["packed1", "packed2"]


def test_a_recording_is_looked_into_and_a_configuration_written(tmp_path):
    path, written = tmp_path / "a.log", tmp_path / "a.toml"
    path.write_bytes(recording.path("book_1").read_bytes() + b"(9.0) can0 20000004#0001\n")
    lines = succeed("sniff", path, "--write", written).splitlines()
    assert lines[0].startswith("150 messages (left out: 1 error frame) in ")
    assert lines[1].startswith("iCub MTB, class 0x400, board 14, triangles 0, 1, 2, 3, 4: 50 taxels, 10 messages")
    assert lines[2].startswith("  thermal_pads: false where")
    (sensor,) = load(written).sensor.values()
    assert make_codec(sensor) == Icub(14, (0, 1, 2, 3, 4))
    with path.open("a") as file:
        file.write("(9.0) can1 4E0#00\n")
    assert "id 0x4e0 comes from can0 and from can1, and their frames would mix: keep one" in refusal("sniff", path)
    assert "no bus is opened" in refusal("sniff", path, "--interface", "slcan")


def test_many_unknown_ids_are_cut_short():
    lines = report(survey(Message(n / 10, n % 20, b"") for n in range(200)), "200 messages in 3 s")
    assert lines[1].startswith("no known skin: some are silent until")
    assert len(lines) == 2 + 8 + 2
    assert lines[-2] == "and 12 unknown ids more"
    assert lines[-1].startswith('if a skin sends these: codec.name = "dbc" reads what a DBC file describes')


def test_a_refusal_is_one_line_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text("mine")
    silent = "--interface virtual --channel sniffed --seconds 0.1"
    for arguments, reason in (
        (f"{silent} --write a.toml", "a.toml is there already"),
        (f"{silent} --write b.toml", "no known skin sends on this bus: nothing to write"),
        ("--interface nope", "python-can has no interface of that name"),
        ("--channel gone7", "bus socketcan gone7: "),
    ):
        assert reason in refusal("sniff", *arguments.split())
    assert [each.read_text() for each in tmp_path.iterdir()] == ["mine"]
