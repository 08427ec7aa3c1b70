"""Logs as people have them: every message is read as it was meant, and what is not a message is counted."""

import gzip
import sqlite3
import struct
from pathlib import Path

import can
import pytest

from tactiled.bus.recording import Recording, read
from tactiled.errors import ConfigError
from tactiled.frames import Message

FIRST, SECOND = bytes.fromhex("0700BC3A12FF1F00"), bytes.fromhex("0701023000")  # a frame of two messages
HEAD = "date Fri Nov 27 10:13:20.000 am 2026\nbase hex  timestamps absolute\nno internal events logged\n"
ASC = " {} 1  500             Rx   d 8 07 00 BC 3A 12 FF 1F 00\n {} 1  500             Rx   d 5 07 01 02 30 00\n"
TWO = "(1.0) can0 500#0700BC3A12FF1F00\n(1.0002) can0 500#0701023000\n"
TRC = "     1)  0.0  Rx  0500  8  07 00 BC 3A 12 FF 1F 00\n     2)  0.2  Rx  0500  5  07 01 02 30 {}"
VERSION = ";$FILEVERSION={}\n;$STARTTIME=45244.5\n"
STARTED = 1699963200.0  # s, of the time above
UNZONED = "its times are of an unknown time zone, taken for UTC"
FD_LINE = " {} CANFD   1 Rx        500  {} 0 8  8 07 00 BC 3A 12 FF 1F 00   102203  133   {} e0006659 46500250\n"
CSV_ROW = "1.0,0x500,0,0,0,8,BwC8OhL/HwA=\n"
CSV = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"


