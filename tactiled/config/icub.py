"""A configuration from the files of an iCub or ergoCub: which boards and triangles there are, and where.

Sources: robots-configuration (*/hardware/skin/*-skinSpec.xml: boards by CAN port, their type, period and no load,
and sets of triangles with shift and offset; *-skin.xml: the boards of a port); icub-main
(app/skinGui/conf/skinGui/*.ini and src/tools/iCubSkinGui/plugin: SkinMeshThreadPort.cpp for the columns,
Triangle_10pad.h for how a triangle is placed, Fingertip3Left.h and Fingertip3Right.h for fingertips laid flat;
app/skinGui/conf/positions/*.txt: taxels in m, twelve a triangle).
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import floor
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from tactiled.bus.codecs.icub import PAD_POSITIONS, PADS, UNITS_PER_MM, Icub
from tactiled.config.load import parse
from tactiled.errors import ConfigError

TRIANGLES = 16  # of a board
APERTURE_MM = 4.4  # of a triangle's taxels
DRAWN_MM = 2.7 / 15.3  # of a unit in which skinGui draws fingertips
LEFT_TIP = (
    (30, -20), (0, -20), (-30, -20), (-45, -39), (45, -39), (-30, -58),
    (0, -58), (30, -58), (25, 10), (0, 0), (-25, 10), (0, 40),
)  # fmt: skip
RIGHT_TIP = (
    (0, 40), (25, 10), (0, 0), (-25, 10), (-30, -20), (0, -20),
    (30, -20), (-45, -39), (45, -39), (30, -58), (0, -58), (-30, -58),
)  # fmt: skip
TRIANGLE_MM, LEFT_MM, RIGHT_MM = (
    np.array(PAD_POSITIONS) / UNITS_PER_MM, np.array(LEFT_TIP) * DRAWN_MM, np.array(RIGHT_TIP) * DRAWN_MM
)  # fmt: skip
# Kinds of sensors of the .ini that have twelve pads: where those are, and whether a mirrored one differs.
PLACED = {
    "triangle_10pad": (TRIANGLE_MM, True), "triangle": (TRIANGLE_MM, True),
    "fingertip3l": (LEFT_MM, True), "fingertip3r": (RIGHT_MM, False),
}  # fmt: skip
FLAT_MM = 1.0  # by which the taxels of a flat part may differ in height
Positions = Mapping[int, NDArray[np.float64]]  # (PADS, 2) mm, x to the right, y down, by number on the part
HEAD = """\
# Written by `tactiled init` from {source}. This was never tried on
# a robot. Go through the lines marked EDIT, and delete the mark.
# The robot's own software starts its boards; start = true has the service do it in its place.
"""
BUS = """
[bus.can{number}]{port}
interface = "socketcan"
channel = "can{number}"                # EDIT: where the boards are
"""
SENSOR = """
[sensor.{name}]
bus = "can{number}"

[sensor.{name}.codec]
{codec}

