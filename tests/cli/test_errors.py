"""Errors as a user sees them: one line, exit code 2, no traceback."""

import socket
import subprocess

import pytest

from tactiled.cli.demo import demo_config
from tactiled.config import load
from tactiled.config.example import EXAMPLE
from tests.cli.commands import TACTILED, refusal, succeed

VIRTUAL = EXAMPLE.replace("port = 8000", "port = 0").replace('"socketcan"', '"virtual"')


@pytest.fixture
def config(tmp_path):
    def write(old, new, text=EXAMPLE):
        assert old in text
        path = tmp_path / "a.toml"
        path.write_text(text.replace(old, new, 1))
        return path

    return write


def test_a_refusal_is_one_line_and_exit_code_2(config):
    path = config("port = 8000", "prot = 8000")
    done = subprocess.run([*TACTILED, "check", str(path)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr == f"tactiled: {path}: server.prot: unknown key: did you mean port?\n"


def test_a_wrong_option_is_one_line_with_its_value_and_no_verb_prints_the_help():
    for words, message in (
        ("demo --rate-hz 0", "--rate-hz 0: must be greater than or equal to 0.1"),
        ("export --workers=none a.log", "--workers none: must be a valid integer"),
        ("demo --rate", "No such option: --rate (Possible options: --port, --rate-hz)"),
        ("record", "Missing argument out"),
        ("bench load --sensors nix", "--sensors nix: must be a valid integer"),
        ("recrod a.log", "No such command 'recrod'. Did you mean 'record'?"),
    ):
        assert refusal(*words.split()).startswith(message), words
    for verbs in ([], ["bench"]):
        done = subprocess.run([*TACTILED, *verbs], capture_output=True, text=True, timeout=60)
        assert (done.returncode, "Commands:" in done.stderr) == (2, True)


@pytest.mark.parametrize("verb", ["check", "run"])
def test_check_and_run_refuse_the_same(tmp_path, config, verb):
    bad = tmp_path / "bad"
    bad.write_text("[" * 100_000)
    for old, new, text, message in (
        ("rows = 32", "rows = 500", EXAMPLE, "sensor.palm: 16000 taxels of 12 bits need 391 messages a frame"),
        ('method = "auto"', 'method = "sharpen"', EXAMPLE,
         "sensor.palm: method = 'sharpen': no such method: choose one of"),
        ("# dead = [17, 301]", "dead = [2000]", EXAMPLE,
         "sensor.palm: dead names taxel 2000: the array has 0 to 1023"),
        ("port = 0", f'port = 0\nstate = "{bad}"', VIRTUAL, f"state {bad}: "),
        ("port = 0", f'port = 0\ntls_certificate = "{bad}"\ntls_key = "{bad}"', VIRTUAL, f"{bad}, {bad}: "),
        ("port = 0", 'port = 0\ntls_certificate = "/gone"\ntls_key = "/gone"', VIRTUAL,
         "/gone: No such file or directory: give the PEM files"),
        ("port = 0", f'port = 0\ntls_certificate = "{bad}"\ntls_key = "/{bad.name * 100}"', VIRTUAL,
         ": File name too long: give the PEM files"),
    ):  # fmt: skip
        assert message in refusal(verb, config(old, new, text))
    message = refusal(verb, "nowhere.toml")
    assert message.startswith("nowhere.toml: No such file or directory: give the path of a config")


def test_wrong_arguments_of_demo_are_refused():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        message = refusal("demo", "--port", port, "--scene", "flood")  # before what takes long
    assert message == f"address 127.0.0.1:{port}: in use: choose another port, or 0 for any free one"
    for arguments, message in (
        ("--scene flood", "scene = 'flood': no such scene: choose tour or one of ring"),
        ("--recording flood", "recording 'flood': no such recording"),
        ("--recording book_1 --shear", "--shear: recording book_1 has none"),
    ):
        assert message in refusal("demo", *arguments.split())


def test_init_writes_a_valid_configuration_and_never_overwrites(tmp_path):
    path = tmp_path / "b.toml"
    succeed("init", path)
    output = succeed("check", path)
    for line in ("gain at the taxel Nyquist", "smallest resolvable gap", "is valid: 1 sensor, 1 bus"):
        assert line in output
    succeed("init", demo := tmp_path / "d.toml", "--skin", "demo")
    assert load(demo).sensor == demo_config().sensor
    assert "b.toml is there already" in refusal("init", path)
    assert "--positions p.ini: needs --from-icub" in refusal("init", tmp_path / "c.toml", "--positions", "p.ini")
    assert "--skin icub: no such skin: choose one of agibot-omnihand, " in refusal("init", path, "--skin", "icub")
    assert "leave one of them out" in refusal("init", path, "--skin", "cyskin", "--from-icub", "no.xml")
    assert "no.xml: No such file" in refusal("init", tmp_path / "c.toml", "--from-icub", "no.xml")
