"""Configurations of skins by their names, as `tactiled init --skin` writes them."""

from math import prod
from typing import NamedTuple

HEAD = """\
# Written by `tactiled init --skin {name}`. Go through the lines marked EDIT and delete the mark, then
# `tactiled check` this file.
"""
BUS = """
[bus.can0]
interface = "socketcan"
channel = "can0"                       # EDIT: where the skin is{fd}
"""
SENSOR = """
[sensor.skin]{bus}
method = "auto"
{refine}{codec}{array}
[sensor.skin.cover]                    # EDIT: the rubber over the taxels
thickness_mm = 1.0
young_mpa = 0.5
poisson = 0.48
"""
ARRAY = """
[sensor.skin.array]                    # EDIT: {about}
rows = {rows}
columns = {columns}
pitch_mm = {pitch_mm}
"""
FINE_TAXELS = 64  # of a grid, up to which an image has finer cells
REFINE = "refine = 2                             # cells along a pitch: finer ones draw smoother outlines"
KPA = """
[sensor.skin.calibration]
kpa_per_count = 1.0                    # EDIT: what is pushed is in kPa; of counts, what one of them is
"""
PITCH = "pitch_mm is a guess"


class Ready(NamedTuple):
    """What a configuration of a skin holds."""

    codec: str  # in TOML; empty: its frames are pushed
    shape: tuple[int, int] | None = None  # rows, columns; None: the codec has positions
    pitch_mm: float = 1.0
    about: str = PITCH
    fd: bool = False


def _fingers(codec: str, rows: int, columns: int, fd: bool = False) -> Ready:
    """The index finger of a hand that is asked."""
    return Ready(codec, (rows, columns), about=f"{PITCH}; more fingers are more rows", fd=fd)


READY = {
    "agibot-omnihand": _fingers('name = "omnihand"\nhand = "right"\nparts = [2]', 8, 2, fd=True),
    "barretthand": Ready('name = "barrett"\nnode = 11\npoll_hz = 20.0', (8, 3)),
    "cyskin": Ready('name = "cyskin"', (4, 4), about="4 x 4 stands for the 16 taxels: give their positions_mm"),
    "icub-fingertips": Ready('name = "icub"\nboard = 14\ntriangles = [0, 1, 2, 3, 4]\nthermal_pads = false'),
    "linkerhand-g20": _fingers('name = "linker"\nhand = "right"\nfingers = [2]\nlayout = "g20-5"', 23, 9),
    "linkerhand-l6": _fingers('name = "linker"\nhand = "right"\nfingers = [2]', 12, 6),
    "linkerhand-l30": _fingers('name = "linker_l30"\nnode = 1\nfingers = [2]', 12, 6, fd=True),
    "linkerhand-o6": _fingers('name = "linker"\nhand = "right"\nfingers = [2]\nlayout = "10x4"', 10, 4),
    "linkerhand-o20": _fingers('name = "linker"\nhand = "right"\nfingers = [2]\nlayout = "o20"', 12, 6, fd=True),
    "poweron-touchdetect": Ready('name = "poweron"\nbase_id = 0x300', (6, 6)),
    "pushed": Ready("", (8, 8), about="what is pushed"),
    "xela-4x4": Ready('name = "xela"\ncontroller = 1\nrows = [4, 3, 2, 1]\ncolumns = [3, 2, 1, 0]', (4, 4)),
    "xela-4x6": Ready('name = "xela"\ncontroller = 1', (4, 6)),
}


def configuration(name: str) -> str:
    """The configuration of a skin of READY, as TOML."""
    codec, shape, pitch_mm, about, fd = READY[name]
    text = HEAD.format(name=name)
    if codec:
        text += BUS.format(fd="\nfd = true" if fd else "")
    array = ""
    if shape:
        array = ARRAY.format(about=about, rows=shape[0], columns=shape[1], pitch_mm=pitch_mm)
    bus = '\nbus = "can0"' if codec else ""
    table = f"\n[sensor.skin.codec]\n{codec}\n" if codec else ""
    refine = fine(shape) + "\n" if fine(shape) else ""
    return text + SENSOR.format(bus=bus, refine=refine, codec=table, array=array) + ("" if codec else KPA)


def fine(shape: tuple[int, int] | None) -> str:
    """The line that gives a small grid's image finer cells; "" for any other array."""
    return REFINE if shape and prod(shape) <= FINE_TAXELS else ""
