import dataclasses
import re

import numpy as np
import pytest

from tactiled.web.rest import drawing
from tactiled.web.rest.frames import picture
from tests.conftest import NO_LOAD, SIDE, meanwhile, pressed, until
from tests.viewer.conftest import THUMB, Pair


def draw(*arguments):
    return drawing.draw(picture(*arguments))


def scale(figure):
    return figure.axes[0].images[0].get_clim()


def test_noise_alone_is_dark_and_a_load_fills_the_scale(rig):
    idle = rig.show(np.full((SIDE, SIDE), NO_LOAD) + np.arange(SIDE) % 2)  # up to 0.5 kPa, the noise
    assert scale(draw(rig.sensor, idle, "raw", None)) == (0, 15 * 0.5)
    assert scale(draw(rig.sensor, idle, "raw", 3.0)) == (0, 3.0)
    strong = rig.show(pressed())
    unknown = dataclasses.replace(strong, noise_gain=float("nan"))
    for image in (strong, unknown):
        assert scale(draw(rig.sensor, image, "raw", None)) == (0, 200)
    assert scale(draw(rig.sensor, strong, "restored", None)) == (0, strong.restored.max())
    deviation = rig.sensor.pipeline.deviation(strong)
    assert scale(draw(rig.sensor, strong, "deviation", None)) == (0, deviation.max())


def test_the_title_gives_the_age_of_a_stale_image(rig):
    image = rig.show(pressed())
    assert draw(rig.sensor, image, "raw", None).axes[0].get_title() == "palm, raw, frame 0"
    until(lambda: rig.sensor.status().state == "stale")
    title = draw(rig.sensor, image, "raw", None).axes[0].get_title()
    assert re.fullmatch(r"palm, raw, frame 0\nSTALE: \d+\.\d+ s old", title)


def test_a_map_is_true_to_scale_and_taxels_of_no_grid_are_as_large_as_they_are():
    with meanwhile(Pair("picture", THUMB)) as pair:
        for sensor, image in zip(("palm", "thumb"), pair.both(), strict=True):
            figure = draw(pair.service.sensor(sensor), image, "raw", None)
            figure.draw_without_rendering()
            extent, axes = figure.axes[0].get_window_extent(), figure.axes[0]
            across, down = np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())
            assert extent.width / extent.height == pytest.approx(across / down, rel=0.01)
    (discs,) = axes.collections
    assert set(discs.get_widths()) == {1.5}
    np.testing.assert_array_equal(discs.get_array(), image.raw)
