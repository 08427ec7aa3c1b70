import pytest

from tactiled.bus.sniff import survey
from tactiled.cli.demo import demo_config
from tactiled.cli.sniff import configuration
from tactiled.config import parse
from tactiled.config.example import EXAMPLE
from tactiled.plausibility.settings import config_findings, unedited
from tests import conftest, plans, skin
from tests.bus.skins import CODECS, DBC, traffic

BUS = '[bus.can0]\ninterface = "virtual"\n'
SKIN = """[sensor.a]
bus = "can0"
{more}
codec = {{ {codec} }}
array = {{ {array} }}
cover = [{cover}]
substrate = [{substrate}]
calibration = {{ {calibration} }}
"""
PACKED, WIDE, BYTES = (f'name = "packed", fd = true, bits = {bits}' for bits in (12, 16, 8))
ICUB = 'name = "icub", board = 4, triangles = [0, 1]'
# A skin: codec; rows, columns, pitch and aperture (mm), none where the skin knows them; layers of the cover and of
# the substrate: thickness (mm), Young's modulus (MPa), Poisson's ratio; calibration.
SKINS = {
    "iCub under neoprene": (ICUB, (), [(2.0, 1.0, 0.45)], [], "no_load = 245, saturation = 10"),
    "iCub in kPa": (ICUB, (), [(2.0, 0.5, 0.48)], [], "kpa_per_count = -0.8"),
    "XELA uSkin, 7.35 N on 16 mm2 at 10 085 counts": (
        'name = "xela"', (4, 6, 4.7), [(4.0, 0.2, 0.49)], [],
        "kpa_per_count = 0.0456, no_load = 36000, shear_n_per_count = 0.0006, saturation = 46085",
    ),
    "LinkerHand": ('name = "linker", fingers = [1, 2]', (24, 6, 1.5), [(2.0, 0.5, 0.48)], [], ""),
    "thick gel": (
        PACKED, (5, 4, 2.5, 1.0), [(5.0, 0.1, 0.499)], [], "kpa_per_count = 0.05, no_load = 2000, noise_kpa = 0.5"
    ),
    "softest gel": (PACKED, (8, 8, 2.0), [(2.0, 0.005, 0.4999)], [], ""),
    "magnetic lattice over Hall elements": (
        WIDE, (3, 5, 15.0, 0.1), [(10.0, 1.0, 0.3)], [], "kpa_per_count = 0.01, no_load = 32768"
    ),
    "insole of leather on foam": (
        PACKED, (22, 8, 10.0, 9.0), [(1.2, 60.0, 0.4)], [(4.0, 0.3, 0.2)], "kpa_per_count = 0.3, noise_kpa = 3.0"
    ),
    "mattress": (BYTES, (32, 32, 25.0), [(50.0, 0.01, 0.1)], [], "kpa_per_count = 0.13"),
    "floor tiles under vinyl": (PACKED, (10, 10, 300.0), [(2.0, 50.0, 0.4)], [], "kpa_per_count = 1.0"),
    "fingerprint sensor under parylene": (
        BYTES, (64, 64, 0.05), [(0.005, 2800.0, 0.4)], [], "kpa_per_count = 0.5"
    ),
    "hard film on gel, glued to a board": (
        PACKED, (16, 16, 1.0), [(0.05, 4000.0, 0.35), (1.0, 0.5, 0.4999)], [(0.025, 1, 0.48), (1.6, 2e4, 0.15)], ""
    ),
    "film on foam": (PACKED, (16, 16, 2.0), [(0.1, 4000.0, 0.38)], [(3.0, 0.05, 0.1)], "kpa_per_count = 0.2"),
    "glass over a rigid array": (PACKED, (8, 8, 4.0), [(0.7, 7e4, 0.22)], [(1.0, 1e7, 0.3)], "kpa_per_count = 1"),
    "polyurethane sole": (PACKED, (16, 16, 1.5), [(2.0, 150.0, 0.45)], [], ""),
    "hard rubber": (PACKED, (8, 8, 2.0), [(2.0, 20.0, 0.49)], [], ""),
    "parylene alone": (PACKED, (8, 8, 2.0), [(0.01, 2800.0, 0.4)], [], ""),
    "spun rubber on a fine array": (PACKED, (16, 16, 0.1), [(0.02, 1.5, 0.49)], [], ""),
    "two buttons": (PACKED, (1, 2, 2.0), [(5.0, 0.5, 0.48)], [], ""),
    "16 bits in kPa": (WIDE, (8, 8, 2.0), [(2.0, 0.5, 0.48)], [], "kpa_per_count = 1.0"),
    "floats of a DBC file": (
        f'name = "dbc", file = "{DBC}", taxels = ["Floats.F0", "Floats.F1"]', (1, 2, 2.0), [(2.0, 0.5, 0.48)], [],
        "kpa_per_count = 1e-3, no_load = 1000000"
    ),
    "Shimojo's softest film": (PACKED, (20, 20, 0.25), [(0.6, 98.0, 0.45)], [(1.0, 980.0, 0.3)], ""),
    "Shimojo's hardest film": (PACKED, (20, 20, 1.0), [(0.1, 9807.0, 0.3)], [(1.0, 980.0, 0.3)], ""),
}  # fmt: skip


