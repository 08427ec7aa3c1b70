"""Which skins speak on a bus, from what was heard of it; pure."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from tactiled.bus.assemble import assemble, whole
from tactiled.bus.codecs import Codec, barrett, cyskin, icub, linker, packed, poweron, understands, xela
from tactiled.bus.packing import Fit, counts_up, likeliest, packed_fits, shape
from tactiled.frames import Message

Key = tuple[int, bool]  # id, extended
Traffic = Mapping[Key, list[Message]]
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


def _measured(one: Found, messages: list[Message]) -> Found:
    """With its rate, its losses and its counts."""
    frames, loss = assemble(one.made, messages)
    good = whole(frames)
    no_load = int(np.median([each.counts for each in good])) if good else 0
    rate = _rate([each.time for each in frames[1:]])  # the first may have begun before we listened
    lost = loss.lost - frames[:SETTLED][-1].loss.lost if frames else 0
    return replace(one, frames=len(good), rate_hz=rate, lost=lost, no_load=no_load)


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
            if keys and understands(codec, _all(left, keys)):
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
        if keys and understands(codec, left[keys[0]]) and len({each.data[0] >> 4 for each in left[keys[0]]}) == 5:
            doubt = "array: 8 x 3 is a fingertip's; the palm has positions of its own"
            yield Found(
                {"name": "barrett", "node": node}, codec, keys, (8, 3), f"BarrettHand pad, node {node}", (doubt,)
            )


def find_cyskin(left: Traffic) -> Iterator[Found]:
    """CySkin: four ids, as often as one another."""
    codec = cyskin.CySkin()
    keys = _standard(left, sorted(id_ for id_, _ in codec.ids))
    if len(keys) == codec.segments and _even(left, keys) and understands(codec, _all(left, keys)):
        doubt = "array: 4 x 4 stands for the 16 taxels: give their positions_mm"
        yield Found({"name": "cyskin"}, codec, keys, (4, 4), "CySkin finger", (doubt,))


def find_linker(left: Traffic) -> Iterator[Found]:
    """LinkerHand: rows of its fingers, as replies to somebody's requests."""
    for hand, id_ in linker.HANDS.items():
        keys = _standard(left, (id_,))
        rows = [m for m in _all(left, keys) if len(m.data) == 8 and m.data[0] - linker.FINGER in range(1, 6)]
        fingers = tuple(sorted({each.data[0] - linker.FINGER for each in rows}))
        codec = linker.Linker("right" if hand == "right" else "left", fingers)
        if rows and len({each.data[1] >> 4 for each in rows}) == linker.ROWS and understands(codec, rows):
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
            and understands(codec, messages)
        ):
            yield Found(
                {"name": "poweron", "base_id": id_}, codec, keys, (6, 6), f"PowerON TouchDetect at {id_:#x}"
            )


def find_xela(left: Traffic) -> Iterator[Found]:
    """XELA uSkin: a message a taxel, in one of its id schemes."""
    yield from _older_xela(left)
    yield from _current_xela(left)


def _older_xela(left: Traffic) -> Iterator[Found]:
    """Its older ids, the largest array first."""
    for profile, ids in sorted(xela.OLDER.items(), key=lambda each: -len(each[1])):
        codec = xela.Xela(profile)
        keys = _standard(left, ids)
        if len(keys) == len(ids) and _is_xela(codec, _all(left, keys)):
            width = 6 if profile == "4x6-old" else 4
            said = f"XELA uSkin, older ids ({profile})"
            yield Found({"name": "xela", "profile": profile}, codec, keys, (len(ids) // width, width), said)


def _current_xela(left: Traffic) -> Iterator[Found]:
    """Its current ids: row, column and microcontroller in each."""
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
    return _status(messages) and understands(codec, messages)


def _even(left: Traffic, keys: Iterable[Key]) -> bool:
    """Whether ids are heard as often as one another, but for what was cut at the ends or lost."""
    counts = [len(left[key]) for key in keys]
    return max(counts) - min(counts) <= 2 + 0.1 * max(counts)


def find_packed(left: Traffic) -> Iterator[Found]:
    """The packed layout: sequence numbers and segments that count up."""
    for key, messages in left.items():
        fits = packed_fits(key, messages) if counts_up(messages) else ()
        if fits:
            yield _packed(key, messages[0].fd, fits)


def _packed(key: Key, fd: bool, fits: Sequence[Fit]) -> Found:
    """The array of the likeliest fit, the others told as doubts."""
    best = likeliest(fits)
    rows, columns = shape(best.least, best.most)
    id_, extended = key
    near = not extended and 0x500 <= id_ <= 0x50F
    where = {"base_id": 0x500, "array_id": id_ - 0x500} if near else {"base_id": id_, "array_id": 0}
    settings: dict[str, Any] = {**where, "extended": extended, "bits": best.bits, "fd": fd}
    says = (
        f"packed layout, {'CAN FD' if fd else 'classic'}, array {where['array_id']} at {where['base_id']:#x},"
        f" {best.bits} bits a taxel"
    )
    doubts = [f"array: {_many(best)} taxels fit; best guess: {rows} x {columns}"]
    others = ", ".join(f"{each.bits} ({_many(each)})" for each in fits if each.bits != best.bits)
    if others:
        doubts.append(f"bits: nothing speaks against {others} taxels either, but steps are largest there")
    codec = packed.Packed(rows * columns, **settings)
    return Found({"name": "packed"} | settings, codec, (key,), (rows, columns), says, tuple(doubts))


def _many(fit: Fit) -> str:
    return f"{fit.least}" if fit.least == fit.most else f"{fit.least} to {fit.most}"


RECOGNISERS: tuple[Callable[[Traffic], Iterator[Found]], ...] = (
    find_packed,
    find_icub,
    find_barrett,
    find_cyskin,
    find_linker,
    find_poweron,
    find_xela,
)
