"""The skins without sequence numbers: genuine vectors, and what all of them have in common."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.build import make_array, make_codec, sensor_plan
from tactiled.bus.assemble import Assembler
from tactiled.bus.codecs.barrett import Barrett
from tactiled.bus.codecs.cyskin import ORDER, CySkin
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.poweron import PowerOn
from tactiled.bus.codecs.xela import Xela
from tactiled.bus.router import Router
from tactiled.config import parse
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import MISSING, Loss, Message

CODECS = {
    "xela": Xela(),
    "xela 4x4-old": Xela("4x4-old"),
    "xela 4x4-new": Xela("4x4-new"),
    "xela 4x6-old": Xela("4x6-old"),
    "xela single": Xela("single"),
    "barrett": Barrett(11),
    "poweron": PowerOn(),
    "cyskin": CySkin(),
    "linker": Linker("left", (1, 3)),
}


def message(text):
    id_, data = text.split("#")
    return Message(0.0, int(id_, 16), bytes.fromhex(data))


def payloads(codec, *texts):
    found = [None] * codec.segments
    for text in texts:
        reading = codec.decode(message(text))
        found[reading.segment] = reading.payload
    return found


def counts(codec, *texts):
    return codec.unpack(payloads(codec, *texts)).tolist()


# As a module of two SDAs with eight taxels each sent them.
XELA_SENT = (
    "141#9340983F0C915114", "071#933DB83FFA8E3717", "031#933DEA4178901F0F", "021#933EFC41AC8EDA0E",
    "051#933FFE403B8B5415", "131#933DD140288B230F", "061#833F3D40408CC316",
)  # fmt: skip


def test_genuine_xela_frames():
    codec = Xela(rows=(0, 1), columns=tuple(range(8)))
    axes = codec.axes(payloads(codec, *XELA_SENT)).reshape(2, 8, 3)
    assert axes[1, 4].tolist() == [0x4098, 0x3F0C, 0x9151]
    assert axes[0, 7].tolist() == [0x3DB8, 0x3FFA, 0x8E37]
    assert axes[0, 6].tolist() == [0x3F3D, 0x4040, 0x8CC3]
    again = codec.axes(payloads(codec, "031#833DF6416690180F")).reshape(2, 8, 3)
    assert again[0, 3].tolist() == [0x3DF6, 0x4166, 0x9018]
    z = np.array(counts(codec, *XELA_SENT)).reshape(2, 8)
    assert z.tolist() == [
        [0, 0, 0x8EDA, 0x901F, 0, 0x8B54, 0x8CC3, 0x8E37],
        [0, 0, 0, 0x8B23, 0x9151, 0, 0, 0],
    ]


def test_genuine_xela_shear():
    """Counts from 0x4000 along the skin's x and y; NaN where the taxel's message did not come."""
    codec = Xela(rows=(0, 1), columns=tuple(range(8)))
    shear = codec.shear(payloads(codec, *XELA_SENT)).reshape(2, 2, 8)
    assert shear[:, 1, 4].tolist() == [0x4098 - 0x4000, 0x3F0C - 0x4000]
    assert shear[:, 0, 7].tolist() == [0x3DB8 - 0x4000, 0x3FFA - 0x4000]
    assert np.isnan(shear).sum() == 2 * (16 - len(XELA_SENT))


def test_shear_comes_back_as_it_was_encoded_to_the_ends_of_its_axes():
    codec, rng = Xela(), np.random.default_rng(1)
    counts, shear = rng.integers(0, 0x10000, 24), rng.integers(-0x4000, 0xC000, (2, 24)).astype(np.float32)
    shear[:, 0] = -1e6, 1e6
    sent = [codec.decode(each).payload for each in codec.encode_sheared(counts.astype(np.uint16), shear, 0, 0.0)]
    np.testing.assert_array_equal(codec.unpack(sent), counts)
    np.testing.assert_array_equal(codec.shear(sent)[:, 1:], shear[:, 1:])
    assert codec.shear(sent)[:, 0].tolist() == [-0x4000, 0xFFFF - 0x4000]


def test_a_frame_carries_the_shear_of_its_own_messages_and_only_skins_that_feel_it_do():
    codec = Xela(rows=(0, 1), columns=tuple(range(8)))
    assembler = Assembler(codec)
    for text in XELA_SENT:
        assembler.push(codec.decode(message(text)))
    (frame,) = assembler.flush(1.0)
    np.testing.assert_array_equal(frame.shear, codec.shear(payloads(codec, *XELA_SENT)))
    np.testing.assert_array_equal(np.isnan(frame.shear), [frame.flags == MISSING] * 2)
    pad = Barrett(11)
    frames = [
        f for each in pad.encode(np.zeros(24, np.uint16), 0, 0.0) for f in Assembler(pad).push(pad.decode(each))
    ]
    assert [frame.shear for frame in frames] == [None] * len(frames)


def test_xelas_module_of_4_x_6_has_its_first_sda_at_the_bottom_and_taxel_5_at_the_left():
    codec = Xela()
    bottom_left = codec.decode(message("151#9340003F0C915114"))
    assert divmod(bottom_left.segment, 6) == (3, 0)
    assert codec.size == 24


@pytest.mark.parametrize(
    ("codec", "model"),
    [
        (Xela(), "uSPa46"),
        (Xela(rows=(3, 2, 1, 0), columns=(3, 2, 1, 0)), "uSPa44"),
        (Xela(rows=(0, 1), columns=tuple(range(8))), "XR1944"),
        (Xela(rows=(0, 1), columns=(0, 1, 2)), "unknown"),
        (Xela("4x4-new"), "XR1944"),
        (Xela("4x6-old"), "XR1946"),
        (Xela("single"), "unknown"),
        (Xela("single", model="XR1911"), "XR1911"),
        (Xela(model="XR1946"), "XR1946"),
    ],
)
def test_xelas_model_is_told_by_ids_and_size_unless_it_is_given(codec, model):
    assert codec.told_model == model


@pytest.mark.parametrize(
    ("profile", "id_", "taxel"),
    [("4x4-old", 0x123, 11), ("4x4-new", 0x21A, 14), ("4x6-old", 0x135, 23), ("single", 0x71F, 15)],
)
def test_xelas_older_ids(profile, id_, taxel):
    assert Xela(profile).decode(Message(0.0, id_, bytes(8))).segment == taxel


def test_genuine_poweron_frames():
    sent = (
        "300#9601E25504EFA3C7", "301#97ACB05505EFA3C7", "302#B2DCF34504EFA3C7", "303#9BBBB95505EFA3C7",
        "304#AFF2E94504EFA3C7", "305#A4BCBE5505EFA3C7",
    )  # fmt: skip
    assert counts(PowerOn(), *sent) == [
        0x596, 0x501, 0x4E2, 0x597, 0x5AC, 0x5B0,
        0x5B2, 0x4DC, 0x4F3, 0x59B, 0x5BB, 0x5B9,
        0x5AF, 0x4F2, 0x4E9, 0x5A4, 0x5BC, 0x5BE,
        *[0] * 18,
    ]  # fmt: skip


def test_linkers_rows():
    codec = Linker("right", (2, 1))
    polls = codec.talk.polls
    assert [(each.message.id, each.message.data.hex()) for each in polls] == [(0x27, "b2c6"), (0x27, "b1c6")]
    assert [each.segments for each in polls] == [range(12), range(12, 24)]
    found = np.array(counts(codec, "027#B130000102030405")).reshape(2, 12, 6)
    assert found[1, 3].tolist() == [0, 1, 2, 3, 4, 5]
    assert np.count_nonzero(found) == 5


def test_barretts_taxels_are_big_endian_behind_the_segments_digit():
    """Derived from the layout: seq[4] t0[12] ... t4[12]."""
    found = counts(Barrett(11), "569#2ABC123FFF001800", "569#4111222333444FFF")
    assert found[10:15] == [0xABC, 0x123, 0xFFF, 0x001, 0x800]
    assert found[20:24] == [0x111, 0x222, 0x333, 0x444]  # there is no 25th
    assert sum(found[:10]) == 0


def test_cyskins_values_are_taxels_in_another_order():
    """Derived from the layout: value n of a frame, little-endian, is taxel ORDER[n]."""
    codec = CySkin()
    found = counts(codec, "405#0100020003000400", "40B#3412000000000080")
    assert [found[11], found[15], found[14], found[12]] == [1, 2, 3, 4]
    assert (found[2], found[1]) == (0x1234, 0x8000)
    frame = Assembler(codec)
    first = codec.encode(np.arange(16, dtype=np.uint16), 0, 0.0)[0]
    frame.push(codec.decode(first))
    (marked,) = frame.flush(1.0)
    assert np.flatnonzero(marked.flags == 0).tolist() == sorted(ORDER[:4])


@pytest.mark.parametrize("name", CODECS)
@given(seed=st.integers(0, 2**32 - 1))
def test_decode_inverts_encode_over_the_whole_range(name, seed):
    codec = CODECS[name]
    sent = np.random.default_rng(seed).integers(0, codec.full_scale + 1, codec.size).astype(np.uint16)
    messages = codec.encode(sent, 0, 0.0)
    assert len(messages) == codec.segments
    assert {(each.id, each.extended) for each in messages} == codec.ids
    readings = [codec.decode(each) for each in messages]
    assert sorted(reading.segment for reading in readings) == list(range(codec.segments))
    found = [each.payload for each in sorted(readings, key=lambda each: each.segment)]
    np.testing.assert_array_equal(codec.unpack(found), sent)
    lost = seed % codec.segments
    sent[codec.span(lost)] = 0
    np.testing.assert_array_equal(codec.unpack([*found[:lost], None, *found[lost + 1 :]]), sent)


@pytest.mark.parametrize("name", CODECS)
def test_frames_follow_one_another_and_a_lost_message_is_marked(name):
    codec = CODECS[name]
    assembler = Assembler(codec)
    rows = [codec.encode(np.full(codec.size, n, np.uint16), n, float(n)) for n in range(1, 5)]
    del rows[1][1]
    frames = [frame for row in rows for each in row for frame in assembler.push(codec.decode(each))]
    assert [frame.sequence for frame in frames] == [0, 1, 2, 3]
    assert assembler.loss == Loss(lost=1, incomplete=1)
    for n, frame in enumerate(frames):
        known = frame.flags & MISSING == 0
        assert known.sum() == (codec.size if n != 1 else codec.size - len(np.arange(codec.size)[codec.span(1)]))
        assert np.all(frame.counts[known] == n + 1)


@pytest.mark.parametrize("name", CODECS)
def test_what_is_none_of_the_skins_is_refused(name):
    codec = CODECS[name]
    good = codec.encode(np.zeros(codec.size, np.uint16), 0, 0.0)[0]
    for bad in (good._replace(data=good.data[:7]), good._replace(fd=True), good._replace(data=b"")):
        with pytest.raises(CodecError):
            codec.decode(bad)
    with pytest.raises(CodecError, match=str(codec.size)):
        codec.encode(np.zeros(codec.size + 1, np.uint16), 0, 0.0)


@pytest.mark.parametrize("name", CODECS)
@given(stream=st.lists(st.tuples(st.integers(0, 30), st.binary(max_size=9), st.booleans()), max_size=40))
def test_any_bytes_neither_crash_nor_go_uncounted(name, stream):
    codec = CODECS[name]
    ids = sorted(codec.ids)
    router = Router({"it": codec})
    for at, data, fd in stream:
        id_, extended = ids[at % len(ids)]
        for _, frame in router.push(Message(0.0, id_, data, extended, fd)):
            assert frame.counts.shape == frame.flags.shape == (codec.size,)
    loss = router.assemblers["it"].loss
    assert loss.foreign == 0
    assert loss.malformed >= sum(fd or len(data) != 8 for _, data, fd in stream)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Xela("4x5"), "codec.profile = '4x5': choose current or one of 4x4-old"),
        (lambda: Xela(rows=(1, 1)), "names an SDA or a taxel twice"),
        (lambda: Linker(fingers=(2, 2)), r"codec.fingers = \[2, 2\]: names a finger twice"),
    ],
)
def test_a_setting_that_cannot_be_is_refused(make, says):
    with pytest.raises(ConfigError, match=says):
        make()


CONFIG = """
[bus.can0]
interface = "virtual"
[sensor.skin]
bus = "can0"
codec = {{ {codec} }}
array = {{ rows = {rows}, columns = {columns}, pitch_mm = 4.0 }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
"""


@pytest.mark.parametrize(
    ("codec", "shape", "made"),
    [
        ('name = "xela"', (4, 6), Xela()),
        ('name = "xela", controller = 3, rows = [0, 1], columns = [0, 1, 2]', (2, 3),
         Xela("current", 3, (0, 1), (0, 1, 2))),
        ('name = "xela", profile = "single"', (4, 4), Xela("single")),
        ('name = "barrett", node = 11', (8, 3), Barrett(11)),
        ('name = "poweron"', (6, 6), PowerOn()),
        ('name = "cyskin"', (4, 4), CySkin()),
        ('name = "linker", hand = "left", fingers = [2]', (12, 6), Linker("left", (2,))),
    ],
)  # fmt: skip
def test_a_configuration_names_every_skin(codec, shape, made):
    text = CONFIG.format(codec=codec, rows=shape[0], columns=shape[1])
    sensor = parse(text).sensor["skin"]
    assert make_codec(sensor) == made
    assert make_array(sensor).size == made.size


def test_a_fault_in_a_skins_settings_is_named_without_its_tag():
    text = CONFIG.format(codec='name = "barrett", node = 99, nod = 1', rows=8, columns=3)
    with pytest.raises(ConfigError) as caught:
        parse(text, "a.toml")
    told = str(caught.value)
    assert "a.toml: sensor.skin.codec.node = 99: " in told
    assert "a.toml: sensor.skin.codec.nod: unknown key: did you mean node?" in told


@pytest.mark.parametrize(
    ("codec", "shape", "calibration", "says"),
    [
        (
            'name = "barrett", node = 11',
            (8, 3),
            "kpa_per_count = 1.0, ",
            "the codec carries no shear: leave it out",
        ),
        ('name = "xela"', (4, 6), "", "forces need kpa_per_count, too: give both"),
    ],
)
def test_a_scale_of_shear_without_what_it_needs_is_refused(codec, shape, calibration, says):
    text = CONFIG.format(codec=codec, rows=shape[0], columns=shape[1])
    text += f"calibration = {{ {calibration}shear_n_per_count = 0.0006 }}"
    with pytest.raises(ConfigError, match=f"sensor.skin: calibration.shear_n_per_count = 0.0006: {says}"):
        sensor_plan("skin", parse(text).sensor["skin"])
