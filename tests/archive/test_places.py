"""Inputs and outputs by fsspec: in memory, in a zip file, and on a disk by URL."""

import sys
import zipfile

import pytest
from fsspec.implementations.memory import MemoryFileSystem

from tactiled.archive.places import Place, inputs, place
from tactiled.errors import ConfigError, TactileError

MEMORY = MemoryFileSystem()
PASSWORD, SECRET = "correct-horse", "battery-staple"


@pytest.fixture
def memory():
    """The file system in memory, which all of a process share."""
    MEMORY.pseudo_dirs[:] = [""]
    MEMORY.store.clear()
    yield MEMORY
    MEMORY.store.clear()


@pytest.fixture
def folder(tmp_path):
    for name in ("a.log", "b.log.gz", "deep/c.blf", "deep/notes.txt", "E.LOG.GZ"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    return tmp_path


def names(*paths):
    return {
        name: str(each)
        for name, each in inputs([str(path) for path in paths], (".log", ".log.gz", ".blf")).items()
    }


def test_inputs_are_files_patterns_and_all_recordings_of_folders(folder):
    assert names(folder) == {
        "a": f"{folder}/a.log",
        "b": f"{folder}/b.log.gz",
        "E": f"{folder}/E.LOG.GZ",
        "deep/c": f"{folder}/deep/c.blf",
    }
    assert names(f"{folder}/*.log", f"file://{folder}/deep/notes.txt") == {
        "a": f"{folder}/a.log",
        "notes": f"{folder}/deep/notes.txt",
    }
    assert [*names(f"{folder}/**/*.blf", folder / "a.log", folder / "a.log")] == ["c", "a"]


def test_inputs_of_one_name_and_none_at_all_are_refused(folder):
    (folder / "deep" / "a.blf").write_text("other")
    with pytest.raises(ConfigError, match=r"deep/a\.blf: .*/a\.log has the same name"):
        names(folder / "a.log", f"{folder}/deep/*")
    with pytest.raises(ConfigError, match=r"none\*: no file there"):
        names(f"{folder}/none*")


def test_a_zip_file_is_an_input(folder):
    with zipfile.ZipFile(folder / "x.zip", "w") as archive:
        archive.writestr("runs/a.log", "zipped")
    assert names(f"zip://runs::file://{folder}/x.zip") == {"a": "zip://runs/a.log"}
    with place(f"zip://runs/a.log::file://{folder}/x.zip").local() as copy:
        assert (copy.name, copy.read_text()) == ("a.log", "zipped")
    assert not copy.exists()


def test_an_output_elsewhere_has_its_name_only_when_it_is_whole(memory):
    target = place("memory://out/a.zarr")
    with target.written(replace=False) as part:
        (part / "c").mkdir(parents=True)
        (part / "c" / "0").write_text("new")
        assert not memory.find("/")
    assert memory.find("/") == ["/out/a.zarr/c/0"]
    with (
        pytest.raises(ConfigError, match=r"memory:///out/a\.zarr is there already"),
        target.written(replace=False),
    ):
        pass
    with pytest.raises(KeyboardInterrupt), target.written(replace=True) as part:
        raise KeyboardInterrupt
    with target.written(replace=True) as part:
        part.write_text("file")
    assert (memory.find("/"), memory.cat("/out/a.zarr")) == (["/out/a.zarr"], b"file")


class Locked(MemoryFileSystem):
    """Shows its settings and whole paths in errors, as file systems of the web do."""

    protocol = "locked"

    def get_file(self, path, *_, **__):
        raise PermissionError(f"{self.storage_options} may not read {path}")


def test_credentials_are_never_printed():
    url = f"locked://me:{PASSWORD}@host/a.log?token={PASSWORD}-too"
    one = Place(url, Locked(secret=SECRET))
    with pytest.raises(TactileError, match="may not read") as failure, one.local():
        pass
    for each in (PASSWORD, SECRET):
        assert each not in f"{failure.value} {one} {one!r} {one.name}"
    assert str(one) == "locked://host/a.log"
    with pytest.raises(TactileError, match=r"ftp://127\.0\.0\.1:1/a\.log: Connection refused") as failure:
        place(f"ftp://me:{PASSWORD}@127.0.0.1:1/a.log")
    assert PASSWORD not in str(failure.value)


@pytest.mark.parametrize(
    ("url", "message"),
    [("nowhere://a.log", "Protocol not known: nowhere"), ("s3://bucket/a.log", "Install s3fs to access S3")],
)
def test_a_file_system_that_is_not_there_is_named(url, message):
    with pytest.raises(TactileError, match=message):
        place(url)


def test_without_fsspec_one_file_of_this_machine_needs_none(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    assert place("a.log").path == "a.log"
    with pytest.raises(ConfigError, match=r"memory://a\.log: .* need fsspec: pip install 'tactiled\[fsspec\]'"):
        place("memory://a.log")
