import os

import pytest
from threadpoolctl import threadpool_limits

from tactiled.config import parse
from tactiled.runtime.service import Service
from tactiled.study import latency
from tests.conftest import CONFIG, pressed


@pytest.mark.parametrize("clients", [1, 3])
def test_every_client_is_timed(monkeypatch, clients):
    monkeypatch.setattr(latency, "WARM_UP_S", 0.2)
    config = parse(CONFIG.format(channel=f"latency-{clients}"))
    service = Service(config)
    codec = service.sensor("palm").codec
    cores = os.sched_getaffinity(0)

    def source(sequence, _, now):
        return codec.encode(pressed().ravel(), sequence, now)

    with threadpool_limits(1):
        result = latency.measure(service, config, source, 50, 1.0, clients)
    assert len(result.ages_ms) == clients
    assert all(0 < len(each) <= result.frames <= 51 and each.min() > 0 for each in result.ages_ms)
    assert result.pinned == (clients > 1 and len(cores) > 1)
    assert os.sched_getaffinity(0) == cores
    received = min(len(each) for each in result.ages_ms)
    assert f"{result.frames} / {received}" in [line[1] for line in latency.lines(result)]
