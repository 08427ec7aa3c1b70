import re
import socket

import pytest

from tactiled import logs
from tactiled.config import Server
from tactiled.errors import TactileError
from tactiled.web.app import create
from tactiled.web.server import serve
from tests.conftest import BRIDGES, running


def test_an_address_that_cannot_be_bound_is_refused_in_one_line(rig):
    def error(**address):
        with pytest.raises(TactileError) as caught:
            running(rig.service, Server(control_token="a" * 16, **address)).__enter__()
        return str(caught.value)

    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert error(port=port).startswith(f"address 127.0.0.1:{port}: in use: choose another port")
        with pytest.raises(TactileError, match=f"address 127.0.0.1:{port}: in use"):
            serve(create(rig.service, config := Server(port=0, xela=port), BRIDGES), config)
    for host in ("nowhere.invalid", "203.0.113.7", "a" * 64):
        assert host in error(host=host)
        assert "\n" not in error(host=host)


def test_a_client_that_comes_as_soon_as_the_address_is_announced_is_not_refused(rig, monkeypatch):
    def connect(text):
        socket.create_connection(("127.0.0.1", int(re.search(r":(\d+)/", text)[1]))).close()
        raise KeyboardInterrupt

    monkeypatch.setattr(logs, "announce", connect)
    with pytest.raises(KeyboardInterrupt):
        serve(create(rig.service, Server(port=0)), Server(port=0))
