"""Tables that take long to compute, kept on disk under a key of all that they were computed from."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tactiled.files import whole

Floats = NDArray[np.float64]

DIGEST = sha256().digest_size  # bytes of a checksum


def kept(folder: Path, inputs: Sequence[object], make: Callable[[], Floats]) -> Floats:
    """Give the table (n, m) that `make` computes from `inputs`, out of `folder` where it is already there.

    A cache that cannot be read or written, whatever is wrong with it, is no reason to stop.
    """
    key = sha256(b"\0".join(_bytes(each) for each in inputs)).digest()
    path = folder / f"{key.hex()}.table"
    with suppress(OSError, ValueError):
        return _restored(path.read_bytes(), key)
    table = make()
    with suppress(OSError):
        _store(_content(table, key), path)
    return table


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


def _store(content: bytes, path: Path) -> None:
    """Write a file, of which no reader ever meets half."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path, replace=True) as part:
        part.write_bytes(content)
