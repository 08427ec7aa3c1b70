"""The service under attack: a real process on buses of this machine, seen from outside only."""

import os
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

from tests.attack.wire import HOST
from tests.process import free_port, self_signed

GROUP = "239.74.163.78"
READ, CONTROL = "attack-read-token", "attack-control-token"
START_S = 120.0  # that a busy machine may take to start the service

CONFIG = """
[server]
host = "127.0.0.1"
port = {port}
read_token = "{read}"
control_token = "{control}"
xela = {xela}
foxglove = {foxglove}
recordings = "{folder}/recordings"
recordings_leave_mb = 0
state = "{folder}/state.json"
control_per_minute = 0
{tls}
[bus.can0]
interface = "udp_multicast"
channel = "{group}"
port = {bus}
hop_limit = 0

[sensor.palm0]
bus = "can0"
method = "wiener"
codec = {{ name = "packed", bits = 12, fd = true }}
array = {{ rows = 8, columns = 8, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5, saturation = 4000 }}

[sensor.board]
bus = "can0"
method = "raw"
codec = {{ name = "icub", board = 13, triangles = [5], start = true }}
array = {{ aperture_mm = 3.6 }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5 }}

[sensor.skin]
bus = "can0"
method = "raw"
codec = {{ name = "xela" }}
array = {{ rows = 4, columns = 6, pitch_mm = 4.0 }}
cover = {{ thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.02, no_load = 36000 }}
"""
TLS_FILES = """
tls_certificate = "{folder}/certificate.pem"
tls_key = "{folder}/key.pem"
"""


@dataclass(frozen=True)
class Kind:
    """How a service is started."""

    tls: bool = False
    descriptors: int = 0  # that the system lets it have; 0: as many as this process


HTTP, TLS, DESCRIPTORS_256 = Kind(), Kind(tls=True), Kind(descriptors=256)


class Target:
    """One running service, and a simulated skin on its first bus."""

    def __init__(self, kind):
        self.kind, self.tls = kind, trusting() if kind.tls else None
        self._folder = tempfile.TemporaryDirectory(prefix="attacked-")
        self.folder = Path(self._folder.name)
        self.port, self.xela, self.foxglove = free_port(), free_port(), free_port()
        self.bus_port = free_port(socket.SOCK_DGRAM)
        self.log = self.folder / "log"
        self.config = self.folder / "attacked.toml"
        tls = TLS_FILES.format(folder=self.folder) if kind.tls else ""
        ports = {"port": self.port, "xela": self.xela, "foxglove": self.foxglove, "bus": self.bus_port}
        self.config.write_text(
            CONFIG.format(folder=self.folder, tls=tls, group=GROUP, read=READ, control=CONTROL, **ports)
        )
        if kind.tls:
            self_signed(self.folder)
        self.process = self._run("run", str(self.config))
        self._skin: subprocess.Popen[bytes] | None = None

    def ready(self):
        """Wait until it answers, and until a skin that sends is live."""
        end = time.monotonic() + START_S
        while b'"live"' not in (health := self.get("/api/v1/health")):
            if self.process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"the service did not start: {self.log.read_text()}")
            if health and self._skin is None:
                options = "--config", str(self.config), "--sensor", "palm0", "--rate-hz", "20"
                self._skin = self._run("simulate", *options)
            time.sleep(0.1)

    def get(self, path):
        """The body of the answer to a request; empty where there is none."""
        url = f"http{'s' if self.tls else ''}://{HOST}:{self.port}{path}"
        try:
            headers = {"Authorization": f"Bearer {CONTROL}"}
            return httpx.get(url, headers=headers, verify=self.tls or True, timeout=5.0).content
        except httpx.HTTPError:
            return b""

    def rss_mb(self, field="VmRSS"):
        """Resident memory; VmHWM: its peak."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.partition(f"{field}:")[2].split()[0]) >> 10

    def descriptors(self):
        """Open files and sockets."""
        return sum(1 for _ in Path(f"/proc/{self.process.pid}/fd").iterdir())

    def children_s(self):
        """Processor time (s) of the processes that it started, of ended ones, too."""
        own = _times_s(self.process.pid)[2:]
        return sum(own, sum(sum(_times_s(pid)) for pid in _descendants(self.process.pid)))

    def close(self):
        """Leave nothing behind."""
        for process in filter(None, (self._skin, self.process)):
            process.kill()
            process.wait()
        self._folder.cleanup()

    def _run(self, *command):
        limit = f"ulimit -n {self.kind.descriptors}; " if self.kind.descriptors else ""
        shell = ["sh", "-c", f'{limit}exec "$@"', "sh", sys.executable, "-m", "tactiled", *command]
        settings = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        with self.log.open("ab") as log:
            return subprocess.Popen(shell, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=settings)


def _descendants(pid):
    """The processes that a process, or one of them, has started, and that have not ended."""
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            for child in file.read_text().split():
                yield child
                yield from _descendants(child)


def _times_s(pid):
    """User and system time (s) of a process, and of its ended children; nothing if it has ended."""
    with suppress(OSError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return [int(each) / os.sysconf("SC_CLK_TCK") for each in fields[11:15]]
    return []


class Pool(dict[Kind, Target]):
    """Services that attacks share: one of each kind, started when it is first asked for."""

    def __missing__(self, kind):
        return self.setdefault(kind, Target(kind))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for target in self.values():
            target.close()


def trusting():
    """A client's TLS that trusts every certificate."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context
