"""Files, and folders of files, that are complete or absent: written under another name, then renamed."""

import errno
import fcntl
import hashlib
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

from tactiled.errors import ConfigError, TactileError

SCRATCH = ".tactiled-"
NO_HARD_LINKS = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # errors of file systems without them


@contextmanager
def scratch_folder(parent: Path, label: str = "") -> Iterator[Path]:
    """A hidden folder `.tactiled-LABEL...`, which is removed at the end, after kill -9 by `clear_scratch`."""
    with ExitStack() as stack:
        while True:
            made = TemporaryDirectory(prefix=f"{SCRATCH}{label}", dir=parent, ignore_cleanup_errors=True)
            folder = Path(stack.enter_context(made))
            if stack.enter_context(_locked(folder)) or folder.exists():  # else it was taken for a remnant
                break
        yield folder


def clear_scratch(parent: Path) -> None:
    """Remove the scratch folders whose processes have ended without doing so."""
    for folder in parent.glob(f"{SCRATCH}*"):
        with _locked(folder) as ours:
            if ours:
                rmtree(folder, ignore_errors=True)


@contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    """Lock a folder meanwhile; gives whether nobody else has done so, False where that cannot be known."""
    with ExitStack() as stack:
        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # another file system or user, too
            yield False
        else:
            yield folder.exists()


@contextmanager
def atomic_write(path: Path, *, replace: bool = False, label: str = "") -> Iterator[Path]:
    """A path for a file or folder: it becomes `path` where the block ends well, and is removed where it does not.

    It has the name of `path` in a scratch folder beside it, where other temporary files may lie, too.
    OSError where that fails; FileExistsError where `path` exists by then and `replace` is false.
    """
    with scratch_folder(path.parent, label) as folder:
        part = folder / path.name
        yield part
        for each in (part, *part.rglob("*")):
            if not each.is_dir():
                with each.open("rb+") as file:
                    os.fsync(file.fileno())
        if not replace:
            _rename_new(part, path)
            return
        if part.is_dir() and path.is_dir():
            path.rename(folder / ".replaced")
        part.replace(path)


def _rename_new(part: Path, path: Path) -> None:
    """Give a file or folder the name `path`; FileExistsError where it is taken."""
    if part.is_dir():
        path.mkdir()  # reserves the name
        part.replace(path)
        return
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


@contextmanager
def whole_file(path: Path, *, replace: bool = False, label: str = "") -> Iterator[Path]:
    """`atomic_write` for a file that a user names, or a link to one; TactileError where that cannot be."""
    target = Path(os.path.realpath(path)) if replace else path
    try:
        if target.is_symlink() or (target.exists() and not (target.is_file() or target.is_dir())):
            raise ConfigError(f"{path}: no plain file: give a file that can be written")
        if target.exists() and not replace:
            raise FileExistsError
        with atomic_write(target, replace=replace, label=label) as part:
            yield part
    except FileExistsError as error:
        raise ConfigError(f"{path} is there already: name another file, or remove it first") from error
    except OSError as error:
        raise TactileError(f"{path}: {error.strerror or error}: nothing is written") from error


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hex; ConfigError where it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from error
