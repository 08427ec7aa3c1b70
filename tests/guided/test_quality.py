import numpy as np
import pytest

from tactiled.geometry import grid, layout
from tactiled.guided.quality import Need, advice, enough, zone_counts

NEED = Need("press", 20, per_zone=2)
FULL = np.full((3, 3), 2)


def zones(**counts):
    made = FULL.copy()
    for place, count in counts.items():
        made[{"left": (1, 0), "top": (0, 1), "right": (1, 2), "middle": (1, 1), "bottom": (2, 1)}[place]] = count
    return made


def test_every_place_counts_in_its_zone_and_beside_the_array_in_the_nearest():
    array = grid(6, 9, 2.0, 1.5)  # 18 mm x 12 mm about its taxels, the first at (0, 0)
    places = np.array([[-0.9, -0.9], [7.9, 5.0], [8.0, 4.9], [16.9, 10.9], [-50.0, 5.0], [99.0, 5.0]])
    np.testing.assert_array_equal(zone_counts(places, array), [[1, 0, 0], [1, 2, 1], [0, 0, 1]])
    assert not zone_counts(np.empty((0, 2)), array).any()
    thin = layout(np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0]]), 1.0)
    np.testing.assert_array_equal(zone_counts(np.array([[8.0, 0.0]]), thin), [[0, 0, 0], [0, 0, 1], [0, 0, 0]])


@pytest.mark.parametrize(
    ("count", "where", "text"),
    [
        (0, np.zeros((3, 3), int), "0 of 20 presses"),
        (20, FULL, "20 presses: enough"),
        (12, FULL, "12 of 20 presses"),
        (12, zones(left=0), "12 of 20 presses; enough in the middle, none at the left border"),
        (21, zones(left=1, middle=0), "21 of 20 presses; none in the middle, 1 at the left border"),
        (
            9,
            zones(left=0, top=0, right=0, bottom=0),
            "9 of 20 presses; enough in the middle, none at the top border, at the left border "
            "and in 2 more zones",
        ),
    ],
)
def test_advice_names_what_is_missing(count, where, text):
    assert advice(count, where, NEED) == text
    assert enough(count, where, NEED) == text.endswith("enough")


def test_what_needs_no_zones_counts_alone():
    need = Need("edge", 5)
    assert advice(4, np.zeros((3, 3), int), need) == "4 of 5 edges"
    assert enough(5, np.zeros((3, 3), int), need)
