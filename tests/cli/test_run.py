import os
import signal
import socket
import subprocess
from contextlib import contextmanager

import pytest

from tactiled.cli.app import handled
from tests.cli.commands import TACTILED, run
from tests.conftest import BUSY_S, CONFIG, ask
from tests.systemd import Manager


@contextmanager
def unit(folder, interface="virtual", port=None, sockets=1):
    """`tactiled run` as the unit and its socket run it, and where the socket listens."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        (host, own), number = listener.getsockname(), listener.fileno()
        text = CONFIG.format(channel="none").replace('"virtual"', f'"{interface}"\nfd = true')
        (folder / "palm.toml").write_text(f'[server]\nstate = "{folder}/state.json"\nport = {port or own}\n{text}')
        shell = ["bash", "-c", f'LISTEN_PID=$$ exec "$@" 3<&{number}', "-"]
        environment = os.environ | {"NOTIFY_SOCKET": f"{folder}/notify", "LISTEN_FDS": f"{sockets}"}
        streams = {"pass_fds": [number], "stderr": subprocess.PIPE, "text": True}
        process = subprocess.Popen([*shell, *TACTILED, "run", folder / "palm.toml"], env=environment, **streams)
    try:
        yield process, f"http://{host}:{own}"
    finally:
        process.kill()
        process.communicate()


def test_a_unit_is_ready_with_its_bus_and_port_and_notifies_reload_and_stop(tmp_path):
    with Manager(f"{tmp_path}/notify") as manager, unit(tmp_path) as (process, url):
        assert manager.receive("READY")["STATUS"] == f"{url}: 0 of 1 sensors live, palm silent"
        assert ask("GET", f"{url}/api/v1/health").json()["sensors"]
        process.send_signal(signal.SIGHUP)
        assert manager.receive("RELOADING")["RELOADING"] == "1"
        assert manager.receive("READY") == {"READY": "1"}
        process.send_signal(signal.SIGTERM)
        assert manager.receive("STOPPING")
        assert process.wait(BUSY_S) == 0


FAULTS = {
    "bus socketcan none": {"interface": "socketcan"},
    "tactiled.socket: listens at ('127.0.0.1', ": {"port": 1},
    "LISTEN_FDS = '2': tactiled.socket must hold one socket": {"sockets": 2},
}


@pytest.mark.parametrize("line", FAULTS)
def test_without_its_bus_or_its_own_socket_a_unit_is_never_ready(tmp_path, line):
    with Manager(f"{tmp_path}/notify") as manager, unit(tmp_path, **FAULTS[line]) as (process, _):
        assert line in process.communicate(timeout=BUSY_S)[1]
        manager.setblocking(False)
        with pytest.raises(BlockingIOError):
            manager.receive()
        assert process.returncode == 2


def test_a_start_that_is_stopped_while_a_cover_is_solved_is_no_failure(tmp_path, monkeypatch):
    (tmp_path / "palm.toml").write_text(CONFIG.format(channel="none"))
    monkeypatch.setattr("tactiled.cli.run.prepared", lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    with handled(lambda *_: pytest.fail("not caught"), signal.SIGTERM):
        assert run("run", tmp_path / "palm.toml").exit_code == 0


def test_a_zenoh_table_without_publish_is_said_to_have_no_effect(tmp_path, monkeypatch):
    zenoh = '[zenoh]\nconnect = ["tcp/127.0.0.1:7447"]\nrobot = "r1"\n'
    (tmp_path / "palm.toml").write_text(zenoh + CONFIG.format(channel="none"))
    monkeypatch.setattr("tactiled.cli.run.serve", lambda *_: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # an empty cache
    done = run("run", tmp_path / "palm.toml")
    assert done.exit_code == 0
    assert done.stderr.splitlines() == [
        "tactiled: palm: solving the cover (1 of 1)",
        "tactiled: [zenoh] has no effect without --publish",
    ]
