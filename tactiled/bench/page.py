"""Pieces of a self-contained page: tables, charts inlined, a style that prints."""

import re
from collections.abc import Collection, Iterable, Sequence
from html import escape
from pathlib import Path

STYLE = Path(__file__).with_suffix(".css").read_text(encoding="utf-8")


def page(title: str, parts: Iterable[str]) -> str:
    """Give a whole document."""
    head = '<meta charset="utf-8">\n<meta name="viewport" content="width=device-width, initial-scale=1">'
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n{head}\n<title>{escape(title)}</title>\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n" + "\n".join(parts) + "\n</body>\n</html>\n"
    )


def svg(path: Path) -> str:
    """Give an SVG file as part of the page, as wide as the text."""
    drawing = path.read_text(encoding="utf-8")
    start = drawing.index("<svg")
    end = drawing.index(">", start)
    tag = re.sub(r'\s(width|height)="[^"]*"', "", drawing[start:end])
    return tag + re.sub(r"<metadata>.*?</metadata>", "", drawing[end:], flags=re.DOTALL)


def table(
    headings: Sequence[str], rows: Iterable[Sequence[str]], good: Collection[str] = (), bad: Collection[str] = ()
) -> str:
    """Give a table; the cells in `good` and in `bad` are shaded."""
    classes = dict.fromkeys(good, " class='good'") | dict.fromkeys(bad, " class='bad'")
    head = "".join(f"<th>{escape(name)}</th>" for name in headings)
    cells = ("".join(f"<td{classes.get(cell, '')}>{escape(cell)}</td>" for cell in row) for row in rows)
    body = "".join(f"<tr>{row}</tr>\n" for row in cells)
    return f"<div class='scroll'><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>"


def text(*paragraphs: str) -> str:
    """Give paragraphs; `code` in backticks."""
    coded = (re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(each)) for each in paragraphs)
    return "\n".join(f"<p>{each}</p>" for each in coded)
