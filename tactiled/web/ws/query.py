"""What a client of a stream asks for in the address, and may say."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, cast

from pydantic import ValidationError
from starlette.datastructures import QueryParams

from tactiled.web.schemas import Next
from tactiled.wire import KINDS, PRESSURES, Kind

NUMBER = r"[0-9]+(\.[0-9]*)?([eE][+-]?[0-9]{1,2})?"
PARAMETERS = ("kinds", "rate_hz", "format", "flow", "contacts", "together")
NEXT = '{"type": "next"}, or with "sensor": its name'


@dataclass(frozen=True, slots=True)
class Wish:
    """What a client asked for in the address."""

    kinds: tuple[Kind, ...] = PRESSURES
    rate_hz: float = 0.0  # 0: every frame
    form: Literal["binary", "json"] = "binary"
    contacts: bool = False  # as text messages
    credit: bool = False  # one image of each kind for each {"type": "next"}
    together: bool = False  # the images of a frame in one binary message


def once(query: QueryParams) -> QueryParams:
    """The same query; ValueError where a parameter stands in it more than once, of which one would be taken."""
    counts = Counter(name for name, _ in query.multi_items())
    for name, count in counts.items():
        if count > 1:
            raise ValueError(f"{name:.80}: given {count} times: give it once, several values with commas between")
    return query


def no_such(name: str, there: Sequence[str]) -> str:
    """What is said of a parameter that is none of those there are."""
    known = f"are {', '.join(there)}" if there else "is none"
    return f"{name:.80}: no such parameter: there {known}"


def wish(query: Mapping[str, str], more: Sequence[str] = ()) -> Wish:
    """Read the address's query, which may have `more` parameters; ValueError names the parameter and its value."""
    there = (*PARAMETERS, *more)
    if unknown := set(query) - {*there, "token"}:
        raise ValueError(no_such(min(unknown), there))
    kinds = tuple(query.get("kinds", ",".join(PRESSURES)).split(","))
    if not set(kinds) <= set(KINDS) or len(set(kinds)) < len(kinds):
        raise ValueError(f"kinds={query['kinds']}: give some of {','.join(KINDS)}, each once")
    given = query.get("rate_hz", "0")
    rate_hz = float(given) if re.fullmatch(NUMBER, given) else -1.0
    if not 0 <= rate_hz <= 1e4:
        raise ValueError(f"rate_hz={query['rate_hz']}: give 0 (every frame) to 10000")
    form = cast(Literal["binary", "json"], _one_of(query, "format", "binary", "json"))
    together = _one_of(query, "together", "0", "1") == "1"
    if together and form == "json":
        raise ValueError("together=1: only of format=binary: leave one of the two out")
    return Wish(
        cast(tuple[Kind, ...], kinds),
        rate_hz,
        form,
        _one_of(query, "contacts", "0", "1") == "1",
        _one_of(query, "flow", "newest", "credit") == "credit",
        together,
    )


def _one_of(query: Mapping[str, str], name: str, *choices: str) -> str:
    """The value of a parameter, by default the first of its choices."""
    if (value := query.get(name, choices[0])) not in choices:
        raise ValueError(f"{name}={value}: give {' or '.join(choices)}")
    return value


def asked_for(query: Mapping[str, str], there: Sequence[str]) -> list[str]:
    """The sensors that a query names, by default all; ValueError where it names one twice or none."""
    names = query["sensors"].split(",") if "sensors" in query else list(there)
    if len(set(names)) < len(names):
        raise ValueError(f"sensors={query['sensors']}: give each name once")
    return names


def sheared(query: Mapping[str, str], names: Sequence[str]) -> list[str]:
    """The sensors of which a query asks for shear, too; ValueError where one is not among those asked for."""
    found = query["shear"].split(",") if "shear" in query else []
    if len(set(found)) < len(found) or not set(found) <= set(names):
        raise ValueError(f"shear={query['shear']}: give some of {','.join(names)}, each once")
    return found


def next_of(text: str | None, names: Sequence[str]) -> Sequence[str]:
    """The sensors of which a client's message asks for the next image; ValueError where it says anything else."""
    try:
        sensor = Next.model_validate_json(text or "").sensor
        if sensor is None or sensor in names:
            return names if sensor is None else [sensor]
    except ValidationError:
        pass
    raise ValueError(f"message {'of bytes' if text is None else repr(text[:40])}: the only one there is: {NEXT}")
