import numpy as np
import pytest

from tactiled.config import load
from tactiled.errors import ConfigError
from tactiled.recorded.offline import read_frame_series
from tests.cli.recordings import CODEC, CONFIG, FRAMES, counts, traffic, write


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text(CONFIG)
    return load(path)


def test_every_frame_in_counts_with_its_time_and_nan_where_a_message_never_came(tmp_path, config):
    series = read_frame_series(write(tmp_path / "a.log", traffic(missing={(7, 1)})), "palm", config)
    rng = np.random.default_rng(1)
    expected = np.array([counts(each, rng) for each in range(FRAMES)], np.float32)
    expected[7, CODEC.span(1)] = np.nan
    assert np.isnan(expected).any()
    np.testing.assert_array_equal(series.counts, expected)
    np.testing.assert_allclose(series.times, 1.6e9 + 0.01 * np.arange(FRAMES), atol=1e-5)


def test_times_ascend_though_the_recordings_clock_steps_back(tmp_path, config):
    log = write(tmp_path / "a.log", traffic())
    lines = log.read_text().splitlines()
    half = len(lines) // 2
    log.write_text("\n".join(lines[:half] + [each.replace("(16", "(15", 1) for each in lines[half:]]))
    times = read_frame_series(log, "palm", config).times
    assert len(times) == FRAMES
    assert (np.diff(times) > 0).all()
    assert times[-1] - times[0] < 2


def test_a_recording_of_something_else_is_refused(tmp_path, config):
    foreign = write(tmp_path / "a.log", [each._replace(id=0x77) for each in traffic()])
    with pytest.raises(ConfigError, match=r"a\.log: holds no frame of sensor palm"):
        read_frame_series(foreign, "palm", config)


def test_two_boards_with_one_id_on_two_channels_are_not_mixed(tmp_path, config):
    log = write(tmp_path / "a.log", traffic())
    other = log.read_text().replace("can0", "can1").replace(") ", "5) ")  # half a microsecond later
    lines = log.read_text().splitlines() + other.splitlines()
    log.write_text("".join(f"{each}\n" for each in sorted(lines)))
    with pytest.raises(ConfigError, match="id 0x500 comes from can0 and from can1"):
        read_frame_series(log, "palm", config)
