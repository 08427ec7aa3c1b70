"""A skin that a DBC file describes: bytes worked out by hand from bit positions, and every fault of its map."""

import struct
import sys

import numpy as np
import pytest

from tactiled.build import make_codec, sensor_plan, sensor_plans
from tactiled.bus.assembler import assemble
from tactiled.bus.codec import read_one
from tactiled.bus.codecs.dbc import Dbc, expand, numbered
from tactiled.calibrate.counts.means import Rails
from tactiled.config import load, parse
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import BAD, Message
from tactiled.geometry import grid
from tests.bus.skins import CODECS, CONFIG, DBC, GRID, payloads_of

PAGE = 0x18FF0065
FLOATS = Dbc(DBC, ("Floats.F1", "Floats.Offset", "Floats.F0"))
DOUBLE = Dbc(DBC, ("Doubles.D0",))


@pytest.mark.parametrize(
    ("codec", "message", "counts"),
    [
        (  # little-endian signals are the bits of one integer
            CODECS["dbc"],
            Message(0.0, 0x300, (0xABC | 0x123 << 12 | 0xFFF << 24).to_bytes(7, "little") + b"\x99"),
            [0xABC, 0x123, 0xFFF, 0, 0, 0],
        ),
        (  # DBC counts big-endian bits within a byte from the right: 3|12@0 is byte 0's low digit, then byte 1
            CODECS["dbc"],
            Message(0.0, 0x301, bytes.fromhex("0ABC12305670")),
            [0, 0, 0, 0xABC, 0x123, 0x056],
        ),
        # variants of a multiplexed message are segments of their own
        (CODECS["dbc-pages"], Message(0.0, PAGE, bytes.fromhex("0034127856"), True), [0, 0x1234, 0x5678]),
        (CODECS["dbc-pages"], Message(0.0, PAGE, bytes.fromhex("0112340000"), True), [0x1234, 0, 0]),
        (FLOATS, Message(0.0, 0x303, struct.pack("<ffh2x", 1.5, -2.25, -7), fd=True), [-2.25, -7.0, 1.5]),
    ],
)
def test_counts_of_golden_messages(codec, message, counts):
    decoded = codec.unpack(payloads_of(codec, [message]))
    assert (decoded.tolist(), decoded.dtype) == (counts, np.float32 if codec is FLOATS else np.uint16)
    if codec is FLOATS:
        assert codec.encode(decoded, 0, 0.0) == [message]


@pytest.mark.parametrize(
    ("codec", "message"),
    [
        ("dbc", Message(0.0, 0x300, bytes(7))),
        ("dbc", Message(0.0, 0x300, bytes(8), extended=True)),
        ("dbc", Message(0.0, 0x7FF, bytes(8))),
        ("dbc-pages", Message(0.0, PAGE, bytes.fromhex("0200000000"), True)),  # without taxels
        ("dbc-pages", Message(0.0, PAGE, bytes.fromhex("0900000000"), True)),  # unknown
    ],
)
def test_a_message_outside_the_map_is_refused(codec, message):
    with pytest.raises(CodecError):
        read_one(CODECS[codec], message)


@pytest.mark.parametrize(
    ("codec", "id_", "data", "counts", "flags"),
    [
        *(
            (FLOATS, 0x303, struct.pack("<ffh2x", number, -2.25, -7), [-2.25, -7.0, 0.0], [0, 0, BAD])
            for number in (float("nan"), float("inf"), -float("inf"))
        ),
        (DOUBLE, 0x305, struct.pack("<d", 1e300), [0.0], [BAD]),
        (DOUBLE, 0x305, struct.pack("<d", -1.1e9), [0.0], [BAD]),
        (DOUBLE, 0x305, struct.pack("<d", 2.0**29), [2.0**29], [0]),
    ],
)
def test_a_number_that_no_sensor_gives_makes_only_its_own_taxel_bad(codec, id_, data, counts, flags):
    (frame,), _ = assemble(codec, [Message(0.0, id_, data, fd=len(data) > 8)])
    assert (frame.counts.tolist(), frame.flags.tolist()) == (counts, flags)


@pytest.mark.parametrize(
    ("codec", "counts", "reason"),
    [
        (CODECS["dbc"], [0, 4096, 0, 0, 0, 0], "count 4096 of taxel 1: T0_1 carries 0 to 4095"),
        (FLOATS, [0, -32769, 0], "count -32769 of taxel 1: Offset carries -32768 to 32767"),
    ],
)
def test_a_count_that_does_not_fit_is_refused(codec, counts, reason):
    with pytest.raises(CodecError, match=reason):
        codec.encode(np.array(counts, np.float32), 0, 0.0)


ROWS = "rows = 2, columns = 3, pitch_mm = 4.0"
TEMPLATE = 'taxels = "Row{row}.T{row}_{column}"'


def sensor(folder, codec, array=ROWS, content=None):
    (folder / "skins").mkdir()
    (folder / "skins" / "skin.dbc").write_bytes(DBC.read_bytes() if content is None else content)
    (folder / "a.toml").write_text(CONFIG.format(codec=f'name = "dbc", {codec}', array=array))
    return load(folder / "a.toml").sensor["skin"]


