"""Lines of text logs as messages: candump's .log, Vector's .asc, PEAK's .trc and python-can's .csv."""

import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from tactiled.bus.canbus import CanMessage, dlc2len, formats
from tactiled.frames import Message

Logged = tuple[str, Message] | CanMessage  # of a channel; or as python-can has it
ERROR_FRAME, REMOTE_FRAME, XL_FRAME = "error frame", "remote frame", "CAN XL frame"
DROPPED, CUT, UNREADABLE = "dropped message", "cut-off message", "unreadable line"
EVENT, REQUEST, ZEROED = "other event", "transmit request", "zeroed line"
LAST_LINE_CUT = "its last line is cut off"
LOCAL_TIME = "its times are of an unknown time zone, taken for UTC"
MAX_CLASSIC_BYTES = 8
MAX_STANDARD_ID = 0x7FF
BYTES = "((?:[0-9A-Fa-f]{2}){0,8})|(#)[0-9A-Fa-f]((?:[0-9A-Fa-f]{2}){0,64})"  # classic; FD
CANDUMP_LINE = re.compile(
    rf"\(([0-9]+\.[0-9]+)\) ([^\s]+) ([0-9A-Fa-f]{{3}}|[01][0-9A-Fa-f]{{7}})#(?:{BYTES})(?: [RT])?\n"
)
CANDUMP_FIELDS = re.compile(r"\(([^\s()]+)\)\s+(\S+)\s+([0-9A-F]{1,8})#(\S*)(?:\s+[RT])?", re.IGNORECASE)
CANDUMP_DATA = re.compile(rf"(?:{BYTES})(?:_[9A-F])?", re.IGNORECASE)  # with a raw DLC above 8
CANDUMP_DROPS = re.compile(r"DROPCOUNT: dropped ([0-9]+) CAN frame")
CANDUMP_OTHERS = (
    (re.compile(r"R[0-9]*(_[9A-F])?", re.IGNORECASE), REMOTE_FRAME),
    (re.compile(r"#?([0-9A-F]{2})*[0-9A-F]", re.IGNORECASE), CUT),
    (re.compile(r"[0-9A-F]+:[0-9A-F]+:[0-9A-F]+#[0-9A-F.]*", re.IGNORECASE), XL_FRAME),
)
BOM = "\ufeff"  # at the beginning of each of several files that became one
ERROR_FLAG = 0x20000000  # in an id, as SocketCAN marks an error frame
NUMBER = re.compile(r"-?[0-9]+([.,][0-9]+)?")
ASC_HEAD = re.compile(r"//|(date|base|(no )?internal|begin|end|previous)\b", re.IGNORECASE)
ASC_START = re.compile("start|stop|beginn?|ende?", re.IGNORECASE)  # of the measurement: nothing else happened
ASC_DIRECTIONS = {"rx", "tx", "txrq"}
FD_FORMAT, REMOTE = 0x1000, 0x10  # bits of the flags in a CANFD line of .asc
TRC_COLUMNS = {
    "1.0": "NOIlD", "1.1": "NOdIlD", "1.2": "NOBdIlD", "1.3": "NOBdIRlD", "2.0": "NOTIdlD", "2.1": "NOTBIdRLD",
}  # fmt: skip  # as $COLUMNS names them
TRC_MESSAGES = {"Rx", "Tx", "DT", "FD", "FB", "FE", "BI"}
TRC_OTHERS = {"RR": REMOTE_FRAME, "ER": ERROR_FRAME, "Error": ERROR_FRAME}
TRC_DATA = {"RTR": REMOTE_FRAME, "ERROR": ERROR_FRAME}  # in the place of the first byte
TRC_FD = {"FD", "FB", "FE", "BI"}
TRC_NO_ID = "FFFFFFFF"  # of a warning
TRC_EPOCH = datetime(1899, 12, 30, tzinfo=UTC)
CSV_HEAD = "timestamp,arbitration_id,extended,remote,error,dlc,data"


@dataclass(slots=True)
class Remarks:
    """What a recording has besides whole data frames, as far as it was read."""

    left_out: Counter[str] = field(default_factory=Counter)  # by kind, in the singular
    caveats: list[str] = field(default_factory=list)


class FormatError(ValueError):
    """A file that is no recording, or not as its name says; the text says what to do."""


class NoFrameError(Exception):
    """A line that is no whole data frame: `kind`, as Remarks counts it, and how often."""

    def __init__(self, kind: str, count: int = 1) -> None:
        super().__init__(kind)
        self.kind, self.count = kind, count