def after(path, content):
    """What is read of a file: its recording, and its messages."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    recording = Recording(path)
    return recording, list(recording)


@pytest.mark.parametrize(
    ("name", "content", "times", "also"),
    [
        ("a.asc", HEAD + ASC.format(-0.5, -0.4998) + ASC.format(0.1, 0.1002), [0, 0.0002, 0.6, 0.6002],
         "its times count from its first line, 0.5 s before the trigger"),
        ("a.asc", HEAD.replace("absolute", "relative") + ASC.format("0.0", 0.0002) + ASC.format(0.1, 0.0002),
         [0, 0.0002, 0.1002, 0.1004], ""),
        ("a.asc", HEAD.replace("absolute", "relative") + ASC.format("0.0", 0.0002) + " 0.5 1 Statistic: D 0\n"
         + ASC.format(0.1, 0.0002), [0, 0.0002, 0.6002, 0.6004], "left out: 1 other event"),
        ("a.asc", "base hex  no internal events logged\n// version 7.1.0\n" + ASC.format("0.0", 0.0002),
         [0, 0.0002], ""),
        ("a.asc", ASC.format("0.0", 0.0002), [0, 0.0002], ""),
        ("a.asc", "0.0 CAN 1 Status:chip status error active\n" + ASC.format("0.0", 0.0002), [0, 0.0002],
         "left out: 1 other event"),
        ("a.asc", (HEAD + "// Pr\xfcfstand\n" + ASC.format("0.0", 0.0002)).encode("cp1252"), [0, 0.0002], ""),
        ("a.asc", HEAD + " 0.000000 CANFD   Start of measurement\n" + ASC.format("0.0", 0.0002), [0, 0.0002], ""),
        ("a.asc", HEAD + ASC.format("0.0", 0.0002) + " 0.1 1 500 Rx d 8 07 00\n", [0, 0.0002],
         "left out: 1 cut-off message"),
        ("a.asc", HEAD + ASC.format("0.0", 0.0002) + ASC.format("0.1", 0.1002).replace("Rx ", "TxRq"), [0, 0.0002],
         "left out: 2 transmit requests"),
        ("a.log", TWO + "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)\n", [1, 1.0002],
         "left out: 3 dropped messages"),
        ("a.log", TWO + "(1.1) can0 20000004#0010000000000000\n(1.1) can0 20000080#\n(1.1) can0 A8FF0022#01\n",
         [1, 1.0002], "left out: 3 error frames"),
        ("a.log", TWO + "(1.1) can0 45123#81:00:12345678#11223344.556677\n", [1, 1.0002],
         "left out: 1 CAN XL frame"),
        ("a.log", TWO + "(1.1) can0 500#R8_B\n", [1, 1.0002], "left out: 1 remote frame"),
        ("a.log", TWO.replace("1F00\n", "1F00_B\n"), [1, 1.0002], ""),
        ("a.log", TWO.replace("0701023000", "07.01.02.30.00"), [1, 1.0002], ""),
        ("a.log", TWO + "(1.1) can0 500#070\n(1.2) can0 500#07(1.3) can0 500#0701023000\n", [1, 1.0002],
         "left out: 1 cut-off message, 1 unreadable line"),
        ("a.log", TWO + "(1.1) can0 500#07010230001122334455\n", [1, 1.0002], "left out: 1 unreadable line"),
        ("a.log", "\0\0\0\n" + TWO, [1, 1.0002], "left out: 1 zeroed line"),
        ("a.log", TWO + "\0\0\0", [1, 1.0002], "its end is cut off"),
        ("a.log", b"\xef\xbb\xbf" + TWO.encode(), [1, 1.0002], ""),
        ("a.log", TWO.encode("utf-16"), [1, 1.0002], ""),
        ("a.log", "# a grasp\n" + TWO + "\ufeff" + TWO.replace("(1.", "(2."), [1, 1.0002, 2, 2.0002],
         "left out: 1 unreadable line"),
        ("a.log", TWO.lower(), [1, 1.0002], ""),
        ("a.log", TWO + "(1.1) can0 88888888#01\n", [1, 1.0002], "left out: 1 unreadable line"),
        ("a.asc", HEAD + ASC.format("0.0", "0.0002") + " 0.1 1 123456789ABx Rx d 1 00\n", [0, 0.0002],
         "left out: 1 unreadable line"),
        ("a.asc", HEAD + ASC.format("0,0", "0,0002").upper(), [0, 0.0002], ""),
        ("a.asc", HEAD + ASC.format("86399.9", "86399.9002") + ASC.format("0.1", "0.1002"),
         [86399.9, 86399.9002, 0.1, 0.1002], ""),
        ("a.asc", HEAD.replace("Fri Nov", "Fre M\xe4r") + "Begin Triggerblock Fre M\xe4r 27 10:13:20.000 2026\r\n"
         " 0.0 Start der Messung\r\n" + ASC.format("0.0", "0.0002").replace("\n", "\r\n") + "End TriggerBlock\r\n",
         [0, 0.0002], ""),
        ("a.asc", HEAD + ASC.format("0.0", "0.0002") + " 0.1 1 500 Rx d 8 07 00date Fri Nov 27 2026\n" + HEAD,
         [0, 0.0002], "left out: 1 cut-off message"),
        ("a.asc", HEAD + ASC.format("0.0", "0.0002") + " 0.1 1 Engine Rx d 1 00\n 0.2 CANXL 1 Rx 500 0 1\n"
         " 0.3 CAN 1 Status:chip status error active\n", [0, 0.0002],
         "left out: 1 CAN XL frame, 1 other event, 1 unreadable line"),
        ("a.trc", VERSION.format(2.0) + " 1 0.0 DT 0500 Rx 8 07 00 BC 3A 12 FF 1F 00\n 2 0.1 ER Rx 00 01 02\n"
         " 3 0.2 DT 0500 Rx 5 07 01 02 30 00\n 4 0.3 ST Rx 00 00 00 08\n", [STARTED, STARTED + 0.0002],
         f"left out: 1 error frame, 1 other event; {UNZONED}"),
        ("a.csv", CSV.replace("_", " ").replace(",", ", ") + CSV_ROW, [1], ""),
        ("a.trc", VERSION.format(1.1) + TRC.format("00"), [STARTED, STARTED + 0.0002], f"{UNZONED}"),
        ("a.trc", VERSION.format(1.1) + TRC.format("0"), [STARTED], f"{UNZONED}; its end is cut off"),
        ("a.trc", VERSION.format(1.1) + TRC.format(""), [STARTED], f"{UNZONED}; its end is cut off"),
        ("a.trc", VERSION.format(1.1) + TRC.format("0\n"), [STARTED], f"left out: 1 cut-off message; {UNZONED}"),
        ("a.trc", ";$FILEVERSION=1.2\n" + TRC.format("00").replace("Rx", "1 Rx"), [0, 0.0002], ""),
        ("a.trc", ";##\n;   C:\\a.trc\n 1)  0  0500  8  07 00 BC 3A 12 FF 1F 00 \r\n"
         " 2)  3  0008  4  ERROR 00 19 08 08 \n"
         " 3)  4  FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT\n 4)  5  0100  3  RTR\n", [0],
         "left out: 1 error frame, 1 other event, 1 remote frame"),
        ("a.trc", VERSION.format(1.2) + " 1)  0.0  1  Rx  0500  8  07 00 BC 3A 12 FF 1F 00\n"
         " 2)  9.2  1  Error  0008  4  00 19 08 08\n 3)  9.3  2  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT\n",
         [STARTED],          f"left out: 1 error frame, 1 other event; {UNZONED}"),
        ("a.csv", CSV + CSV_ROW + "1.0002,0x500,0,0,0,5,BwECMAA=", [1, 1.0002], ""),
        ("a.csv", CSV + CSV_ROW + "1.0002,0x500,0,0,0,5,BwEC", [1], "its end is cut off"),
        ("a.csv", CSV + CSV_ROW + "1.0002,0x500,0,0,0,5,BwECMAA", [1], "its end is cut off"),
        ("a.csv", CSV + CSV_ROW + "1.0002,0x500,0,0,0,5,BwEC\n", [1],
         "left out: 1 cut-off message"),
    ],
)  # fmt: skip
def test_a_log_is_read_as_it_was_meant_and_what_is_no_message_is_counted(tmp_path, name, content, times, also):
    recording, messages = after(tmp_path / name, content)
    assert [each.time for each in messages] == pytest.approx(times)
    assert [each[1:] for each in messages] == [
        (0x500, (FIRST, SECOND)[n % 2], False, False) for n in range(len(times))
    ]
    steps = ", with 1 step of their clock" * (times != sorted(times))
    assert recording.summary() == f"{len(times)} messages{steps}" + (f" ({also})" if also else "")


@pytest.mark.parametrize(
    ("switched", "flags", "fd"), [(0, "303000", True), (0, "300000", False), (1, "300000", True)]
)
def test_a_classic_frame_on_a_can_fd_channel_of_asc_stays_classic(tmp_path, switched, flags, fd):
    _, (message,) = after(tmp_path / "a.asc", HEAD + FD_LINE.format("0.1", switched, flags))
    assert message == (0.1, 0x500, FIRST, False, fd)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", CSV + CSV_ROW + "1.0002,0x500,0,0,0,5,BwECMAA=\n"),
        ("a.trc", TRC.format("1F\r\n").replace("Rx  ", "")),
        ("a.trc", VERSION.format(1.1) + TRC.format("1F\n")),
        ("a.trc", VERSION.format(1.3) + TRC.format("1F\n").replace("Rx  0500", "1  Rx  0500  -")),
        ("a.trc", VERSION.format(2.1) + " 1 0.0 DT 1 0500 Rx - 8 07 00 BC 3A 12 FF 1F 00\n"
         " 2 0.5 FD 1 18FF0500 Rx - 9 01 02 03 04 05 06 07 08 09 0A 0B 0C\n"),
        ("a.log", TWO + "(1.1) can0 18FF0500##101020304\n"),
        ("a.asc", HEAD + ASC.format("0.0", "0.0002") + FD_LINE.format("0.1", 1, "303000")),
    ],
)  # fmt: skip
def test_of_a_file_cut_anywhere_only_whole_messages_are_taken(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content, newline="")
    complete, begun = list(read(path)), content.index("500")
    for at in range(begun, len(content)):
        path.write_text(content[:at], newline="")
        messages, cause = list[Message](), EOFError()
        try:
            messages.extend(read(path))
        except ConfigError as error:
            cause = error.__cause__
        assert isinstance(cause, EOFError)
        assert messages == complete[: len(messages)]
        assert len(messages) >= content[:at].count("\n", begun)


def test_can_fd_lines_of_old_versions_of_asc_are_read(tmp_path):
    line = " 0.1 CANFD 1  {}  Tx   1 0 {} 8  Length = 200000 BitCount = 128 ID = 257\n"
    data = " ".join(f"{each:02X}" for each in FIRST)
    content = HEAD + line.format("101", f"d 8 8 {data}").replace("8  L", " L") + line.format("100", "r")
    recording, messages = after(tmp_path / "a.asc", content)
    assert messages == [(0.1, 0x101, FIRST, False, True)]
    assert recording.summary() == "1 messages (left out: 1 remote frame)"


def test_numbers_of_a_decimal_asc_are_decimal(tmp_path):
    line = " 0.1 1 {} Rx d 3 7 255 16\n"
    _, messages = after(
        tmp_path / "a.asc", "base dec timestamps absolute\n" + line.format(1280) + line.format("70000x")
    )
    assert [each[1:4] for each in messages] == [(1280, b"\x07\xff\x10", False), (70000, b"\x07\xff\x10", True)]


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.log", "  can0  500   [8]  07 00 BC 3A 12 FF 1F 00\n", "it is what candump .*: record with candump -l"),
        ("a.txt", " (1700000000.1)  can0  500   [8]  07 00\n", "it is what candump .*: record with candump -l"),
        ("a.log", " (1700000000.1)  can0  RX - -  500   [8]  07 00\n", "record with candump -l"),
        ("a.log", "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n", "it is BUSMASTER's log: convert it"),
        ("a.csv", "Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n1,500,false,Rx,0,1,07,\n", "it is SavvyCAN's CSV"),
        ("a.crtd", "1542473901.020305 1R11 500 07 00\n", "it is OVMS's CRTD: convert it"),
        ("a.txt", "Timestamp: 1700000000.1    ID: 0500    S Rx    DL:  8\n", "it is what python-can prints"),
        ("a.txt", TWO, "it is candump's log: name it with .log$"),
        ("a.log", HEAD, "it is Vector's .asc: name it with .asc$"),
        ("a.csv", "time;id;data\n1;2;3\n", "a .csv must begin with python-can's .* not 'time;id;data': give"),
        ("a.log", gzip.compress(TWO.encode(), mtime=0), "it is packed by gzip: name it with .gz at the end"),
        ("a.pcap", b"\xd4\xc3\xb2\xa1\x02\0\x04\0", "it is a capture of Wireshark or tcpdump: record"),
        ("a.trc", VERSION.format("3.0"), "its version 3.0 is none of 1.0, 1.1, 1.2, 1.3, 2.0, 2.1: save"),
        ("a.trc", VERSION.format("1.1") + "nonsense\n", "is no number|is not a number: give a recording"),
    ],
)  # fmt: skip
def test_a_file_of_another_tool_is_named_in_one_line(tmp_path, name, content, reason):
    with pytest.raises(ConfigError, match=reason):
        after(tmp_path / name, content)


@pytest.mark.parametrize("name", ["a.v1.2.log", "a.v1.log.gz", "A.B.LOG.GZ"])
def test_a_name_may_have_dots(tmp_path, name):
    content = gzip.compress(TWO.encode()) if name.lower().endswith(".gz") else TWO
    assert len(after(tmp_path / name, content)[1]) == 2


def test_channels_are_those_of_the_file(tmp_path):
    rows = "".join(f" {n}) {n}.0 {n} Rx 0500 - 1 0{n}\n" for n in (1, 2))
    (tmp_path / "a.trc").write_text(";$FILEVERSION=1.3\n" + rows)
    for name in ("a.blf", "a.asc"):
        with can.Logger(tmp_path / name) as writer:
            for channel in (0, 1):
                writer(can.Message(1.6e9 + channel, 0x500, is_extended_id=False, data=b"1", channel=channel))
    for name in ("a.trc", "a.blf", "a.asc"):
        with pytest.raises(ConfigError, match="comes from channel 1 and from channel 2, and their"):
            list(Recording(tmp_path / name, frozenset({(0x500, False)})))


def test_times_of_vectors_and_peaks_tools_are_doubted_and_a_blf_without_an_end_is_refused(tmp_path):
    path = tmp_path / "a.blf"
    with can.Logger(path) as writer:
        writer(MESSAGES[0])
    content = bytearray(path.read_bytes())
    content[8:12] = 2, 12, 0, 0  # CANoe
    recording, _ = after(path, bytes(content))
    assert recording.summary() == f"1 messages ({UNZONED})"
    head = content[:144] + struct.pack("<4sHHIIH6xI4x", b"LOBJ", 16, 1, 64, 10, 0, 32)
    with pytest.raises(ConfigError, match="an object has 0 bytes"):
        after(path, bytes(head) + struct.pack("<4sHHII", b"LOBJ", 32, 1, 0, 1) + bytes(16))


def test_objects_of_a_blf_file_that_are_in_no_container_are_read(tmp_path):
    path = tmp_path / "a.blf"
    with can.BLFWriter(path, compression_level=0) as writer:
        for each in MESSAGES:
            writer(each)
    content = path.read_bytes()
    packed, (single, messages) = list(Recording(path)), after(path, content[:144] + content[144 + 32 :])
    assert messages == packed
    assert single.summary() == "6 messages (left out: 1 error frame, 1 remote frame)"


def test_a_wide_id_of_asc_is_of_29_bits_without_its_x_too(tmp_path):
    _, (message,) = after(tmp_path / "a.asc", HEAD + " 0.1 1 18EBFF00 Rx d 1 07\n")
    assert message == (0.1, 0x18EBFF00, b"\x07", True, False)


@pytest.mark.parametrize(("started", "hours"), [(45244.5, 1), (45122.5, 2)])  # in winter and in summer
def test_times_of_a_zone_that_is_given_are_moved_to_utc(tmp_path, started, hours):
    path = tmp_path / "a.trc"
    path.write_text(VERSION.format(1.1).replace("45244.5", str(started)) + TRC.format("00\n"))
    recording = Recording(path, zone="Europe/Berlin")
    local = STARTED + (started - 45244.5) * 86400
    assert [each.time for each in recording] == pytest.approx(
        [local - hours * 3600, local - hours * 3600 + 0.0002]
    )
    assert recording.summary() == "2 messages (its times were of Europe/Berlin)"
    path = tmp_path / "a.log"
    path.write_text(TWO)
    assert [each.time for each in Recording(path, zone="Europe/Berlin")] == [1, 1.0002]


def test_a_mistyped_database_is_not_made_and_one_without_messages_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"gone.db: No such file"):
        list(Recording(tmp_path / "gone.db"))
    assert not list(tmp_path.iterdir())
    with sqlite3.connect(tmp_path / "a.db") as database:
        database.execute("CREATE TABLE poses (x)")
    database.close()
    with pytest.raises(
        ConfigError, match="it has no table 'messages', only poses: give a database that python-can"
    ):
        list(Recording(tmp_path / "a.db"))


MESSAGES = [
    can.Message(1.6e9 + n / 8, id_, data=bytes(range(n)), is_extended_id=extended, channel=n % 2, **kind)
    for n, (id_, extended, kind) in enumerate([
        (0x500, False, {}), (0x12345, True, {}), (0x7, False, {}), (0x0, True, {"is_remote_frame": True}),
        (0x1FFFFFFF, True, {}), (0x0, False, {"is_error_frame": True}), (0x501, False, {}), (0x6, False, {}),
    ])
]  # fmt: skip
LONG = [can.Message(1.6e9 + 2 + n, 0x502, is_fd=True, data=bytes(n), channel=0) for n in (1, 8, 12, 64)]
EXTRA = {
    "us.asc": "date Sat Sep 30 10:06:13.191 PM 2017\nbase hex timestamps absolute\n"
    "internal events logged\nBegin TriggerBlock Sat Sep 30 10:06:13.191 PM 2017\n"
    " 0.000 Start of measurement\n 17.87 1 6F8 Rx d 8 FF 00 0C FE 00 00 00 00 Length = 239910 BitCount = 124\n"
    " 18.0 1 2A Tx d D 55 AA 01 02 03 04 05 06 Length = 2\n 18.1 2 J1939TP FEE3p 6 0 0 - Rx d 2 A0 0F\n"
    + FD_LINE.format("30.0", "Generic_Name 1", "303000") + "End TriggerBlock\n",
    "old.trc": ";##\n 1) 17535 00000100 8 00 01 02 03 04 05 06 07\n 2) 17540 FFFFFFFF 4 00 00 00 08 BUSHEAVY\n"
    " 3) 19295 0000 0\n 4) 48937 0704 1 RTR\n",
    "crlf.log": TWO.replace("\n", "\r\n") + "(1.1) can0 7DF##3ab00 T\r\n(1.1) can0 20000088#0000\r\n",
    "vcan.log": "(1609779922.655421) vcan1 001#\n(1609779922.7) 7 18FF00AB#0102 R\n(1609779922.8) can0 FFF##1"
    + 64 * "5A" + " T\n(1609779922.8) can0 00000123##0aB\n (1609779922.9)  can0   123#1122\n\n"
    "(1609779923.0) can0 123#R8 T\n(1609779923) can0 12345#11 r\n(1609779923.5) can0 1#1213\n",
}  # fmt: skip


ROOT = Path(__file__).parents[2]
OURS = [str(each) for folder in ("tactiled/recordings", "tests") for each in (ROOT / folder).rglob("*.log")]


@pytest.mark.parametrize(
    "name", ["a.log", "a.asc", "a.blf", "a.csv", "a.trc", "a.db", "a.log.gz", "a.asc.gz", *EXTRA, *OURS]
)
def test_a_file_that_python_can_reads_right_is_read_alike(tmp_path, name):
    path = tmp_path / name
    if name in OURS:
        pass
    elif name in EXTRA:
        path.write_bytes(EXTRA[name].encode())
    else:
        with can.Logger(path) as writer:
            for each in MESSAGES + (LONG if name[2:5] in ("log", "asc", "blf") else []):
                writer(each)
    with can.LogReader(path) as log:
        expected = [
            (each.timestamp, each.arbitration_id, bytes(each.data), each.is_extended_id, each.is_fd)
            for each in log if not (each.is_error_frame or each.is_remote_frame)
        ]  # fmt: skip
    recording = Recording(path)
    assert list(recording) == expected
    assert len(expected) == {"us": 3, "old": 2, "crlf": 3, "vcan": 7}.get(name.split(".")[0], len(expected)) > 1
    assert UNZONED not in recording.summary()
