from types import SimpleNamespace

import numpy as np
import pytest

from tactiled.bus.codecs.icub import Icub
from tactiled.bus.codecs.linker import Linker
from tactiled.bus.codecs.packed import Packed
from tactiled.bus.sniff import survey
from tactiled.config import parse
from tactiled.frames import Message
from tactiled.plausibility.traffic import bus_report
from tests.bus.skins import CODECS, DBC, traffic

CONFIG = """
[bus.can0]
interface = "virtual"
[sensor.a]
bus = "can0"
codec = {{ {codec} }}
{array}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
calibration = {{ {calibration} }}
"""
GRID = "array = { rows = 5, columns = 6, pitch_mm = 2.0 }"
FD = Packed(30, 12, fd=True)
HEALTHY = list(traffic(FD))


def report(messages, codec='name = "packed", fd = true', array=GRID, calibration="no_load = 80", more=""):
    text = CONFIG.format(codec=codec, array=array + more, calibration=calibration)
    return bus_report(parse(text), "can0", messages, 3.0)


def findings(*arguments, **settings):
    return [str(each) for each in report(*arguments, **settings).findings]


def altered(change):
    """The healthy frames, their counts (T, 30) changed."""
    counts = np.array([FD.unpack([m.data[2:]]) for m in HEALTHY])
    change(counts)
    return [
        each._replace(time=sequence / 50)
        for sequence, frame in enumerate(counts)
        for each in FD.encode(frame, sequence, 0.0)
    ]


def test_a_healthy_array_is_heard_and_foreign_ids_are_counted():
    result = report([*HEALTHY, Message(0.1, 0x6A1, b"")])
    assert result.lines == ["a: 50.0 frames a second, 0 messages lost, 0 malformed"]
    assert not result.findings
    assert [each.id for each in result.others.unknown] == [0x6A1]


def pressed(rows, columns):
    """Frames of a finger that goes over an array in a circle (T, N)."""
    y, x = np.mgrid[:rows, :columns]
    turn = np.linspace(0, 6, 60)[:, None, None]
    squares = (y - rows / 2 - rows / 4 * np.cos(turn)) ** 2 + (x - columns / 2 - columns / 4 * np.sin(turn)) ** 2
    frames = 80 + 800 * np.exp(-squares / 4) + np.random.default_rng(3).normal(0, 2, (60, rows, columns))
    return frames.reshape(60, -1).astype(np.uint16)


@pytest.mark.parametrize(("rows", "columns"), [(16, 10), (9, 14)])
def test_rows_and_columns_that_contradict_what_presses_are_doubted(rows, columns):
    codec = Packed(rows * columns, 12, fd=True)
    messages = [
        each._replace(time=n / 50 + k * 1e-4)
        for n, frame in enumerate(pressed(rows, columns))
        for k, each in enumerate(codec.encode(frame, n, 0.0))
    ]
    grid = "array = {{ rows = {}, columns = {}, pitch_mm = 2.0 }}"
    assert not findings(messages, array=grid.format(rows, columns))
    (line,) = findings(messages, array=grid.format(columns, rows))
    assert f"sensor.a.array = {columns} x {rows}: what presses" in line
    assert line.endswith(f"as on {rows} x {columns}: rows and columns are swapped")
    (one,) = survey(messages).senders
    assert one.match.shape == (rows, columns)
    assert one.match.notes[0].endswith(f"best guess: {rows} x {columns}, in which neighbours change alike")


