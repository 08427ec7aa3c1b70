import pytest

from tactiled.build import make_array, make_codec
from tactiled.bus import skins
from tactiled.config import load, parse, ready
from tactiled.config.example import EXAMPLE
from tactiled.errors import ConfigError
from tactiled.plausibility.settings import unedited

COVER = "sensor.palm.cover"


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ("port = 8000", "prt = 8000", "server.prt: unknown key: did you mean port?"),
        ("thickness_mm", "thickness_um", COVER + ".thickness_um: unknown key: did you mean thickness_mm?"),
        ("thickness_mm", "thickness", COVER + ".thickness: unknown key: did you mean thickness_mm?"),
        ("thickness_mm = 1.2", "", COVER + ".thickness_mm: missing"),
        ("thickness_mm = 1.2", 'thickness_mm = "1.2 mm"', COVER + ".thickness_mm = '1.2 mm': "),
        ("young_mpa = 0.6", "young_mpa = nan", COVER + ".young_mpa = nan: give 0.001 to 1e7 MPa"),
        ("poisson = 0.48", "poisson = 0.5", COVER + ".poisson = 0.5: give 0 to 0.49999"),
        ("id = 0x500", "id = 0x20000000", "sensor.palm.codec.base_id = 0x20000000: give 0x0 to 0x1ffffff0"),
        ("bits = 12 ", "bits = 20 ", "sensor.palm.codec.bits = 20: give 8 to 16"),
        ("bits = 12 ", 'bits = "12" ', "sensor.palm.codec.bits = '12': Input should be a valid integer"),
        ("young_mpa = 0.6", "young_mpa = true", COVER + ".young_mpa = True: Input should be a valid number"),
        ('name = "packed"', 'name = "pakt"', "sensor.palm.codec: unknown codec 'pakt'; available: barrett, "),
        ('name = "packed"', "", "sensor.palm.codec.name: missing"),
        ('bus = "can0"', 'bus = "can1"', "sensor.palm.bus = 'can1': no such bus: the file has can0"),
        ("refine = 1 ", "refine = 0 ", "sensor.palm.refine = 0: "),
        ("port = 8000", 'xela_host = "::"', "server: xela_host = '::' without xela: give the port, too"),
        ("port = 8000", "xela = 70000", "server.xela = 70000: "),
        ("port = 8000", "xela = 8000", "server: port and xela are both 8000: give each a port of its own"),
        ("port = 8000", 'xela = 9\nxela_host = "0.0.0.0"\nfoxglove = 9', "server: foxglove and xela are both 9: "),
        ("pitch_mm = 1.0", "pitch_mm = 1.0\norigin_mm = [1, 2, 3]",
         "sensor.palm.array: origin_mm = [1.0, 2.0, 3.0] without frame_id: give the frame of reference, too"),
        ("pitch_mm = 1.0", 'pitch_mm = 1.0\nframe_id = "hand"\norientation = [0, 0, 0.7, 0.7]',
         "sensor.palm.array.orientation: [0.0, 0.0, 0.7, 0.7] has the norm 0.989949: give a unit quaternion"),
        ("pitch_mm = 1.0", 'pitch_mm = 1.0\nframe_id = "/hand"',
         "sensor.palm.array.frame_id = '/hand': give 1 to 128 ASCII letters, digits, _ . / or -, a letter, digit"),
        ("[bus.can0]", '[bus."can 0"]',
         "bus: name 'can 0': give 1 to 64 ASCII letters, digits, _ or -, a letter or digit first"),
        ('bus = "can0"', 'bus = "c\u00e4n"', "sensor.palm.bus = 'c\u00e4n': give 1 to 64 ASCII letters, "),
        ("port = 8000", 'port = 8000\n[zenoh]\nconnect = ["tcp:1"]',
         "zenoh.connect[0] = 'tcp:1': give tcp, tls, quic, udp or ws, then /ADDRESS:PORT, such as tcp/"),
        ("port = 8000", 'port = 8000\n[zenoh]\nlisten = ["tcp/[::1]:7447"]\nprefix = "a b"',
         "zenoh.prefix = 'a b': give ASCII letters, digits, _ or -, in parts with / between"),
        ("port = 8000", 'port = 8000\n[zenoh]\nlisten = ["tcp/[::1]:7447"]\ncontrol_key = "hunter2hunter2hunter2"',
         "zenoh.control_key: give 64 of the digits 0-9 and a-f, as `openssl rand -hex 32` prints them"),
        ("accuracy = ", "no_load = 1\naccuracy = ",
         "sensor.palm.kernel.no_load: unknown key: did you mean calibration.no_load or codec.no_load?"),
        ("port = 8000", "rows = 8", "server.rows: unknown key: did you mean array.rows or codec.rows?"),
        ("port = 8000", "thickness_mm = 8", "server.thickness_mm: unknown key: did you mean cover.thickness_mm?"),
        ("accuracy = ", 'method = "auto"\naccuracy = ',
         "sensor.palm.kernel.method: unknown key: did you mean sensor.method?"),
        ("fd = true\n\n", "\n", "sensor.palm.codec.fd = true: bus can0 is not CAN FD: set bus.can0.fd = true"),
        ('host = "127.0.0.1"', 'host = "0.0.0.0"', "server: other machines could reach it: give control_token"),
        ("port = 8000", 'control_token = "secret"',
         "server.control_token: Value should have at least 16 characters, not 6"),
        ('"socketcan"', '"soketcan"',
         "bus.can0.interface = 'soketcan': python-can has no interface of that name: choose one of canalystii, "),
    ],
)  # fmt: skip
def test_a_fault_is_named_with_its_place_and_its_value(old, new, line):
    assert EXAMPLE.count(old) >= 1
    with pytest.raises(ConfigError) as caught:
        parse(EXAMPLE.replace(old, new, 1), "a.toml")
    assert f"a.toml: {line}" in str(caught.value)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (("port = 8000", "prt = 8000"), ("poisson = 0.48", "poisson = 0.7")),
        (('"socketcan"', '"soketcan"'), ('bus = "can0"', 'bus = "can1"')),
    ],
)
def test_all_faults_are_reported_at_once(one, other):
    with pytest.raises(ConfigError) as caught:
        parse(EXAMPLE.replace(*one).replace(*other))
    assert len(str(caught.value).splitlines()) == 2


