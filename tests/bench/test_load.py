import numpy as np
import pytest

from tactiled.bench import load


@pytest.mark.parametrize(("sensors", "clients", "pull"), [(1, 2, True), (2, 2, False)])
def test_every_clients_images_are_aged_and_every_message_is_counted(monkeypatch, sensors, clients, pull):
    monkeypatch.setattr(load, "WARM_UP_S", 0.5)
    result = load.measure(sensors, clients, 20.0, 1.0, pull)
    assert (result.frames, len(result.ages_ms)) == (20, clients)
    assert all(0 < len(each) <= 20 and each.min() > 0 for each in result.ages_ms)
    assert result.cores > 0
    row = load.line(sensors, 20.0, pull, result)
    assert len(row) == len(load.HEADINGS)
    assert row[:4] == (str(sensors), str(clients), "20", "pulled" if pull else "newest")
    seen = sum(map(len, result.ages_ms)) / (clients * 20)
    assert row[-1] == f"{1 - seen:.2%}"
    assert row[6] == f"{np.percentile(np.concatenate(result.ages_ms), 99):.2f}"
