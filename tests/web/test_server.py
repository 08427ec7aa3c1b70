import socket

import pytest

from tactiled.errors import TactileError
from tactiled.web.server import running


def test_a_port_in_use_is_told_in_one_line(rig):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(TactileError, match=f"address 127.0.0.1:{port}: in use: choose another port"):
            running(rig.service, port=port).__enter__()


@pytest.mark.parametrize("host", ["nowhere.invalid", "203.0.113.7"])
def test_a_host_that_is_not_this_machine_is_told_in_one_line(rig, host):
    with pytest.raises(TactileError, match=host) as caught:
        running(rig.service, host=host).__enter__()
    assert "\n" not in str(caught.value)
