import os
import subprocess
import sys

import pytest

from tactiled import systemd
from tests.systemd import Manager, activated

ASK = "from tactiled import systemd; it = systemd.listen_socket(); print(it.getsockname(), it.get_inheritable())"


@pytest.mark.parametrize("abstract", [False, True])
def test_states_reach_the_manager_one_a_line(tmp_path, monkeypatch, abstract):
    with Manager(tmp_path, abstract) as manager:
        monkeypatch.setenv("NOTIFY_SOCKET", manager.address)
        assert systemd.supervises()
        systemd.notify(READY="1", STATUS="two\nlines")
        assert manager.receive() == {"READY": "1", "STATUS": "two lines"}
        with systemd.reloading():
            states = manager.receive()
            assert states.pop("RELOADING") == "1"
            assert int(states.pop("MONOTONIC_USEC")) > 0
        assert manager.receive() == {"READY": "1"}


def test_without_a_manager_nothing_is_sent(monkeypatch, tmp_path):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not systemd.supervises()
    systemd.notify(READY="1")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))  # a manager that has ended
    systemd.notify(READY="1")
    monkeypatch.setenv("LISTEN_PID", str(os.getpid() + 1))  # the socket is another process's
    assert systemd.listen_socket() is None


def test_the_socket_of_the_unit_is_one_and_children_do_not_inherit_it():
    with activated(sys.executable, "-c", ASK) as (command, listener):

        def run(sockets):
            environment = os.environ | {"LISTEN_FDS": sockets}
            number = listener.fileno()
            return subprocess.run(command, env=environment, pass_fds=[number], capture_output=True, text=True)

        assert run("1").stdout.strip() == f"{listener.getsockname()} False"
        assert "LISTEN_FDS = '2': tactiled.socket must hold one socket" in run("2").stderr
