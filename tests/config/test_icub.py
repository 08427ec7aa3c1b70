"""Files of iCub and ergoCub, with numbers of robots-configuration and icub-main, whose files are named."""

import numpy as np
import pytest

from tactiled.build import make_array, make_codec
from tactiled.config import icub, parse
from tactiled.errors import ConfigError

DEFAULTS = {
    "period": "50",
    "skinType": "8",
    "noLoad": "0xf0",
    "enabled": "false",
    "shift": "2",
    "cdcOffset": "0x2200",
}
# iCubGenova09/hardware/skin/left_upperarm-eb2-skinSpec.xml
UPPER_ARM = ("1 13 3 10 2 1 0x2200",)
# app/skinGui/conf/skinGui/left_upperarm_V3.ini
UPPER_ARM_INI = """cardid 13\t\t
robotPart left_upperarm
[SENSORS]\t\t
#\t     Number\tX\t\tY\tOrientation (degree)\tGain \tMirror
triangle_10pad\t8\t-2\t34.57437416\t180\t4\t
triangle_10pad\t9\t14\t25.33676985\t239.9998597\t4\t
triangle_10pad\t6\t14\t6.861561237\t180\t4\t
triangle_10pad\t7\t-2\t-2.37604307\t120.0001403\t4\t
triangle_10pad\t3\t30\t-2.37604307\t239.9998597\t4\t
triangle_10pad\t4\t46\t6.861561237\t299.9997194\t4\t
triangle_10pad\t10\t30\t34.57437416\t299.9997194\t4\t
triangle_10pad\t5\t46\t25.33676985\t239.9998597\t4\t
"""
# left_forearm_V2.ini: two boards, mirrored
FOREARM_INI = """cardid 13 12
[SENSORS]
palmL\t5\t0\t0\t0\t4
triangle_10pad\t0\t100.00\t-20.00\t30.00\t5\t1
triangle_10pad\t1\t109.24\t-4.00\t-30.00\t5\t1
triangle_10pad\t16\t100.00\t-100.00\t-210.00\t5\t0
"""


@pytest.fixture
def write(tmp_path):
    """Writes a skinSpec.xml, and a file of positions."""

    def written(sets=(), boards=(), positions=None, name="left_arm-eb1-skinSpec.xml", numbers=(), **defaults):
        texts = DEFAULTS | defaults
        groups = {
            "defaultCfgBoard": {key: texts[key] for key in ("period", "skinType", "noLoad")},
            "specialCfgBoards": {f"boardSetCfg{n}": each for n, each in enumerate(boards, 1)},
            "defaultCfgTriangle": {key: texts[key] for key in ("enabled", "shift", "cdcOffset")},
            "specialCfgTriangles": {f"triangleSetCfg{n}": each for n, each in enumerate(sets, 1)},
        }
        for group in ("specialCfgBoards", "specialCfgTriangles"):
            groups[group]["numOfSets"] = str(dict(numbers).get(group, len(groups[group])))
        xml = "".join(
            f'<group name="{group}">'
            + "".join(f'<param name="{key}">   {text}  </param> <!-- x -->' for key, text in table.items())
            + "</group>"
            for group, table in groups.items()
        )
        spec = tmp_path / name
        spec.write_text(
            f'<?xml version="1.0" encoding="UTF-8" ?>\n<!DOCTYPE params PUBLIC "a" "b">\n<params>{xml}</params>'
        )
        if positions is not None:
            (tmp_path / "part.ini").write_text(positions)
        return spec, None if positions is None else tmp_path / "part.ini"

    return written


def sensors(files):
    return parse(icub.configuration(*files)).sensor


