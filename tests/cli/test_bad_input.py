import socket
import subprocess
import sys

import pytest

from tactiled.config.example import EXAMPLE


def tactiled(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "tactiled", *arguments], capture_output=True, text=True, timeout=60
    )


def refused(done, says):
    """One line for each fault, exit code 2, no traceback."""
    assert done.returncode == 2, done
    assert "Traceback" not in done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert says in lines[0]


@pytest.fixture
def config(tmp_path):
    def write(old, new):
        assert old in EXAMPLE
        path = tmp_path / "a.toml"
        path.write_text(EXAMPLE.replace(old, new, 1))
        return str(path)

    return write


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("port = 8000", "prot = 8000", "server.prot: unknown key: did you mean port?"),
        ("fd = true\n\n", "\n", "sensor.palm.codec.fd = true: bus can0 is not CAN FD: set bus.can0.fd = true"),
        (
            "rows = 32",
            "rows = 500",
            "sensor.palm: 16000 taxels of 12 bits need 391 messages a frame",
        ),
        ("young_mpa = 0.6", "young_mpa = nan", "cover[0].young_mpa = nan: give 0.001 to 1e7 MPa"),
        ("poisson = 0.48", "poisson = 0.5", "cover[0].poisson = 0.5: give 0 to 0.49999"),
        ("poisson = 0.48", "poisson = 0.7", "cover[0].poisson = 0.7: give 0 to 0.49999"),
        (
            'method = "auto"',
            'method = "sharpen"',
            "sensor.palm: method = 'sharpen': no such method: choose one of",
        ),
        (
            "# dead = [17, 301]",
            "dead = [2000]",
            "sensor.palm: dead names taxel 2000: the array has 0 to 1023",
        ),
    ],
)
@pytest.mark.parametrize("verb", ["check", "run"])
def test_a_wrong_configuration(config, verb, old, new, says):
    refused(tactiled(verb, config(old, new)), says)


@pytest.mark.parametrize("key", ["state", "tls"])
@pytest.mark.parametrize("verb", ["check", "run"])
def test_a_file_that_the_start_needs_and_that_is_none(tmp_path, verb, key):
    bad, path = tmp_path / "bad", tmp_path / "a.toml"
    bad.write_text("[" * 100_000)
    line = f'state = "{bad}"' if key == "state" else f'tls_certificate = "{bad}"\ntls_key = "{bad}"'
    text = EXAMPLE.replace("port = 8000", f"port = 0\n{line}").replace('"socketcan"', '"virtual"')
    path.write_text(text)
    refused(tactiled(verb, str(path)), f"state {bad}: " if key == "state" else f"{bad}, {bad}: ")


@pytest.mark.parametrize("verb", ["check", "run"])
def test_a_file_that_is_not_there(verb):
    refused(tactiled(verb, "nowhere.toml"), "nowhere.toml: No such file or directory: give the path of a config")


def test_an_interface_that_is_not_there(config):
    path = config('channel = "can0"', 'channel = "nocan7"')
    refused(tactiled("run", path), "bus socketcan nocan7: ")


def test_a_port_in_use():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused(tactiled("demo", "--port", str(port)), f"address 127.0.0.1:{port}: in use: choose another port")


def test_a_scene_and_a_recording_that_are_not_there():
    refused(tactiled("demo", "--scene", "flood"), "scene = 'flood': no such scene: choose tour or one of ring")
    refused(tactiled("demo", "--recording", "flood"), "flood")
    refused(tactiled("demo", "--recording", "book_1", "--shear"), "--shear: recording book_1 has none")


def test_init_writes_what_check_finds_right_and_never_overwrites(tmp_path):
    path = str(tmp_path / "b.toml")
    assert tactiled("init", path).returncode == 0
    done = tactiled("check", path)
    assert done.returncode == 0, done.stderr
    for line in ("gain at the taxel Nyquist", "smallest resolvable gap", "is valid: 1 sensor, 1 bus"):
        assert line in done.stdout
    refused(tactiled("init", path), "b.toml is there already")
