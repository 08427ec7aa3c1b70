"""A skin told by a DBC file: bytes worked out by hand from its bit positions, and every fault of its map."""

import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.build import make_codec
from tactiled.bus.assemble import Assembler
from tactiled.bus.codecs.dbc import Dbc, expand
from tactiled.config import load
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import BAD, MISSING, Loss, Message
from tactiled.simulate.array import Taxels

FILE = Path(__file__).parent / "skin.dbc"
GRID = expand("Row{row}.T{row}_{column}", (2, 3), 6, 0)
PAGES = ("Pages.P2", "Pages.P0", "Pages.P1")
FLOATS = ("Floats.F1", "Floats.Offset", "Floats.F0")
CODECS = {"grid": Dbc(FILE, GRID), "pages": Dbc(FILE, PAGES), "floats": Dbc(FILE, FLOATS)}
PAGE = 0x18FF0065


def counts(codec, *messages):
    payloads = [None] * codec.segments
    for message in messages:
        reading = codec.decode(message)
        payloads[reading.segment] = reading.payload
    return codec.unpack(payloads).tolist()


def test_little_endian_signals_are_the_bits_of_one_integer():
    value = 0xABC | 0x123 << 12 | 0xFFF << 24
    row = Message(0.0, 0x300, value.to_bytes(7, "little") + b"\x99")
    assert counts(CODECS["grid"], row) == [0xABC, 0x123, 0xFFF, 0, 0, 0]


def test_big_endian_signals_run_on_from_byte_to_byte():
    """DBC counts bits within a byte from the right: 3|12@0 is the low digit of byte 0, then byte 1."""
    row = Message(0.0, 0x301, bytes.fromhex("0ABC12305670"))
    assert counts(CODECS["grid"], row) == [0, 0, 0, 0xABC, 0x123, 0x056]


def test_variants_of_a_multiplexed_message_are_segments_of_their_own():
    codec = CODECS["pages"]
    assert (codec.ids, codec.segments) == ({(PAGE, True)}, 2)
    zero, one = (Message(0.0, PAGE, bytes.fromhex(each), True) for each in ("0034127856", "0112340000"))
    assert counts(codec, zero) == [0, 0x1234, 0x5678]
    assert counts(codec, one) == [0x1234, 0, 0]
    for page in ("0200000000", "0900000000"):  # without taxels; unknown
        with pytest.raises(CodecError):
            codec.decode(Message(0.0, PAGE, bytes.fromhex(page), True))


def test_floats_and_signs_are_counted_as_floats():
    message = Message(0.0, 0x303, struct.pack("<ffh2x", 1.5, -2.25, -7), fd=True)
    codec = CODECS["floats"]
    assert counts(codec, message) == [-2.25, -7.0, 1.5]
    assert codec.unpack([None]).dtype == np.float32
    assert CODECS["grid"].unpack([None, None]).dtype == np.uint16


@pytest.mark.parametrize("worst", [float("nan"), float("inf"), -float("inf")])
def test_a_float_that_is_no_number_makes_its_taxel_bad_and_no_other(worst):
    codec = CODECS["floats"]
    message = Message(0.0, 0x303, struct.pack("<ffh2x", worst, -2.25, -7), fd=True)
    (frame,) = Assembler(codec).push(codec.decode(message))
    assert frame.flags.tolist() == [0, 0, BAD]
    assert frame.counts.tolist() == [-2.25, -7.0, 0.0]


def test_a_double_past_float32_makes_its_taxel_bad():
    codec = Dbc(FILE, ("Doubles.D0",))
    assert codec.decode(Message(0.0, 0x305, struct.pack("<d", 1e300))).bad == (0,)
    assert codec.decode(Message(0.0, 0x305, struct.pack("<d", 1e30))).bad == ()


