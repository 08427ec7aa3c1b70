"""Which skins send on a bus, from the messages that came; pure."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tactiled.bus.assembler import assemble
from tactiled.bus.codec import Match, Traffic
from tactiled.bus.skins import recognised, skins
from tactiled.frames import Message

SETTLED_FRAMES = 8  # in which the beginning of a frame without sequence numbers is learned


@dataclass(frozen=True, slots=True)
class Sender:
    """One array that sends on the bus."""

    name: str  # of its codec
    match: Match
    frames: int  # whole ones
    rate_hz: float  # frames a second
    lost: int  # messages
    no_load: int  # median count of a taxel: its rest, where most of the array was not touched


class UnknownId(NamedTuple):
    """Messages that belong to no known skin."""

    id: int
    extended: bool
    messages: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class Survey:
    """What is on a bus."""

    senders: tuple[Sender, ...]
    unknown: tuple[UnknownId, ...]  # the most frequent first


def survey(messages: Iterable[Message]) -> Survey:
    """Every known skin among some messages, and the rest by id; a skin with sequence numbers comes first."""
    traffic = Traffic(messages)
    matches = [(name, each) for name, skin in skins() for each in recognised(name, skin, traffic)]
    matches.sort(key=lambda each: each[1].codec.modulus is None)
    senders = []
    for name, match in matches:
        if all(key in traffic for key in match.keys):  # not yet taken by a skin before it
            own = sorted((m for key in match.keys for m in traffic.pop(key)), key=lambda each: each.time)
            senders.append(_measured(name, match, own))
    unknown = [UnknownId(*key, len(each), mean_rate_hz([m.time for m in each])) for key, each in traffic.items()]
    return Survey(tuple(senders), tuple(sorted(unknown, key=lambda each: -each.messages)))


def mean_rate_hz(times: Sequence[float]) -> float:
    """Mean rate (1/s) of what came at these times (s), in any order; 0 if they are all the same."""
    span = max(times, default=0.0) - min(times, default=0.0)
    return (len(times) - 1) / span if span > 0 else 0.0


def _measured(name: str, match: Match, messages: list[Message]) -> Sender:
    frames, loss = assemble(match.codec, messages)
    good = [each.counts for each in frames if not each.flags.any()]
    rate_hz = mean_rate_hz([each.time for each in frames[1:]])  # the first may have begun before the recording
    lost = loss.lost - frames[:SETTLED_FRAMES][-1].loss.lost if frames else 0
    return Sender(name, match, len(good), rate_hz, lost, int(np.median(good)) if good else 0)