@pytest.mark.parametrize(
    ("taxels", "array"),
    [
        (TEMPLATE, ROWS),
        ('taxels = "Row{message}.T{message}_{signal}"', ROWS),
        (f"taxels = {list(GRID)}", "positions_mm = [[0,0],[4,0],[8,0],[0,4],[4,4],[8,4]], aperture_mm = 3"),
    ],
)
def test_a_configuration_names_a_file_beside_it_and_its_taxels(tmp_path, monkeypatch, taxels, array):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    codec = make_codec(sensor(tmp_path, f'file = "skins/skin.dbc", {taxels}', array))
    counts = np.array([1, 2, 3, 4, 5, 6], np.uint16)
    assert codec.encode(counts, 0, 0.0) == CODECS["dbc"].encode(counts, 0, 0.0)


@pytest.mark.parametrize(
    ("signals", "ends"),
    [
        (GRID, (0, 4095)),
        (["Floats.Offset"], (-32768, 32767)),
        (["Floats.F0"], (-np.inf, np.inf)),
        (["Wide.W0"], (-np.inf, np.inf)),  # 24 bits
        (["Row0.T0_0", "Row0.Counter"], (-np.inf, np.inf)),  # 12 and 8 bits
    ],
)
def test_only_narrow_signals_of_one_size_have_a_ceiling(signals, ends):
    codec = Dbc(DBC, signals)
    assert codec.ends == ends
    assert Rails.of(None, codec.ends) == Rails(*ends)


def test_a_template_may_count_from_1_and_pad():
    assert expand("Row{row}.T{column:02}", (1, 2), 2, 1) == ("Row1.T01", "Row1.T02")
    assert expand("M.T{taxel}", None, 3, 0) == ("M.T0", "M.T1", "M.T2")


def test_a_template_may_number_messages_that_hold_unequal_counts_of_taxels():
    line, names = grid(1, 5, 1.0), ("M1.T1", "M1.T2", "M2.T3", "M2.T4", "M3.T5")
    assert numbered("M{message}.T{taxel}", line, 1, names) == names
    names = ("M0.S0", "M0.S1", "M1.S0", "M1.S1", "M2.S0")
    assert numbered("M{message}.S{signal}", line, 0, names) == names
    assert numbered("M0.S{taxel}", grid(1, 2, 1.0), 0, names) == names[:2]


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (f'file = "nope.dbc", {TEMPLATE}', r"codec.file = '.*nope.dbc': No such file"),
        ('taxels = "Row{row}.T{row}_{col}"',
         r"'Row\{row\}.T\{row\}_\{col\}': 'col': a template may hold \{taxel\}, \{row\}, \{column\}, "
         r"\{message\}, \{signal\}"),
        (f"{TEMPLATE}, first = 1", r"names 'Row1.T1_3': skin.dbc has no such signal: did you mean Row"),
        ('taxels = "Row{message}.T{message}_{column}", first = 1', "file has no Row2.T2_3: it has names for 2"),
        ('taxels = "Row{message}.T0_0"', "the file has no Row1.T0_0: it has names for 1 of 6 taxels"),
        ('taxels = ["@"]', "names '@': skin.dbc has no such signal: it has 23 signals"),
        ('taxels = ["Row0.T0_0", "Row0.T0_0"]', "names Row0.T0_0 twice"),
        ('taxels = ["Pages.Page"]', "Pages.Page, which comes with several variants"),
        ('taxels = ["Nested.Always"]', "Nested.Always, which comes with several"),
        ('taxels = ["Nested.Deep"]', "Nested.Deep, which comes with several"),
        ('taxels = ["Long.L0"]', "names Long.L0: the message has 100 bytes, and CAN FD carries 64"),
        ('file = "skins/skin.dbc"', r"a.toml: sensor.skin.codec.taxels: missing"),
        (f"taxels = {list(GRID[:5])}", "the codec carries 5 taxels and the array has 6"),
    ],
)  # fmt: skip
def test_every_fault_of_the_map_is_named(tmp_path, settings, reason):
    settings = settings if "file" in settings else f'file = "skins/skin.dbc", {settings}'
    with pytest.raises(ConfigError, match=reason):
        sensor_plan("skin", sensor(tmp_path, settings))


def test_messages_of_can_fd_need_a_bus_for_them():
    codec = f'name = "dbc", file = "{DBC}", taxels = ["Floats.F0", "Floats.F1"]'
    text = CONFIG.format(codec=codec, array="rows = 1, columns = 2, pitch_mm = 4").replace("virtual", "socketcan")
    with pytest.raises(ConfigError, match=r"skin.codec: message 0x303 has 12 bytes, and bus can0 is not CAN FD"):
        sensor_plans(parse(text))
    assert sensor_plans(parse(text.replace('"socketcan"', '"socketcan"\nfd = true')))


@pytest.mark.parametrize("content", [b"", b"\xff\x00garbage", b'VERSION ""\nBO_ 1 A: 8 X\n SG_ B : 60|12@1+'])
def test_a_file_of_another_format_is_named(tmp_path, content):
    with pytest.raises(ConfigError, match=r"skin\.dbc"):
        make_codec(sensor(tmp_path, f'file = "skins/skin.dbc", {TEMPLATE}', content=content))


def test_without_cantools_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cantools", None)
    with pytest.raises(ConfigError, match=r"needs cantools: pip install 'tactiled\[dbc\]'"):
        Dbc(DBC, GRID)