@pytest.mark.parametrize("name", CODECS)
@given(seed=st.integers(0, 2**32 - 1))
def test_decode_inverts_encode_over_the_whole_range(name, seed):
    codec = CODECS[name]
    random = np.random.default_rng(seed)
    if name == "floats":
        sent = np.array([random.normal(0, 1e4), random.integers(-32768, 32768), random.normal()], np.float32)
    else:
        sent = random.integers(0, codec.full_scale + 1, codec.size).astype(np.uint16)
    messages = codec.encode(sent, 0, 0.0)
    assert {(each.id, each.extended) for each in messages} == codec.ids
    readings = sorted((codec.decode(each) for each in messages), key=lambda each: each.segment)
    assert [each.segment for each in readings] == list(range(codec.segments))
    payloads = [each.payload for each in readings]
    np.testing.assert_array_equal(codec.unpack(payloads), sent)
    lost = seed % codec.segments
    sent[codec.span(lost)] = 0
    np.testing.assert_array_equal(codec.unpack([*payloads[:lost], None, *payloads[lost + 1 :]]), sent)


def test_a_message_that_comes_again_before_the_others_came_is_loss():
    codec = CODECS["grid"]
    zero, one = codec.encode(np.arange(6, dtype=np.uint16), 0, 0.0)
    assembler = Assembler(codec)
    frames = [f for each in (zero, one, zero, zero, one) for f in assembler.push(codec.decode(each))]
    assert [np.flatnonzero(frame.flags == MISSING).tolist() for frame in frames] == [[], [3, 4, 5], []]
    assert assembler.loss == Loss(lost=1, incomplete=1)


@pytest.mark.parametrize("lost", [0, 1])
def test_a_skin_of_two_messages_is_not_paired_askew_after_a_loss(lost):
    codec = CODECS["grid"]
    messages = [
        each._replace(time=n / 100 + at / 5000)
        for n in range(12)
        for at, each in enumerate(codec.encode(np.full(6, n, np.uint16), 0, 0.0))
    ]
    del messages[2 * 5 + lost]
    assembler = Assembler(codec)
    frames = [f for each in messages for f in assembler.push(codec.decode(each))]
    assert [set(frame.counts[frame.flags == 0].tolist()) for frame in frames] == [{n} for n in range(12)]
    assert [bool(frame.flags.any()) for frame in frames] == [n == 5 for n in range(12)]


@pytest.mark.parametrize(
    "message",
    [
        Message(0.0, 0x300, bytes(7)),
        Message(0.0, 0x300, b""),
        Message(0.0, 0x300, bytes(8), extended=True),
        Message(0.0, 0x7FF, bytes(8)),
    ],
)
def test_what_the_map_does_not_hold_is_refused(message):
    with pytest.raises(CodecError):
        CODECS["grid"].decode(message)


@pytest.mark.parametrize(
    ("name", "sent", "says"),
    [
        ("grid", [0, 4096, 0, 0, 0, 0], "count 4096 of taxel 1: T0_1 says 0 to 4095"),
        ("grid", [0] * 5, r"counts \(5,\): expected 6"),
        ("floats", [0, -32769, 0], "count -32769 of taxel 1: Offset says -32768 to 32767"),
    ],
)
def test_a_count_that_does_not_fit_is_not_cut_off_in_silence(name, sent, says):
    with pytest.raises(CodecError, match=says):
        CODECS[name].encode(np.array(sent, np.float32), 0, 0.0)


CONFIG = """
[bus.can0]
interface = "virtual"
[sensor.skin]
bus = "can0"
codec = {{ name = "dbc", {codec} }}
array = {{ {array} }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
"""
ROWS = "rows = 2, columns = 3, pitch_mm = 4.0"
TEMPLATE = 'taxels = "Row{row}.T{row}_{column}"'


def made(tmp_path, codec, array=ROWS, content=None):
    (tmp_path / "skins").mkdir()
    (tmp_path / "skins" / "skin.dbc").write_bytes(FILE.read_bytes() if content is None else content)
    path = tmp_path / "a.toml"
    path.write_text(CONFIG.format(codec=codec, array=array))
    return make_codec(load(path).sensor["skin"])


@pytest.mark.parametrize(
    ("taxels", "array"),
    [
        (TEMPLATE, ROWS),
        (f"taxels = {list(GRID)}", ROWS),
        (f"taxels = {list(GRID)}", "positions_mm = [[0,0],[4,0],[8,0],[0,4],[4,4],[8,4]], aperture_mm = 3"),
    ],
)
def test_a_configuration_names_a_file_beside_it_and_its_taxels(tmp_path, monkeypatch, taxels, array):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    codec = made(tmp_path, f'file = "skins/skin.dbc", {taxels}', array)
    sent = np.array([1, 2, 3, 4, 5, 6], np.uint16)
    assert codec.encode(sent, 0, 0.0) == CODECS["grid"].encode(sent, 0, 0.0)


