import re

import numpy as np
import pytest

from tests.bench.soak import Sample, report, slope


def samples(mb_per_hour, noise_mb=3.0):
    """An hour, a sample a second: memory that only ever rises above what it needs."""
    above = np.abs(np.random.default_rng(1).normal(0, noise_mb, 3600))
    return [Sample(n, 200 + mb_per_hour * n / 3600 + above[n], 24, 18) for n in range(3600)]


@pytest.mark.parametrize("mb_per_hour", [0.0, 5.0])
def test_the_slope_is_that_of_the_memory_that_is_needed(mb_per_hour):
    gain, error = slope(samples(mb_per_hour))
    assert abs(gain - mb_per_hour) < 0.2
    assert error < 0.2


def test_the_report_has_both_ends(capsys):
    report(samples(5.0), ["stream", "stream"], 300)
    text = capsys.readouterr().out
    assert float(re.search(r"after warm-up: \+(\S+)", text)[1]) == pytest.approx(5.0, abs=0.3)
    least = [float(each) for each in re.findall(r"│ (2\d\d\.\d) ", text)]
    assert least == pytest.approx([200.4, 204.0], abs=0.2)
    assert '"stream": 2' in text
