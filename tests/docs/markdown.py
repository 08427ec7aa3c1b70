"""Lines of Markdown."""

from functools import wraps

BLOCKS = {}  # functions that give the lines of a block, by its name


def is_block(function):
    """Mark a function whose name with - for _ is that of a block."""
    BLOCKS[function.__name__.replace("_", "-")] = function
    return function


def is_table(*head):
    """Mark a function whose rows are a block of the guide, under this head."""
    return lambda rows: is_block(wraps(rows)(lambda: table(head, rows())))


def fenced(lines):
    """Mark a function whose lines are a block of text."""
    return is_block(wraps(lines)(lambda: ("```text", *lines(), "```")))


def table(head, rows):
    """The lines of a table; the first column is never empty."""
    return [line(head), "|" + "---|" * len(head), *map(line, rows)]


def line(cells):
    return "".join(f"| {' '.join(cell.split()).replace('|', chr(92) + '|')} " for cell in cells) + "|"


def code(text):
    return f"`{text}`"


def codes(values):
    return ", ".join(map(code, values))


def sentence(text):
    """With a capital letter, unless it begins with code, and a full stop."""
    text = text.strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!")) else ".")
