"""Where inputs and outputs are: paths of this machine, and URLs by way of fsspec, which is an extra."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urlsplit

from tactiled.bus.redact import Secret, redacted, redactor, seal
from tactiled.errors import ConfigError, TactileError
from tactiled.files import whole_file

NAME = "{}"  # in the path of an output: there goes the name of its input
NEEDS_FSSPEC = "{}: URLs, and several files at once, need fsspec: pip install 'tactiled[fsspec]'"


@dataclass(frozen=True, repr=False)
class Place:
    """A file or folder, which is printed without credentials; all that fails with it is a TactileError."""

    path: str
    files: Any = None  # fsspec's file system with its credentials; None: as Python opens `path`

    def __str__(self) -> str:
        if "://" in self.path:  # http's paths are whole URLs
            return redacted(self.path)
        return self.path if self.on_disk else f"{_protocol(self.files)}://{self.path}"

    __repr__ = __str__

    @property
    def on_disk(self) -> bool:
        """Whether it is a path of this machine."""
        return self.files is None or _protocol(self.files) == "file"

    @property
    def name(self) -> str:
        """Without its folders."""
        return Path(urlsplit(self.path).path if "://" in self.path else self.path).name

    def beside(self, name: str) -> "Place":
        """Another name in the same folder."""
        return Place(self.path.removesuffix(self.name) + name, self.files)

    def call(self, method: str, *arguments: Any, **options: Any) -> Any:
        """Call a method of the file system with its path."""
        with _errors(str(self), self.path, getattr(self.files, "storage_options", {})):
            return getattr(self.files, method)(self.path, *arguments, **options)

    def sizes(self) -> dict[str, int]:
        """Bytes of each file of a folder by its path in it, or of a file as `""`; {} if nothing is there."""
        self.files.invalidate_cache()
        files = self.call("find", detail=True)
        return {path.removeprefix(self.path): each["size"] for path, each in sorted(files.items())}

    def remove(self) -> None:
        """Remove it, if it is there."""
        if self.call("exists"):
            self.call("rm", recursive=True)

    @contextmanager
    def local(self) -> Iterator[Path]:
        """Its path on this machine; of a URL, that of a copy meanwhile."""
        if self.on_disk:
            yield Path(self.path)
            return
        with TemporaryDirectory(prefix="tactiled-") as folder:
            copy = Path(folder) / self.name
            self.call("get_file", str(copy))
            try:
                yield copy
            except TactileError as error:
                raise TactileError(str(error).replace(str(copy), str(self))) from error

    @contextmanager
    def written(self, *, replace: bool, label: str = "") -> Iterator[Path]:
        """A path for a file or a folder: where the block ends well it is whole at this place, else nothing is.

        What it is named until then, beside this place, begins with .tactiled-`label`.
        """
        if self.on_disk:
            with whole_file(Path(self.path), replace=replace, label=label) as part:
                yield part
            return
        if not replace and self.call("exists"):
            raise ConfigError(f"{self} is there already: name another file, or remove it first")
        with TemporaryDirectory(prefix="tactiled-") as folder:
            copy, unfinished = Path(folder) / self.name, self.beside(f".tactiled-{label}-{self.name}")
            yield copy
            with _errors(str(self), self.path, self.files.storage_options):
                self.files.put(str(copy), unfinished.path, recursive=copy.is_dir())
            self.remove()
            unfinished.call("mv", self.path, recursive=copy.is_dir())


def _protocol(files: Any) -> str:
    return files.protocol if isinstance(files.protocol, str) else files.protocol[0]


@contextmanager
def _errors(label: str, path: str, options: Mapping[str, Any]) -> Iterator[None]:
    """Whatever a file system raises, as a TactileError without what is secret in its path and options."""
    try:
        yield
    except Exception as error:
        hide = redactor(seal(options) | {"path": Secret(path, label)})
        text = " ".join(hide(getattr(error, "strerror", None) or str(error)).split())
        raise TactileError(f"{label}: {text or type(error).__name__}") from error


def place(text: str, *, plain: bool = True) -> Place:
    """Where a path or URL leads; unless `plain`, with fsspec's file system for paths, too."""
    if plain and "://" not in text:
        return Place(text)
    label = redacted(text) if "://" in text else text
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise ConfigError(NEEDS_FSSPEC.format(label)) from error
    with _errors(label, text, {}):
        files, path = url_to_fs(text)
    return Place(path, files)


def inputs(paths: Sequence[str], endings: Collection[str]) -> dict[str, Place]:
    """Every input by its name: files, those that match a *, and those in folders that have one of the endings.

    Endings may be in capitals. The name is without ending, of a file in a folder with the folders between;
    ConfigError where two are the same.
    """
    places: dict[str, Place] = {}
    for text in paths:
        origin = place(text, plain=False)
        if "*" in origin.path:
            listing = origin.call("glob", detail=True).items()
            names = {path: Path(path).name for path, each in listing if each["type"] == "file"}
        elif not origin.name.endswith(tuple(endings)) and origin.call("isdir"):
            folder = origin.path.rstrip("/") + "/"
            paths = origin.call("find")
            names = {path: path.removeprefix(folder) for path in paths if path.lower().endswith(tuple(endings))}
        else:
            names = {origin.path: origin.name}
        if not names:
            raise ConfigError(f"{origin}: no file there: give files, or a folder with {', '.join(endings)}")
        for path in sorted(names):
            name = str(Path(names[path]).with_suffix(""))
            if path.lower().endswith(".gz"):
                name = str(Path(name).with_suffix(""))
            one = Place(path, origin.files)
            if places.setdefault(name, one) != one:
                raise ConfigError(f"{one}: {places[name]} has the same name: rename one")
    return places
