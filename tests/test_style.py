"""Names are the field's words, files and functions stay short: what ruff does not check of the house's style."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAX_FILE_LINES, MAX_FUNCTION_LINES, MAX_PARAMETERS = 350, 50, 8
# Participles and adverbs that do not say what a value is, vague sizes, and words of our own for the field's.
WORDS = """
told said asked heard found seen given kept left sent held shown known taken drawn chosen wanted meant spent
gone ran wished says tells tell most least few whole bare sure there away anew here hardly seldom nothing film
films wish talk patience doubt doubts lawful soonest meaning lucy variation gaps guard door room rooms belt
blast signs silence alarms claims stay small big
"""
BANNED = set(WORDS.split())
ALLOWED = {
    "kept",  # the rest are fields of the API's JSON, which do not change, ...
    "ran",
    "seen",
    "tell",  # and a method of Python's files
}
KIT = ROOT / "tests/release_0_4_2"  # what a user of that release wrote


def sources():
    return [path for folder in ("tactiled", "tests") for path in sorted((ROOT / folder).rglob("*.py"))]


def stored(tree):
    """The names that a module gives, and the lines."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                yield node.name, node.lineno
            case ast.arg():
                yield node.arg, node.lineno
            case ast.Name(ctx=ast.Store()):
                yield node.id, node.lineno
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr, node.lineno
            case ast.alias(asname=str()):
                yield node.asname, node.lineno


def banned(tree):
    return [f"{line}: {name}" for name, line in stored(tree) if name.strip("_").lower() in BANNED - ALLOWED]


def long(tree, options):
    """Functions that are too long or take too much; the options of a command are no parameters."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            args = node.args
            count = 0 if options else len(args.posonlyargs + args.args + args.kwonlyargs)
            lines = node.end_lineno - node.lineno + 1
            if lines > MAX_FUNCTION_LINES or count > MAX_PARAMETERS:
                yield f"{node.lineno}: {node.name} has {lines} lines, {count} parameters"


def test_names_are_words_of_the_field_and_nothing_is_long():
    findings = []
    for path in sources():
        text = path.read_text()
        tree = ast.parse(text)
        problems = list(long(tree, options=path.parent.name == "cli"))
        if path.parent != KIT:
            problems += banned(tree)
        if len(text.splitlines()) > MAX_FILE_LINES:
            problems.append(f"{MAX_FILE_LINES}: the file goes on")
        if path.stem.removeprefix("test_") in BANNED:
            problems.append("0: the file's name")
        findings += [f"{path.relative_to(ROOT)}:{each}" for each in problems]
    assert not findings, "\n".join(findings)


def test_a_banned_name_a_long_function_and_many_parameters_are_found():
    assert banned(ast.parse("def f(told):\n    MOST = 1\n    self.heard = told")) == [
        "1: told",
        "2: MOST",
        "3: heard",
    ]
    assert list(long(ast.parse("def f():\n" + "    pass\n" * 50), options=False))
    many = ast.parse("def f(a, b, c, d, e, f, g, h, i): pass")
    assert list(long(many, options=False))
    assert not list(long(many, options=True))
