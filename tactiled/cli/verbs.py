"""The verbs, each with its line of `--help`: a verb's file is imported when that verb runs, and not before."""

import gc
from collections.abc import Sequence
from importlib import import_module
from typing import Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from tactiled.errors import ConfigError

USAGE_ERROR: Any = typer.BadParameter.__bases__[0]  # click's, or that of typer's own copy of click
VERBS = """\
run      Run the service: read the buses, restore every frame, serve it over HTTP and WebSocket.
demo     Simulate a covered array, or play a real recording, and serve it live; needs no hardware.
check    Check a configuration, and print the effect of each cover on its array.
cover    Print a cover's gain over spatial frequency, and the resolution that it leaves.
replay   Restore every frame of a recording and serve it as `run` does; every run gives the same images.
export   Restore every frame of recordings into arrays, tables, or files for Foxglove, ROS 2 or Rerun.
init     Write a commented configuration.
paper    Reproduce the figures of Shimojo's paper, and compare its statements with both models.
record   Record all messages of a bus to a file, also of other devices, and error frames.
restore  Restore the frames of .npy and .csv files, however many, with bounded memory.
simulate Simulate a covered array on a bus (32 x 32 without --config).
serve    Serve the sensors that `run --publish` publishes on a Zenoh network; reads no bus.
sniff    List the known skins on a bus, or in a recording; sends nothing.
top      Show rates, ages, losses, warnings and processor time of a running service.
"""
CALIBRATE_VERBS = """\
gain     Find each taxel's gain and curve in a recording under known loads.
cover    Find a cover's thickness in a recording of presses.
map      Judge by a recording of a rolling finger whether the taxels lie where the configuration says.
show     Print what a calibration file holds.
"""
BENCH_VERBS = """\
calibration Calibrate simulated skins whose gains and covers are known, and hold the results against the truth.
frontier  Chart error against time for every method of ours and for others', in one run on one thread.
load      Load a service with arrays and clients: processor time, age of images at the clients, and what is lost.
picard    Draw the singular values of an array under its cover, and which of a scene's modes rise above the noise.
report    Measure speed, accuracy, limits and failures, and write one page that holds all charts and tables.
stability Let one thing after another go wrong, and show where each method becomes worse than the raw image.
"""


class Verbs(TyperGroup):
    """The verbs of VERBS: `--help` and completion of their names read it, and running one imports its function."""

    lines, file = VERBS, "tactiled.cli.{}"
    files: ClassVar = {"paper": "tactiled.cli.bench"}  # of verbs that are in another

    def __init__(self, *, commands: dict[str, Any], **settings: Any) -> None:
        lines = dict(line.split(maxsplit=1) for line in self.lines.splitlines())
        super().__init__(
            commands={verb: TyperCommand(verb, short_help=lines[verb]) for verb in lines} | commands, **settings
        )
        self._lazy = lines.keys()
        self._arguments: Sequence[str] = ()

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write plain text: rich's boxes take longer to import than all else that `--help` needs."""
        super(TyperGroup, self).format_help(ctx, formatter)

    def invoke(self, ctx: Any) -> Any:
        """Run what the arguments say; ConfigError, a line with the value, where an option or argument is wrong."""
        try:
            return super().invoke(ctx)
        except USAGE_ERROR as error:
            if "\n" in (message := error.format_message()):  # the help, where nothing is given
                raise
            text = message.removeprefix("Invalid value for ").replace("Input should be", "must be")
            for name in getattr(getattr(error, "param", None), "opts", ()):
                text = text.replace(f"'{name}'", " ".join((name, *_given(name, self._arguments))))
            raise ConfigError(text.removesuffix(".")) from error

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Give the command that `args` begin with, the function of its name in its file."""
        self._arguments = args
        verb, command, rest = super().resolve_command(ctx, args)
        if verb in self._lazy:
            one = typer.Typer(add_completion=False)
            file = self.files.get(verb, self.file.format(verb))
            one.command(verb)(getattr(import_module(file), verb))
            command = typer.main.get_command(one)
            if not gc.isenabled():
                gc.freeze()  # what is imported stays: no later collection walks through it
                gc.enable()
        return verb, command, rest


def _given(option: str, arguments: Sequence[str]) -> Sequence[str]:
    """What `arguments` give an option, of --option=value, too."""
    words = [part for each in arguments for part in each.split("=", 1)]
    return words[words.index(option) + 1 :][:1] if option in words else ()


class BenchVerbs(Verbs):
    """The verbs of `tactiled bench`."""

    lines, file = BENCH_VERBS, "tactiled.cli.bench"


class CalibrateVerbs(Verbs):
    """The verbs of `tactiled calibrate`."""

    lines, file = CALIBRATE_VERBS, "tactiled.cli.calibrate"
    files: ClassVar = {"cover": "tactiled.cli.calibrate_cover", "map": "tactiled.cli.calibrate_map"}