def test_an_upper_arm_has_its_triangles_and_a_regular_lattice_over_their_edges(write):
    (sensor,) = sensors(write(UPPER_ARM, positions=UPPER_ARM_INI)).values()
    codec = sensor.codec.settings
    assert (codec.board, codec.triangles, codec.skin_type) == (13, tuple(range(3, 11)), 8)
    assert (codec.period_ms, codec.shift, codec.cdc_offset, codec.no_load) == (50, 1, 0x2200, 0xF0)
    array = make_array(sensor)
    assert array.size == make_codec(sensor).size == 80
    places = np.array(sensor.array.positions_mm)
    centre = 10 * codec.triangles.index(8) + 3  # pad 3 is a triangle's centre, and 6 is thermal
    np.testing.assert_allclose(places[centre], (-2, -34.57), atol=0.01)
    np.testing.assert_allclose(places[centre - 3], (-2 - 257.2 / 40, -34.57), atol=0.01)  # turned by 180 degrees
    distances = np.hypot(*(places[:, None] - places).T) + np.diag(np.full(80, np.inf))
    np.testing.assert_allclose(distances.min(axis=0), 257.2 / 40, atol=0.02)
    assert np.count_nonzero(distances < 6.5) > 2 * 8 * 12  # those of single triangles have 12 such pairs


def test_sets_of_one_board_with_other_settings_and_two_ports_are_sensors_of_their_own(write):
    sets = ("1 14 0 6 1 0 0x2000", "1 14 8 11 1 2 0x2200", "2 9 0 8 1 2 0x2200", "2 9 4 4 0 2 0x2200")
    found = sensors(write(sets))
    got = {
        name: (each.bus, each.codec.settings.board, each.codec.settings.triangles, each.codec.settings.cdc_offset)
        for name, each in found.items()
    }
    assert got == {
        "left_arm_14_0": ("can0", 14, tuple(range(7)), 0x2000),
        "left_arm_14_8": ("can0", 14, (8, 9, 10, 11), 0x2200),
        "left_arm_9_0": ("can1", 9, (0, 1, 2, 3, 5, 6, 7, 8), 0x2200),
    }


def test_an_ergocub_hand_has_the_board_of_its_special_set(write):
    """ergoCubSN001/hardware/skin/left_hand-eb4-j2_3-skinSpec.xml, which counts one set and has four."""
    sets, boards = ("2 2 0 15 1 1 0x0000", "2 2 8 8 1 3 0x0000"), ("2 2 2 50 1 0xc8",)
    files = write(sets, boards, numbers={"specialCfgTriangles": 1}, skinType="2", shift="1", cdcOffset="0x0000")
    (sensor,) = sensors(files).values()
    codec = sensor.codec.settings
    assert (codec.board, codec.triangles, codec.skin_type, codec.no_load) == (2, tuple(range(16)), 1, 0xC8)
    assert (codec.shift, codec.cdc_offset) == (1, 0)


def test_boards_come_from_the_file_beside_and_cards_number_the_triangles(write, tmp_path):
    (tmp_path / "left_arm-eb1-skin.xml").write_text(
        '<device><group name="patches"><param name="skinCanAddrsPatch1"> 12 13 </param></group></device>'
    )
    found = sensors(write(enabled="true", skinType="0", positions=FOREARM_INI))
    codecs = [each.codec.settings for each in found.values()]
    assert {each.board: each.triangles for each in codecs} == {13: (0, 1), 12: (0,)}
    by_board = {each.codec.settings.board: np.array(each.array.positions_mm) for each in found.values()}
    np.testing.assert_allclose(by_board[12][3], (100, 100), atol=0.01)
    angle = np.deg2rad(30)  # pad 0 of a mirrored triangle is on the other side
    np.testing.assert_allclose(by_board[13][0], (100 - 6.43 * np.cos(angle), 20 + 6.43 * np.sin(angle)), atol=0.01)


