import re

from typer.testing import CliRunner

from tactiled.cli import bench_contacts
from tactiled.cli.app import app
from tactiled.study.contacts import measure


def test_the_restored_image_tells_better_where_how_strong_and_how_many():
    raw, restored = measure(2.0, 0.01, 12)
    assert (raw.one, restored.one) == (1, 1)
    assert restored.off_mm < raw.off_mm < 0.03
    assert restored.far_mm < raw.far_mm
    assert restored.force < 0.02 < 0.05 < raw.force
    assert restored.gap_mm < raw.gap_mm


def test_the_same_seed_gives_the_same_figures_and_another_others():
    assert measure(1.0, 0.01, 4) == measure(1.0, 0.01, 4)
    assert measure(1.0, 0.01, 4, seed=2)[0].off_mm != measure(1.0, 0.01, 4)[0].off_mm


def test_the_table(monkeypatch):
    monkeypatch.setattr(bench_contacts, "THICKNESSES", (1.0,))
    monkeypatch.setattr(bench_contacts, "NOISES", (0.01,))
    done = CliRunner().invoke(app, ["bench", "contacts", "--repeats", "4"], env={"COLUMNS": "100"})
    assert done.exit_code == 0
    raw, restored = measure(1.0, 0.01, 4)
    row = rf"1, 1 % +│ +100 / 100 │ +{raw.off_mm:.3f} / {restored.off_mm:.3f} │"
    assert re.search(row, done.stdout)
