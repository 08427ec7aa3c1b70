"""Blocks of README and guide that code prints, between `<!-- begin: NAME -->` and `<!-- end -->`."""

import re
from functools import cache
from pathlib import Path

from tests.docs import covers, examples, tables  # noqa: F401  # whose blocks register
from tests.docs.markdown import BLOCKS

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "tactiled/docs"
BLOCK = re.compile(r"(<!-- begin: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def pages():
    """README and every page of the guide."""
    return [ROOT / "README.md", *sorted(GUIDE.glob("*.md"))]


@cache
def block(name):
    """The lines of one block; KeyError where no block has this name."""
    return "".join(f"{line}\n" for line in BLOCKS[name]())


def printed(page):
    """A page with its blocks printed again."""
    return BLOCK.sub(lambda match: f"{match[1]}{block(match[2])}{match[3]}", page)
