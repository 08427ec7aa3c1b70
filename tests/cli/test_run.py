import os
import re
import signal
import socket
import subprocess
from contextlib import contextmanager

import pytest

from tactiled.cli.app import handled
from tests.cli.commands import TACTILED, refusal, run
from tests.conftest import BUSY_S, CONFIG, ask
from tests.systemd import Manager


def configured(folder, port, interface="virtual"):
    text = CONFIG.format(channel="none").replace('"virtual"', f'"{interface}"\nfd = true')
    path = folder / "palm.toml"
    path.write_text(f'[server]\nstate = "{folder}/state.json"\nport = {port}\n{text}')
    return path


@contextmanager
def unit(folder):
    """`tactiled run` as the unit and its socket run it, and where the socket listens."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        (host, port), number = listener.getsockname(), listener.fileno()
        shell = ["bash", "-c", f'LISTEN_PID=$$ exec "$@" 3<&{number}', "-"]
        environment = os.environ | {"NOTIFY_SOCKET": f"{folder}/notify", "LISTEN_FDS": "1"}
        command = [*shell, *TACTILED, "run", configured(folder, port)]
        process = subprocess.Popen(command, env=environment, pass_fds=[number])
    try:
        yield process, f"http://{host}:{port}"
    finally:
        process.kill()
        process.wait()


def test_a_unit_is_ready_with_its_bus_and_port_and_notifies_reload_and_stop(tmp_path, capfd):
    with Manager(f"{tmp_path}/notify") as manager, unit(tmp_path) as (process, url):
        assert manager.receive("READY")["STATUS"] == f"{url}: 0 of 1 sensors live, palm silent"
        assert ask("GET", f"{url}/api/v1/health").json()["sensors"]
        process.send_signal(signal.SIGHUP)
        assert manager.receive("RELOADING")["RELOADING"] == "1"
        assert manager.receive("READY") == {"READY": "1"}
        process.send_signal(signal.SIGTERM)
        process.send_signal(signal.SIGINT)
        assert manager.receive("STOPPING")
        process.send_signal(signal.SIGINT)  # the end goes on
        assert process.wait(BUSY_S) == 0
        assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize(
    ("interface", "sockets", "line"),
    [
        ("socketcan", 1, "bus socketcan none"),
        ("virtual", 1, "tactiled.socket: listens at ('127.0.0.1', "),
        ("virtual", 2, "LISTEN_FDS = '2': tactiled.socket must hold one socket"),
    ],
)
def test_without_its_bus_or_its_own_socket_a_unit_is_never_ready(tmp_path, monkeypatch, interface, sockets, line):
    ours = {"NOTIFY_SOCKET": f"{tmp_path}/notify", "LISTEN_FDS": f"{sockets}", "LISTEN_PID": f"{os.getpid()}"}
    for name, value in ours.items():
        monkeypatch.setenv(name, value)
    with Manager(ours["NOTIFY_SOCKET"]) as manager, socket.create_server(("127.0.0.1", 0)) as listener:
        monkeypatch.setattr("tactiled.systemd.FIRST_LISTEN_FD", os.dup(listener.fileno()))
        assert line in refusal("run", configured(tmp_path, 1, interface))
        manager.setblocking(False)
        with pytest.raises(BlockingIOError):
            manager.receive()


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGHUP])
def test_a_start_that_is_stopped_while_a_cover_is_solved_is_no_failure(tmp_path, monkeypatch, kind):
    (tmp_path / "palm.toml").write_text(CONFIG.format(channel="none"))
    monkeypatch.setattr("tactiled.cli.run.prepared", lambda *_: os.kill(os.getpid(), kind))
    with handled(lambda *_: pytest.fail("not caught"), kind):
        assert run("run", tmp_path / "palm.toml").exit_code == 0


def test_a_zenoh_table_without_publish_is_said_to_have_no_effect(tmp_path, monkeypatch):
    zenoh = '[zenoh]\nconnect = ["tcp/127.0.0.1:7447"]\nrobot = "r1"\n'
    (tmp_path / "palm.toml").write_text(zenoh + CONFIG.format(channel="none"))
    monkeypatch.setattr("tactiled.cli.run.serve", lambda *_: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # an empty cache
    done = run("run", tmp_path / "palm.toml")
    assert done.exit_code == 0
    solving, solved, effect = done.stderr.splitlines()
    assert solving == "tactiled: palm: solving the cover (1 of 1)"
    assert re.fullmatch(r"tactiled: palm: cover solved in \d+\.\d s", solved)
    assert effect == "tactiled: [zenoh] has no effect without --publish"
