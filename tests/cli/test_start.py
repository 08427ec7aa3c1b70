import importlib
import inspect
import os
import subprocess
import sys
from importlib.metadata import version
from pkgutil import iter_modules

import pytest
from typer.testing import CliRunner

import tactiled.cli
from tactiled.cli.app import app
from tactiled.cli.verbs import BENCH_VERBS, VERBS
from tactiled.config.example import EXAMPLE

SERVER = ("fastapi", "starlette", "uvicorn", "tactiled.web")
HEAVY = (*SERVER, "matplotlib", "skimage", "tactiled.bench")
SILENT = ["--interface", "virtual", "--channel", "nobody", "--seconds", "0.05"]


TABLES = [
    [(verb, file.format(verb), line) for verb, line in (each.split(maxsplit=1) for each in lines.splitlines())]
    for lines, file in ((VERBS, "tactiled.cli.{}"), (BENCH_VERBS, "tactiled.cli.bench_{}"))
]


def modules(*arguments, **environment):
    """Names of all modules that a verb has imported when it ends well."""
    program = (
        "import atexit, sys; atexit.register(lambda: print(*sys.modules)); from tactiled.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, env=os.environ | environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1].split()


def of(names, *packages):
    return [name for name in names if any(f"{name}.".startswith(f"{each}.") for each in packages)]


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["bench", "--help"]])
def test_help_and_version_import_no_verb(arguments):
    files = [file for table in TABLES for _, file, _ in table]
    assert not of(modules(*arguments), *HEAVY, *files, "numpy", "can", "tactiled.config")


def test_the_version_is_printed():
    done = CliRunner().invoke(app, ["--version"])
    assert (done.exit_code, done.output) == (0, f"tactiled {version('tactiled')}\n")


@pytest.mark.parametrize("verb", ["init", "check", "sniff", "record"])
def test_verbs_without_a_server_import_none(verb, tmp_path):
    config = tmp_path / "palm.toml"
    config.write_text(EXAMPLE)
    arguments = {
        "init": [str(tmp_path / "new.toml")],
        "check": [str(config)],
        "sniff": SILENT,
        "record": [str(tmp_path / "out.log"), *SILENT],
    }
    names = modules(verb, *arguments[verb])
    assert f"tactiled.cli.{verb}" in names
    assert not of(names, *HEAVY)


def test_a_service_with_a_cached_kernel_imports_no_solver_and_nothing_that_only_draws(tmp_path):
    config = tmp_path / "palm.toml"
    config.write_text(EXAMPLE.replace('"socketcan"', '"virtual"'))
    program = (
        "import gc, sys; from tactiled.cli import main, run; from tactiled.web.app import create;"
        "run.serve = lambda service, at: create(service, at) and print(gc.isenabled(), *sys.modules); main()"
    )
    for _ in range(2):  # the first solves the cover
        done = subprocess.run(
            [sys.executable, "-c", program, "run", str(config)],
            capture_output=True,
            text=True,
            env=os.environ | {"XDG_CACHE_HOME": str(tmp_path), "XDG_STATE_HOME": str(tmp_path)},
        )
        assert done.returncode == 0, done.stderr
    enabled, *names = done.stdout.split()
    assert enabled == "True"
    assert not of(names, "skfem", "skimage", "matplotlib", "scipy.ndimage", "tactiled.bench")


@pytest.mark.parametrize("group", [[], ["bench"]])
def test_help_lists_every_verb_with_the_first_paragraph_of_its_docstring(group):
    listed = " ".join(CliRunner().invoke(app, [*group, "--help"]).output.split())
    for verb, module, line in TABLES[len(group)]:
        function = getattr(importlib.import_module(module), verb)
        assert " ".join(inspect.getdoc(function).split("\n\n")[0].split()) == line
        assert f" {verb} {line}" in listed


def test_every_file_of_a_verb_is_in_a_table():
    named = {
        f"tactiled.cli.{each.name}"
        for each in iter_modules(tactiled.cli.__path__)
        if importlib.import_module(f"tactiled.cli.{each.name}").__doc__.startswith("`tactiled ")
    }
    assert named == {module for table in TABLES for _, module, _ in table}


def completed(words):
    """What a shell is told that these words may go on with."""
    arguments = {"COMP_WORDS": " ".join(["tactiled", *words]), "COMP_CWORD": str(len(words))}
    program = "import sys; sys.argv[0] = 'tactiled'; from tactiled.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        env=os.environ | arguments | {"_TACTILED_COMPLETE": "complete_bash"},
    )
    return done.stdout.split()


def test_shells_complete_verbs_and_their_options():
    assert completed(["re"]) == ["replay", "record", "restore"]
    assert completed(["bench", "re"]) == ["report", "restore"]
    assert completed(["init", "--"]) == ["--help"]
    assert "--seconds" in completed(["sniff", "--se"])
