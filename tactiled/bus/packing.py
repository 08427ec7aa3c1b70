"""How a packed array that nobody described packs its taxels: their bits, their number, their shape; pure."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tactiled.bus.assemble import assemble, whole
from tactiled.bus.codecs import Codec, understands
from tactiled.bus.codecs.packed import HEADER, Packed
from tactiled.frames import Message

BITS = range(8, 17)  # a taxel, in the packed layout
USUAL = 12


class Fit(NamedTuple):
    """A width of the taxels that nothing heard speaks against."""

    bits: int
    least: int  # taxels, fewest and most
    most: int
    roughness: float  # mean step from taxel to taxel over full scale: small where the width is right


def counts_up(messages: Sequence[Message]) -> bool:
    """Whether nearly every message is what must come behind the one before it, lost ones allowed for."""
    if len(messages) < 4 or any(len(each.data) < HEADER or each.fd != messages[0].fd for each in messages):
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


def packed_fits(key: tuple[int, bool], messages: Sequence[Message]) -> tuple[Fit, ...]:
    """Every width, with its numbers of taxels, whose lengths and padding are those of an id's messages."""

    def codec(size: int, bits: int) -> Packed:
        return Packed(size, bits, messages[0].fd, 0, *key)

    segments = max(each.data[1] for each in messages) + 1
    full = list({each.data: each for each in messages if each.data[1] < segments - 1}.values())
    last = list({each.data: each for each in messages if each.data[1] == segments - 1}.values())
    fits = []
    for bits in BITS:
        taxels = codec(1, bits).taxels
        sizes = range((segments - 1) * taxels + 1, segments * taxels + 1)
        if full and not understands(codec(sizes[-1], bits), full):
            continue
        good = [size for size in sizes if understands(codec(size, bits), last)]
        if good:
            fits.append(Fit(bits, good[0], good[-1], _roughness(codec(good[0], bits), messages)))
    return tuple(fits)


def _roughness(codec: Codec, messages: Sequence[Message]) -> float:
    """Mean step from taxel to taxel of the first frames, over full scale."""
    frames = whole(assemble(codec, messages[: 100 * codec.segments])[0])
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
