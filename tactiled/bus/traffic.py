"""What came on a bus, as a skin's recogniser sees it; pure."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tactiled.errors import CodecError
from tactiled.frames import Message

if TYPE_CHECKING:
    from tactiled.bus.codec import Codec

Key = tuple[int, bool]  # CAN id, whether it has 29 bits


@dataclass(frozen=True, slots=True)
class Match:
    """One array that a recogniser found."""

    settings: dict[str, Any]  # of its codec, as a configuration has them
    codec: "Codec"
    keys: tuple[Key, ...]  # its messages' ids, in order
    shape: tuple[int, int] | None  # rows, columns; None where the skin knows its taxels' positions
    description: str  # one phrase
    notes: tuple[str, ...] = ()  # what the bus does not say
    pitch_mm: float = 4.0  # a guess


class Traffic(dict[Key, list[Message]]):
    """Messages by id."""

    def __init__(self, messages: Iterable[Message]) -> None:
        super().__init__()
        for each in messages:
            self.setdefault((each.id, each.extended), []).append(each)

    def standard(self, ids: Iterable[int]) -> tuple[Key, ...]:
        """Those of some 11-bit ids on which messages came."""
        return tuple((each, False) for each in ids if (each, False) in self)

    def messages(self, keys: Iterable[Key]) -> list[Message]:
        """All messages on some ids."""
        return [each for key in keys for each in self[key]]

    def even(self, keys: Iterable[Key]) -> bool:
        """Whether ids came as often as one another, but for what was cut at the ends or lost."""
        counts = [len(self[key]) for key in keys]
        return max(counts) - min(counts) <= 2 + 0.1 * max(counts)


def understands(codec: "Codec", messages: Iterable[Message]) -> bool:
    """Whether a codec decodes every one of some messages."""
    try:
        for each in messages:
            codec.decode(each)
    except CodecError:
        return False
    return True
