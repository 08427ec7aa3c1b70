"""Which skins speak on a bus, from what was heard of it; pure."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from tactiled.bus.assemble import Assembler
from tactiled.bus.codecs import Codec, barrett, cyskin, icub, linker, packed, poweron, xela
from tactiled.errors import CodecError
from tactiled.frames import Message, RawFrame

Key = tuple[int, bool]  # id, extended
Traffic = Mapping[Key, list[Message]]
BITS = range(8, 17)  # a taxel, in the packed layout
USUAL = 12
SETTLED = 8  # frames, in which the beginning of one without sequence numbers is learned


@dataclass(frozen=True, slots=True)
class Found:
    """One array that was recognised."""

    codec: dict[str, Any]  # as a configuration has it
    made: Codec
    keys: tuple[Key, ...]
    shape: tuple[int, int] | None  # rows, columns; None where the codec knows its taxels' places
    says: str  # what it is, in one phrase
    doubts: tuple[str, ...] = ()  # what could not be heard
    frames: int = 0  # whole ones
    rate_hz: float = 0.0  # frames a second
    lost: int = 0  # messages
    no_load: int = 0  # median count of a taxel: its rest, where most of the array was not touched


class Other(NamedTuple):
    """Messages that belong to no known skin."""

    id: int
    extended: bool
    messages: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class Heard:
    """What was on the bus."""

    found: tuple[Found, ...] = ()
    others: tuple[Other, ...] = ()


def recognise(messages: Iterable[Message]) -> Heard:
    """Every known skin in what was heard, and the rest by id."""
    left: dict[Key, list[Message]] = {}
    for each in messages:
        left.setdefault((each.id, each.extended), []).append(each)
    found: list[Found] = []
    for look in RECOGNISERS:
        for one in tuple(look(left)):
            if not all(key in left for key in one.keys):
                continue  # another has them
            mine = sorted((m for key in one.keys for m in left.pop(key)), key=lambda each: each.time)
            found.append(_measured(one, mine))
    others = (Other(*key, len(each), _rate([m.time for m in each])) for key, each in left.items())
    return Heard(tuple(found), tuple(sorted(others, key=lambda each: -each.messages)))


def _rate(times: Sequence[float]) -> float:
    span = max(times, default=0.0) - min(times, default=0.0)
    return (len(times) - 1) / span if span > 0 else 0.0


def _frames(codec: Codec, messages: Iterable[Message]) -> tuple[list[RawFrame], int]:
    """The frames in messages, and how many messages were lost behind the first few of them."""
    assembler = Assembler(codec)
    frames: list[RawFrame] = []
    for message in messages:
        try:
            frames += assembler.push(codec.decode(message))
        except CodecError:
            continue
    return frames, assembler.loss.lost - frames[:SETTLED][-1].loss.lost if frames else 0


def _whole(frames: Iterable[RawFrame]) -> list[RawFrame]:
    return [each for each in frames if not each.flags.any()]


def _measured(one: Found, messages: list[Message]) -> Found:
    """With its rate, its losses and its counts."""
    frames, lost = _frames(one.made, messages)
    whole = _whole(frames)
    no_load = int(np.median([each.counts for each in whole])) if whole else 0
    rate = _rate([each.time for each in frames[1:]])  # the first may have begun before we listened
    return replace(one, frames=len(whole), rate_hz=rate, lost=lost, no_load=no_load)


def _means(codec: Codec, messages: Iterable[Message]) -> bool:
    """Whether a codec knows what to make of every one of some messages."""
    try:
        for each in messages:
            codec.decode(each)
    except CodecError:
        return False
    return True


def _standard(left: Traffic, ids: Iterable[int]) -> tuple[Key, ...]:
    """Those of some 11-bit ids that were heard."""
    return tuple((each, False) for each in ids if (each, False) in left)


def _all(left: Traffic, keys: Iterable[Key]) -> list[Message]:
    return [each for key in keys for each in left[key]]


def find_icub(left: Traffic) -> Iterator[Found]:
    """ICub MTB boards: heads and tails by triangle."""
    for kind, age in ((icub.PERIODIC, "class 0x400"), (icub.OLD, "class 0x300, an older board")):
        for board in range(16):
            keys = tuple(
                key
                for key in _standard(left, (kind | board << 4 | triangle for triangle in range(16)))
                if {each.data[0] for each in left[key] if each.data} == {icub.HEAD, icub.TAIL}
            )
            triangles = tuple(id_ & 0xF for id_, _ in keys)
            codec = icub.Icub(board, triangles)
            if keys and _means(codec, _all(left, keys)):
                yield Found(
                    {"name": "icub", "board": board, "triangles": list(triangles)},
                    codec,
                    keys,
                    None,
                    f"iCub MTB, {age}, board {board}, triangles {', '.join(map(str, triangles))}",
                    ("thermal_pads: false where pads 6 and 10 are taxels too, as on a fingertip",),
                )


def find_barrett(left: Traffic) -> Iterator[Found]:
    """BarrettHand pads: five messages on one id, in turn."""
    for node in range(32):
        keys = _standard(left, (barrett.FULL | node << 5,))
        codec = barrett.Barrett(node)
        if keys and _means(codec, left[keys[0]]) and len({each.data[0] >> 4 for each in left[keys[0]]}) == 5:
            doubt = "array: 8 x 3 is a fingertip's; the palm has positions of its own"
            yield Found(
                {"name": "barrett", "node": node}, codec, keys, (8, 3), f"BarrettHand pad, node {node}", (doubt,)
            )


def find_cyskin(left: Traffic) -> Iterator[Found]:
    """CySkin: four ids, as often as one another."""
    codec = cyskin.CySkin()
    keys = _standard(left, sorted(id_ for id_, _ in codec.ids))
    if len(keys) == codec.segments and _even(left, keys) and _means(codec, _all(left, keys)):
        doubt = "array: 4 x 4 stands for the 16 taxels: give their positions_mm"
        yield Found({"name": "cyskin"}, codec, keys, (4, 4), "CySkin finger", (doubt,))


def find_linker(left: Traffic) -> Iterator[Found]:
    """LinkerHand: rows of its fingers, as replies to somebody's requests."""
    for hand, id_ in linker.HANDS.items():
        keys = _standard(left, (id_,))
        rows = [m for m in _all(left, keys) if len(m.data) == 8 and m.data[0] - linker.FINGER in range(1, 6)]
        fingers = tuple(sorted({each.data[0] - linker.FINGER for each in rows}))
        codec = linker.Linker("right" if hand == "right" else "left", fingers)
        if rows and len({each.data[1] >> 4 for each in rows}) == linker.ROWS and _means(codec, rows):
            settings = {"name": "linker", "hand": hand, "fingers": list(fingers)}
            said = f"LinkerHand, {hand} hand, fingers {', '.join(map(str, fingers))}, polled by another node"
            yield Found(settings, codec, keys, (linker.ROWS * len(fingers), linker.COLUMNS), said)


