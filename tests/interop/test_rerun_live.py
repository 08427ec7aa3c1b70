import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager, suppress
from threading import Event

import pytest
import rerun_cli
from rerun.chunk import RrdReader

from tactiled.errors import ConfigError
from tactiled.interop.rerun import Rerun
from tests.conftest import BUSY_S, pressed, until
from tests.process import free_port

pytestmark = pytest.mark.filterwarnings("ignore:RRD file has no footer")  # it is not complete
VIEWER = f"{rerun_cli.__path__[0]}/rerun"


@pytest.fixture
def port():
    return free_port()


@contextmanager
def viewer(port, file):
    """Rerun's program without a window, which keeps what it gets in a file."""
    command = [VIEWER, "--save", file, "--bind", "127.0.0.1", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


def listens(port):
    with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
        return True
    return False


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

    with Rerun(port).running(rig.host):
        for name in ("first.rrd", "second.rrd"):  # the first is killed, and nobody is told
            with viewer(port, tmp_path / name):
                until(lambda file=tmp_path / name: arrived(file))
    assert not rig.service.faults.now


def test_the_service_ends_though_a_viewer_hangs(rig, port, monkeypatch):
    called, ended = Event(), Event()
    monkeypatch.setattr("tactiled.interop.rerun._show", lambda *_: called.set() or ended.wait())
    with socket.create_server(("127.0.0.1", port)), Rerun(port).running(rig.host):
        assert called.wait(BUSY_S)
    ended.set()


WITH_HANGING_VIEWER = """
import sys, threading, numpy, rerun
from tactiled.messages.rerun import new_stream
stream = new_stream()
stream.connect_grpc(sys.argv[1])
stream.flush()
print("connected", flush=True)
input()  # the viewer hangs
def log():
    while True:
        stream.log("a", rerun.DepthImage(numpy.random.rand(256, 256)))
threading.Thread(target=log, daemon=True).start()
try:
    while True:
        stream.flush(timeout_sec=3.0)  # fails once the buffers on the way are full
except RuntimeError:
    pass
"""


def test_a_process_ends_though_its_viewer_hangs(port, tmp_path):
    with viewer(port, tmp_path / "a.rrd") as process:
        until(lambda: listens(port))
        command = [sys.executable, "-c", WITH_HANGING_VIEWER, f"rerun+http://127.0.0.1:{port}/proxy"]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout.readline() == "connected\n"
            process.send_signal(signal.SIGSTOP)
            try:
                program.communicate("\n", timeout=BUSY_S)
            finally:
                program.kill()
            assert program.returncode == 0


def test_a_missing_sdk_is_one_line(rig, monkeypatch):
    monkeypatch.setattr("tactiled.interop.rerun.find_spec", lambda _: None)
    with pytest.raises(ConfigError, match=re.escape("--rerun needs Rerun's SDK: pip install 'tactiled[rerun]'")):
        Rerun(9876).running(rig.host).__enter__()
