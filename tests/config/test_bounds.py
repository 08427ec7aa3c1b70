"""Any configuration is refused by name, or runs: nothing that is accepted fails later."""

from itertools import product
from unittest.mock import Mock

import numpy as np
import pytest

from tactiled.build import sensor_plans
from tactiled.config import parse
from tactiled.errors import ConfigError, PhysicsError
from tactiled.frames import Loss, RawFrame
from tactiled.live.pipeline import Pipeline
from tactiled.live.service import Service
from tactiled.restore.methods import METHODS

TEXT = """
[bus.can0]
interface = "virtual"
[sensor.palm]
bus = "can0"
refine = {refine}
stale_after_s = {stale_after_s}
codec = {{ name = "packed", fd = true, bits = {bits} }}
array = {{ rows = {rows}, columns = {columns}, pitch_mm = {pitch_mm} }}
cover = {{ thickness_mm = {thickness_mm}, young_mpa = {young_mpa}, poisson = {poisson} }}
substrate = {{ thickness_mm = {thickness}, young_mpa = {young}, poisson = 0.3 }}
kernel = {{ model = "{model}", accuracy = {accuracy} }}
[sensor.palm.calibration]
kpa_per_count = {kpa_per_count}
no_load = {no_load}
noise_kpa = {noise_kpa}
saturation = {saturation}
"""
LAYER = "{ thickness_mm = 1.0, young_mpa = 1.0, poisson = 0.3 }, "
GRID = "rows = 5, columns = 6, pitch_mm = 1.0"
BITS = 12
USUAL = {
    "refine": 1, "stale_after_s": 0.5, "bits": BITS, "rows": 5, "columns": 6, "pitch_mm": 1.0, "model": "layered",
    "thickness_mm": 1.2, "young_mpa": 0.6, "poisson": 0.48, "thickness": 1.6, "young": 2e4, "accuracy": 1e-2,
    "kpa_per_count": 0.05, "no_load": 80, "noise_kpa": 0.1, "saturation": 4095,
}  # fmt: skip
NUMBERS = sorted({*USUAL} - {"model"})
EXTREMES = [0, -1, 0.5, 1e-320, 1e-300, 1e-20, 1e9, 1e300, 1e308, -1e308, float("inf"), float("nan"), 10**30]


# One of a list, or an end of a range or any number within it, even in its logarithm.
LEGAL = {
    "refine": [1, 2, 3], "stale_after_s": (0.001, 3600.0), "bits": [BITS],
    "rows": [1, 2, 3, 5, 7], "columns": [1, 2, 4, 6, 7], "pitch_mm": (0.01, 1000.0),
    "model": ["layered", "layered", "fem"], "accuracy": (1e-3, 0.1),
    "thickness_mm": (0.001, 100.0), "young_mpa": (0.001, 1e7), "poisson": [0.0, 0.3, 0.48, 0.4999, 0.49999],
    "thickness": (0.001, 100.0), "young": (0.001, 1e7),
    "kpa_per_count": (1e-9, 1e6), "no_load": [-1e9, 0, 80.0, 1e9],
    "noise_kpa": (1e-9, 1e6), "saturation": [-1e9, 4095, 1e9],
}  # fmt: skip


def drawn(of, random):
    if isinstance(of, tuple):
        of = [*of, *np.clip(np.exp(random.uniform(*np.log(of), 4)), *of).tolist()]
    return of[random.integers(len(of))]


def text(numbers):
    return TEXT.format(**{key: f"{value}" for key, value in numbers.items()})


@pytest.fixture(autouse=True)
def _cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


def runs(numbers, seed):
    """Restore frames by every method: finite and of the right shape, whatever the noise is configured to be."""
    (plan,) = sensor_plans(parse(text(numbers)))
    counts = np.random.default_rng(seed).integers(0, 2**BITS, (2, plan.array.size)).astype(np.uint16)
    pipeline, flags = Pipeline(plan), np.zeros(plan.array.size, np.uint8)
    for at, (method, each) in enumerate(product(METHODS, counts)):
        pipeline.set_method(method)
        image = pipeline.process(RawFrame(at, at * 0.01, 0.0, each, flags, Loss()))
        assert np.isfinite(image.restored).all(), method
        assert image.restored.shape == plan.blur.surface_shape


