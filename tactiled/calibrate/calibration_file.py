"""The calibration file of one array: JSON with a readable head, one array a line, a checksum over its content."""

import hashlib
import json
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, ValidationError, model_validator

from tactiled.calibrate.sections import (
    MAX_TAXELS,
    CoverSection,
    GainSection,
    HealthSection,
    NoLoadSection,
    Section,
    Table,
    build,
    error_line,
)
from tactiled.cover.stack import Stack
from tactiled.errors import ConfigError, StateError
from tactiled.files import atomic_write
from tactiled.units import PRESSURE, Pressure

FORMAT, VERSION = "tactiled calibration", 2
ID_DIGITS = 12  # of the checksum
FILES_KEPT = 10  # former ones
MAX_BYTES = 8 << 20  # of a file: 16 384 taxels with 32 numbers each, of 16 characters
MAX_BYTES_OF_NONE, MAX_BYTES_OF_TAXEL = 256 << 10, 512  # of a file: its head and cover; 32 numbers


class CalibrationFile(Table):
    """All of one array's calibration; `replaced` gives it with other sections."""

    sensor: Annotated[str, Field(min_length=1, max_length=64)]
    codec: Annotated[str, Field(min_length=1, max_length=200)]
    taxels: Annotated[int, Field(ge=1, le=MAX_TAXELS)]
    unit: Pressure = PRESSURE
    no_load: NoLoadSection | None = None
    gain: GainSection | None = None
    cover: CoverSection | None = None
    health: HealthSection | None = None

    @property
    def sections(self) -> dict[str, Section]:
        """The sections that there are, by name."""
        return {name: each for name, each in self if isinstance(each, Section)}

    @property
    def created(self) -> str:
        """When the newest section was made, UTC."""
        return max(each.origin.created for each in self.sections.values())

    @cached_property
    def checksum(self) -> str:
        """SHA-256 over the content, 64 hex digits."""
        return _checksum(self._content)

    @property
    def id(self) -> str:
        """The checksum's first ID_DIGITS digits."""
        return self.checksum[:ID_DIGITS]

    @property
    def text(self) -> str:
        """The file's text: the head first."""
        content = self._content
        sections = {key: content.pop(key) for key in self.sections}
        return _text(content | {"checksum": self.checksum} | sections) + "\n"

    @property
    def _content(self) -> dict[str, Any]:
        content = {key: each for key, each in self.model_dump(mode="json").items() if each is not None}
        version = max((each.version for each in self.sections.values()), default=1)  # 0.4.2 reads what it can
        return {"format": FORMAT, "version": version, "created": self.created} | content

    def replaced(self, **sections: Section) -> Self:
        """The same with these sections instead of its own; ConfigError where one does not fit the array."""
        return build(type(self), **{key: getattr(self, key) for key in type(self).model_fields} | sections)

    def need_fit(self, sensor: str, codec: str, taxels: int, stack: Stack) -> None:
        """ConfigError, which names what differs, where it is of another array, or its cover of another stack."""
        for key, value in {"sensor": sensor, "codec": codec, "taxels": taxels}.items():
            if (own := getattr(self, key)) != value:
                raise ConfigError(f"{key} is {own!r}, and the configuration has {value!r}")
        if self.cover and self.cover.stack != stack:
            raise ConfigError(
                f"cover was fitted with {self.cover.stack}, and the configuration has {stack}: fit it again"
            )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.sections:
            raise ValueError("no section: give no_load, gain, cover or health")
        lengths = {
            "no_load": len(self.no_load.counts) if self.no_load else None,
            "gain": self.gain.curves.size if self.gain else None,
            "health": len(self.health.noise_counts) if self.health else None,
        }
        for name, length in lengths.items():
            if length not in (None, self.taxels):
                raise ValueError(f"{name} has {length} taxels: the file has {self.taxels}")
        if self.health and (beyond := [each for each in self.health.dead if each >= self.taxels]):
            raise ValueError(f"health.dead names taxel {beyond[0]}: the array has 0 to {self.taxels - 1}")
        return self


