"""These tests need vcan0 (classic) and vcan1 (CAN FD), up: this machine's own, or those of `kernel.py`."""

import contextlib
import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tactiled.bus.reader import open_bus
from tests.conftest import turn

HAS_VCAN = all(Path("/sys/class/net", name).exists() for name in ("vcan0", "vcan1"))
OWN_KERNEL = "User Mode Linux" in Path("/proc/cpuinfo").read_text()
FOLDER = Path(__file__).parent
COMMAND = f"{sys.executable} {FOLDER / 'kernel.py'} {sys.executable} -m pytest {FOLDER}"
COUNT = pytest.StashKey[int]()


def pytest_collection_modifyitems(config, items):
    mine = [item for item in items if FOLDER in item.path.parents]
    for item in mine:
        item.add_marker(pytest.mark.timeout(900))
        if not HAS_VCAN:
            item.add_marker(pytest.mark.skip(reason="this kernel has no vcan0 and vcan1"))
    config.stash[COUNT] = len(mine)


def pytest_terminal_summary(terminalreporter, config):
    if count := config.stash.get(COUNT, 0):
        where = f"ran on {'a kernel of their own' if OWN_KERNEL else 'this machine'}, Linux {platform.release()}"
        if not HAS_VCAN:
            where = f"DID NOT RUN: this kernel has no vcan0 and vcan1: {COMMAND}"
        terminalreporter.write_line(f"vcan: {count} tests {where}")


def ip(*arguments):
    sudo = [] if os.geteuid() == 0 else ["sudo"]
    subprocess.run([*sudo, "ip", "link", *arguments], check=True)


@pytest.fixture(autouse=True)
def alone():
    """There is one vcan0 and one vcan1, for all workers."""
    with turn("vcan"):
        yield


@pytest.fixture
def bus():
    """Opens buses, classic on vcan0 and CAN FD on vcan1, and closes them."""
    with contextlib.ExitStack() as stack:

        def opened(fd=False):
            one = open_bus(interface="socketcan", channel="vcan1" if fd else "vcan0", fd=fd)
            stack.callback(one.close)
            return one

        yield opened


@pytest.fixture
def run():
    """Starts processes, and ends them."""
    with contextlib.ExitStack() as stack:

        def started(*command, stdout=subprocess.PIPE):
            words = [str(part) for part in command]
            process = subprocess.Popen(words, stdout=stdout, stderr=subprocess.STDOUT, text=True)
            stack.callback(ended, process)
            return process

        yield started


def ended(process):
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        process.communicate(timeout=20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()


@pytest.fixture
def link():
    """Sets a link down or up; it is up again afterwards."""
    yield lambda name, state: ip("set", name, state)
    for name in ("vcan0", "vcan1"):
        ip("set", name, "up")


@pytest.fixture
def until():
    def wait(true, seconds=240.0):
        end = time.monotonic() + seconds
        while not (value := true()):
            assert time.monotonic() < end, "it did not happen in time"
            time.sleep(0.2)  # asking is work, too, for the one processor of the kernel
        return value

    return wait