def test_a_template_may_count_from_1_and_pad():
    assert expand("Row{row}.T{column:02}", (1, 2), 2, 1) == ("Row1.T01", "Row1.T02")
    assert expand("M.T{taxel}", None, 3, 0) == ("M.T0", "M.T1", "M.T2")


@pytest.mark.parametrize(
    ("codec", "says"),
    [
        (f'file = "nope.dbc", {TEMPLATE}', r"codec.file = '.*nope.dbc': No such file"),
        ('file = "skins/skin.dbc", taxels = "Row{row}.T{row}_{col}"',
         r"'Row\{row\}.T\{row\}_\{col\}': 'col': a template may hold \{taxel\}, \{row\}, \{column\}"),
        ('file = "skins/skin.dbc", taxels = "Row{row}.T{row}_{column}", first = 1',
         r"names 'Row1.T1_3': skin.dbc has no such signal: did you mean Row"),
        ('file = "skins/skin.dbc", taxels = ["Row0.T0_0", "Row0.T0_1", "Row0.T0_9"]',
         r"names 'Row0.T0_9': skin.dbc has no such signal: did you mean Row0.T0_"),
        ('file = "skins/skin.dbc", taxels = "zzz"', "names zzz twice"),
        ('file = "skins/skin.dbc", taxels = ["@"]', "names '@': skin.dbc has no such signal: it has 20 signals"),
        ('file = "skins/skin.dbc", taxels = ["Row0.T0_0", "Row0.T0_0"]', "names Row0.T0_0 twice"),
        ('file = "skins/skin.dbc", taxels = ["Pages.Page"]', "Pages.Page, which comes with several variants"),
        ('file = "skins/skin.dbc", taxels = ["Nested.Always"]', "Nested.Always, which comes with several"),
        ('file = "skins/skin.dbc", taxels = ["Nested.Deep"]', "Nested.Deep, which comes with several"),
        ('file = "skins/skin.dbc"', r"a.toml: sensor.skin.codec.taxels: missing"),
        ('file = "skins/skin.dbc", taxels = [], frist = 1', "sensor.skin.codec.frist: unknown key: did you mean"),
    ],
)  # fmt: skip
def test_every_fault_of_the_map_is_named(tmp_path, codec, says):
    with pytest.raises(ConfigError, match=says):
        made(tmp_path, codec)


@pytest.mark.parametrize("content", [b"", b"\xff\x00garbage", b'VERSION ""\nBO_ 1 A: 8 X\n SG_ B : 60|12@1+'])
def test_a_file_that_is_no_dbc_is_named(tmp_path, content):
    with pytest.raises(ConfigError, match=r"skin\.dbc"):
        made(tmp_path, f'file = "skins/skin.dbc", {TEMPLATE}', content=content)


def test_without_cantools_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cantools", None)
    with pytest.raises(ConfigError, match=r"needs cantools: pip install 'tactiled\[dbc\]'"):
        Dbc(FILE, GRID)


def test_a_map_of_another_size_than_the_array_is_refused(tmp_path):
    from tactiled.build import sensor_plan

    (tmp_path / "a.toml").write_text(
        CONFIG.format(codec=f'file = "{FILE}", taxels = {list(GRID[:5])}', array=ROWS)
    )
    with pytest.raises(ConfigError, match="the codec carries 5 taxels and the array has 6"):
        sensor_plan("skin", load(tmp_path / "a.toml").sensor["skin"])


@pytest.mark.parametrize("name", CODECS)
def test_a_simulated_array_fits_every_signal(name):
    from tactiled.calibrate.calibration import Calibration

    codec = CODECS[name]
    sent = Taxels(Calibration(), codec.full_scale, 0.0, 0).count(np.full(codec.size, 1e9))
    assert len(codec.encode(sent, 0, 0.0)) == codec.segments
