"""Skins by name, and those of other packages; the one in the guide is installed and run as it stands there."""

import re
import tomllib
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from tactiled.build import make_array, make_calibration, make_codec, sensor_plan
from tactiled.bus.assembler import assemble
from tactiled.bus.codecs import xela
from tactiled.bus.router import Router
from tactiled.bus.sniff import survey
from tactiled.config import parse
from tactiled.errors import ConfigError
from tactiled.frames import Loss
from tests.bus.skins import CONFIG

GUIDE = (Path(__file__).parents[2] / "tactiled/docs/codecs.md").read_text("utf-8")
SECTION = GUIDE.split("\n## A codec of your own\n")[1].split("\n## ")[0]
CODE = re.search(r"```python\n(.*?)```", SECTION, re.DOTALL)[1]
PACKAGE = "'my-skin' of my_skin 1.2: "


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a package with an entry point on the path, as pip does."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(code=CODE, name="my-skin", package="my_skin"):
        module = f"{package}_{tmp_path.name}".replace("-", "_")  # no test finds another's in sys.modules
        (tmp_path / f"{module}.py").write_text(code)
        about = tmp_path / f"{package}-1.2.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n")
        (about / "entry_points.txt").write_text(f"[tactiled.codecs]\n{name} = {module}:MySkin\n")

    return put


def sensor(codec='name = "my-skin"', array="rows = 2, columns = 4, pitch_mm = 4.0"):
    return parse(CONFIG.format(codec=codec, array=array), "a.toml").sensor["skin"]


def test_the_guides_example_works_and_is_recognised(install):
    project = tomllib.loads(re.search(r"```toml\n(.*?)```", SECTION, re.DOTALL)[1])["project"]
    assert {*project} == {"name", "version", "entry-points"}  # without a name and a version pip refuses it
    assert project["entry-points"] == {"tactiled.codecs": {"my-skin": "my_skin:MySkin"}}
    install()
    plan = sensor_plan("skin", sensor('name = "my-skin", base_id = 0x200'))
    assert (plan.codec_name, plan.codec.ids) == ("my-skin", {(0x200, False), (0x201, False)})
    counts = np.array([0, 1, 2, 3, 250, 251, 252, 255], np.uint16)
    messages = [each for n in range(20) for each in plan.codec.encode(counts, 0, n / 50)]
    assert [each.data.hex() for each in messages[:2]] == ["00010203", "fafbfcff"]
    frames, loss = assemble(plan.codec, messages)
    np.testing.assert_array_equal(frames[0].counts, counts)
    assert (len(frames), loss) == (20, Loss())
    (sender,) = survey(messages).senders
    assert (sender.name, sender.match.settings, sender.frames) == ("my-skin", {"base_id": 0x200}, 20)


@pytest.mark.parametrize(
    ("codec", "reasons"),
    [
        ('name = "my-skin", base_id = 0x7FF', [": base_id = 2047: give 0 to 2046"]),
        ('name = "my-skin", base_id = "a"', [": base_id = hidden: Input should be a valid integer"]),
        ('name = "my-skin", base_ib = 1', [": base_ib: unknown key"]),
        (
            'name = "barrett", node = 99, nod = 1',
            [".node = 99: give 0 to 31", ".nod: unknown key: did you mean node?"],
        ),
    ],
)
def test_every_fault_of_a_skins_settings_is_named(install, codec, reasons):
    install()
    with pytest.raises(ConfigError) as caught:
        sensor(codec)
    for each in reasons:
        assert f"a.toml: sensor.skin.codec{each}" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("import numpy as np", "import nympy as np", "import: ModuleNotFoundError: No module named 'nympy'"),
        ("class MySkin", "class Skin", "fails to import: AttributeError: "),
        ("class MySkin(ClassicSkin)", "class MySkin", "is no dataclass of tactiled.bus.codec.Skin"),
        ("size, taxels,", "taxels, size,", "ValueError: "),
        ("rows = self", "counts = counts // 2; rows = self", "taxel 1 was encoded as 1 and decoded as 0"),
        ("astype(np.uint16)", "astype(np.int32)", r"unpack gave int32 \(8,\), not uint16 or float32 \(8,\)"),
        ("enumerate(rows)", "enumerate(rows[:1])", "do not carry every taxel once"),
        ("first + at, row", "at, row", "a message with id 0x0, which the codec does not list"),
        (", full_scale = 8, 4, 255", " = 8, 4", "NotImplementedError: full_scale"),
        ("size, taxels,", "modulus = 4; size, taxels,", "decode gave no sequence number of message 0x120"),
        ("message.id - self", "1 + message.id - self", "decode gave segment 2 of message 0x121: expected 0 to 1"),
        ("row.tobytes()", "row.tobytes() + bytes([sequence])[:0]", "ValueError: bytes must be in range"),
        (
            "    def decode",
            "    def span(self, segment): return slice(4 - 4 * segment, 8 - 4 * segment)\n\n    def decode",
            r"without segment 0 taxel 1 is 0 and not 1: span\(0\) must give the taxels of this segment",
        ),
    ],
)  # fmt: skip
def test_a_faulty_package_is_refused_by_its_name(install, old, new, reason):
    assert CODE.count(old) == 1
    install(CODE.replace(old, new))
    with pytest.raises(ConfigError, match=f"{PACKAGE}.*{reason}"):
        make_codec(sensor())


