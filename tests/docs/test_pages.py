"""README and guide: printed blocks are as the code prints them, links lead somewhere, examples work."""

import re
import tomllib
from pathlib import Path
from urllib.parse import unquote

import pytest

from tactiled.config import parse
from tests.docs.blocks import BLOCK, BLOCKS, ROOT, pages, printed

PAGES = pages()
README, GUIDE = PAGES[0], ROOT / "tactiled/docs"
FENCE = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"")
by_page = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)


def anchors(page):
    """The anchors that GitHub gives a page's headings."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page), re.MULTILINE)
    plain = (re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower().strip() for heading in headings)
    return {re.sub(r"[^\w\- ]", "", heading).replace(" ", "-") for heading in plain}


def links(page):
    text = re.sub(r"`[^`]*`", "", FENCE.sub("", page))
    return [one or other for one, other in LINK.findall(text)]


@by_page
def test_its_printed_blocks_are_what_the_code_prints(path):
    page = path.read_text("utf-8")
    assert page == printed(page), "run python -m tests.docs"
    assert page.count("<!-- begin") == page.count("<!-- end") == len(BLOCK.findall(page))


def test_a_block_that_was_edited_is_found():
    page = (GUIDE / "streams.md").read_text("utf-8")
    assert page.replace("| 4401 |", "| 4402 |") != page
    assert printed(page.replace("| 4401 |", "| 4402 |")) == page


def test_every_block_stands_in_a_page():
    found = {found[1] for path in PAGES for found in BLOCK.findall(path.read_text("utf-8"))}
    assert found == set(BLOCKS)


@by_page
def test_its_links_lead_to_files_and_headings_that_exist(path):
    for link in links(path.read_text("utf-8")):
        if link.startswith(("http://", "https://")):
            continue
        name, _, anchor = unquote(link).partition("#")
        there = (path.parent / name).resolve() if name else path
        assert there.is_file(), link
        assert there.is_relative_to(ROOT), link
        assert not anchor or anchor in anchors(there.read_text("utf-8")), link


def test_links_and_anchors_are_found():
    page = '# A *b* `c_d`\n[x](y.md#z) `[no](link)` <img src="p.png">\n```\n# none\n```\n### It\'s [e](f.md)\n'
    assert links(page) == ["y.md#z", "p.png", "f.md"]
    assert anchors(page) == {"a-b-c_d", "its-e"}


def test_the_index_and_the_readme_name_every_page():
    for page, folder in ((GUIDE / "index.md", ""), (README, "tactiled/docs/")):
        named = {link.partition("#")[0] for link in links(page.read_text("utf-8"))}
        assert {f"{folder}{path.name}" for path in PAGES[1:] if path != page} <= named


def test_the_readme_is_short():
    lines = README.read_text("utf-8").splitlines()
    assert len(lines) <= 300
    assert max(len(line) for line in lines if not line.startswith("|")) <= 115


@by_page
def test_its_toml_can_be_read(path):
    for text in re.findall(r"```toml\n(.*?)```", path.read_text("utf-8"), re.DOTALL):
        if text.startswith("# one of these"):
            for line in text.splitlines()[1:]:
                tomllib.loads(line)
        else:
            tomllib.loads(text)


def test_the_configuration_page_begins_with_a_whole_file():
    text = re.search(r"```toml\n(.*?)```", (GUIDE / "configuration.md").read_text("utf-8"), re.DOTALL)[1]
    assert parse(text, "palm.toml").sensor["palm"].codec.name == "packed"


def test_the_package_has_the_guide():
    project = tomllib.loads(Path(ROOT / "pyproject.toml").read_text("utf-8"))
    assert "docs/**" in project["tool"]["setuptools"]["package-data"]["tactiled"]
