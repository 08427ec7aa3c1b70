"""Fuzz the codecs and the assembler, led by coverage: `python tests/fuzz/codecs.py -runs=1000000`.

`--skin NAME` takes one skin instead of all in turn; every other argument is libFuzzer's (`-max_len` is 24, a byte
or more a message). What is found goes to a folder that is gone at the end, unless one is given. It begins with the
inputs in `corpus/NAME.hex`, a line each. An input that fails is left in the working directory: add its line there,
and pytest replays it.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import atheris

sys.path[0] = str(Path(__file__).parents[2])  # this folder would put this file in the place of Python's codecs
with atheris.instrument_imports(include=["tactiled.bus"]):
    from tests.fuzz import harness


def fuzz(name, folder, arguments):
    """Fuzz one skin with a folder for what is found; ends the process without a way back."""
    findings, seeds = Path(folder, "findings"), Path(folder, "seeds")
    findings.mkdir()
    seeds.mkdir()
    for at, each in enumerate(harness.corpus(name)):
        (seeds / str(at)).write_bytes(each)
    folders = [] if any(not each.startswith("-") for each in arguments) else [str(findings)]
    atheris.Setup(
        [sys.argv[0], "-max_len=24", *arguments, *folders, str(seeds)],
        lambda data: harness.check(name, data),
        enable_python_coverage=True,
    )
    atheris.Fuzz()


def main(arguments):
    """All skins, or the one asked for, each in a process of its own."""
    if arguments[:1] == ["--child"]:
        fuzz(arguments[1], arguments[2], arguments[3:])
    names = list(harness.SKINS)
    if "--skin" in arguments:
        at = arguments.index("--skin")
        names, arguments = [arguments[at + 1]], arguments[:at] + arguments[at + 2 :]
    for name in names:
        print(f"== {name}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run([sys.executable, __file__, "--child", name, folder, *arguments])
        if done.returncode:
            sys.exit(done.returncode)


if __name__ == "__main__":
    main(sys.argv[1:])
