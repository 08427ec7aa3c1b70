"""Codecs of other packages; the one in the guide is installed and run as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

from tactiled.build import make_codec, sensor_plan
from tactiled.bus.codecs import plugins
from tactiled.bus.router import Router
from tactiled.config import parse
from tactiled.errors import CodecError, ConfigError
from tactiled.frames import Loss, Message

GUIDE = (Path(__file__).parents[2] / "tactiled/docs/codecs.md").read_text("utf-8")
SECTION = GUIDE.split("\n## A codec of your own\n")[1].split("\n## ")[0]
CODE = re.search(r"```python\n(.*?)```", SECTION, re.DOTALL)[1]
CONFIG = """
[bus.can0]
interface = "virtual"
[sensor.skin]
bus = "can0"
codec = {{ {codec} }}
array = {{ rows = 2, columns = 4, pitch_mm = 4.0 }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Put a package with an entry point on the path, as pip does."""
    monkeypatch.syspath_prepend(tmp_path)

    def put(code, name="my-skin", package="my_skin", maker="MySkin", version="1.2"):
        module = f"{package}_{tmp_path.name}".replace("-", "_")  # no test finds another's in sys.modules
        (tmp_path / f"{module}.py").write_text(code)
        about = tmp_path / f"{package}-{version}.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
        (about / "entry_points.txt").write_text(f"[tactiled.codecs]\n{name} = {module}:{maker}\n")

    return put


def sensor(codec='name = "my-skin"'):
    return parse(CONFIG.format(codec=codec), "a.toml").sensor["skin"]


def test_the_guides_example_is_short_and_its_entry_point_the_one_tested():
    assert len(CODE.strip().splitlines()) <= 25
    assert 'my-skin = "my_skin:MySkin"' in SECTION


def test_the_guides_example_works_as_it_stands_there(install):
    install(CODE)
    plan = sensor_plan("skin", sensor('name = "my-skin", base_id = 0x200'))
    assert (plan.codec_name, plan.codec.ids) == ("my-skin", {(0x200, False), (0x201, False)})
    router = Router({"skin": plan.codec})
    counts = np.array([0, 1, 2, 3, 250, 251, 252, 255], np.uint16)
    messages = plan.codec.encode(counts, 0, 1.0)
    assert [each.data.hex() for each in messages] == ["00010203", "fafbfcff"]
    ((_, frame),) = [each for message in messages for each in router.push(message)]
    np.testing.assert_array_equal(frame.counts, counts)
    router.push(messages[0]._replace(data=b"abc"))
    assert router.assemblers["skin"].loss == Loss(malformed=1)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("import numpy as np", "import nympy as np", "import: ModuleNotFoundError: No module named 'nympy'"),
        ("class MySkin", "class Skin", "fails to import: AttributeError: "),
        ("base_id=0x120", "base_id", "refuses its settings: TypeError: "),
        ("size, taxels,", "taxels, size,", "breaks the interface of a codec: "),
        ("rows = self", "counts = counts // 2; rows = self", "taxel 1 was encoded as 1 and decoded as 0"),
        ("astype(np.uint16)", "astype(np.int32)", r"unpack gave int32 \(8,\), not uint16 or float32 \(8,\)"),
        ("enumerate(rows)]", "enumerate(rows)][:1]", "do not carry every taxel once"),
        ("self.base_id + at, row", "at, row", "a message on id 0x0, which is none of its ids"),
        (", full_scale = 8, 4, 255", " = 8, 4", "NotImplementedError"),
    ],
)  # fmt: skip
def test_a_package_that_is_wrong_is_told_with_its_name(install, old, new, says):
    assert CODE.count(old) == 1
    install(CODE.replace(old, new))
    with pytest.raises(ConfigError, match=f"codec.name = 'my-skin' of my_skin 1.2: .*{says}"):
        make_codec(sensor())


@pytest.mark.parametrize("error", ["ConfigError", "ValueError"])
def test_a_setting_that_it_refuses_is_told_with_its_name(install, error):
    refusal = f"    def __init__(self, base_id=0x120):\n        raise {error}('codec.base_id = 7: odd')\n"
    install(
        re.sub(r"    def __init__.*?\n\n", refusal, CODE, flags=re.DOTALL) + "\nfrom tactiled.errors import *\n"
    )
    with pytest.raises(ConfigError, match=r"codec.name = 'my-skin' of my_skin 1.2: .*codec.base_id = 7: odd"):
        make_codec(sensor())


def test_one_that_cannot_be_imported_is_imported_only_if_it_is_named(install):
    install("raise SystemError('broken')", "broken", "broken_skin")
    install(CODE)
    assert make_codec(sensor()).size == 8
    assert make_codec(sensor('name = "barrett", node = 1')).size == 24
    with pytest.raises(ConfigError, match=r"'broken' of broken_skin 1.2: fails to import: SystemError: broken"):
        make_codec(sensor('name = "broken"'))


def test_a_built_ins_name_is_refused(install):
    install(CODE, name="barrett")
    with pytest.raises(
        ConfigError, match=r"a.toml: sensor.skin.codec.name = 'barrett': built in, and my_skin 1.2"
    ):
        sensor('name = "barrett", node = 1')
    assert make_codec(sensor('name = "poweron"')).size == 36


def test_a_name_that_two_packages_offer_is_refused(install):
    install(CODE)
    install(CODE, package="other_skin")
    with pytest.raises(ConfigError, match=r"'my-skin': offered by (my|other)_skin 1.2 and (my|other)_skin 1.2"):
        sensor()


def test_a_name_that_nobody_offers_is_refused_and_the_offers_named(install):
    install(CODE)
    with pytest.raises(
        ConfigError, match=r"unknown codec 'my-skim'; available: .*linker, dbc, my-skin: did you mean my-skin\?"
    ):
        sensor('name = "my-skim"')


@pytest.mark.parametrize(
    "body",
    [
        "raise IndexError('beyond')",
        "return Reading(0.0, 9, b'abcd')",
        "return Reading(0.0, 0, b'abcd', bad=(8,))",
        "return None",
        "raise CodecError('beyond')",
    ],
)
def test_what_decode_raises_while_running_is_malformed_and_ends_nothing(install, body):
    guard = f"        if message.data[:1] == b'!':\n            {body}\n"
    install(CODE.replace("    def decode(self, message):\n", "    def decode(self, message):\n" + guard))
    codec = make_codec(sensor())
    bad = Message(0.0, 0x120, b"!abc")
    with pytest.raises(CodecError, match="codec my-skin: "):
        codec.decode(bad)
    router = Router({"skin": codec})
    first, second = codec.encode(np.arange(8, dtype=np.uint16), 0, 0.0)
    frames = [frame for each in (first, bad, second) for _, frame in router.push(each)]
    assert frames[0].counts.tolist() == list(range(8))
    assert router.assemblers["skin"].loss == Loss(malformed=1)


def test_a_frame_that_cannot_be_unpacked_is_malformed_and_ends_nothing(install):
    guard = "        if b'!abc' in payloads:\n            raise IndexError('beyond')\n"
    install(CODE.replace("did not come\n", "did not come\n" + guard))
    codec = make_codec(sensor())
    router = Router({"skin": codec})
    first, second = codec.encode(np.arange(8, dtype=np.uint16), 0, 0.0)
    frames = [f for each in (first._replace(data=b"!abc"), second, first, second) for _, f in router.push(each)]
    assert [frame.counts.tolist() for frame in frames] == [list(range(8))]
    assert router.assemblers["skin"].loss == Loss(malformed=2)


def test_a_name_that_vanished_since_the_file_was_read_is_named():
    with pytest.raises(ConfigError, match=r"codec.name = 'gone': no installed package offers it"):
        plugins.make("gone", {})


SECRETS = (
    'name = "my-skin", api_key = "hush-key", url = "https://palm:hush-login@elsewhere?x=hush-query", rate = 5'
)
TAKES = """
from tactiled.errors import ConfigError
CODE
class Guarded(MySkin):
    def __init__(self, api_key, url, rate):
        super().__init__()
""".replace("CODE", CODE)


def test_its_texts_are_secrets_that_it_alone_gets(install):
    install(TAKES + "        assert (api_key, rate) == ('hush-key', 5) and 'hush-login' in url\n", maker="Guarded")
    one = sensor(SECRETS)
    assert make_codec(one).size == 8
    told = {"name": "my-skin", "api_key": "hidden", "url": "hidden", "rate": 5}
    assert one.model_dump(mode="json")["codec"] == told
    assert "hush" not in repr(one) + one.model_dump_json() + str(one.model_dump())


@pytest.mark.parametrize("kind", ["ValueError", "ConfigError"])
def test_what_it_says_of_a_secret_is_replaced(install, kind):
    install(TAKES + f"        raise {kind}('wrong key ' + api_key)\n", maker="Guarded")
    with pytest.raises(ConfigError, match="wrong key hidden"):
        make_codec(sensor(SECRETS))