def test_two_sensors_of_one_name_in_ros_are_an_error_where_ros_is_used():
    one = EXAMPLE[EXAMPLE.index("[sensor.palm]") :]
    text = EXAMPLE.replace("sensor.palm", "sensor.left-palm") + one.replace("sensor.palm", "sensor.left_palm")
    assert len(parse(text).sensor) == 2
    with pytest.raises(ConfigError, match=r"sensor.left-palm and sensor.left_palm: both are left_palm in ROS 2"):
        parse(f'{text}\n[zenoh]\nlisten = ["tcp/127.0.0.1:7447"]\nros_domain = 0\n')


@pytest.mark.parametrize("name", ready.READY)
def test_the_configuration_of_every_skin_is_complete_and_doubtful_until_it_is_edited(name):
    text = ready.configuration(name)
    (sensor,) = parse(text).sensor.values()
    array = make_array(sensor)
    assert make_codec(sensor).size == array.size
    assert sensor.refine == (2 if array.shape and array.size <= 64 else None)  # a picture, not 24 squares
    assert len(unedited(text)) >= 1 + (name != "pushed")


def test_every_skin_with_messages_of_its_own_has_a_configuration():
    named = {parse(ready.configuration(each)).sensor["skin"].codec.name for each in ready.READY}
    assert named == {*skins.BUILT_IN} - {"dbc", "packed"}  # which describe any array


def test_a_sensor_without_bus_and_codec_has_a_bus_of_its_own():
    at = EXAMPLE.index("[sensor.palm.codec]"), EXAMPLE.index("[sensor.palm.array]")
    text = EXAMPLE[: at[0]].replace('bus = "can0"', "") + EXAMPLE[at[1] :]
    config = parse(text)
    assert (config.sensor["palm"].bus, config.sensor["palm"].codec.name) == ("palm", "pushed")
    assert config.bus["palm"].settings()["interface"] == "virtual"
    assert "can0" in config.bus
    with pytest.raises(
        ConfigError, match=r"sensor\.palm: without bus and codec its frames are pushed: rename bus"
    ):
        parse(text.replace("bus.can0", "bus.palm"))
    with pytest.raises(ConfigError, match=r"sensor\.palm\.codec: missing"):
        parse(EXAMPLE[: at[0]] + EXAMPLE[at[1] :])


LAYER = "thickness_mm = 1.2\nyoung_mpa = 0.6\npoisson = 0.48\n"
COVER_TABLE = f"[sensor.palm.cover]\n{LAYER}"


def test_a_cover_may_be_a_list_of_layers_but_not_of_none():
    layers = f"[{COVER_TABLE}".replace("cover]", "cover]]")
    text = EXAMPLE.replace(COVER_TABLE, layers + layers.replace("1.2", "0.1"))
    assert [layer.thickness_mm for layer in parse(text).sensor["palm"].cover] == [1.2, 0.1]
    with pytest.raises(ConfigError, match=r"sensor\.palm\.cover\[0\]\.thickness_mm = -1\.2: "):
        parse(text.replace("1.2", "-1.2", 1))
    text = EXAMPLE.replace(COVER_TABLE, "").replace("\nmethod", "\ncover = []\nmethod")
    with pytest.raises(ConfigError, match=r"sensor\.palm\.cover = \[\]: give at least one layer"):
        parse(text)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "No such file"), (b"port = ", "not TOML"), (b"\xff", "not UTF-8 text at byte 0")],
)
def test_an_unreadable_file_is_named(tmp_path, content, message):
    path = tmp_path / "skin.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=f"{path}: {message}"):
        load(path)
