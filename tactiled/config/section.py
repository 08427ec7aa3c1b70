"""What tables of the configuration file have in common."""

from typing import Any

from pydantic import BaseModel, ConfigDict, PlainSerializer, SerializationInfo

from tactiled.bus.redact import show


class Section(BaseModel):
    """A table of the file: refuses a key that it does not know. The text below a key describes it in the guide."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


def _serialize(value: Any, info: SerializationInfo) -> Any:
    """As it may be printed, in JSON; as it is, Secrets included, in Python."""
    return show(value) if info.mode == "json" else value


Redacted = PlainSerializer(_serialize)
