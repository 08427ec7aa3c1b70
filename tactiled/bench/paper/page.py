"""One page with the paper's statements, their verdicts, and the figures."""

from collections.abc import Iterator
from html import escape
from pathlib import Path

from tactiled.bench.page import page, table, text
from tactiled.bench.paper.figures import FIGURES
from tactiled.bench.paper.statements import Statement, statements
from tactiled.bench.results import make_folder
from tactiled.charts.style import figure

TITLE = "The mechanical filtering effect of an elastic cover, computed again"
INTRODUCTION = """M. Shimojo, Mechanical Filtering Effect of Elastic Cover for Tactile Sensor, computes how a cover
blurs pressure on its way to a sensor. Here every figure that its text defines is computed twice: by axisymmetric
finite elements that do not lock, and exactly, wavenumber by wavenumber. Unless a row says otherwise the cover is
0.2 mm thick, 98 MPa, Poisson's ratio 0.3, bonded to 1 mm of sensor at 980 MPa and 0.3 on a rigid base."""
HEADINGS = ("Where", "The paper states", "Finite elements", "Exact", "Verdict", "Why")
VERDICTS = {True: "agrees", False: "disagrees", None: "open"}


def write(folder: Path) -> Path:
    """Draw every figure into `folder` and write its page; give the page's path."""
    make_folder(folder)
    for name, height, plot, *_ in FIGURES:
        with figure(folder / name, 10, height) as chart:
            plot(chart)
    path = folder / "index.html"
    path.write_text(page(TITLE, _parts(statements())), encoding="utf-8")
    return path


def _parts(compared: list[Statement]) -> Iterator[str]:
    agree, disagree, unknown = (sum(one.agrees is verdict for one in compared) for verdict in VERDICTS)
    yield f"<h1>{TITLE}</h1>"
    yield text(
        INTRODUCTION,
        f"Of {len(compared)} statements {agree} agree, {disagree} do not, {unknown} cannot be checked.",
    )
    yield "<h2>Statements</h2>"
    rows = [
        (
            one.where,
            one.states,
            *(n.replace("-", "−") for n in (one.fem, one.exact)),
            VERDICTS[one.agrees],
            one.why,
        )
        for one in compared
    ]
    yield table(HEADINGS, rows, good=("agrees",), bad=("disagrees",))
    yield "<h2>Figures</h2>"
    yield text("Lines are the exact solution, marks and pictures the finite elements.")
    for name, *_, number, caption in FIGURES:
        picture = f"<img src='{name}' alt='{escape(caption)}'>"
        yield f"<figure>{picture}<figcaption>{number}. {escape(caption)}</figcaption></figure>"
