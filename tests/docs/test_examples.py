"""Programs of the guide, run as they are written there."""

import re
import tomllib

import numpy as np
import pytest

from tactiled.bus import recording, skins
from tactiled.config.example import GRASP
from tests.cli.commands import succeed
from tests.conftest import pressed
from tests.docs.blocks import GUIDE


def read(name):
    return (GUIDE / name).read_text("utf-8")


def program(name):
    """The only Python program of a page."""
    (text,) = re.findall(r"```python\n(.*?)```", read(name), re.DOTALL)
    return text


def test_the_client_of_the_streams_page_prints_the_newest_image(rig, url, capsys):
    rig.stale_after(600)
    image = rig.show(pressed())
    client = program("streams.md").replace("ws://127.0.0.1:8000", url.replace("http", "ws", 1))
    asks_again = """        socket.send('{"type": "next"}')\n"""
    assert client.endswith(asks_again)
    exec(client.removesuffix(asks_again) + "        break\n", {})
    assert capsys.readouterr().out == f"{image.sequence} {image.restored.max()!s} kPa\n"


def test_the_rest_example_adds_up_the_force(rig, url, capsys):
    rig.show(pressed())
    exec(program("api.md").replace("http://127.0.0.1:8000", url), {})
    image = rig.sensor.hub.latest()
    assert float(capsys.readouterr().out.split()[0]) == pytest.approx(float(image.restored.sum()) * 1e-3)


def test_an_export_has_the_arrays_of_the_recordings_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hand.toml").write_text(GRASP)
    succeed("export", recording.path("book_1"), "--config", "hand.toml", "-o", "grasp.npz")
    rows = read("recordings.md").split("| Array | Meaning |")[1].split("\n\n")[0]
    names = re.findall(r"`(\w+)`", "".join(line.split("|")[1] for line in rows.splitlines()[2:]))
    assert set(np.load("grasp.npz")) == {*names} - {
        "shear",
        "noise_kpa",
        "regions",
        "region",
        "measure",
        "traction",
        "traction_deviation",
    }  # uncalibrated, none set
    capsys.readouterr()
    exec(program("recordings.md"), {})
    assert "counts" in capsys.readouterr().out


def test_the_restoration_page_restores_an_array_of_frames(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hand.toml").write_text(GRASP)
    np.save("frames.npy", np.zeros((3, 60)))
    exec(program("restoration.md").replace("palm", "hand"), {})
    assert capsys.readouterr().out == "0.0 counts idle\n"


def test_the_codecs_page_has_a_line_for_every_codec():
    lines = re.search(r"# one of these.*?\n(.*?)```", read("codecs.md"), re.DOTALL)[1].splitlines()
    assert {tomllib.loads(line)["codec"]["name"] for line in lines} == {*skins.BUILT_IN} - {"pushed"}
