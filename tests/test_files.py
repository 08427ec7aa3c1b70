import errno
import os

import pytest

from tactiled.files import whole


def names(folder):
    return [each.name for each in folder.iterdir()]


def write(path, after=id, **how):
    with whole(path, **how) as part:
        part.write_text("new")
        after(part)


def test_a_file_gets_its_name_once_it_is_whole(tmp_path):
    with whole(tmp_path / "a") as part:
        part.write_text("new")
        assert "a" not in names(tmp_path)
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "new"


def test_one_that_is_there_by_then_is_kept_unless_it_is_to_be_replaced(tmp_path):
    path = tmp_path / "a"
    with pytest.raises(FileExistsError):
        write(path, lambda _: path.write_text("mine"))
    assert (path.read_text(), names(tmp_path)) == ("mine", ["a"])
    write(path, replace=True)
    assert (path.read_text(), names(tmp_path)) == ("new", ["a"])


@pytest.mark.parametrize("fault", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt(), ValueError()])
@pytest.mark.parametrize("replace", [False, True])
def test_nothing_is_left_of_one_that_was_not_finished(tmp_path, fault, replace):
    def fail(_):
        raise fault

    with pytest.raises(type(fault)):
        write(tmp_path / "a", fail, replace=replace)
    assert not names(tmp_path)


@pytest.mark.parametrize("replace", [False, True])
def test_a_part_that_somebody_removed_is_an_error(tmp_path, replace):
    with pytest.raises(FileNotFoundError):
        write(tmp_path / "a", lambda part: part.unlink(), replace=replace)
    assert not names(tmp_path)


def test_a_file_system_without_links_overwrites_nothing_either(tmp_path, monkeypatch):
    def link(*_, **__):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)
    path = tmp_path / "a"
    write(path)
    assert (path.read_text(), names(tmp_path)) == ("new", ["a"])
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        write(path)
    assert (path.read_text(), names(tmp_path)) == ("mine", ["a"])


def test_a_write_that_fails_at_its_last_step_leaves_no_name(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.ENOTSUP, "Operation not supported")

    monkeypatch.setattr(os, "link", fail)
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="not supported"):
        write(tmp_path / "a")
    assert not names(tmp_path)


def test_two_writers_of_one_name_do_not_meet(tmp_path):
    path = tmp_path / "a"
    with whole(path, replace=True) as one, whole(path, replace=True) as other:
        one.write_text("one")
        other.write_text("other")
    assert (path.read_text(), names(tmp_path)) == ("one", ["a"])