def outcome(numbers, seed):
    """What a configuration is refused with; nothing where it runs."""
    try:
        runs(numbers, seed)
    except (ConfigError, PhysicsError) as error:
        return str(error)
    return ""


@pytest.mark.parametrize("seed", range(12))
def test_numbers_within_the_bounds_run_or_are_refused_by_name(seed):
    random = np.random.default_rng(seed)
    numbers = {key: drawn(of, random) for key, of in LEGAL.items()}
    message = outcome(numbers, seed)
    contrast = abs(np.log10(numbers["young_mpa"] / numbers["young"]))
    assert message == "" or (message.startswith("sensor.palm: ") and (numbers["model"] == "fem" or contrast > 6))


@pytest.mark.parametrize("key", NUMBERS)
def test_extreme_numbers_are_refused_with_their_key_or_run(key):
    for value in EXTREMES:
        message = outcome(USUAL | {key: value}, 0)
        assert message == "" or (key in message and repr(value)[:4] in message)


@pytest.mark.parametrize(
    ("thickness_mm", "young_mpa", "poisson"),
    [(0.01, 2500.0, 0.4), (20.0, 0.01, 0.0), (0.2, 1e6, 0.2), (2.0, 0.5, 0.4999)],
)
def test_covers_of_real_skins_are_solved(thickness_mm, young_mpa, poisson):
    cover = {"thickness_mm": thickness_mm, "young_mpa": young_mpa, "poisson": poisson}
    runs(USUAL | cover | {"model": "fem"}, 0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rows = 5", "rows = [" + "[" * 5000, "config: tables or lists are nested too deep"),
        ("refine = 1", "refine = " + "[" * 200 + "]" * 200, "config: tables or lists are nested too deep"),
        ('interface = "virtual"', 'interface = "virtual"\n' + "x." * 3000 + "x = 1", "nested too deep"),
        ("rows = 5", "rows = " + "5" * 5000, "config: not TOML: Exceeds the limit (4300 digits)"),
        (GRID, "positions_mm = [[0.0, 0.0], [1e300, 1.0]]",
         "sensor.palm.array.positions_mm[1][0] = 1e+300: give -10000 to 10000 mm"),
        (GRID, "positions_mm = []", "at least 1 item"),
        (GRID, "positions_mm = [[0.0, 0.0]]", "array has one position"),
        (GRID, "rows = 5, positions_mm = [[0.0, 0.0], [1.0, 0.0]]",
         "array.rows = 5: belongs to a grid, and this array has positions"),
        (GRID, "rows = 5, columns = 6",
         "array is incomplete: give rows, columns and pitch_mm"),
        (GRID, "positions_mm = [[0.0, 0.0], [0.02, 0.0], [9e3, 9e3]]",
         "array positions spread over 9000 x 9000 mm, and two are 0.02 mm apart"),
        ("cover = {", f"cover = [{9 * LAYER}]\nfoam = {{", "at most 8 items"),
        ("rows = 5, columns = 6", "rows = 100, columns = 100", "refine = 8: 10000 taxels then have 640000 cells"),
        ("rows = 5, columns = 6", "rows = 1, columns = 1024", "up to 8192 in a row: give at most 65536, and 1024"),
    ],
)  # fmt: skip
def test_too_much_of_anything_is_refused(old, new, message):
    usual = text(USUAL | ({"refine": 8} if "in a row" in message or "cells" in message else {}))
    assert old in usual
    with pytest.raises(ConfigError) as caught:
        sensor_plans(parse(usual.replace(old, new)))
    assert message in str(caught.value)


def test_history_larger_than_memory_is_refused(monkeypatch):
    monkeypatch.setattr("tactiled.live.sensor.History", Mock(side_effect=MemoryError))
    with pytest.raises(ConfigError, match=r"server\.history_mb = 64: this machine has less memory: give less"):
        Service(parse(text(USUAL)))


def test_a_cover_that_needs_too_many_elements_is_refused():
    thin_on_soft = USUAL | {"thickness_mm": 0.001, "young_mpa": 1.0, "thickness": 20.0, "young": 0.001}
    with pytest.raises(PhysicsError, match=r"sensor\.palm: far field reaches past .* mm, .*use model 'layered'"):
        sensor_plans(parse(text(thin_on_soft | {"model": "fem"})))
    runs(thin_on_soft, 0)
