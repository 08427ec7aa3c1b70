"""Pieces of a self-contained page: tables, charts inlined, a style that prints."""

import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

STYLE = """
:root { color-scheme: light; --ink: #1b1f24; --soft: #55606b; --line: #d8dde3; --blue: #0072b2; }
* { box-sizing: border-box; }
body { font: 16px/1.55 system-ui, sans-serif; color: var(--ink); background: #fff; margin: 0 auto; }
body { max-width: 68rem; padding: 2.5rem 1.25rem 4rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .5rem; letter-spacing: -.01em; }
h2 { font-size: 1.35rem; margin: 3.25rem 0 .5rem; padding-top: 1rem; border-top: 2px solid var(--ink); }
h3 { font-size: 1.02rem; margin: 1.75rem 0 .4rem; }
p, ul { max-width: 46rem; margin: .5rem 0; }
summary { color: var(--blue); cursor: pointer; }
code { background: #f1f4f7; border-radius: .25rem; padding: .1rem .35rem; font-size: .9em; }
.soft { color: var(--soft); font-size: .92rem; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); gap: 1rem; }
.tiles { margin: 1.75rem 0; }
.tile { border: 1px solid var(--line); border-radius: .6rem; padding: .9rem 1.1rem 1rem; }
.tile b { display: block; font-size: 1.75rem; line-height: 1.25; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: .9rem; line-height: 1.4; display: block; }
nav { margin: 1rem 0 0; font-size: .95rem; }
nav a { color: var(--blue); margin-right: 1.1rem; white-space: nowrap; }
figure { margin: 1.25rem 0 1.75rem; }
figure svg, figure img { display: block; width: 100%; height: auto; }
figcaption { color: var(--soft); font-size: .92rem; max-width: 46rem; margin-top: .4rem; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .86rem; line-height: 1.35; width: 100%; }
th, td { border-bottom: 1px solid var(--line); padding: .4rem .55rem; text-align: left; vertical-align: top; }
th { border-bottom: 2px solid #444; vertical-align: bottom; }
td { font-variant-numeric: tabular-nums; }
td.good { background: #e6f1f8; }
td.bad { background: #fbe8dc; }
@media print { h2 { break-after: avoid; } figure { break-inside: avoid; } }
"""


def page(title: str, parts: Iterable[str]) -> str:
    """Give a whole document."""
    head = '<meta charset="utf-8">\n<meta name="viewport" content="width=device-width, initial-scale=1">'
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n{head}\n<title>{escape(title)}</title>\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n" + "\n".join(parts) + "\n</body>\n</html>\n"
    )


def svg(path: Path, caption: str) -> str:
    """Give an SVG file as part of the page, as wide as the text."""
    drawing = path.read_text(encoding="utf-8")
    drawing = drawing[drawing.index("<svg") :]
    first = drawing.index(">")
    tag = re.sub(r'\s(width|height)="[^"]*"', "", drawing[:first])
    label = f' role="img" aria-label="{escape(caption, quote=True)}"'
    body = re.sub(r"<metadata>.*?</metadata>", "", drawing[first:], flags=re.DOTALL)
    return f"<figure>{tag}{label}{body}<figcaption>{escape(caption)}</figcaption></figure>"


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], good: str = "", bad: str = "") -> str:
    """Give a table; cells that match the pattern `good` or `bad` wholly are shaded."""
    head = "".join(f"<th>{escape(name)}</th>" for name in headings)
    body = "".join("<tr>" + "".join(_cell(cell, good, bad) for cell in row) + "</tr>\n" for row in rows)
    return f"<div class='scroll'><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>"


def _cell(text: str, good: str, bad: str) -> str:
    kind = next(
        (name for name, pattern in (("good", good), ("bad", bad)) if re.fullmatch(pattern or "$.", text)), ""
    )
    return f"<td class='{kind}'>{escape(text)}</td>" if kind else f"<td>{escape(text)}</td>"


def tiles(pairs: Iterable[tuple[str, str]]) -> str:
    """Give figures in large type, each with its meaning."""
    each = "".join(f"<div class='tile'><b>{escape(a)}</b><span>{escape(b)}</span></div>" for a, b in pairs)
    return f"<div class='tiles'>{each}</div>"


def text(*paragraphs: str) -> str:
    """Give paragraphs; `code` in backticks."""
    coded = (re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(each)) for each in paragraphs)
    return "\n".join(f"<p>{each}</p>" for each in coded)