def test_padding_is_no_row_of_the_array():
    codec = Packed(48, 8, fd=True)  # 62 taxels would fit
    frames = enumerate(pressed(4, 12) // 4)
    (one,) = survey(
        [each._replace(time=n / 50) for n, frame in frames for each in codec.encode(frame, n, 0.0)]
    ).senders
    assert one.match.shape == (4, 12)
    (idle,) = survey(traffic(codec)).senders
    assert idle.match.shape == (6, 8)


def test_without_a_press_the_squarest_grid_is_guessed_and_the_guess_says_so():
    (one,) = survey(traffic(Packed(160, 12, fd=True))).senders
    assert one.match.shape == (10, 16)
    assert "best guess: 10 x 16; slide a finger over it to tell" in one.match.notes[0]


def stick(counts):
    counts[:, [3, 7]] = 91


def end(counts):
    counts[:] = 80
    counts[:, 29] = 4095


def wrapped(numbers):
    """Healthy frames whose sequence numbers are these, again and again."""
    frames = enumerate(traffic(FD, 3 * len(numbers)))
    return [each._replace(data=bytes([numbers[n % len(numbers)]]) + each.data[1:]) for n, each in frames]


# Messages, settings and the one finding that they give.
FAULTS = {
    "nothing": ([], {}, "bus.can0: no message in 3 s: nothing sends, or bit rate, channel or wiring are wrong"),
    "another array": (
        traffic(Packed(30, 12, fd=True, array_id=2)),
        {},
        "sensor.a.codec.array_id = 0: no complete frame: packed layout, CAN FD, array 2 at 0x500, 12 bits a taxel"
        " sends: array_id = 2",
    ),
    "another id": (
        traffic(Packed(30, 12, fd=True, base_id=0x640)),
        {},
        "a.codec.base_id = 0x500: no complete frame: packed layout, CAN FD, array 0 at 0x640, 12 bits a taxel "
        "sends: base_id = 0x640",
    ),
    "classic for CAN FD": (traffic(Packed(30, 12)), {}, "12 bits a taxel sends: fd = false"),
    "CAN FD for classic": (HEALTHY, {"codec": 'name = "packed"'}, "12 bits a taxel sends: fd = true"),
    "another size": (
        traffic(Packed(300, 12, fd=True)), {}, "sends 8 messages a frame, and 1 are expected"
    ),
    "another board": (
        traffic(Icub(3, (1,))),
        {"codec": 'name = "icub", board = 4, triangles = [1]', "array": "", "calibration": ""},
        "codec.board = 4: no complete frame: iCub MTB, class 0x400, board 3, triangles 1 sends: board = 3",
    ),
    "strangers": ([Message(0.1, 0x6A1, b"")], {}, "sensor.a.codec = packed: no complete frame on ids 0x500"),
    "loss": ([each for n, each in enumerate(HEALTHY) if n % 10 != 9], {}, "7.7 % of its messages are lost"),
    "malformed": (
        [each._replace(data=each.data + bytes(4 * (n % 10 == 9))) for n, each in enumerate(HEALTHY)],
        {},
        "sensor.a.codec = packed: 10.0 % of its messages do not fit the layout, the first CAN FD, id 0x500,"
        " 52 bytes: 09 00 ",
    ),
    "malformed, all": (
        [each._replace(data=b"\0\1" + each.data[2:]) for each in HEALTHY],
        {},
        "100.0 % of its messages do not fit the layout",
    ),
    "an early wrap": (
        wrapped(range(16)),
        {},
        "sensor.a.codec: its sequence number counts from 0 to 15 and begins again, and 256 numbers are expected:"
        " have the firmware count to 255, or set modulus = 16 in a codec of your own",
    ),
    "a wrap that looks like loss": (wrapped(range(200)), {}, "counts from 0 to 199"),
    "a sequence number without 0": (wrapped(range(1, 256)), {}, "counts from 1 to 255"),
    "a sequence number of two values": (wrapped(range(2)), {}, "counts from 0 to 1"),
    "a sequence number that stands still": (
        [each._replace(data=b"\0" + each.data[1:]) for each in HEALTHY], {}, "97.5 % of its messages repeat others"
    ),
    "pauses": (HEALTHY, {"more": "\nstale_after_s = 0.015"}, "stale_after_s = 0.015: frames come 0.02 s apart"),
    "one pause": (
        [each._replace(time=each.time + (n > 20)) for n, each in enumerate(HEALTHY)],
        {},
        "stale_after_s = 0.5: one frame came 1 s after the one before",
    ),
    "another zero": (HEALTHY, {"calibration": "no_load = 2048"}, "no_load = 2048: half of the taxels read 80"),
    "stuck": (altered(stick), {}, "dead = []: never change: taxels 3, 7: list them if they do not work"),
    "at the end of the scale": (altered(end), {}, "never change: taxels 29: list them"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_one_finding_with_its_likely_reason(fault):
    messages, settings, reason = FAULTS[fault]
    (finding,) = findings(list(messages), **settings)
    assert reason in finding


def test_what_a_sensor_without_a_complete_frame_sends_is_counted():
    first_is_1 = [each._replace(data=each.data[:1] + b"\1" + each.data[2:]) for each in HEALTHY]
    assert report(first_is_1).lines == [f"a: no complete frame, 0 messages lost, {len(HEALTHY)} malformed"]
    assert report([Message(0.1, 0x6A1, b"")]).lines == ["a: no complete frame"]


def test_what_a_healthy_array_may_do_is_no_fault():
    assert not findings(altered(stick), calibration="no_load = 80, dead = [3, 7]")
    assert not findings(altered(lambda counts: counts.fill(80)))
    assert not findings(altered(stick)[:10])
    assert not findings(HEALTHY, calibration="no_load = 100")
    assert not findings([each for n, each in enumerate(traffic(FD, 200)) if n != 100])
    assert not findings(wrapped(range(256)))
    longer = [each._replace(data=each.data + bytes(4 * (n == 100))) for n, each in enumerate(traffic(FD, 200))]
    assert not findings(longer)
    restarted = [each._replace(time=each.time + n // 16) for n, each in enumerate(wrapped(range(16)))]
    assert not findings(restarted, more="\nstale_after_s = 2")


def test_the_no_load_of_a_calibration_file_counts(monkeypatch):
    file = SimpleNamespace(gain=None, health=None, no_load=SimpleNamespace(values=np.full(30, 80.0)))
    monkeypatch.setattr("tactiled.plausibility.traffic.configured_file", lambda _: file)
    assert not findings(HEALTHY, calibration="no_load = 2048")
    file.no_load.values[:16] = 2048
    assert findings(HEALTHY)


@pytest.mark.parametrize("messages", [[], [Message(0.1, 0x27, b"\xb1\xc6")]])
def test_a_skin_that_waits_until_asked_is_no_fault(messages):
    result = report(messages, 'name = "linker"', "array = { rows = 12, columns = 6, pitch_mm = 2.0 }", "")
    assert result.lines == ["a: no frame: it waits until asked or started, and a check sends nothing"]
    assert not result.findings


def test_a_skin_that_another_node_polls_is_heard():
    others = [Message(each / 50 + 0.01, 0x27, b"\xc0\x01") for each in range(40)]
    result = report(
        sorted([*traffic(Linker("right", (1,))), *others]),
        'name = "linker"',
        "array = { rows = 12, columns = 6, pitch_mm = 2.0 }",
    )
    assert result.lines == ["a: 50.0 frames a second, 0 messages lost, 40 malformed"]
    assert not result.findings


def test_pages_of_a_dbc_message_that_carry_no_taxels_are_a_hint():
    codec = f'name = "dbc", file = "{DBC}", taxels = ["Pages.P0", "Pages.P1"]'
    result = report(list(traffic(CODECS["dbc-pages"])), codec, "array = { rows = 1, columns = 2, pitch_mm = 2.0 }")
    assert [each.hint for each in result.findings if "do not fit" in each.reason] == [True]
