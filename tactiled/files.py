"""Files that are there whole or not at all: written under another name, then given their own."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

NO_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # what a file system without links says


@contextmanager
def whole(path: Path, *, replace: bool = False) -> Iterator[Path]:
    """A path to write to; what is there becomes `path` where the block ends well, and goes where it does not.

    OSError where it cannot be, FileExistsError where something is at `path` by the end and not to `replace`.
    """
    part = path.with_name(f".tactiled-{token_hex(8)}.part")
    try:
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        if replace:
            part.replace(path)
        else:
            _name(part, path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _name(part: Path, path: Path) -> None:
    """Give a file the name `path`, which must be free."""
    try:
        path.hardlink_to(part)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        path.open("xb").close()  # takes the name: nobody else gets it meanwhile
        try:
            part.replace(path)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
