"""One page with the paper's statements, what became of them, and the figures."""

import re
from collections.abc import Iterator
from html import escape
from pathlib import Path

from tactiled.errors import ConfigError
from tactiled.study.paper import gains, pictures
from tactiled.study.paper.claims import Claim
from tactiled.study.paper.figures import FIGURES

VERDICTS = {True: ("yes", "agrees"), False: ("no", "disagrees"), None: ("open", "open")}

HEAD = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The mechanical filtering effect of an elastic cover, computed again</title>
<style>
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1b1f24; margin: 0 auto; max-width: 72rem; }
body { padding: 2rem 1rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 .5rem; }
col.where { width: 13%; }
col.states { width: 22%; }
col.number { width: 12%; }
col.verdict { width: 11%; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 .75rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .92rem; min-width: 62rem; table-layout: fixed; width: 100%; }
th, td { border-bottom: 1px solid #d8dde3; padding: .5rem .6rem; text-align: left; vertical-align: top; }
th { border-bottom: 2px solid #444; }
td { font-variant-numeric: tabular-nums; }
span { border-radius: .3rem; font-weight: 600; padding: .1rem .45rem; white-space: nowrap; }
.yes { background: #d9ecf7; color: #00466f; }
.no { background: #fbe3d2; color: #7d3600; }
.open { background: #e8eaed; color: #3c4248; }
figure { margin: 0 0 2rem; }
img { height: auto; max-width: 60rem; width: 100%; }
figcaption { color: #444b53; font-size: .95rem; }
</style>
</head>
<body>
<h1>The mechanical filtering effect of an elastic cover, computed again</h1>
"""

INTRODUCTION = """<p>M. Shimojo, <cite>Mechanical Filtering Effect of Elastic Cover for Tactile Sensor</cite>,
computes how a cover blurs pressure on its way to a sensor. Here every figure that its text defines is computed
twice: by axisymmetric finite elements that do not lock, and exactly, wavenumber by wavenumber. Unless a row says
otherwise the cover is 0.2&nbsp;mm thick, 98&nbsp;MPa, Poisson's ratio 0.3, bonded to 1&nbsp;mm of sensor at
980&nbsp;MPa and 0.3 on a rigid base.</p>
"""

COLUMNS = """<colgroup><col class="where"><col class="states"><col class="number"><col class="number">
<col class="verdict"><col></colgroup>
<tr><th>Where</th><th>The paper states</th><th>Finite elements</th><th>Exact</th><th>Verdict</th><th>Why</th></tr>
"""


def claims() -> list[Claim]:
    """Check every statement of the paper that its text defines."""
    parts = (
        gains.response,
        gains.thickness,
        gains.modulus,
        gains.poisson,
        pictures.ring,
        pictures.materials,
        pictures.rod,
    )
    return [claim for part in parts for claim in part()]


def write(folder: Path) -> Path:
    """Draw every figure into `folder` and write its page; give the page's path."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"folder {folder} cannot be made: {error.strerror}") from error
    for name, _, _, draw in FIGURES:
        draw(folder / name)
    page = folder / "index.html"
    text = "".join(_page(claims()))
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"page {page} cannot be written: {error.strerror}") from error
    return page


def _page(checked: list[Claim]) -> Iterator[str]:
    """Give the page piece by piece."""
    yield HEAD
    yield INTRODUCTION
    agree, disagree, unknown = (sum(claim.agrees is verdict for claim in checked) for verdict in VERDICTS)
    yield f"<p>Of {len(checked)} statements {agree} agree, {disagree} do not, {unknown} cannot be checked.</p>\n"
    yield "<h2>What the paper states, and what is found</h2>\n<div class='scroll'><table>\n"
    yield COLUMNS
    for claim in checked:
        yield _row(claim)
    yield "</table></div>\n<h2>Figures</h2>\n"
    yield "<p>Lines are the exact solution, marks and pictures the finite elements.</p>\n"
    for name, number, caption, _ in FIGURES:
        picture = f"<img src='{name}' alt='{escape(caption)}'>"
        yield f"<figure>{picture}<figcaption>{number}. {escape(caption)}</figcaption></figure>\n"
    yield "</body>\n</html>\n"


def _row(claim: Claim) -> str:
    """Give a claim's row of the table."""
    style, word = VERDICTS[claim.agrees]
    cells = (
        f"<td>{escape(claim.where)}</td><td>{escape(claim.states)}</td>"
        f"<td>{_number(claim.fem)}</td><td>{_number(claim.exact)}</td>"
    )
    return f"<tr>{cells}<td><span class='{style}'>{word}</span></td><td>{escape(claim.why)}</td></tr>\n"


def _number(text: str) -> str:
    """Escape a cell, a true minus before its numbers, powers of ten written out."""
    ten = re.sub(r"(\d)e-0*(\d+)", r"\1 × 10<sup>−\2</sup>", escape(text))
    return re.sub(r"(^|\s)-(?=\d)", r"\1−", ten)
