"""Settings that another package defines: what may be printed of them."""

import datetime

import pytest

from tactiled.bus.reader import open_bus
from tactiled.bus.redact import HARMLESS, redactor, reveal, seal, show
from tactiled.config import parse
from tactiled.errors import BusError, ConfigError

SETTINGS = {
    "interface": "slcan",
    "channel": "socket://palm:hush-login@adapter:1/port?pin=hush-query#hush-end",
    "tty_baudrate": 115200,
    "fd": True,
    "password": "hush-password",
    "nobody_knows": "hush-unknown",
    "dongle_pin": 123456,
    "pinky": 5,
    "when": datetime.date(2020, 1, 1),
    "auth": {"number": 987654},
    "nodes": [{"user": "hush-user", "id": 3}, "hush-listed"],
}


def test_of_settings_numbers_booleans_and_what_is_declared_harmless_are_shown_and_nothing_else():
    sealed = seal(SETTINGS, HARMLESS)
    assert show(sealed) == {
        "interface": "slcan",
        "channel": "socket://adapter:1/port",
        "tty_baudrate": 115200,
        "fd": True,
        "password": "hidden",
        "nobody_knows": "hidden",
        "dongle_pin": "hidden",
        "pinky": 5,
        "when": "hidden",
        "auth": "hidden",
        "nodes": [{"user": "hidden", "id": 3}, "hidden"],
    }
    assert "hush" not in f"{sealed!r} {sealed} {sealed['channel']} {sealed['password']!r:>10}"
    assert reveal(sealed) == SETTINGS
    assert seal(sealed, HARMLESS) == sealed


@pytest.mark.parametrize(
    ("address", "printed"),
    [
        ("can0", "can0"),
        ("/dev/ttyUSB0@115200", "/dev/ttyUSB0@115200"),
        (r"\\.\COM10", r"\\.\COM10"),
        ("239.74.163.2", "239.74.163.2"),
        ("ff15:7079:7468:6f6e:6465:6d6f:6d63:6173", "ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"),
        ("rfc2217://adapter:2217", "rfc2217://adapter:2217"),
        ("ws://u:hush@h@[::1]:3/x?hush", "ws://[::1]:3/x"),
        ("ws://palm:12#hush@elsewhere:1", "hidden"),  # where its login ends, nobody can say
        ("ws://palm:12/hush@elsewhere:1", "hidden"),
        ("ws://palm:hush", "hidden"),
        ("palm:hush@elsewhere", "hidden"),
        ("adapter:80?token=hush", "hidden"),
    ],
)
def test_of_an_address_scheme_host_port_and_path_are_shown(address, printed):
    assert show(seal({"channel": address}, HARMLESS)) == {"channel": printed}


@pytest.mark.parametrize(
    "text",
    [
        "could not open {channel!r}: no answer",
        "login palm:hush-login was refused",
        "wrong password HUSH-PASSWORD",
        "bad query pin=hush-query",
        "{nodes} and {auth}",
        "code 123456 or 987654",
    ],
)
def test_what_python_can_says_of_a_secret_is_replaced(monkeypatch, text):
    text = text.format(**SETTINGS)

    def fail(**settings):
        assert settings == SETTINGS
        raise OSError(text)

    monkeypatch.setattr("tactiled.bus.reader.Bus", fail)
    with pytest.raises(BusError) as caught:
        open_bus(**SETTINGS)
    assert str(caught.value).startswith("bus slcan socket://adapter:1/port: ")
    for secret in ("hush", "123456", "987654"):
        assert secret not in str(caught.value).lower()
    short = redactor(seal({"password": "an", "empty": ""}))  # replaced only as a word
    assert short("can says an error") == "can says hidden error"


@pytest.mark.parametrize(
    "spoilt",
    [
        'bus.can0 = "ws://palm:hush@elsewhere"',
        'bus.can0 = { interface = "virtual", channel = ["ws://palm:hush@elsewhere"] }',
        'bus.can0 = { interface = { token = "hush" } }',
        'server = [{ read_token = "hush" }]',
        'server = { read_token = "hush" }',
        'server = { host = { read_token = "hush" } }',
    ],
)
def test_a_fault_of_the_file_is_reported_without_secrets(spoilt):
    with pytest.raises(ConfigError) as caught:
        parse(spoilt)
    assert "hush" not in str(caught.value)
    assert spoilt.split(" ", 1)[0] in str(caught.value)
