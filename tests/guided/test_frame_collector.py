import numpy as np

from tactiled.frames import BAD, MISSING, Loss, RawFrame
from tactiled.guided.frame_collector import FrameCollector

TAXELS = 4


def frame(at, counts=7, flags=(0, 0, 0, 0)):
    return RawFrame(0, 0.0, 0.0, np.full(TAXELS, counts, np.uint16), np.array(flags, np.uint8), Loss(), arrived=at)


def test_frames_come_out_as_they_went_in_and_what_is_unknown_is_no_number():
    collector = FrameCollector(TAXELS)
    for n in range(5):
        collector.add(frame(10 + n / 10, counts=n, flags=(0, MISSING, BAD, 0)))
    series = collector.series()
    np.testing.assert_allclose(series.times, [10.0, 10.1, 10.2, 10.3, 10.4])
    np.testing.assert_array_equal(series.counts[:, [0, 3]], np.repeat(np.arange(5.0), 2).reshape(5, 2))
    assert np.isnan(series.counts[:, 1:3]).all()
    np.testing.assert_allclose(collector.series(seconds=0.15).times, [10.3, 10.4])
    np.testing.assert_allclose(collector.series(first=4).counts[:, 0], [4])
    assert collector.series(first=5).counts.shape[0] == 0


def test_it_takes_frames_for_its_time_in_its_memory_whatever_their_rate():
    for rate in (20, 1000):
        collector = FrameCollector(TAXELS, max_s=2.0, max_bytes=100 * 4 * TAXELS)
        for n in range(5 * rate):
            collector.add(frame(n / rate))
        assert collector.full
        assert collector.series().counts.nbytes <= 100 * 4 * TAXELS
        assert 1.9 < collector.seconds <= 2.0
    assert not FrameCollector(TAXELS).full
