from importlib import import_module

import pytest


@pytest.mark.parametrize("module", ["tests.bench.__main__", "tests.viewer.measure_seek"])
def test_every_measurement_can_be_imported(module):
    import_module(module)
