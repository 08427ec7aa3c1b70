"""Programs of the guide, run as they are written there."""

import re
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

from tactiled.bus import recording, skins
from tactiled.cli.app import app
from tactiled.cli.demo import demo_config
from tactiled.config.example import GRASP
from tests.conftest import pressed
from tests.docs.blocks import ROOT
from tests.docs.settings import models


def programs(name):
    """The Python programs of a page."""
    return re.findall(r"```python\n(.*?)```", (ROOT / "tactiled/docs" / name).read_text("utf-8"), re.DOTALL)


def test_the_client_of_the_streams_page_prints_the_newest_image(rig, url, capsys):
    rig.stale_after(600)
    image = rig.show(pressed())
    (program,) = programs("streams.md")
    once = program.replace("ws://127.0.0.1:8000", url.replace("http", "ws", 1))
    asks_again = """        socket.send('{"type": "next"}')\n"""
    assert once.endswith(asks_again)
    exec(once.removesuffix(asks_again) + "        break\n", {})
    assert capsys.readouterr().out == f"{image.sequence} {image.restored.max()!s} kPa\n"


def test_the_rest_example_adds_up_the_force(rig, url, capsys):
    rig.show(pressed())
    (program,) = programs("api.md")
    exec(program.replace("http://127.0.0.1:8000", url), {})
    image = rig.sensor.hub.latest()
    assert float(capsys.readouterr().out.split()[0]) == pytest.approx(float(image.restored.sum()) * 1e-3)


def test_an_export_has_the_arrays_of_the_recordings_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hand.toml").write_text(GRASP)
    done = CliRunner().invoke(
        app, ["export", str(recording.path("book_1")), "--config", "hand.toml", "-o", "grasp.npz"]
    )
    assert done.exit_code == 0, done.output
    page = (ROOT / "tactiled/docs/recordings.md").read_text("utf-8")
    rows = page.split("| Array | Meaning |")[1].split("\n\n")[0]
    named = re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in rows.splitlines()[2:]))
    assert set(np.load("grasp.npz")) == {*named} - {"shear"}
    (program,) = programs("recordings.md")
    exec(program, {})
    assert "kPa" in capsys.readouterr().out


def test_the_demo_is_as_the_simulation_page_says():
    page = (ROOT / "tactiled/docs/simulation.md").read_text("utf-8")
    for arguments in ({}, {"shear": True}, {"record": "book_1"}):
        (name,) = demo_config(**arguments).sensor
        assert not arguments or f"`{name}`" in page
    assert all(f"`{name}`" in page for name in recording.names())


def test_the_codecs_page_has_a_line_for_every_codec():
    page = (ROOT / "tactiled/docs/codecs.md").read_text("utf-8")
    lines = re.search(r"# one of these.*?\n(.*?)```", page, re.DOTALL)[1].splitlines()
    named = [tomllib.loads(line)["codec"]["name"] for line in lines]
    assert sorted(named) == sorted(skins.BUILT_IN) == sorted(models())
