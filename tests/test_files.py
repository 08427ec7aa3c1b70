import errno
import os
import subprocess
import sys
from unittest.mock import Mock

import pytest

from tactiled.files import atomic_write, clear_scratch


def names(folder):
    return [each.name for each in folder.iterdir()]


def write(path, meanwhile=id, **options):
    with atomic_write(path, **options) as part:
        part.write_text("new")
        assert path.name not in names(path.parent) or path.read_text() == "old"
        meanwhile(part)


@pytest.mark.parametrize("links", [True, False])
def test_a_new_file_never_overwrites_one_that_exists_by_the_end(tmp_path, monkeypatch, links):
    if not links:
        monkeypatch.setattr(os, "link", Mock(side_effect=OSError(errno.EPERM, "Operation not permitted")))
    path = tmp_path / "a"
    write(path)
    assert (path.read_text(), names(tmp_path)) == ("new", ["a"])
    path.unlink()
    with pytest.raises(FileExistsError):
        write(path, lambda _: path.write_text("old"))
    assert (path.read_text(), names(tmp_path)) == ("old", ["a"])
    write(path, replace=True)
    assert (path.read_text(), names(tmp_path)) == ("new", ["a"])


@pytest.mark.parametrize("replace", [False, True])
def test_an_unfinished_file_is_removed(tmp_path, replace):
    for fault in (OSError(errno.ENOSPC, "full"), KeyboardInterrupt(), ValueError()):
        with pytest.raises(type(fault)):
            write(tmp_path / "a", Mock(side_effect=fault), replace=replace)
    with pytest.raises(FileNotFoundError):  # somebody removed it
        write(tmp_path / "a", lambda part: part.unlink(), replace=replace)
    assert not names(tmp_path)


def test_a_failed_rename_leaves_no_name_behind(tmp_path, monkeypatch):
    for call in ("link", "replace"):
        monkeypatch.setattr(os, call, Mock(side_effect=OSError(errno.ENOTSUP, "Operation not supported")))
    with pytest.raises(OSError, match="not supported"):
        write(tmp_path / "a")
    assert not names(tmp_path)


def test_two_writers_of_one_name_do_not_share_a_part(tmp_path):
    path = tmp_path / "a"
    with atomic_write(path, replace=True) as one, atomic_write(path, replace=True) as other:
        one.write_text("one")
        other.write_text("other")
    assert (path.read_text(), names(tmp_path)) == ("one", ["a"])


def test_a_folder_is_renamed_with_its_files_and_replaces_only_if_it_may(tmp_path):
    path = tmp_path / "a"
    for text, replace in (("one", False), ("two", True)):
        with atomic_write(path, replace=replace) as part:
            (part / "deep").mkdir(parents=True)
            (part / "deep" / "b").write_text(text)
        assert ((path / "deep" / "b").read_text(), names(tmp_path)) == (text, ["a"])
    with pytest.raises(FileExistsError), atomic_write(path) as part:
        part.mkdir()
    assert ((path / "deep" / "b").read_text(), names(tmp_path)) == ("two", ["a"])


KILLED = """
import os, sys
from pathlib import Path
from tactiled.files import atomic_write
with atomic_write(Path(sys.argv[1])) as part:
    part.write_bytes(bytes(1000))
    os.kill(os.getpid(), 9)
"""


def test_what_a_killed_process_left_is_removed_and_what_is_in_use_is_not(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "a.log")], check=False)
    assert len(list(tmp_path.glob(".tactiled-*/a.log"))) == 1
    with atomic_write(tmp_path / "b.log") as part:
        part.touch()
        clear_scratch(tmp_path)
        assert [each.name for each in tmp_path.glob(".tactiled-*/*")] == ["b.log"]
    assert [each.name for each in tmp_path.iterdir()] == ["b.log"]
