"""Tables that take long to compute, kept on disk under a key of all that they were computed from."""

import os
from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path

import numpy as np

from tactiled.arrays import Floats
from tactiled.files import atomic_write

Report = Callable[[str], object]


def cached_table(
    folder: Path | None,
    inputs: Sequence[object],
    make: Callable[[], Floats],
    report: Report = lambda _: None,
    suffix: str = "table",
) -> Floats:
    """Give the table (n, m) that `make` computes from `inputs`, out of `folder` where it is already there.

    By default the folder is in the user's cache. A cache that cannot be read or written, whatever is wrong with
    it, is no reason to stop: `report` gets a line.
    """
    key = sha256(b"\0".join(_bytes(each) for each in inputs)).digest()
    try:
        cache = folder or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tactiled"
        path = cache / f"{key.hex()}.{suffix}"
    except RuntimeError:
        report(f"no {suffix} is kept: there is no home directory: set HOME or XDG_CACHE_HOME")
        return make()
    try:
        return _decoded(path.read_bytes(), key)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        report(f"{path}: {getattr(error, 'strerror', None) or error}: it is computed again")
    table = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path, replace=True) as part:
            part.write_bytes(_encoded(table, key))
    except OSError as error:
        report(f"{path}: {error.strerror or error}: it is not kept")
    return table


def _bytes(value: object) -> bytes:
    return bytes(value.tobytes()) if isinstance(value, np.ndarray) else repr(value).encode()


def _encoded(table: Floats, key: bytes) -> bytes:
    """Give a table as bytes: a checksum of all the rest and of its key, the number of its columns, its numbers."""
    body = int(table.shape[1]).to_bytes(8, "little") + table.astype("<f8").tobytes()
    return sha256(key + body).digest() + body


def _decoded(content: bytes, key: bytes) -> Floats:
    """Give the table whose `_encoded` this is; ValueError for any other bytes and for another key's."""
    size = sha256().digest_size
    checksum, body = content[:size], content[size:]
    if sha256(key + body).digest() != checksum:
        raise ValueError("the checksum is wrong")
    return np.frombuffer(body, "<f8", offset=8).reshape(-1, int.from_bytes(body[:8], "little")).astype(float)
