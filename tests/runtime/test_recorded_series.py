import pickle

import numpy as np
import pytest

from tactiled.build import sensor_plan
from tactiled.config import parse
from tactiled.config.example import EXAMPLE, GRASP


@pytest.mark.parametrize("text", [EXAMPLE, GRASP], ids=["grid", "layout"])
def test_another_process_restores_with_the_same_blur(text):
    ((name, sensor),) = parse(text).sensor.items()
    plan = sensor_plan(name, sensor)
    plan.blur.thickness_error = 0.07
    blur, image = pickle.loads(pickle.dumps(plan)).blur, np.arange(len(plan.cells.areas), dtype=np.float32)
    image = image.reshape(plan.blur.surface_shape)
    np.testing.assert_array_equal(blur.forward(image), plan.blur.forward(image))
    assert blur.thickness_error == 0.07
