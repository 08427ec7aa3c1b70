"""Results as files, and the machine that they were measured on."""

import csv
import json
import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from tactiled.errors import ConfigError

LIBRARIES = ("numpy", "scipy", "scikit-image", "opencv-python-headless", "pyproximal")  # the last two if installed


def machine() -> str:
    """One line: processor, cores, system, Python and the libraries that determine the speed."""
    libraries = ", ".join(f"{name} {number}" for name in LIBRARIES if (number := _version(name)))
    system = f"{platform.system()} {platform.release()}"
    return f"{_processor()}, {os.cpu_count()} cores, {system}, Python {platform.python_version()}, {libraries}"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


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