def find_poweron(left: Traffic) -> Iterator[Found]:
    """PowerON TouchDetect: twelve ids in a row, as often as one another, their last bytes never changing."""
    segments = poweron.PowerOn().segments
    for id_, extended in sorted(left):
        keys = _standard(left, range(id_, id_ + segments))
        if extended or len(keys) != segments or not _even(left, keys) or id_ > 0x7F4:
            continue
        messages = _all(left, keys)
        codec = poweron.PowerOn(id_)
        constant = len({each.data[poweron.USED :] for each in messages}) == 1
        if (
            constant
            and all(each.data[4] < 16 for each in messages if len(each.data) > 4)
            and _means(codec, messages)
        ):
            yield Found(
                {"name": "poweron", "base_id": id_}, codec, keys, (6, 6), f"PowerON TouchDetect at {id_:#x}"
            )


def find_xela(left: Traffic) -> Iterator[Found]:
    """XELA uSkin: a message a taxel, in one of its id schemes, the largest of the older ones first."""
    for profile, ids in sorted(xela.OLDER.items(), key=lambda each: -len(each[1])):
        codec = xela.Xela(profile)
        keys = _standard(left, ids)
        if len(keys) == len(ids) and _is_xela(codec, _all(left, keys)):
            width = 6 if profile == "4x6-old" else 4
            said = f"XELA uSkin, older ids ({profile})"
            yield Found({"name": "xela", "profile": profile}, codec, keys, (len(ids) // width, width), said)
    for controller in range(16):
        heard = [id_ for id_, extended in left if not extended and id_ & 0xF == controller]
        taxels = [id_ for id_ in heard if _status(left[id_, False])]
        rows = tuple(sorted({id_ >> 8 for id_ in taxels}, reverse=True))
        columns = tuple(sorted({id_ >> 4 & 0xF for id_ in taxels}, reverse=True))
        codec = xela.Xela("current", controller, rows, columns)
        keys = _standard(left, sorted(id_ for id_, _ in codec.ids))
        if len(keys) == codec.size >= 4 and _is_xela(codec, _all(left, keys)):
            yield Found(
                {"name": "xela", "controller": controller, "rows": list(rows), "columns": list(columns)},
                codec,
                keys,
                (len(rows), len(columns)),
                f"XELA uSkin, microcontroller {controller}, SDAs {', '.join(map(str, rows))}",
                ("rows, columns: as on the 4 x 6 module with its connector on the left",),
            )


def _status(messages: Sequence[Message]) -> bool:
    return all(len(each.data) == 8 and each.data[0] & 0xEF == xela.STATUS for each in messages)


def _is_xela(codec: Codec, messages: Sequence[Message]) -> bool:
    return _status(messages) and _means(codec, messages)


def _even(left: Traffic, keys: Iterable[Key]) -> bool:
    """Whether ids are heard as often as one another, but for what was cut at the ends or lost."""
    counts = [len(left[key]) for key in keys]
    return max(counts) - min(counts) <= 2 + 0.1 * max(counts)


class Fit(NamedTuple):
    """A width of the taxels that nothing heard speaks against."""

    bits: int
    least: int  # taxels, fewest and most
    most: int
    roughness: float  # mean step from taxel to taxel over full scale: small where the width is right


def find_packed(left: Traffic) -> Iterator[Found]:
    """The packed layout: sequence numbers and segments that count up."""
    for key, messages in left.items():
        if not _counts_up(messages):
            continue
        fits = packed_fits(key, messages)
        if not fits:
            continue
        best = likeliest(fits)
        rows, columns = shape(best.least, best.most)
        id_, extended = key
        near = not extended and 0x500 <= id_ <= 0x50F
        where = {"base_id": 0x500, "array_id": id_ - 0x500} if near else {"base_id": id_, "array_id": 0}
        settings: dict[str, Any] = {**where, "extended": extended, "bits": best.bits, "fd": messages[0].fd}
        kind = "CAN FD" if messages[0].fd else "classic"
        others = ", ".join(f"{each.bits} ({_many(each)})" for each in fits if each.bits != best.bits)
        yield Found(
            {"name": "packed"} | settings,
            packed.Packed(rows * columns, **settings),
            (key,),
            (rows, columns),
            f"packed layout, {kind}, array {where['array_id']} at {where['base_id']:#x}, {best.bits} bits a taxel",
            (f"array: {_many(best)} taxels fit, {rows} x {columns} is the squarest",)
            + (
                (f"bits: nothing speaks against {others} taxels either, but steps are largest there",)
                if others
                else ()
            ),
        )


def _many(fit: Fit) -> str:
    return f"{fit.least}" if fit.least == fit.most else f"{fit.least} to {fit.most}"


def _counts_up(messages: Sequence[Message]) -> bool:
    """Whether nearly every message is what must come behind the one before it, lost ones allowed for."""
    if len(messages) < 4 or any(len(each.data) < packed.HEADER or each.fd != messages[0].fd for each in messages):
        return False
    last = max(each.data[1] for each in messages)
    if {each.data[1] for each in messages} != set(range(last + 1)):
        return False
    follows = sum(
        now.data[:2] == (bytes((was.data[0], was.data[1] + 1)) if was.data[1] < last else _next(was))
        for was, now in pairwise(messages)
    )
    return follows >= 0.8 * (len(messages) - 1)


def _next(message: Message) -> bytes:
    return bytes(((message.data[0] + 1) % 256, 0))


def packed_fits(key: Key, messages: Sequence[Message]) -> tuple[Fit, ...]:
    """Every width, with its numbers of taxels, whose lengths and padding are those of the messages."""
    segments = max(each.data[1] for each in messages) + 1
    whole = list({each.data: each for each in messages if each.data[1] < segments - 1}.values())
    last = list({each.data: each for each in messages if each.data[1] == segments - 1}.values())
    fits = []
    for bits in BITS:
        full = _packed(1, bits, key, messages[0].fd).taxels
        sizes = range((segments - 1) * full + 1, segments * full + 1)
        if whole and not _means(_packed(sizes[-1], bits, key, messages[0].fd), whole):
            continue
        good = [size for size in sizes if _means(_packed(size, bits, key, messages[0].fd), last)]
        if good:
            fits.append(
                Fit(bits, good[0], good[-1], _roughness(_packed(good[0], bits, key, messages[0].fd), messages))
            )
    return tuple(fits)


def _packed(size: int, bits: int, key: Key, fd: bool) -> packed.Packed:
    return packed.Packed(size, bits, fd, 0, *key)


def _roughness(codec: Codec, messages: Sequence[Message]) -> float:
    """Mean step from taxel to taxel of the first frames, over full scale."""
    frames = _whole(_frames(codec, messages[: 100 * codec.segments])[0])
    if not frames or codec.size < 2:
        return 0.0
    return float(np.abs(np.diff([each.counts.astype(float) for each in frames])).mean() / codec.full_scale)


def likeliest(fits: Sequence[Fit]) -> Fit:
    """The width whose images step least, the smallest of such; the usual one where nothing steps at all."""
    if all(each.roughness == 0 for each in fits):
        return next((each for each in fits if each.bits == USUAL), fits[0])
    bound = 1.25 * min(each.roughness for each in fits) + 1e-3
    return next(each for each in fits if each.roughness <= bound)


def shape(least: int, most: int) -> tuple[int, int]:
    """The squarest rows x columns with so many taxels; of equals the one with most of them."""
    sides = (
        (rows, size // rows) for size in range(least, most + 1) for rows in range(1, size + 1) if not size % rows
    )
    return min(
        ((rows, columns) for rows, columns in sides if rows <= columns),
        key=lambda each: (each[1] / each[0], -each[0] * each[1]),
    )


RECOGNISERS: tuple[Callable[[Traffic], Iterator[Found]], ...] = (
    find_packed,
    find_icub,
    find_barrett,
    find_cyskin,
    find_linker,
    find_poweron,
    find_xela,
)
