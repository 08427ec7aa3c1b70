"""A reader in a process of its own: python -m tests.interop.zenoh_reader ENDPOINT ROBOT [its clock's offset, s].

SIGUSR1 stops its skin, and lets it go on.
"""

import signal
import sys
import time

endpoint, robot, offset_s = (*sys.argv[1:], "0")[:3]
true_time = time.time
time.time = lambda: true_time() + float(offset_s)

from tactiled.cli.app import stoppable  # noqa: E402
from tactiled.interop.zenoh.reader import publish  # noqa: E402
from tests.conftest import Rig, pressed  # noqa: E402

TABLE = '\n[zenoh]\nmode = "client"\nconnect = ["{}"]\nrobot = "{}"\n'


class Skin:
    """Frames at 50 Hz, unless it is stopped."""

    sends = True

    def toggle(self, *_):
        self.sends = not self.sends

    def play(self, rig):
        while True:
            if self.sends:
                rig.send(pressed(rig.sequence % 6))
            time.sleep(0.02)


if __name__ == "__main__":
    from threading import Thread

    skin, rig = Skin(), Rig("reader", TABLE.format(endpoint, robot))
    signal.signal(signal.SIGUSR1, skin.toggle)
    with stoppable(), rig.service.running():
        Thread(target=skin.play, args=(rig,), daemon=True).start()
        publish(rig.service, rig.config.server, rig.config.zenoh)
