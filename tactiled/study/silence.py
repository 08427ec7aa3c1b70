"""Images of `auto` that are worse than raw with nothing to tell of it, each with the reason why nothing could."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tactiled.study.pairs import Pair
from tactiled.study.stability import Found, Row, fails_silently

UNKNOWN = "silent, and no reason is known"
EXPLAINED = "a press explains this frame down to its noise: "
LIFT = EXPLAINED + "what lifts the array is what a wide press would be"
FAINT = EXPLAINED + "where taxels are dead, too little presses to stand out of it"
REASONS = {  # by fault; each holds only where a press does explain the frame
    "offset": LIFT,
    "drift": LIFT,
    "dead": FAINT,
    "dead taxels untold": FAINT,
}
HEADINGS = ("goes wrong", "by", "scene", "error over raw", "true error, kPa", "claimed, kPa", "why nothing tells")


@dataclass(frozen=True, slots=True)
class Silence:
    """A silent image, and why nothing could have told."""

    row: Row
    by: str  # how much went wrong; empty for two faults, whose name tells
    reason: str  # UNKNOWN where none is


def listed(found: Found, together: Sequence[Pair]) -> list[Silence]:
    """Every silent image of one fault or of two, worst first."""
    silent = [
        Silence(row, f"{row.value:g} {sweep.unit}", reason((sweep.name,), row))
        for sweep, rows in found
        for row in rows
        if fails_silently(row)
    ]
    silent += [
        Silence(row, "", reason(pair.faults, row)) for pair in together for row in pair.rows if fails_silently(row)
    ]
    return sorted(silent, key=lambda one: -one.row.over_raw)


def reason(faults: Iterable[str], row: Row) -> str:
    """Why nothing could tell of a row with such faults."""
    known = dict.fromkeys(REASONS[fault] for fault in faults if fault in REASONS) if row.lawful else {}
    return "; ".join(known) or UNKNOWN


def verdict(found: Sequence[Silence]) -> str:
    """How many images are silent, and how many of them for no known reason."""
    if not found:
        return "No image that is worse than the raw one is silent."
    unknown = sum(one.reason == UNKNOWN for one in found)
    loud = f" NO REASON IS KNOWN FOR {unknown} OF THEM." if unknown else " A reason is known for each."
    return (
        f"Images that are worse than the raw one, over twice as wrong as claimed, and with nothing to warn of it:"
        f" {len(found)}. They are all listed, worst first.{loud}"
    )


def lines(found: Sequence[Silence]) -> list[tuple[str, ...]]:
    """A table of silent images, by HEADINGS."""
    return [
        (
            one.row.sweep,
            one.by.replace("-", "−"),
            one.row.scene,
            f"{one.row.over_raw:.2f}",
            f"{one.row.error:.2f}",
            f"{one.row.claimed:.2f}",
            one.reason,
        )
        for one in found
    ]
