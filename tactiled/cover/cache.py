"""Tables that take long to compute, kept on disk under a key of all that they were computed from."""

import os
from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactiled.files import atomic_write

Floats = NDArray[np.float64]
Report = Callable[[str], object]

DIGEST = sha256().digest_size  # bytes of a checksum


def kept(
    folder: Path | None,
    inputs: Sequence[object],
    make: Callable[[], Floats],
    report: Report = lambda _: None,
    kind: str = "table",
) -> Floats:
    """Give the table (n, m) that `make` computes from `inputs`, out of `folder` where it is already there.

    By default the folder is in the user's cache; `kind` is the ending of the file's name. A cache that cannot be
    read or written, whatever is wrong with it, is no reason to stop: `report` gets a line.
    """
    key = sha256(b"\0".join(_bytes(each) for each in inputs)).digest()
    try:
        path = (folder or cache_folder()) / f"{key.hex()}.{kind}"
    except OSError as error:
        report(f"no {kind} is kept: {error}")
        return make()
    try:
        return _restored(path.read_bytes(), key)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        report(f"{path}: {_why(error)}: it is computed again")
    table = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path, replace=True) as part:
            part.write_bytes(_content(table, key))
    except OSError as error:
        report(f"{path}: {_why(error)}: it is not kept")
    return table


def cache_folder() -> Path:
    """Give the folder for tables in the user's cache; OSError where the user has none."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tactiled"
    except RuntimeError as error:
        raise FileNotFoundError("there is no home directory: set HOME or XDG_CACHE_HOME") from error


def _why(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error)


def _bytes(value: object) -> bytes:
    return bytes(value.tobytes()) if isinstance(value, np.ndarray) else repr(value).encode()


def _content(table: Floats, key: bytes) -> bytes:
    """Give a table as bytes: a checksum of all the rest and of its key, the number of its columns, its numbers."""
    body = int(table.shape[1]).to_bytes(8, "little") + table.astype("<f8").tobytes()
    return sha256(key + body).digest() + body


def _restored(content: bytes, key: bytes) -> Floats:
    """Give the table whose `_content` this is; ValueError for any other bytes and for another key's."""
    checksum, body = content[:DIGEST], content[DIGEST:]
    if sha256(key + body).digest() != checksum:
        raise ValueError("the checksum is wrong")
    return np.frombuffer(body, "<f8", offset=8).reshape(-1, int.from_bytes(body[:8], "little")).astype(float)
