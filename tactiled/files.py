"""Files that are complete or absent: written under another name, then renamed."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex

NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # errors of file systems without them


@contextmanager
def atomic_write(path: Path, *, replace: bool = False) -> Iterator[Path]:
    """A path to write to: it becomes `path` where the block ends well, and is removed where it does not.

    OSError where that fails; FileExistsError where `path` exists by then and `replace` is false.
    """
    part = path.with_name(f".tactiled-{token_hex(8)}.part")
    try:
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        if replace:
            part.replace(path)
        else:
            _rename_new(part, path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def _rename_new(part: Path, path: Path) -> None:
    """Give a file the name `path`; FileExistsError where it is taken."""
    try:
        path.hardlink_to(part)
    except OSError as error:
        if error.errno not in NO_HARD_LINKS:
            raise
        path.open("xb").close()  # reserves the name
        try:
            part.replace(path)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
