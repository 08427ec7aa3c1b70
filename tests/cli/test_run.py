import os
import signal
import subprocess

import httpx
import pytest

from tests.cli.commands import TACTILED
from tests.conftest import BUSY_S, CONFIG, HTTP
from tests.systemd import Manager, activated


def start(tmp_path, manager, interface="virtual", port=None):
    """`tactiled run` as a unit behind a socket runs it."""
    config = tmp_path / "palm.toml"
    with activated(*TACTILED, "run", config) as (command, listener):
        number, address = listener.fileno(), listener.getsockname()
        text = CONFIG.format(channel="none").replace('"virtual"', f'"{interface}"\nfd = true')
        config.write_text(f'[server]\nstate = "state.json"\nport = {port or address[1]}\n{text}')
        environment = os.environ | {"NOTIFY_SOCKET": manager.address, "LISTEN_FDS": "1"}
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return subprocess.Popen(command, env=environment, pass_fds=[number], **streams), address


def test_a_unit_is_ready_with_its_bus_and_port_and_notifies_reload_and_stop(tmp_path):
    with Manager(tmp_path) as manager:
        process, (host, port) = start(tmp_path, manager)
        with process:
            url = f"http://{host}:{port}"
            assert manager.receive_until("READY") == {
                "STATUS": f"{url}: 0 of 1 sensors live, palm silent", "READY": "1", "WATCHDOG": "1",
            }  # fmt: skip
            assert httpx.get(f"{url}/api/v1/health", **HTTP).json()["sensors"]
            process.send_signal(signal.SIGHUP)
            assert manager.receive_until("RELOADING")["RELOADING"] == "1"
            assert manager.receive_until("READY") == {"READY": "1"}
            assert manager.receive_until("WATCHDOG")
            process.send_signal(signal.SIGTERM)
            assert manager.receive_until("STOPPING")["STOPPING"] == "1"
            assert process.wait(BUSY_S) == 0


@pytest.mark.parametrize(
    ("faults", "line"),
    [
        ({"interface": "socketcan"}, "bus socketcan none"),
        ({"port": 1}, "tactiled.socket: listens at ('127.0.0.1', "),
    ],
)
def test_without_its_bus_or_its_own_address_a_unit_is_never_ready(tmp_path, faults, line):
    with Manager(tmp_path) as manager:
        process, _ = start(tmp_path, manager, **faults)
        output, _ = process.communicate(timeout=BUSY_S)
        assert (process.returncode, line in output) == (2, True), output
        assert manager.pending() == []
