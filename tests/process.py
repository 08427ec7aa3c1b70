"""`tactiled run` as a process of its own, seen from outside only."""

import os
import random
import re
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path


def free_port(kind=socket.SOCK_STREAM):
    """A port that nobody has, below those that the system gives to new connections."""
    while True:
        with socket.socket(socket.AF_INET, kind) as one, suppress(OSError):
            one.bind(("", random.SystemRandom().randrange(10_000, 32_000)))
            return one.getsockname()[1]


def self_signed(folder):
    """The files of a new certificate and its key."""
    files = folder / "certificate.pem", folder / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost"]
    subprocess.run([*command, "-out", files[0], "-keyout", files[1]], check=True, capture_output=True)
    return files


class Running:
    """A service that runs by a configuration file; it is there when this is made."""

    def __init__(self, config, module="tactiled", **environment):
        command = [sys.executable, "-m", module, "run", str(config)]
        settings = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"} | environment
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=settings,
        )
        self.lines = []
        self.url = re.search(r"https?://[^/]+", self.line(" served at "))[0]
        host, _, port = self.url.partition("//")[2].rpartition(":")
        while True:  # the line comes a moment before it accepts
            with suppress(ConnectionRefusedError), socket.create_connection((host, int(port))):
                break
            time.sleep(0.005)

    def line(self, text):
        """The next line of the output that holds a text."""
        while line := self.process.stdout.readline():
            self.lines.append(line)
            if text in line:
                return line
        raise RuntimeError(f"the service ended with {self.process.wait()}: {''.join(self.lines)}")

    def status(self, field):
        """A number of /proc/PID/status."""
        text = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(text.partition(f"{field}:")[2].split()[0])

    def descriptors(self):
        """Open files and sockets."""
        return sum(1 for _ in Path(f"/proc/{self.process.pid}/fd").iterdir())

    def signal(self, number):
        """Send a signal."""
        self.process.send_signal(number)

    def end(self):
        """End it by SIGTERM; gives the exit code."""
        self.process.terminate()
        self.lines += self.process.stdout.readlines()
        return self.process.wait()

    def kill(self):
        """End it by SIGKILL, if it runs."""
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