[sensor.{name}.array]
aperture_mm = {aperture:.1f}                      # as icub-main's skinGui draws them
{positions}
[sensor.{name}.cover]                  # EDIT: the foam over the taxels
thickness_mm = 2.0
young_mpa = 0.3
poisson = 0.45
"""


class Address(NamedTuple):
    """A board: its CAN port, and its number on it."""

    port: int
    board: int


class Triangle(NamedTuple):
    """How a triangle is set up."""

    enabled: bool
    shift: int
    cdc_offset: int


@dataclass(frozen=True)
class Spec:
    """What a skinSpec.xml says."""

    boards: Mapping[Address, tuple[int, int, int]]  # period, type, no load, of special boards
    board: tuple[int, int, int]  # the same, of all others
    triangles: Mapping[Address, tuple[Triangle, ...]]  # TRIANGLES of each board


def configuration(spec: Path, positions: Path | None = None) -> str:
    """A configuration of every enabled triangle, as TOML; ConfigError names file, key and bad value."""
    found = _read_spec(spec)
    enabled = {each: [n for n, one in enumerate(all_) if one.enabled] for each, all_ in found.triangles.items()}
    placed = None if positions is None else _read_positions(positions, list(found.triangles))
    if placed is not None:
        enabled = {each: [n for n in numbers if n in placed.get(each, ())] for each, numbers in enabled.items()}
    if not any(enabled.values()):
        raise ConfigError(f"{positions or spec}: none of its triangles is enabled in {spec.name}")
    source = spec.name if positions is None else f"{spec.name} and {positions.name}"
    ports = sorted({each.port for each, numbers in enabled.items() if numbers})
    text = HEAD.format(source=source)
    for number, port in enumerate(ports):
        text += BUS.format(number=number, port=f"  # CAN port {port}" if len(ports) > 1 else "")
    part = re.sub(r"\W", "_", spec.name.split("-")[0], flags=re.ASCII) or "skin"
    groups = [
        (each, list(group))
        for each, numbers in enabled.items()
        for _, group in groupby(
            sorted(numbers, key=found.triangles[each].__getitem__), found.triangles[each].__getitem__
        )
    ]
    for address, numbers in groups:
        name = part if len(groups) == 1 else f"{part}_{address.board}_{numbers[0]}"
        codec = _codec(found, address, numbers)
        lines, pads = "", None
        if placed is not None:  # mm, in the order of a frame
            pads = np.concatenate([placed[address][each] for each in numbers])[codec.is_taxel.ravel()]
            lines = _positions(pads)
        number = ports.index(address.port)
        form = {"codec": _settings(codec), "aperture": _aperture(pads), "positions": lines}
        text += SENSOR.format(name=name, number=number, **form)
    parse(text, str(spec))  # what is written can be read
    return text


def _codec(spec: Spec, address: Address, numbers: Sequence[int]) -> Icub:
    """The codec of some triangles of a board that are set up alike; ConfigError for a type that is not known."""
    period, kind, no_load = spec.boards.get(address, spec.board)
    _, shift, offset = spec.triangles[address][numbers[0]]
    if kind not in (0, 1, 2, 3, 8):
        raise ConfigError(f"board {address.board}: skinType = {kind}: known are 0, 1, 2, 3 and 8")
    settings = {"period_ms": period, "shift": shift, "cdc_offset": offset, "no_load": no_load}
    return Icub(address.board, tuple(numbers), skin_type=kind, **settings)  # type: ignore[arg-type]  # checked above


def _settings(codec: Icub) -> str:
    keys = ("board", "triangles", "skin_type", "start", "period_ms", "shift", "cdc_offset", "no_load")
    values = {"name": "icub"} | {each: getattr(codec, each) for each in keys}
    return "\n".join(f"{key} = {json.dumps(value)}" for key, value in values.items())


def _positions(pads: NDArray[np.float64]) -> str:
    rows = [", ".join(f"[{x:.2f}, {y:.2f}]" for x, y in pads[at : at + 5]) for at in range(0, len(pads), 5)]
    return "positions_mm = [\n" + "".join(f"  {each},\n" for each in rows) + "]\n"


def _aperture(pads: NDArray[np.float64] | None) -> float:
    """Diameter of taxels (mm, to a tenth): a triangle's, or as much as the nearest two leave, as in fingertips."""
    if pads is None or len(pads) < 2:
        return APERTURE_MM
    distances = np.hypot(*(pads[:, None] - pads).T) + np.diag(np.full(len(pads), np.inf))
    return min(APERTURE_MM, floor(10 * float(distances.min())) / 10)


def _read_spec(path: Path) -> Spec:
    """Boards and triangles; the boards of `-skin.xml` beside it, where the file names none."""
    groups = _groups(path)
    period, kind, no_load, enabled, shift, offset = (
        _whole(path, key, groups.get(group, {}).get(key, preset))
        for group, key, preset in (
            ("defaultCfgBoard", "period", ""), ("defaultCfgBoard", "skinType", ""),
            ("defaultCfgBoard", "noLoad", ""), ("defaultCfgTriangle", "enabled", "true"),
            ("defaultCfgTriangle", "shift", ""), ("defaultCfgTriangle", "cdcOffset", ""),
        )
    )  # fmt: skip
    special: dict[Address, tuple[int, int, int]] = {}
    for port, first, last, *values in _sets(path, groups, "specialCfgBoards", "boardSetCfg", 6):
        special |= {Address(port, board): (values[0], values[1], values[2]) for board in range(first, last + 1)}
    usual = (Triangle(bool(enabled), shift, offset),) * TRIANGLES
    triangles = dict.fromkeys(special, usual)
    for port, board, first, last, *values in _sets(path, groups, "specialCfgTriangles", "triangleSetCfg", 7):
        if not 0 <= first <= last < TRIANGLES:
            raise ConfigError(
                f"{path}: triangleSetCfg: triangles {first} to {last}: a board has 0 to {TRIANGLES - 1}"
            )
        own = list(triangles.get(Address(port, board), usual))
        own[first : last + 1] = [Triangle(bool(values[0]), values[1], values[2])] * (last + 1 - first)
        triangles[Address(port, board)] = tuple(own)
    if not triangles:
        triangles = dict.fromkeys(_boards_beside(path), usual)
    return Spec(special, (period, kind, no_load), triangles)