def candump(lines: Iterable[str], remarks: Remarks) -> Iterator[Logged]:
    """Data frames as candump and python-can write them; ValueError for a line that does not begin with a time."""
    for line in lines:
        if match := CANDUMP_LINE.fullmatch(line):
            time, channel, id_, classic, fd, data = match.groups()
            data = bytes.fromhex(data if fd else classic)
            yield channel, Message(float(time), int(id_, 16), data, len(id_) > 3, fd is not None)
        elif text := line.strip().lstrip(BOM):
            try:
                yield _candump(text)
            except NoFrameError as fault:
                remarks.left_out[fault.kind] += fault.count


def _candump(text: str) -> Logged:
    """The message of any line; NoFrameError or ValueError where there is none."""
    if match := CANDUMP_DROPS.match(text):
        raise NoFrameError(DROPPED, int(match[1]))
    if (match := CANDUMP_FIELDS.fullmatch(text)) is None:
        if text.startswith("#") or (text.startswith("(") and "#" in text):
            raise NoFrameError(UNREADABLE)
        raise ValueError(f"{text[:40]!r} is no line of candump's log")
    time, channel, id_, body = match.groups()
    if len(id_) > 3 and int(id_, 16) & ERROR_FLAG:
        raise NoFrameError(ERROR_FRAME)
    if (match := CANDUMP_DATA.fullmatch(body.replace(".", ""))) is None:
        raise NoFrameError(next((kind for pattern, kind in CANDUMP_OTHERS if pattern.fullmatch(body)), UNREADABLE))
    data = bytes.fromhex(match[1] or match[3] or "")
    return channel, Message(float(time), int(id_, 16), data, len(id_) > 3, match[2] is not None)


def asc(lines: Iterable[str], remarks: Remarks) -> Iterator[Logged]:
    """Data frames of Vector's .asc, timed from the start of the measurement, or from an earlier first line."""
    base, since_last, now, shift = 16, False, 0.0, -1.0
    for line in lines:
        words = line.split()
        if not words:
            continue
        if NUMBER.fullmatch(words[0]):
            now = _number(words[0]) + (now if since_last else 0.0)
            if shift < 0:
                shift = max(0.0, -now)
                if shift:
                    remarks.caveats.append(f"its times count from its first line, {shift:g} s before the trigger")
            try:
                yield _asc(words[1:], base, now + shift)
            except NoFrameError as fault:
                remarks.left_out[fault.kind] += fault.count
        elif words[0].lower() == "base":
            base, since_last = 10 if "dec" in line.lower() else 16, "relative" in line.lower()
        elif not ASC_HEAD.match(" ".join(words)):
            remarks.left_out[UNREADABLE] += 1


def _asc(words: list[str], base: int, time: float) -> Logged:
    """The message of a line behind its time; NoFrameError where there is none."""
    bus, *words = words or [""]
    fd = bus.upper() == "CANFD"
    if fd:
        bus, *words = words or [""]
        if words[:1] and words[0].lower() in ASC_DIRECTIONS:  # since version 8.1 before the id
            words[:2] = words[1::-1]
        elif "r" in (kind := [each.lower() for each in words[4:5]]):
            raise NoFrameError(REMOTE_FRAME)
        elif "d" in kind:
            del words[4]
    if not bus.isdigit():
        raise NoFrameError(XL_FRAME if bus.upper() == "CANXL" else EVENT, int(not ASC_START.match(bus)))
    if "errorframe" in (each.lower() for each in words[:2]):
        raise NoFrameError(ERROR_FRAME)
    if len(words) < 3 or words[1].lower() not in ASC_DIRECTIONS:
        raise NoFrameError(EVENT)
    if words[1].lower() == "txrq":  # what is sent comes once more, as Tx
        raise NoFrameError(REQUEST)
    id_ = words[0].lower()
    try:
        number = int(id_.removesuffix("x"), base)
        data, fd = _asc_fd(words[2:], base) if fd else (_asc_classic(words[2:], base), False)
    except (ValueError, IndexError):
        raise NoFrameError(UNREADABLE) from None
    return bus, Message(time, number, data, id_.endswith("x") or number > MAX_STANDARD_ID, fd)


def _asc_classic(words: list[str], base: int) -> bytes:
    """Data of what stands behind the direction."""
    if words[0].lower() == "r":
        raise NoFrameError(REMOTE_FRAME)
    length = min(int(words[1], base), MAX_CLASSIC_BYTES)
    return _data(words[2 : 2 + length], length, base)


