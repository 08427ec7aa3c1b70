import importlib
import inspect
import os
import signal
import subprocess
import sys
from importlib.metadata import version
from pkgutil import iter_modules

import pytest

import tactiled.cli
from tactiled.build import sensor_plans
from tactiled.cli.app import SERVICES, STOP_SIGNALS, handled, main
from tactiled.cli.verbs import BenchVerbs, CalibrateVerbs, Verbs
from tactiled.config import load
from tactiled.config.example import EXAMPLE
from tests.cli.commands import succeed

DROPPED = """
import os, signal, sys, time, weakref
from tactiled.cli import app
class Dropped: pass
def callback(_):
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.1)  # whatever it raises meanwhile is dropped
signal.signal(signal.SIGTERM, getattr(app, sys.argv[1]))
one = Dropped()
reference = weakref.ref(one, callback)
del one
time.sleep(60)
"""
HEAVY = ("fastapi", "starlette", "uvicorn", "tactiled.web", "matplotlib", "skimage", "tactiled.bench")
EACH_IN_TURN = """
import sys
from tactiled.cli import main
for line in sys.argv[1:]:
    sys.argv = ["tactiled", *line.split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, line
print(*sys.modules)
"""
SILENT_BUS = "--interface virtual --channel nobody --seconds 0.05"
TABLES = [
    [
        (verb, group.files.get(verb, group.file.format(verb)), line)
        for verb, line in (each.split(maxsplit=1) for each in group.lines.splitlines())
    ]
    for group in (Verbs, BenchVerbs, CalibrateVerbs)
]


def python(program, *arguments, **environment):
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, env=os.environ | environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def imported(*lines):
    """Names of all modules that these lines import, one after the other; each ends well."""
    return python(EACH_IN_TURN, *lines).splitlines()[-1].split()


def of(names, *packages):
    return [name for name in names if any(f"{name}.".startswith(f"{each}.") for each in packages)]


def test_help_and_version_import_no_verb():
    files = [file for table in TABLES for _, file, _ in table]
    assert not of(
        imported("--help", "--version", "bench --help"), *HEAVY, *files, "numpy", "can", "tactiled.config"
    )


def test_the_version_is_printed():
    assert succeed("--version") == f"tactiled {version('tactiled')}\n"


def test_verbs_without_a_server_import_none(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "palm.toml").write_text(EXAMPLE)
    lines = "init new.toml", "check palm.toml", f"sniff {SILENT_BUS}", f"record out.log {SILENT_BUS}"
    names = imported(*lines)
    assert {f"tactiled.cli.{line.split()[0]}" for line in lines} <= {*names}
    assert not of(names, *HEAVY)


def test_a_service_with_a_cached_kernel_imports_no_solver_and_nothing_that_only_draws(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    config = tmp_path / "palm.toml"
    config.write_text(EXAMPLE.replace('"socketcan"', '"virtual"'))
    program = (
        "import gc, sys; from tactiled.cli import main, run;"
        "run.serve = lambda app, at: fit() and print(gc.isenabled(), *sys.modules);"
        "fit = lambda: __import__('tactiled.calibrate.counts.force_gain'); main()"
    )
    sensor_plans(load(config))  # solves the cover
    collects, *names = python(program, "run", str(config), XDG_STATE_HOME=str(tmp_path)).split()
    assert collects == "True"
    assert "tactiled.calibrate.counts.force_gain" in names  # which the process of a fit imports
    unused = "skfem", "skimage", "matplotlib", "scipy.ndimage", "scipy.stats", "tactiled.bench", "rerun", "rosbags"
    assert not of(names, *unused)


@pytest.mark.parametrize("kind", STOP_SIGNALS)
@pytest.mark.parametrize("verb", sorted(SERVICES))
def test_a_service_that_is_stopped_while_it_is_imported_ends_well(verb, kind, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["tactiled", verb])
    monkeypatch.setattr("tactiled.cli.verbs.import_module", lambda _: signal.raise_signal(kind))
    monkeypatch.setattr("gc.disable", lambda: None)
    with handled(signal.default_int_handler, *STOP_SIGNALS), pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code


@pytest.mark.parametrize(("table", "group"), [(0, []), (1, ["bench"]), (2, ["calibrate"])])
def test_help_lists_every_verb_with_the_first_paragraph_of_its_docstring(table, group):
    listed = " ".join(succeed(*group, "--help").split())
    for verb, module, line in TABLES[table]:
        function = getattr(importlib.import_module(module), verb)
        assert " ".join(inspect.getdoc(function).split("\n\n")[0].split()) == line
        assert f" {verb} {line}" in listed


def test_every_file_of_a_verb_is_in_a_table():
    names = [f"tactiled.cli.{each.name}" for each in iter_modules(tactiled.cli.__path__)]
    verbs = {name for name in names if importlib.import_module(name).__doc__.startswith("`tactiled ")}
    assert verbs == {module for table in TABLES for _, module, _ in table}


@pytest.mark.parametrize(
    ("words", "completions"),
    [("re", ["replay", "record", "restore"]), ("bench re", ["report"]), ("sniff --se", ["--seconds"])],
)
def test_shells_complete_verbs_and_their_options(words, completions):
    words = ["tactiled", *words.split()]
    variables = {"COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    program = "import sys; sys.argv[0] = 'tactiled'; from tactiled.cli import main; main()"
    assert python(program, **variables, _TACTILED_COMPLETE="complete_bash").split() == completions


@pytest.mark.parametrize(("handler", "code"), [("_leave", 0), ("_interrupt", -signal.SIGINT)])
def test_a_signal_that_comes_where_python_drops_exceptions_ends_a_command(handler, code):
    done = subprocess.run([sys.executable, "-c", DROPPED, handler], timeout=30, capture_output=True)
    assert done.returncode == code
