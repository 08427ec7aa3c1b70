"""Results as files, and the machine that they were measured on."""

import csv
import json
import os
import platform
import re
from collections.abc import Callable, Iterable
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from tactiled.errors import ConfigError

LIBRARIES = ("numpy", "scipy", "scikit-image", "opencv-python-headless", "pyproximal")  # those that are installed


def machine() -> str:
    """One line: processor, cores, system, Python and the libraries that determine the speed."""
    versions = {each.name: each.version for each in distributions()}
    libraries = ", ".join(f"{name} {versions[name]}" for name in LIBRARIES if name in versions)
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*: (.*)", info.read_text() if info.exists() else "")
    processor = model[1] if model else platform.machine()
    system = f"{platform.system()} {platform.release()}"
    return f"{processor}, {os.cpu_count()} cores, {system}, Python {platform.python_version()}, {libraries}"


def host_meter(stat: Path = Path("/proc/stat")) -> Callable[[], str]:
    """How to get, as a text, the part of processor time from now on that a virtual machine's host took from it.

    "" where the system does not say (`steal` of Linux, proc_stat(5)). Delays of a run with some percent are the
    host's.
    """

    def times() -> tuple[int, int]:
        fields = [int(each) for each in stat.read_text().splitlines()[0].split()[1:9]]
        return fields[7], sum(fields)

    if not stat.exists():
        return lambda: ""
    stolen, total = times()

    def text() -> str:
        now_stolen, now_total = times()
        part = (now_stolen - stolen) / max(now_total - total, 1)
        return f"; its host took {part:.1%} of its processor time meanwhile"

    return text


def make_folder(folder: Path) -> None:
    """Make the folder for results; ConfigError where that cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"folder {folder} cannot be made: {error.strerror}") from error


def write_csv(path: Path, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a table; numbers with six digits, lists with spaces between."""
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([columns, *([_cell(value) for value in row] for row in rows)])


def _cell(value: Any) -> Any:
    return f"{value:.6g}" if isinstance(value, float) else " ".join(value) if isinstance(value, tuple) else value


def write_json(path: Path, results: dict[str, Any]) -> None:
    """Write results and the machine."""
    path.write_text(json.dumps({"machine": machine()} | results, indent=2) + "\n", encoding="utf-8")
