import numpy as np

from tactiled.frames import Loss, RawFrame
from tests.calibrate.counts.skins import contact
from tests.conftest import GAIN, NO_LOAD, until

SWAPPED = [20, 43]


def test_swapped_taxels_are_found_masked_and_logged_and_all_is_undone_when_they_are_put_right(rig, client):
    rig.stale_after(600)
    random, array, monitor = np.random.default_rng(1), rig.sensor.array, rig.sensor.pipeline.monitor
    sequence, sigma = 0, np.ones(rig.sensor.array.size, np.float32)

    def touch(*wrong):
        """Let the map see loads at ever other places, and offer unloaded frames."""
        nonlocal sequence
        for place in random.uniform(0, 7, (20, 1, 2)):
            sequence += 1
            load = contact(place, np.array([1.0]), array, width_mm=1.1)[0] / GAIN
            load[list(wrong)] = load[list(wrong)[::-1]]
            monitor.map.observe(sequence / 10, (load + random.normal(0, 1, array.size)).astype(np.float32), sigma)
            counts, flags = np.full(array.size, NO_LOAD, np.uint16), np.zeros(array.size, np.uint8)
            rig.sensor.restore(RawFrame(sequence, sequence / 10, 0.0, counts, flags, Loss(), sequence / 10))

    def kinds():
        return [(each.kind, each.text) for each in rig.service.events.after(0)]

    def health():
        answer = client.get("/sensors/palm/health")
        assert answer.status_code == 200, answer.text
        return answer.json()

    assert health()["map"] is None
    until(lambda: (touch(*SWAPPED), monitor.state.faults.any())[1])
    assert health()["map"] == "taxels 20 and 43 swapped"
    assert [(each["taxel"], each["fault"]) for each in health()["faults"]] == [(at, "swapped") for at in SWAPPED]
    assert {"faulty", "wrong_map"} <= {each.code for each in rig.sensor.hub.latest().warnings}
    until(lambda: [each for each in kinds() if each[0] == "warning_raised" and "20 and 43 swapped" in each[1]])
    until(lambda: any(kind == "taxel_faulty" and "taxels 20, 43 swapped" in text for kind, text in kinds()))
    until(lambda: (touch(), not monitor.map.wrong and not monitor.state.faults.any())[1])
    assert (health()["map"], health()["faults"]) == ("as configured", [])
    until(lambda: (touch(), any(kind == "taxel_healed" for kind, _ in kinds()))[1])
    until(lambda: any(kind == "warning_cleared" and "swapped" in text for kind, text in kinds()))
