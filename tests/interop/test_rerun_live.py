import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest
import rerun_cli
from rerun.chunk import RrdReader

from tactiled.errors import ConfigError
from tactiled.interop.rerun_live import to_viewer
from tests.conftest import pressed, until

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")  # it is not complete
VIEWER = f"{rerun_cli.__path__[0]}/rerun"


@pytest.fixture
def port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@contextmanager
def viewer(port, file):
    """Rerun's program without a window, which keeps what it gets in a file."""
    command = [VIEWER, "--save", file, "--bind", "127.0.0.1", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


def entities(file):
    """Entities that have arrived so far; the file may end in the midst of one."""
    try:
        return {chunk.entity_path for chunk in RrdReader(file).stream()} if file.exists() else set()
    except (RuntimeError, ValueError):
        return set()


def test_a_viewer_gets_images_whenever_it_comes(rig, port, tmp_path):
    def arrived(file):
        rig.show(pressed())
        return entities(file) >= {f"/palm/{name}" for name in ("raw", "restored", "force", "peak", "contacts")}

    with to_viewer(rig.service, port):
        for name in ("first.rrd", "second.rrd"):  # the first is killed, and nobody is told
            with viewer(port, tmp_path / name):
                until(lambda file=tmp_path / name: arrived(file))
    assert not rig.service.faults.now


def test_a_viewer_that_hangs_delays_no_end(rig, port, tmp_path):
    with viewer(port, tmp_path / "a.rrd") as process, to_viewer(rig.service, port):
        rig.show(pressed())
        until(lambda: entities(tmp_path / "a.rrd"))
        process.send_signal(signal.SIGSTOP)
        for _ in range(20):
            rig.show(pressed())


def test_a_missing_sdk_is_one_line(rig, monkeypatch):
    monkeypatch.setattr("tactiled.interop.rerun_live.find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=re.escape("--rerun needs Rerun's SDK: pip install 'tactiled[rerun]'")):
        to_viewer(rig.service, 9876).__enter__()


def test_run_does_not_import_the_sdk_unless_it_is_used():
    program = (
        "import sys, tactiled.cli.run, tactiled.archive.writers; print({*sys.modules} & {'rerun', 'rosbags'})"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "set()\n"
