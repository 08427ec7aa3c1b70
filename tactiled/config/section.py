"""What tables of the configuration file have in common."""

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, PlainSerializer, SerializationInfo, model_validator

from tactiled.bus.redact import seal, show


class Section(BaseModel):
    """A table of the file: refuses a key that it does not know. The text below a key describes it in the guide."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


def _serialize(value: Any, info: SerializationInfo) -> Any:
    """As it may be printed, in JSON; as it is, Secrets included, in Python."""
    return show(value) if info.mode == "json" else value


Redacted = PlainSerializer(_serialize)


class Foreign(BaseModel):
    """A table whose other keys another package knows, passed on as they are; its texts are secrets."""

    model_config = ConfigDict(extra="allow", frozen=True, use_attribute_docstrings=True)
    __pydantic_extra__: dict[str, Annotated[Any, Redacted]]
    harmless: ClassVar[frozenset[str]] = frozenset({"name"})  # keys whose texts are none

    @model_validator(mode="before")
    @classmethod
    def _seal(cls, table: Any) -> Any:
        return seal(table, cls.harmless) if isinstance(table, dict) else table
