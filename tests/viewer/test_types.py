import shutil
import subprocess
import sys
from pathlib import Path

TSC = Path(sys.prefix) / "lib/tsc/node_modules/.bin/tsc"
STATIC = Path(__file__).parents[2] / "tactiled/web/static"


def check(folder):
    assert TSC.exists(), "no TypeScript: sh tests/run installs it"
    settings = Path(__file__).with_name("tsconfig.json").read_text()
    (folder / "tsconfig.json").write_text(settings.replace("../../tactiled/web/static/", f"{folder}/"))
    return subprocess.run([TSC, "-p", folder], capture_output=True, text=True)


def test_the_viewer_keeps_the_types_that_its_comments_tell(tmp_path):
    shutil.copytree(STATIC, tmp_path, dirs_exist_ok=True)
    checked = check(tmp_path)
    assert checked.stdout == ""
    assert checked.returncode == 0


def test_a_wrong_type_is_found(tmp_path):
    shutil.copytree(STATIC, tmp_path, dirs_exist_ok=True)
    scale = tmp_path / "display_range.js"
    scale.write_text(scale.read_text().replace("this.auto = true;", 'this.auto = "yes";', 1))
    checked = check(tmp_path)
    assert "display_range.js" in checked.stdout
    assert checked.returncode != 0
