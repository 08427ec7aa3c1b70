import pickle
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.config import parse
from tactiled.config.example import EXAMPLE, GRASP
from tactiled.recorded import playback
from tactiled.recorded import series as recorded_series
from tactiled.recorded.frames import HEAD, FrameFiles, SharedFile
from tactiled.recorded.playback import MAX_POINTS, Playback
from tactiled.recorded.series import RecordedSeries, SeriesRows


@pytest.mark.parametrize("text", [EXAMPLE, GRASP], ids=["grid", "layout"])
def test_another_process_restores_with_the_same_blur(text):
    ((name, sensor),) = parse(text).sensor.items()
    plan = sensor_plan(name, sensor)
    plan.blur.thickness_error = 0.07
    blur, image = (
        pickle.loads(pickle.dumps(plan)).blur,
        np.arange(plan.cells.taxel.size, dtype=np.float32).reshape(plan.cells.shape),
    )
    image = image.reshape(plan.blur.surface_shape)
    np.testing.assert_array_equal(blur.forward(image), plan.blur.forward(image))
    assert blur.thickness_error == 0.07


class Counted(SharedFile):
    """A file of which only so many bytes are read at a time."""

    max_bytes = 0

    def read(self, size, offset):
        self.max_bytes = max(self.max_bytes, size)
        return super().read(size, offset)


@pytest.mark.parametrize("frames", [1, 600, 601, 5000])
def test_a_summary_is_that_of_all_rows_of_which_few_are_in_memory(frames, tmp_path, monkeypatch):
    monkeypatch.setattr(recorded_series, "ROWS_AT_ONCE", 5)
    dtype, random = np.dtype([("position", "<f8"), ("values", "<f4", (3, 4))]), np.random.default_rng(frames)
    rows = np.zeros(frames, dtype)
    rows["position"], rows["values"] = np.arange(frames) / 8, random.normal(size=(frames, 3, 4)).round(1)
    rows["values"][random.random((frames, 3, 4)) < 0.3] = rows["values"][:, 1, 2] = np.nan
    file = Counted.temporary(tmp_path)
    file.write(rows.tobytes())
    series = SimpleNamespace(rows=SeriesRows(file, dtype, frames), job=SimpleNamespace(regions=("heel", "toe")))
    summary, values = RecordedSeries.summary.func(series), rows["values"]
    first = np.unique(np.linspace(0, frames, MAX_POINTS, endpoint=False).astype(int))
    number = np.nan_to_num(values, nan=-np.inf).argmax(axis=0)
    np.testing.assert_array_equal(summary.position_s, rows["position"][first])
    np.testing.assert_array_equal(summary.values, np.fmax.reduceat(values, first, axis=0))
    np.testing.assert_array_equal(summary.number, number)
    np.testing.assert_array_equal(summary.highest, np.take_along_axis(values, number[None], axis=0)[0])
    np.testing.assert_array_equal(summary.highest_s, rows["position"][number])
    assert file.max_bytes <= 5 * dtype.itemsize
    file.close()


def test_an_overview_is_that_of_all_frames_of_which_few_heads_are_in_memory_and_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(playback, "HEADS_AT_ONCE", 8)
    heads = np.zeros(5000, HEAD)
    heads["position"], heads["total"] = np.arange(5000) / 8, np.random.default_rng(1).integers(0, 50, 5000)
    file = Counted.temporary(tmp_path)
    file.write(heads.tobytes())
    frames = FrameFiles({"palm": 1}, {"palm": (file, file)})
    palm = SimpleNamespace(plan=SimpleNamespace(name="palm"), _recorded=frames, _overview_frames=0)
    palm._readings = lambda number: (float(number), 0.0)
    palm._extremes = partial(Playback._extremes, palm)
    overview = Playback.overview(palm)
    pieces = np.array_split(np.arange(5000), MAX_POINTS // 2)
    numbers = {each[pick(heads["total"][each])] for each in pieces for pick in (np.argmin, np.argmax)}
    assert abs(len(overview.force) - len(numbers)) < 5  # pieces of another length by one frame
    totals = heads["total"][overview.force.astype(int)]
    assert {totals.min(), totals.max()} == {heads["total"].min(), heads["total"].max()}
    np.testing.assert_array_equal(overview.position_s, overview.force / 8)
    assert file.max_bytes <= 8 * HEAD.itemsize
    file.max_bytes = 0
    assert Playback.overview(palm) is overview
    assert file.max_bytes == 0
    file.close()
