"""Laws that every codec of the package keeps; what single skins send is in test_golden.py."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.bus import skins
from tactiled.bus.assembler import Assembler
from tactiled.bus.codec import ShearCodec, read_one
from tactiled.bus.codecs.dbc import Dbc
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import MISSING, Loss
from tests.bus.skins import CODECS, payloads_of

SEEDS = st.integers(0, 2**32 - 1)
every_codec = pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)


def test_every_skin_of_the_package_is_tested():
    assert {name.split("-")[0] for name in CODECS} == set(skins.BUILT_IN)


@every_codec
@given(seed=SEEDS)
def test_decode_inverts_encode_over_the_whole_range(codec, seed):
    counts = np.random.default_rng(seed).integers(0, codec.full_scale + 1, codec.size).astype(np.uint16)
    messages = codec.encode(counts, seed % 700, 1.5)
    assert {(each.id, each.extended) for each in messages} <= codec.ids
    readings = [read_one(codec, each) for each in messages]
    assert [each.segment for each in readings] == list(range(codec.segments))
    assert {each.sequence for each in readings} == {seed % 700 % codec.modulus if codec.modulus else None}
    assert {(each.time, each.bad) for each in readings} == {(1.5, ())}
    payloads = [each.payload for each in readings]
    np.testing.assert_array_equal(codec.unpack(payloads), counts)
    lost = seed % codec.segments
    payloads[lost], counts[codec.span(lost)] = None, 0
    np.testing.assert_array_equal(codec.unpack(payloads), counts)


@every_codec
def test_a_malformed_message_is_refused(codec):
    good = codec.encode(np.zeros(codec.size, np.uint16), 0, 0.0)[0]
    kinds = [good._replace(data=good.data[:-1]), good._replace(data=b""), good._replace(data=bytes(63))]
    for bad in kinds if isinstance(codec, Dbc) else [*kinds, good._replace(fd=not good.fd)]:
        with pytest.raises(CodecError):
            read_one(codec, bad)


@every_codec
def test_counts_that_the_skin_cannot_send_are_refused(codec):
    with pytest.raises(CodecError, match=str(codec.size)):
        codec.encode(np.zeros(codec.size + 1, np.uint16), 0, 0.0)
    if codec.full_scale < 0xFFFF:
        with pytest.raises(CodecError, match=str(codec.full_scale)):
            codec.encode(np.full(codec.size, codec.full_scale + 1, np.uint16), 0, 0.0)


@every_codec
def test_frames_follow_one_another_and_a_lost_message_is_marked(codec):
    assembler = Assembler(codec)
    rows = [codec.encode(np.full(codec.size, n, np.uint16), n, float(n)) for n in range(1, 5)]
    del rows[1][1 % codec.segments]
    frames = [frame for row in rows for each in row for _, frame in assembler.push(each)]
    assert [frame.sequence for frame in frames] == [0, 1, 2, 3]
    assert assembler.loss == Loss(lost=1, incomplete=1)
    for n, frame in enumerate(frames):
        gap = np.arange(codec.size)[codec.span(1)].tolist() if n == 1 else []
        assert np.flatnonzero(frame.flags == MISSING).tolist() == sorted(gap)
        assert np.all(np.delete(frame.counts, gap) == n + 1)


def test_shear_comes_back_rounded_and_clipped_to_its_axes():
    codec, rng = CODECS["xela"], np.random.default_rng(1)
    counts, shear = rng.integers(0, 0x10000, 24), rng.integers(-0x4000, 0xC000, (2, 24)).astype(np.float32)
    expected = shear.copy()
    shear[:, :3] = [-1e6, 1.7, -1.7], [1e6, -0.6, 2.4]
    expected[:, :3] = [-0x4000, 2, -2], [0xFFFF - 0x4000, -1, 2]
    payloads = payloads_of(codec, codec.encode_sheared(counts.astype(np.uint16), shear, 0, 0.0))
    np.testing.assert_array_equal(codec.unpack(payloads), counts)
    np.testing.assert_array_equal(codec.shear(payloads), expected)
    sheared = [name for name, each in CODECS.items() if isinstance(each, ShearCodec)]
    assert sheared == [name for name in CODECS if name.startswith("xela")]


@pytest.mark.parametrize(
    ("name", "settings", "reason"),
    [
        ("xela", {"rows": (1, 1)}, r"rows = \[1, 1\]: names a number twice"),
        ("xela", {"columns": (3, 3)}, r"columns = \[3, 3\]: names a number twice"),
        ("xela", {"start": True}, "modules of the current profile send by themselves"),
        (
            "xela",
            {"profile": "4x4-old", "rows": [1]},
            r'rows = \[1\]: used only with profile = "current", not with "4x',
        ),
        ("xela", {"profile": "single", "controller": 7}, "controller = 7: used only with start = true"),
        ("linker", {"fingers": (2, 2)}, r"fingers = \[2, 2\]: names a number twice"),
        ("icub", {"board": 0, "triangles": (1, 1)}, r"triangles = \[1, 1\]: names a number twice"),
    ],
)
def test_contradicting_settings_are_refused(name, settings, reason):
    with pytest.raises(ConfigError, match=reason):
        skins.load(name)(**settings)
