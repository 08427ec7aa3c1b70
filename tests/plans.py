"""Sensors as a configuration makes them: what every test that restores starts from."""

from functools import cache

import numpy as np

from tactiled.build import SensorPlan, sensor_plan
from tactiled.config import parse

CONFIG = """
[bus.can0]
interface = "virtual"
[sensor.palm]
bus = "can0"
refine = {refine}
codec = {{ name = "packed", fd = true }}
array = {{ {array}, aperture_mm = {aperture} }}
cover = {{ thickness_mm = {thickness}, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "{model}" }}
"""
SUBSTRATE = "substrate = { thickness_mm = 1.0, young_mpa = 980.0, poisson = 0.3 }\n"


SHAPE = (12, 12)


@cache
def plan(
    shape=SHAPE, thickness=1.0, *, refine=1, pitch=1.0, layout=False, substrate=False, model="layered", beyond=True
) -> SensorPlan:
    """A sensor under rubber `thickness` pitches thick: a grid, or the same taxels as a list of positions."""
    rows, columns = shape
    array = f"rows = {rows}, columns = {columns}, pitch_mm = {pitch}"
    if layout:
        places = np.column_stack([each.ravel() for each in np.mgrid[:rows, :columns][::-1]]) * pitch
        array = f'positions_mm = {places.tolist()}, aperture = "square"'
    if not beyond:
        array += ", beyond_mm = [0, 0, 0, 0]"
    text = CONFIG.format(
        refine=refine, array=array, aperture=0.8 * pitch, thickness=thickness * pitch, model=model
    ) + (SUBSTRATE if substrate else "")
    return sensor_plan("palm", parse(text, "plan").sensor["palm"])