def test_a_skin_whose_shear_does_not_come_back_is_refused(monkeypatch):
    decoded = xela.Xela.shear
    monkeypatch.setattr(xela.Xela, "shear", lambda *args: decoded(*args) + 5)
    with pytest.raises(ConfigError, match="shear of taxel 0 along x was encoded as -1 and decoded as"):
        make_codec(sensor('name = "xela"'))


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("sorted(traffic)", "sorted_(traffic)", "NameError: name 'sorted_' is not"),
        ("for id_,", "yield 3\n        for id_,", "TypeError: 3 is no Match"),
    ],
)
def test_a_recogniser_that_fails_is_named_and_others_go_on(install, caplog, old, new, error):
    assert CODE.count(old) == 1
    install(CODE.replace(old, new))
    codec = make_codec(sensor('name = "barrett", node = 3'))
    frames = [codec.encode(np.zeros(codec.size, np.uint16), n, n / 10) for n in range(9)]
    assert [each.name for each in survey(chain(*frames)).senders] == ["barrett"]
    assert f"'my-skin' of my_skin 1.2: recognise fails: {error}" in caplog.text


def test_a_broken_package_is_imported_only_if_it_is_named(install, caplog):
    install("raise SystemError('broken')", "broken", "broken_skin")
    install()
    assert make_codec(sensor()).size == 8
    assert make_codec(sensor('name = "poweron"')).size == 36
    with pytest.raises(ConfigError, match=r"'broken' of broken_skin 1.2: fails to import: SystemError: broken"):
        sensor('name = "broken"')
    assert survey([]).senders == ()
    assert "'broken' of broken_skin 1.2: fails to import" in caplog.text


@pytest.mark.parametrize(
    ("installed", "name", "reason"),
    [
        ((("barrett", "my_skin"),), "barrett", "'barrett': built in, and my_skin 1.2 offers"),
        ((("my-skin", "a"), ("my-skin", "b")), "my-skin", r"'my-skin': offered by (a|b) 1.2 and (a|b) 1.2"),
        (
            (("my-skin", "a"),),
            "my-skim",
            "unknown codec 'my-skim'; available: .*xela, my-skin: did you mean my-skin",
        ),
    ],
)
def test_an_unknown_or_ambiguous_name_is_refused(install, installed, name, reason):
    for offered, package in installed:
        install(name=offered, package=package)
    with pytest.raises(ConfigError, match=f"a.toml: sensor.skin.codec: {reason}"):
        sensor(f'name = "{name}"')


DECODE, UNPACK = (
    "    def decode(self, message):\n",
    "    def unpack(self, payloads):  # None: a message that did not come\n",
)