def _boards_beside(path: Path) -> Iterator[Address]:
    """The boards of each port in -skin.xml beside -skinSpec.xml; ConfigError where there is no such file."""
    beside = path.with_name(path.name.replace("skinSpec", "skin"))
    if beside == path or not beside.exists():
        raise ConfigError(f"{path}: names no board: put the robot's file {beside.name} beside it")
    for key, text in _groups(beside).get("patches", {}).items():
        for each in text.split():
            yield Address(_whole(beside, key, re.sub(r"\D", "", key)), _whole(beside, key, each))


def _groups(path: Path) -> dict[str, dict[str, str]]:
    """The parameters of every group of an XML file."""
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}: give the robot's skinSpec.xml") from error
    except ElementTree.ParseError as error:
        raise ConfigError(f"{path}: no XML: {error}") from error
    return {
        str(group.get("name")): {str(each.get("name")): (each.text or "").strip() for each in group.iter("param")}
        for group in root.iter("group")
    }


def _sets(
    path: Path, groups: Mapping[str, Mapping[str, str]], group: str, key: str, count: int
) -> Iterator[list[int]]:
    """The sets of a group, of which the robot's software reads the first `numOfSets`."""
    table = groups.get(group, {})
    for number in range(1, 1 + _whole(path, f"{group}.numOfSets", table.get("numOfSets", "0"))):
        text = table.get(f"{key}{number}", "")
        values = [_whole(path, f"{key}{number}", each) for each in text.split()]
        if len(values) != count:
            raise ConfigError(f"{path}: {key}{number} = {text!r}: expected {count} numbers")
        yield values


def _whole(path: Path, key: str, text: str) -> int:
    """A whole number, also hexadecimal, true or false."""
    try:
        return {"true": 1, "false": 0}[text] if text in ("true", "false") else int(text, 0)
    except ValueError as error:
        raise ConfigError(f"{path}: {key} = {text!r}: no whole number") from error


def _read_positions(path: Path, boards: Sequence[Address]) -> dict[Address, Positions]:
    """Where the triangles of each board are: of skinGui's .ini, or of the .txt of a flat part."""
    try:
        text = path.read_text("utf-8", "replace")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}: give a file of icub-main/app/skinGui/conf") from error
    if "[calibration]" in text:
        placed = _of_taxels(path, text.split("[calibration]")[1])
    else:
        placed = dict(_of_triangles(path, text))
        cards = re.search(r"^cardid\s+([\d \t]+)", text, re.MULTILINE)
        order = [int(each) for each in cards[1].split()] if cards else []
        if len(order) > 1 and {each.board for each in boards} == set(order):
            boards = sorted(boards, key=lambda each: order.index(each.board))
    if not placed:
        raise ConfigError(f"{path}: places no triangle")
    if max(placed) >= TRIANGLES * len(boards):
        raise ConfigError(
            f"{path}: places triangle {max(placed)}, and there are {len(boards)} boards of {TRIANGLES}"
        )
    return {
        board: {number % TRIANGLES: each for number, each in placed.items() if number // TRIANGLES == at}
        for at, board in enumerate(boards)
    }


def _of_triangles(path: Path, text: str) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """The triangles of an .ini, whose y axis is upwards: number, x, y (mm), angle, gain, mirrored or not."""
    for line in text.partition("[SENSORS]")[2].splitlines():
        kind, *fields = line.split("#")[0].split() or [""]
        if kind.lower() not in PLACED:
            continue
        at, mirrors = PLACED[kind.lower()]
        try:
            number, x, y, angle, _, mirrored = int(fields[0]), *map(float, (*fields[1:6], "0")[:5])
        except (IndexError, ValueError) as error:
            raise ConfigError(f"{path}: {line.strip()!r}: expected number, x, y, angle, gain") from error
        pads = at * (-1.0 if mirrored and mirrors else 1.0, 1.0)
        cosine, sine = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
        turned = pads @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y)
        yield number, turned * (1.0, -1.0)


def _of_taxels(path: Path, text: str) -> dict[int, NDArray[np.float64]]:
    """The taxels of a .txt seen from outside, by triangle: x, y, z (m) and the normal; ConfigError unless flat."""
    try:
        table = np.array([line.split() for line in text.splitlines() if line.strip()], np.float64)
        triangles = table.reshape(-1, PADS, 6)
    except ValueError as error:
        raise ConfigError(f"{path}: expected six numbers a line, and {PADS} lines for each triangle") from error
    there = {number: each for number, each in enumerate(triangles) if each.any()}
    rows = np.concatenate([*there.values(), np.zeros((0, 6))])
    if len(rows) and (np.ptp(1e3 * rows[:, 2]) > FLAT_MM or np.ptp(np.sign(rows[:, 5]))):
        raise ConfigError(f"{path}: this part is curved: give the .ini of skinGui, which lays it flat")
    return {number: 1e3 * each[:, :2] * (1.0, -np.sign(each[0, 5])) for number, each in there.items()}