def toml(codec, array, cover, substrate, calibration, more=""):
    lists = [
        ", ".join("{{thickness_mm={}, young_mpa={}, poisson={}}}".format(*layer) for layer in layers)
        for layers in (cover, substrate)
    ]
    places = zip(("rows", "columns", "pitch_mm", "aperture_mm"), array, strict=False)
    return BUS + SKIN.format(
        more=more, codec=codec, array=", ".join(f"{key} = {value}" for key, value in places), cover=lists[0],
        substrate=lists[1], calibration=calibration,
    )  # fmt: skip


RIGS = {
    "rig": conftest.CONFIG.format(channel="a"),
    "palm beside a 3-axis skin": skin.CONFIG.format(channel="a") + skin.PALM,
    "plans": plans.CONFIG.format(
        refine=1, array="rows = 12, columns = 12, pitch_mm = 1", aperture=0.8, thickness=3, model="fem"
    ),
}
SNIFFED = {
    name: configuration(survey(traffic(CODECS[name])), {"interface": "virtual"})
    for name in ("packed", "icub", "xela", "barrett", "poweron", "cyskin", "linker")
}
SENSIBLE = {name: toml(*each) for name, each in SKINS.items()} | RIGS | SNIFFED


def findings(text, hints=False):
    return [str(each) for each in config_findings(parse(text)) if each.hint == hints]


@pytest.mark.parametrize("name", SENSIBLE)
def test_a_sensible_skin_raises_no_finding(name):
    assert not findings(SENSIBLE[name])


def test_the_examples_of_the_package_raise_none():
    for config in (parse(EXAMPLE), demo_config(), demo_config("book_1"), demo_config(shear=True)):
        assert not config_findings(config)


def test_a_grid_that_is_given_as_positions_is_only_a_hint():
    def hints(places):
        text = toml(PACKED, (), [(1.0, 0.5, 0.48)], [], "").replace(
            "array = {", f"array = {{ positions_mm = {places}"
        )
        return findings(text, hints=True)

    places = [[2.0 * column, 2.0 * row] for row in range(4) for column in range(5)]
    reason = "a grid: rows = 4, columns = 5, pitch_mm = 2 is restored better"
    assert hints(places) == [f"sensor.a.array.positions_mm: {reason}"]
    assert not hints(places[::-1])  # its order is not that of a grid
    assert not hints([*places[:-1], [8.0, 6.5]])
    assert not hints(places[:-1])


