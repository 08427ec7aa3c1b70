"""The viewer's scripts without a browser: their types, their logic and the messages that they decode."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from tactiled.wire import METHOD_NAMES, pack
from tests.conftest import pressed

FOLDER = Path(__file__).parent
STATIC = FOLDER.parents[1] / "tactiled/web/static"
TSC = Path(sys.prefix) / "lib/tsc/node_modules/.bin/tsc"
DECODE = f"""
import {{ METHODS, packet, parse }} from "{STATIC}/wire/wire.js";
const messages = JSON.parse(process.argv[1]).map(hex => Uint8Array.from(Buffer.from(hex, "hex")));
const fields = ({{ kind, rows, columns, sequence, timestamp, sent, noise, noiseGain, resolutionMm, microseconds,
  iterations, method, values, flags }}) => [kind, rows, columns, sequence, timestamp, sent, noise, noiseGain,
  resolutionMm, microseconds, iterations, METHODS[method], [...values], flags && [...flags]];
console.log(JSON.stringify([METHODS, ...messages.map(each => fields(parse(each, packet())))]));
"""


def test_types_agree_and_a_wrong_one_is_found(tmp_path):
    assert TSC.exists(), "no TypeScript: sh tests/run installs it"
    shutil.copytree(STATIC, tmp_path, dirs_exist_ok=True)
    settings = (FOLDER / "tsconfig.json").read_text()
    (tmp_path / "tsconfig.json").write_text(settings.replace("../../tactiled/web/static/", f"{tmp_path}/"))
    script = (tmp_path / "maps/display_range.js").read_text()
    (tmp_path / "maps/wrong.js").write_text(script.replace("this.auto = true;", 'this.auto = "yes";', 1))
    done = subprocess.run([TSC, "-p", tmp_path], capture_output=True, text=True, cwd=tmp_path)
    found = [line for line in done.stdout.splitlines() if not line.startswith(" ")]
    assert found
    assert all(line.startswith("maps/wrong.js(") for line in found), done.stdout


def test_logic():
    """The tests of `*.test.mjs`, by Node's own runner."""
    run = subprocess.run(["node", "--test", *sorted(FOLDER.glob("*.test.mjs"))], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout
    assert "# fail 0" in run.stdout or "ℹ fail 0" in run.stdout


def test_messages_are_decoded_as_the_service_packs_them(rig):
    image = rig.show(pressed())
    hexes = [pack(image, kind, 12.5, "palm").hex() for kind in ("raw", "restored")]
    run = subprocess.run(
        ["node", "--input-type=module", "-e", DECODE, json.dumps(hexes)],
        capture_output=True,
        text=True,
        check=True,
    )
    methods, raw, restored = json.loads(run.stdout)
    assert tuple(methods) == METHOD_NAMES
    numbers = [image.noise, image.noise_gain, image.resolution_mm, image.microseconds]
    for kind, fields in enumerate((raw, restored)):
        assert fields[:6] == [kind, 8, 8, image.sequence, image.time, 12.5]
        np.testing.assert_allclose(fields[6:10], numbers, rtol=1e-6)
        assert fields[10:12] == [image.iterations, image.method]
        np.testing.assert_array_equal(fields[12], (image.raw, image.restored)[kind].ravel())
    assert (raw[13], restored[13]) == (image.flags.ravel().tolist(), None)