@pytest.mark.parametrize(("side", "mirrored"), [("L", 0), ("R", 1)])
def test_fingertips_are_laid_flat(write, side, mirrored):
    """left_hand_V2_2.ini and right_hand_V2_2.ini: the middle finger, and the thumb, turned by 90 degrees."""
    lines = "".join(f"fingertip3{side} {each} 4.0 {mirrored} 0\n" for each in ("2 -5 40 0", "4 -40 -40 90"))
    (sensor,) = sensors(write(("1 10 0 4 1 2 0x2200",), skinType="1", positions="[SENSORS]\n" + lines)).values()
    assert sensor.codec.settings.triangles == (2, 4)
    places, unit = np.array(sensor.array.positions_mm), 2.7 / 15.3
    assert make_array(sensor).size == make_codec(sensor).size == 22  # pad 11 is thermal in hands
    ring = (
        9 if side == "L" else 2
    )  # the pad at the origin, and beside it one to the right, and the far row's middle
    right, far = (8, 6) if side == "L" else (1, 10)
    assert sensor.array.aperture_mm == 3.5  # the nearest two are 3.53 mm apart
    middle, thumb = places[:11], places[11:]
    np.testing.assert_allclose(middle[ring], (-5, -40), atol=0.01)
    np.testing.assert_allclose(middle[right] - middle[ring], (25 * unit, -10 * unit), atol=0.01)
    np.testing.assert_allclose(middle[far] - middle[ring], (0, 58 * unit), atol=0.01)
    np.testing.assert_allclose(thumb[far] - thumb[ring], (58 * unit, 0), atol=0.01)


@pytest.mark.parametrize(("side", "normal", "sign"), [("left", -1.0, 1), ("right", 1.0, -1)])
def test_a_palm_is_seen_from_outside(write, side, normal, sign):
    """app/skinGui/conf/positions/left_hand_V2_1.txt: twelve lines a triangle, in m; the palm's are 8 to 11."""
    lines = ["0.0  0.0  0.0  0.0  0.0  0.0"] * 192
    for taxel in range(96, 144):
        lines[taxel] = f"{-0.0094 + 0.005 * (taxel % 8)} {0.0012 + 0.005 * (taxel // 8)} 0.0 0.0 0.0 {normal}"
    text = f"name {side}\n[calibration]\n" + "\n".join(lines) + "\n"
    (sensor,) = sensors(write(("1 14 0 15 1 2 0x2200",), positions=text, skinType="1")).values()
    assert sensor.codec.settings.triangles == (8, 9, 10, 11)
    assert sensor.array.positions_mm[0] == (-9.4, sign * 61.2)
    assert len(sensor.array.positions_mm) == 44
    curved = text.replace(f" 0.0 0.0 0.0 {normal}", f" 0.003 0.0 0.0 {normal}", 1)
    with pytest.raises(ConfigError, match=r"part\.ini: this part is curved"):
        sensors(write(("1 14 0 15 1 2 0x2200",), positions=curved, skinType="1"))


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"sets": ("1 14 0 6 1 0",)}, r"triangleSetCfg1 = '1 14 0 6 1 0': expected 7 numbers"),
        ({"sets": ("1 14 0 x 1 0 0",)}, r"triangleSetCfg1 = 'x': no whole number"),
        ({"sets": ("1 14 0 16 1 0 0",)}, r"triangles 0 to 16: a board has 0 to 15"),
        ({"sets": UPPER_ARM, "skinType": "7"}, r"skinType = 7: known are 0, 1, 2, 3 and 8"),
        ({"sets": UPPER_ARM, "period": ""}, r"period = '': no whole number"),
        ({"sets": ("1 14 0 2 0 2 0",)}, r"none of its triangles is enabled"),
        ({"sets": UPPER_ARM, "positions": "[SENSORS]\n"}, r"part.ini: places no triangle"),
        ({"sets": UPPER_ARM, "positions": FOREARM_INI}, r"places triangle 16, and there are 1 boards of 16"),
        (
            {"sets": UPPER_ARM, "positions": "[SENSORS]\ntriangle 3 1"},
            r"'triangle 3 1': expected number, x, y, angle",
        ),
        ({}, r"names no board: put the robot's file left_arm-eb1-skin\.xml beside it"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(write, files, words):
    with pytest.raises(ConfigError, match=words):
        sensors(write(**files))