def test_scale_and_unit_of_a_dbc_file_are_offered():
    def hints(signals, calibration=""):
        return hints_of([f"Row{signals}.T{signals}_{column}" for column in range(3)], calibration)

    def hints_of(taxels, calibration=""):
        codec = f'name = "dbc", file = "{DBC}", taxels = {taxels}'
        return findings(toml(codec, (1, len(taxels), 4.0), [(1.0, 0.5, 0.48)], [], calibration), hints=True)

    (hint,) = hints(0)
    assert hint == (
        "sensor.a.calibration: counts without kpa_per_count; "
        "kpa_per_count = 0.05 and no_load = 80 by scale, offset and unit of the DBC file"
    )
    assert not hints(0, "kpa_per_count = 0.07")  # as measured
    assert hints(0, "kpa_per_count = 0.5") == [
        "sensor.a.calibration.kpa_per_count = 0.5: "
        "scale, offset and unit of the DBC file say kpa_per_count = 0.05 and no_load = 80"
    ]
    assert not hints(1)  # no unit
    (hint,) = hints_of(["Floats.F0", "Floats.F1"])
    assert "kpa_per_count = 1 and no_load = 0 by" in hint


def test_what_may_be_meant_is_only_a_hint():
    (hint,) = findings(EXAMPLE.replace("stale_after_s = 0.5", "stale_after_s = 500"), hints=True)
    assert hint.endswith("a skin that fell silent passes for alive all that time; 0.5 s if it was given in ms")
    assert not findings(EXAMPLE.replace("stale_after_s = 0.5", "stale_after_s = 5"), hints=True)
    codec, array, _, *rest = SKINS["thick gel"]
    assert findings(toml(codec, array, [(5.0, 1.0, 0.3)], *rest), hints=True) == [
        "sensor.a.cover.poisson = 0.3: right for foam; solid rubber as soft as 1 MPa has 0.45 to 0.4999"
    ]
    for cover in ((5.0, 0.1, 0.45), (5.0, 98.0, 0.3)):
        assert not findings(toml(codec, array, [cover], *rest), hints=True)


RUBBER = "stiffer than any rubber, which Poisson's ratio of 0.48 says it is; 0.6 MPa if it was given in"
# What is typed into the file of `tactiled init`: line, value, place and reason.
SLIPS = [
    ("thickness_mm = 1.2", 0.0012, "cover", "thinner than a coat of paint; 1.2 mm if it was given in metres"),
    ("thickness_mm = 1.2", 0.02, "cover", "thinner than a coat of paint; 20 mm if it was given in metres"),
    ("thickness_mm = 1.2", 100, "cover", "(32 mm, pitch 1 mm); 0.1 mm if it was given in µm"),
    ("thickness_mm = 1.0", 0.0016, "substrate", "a coat of paint; 1.6 mm if it was given in metres"),
    ("young_mpa = 0.6", 600_000, "cover", f"{RUBBER} Pa"),
    ("young_mpa = 0.6", 600, "cover", f"{RUBBER} kPa"),
    ("young_mpa = 0.6", 0.0011, "cover", "softer than any gel; 1.1 MPa if it was given in GPa"),
    ("pitch_mm = 1.0", 0.025, "array", "a fingerprint sensor's taxels; 25 mm if it was given in metres"),
    ("kpa_per_count = 0.05", 50, "calibration", "201000 kPa at most, more than any skin measures; 0.05 kPa if it"
     " was given in Pa"),
    ("kpa_per_count = 0.05", 5e-5, "calibration", "0.201 kPa at most, less than a touch; 0.05 kPa if it was given"
     " in MPa"),
    ("no_load = 80", 4200, "calibration", "the codec's counts are 0 to 4095"),
    ("no_load = 80", -80, "calibration", "the codec's counts are 0 to 4095"),
    ("saturation = 4095", 70, "calibration", "a taxel at rest is saturated: must be above no_load = 80"),
    ("saturation = 4095", 4096, "calibration", "never reached: the codec's counts are 0 to 4095"),
    ("# noise_kpa = 0.1", 1e6, "calibration", "drowns all that the array measures, 201 kPa at most"),
    ("# noise_kpa = 0.1", 100, "calibration", "201 kPa at most; 0.1 kPa if it was given in Pa"),
    ("stale_after_s = 0.5", 0.001, "", "every image is stale: the 25 messages of a frame take at least 0.0025 s"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "value", "table", "reason"), SLIPS)
