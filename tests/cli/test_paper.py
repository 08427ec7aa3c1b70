import pytest
from typer.testing import CliRunner

from tactiled.cli import app as cli
from tactiled.errors import ConfigError
from tactiled.study.paper import page


def test_paper_names_its_page(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "FIGURES", ())
    monkeypatch.setattr(page, "claims", list)
    result = CliRunner().invoke(cli.app, ["paper", str(tmp_path / "new" / "folder")])
    assert result.exit_code == 0, result.output
    assert result.output.strip() == str(tmp_path / "new" / "folder" / "index.html")
    assert (tmp_path / "new" / "folder" / "index.html").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"folder .*file/here cannot be made: Not a directory"):
        CliRunner().invoke(cli.app, ["paper", str(tmp_path / "file" / "here")], catch_exceptions=False)


def test_a_page_that_cannot_be_written_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(page, "FIGURES", ())
    monkeypatch.setattr(page, "claims", list)
    (tmp_path / "index.html").mkdir()
    with pytest.raises(ConfigError, match=r"page .*index.html cannot be written: Is a directory"):
        CliRunner().invoke(cli.app, ["paper", str(tmp_path)], catch_exceptions=False)
