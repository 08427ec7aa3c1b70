from dataclasses import replace

import numpy as np
import pytest

from tactiled.bus.codecs.pushed import Pushed
from tactiled.live.contact_search import ImageContacts
from tactiled.live.noise import NOISE_FRAMES
from tactiled.live.pipeline import Pipeline
from tests.conftest import NO_LOAD, SIDE, pressed
from tests.live.conftest import frame

EMPTY = np.full((SIDE, SIDE), NO_LOAD)


def test_before_the_noise_is_known_an_image_says_so_and_noise_is_no_contact(plan):
    unknown = replace(plan, method="wiener", calibration=replace(plan.calibration, noise_kpa=None))
    pipeline, random = Pipeline(unknown), np.random.default_rng(8)
    find, contacts, codes = ImageContacts(plan.array, plan.cells), [], []
    for n in range(NOISE_FRAMES):
        image = pipeline.process(frame(n, np.round(EMPTY + random.normal(0, 6, EMPTY.shape))))
        contacts += find(image, n * 0.01)
        codes.append("noise_unknown" in [each.code for each in image.warnings])
    assert (contacts, codes) == ([], [True] * (NOISE_FRAMES - 1) + [False])
    early = Pipeline(unknown).process(frame(counts=np.where(pressed() > NO_LOAD, 4000, EMPTY)))
    assert len(ImageContacts(plan.array, plan.cells)(early, 0.0)) == 1
    again = Pipeline(unknown, pipeline)
    assert "noise_unknown" not in [each.code for each in again.process(frame(counts=EMPTY)).warnings]


def test_pushed_readings_have_no_noise_of_rounding(plan):
    codec = Pushed(SIDE * SIDE)
    pushed = replace(plan, codec=codec, calibration=replace(plan.calibration, noise_kpa=None, kpa_per_count=1.0))
    pipeline, random = Pipeline(pushed), np.random.default_rng(8)
    for n in range(NOISE_FRAMES + 1):
        values = (EMPTY + random.normal(0, 0.02, EMPTY.shape)).astype(np.float32)
        image = pipeline.process(replace(frame(n), counts=values.ravel()))
    assert image.noise == pytest.approx(0.02, rel=0.1)