def _asc_fd(words: list[str], base: int) -> tuple[bytes, bool]:
    """Data of a CANFD line, and whether it is a CAN FD frame: classic ones of such a channel are in it, too."""
    if not words[0].isdigit():
        del words[0]  # a symbolic name
    switched, _, _, length, *rest = words
    data = _data(rest[: int(length)], int(length), base)
    more = rest[len(data) :]  # since version 8.1 duration, length, flags and others
    flags = int(more[2], 16) if len(more) > 2 and more[0].isdigit() else FD_FORMAT
    if flags & REMOTE:
        raise NoFrameError(REMOTE_FRAME)
    return data, bool(flags & FD_FORMAT) or switched == "1" or len(data) > MAX_CLASSIC_BYTES


def _data(words: list[str], length: int, base: int = 16) -> bytes:
    """Bytes that are written one by one; NoFrameError where some are missing."""
    if len(words) < length:
        raise NoFrameError(CUT)
    return bytes([int(each, base) for each in words])


def trc(lines: Iterable[str], remarks: Remarks) -> Iterator[Logged]:
    """Data frames of PEAK's .trc of any version; ValueError for a line that is none, EOFError for half of one."""
    columns, start, zone_known = TRC_COLUMNS["1.0"], 0.0, False
    for line in lines:
        text = line.strip()
        if text.startswith(";"):
            key, _, value = text.partition("=")
            if key == ";$FILEVERSION":
                columns = _trc_columns(value.strip())
            elif key == ";$STARTTIME":
                start = (TRC_EPOCH + timedelta(days=_number(value.strip()))).timestamp()
            elif key == ";$COLUMNS":
                columns = "".join(value.split(","))
            zone_known = zone_known or "by python-can" in text  # which writes UTC
        elif text:
            if start and not zone_known:
                zone_known = True
                remarks.caveats.append(LOCAL_TIME)
            try:
                yield _trc(dict(zip(columns, text.split(maxsplit=len(columns) - 1), strict=False)), start)
            except (NoFrameError, ValueError) as fault:
                _left_out(fault, line, remarks)


def _left_out(fault: NoFrameError | ValueError, line: str, remarks: Remarks) -> None:
    """Count a line that gave no frame; raise its ValueError, or EOFError where it is half the file's last one."""
    kind = fault.kind if isinstance(fault, NoFrameError) else CUT
    if kind in (CUT, EVENT) and not line.endswith("\n"):
        raise EOFError(LAST_LINE_CUT) from fault
    if isinstance(fault, ValueError):
        raise fault
    remarks.left_out[kind] += fault.count


def _trc_columns(version: str) -> str:
    if version not in TRC_COLUMNS:
        raise FormatError(
            f"its version {version[:40]} is none of {', '.join(TRC_COLUMNS)}: save it as one of these"
        )
    return TRC_COLUMNS[version]


def _trc(row: dict[str, str], start: float) -> Logged:
    """The message of one line's columns, named as in $COLUMNS; NoFrameError where there is none."""
    time, kind = _number(row.get("O", "")) / 1000 + start, row.get("T", row.get("d", "Rx"))
    id_, data = row.get("I", ""), row.get("D", "").split()
    if kind not in TRC_MESSAGES or id_ == TRC_NO_ID:
        raise NoFrameError(TRC_OTHERS.get(kind, EVENT))
    if data and data[0] in TRC_DATA:
        raise NoFrameError(TRC_DATA[data[0]])
    length = row.get("l") or row.get("L")
    if not length:
        raise NoFrameError(CUT)
    count = min(int(length), MAX_CLASSIC_BYTES) if kind not in TRC_FD else int(length)
    count = dlc2len(count) if "L" in row else count
    if any(len(each) != 2 for each in data[:count]):
        raise NoFrameError(CUT)
    fields = int(id_, 16), _data(data[:count], count), len(id_) > 4, kind in TRC_FD
    return row.get("B", "1"), Message(time, *fields)


def csv(lines: Iterable[str], remarks: Remarks) -> Iterator[Logged]:
    """Messages of python-can's own .csv; FormatError for any other table, EOFError where its end is cut off."""
    lines = iter(lines)
    head = next(lines, CSV_HEAD).strip()
    if re.sub("[ _]", "", head).lower() != CSV_HEAD.replace("_", ""):  # it had other spaces once
        raise FormatError(
            f"a .csv must begin with python-can's {CSV_HEAD!r}, not {head[:40]!r}: give another format"
        )
    for line in lines:
        if line.strip():
            try:
                (message,) = formats.CSVReader(io.StringIO(f"{CSV_HEAD}\n{line}"))
                if len(message.data) < message.dlc and not message.is_remote_frame:
                    raise NoFrameError(CUT)
                yield message
            except (NoFrameError, ValueError) as fault:
                _left_out(fault, line, remarks)


def _number(text: str) -> float:
    """A number; ValueError where it is none. Some locales write a comma."""
    if not NUMBER.fullmatch(text):
        raise ValueError(f"{text[:40]!r} is not a number")
    return float(text.replace(",", "."))
