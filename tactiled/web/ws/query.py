"""The query of a stream's address, and the messages of its client."""

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from itertools import permutations
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic.json_schema import WithJsonSchema
from starlette.datastructures import QueryParams

from tactiled.bounds import reason
from tactiled.web.schemas import IMAGE_CELLS, ImageCells, Next
from tactiled.wire import KINDS, PRESSURES, Kind

MAX_NAMED = 30  # characters of a value that a reason names
NEXT = '{"type": "next"}, or with "sensor": its name'
COMBINATIONS = [",".join(some) for count in range(1, len(KINDS) + 1) for some in permutations(KINDS, count)]


def _split(value: Any) -> Any:
    return value.split(",") if isinstance(value, str) else value


def _unique(values: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(values)) < len(values):
        raise ValueError("give each name once")
    return values


Once = AfterValidator(_unique)
Names = Annotated[tuple[str, ...], BeforeValidator(_split), Once, WithJsonSchema({"type": "string"})]
Kinds = Annotated[
    tuple[Kind, ...], BeforeValidator(_split), Once, WithJsonSchema({"type": "string", "enum": COMBINATIONS})
]


class StreamQuery(BaseModel):
    """The parameters of a stream of one sensor."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kinds: Kinds = Field(
        PRESSURES,
        description="images of each frame, sent in this order; shear and traction only from a 3-axis skin",
        json_schema_extra={"default": ",".join(PRESSURES)},
    )
    rate_hz: float = Field(
        0, ge=0, le=10000, description="largest rate of images of one sensor, 1/s; 0: every frame"
    )
    format: Literal["binary", "json"] = Field("binary", description="format of the images")
    flow: Literal["newest", "credit"] = Field(
        "newest", description="when images are sent: newest at once, or one of each kind per `next` message"
    )
    contacts: Literal["0", "1"] = Field("0", description="1: contacts as well")
    together: Literal["0", "1"] = Field(
        "0", description="1, with format=binary: all images of a frame in one message, each with its own header"
    )
    image: ImageCells = Field("raster", description=IMAGE_CELLS)
    token: str | None = Field(None, description="token, if the service needs one")

    @model_validator(mode="after")
    def _binary_together(self) -> "StreamQuery":
        if self.together == "1" and self.format == "json":
            raise ValueError("together=1 needs format=binary")
        return self


class SensorsQuery(StreamQuery):
    """The parameters of a stream of several sensors."""

    sensors: Names | None = Field(
        None, description="sensors, with commas between; left out: all", examples=["palm,tip"]
    )
    shear: Names = Field(
        (),
        description="sensors whose shear is sent after their other images, with commas between",
        examples=["tip"],
    )
    traction: Names = Field((), description="the same of shear as it is restored", examples=["tip"])


Q = TypeVar("Q", bound=StreamQuery)


def once(query: QueryParams) -> QueryParams:
    """The same query; ValueError where it has a parameter more than once, of which one would count."""
    counts = Counter(name for name, _ in query.multi_items())
    for name, count in counts.items():
        if count > 1:
            raise ValueError(f"{name:.80}: given {count} times: give it once, several values with commas between")
    return query


def brief(value: str) -> str:
    """A client's words, or so many that a close frame holds the reason behind them, too."""
    return value if len(value) <= MAX_NAMED else f"{value[:MAX_NAMED]}…"


def no_such(name: str, available: Sequence[str]) -> str:
    """The error of an unknown parameter."""
    names = f"are {', '.join(available)}" if available else "is none"
    return f"{name:.80}: no such parameter: there {names}"


def parse(query: QueryParams, form: type[Q]) -> Q:
    """Read the query of a stream; ValueError names the parameter and its value."""
    try:
        return form.model_validate(dict(once(query)))
    except ValidationError as caught:
        error = caught.errors()[0]
        name = str(error["loc"][0]) if error["loc"] else ""
        if error["type"] == "extra_forbidden":
            raise ValueError(no_such(name, [each for each in form.model_fields if each != "token"])) from None
        why = reason(error)
        raise ValueError(f"{name}={brief(query[name])}: {why}" if name else why) from None


@lru_cache(maxsize=64)  # of at most MAX_MESSAGE_BYTES each: clients send the same ones over and over
def _next_sensor(text: str) -> str | None:
    return Next.model_validate_json(text).sensor


def parse_next(text: str | None, names: Sequence[str]) -> Sequence[str]:
    """The sensors of which a client's message asks for the next image; ValueError for any other message."""
    try:
        sensor = _next_sensor(text or "")
        if sensor is None or sensor in names:
            return names if sensor is None else [sensor]
    except ValidationError:
        pass
    raise ValueError(f"message {'of bytes' if text is None else repr(text[:40])}: the only one there is: {NEXT}")