@pytest.mark.parametrize(
    ("method", "fault", "malformed"),
    [
        *(
            (DECODE, f"if message.data == b'!abc': {fault}", 1)
            for fault in (
                "raise IndexError('beyond')",
                "return Reading(0.0, 9, b'abcd')",
                "return Reading(0.0, -1, b'abcd')",
                "return Reading(0.0, 0, b'abcd', bad=(8,))",
                "return Reading(0.0, 0, b'abcd', bad=(-1,))",
                "return None",
            )
        ),
        (UNPACK, "if b'!abc' in payloads: raise IndexError('beyond')", 2),  # both messages of its frame
    ],
)
def test_a_fault_of_a_packages_codec_makes_messages_malformed(install, method, fault, malformed):
    assert CODE.count(method) == 1
    install(CODE.replace(method, f"{method}        {fault}\n"))
    router = Router({"skin": make_codec(sensor())})
    first, second = router.assemblers["skin"].codec.encode(np.arange(8, dtype=np.uint16), 0, 0.0)
    start = [first._replace(data=b"!abc"), *[second] * (malformed - 1)]
    ((_, frame),) = [each for message in (*start, first, second) for each in router.push(message)]
    assert (frame.counts.tolist(), frame.flags.any()) == (list(range(8)), False)
    assert router.assemblers["skin"].loss == Loss(malformed=malformed)


@pytest.mark.parametrize("error", ["ValueError", "ConfigError"])
@pytest.mark.parametrize("where", ["__post_init__(self)", "codec(self, array)"])
def test_a_packages_texts_are_secrets_that_it_alone_gets(install, error, where):
    fields = "    api_key: str = ''\n    url: str = ''\n    rate: int = 0\n"
    checks = "        assert 'hush-login' in self.url\n        if self.rate == 6:\n"
    refusal = (
        f"    def {where}:\n{checks}            raise {error}('wrong key ' + self.api_key)\n        return self\n"
    )
    code = CODE.replace("    size, taxels", f"{fields}\n{refusal}\n    size, taxels")
    install(code.replace("errors import CodecError", "errors import CodecError, ConfigError"))
    table = 'name = "my-skin", api_key = "hush-key", url = "https://palm:hush-login@elsewhere?x=hush", rate = '
    one = sensor(table + "5")
    assert make_codec(one).size == 8
    printed = {"name": "my-skin", "base_id": 0x120, "api_key": "hidden", "url": "hidden", "rate": 5}
    assert one.model_dump(mode="json")["codec"] == printed
    assert "hush" not in repr(one) + one.model_dump_json() + str(one.model_dump())
    with pytest.raises(ConfigError, match="wrong key hidden") as caught:
        make_codec(sensor(table + "6"))
    assert "= hidden" not in str(caught.value)  # as if it were a value of the whole table


def test_an_icub_board_knows_its_positions_and_the_sign_of_its_counts():
    one = sensor('name = "icub", board = 1, triangles = [3, 4]', "aperture_mm = 3.6")
    assert make_codec(one).size == make_array(one).size == 20
    assert (make_calibration(one).kpa_per_count, make_calibration(one).no_load) == (-1.0, 240.0)
    assert make_calibration(sensor('name = "cyskin"')).kpa_per_count == 1.0
    with pytest.raises(ConfigError, match=r"array\.rows = 2: belongs to a grid, and"):
        make_array(sensor('name = "icub", board = 1, triangles = [3, 4]'))


@pytest.mark.parametrize(
    ("codec", "array", "calibration", "reason"),
    [
        ('name = "poweron"', (6, 6), "kpa_per_count = 1.0, ", "the codec carries no shear: leave it out"),
        ('name = "xela"', (4, 6), "", "forces need kpa_per_count, too: give both"),
    ],
)
def test_a_scale_of_shear_without_shear_or_pressure_is_refused(codec, array, calibration, reason):
    text = CONFIG.format(codec=codec, array=f"rows = {array[0]}, columns = {array[1]}, pitch_mm = 4.0")
    text += f"calibration = {{ {calibration}shear_n_per_count = 0.0006 }}"
    with pytest.raises(ConfigError, match=f"sensor.skin: calibration.shear_n_per_count = 0.0006: {reason}"):
        sensor_plan("skin", parse(text).sensor["skin"])
