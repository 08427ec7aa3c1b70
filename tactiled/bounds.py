"""Bounds of the numbers of the configuration, and what texts may hold, in words in the error; paths beside it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, cast

from pydantic import AfterValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, PlainSerializer, SecretStr
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError, core_schema

from tactiled.units import LENGTH, STIFFNESS

# Units that a number may have been given in, over ours.
SLIPS = {LENGTH: {"metres": 1e3}, STIFFNESS: {"Pa": 1e-6, "GPa": 1e3}}


def reason(fault: ErrorDetails) -> str:
    """What is wrong with a value, in plain words."""
    plain = {"missing": "missing", "extra_forbidden": "unknown key", "unexpected_keyword_argument": "unknown key"}
    words = fault["msg"].removeprefix("Value error, ").replace(" after validation", "")
    return plain.get(fault["type"]) or words.replace("Tuple should", "List should").replace("valid tuple", "list")


def place(loc: Iterable[int | str]) -> str:
    """Where a value stands, such as `array.positions_mm[0]`."""
    named = (part for part in loc if "[" not in str(part))  # no names of types
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in named).removeprefix(".")


def shown(value: Any) -> str:
    """A value that came in JSON, at most 80 characters of it."""
    words = {None: "null", True: "true", False: "false"}
    return words[value] if value is None or isinstance(value, bool) else f"{value!r:.80}"


def slips(value: float, unit: str, units: Mapping[str, float], low: float, high: float) -> list[tuple[float, str]]:
    """What `value` is in `unit` if it was given in others, from `low` to `high`: number and words."""
    meant = ((value * factor, name) for name, factor in units.items() if low <= abs(value) * factor <= high)
    return [(each, f"; {each:g} {unit} if it was given in {name}") for each, name in meant]


@dataclass(frozen=True, slots=True)
class Bounds:
    """A number from `low` to `high`, both included; with `zero` it may be 0, with `signed` of either sign, too.

    `hexadecimal` is how configurations write it.
    """

    low: float
    high: float
    unit: str = ""
    zero: bool = False
    signed: bool = False
    hexadecimal: bool = False

    def __str__(self) -> str:
        """The range in words, for errors."""
        if self.hexadecimal:
            return f"{self.low:#x} to {self.high:#x}"
        low, high = (
            f"{end:g}".replace("e+0", "e") if isinstance(end, float) else f"{end}" for end in (self.low, self.high)
        )
        sign = ", of either sign" if self.signed else ""
        return f"{'0, or ' if self.zero else ''}{low} to {high}{self.unit and ' '}{self.unit}{sign}"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        number = {**handler(source), "strict": True}  # neither text nor true
        return core_schema.no_info_after_validator_function(self._checked, cast(CoreSchema, number))

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        low = -self.high if self.signed else 0 if self.zero else self.low
        return handler(core) | {"minimum": low, "maximum": self.high}

    def _checked(self, value: float) -> float:
        """Refuse a number past either end, and NaN."""
        size = abs(value) if self.signed else value
        if not (self.low <= size <= self.high or (self.zero and value == 0)):
            units = SLIPS.get(self.unit, {}) if size > 0 else {}
            found = slips(value, self.unit, units, self.low, self.high)
            meant, words = found[0] if found else (min(max(size, self.low), self.high), "")
            context = {"bounds": str(self), "slip": words, "meant": meant}
            raise PydanticCustomError("out_of_bounds", "give {bounds}{slip}", context)
        return value


@dataclass(frozen=True, slots=True)
class Syntax:
    """A text that a regular expression matches; `words` say in an error what to give."""

    pattern: str
    words: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._checked, handler(source))

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(core) | {"pattern": self.pattern}

    def _checked(self, text: str) -> str:
        if not re.fullmatch(self.pattern, text):
            raise PydanticCustomError("syntax", "give {words}", {"words": self.words})
        return text


def _check_key(key: SecretStr) -> SecretStr:
    """Refuse a key that a person made up: it could be guessed from one signature."""
    if not re.fullmatch(r"[0-9a-f]{64}", key.get_secret_value()):
        raise ValueError("give 64 of the digits 0-9 and a-f, as `openssl rand -hex 32` prints them")
    return key


Key = Annotated[SecretStr, AfterValidator(_check_key)]  # of signatures
FileBeside = Annotated[  # relative to the folder of the configuration; printed without its folder
    Path,
    AfterValidator(lambda file, info: (info.context or {}).get("folder", Path()) / file),
    PlainSerializer(lambda path: path.name, when_used="json", return_type=str),
]
Port = Annotated[int, Bounds(0, 65535)]
MAX_READING = 1e9  # 30 bits, past any sensor; float32 holds them, and their squares
Counts = Annotated[float, Bounds(-MAX_READING, MAX_READING, "counts")]
Pitch = Annotated[float, Bounds(0.01, 1000.0, LENGTH)]  # from an etched sensor's taxels to a floor's tiles
Place = Annotated[float, Bounds(-1e4, 1e4, LENGTH)]  # no skin is wider than 20 m
NAME, FRAME_ID = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$", r"^[A-Za-z0-9_][A-Za-z0-9_./-]{0,127}$"
ENDPOINT, PREFIX = r"^(tcp|tls|quic|udp|ws)/[^/?#\s]+:[0-9]{1,5}$", r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$"
WORD = "ASCII letters, digits, _ or -"
Name = Annotated[str, Syntax(NAME, f"1 to 64 {WORD}, a letter or digit first")]
FrameId = Annotated[  # tf2 refuses a slash in front
    str, Syntax(FRAME_ID, "1 to 128 ASCII letters, digits, _ . / or -, a letter, digit or _ first")
]
Endpoint = Annotated[
    str, Syntax(ENDPOINT, "tcp, tls, quic, udp or ws, then /ADDRESS:PORT, such as tcp/192.168.1.2:7447")
]
Origin = Annotated[
    str,
    Syntax(
        r"^https?://[a-z0-9.\[\]:-]{1,253}$",
        "a page's origin, such as https://app.example:8443 with no slash behind it",
    ),
]
Origins = Annotated[tuple[Origin, ...], Field(max_length=32)]
Prefix = Annotated[str, Field(max_length=100), Syntax(PREFIX, f"{WORD}, in parts with / between")]
