import re

from tactiled.bench import page
from tactiled.bench.faults import SWEEPS, Setting
from tactiled.bench.frontier import Effort
from tactiled.bench.skin import rubber
from tests.cli.commands import succeed


def test_the_page_holds_every_chart_and_table_and_needs_nothing_else(tmp_path, monkeypatch):
    some = tuple(sweep for sweep in SWEEPS if sweep.name in ("cover", "white noise", "offset"))
    monkeypatch.setattr("tactiled.bench.faults.SWEEPS", some)
    tiny = Effort(covers=(1.0,), noises=(0.02,), size=12, frames=1, rounds=1, peer_rounds=1, stops=(3,))
    monkeypatch.setattr("tactiled.bench.frontier.REDUCED", tiny)
    setting = Setting(rubber(1.5, 12), 1, ("punches",), step=20)
    monkeypatch.setattr("tactiled.bench.stability.setting", lambda *_: setting)
    assert succeed("bench", "report", "--quick", "--out", tmp_path).strip().endswith("index.html")
    html = (tmp_path / "index.html").read_text()
    assert html.count("<svg") == html.count("</svg>") == 4
    assert not re.search(r'(?:src|href)="(?!#)(?!http://www\.w3\.org)[^"]*//', html)
    assert "auto is on the Pareto front in" in html
    assert "images with the right settings" in html
    assert "<img" not in html
    assert "<script" not in html


def test_tables_are_shaded_and_escaped():
    html = page.table(("a <b>",), (("never",), ("no (1)",), ("<i>",)), good=("never",), bad=("no (1)",))
    assert "<th>a &lt;b&gt;</th>" in html
    assert "<td class='good'>never</td>" in html
    assert "<td class='bad'>no (1)</td>" in html
    assert "<td>&lt;i&gt;</td>" in html
