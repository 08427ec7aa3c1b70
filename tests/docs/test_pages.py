"""README and guide: printed blocks and tables of names agree with the code, links lead somewhere."""

import ast
import re
import tomllib
from collections import Counter
from typing import get_args
from urllib.parse import unquote

import pytest

from tactiled.bus.socketcan import KINDS
from tactiled.config import parse
from tactiled.diagnostics.warning_codes import TEXTS, warning
from tactiled.frames import Loss
from tactiled.live.events import Kind
from tactiled.restore import auto, points
from tactiled.restore import methods as method_table
from tests.attack.attacks import ATTACKS
from tests.docs.blocks import BLOCK, GUIDE, ROOT, pages, printed
from tests.docs.markdown import BLOCKS, code

PAGES = pages()
README = PAGES[0]
FENCE = re.compile(r"^ *```.*?^ *```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"")
WARNING_VALUES = {
    "wrong": "taxels 40 and 77 swapped",
    "unused": "", "pitch_mm": 1, "budget_ms": 1, "gap": "finer than 3.1 mm",
    "measured": 0.5, "noise": 0.2, "unit": "kPa", "source": "configured"
}  # fmt: skip
WHY_VALUES = {auto.RAW: 0.003, auto.WIENER: 0.003, auto.SHARP: 0.04, auto.LOADS: 3}
by_page = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)


def read(name):
    return (GUIDE / name).read_text("utf-8")


def reasons():
    """Every reason for a method, with an example's number: the sentences among these modules' constants."""
    for module in (auto, points, method_table):
        for name, text in vars(module).items():
            if name.isupper() and isinstance(text, str) and " " in text:
                yield text.format(WHY_VALUES.get(text))


NAMES = {
    ("bus.md", "Count"): {*map(code, Loss.__dataclass_fields__)},
    ("bus.md", "Kind"): {*map(code, KINDS)},
    ("api.md", "`kind`"): {*map(code, get_args(Kind))},
    ("restoration.md", "`method`"): {*map(code, method_table.METHODS)},
    ("restoration.md", "`why`"): {*reasons()},
}  # page and head of a table whose first column names everything of one kind


def cells(page, head):
    """The rows of a page's table, whose first column has this head."""
    rows = read(page).split(f"\n| {head} |")[1].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("|").split(" | ")] for row in rows if row.startswith("|")]


def anchors(page):
    """The anchors that GitHub gives a page's headings."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", page), re.MULTILINE)
    texts = (re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower().strip() for heading in headings)
    return {re.sub(r"[^\w\- ]", "", text).replace(" ", "-") for text in texts}


def links(page):
    text = re.sub(r"`[^`]*`", "", FENCE.sub("", page))
    return [one or other for one, other in LINK.findall(text)]


@by_page
def test_printed_blocks_are_what_the_code_prints(path):
    page = path.read_text("utf-8")
    assert page == printed(page), "run python -m tests.docs"
    assert page.count("<!-- begin") == page.count("<!-- end") == len(BLOCK.findall(page))


def test_every_block_is_in_a_page():
    assert {match[1] for path in PAGES for match in BLOCK.findall(path.read_text("utf-8"))} == set(BLOCKS)


@pytest.mark.parametrize(("page", "head"), NAMES)
def test_a_table_has_a_row_for_each_name(page, head):
    assert {row[0] for row in cells(page, head)} == NAMES[page, head]


def test_warnings_have_their_texts():
    rows = {row[0]: row[1] for row in cells("restoration.md", "`code`")}
    assert rows == {code(each): warning(each, 2, **WARNING_VALUES).text for each in TEXTS}


@by_page
def test_links_lead_to_files_and_headings_that_exist(path):
    for link in links(path.read_text("utf-8")):
        if link.startswith(("http://", "https://")):
            continue
        name, _, anchor = unquote(link).partition("#")
        target = (path.parent / name).resolve() if name else path
        assert target.is_file(), link
        assert target.is_relative_to(ROOT), link
        assert not anchor or anchor in anchors(target.read_text("utf-8")), link


def test_every_test_that_the_guide_names_exists():
    names = re.findall(
        r"`tests/(\S+\.py)::(\w+)(?:\[([\w-]+)\])?`", "".join(map(read, ("faults.md", "deployment.md")))
    )
    assert len(names) > 20
    for path, test, parameter in names:
        text = (ROOT / "tests" / path).read_text("utf-8")
        assert re.search(rf"^(async )?def {test}\(", text, re.MULTILINE), f"{path}::{test}"
        assert not parameter or parameter in ATTACKS, f"{path}::{test}[{parameter}]"


def test_the_index_and_the_readme_name_every_page():
    for page, folder in ((GUIDE / "index.md", ""), (README, "tactiled/docs/")):
        names = {link.partition("#")[0] for link in links(page.read_text("utf-8"))}
        assert {f"{folder}{path.name}" for path in PAGES[1:] if path != page} <= names


def test_the_readme_is_short():
    assert len(README.read_text("utf-8").splitlines()) <= 200


@by_page
def test_toml_can_be_read(path):
    for text in re.findall(r"```toml\n(.*?)```", path.read_text("utf-8"), re.DOTALL):
        for part in text.splitlines() if text.startswith("# one of these") else [text]:
            tomllib.loads(part)


def test_the_configuration_page_begins_with_a_complete_file():
    text = re.search(r"```toml\n(.*?)```", read("configuration.md"), re.DOTALL)[1]
    assert parse(text, "palm.toml").sensor["palm"].codec.name == "packed"


def test_the_package_has_the_guide_and_the_examples():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    files = project["tool"]["setuptools"]["package-data"]["tactiled"]
    assert {"docs/**", "config/examples/**"} <= {*files}


def definitions(path):
    """Functions, classes, methods and constants of a file, as `name` or `Class.name`."""
    text = path.read_text("utf-8")
    if path.suffix == ".js":
        parts = re.split(r"^export class (\w+).*\{$", text, flags=re.MULTILINE)
        yield from re.findall(r"^export (?:const|(?:async )?function) (\w+)", parts[0], re.MULTILINE)
        for owner, body in zip(parts[1::2], parts[2::2], strict=True):
            yield from (
                f"{owner}.{name}" for name in re.findall(r"^  (?:async )?(\w+)\(.*\{$", body, re.MULTILINE)
            )
        return
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef):
            methods = (each for each in node.body if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef))
            yield from (f"{node.name}.{each.name}" for each in methods)
        elif isinstance(node, ast.Assign):
            yield from (each.id for each in node.targets if isinstance(each, ast.Name))
        elif isinstance(node, ast.FunctionDef):
            yield node.name


def test_every_name_on_the_way_of_a_frame_is_in_its_file():
    names = re.findall(r"`([\w/]+\.(?:py|js))::([\w.]+)`", read("frame.md"))
    assert len(names) == read("frame.md").count("::") > 40
    assert not [f"{path}::{name}" for path, name in names if name not in definitions(ROOT / "tactiled" / path)]


def test_few_classes_share_a_name_on_the_way_from_messages_to_bytes():
    way = read("frame.md").split("## A press")[0].split("give each sensor")[1].split("send them")[0]
    names = {name.split(".")[1] for name in re.findall(r"`[\w/]+\.py::(\w+\.\w+)`", way)}
    names -= {"__call__", "readings"}  # of one interface each
    paths = [*(ROOT / "tactiled").rglob("*.py")]
    owners = Counter(each.split(".")[1] for path in paths for each in definitions(path) if "." in each)
    assert len(names) > 15
    assert {name: owners[name] for name in names if owners[name] > 3} == {}