def test_a_slip_is_one_finding_that_names_it(line, value, table, reason):
    key = line.removeprefix("# ").split(" = ")[0]
    (finding,) = findings(EXAMPLE.replace("aperture_mm = 0.8", "").replace(line, f"{key} = {value}", 1))
    assert finding.startswith(f"sensor.palm.{table and table + '.'}{key} = {value:g}: ")
    assert finding.endswith(reason)


def test_a_read_token_that_allows_control_is_a_finding():
    tokens = '[server]\nread_token = "{}"\ncontrol_token = "0123456789abcdef"\n'
    (finding,) = findings(tokens.format("0123456789abcdef") + RIGS["rig"])
    assert finding.startswith("server.read_token: the same as control_token: ")
    assert not findings(tokens.format("fedcba9876543210") + RIGS["rig"])


# The same, into one of SKINS: cover, substrate or others.
SKIN_SLIPS = [
    ("iCub in kPa", ["kpa_per_count = 0.8"], "no_load = 240: leaves 15 counts for pressure: if counts fall under"),
    ("thick gel", ["kpa_per_count = -1, no_load = 100"], "under pressure, kpa_per_count is positive"),
    ("iCub in kPa", ["kpa_per_count = -800"], "more than any skin measures; -0.8 kPa if it was given in Pa"),
    ("iCub in kPa", ["kpa_per_count = -1, saturation = 250"], "must be below no_load = 240"),
    ("LinkerHand", ["", "stale_after_s = 0.01"], "every image is stale: frames are polled every 0.05 s"),
    ("magnetic lattice over Hall elements", [(3, 5, 15.0, 0.01)], "a point, at a pitch of 15 mm"),
    ("iCub under neoprene", [[(2.0, 1e5, 0.45)]], "ratio of 0.45 says it is; 0.1 MPa if it was given in Pa"),
    ("16 bits in kPa", [[(40, 0.5, 0.48)], []], "for any detail to reach this array (16 mm, pitch 2 mm)"),
    ("two buttons", [[(100, 0.5, 0.48)], []], "; 0.1 mm if it was given in µm"),
    ("floor tiles under vinyl", [[(0.02, 50.0, 0.4)], []], "; 20 mm if it was given in metres"),
    ("16 bits in kPa", [[(0.2, 6e5, 0.3)], []], "harder than steel; 0.6 MPa if it was given in Pa"),
    ("16 bits in kPa", [[(2.5, 2e4, 0.3)], []], "a plate that hides all detail"),
    ("16 bits in kPa", [[(1.6, 2300, 0.35)], [(2.0, 0.5, 0.48)]], "substrate.young_mpa = 0.5: softer than"),
    ("16 bits in kPa", [[(0.001, 4000, 0.3), (0.002, 0.5, 0.48)], []],
     "cover = 2 layers of 0.003 mm: thinner than a coat of paint; 3 mm if it was given in metres"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "change", "reason"), SKIN_SLIPS)
def test_a_slip_is_judged_by_the_skin(name, change, reason):
    parts = [*SKINS[name], ""]
    first = 1 if isinstance(change[0], tuple) else 2 if isinstance(change[0], list) else 4
    parts[first : first + len(change)] = change
    (finding,) = findings(toml(*parts))
    assert reason in finding


def test_a_sniffed_file_is_unedited_until_its_marks_are_gone():
    assert [str(each).split(":")[1].strip() for each in unedited(SNIFFED["packed"])] == [
        "[sensor.packed1.array]", "[sensor.packed1.cover]", "kpa_per_count = 0.05"
    ]  # fmt: skip
    assert not unedited(SNIFFED["packed"].replace("EDIT:", "")) + unedited(EXAMPLE)