def with_sections(
    before: CalibrationFile | None, sensor: str, codec: str, taxels: int, **sections: Section
) -> CalibrationFile:
    """The file `before` with these sections, or a first one of the array."""
    if before is not None:
        return before.replaced(**sections)
    return build(CalibrationFile, sensor=sensor, codec=codec, taxels=taxels, **sections)


def read(text: str | bytes) -> CalibrationFile:
    """The file of that text; ConfigError, one line, for any other text."""
    if len(text) > MAX_BYTES:
        raise ConfigError(f"{len(text)} bytes: a calibration file has at most {MAX_BYTES}")
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise ConfigError(f"truncated, or not JSON, at line {error.lineno}: {error.msg}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not JSON: {error}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigError(f"format: no {FORMAT}")
    if isinstance(version := content.get("version"), int) and version > VERSION:
        raise ConfigError(f"version is {version!s:.20}: this release reads up to {VERSION}: update tactiled")
    checksum = content.pop("checksum", None)
    if checksum != _checksum(content):
        raise ConfigError("checksum: does not match: the content was altered or damaged")
    head = {key: content.pop(key, None) for key in ("format", "version", "created")}
    try:
        made = CalibrationFile.model_validate_json(json.dumps(content))
    except ValidationError as error:
        raise ConfigError(error_line(error)) from error
    if head["created"] != made.created:
        raise ConfigError(f"created is {head['created']!r:.60}: the newest section is of {made.created}")
    return made


def max_bytes(taxels: int) -> int:
    """The size of an array's largest file."""
    return min(MAX_BYTES, MAX_BYTES_OF_NONE + MAX_BYTES_OF_TAXEL * taxels)


def load(path: Path) -> CalibrationFile | None:
    """The file at `path`, None where there is none; ConfigError, which names it, where it cannot be read."""
    try:
        return read(path.read_bytes())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def save(path: Path, file: CalibrationFile | None) -> None:
    """Write a file, or remove it for None; the one before becomes PATH.1, and so on to PATH.10.

    StateError where that fails. At any moment the file at `path` is whole, or removed, whatever ends the process.
    """
    try:
        if file is None:
            _keep(path)
            path.unlink(missing_ok=True)
            return
        with atomic_write(path, replace=True) as part:
            part.write_text(file.text, "utf-8")
            _keep(path)
    except OSError as error:
        raise StateError(f"{path}: {error.strerror}: nothing was written") from error


def kept(path: Path) -> dict[int, Path]:
    """The former files of `path` by number, 1 the newest."""
    paths = {n: path.with_name(f"{path.name}.{n}") for n in range(1, FILES_KEPT + 1)}
    return {n: each for n, each in paths.items() if each.is_file()}


def former(path: Path) -> dict[int, CalibrationFile | str]:
    """The files of `kept`; of one that cannot be read, why."""
    files: dict[int, CalibrationFile | str] = {}
    for n, each in kept(path).items():
        try:
            files[n] = read(each.read_bytes())
        except (OSError, ConfigError) as error:
            files[n] = str(error)
    return files


def _keep(path: Path) -> None:
    """Copy a file to PATH.1 if there is one, those before it renamed to the next number, the last one dropped."""
    if not path.exists():
        return
    former = kept(path)
    free = next((n for n in range(1, FILES_KEPT) if n not in former), FILES_KEPT)
    for n in range(free - 1, 0, -1):
        former[n].replace(path.with_name(f"{path.name}.{n + 1}"))
    with atomic_write(path.with_name(f"{path.name}.1"), replace=True) as copy:
        copy.write_bytes(path.read_bytes())


def _checksum(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _text(value: object, indent: str = "") -> str:
    """JSON in which a list of numbers takes a line."""
    inner = indent + " "
    if isinstance(value, dict):
        lines = [f"{inner}{json.dumps(key)}: {_text(each, inner)}" for key, each in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(each, dict | list) for each in value):
        return "[\n" + ",\n".join(inner + _text(each, inner) for each in value) + f"\n{indent}]"
    return json.dumps(value)
