"""Rows to Markdown."""

from collections.abc import Iterable, Iterator


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> Iterator[str]:
    """The lines of a table; the first column is never empty."""
    head = list(head)
    yield line(head)
    yield "|" + "---|" * len(head)
    yield from map(line, rows)


def line(cells: Iterable[str]) -> str:
    return "".join(f"| {cell.replace('|', chr(92) + '|')} " for cell in cells) + "|"


def code(text: object) -> str:
    return f"`{text}`"


def sentence(text: str) -> str:
    """With a capital letter, unless it begins with code, and a full stop."""
    text = text.strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!")) else ".")
