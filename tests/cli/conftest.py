import threading

import numpy as np
import pytest

from tactiled.bus.reader import open_bus
from tactiled.frames import Message
from tactiled.live.state_file import StateFile
from tests.cli.recordings import CONFIG, traffic, write


@pytest.fixture
def lossy(tmp_path):
    """A recording of which three messages are missing."""
    return write(tmp_path / "a.log", traffic(missing={(7, 0), (20, 1), (40, 1)}))


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text('[server]\ncontrol_token = "0123456789abcdef"  # secret\n' + CONFIG)
    return path


@pytest.fixture
def keep_regions(config, tmp_path):
    """Keeps regions of the palm in the state that the configuration names from now on."""
    state = tmp_path / "state.json"
    config.write_text(config.read_text().replace("[server]\n", f'[server]\nstate = "{state}"\n'))
    return lambda **regions: StateFile(state).keep_regions("palm", regions)


@pytest.fixture
def playing():
    """Puts codecs' frames on a bus at 50 Hz until the test ends."""
    stop, threads = threading.Event(), []

    def play(settings, *codecs):
        def go():
            bus = open_bus(**settings)
            sequence = 0
            while not stop.wait(0.02):
                for codec in codecs:
                    for each in codec.encode(np.full(codec.size, 60, np.uint16), sequence, 0.0):
                        bus.send(each)
                bus.send(Message(0.0, 0x6A1, b"\x01"))
                sequence += 1
            bus.close()

        threads.append(threading.Thread(target=go))
        threads[-1].start()

    yield play
    stop.set()
    for each in threads:
        each.join()
