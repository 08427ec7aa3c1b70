import socket

import pytest
from pydantic import SecretStr

from tactiled.config import Server
from tactiled.errors import TactileError
from tactiled.web.server import running


def test_a_port_in_use_is_told_in_one_line(rig):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(TactileError, match=f"address 127.0.0.1:{port}: in use: choose another port"):
            running(rig.service, Server(port=port)).__enter__()


@pytest.mark.parametrize("host", ["nowhere.invalid", "203.0.113.7", "a" * 64])
def test_a_host_that_is_not_this_machine_is_told_in_one_line(rig, host):
    with pytest.raises(TactileError, match=host) as caught:
        running(rig.service, Server(host=host, control_token=SecretStr("a" * 16))).__enter__()
    assert "\n" not in str(caught.value)
