"""The service under attack: a real process on buses of this machine, seen from outside only."""

import contextlib
import os
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import can

HOST = "127.0.0.1"
GROUP = "239.74.163.78"
READ, CONTROL = "attack-read-token", "attack-control-token"
START_S = 120.0  # that a busy machine may take to start the service
TICK_S = 0.05  # between two looks at memory and descriptors
MB = 1 << 20

SERVER = """
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
"""
TLS = """
tls_certificate = "{folder}/certificate.pem"
tls_key = "{folder}/key.pem"
"""
BUS = """
[bus.can{bus}]
interface = "udp_multicast"
channel = "{group}"
port = {port}
hop_limit = 0

[sensor.palm{bus}]
bus = "can{bus}"
method = "wiener"
codec = {{ name = "packed", bits = 12, fd = true }}
array = {{ rows = 8, columns = 8, pitch_mm = 1.0 }}
cover = {{ thickness_mm = 0.8, young_mpa = 0.6, poisson = 0.48 }}
kernel = {{ model = "layered" }}
calibration = {{ kpa_per_count = 0.5, no_load = 100, noise_kpa = 0.5, saturation = 4000 }}
"""
BOARDS = """
[sensor.board]
bus = "can0"
method = "raw"
codec = { name = "icub", board = 13, triangles = [5], start = true }
array = { aperture_mm = 3.6 }
cover = { thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.5 }

[sensor.skin]
bus = "can0"
method = "raw"
codec = { name = "xela" }
array = { rows = 4, columns = 6, pitch_mm = 4.0 }
cover = { thickness_mm = 2.0, young_mpa = 0.3, poisson = 0.45 }
kernel = { model = "layered" }
calibration = { kpa_per_count = 0.02, no_load = 36000 }
"""


@dataclass(frozen=True)
class Kind:
    """How a service is started."""

    tls: bool = False
    descriptors: int = 0  # that the system lets it have; 0: as many as this process
    buses: int = 1


PLAIN, SECURE, FEW, BUSES = Kind(), Kind(tls=True), Kind(descriptors=256), Kind(buses=4)


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port of loopback that nobody has."""
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind((HOST, 0))
        return one.getsockname()[1]


class Target:
    """One running service, and a simulated skin on its first bus."""

    def __init__(self, kind: Kind) -> None:
        self.kind = kind
        self._folder = tempfile.TemporaryDirectory(prefix="attacked-")
        self.folder = Path(self._folder.name)
        self.port, self.xela, self.foxglove = free_port(), free_port(), free_port()
        self.buses = [free_port(socket.SOCK_DGRAM) for _ in range(kind.buses)]
        self.log = self.folder / "log"
        self.config = self.folder / "attacked.toml"
        self.config.write_text(self._configuration())
        if kind.tls:
            _certificate(self.folder)
        self.process = self._run("run", str(self.config))
        self._skin: subprocess.Popen[bytes] | None = None

    def ready(self) -> "Target":
        """Wait until it answers, and until a skin that sends is live."""
        end = time.monotonic() + START_S
        while b'"live"' not in (health := self.health()):
            if self.process.poll() is not None or time.monotonic() > end:
                raise RuntimeError(f"the service did not start: {self.log.read_text()}")
            if health and self._skin is None:
                sent = "--config", str(self.config), "--sensor", "palm0", "--rate-hz", "20"
                self._skin = self._run("simulate", *sent)
            time.sleep(0.1)
        return self

    def health(self) -> bytes:
        """What it answers; nothing where it does not."""
        line = f"GET /api/v1/health HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {CONTROL}\r\n"
        found = b""
        with contextlib.suppress(OSError), self.plug(5.0) as end:
            end.sendall(f"{line}Connection: close\r\n\r\n".encode())
            while piece := end.recv(1 << 16):
                found += piece
        return found

    def plug(self, timeout: float = 30.0) -> socket.socket:
        """A connection, with TLS where the service has it."""
        end = socket.create_connection((HOST, self.port), timeout=timeout)
        return trusting().wrap_socket(end) if self.kind.tls else end

    def bus(self, number: int = 0) -> can.BusABC:
        """The other end of one of its buses."""
        port = self.buses[number]
        return can.Bus(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0, fd=True)

    def rss_mb(self) -> float:
        """Resident memory."""
        pages = Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE") / MB

    def descriptors(self) -> int:
        """Open files and sockets."""
        return sum(1 for _ in Path(f"/proc/{self.process.pid}/fd").iterdir())

    def close(self) -> None:
        """Leave nothing behind."""
        for process in filter(None, (self._skin, self.process)):
            process.kill()
            process.wait()
        self._folder.cleanup()

    def _configuration(self) -> str:
        text = SERVER + (TLS if self.kind.tls else "")
        ports = {"port": self.port, "xela": self.xela, "foxglove": self.foxglove}
        text = text.format(folder=self.folder, read=READ, control=CONTROL, **ports)
        text += "".join(BUS.format(bus=at, group=GROUP, port=port) for at, port in enumerate(self.buses))
        return text + BOARDS

    def _run(self, *command: str) -> "subprocess.Popen[bytes]":
        limit = f"ulimit -n {self.kind.descriptors}; " if self.kind.descriptors else ""
        shell = ["sh", "-c", f'{limit}exec "$@"', "sh", sys.executable, "-m", "tactiled", *command]
        settings = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
        with self.log.open("ab") as log:
            return subprocess.Popen(shell, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=settings)


class Watch:
    """Looks at the memory and the descriptors of a service all the time."""

    def __init__(self, target: Target) -> None:
        self._target, self._done = target, threading.Event()
        self.rss_mb, self.descriptors = target.rss_mb(), target.descriptors()  # the highest so far
        self._thread = threading.Thread(target=self._go, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Look no longer."""
        self._done.set()
        self._thread.join()

    def _go(self) -> None:
        with contextlib.suppress(OSError, IndexError):  # it has ended
            while not self._done.wait(TICK_S):
                self.rss_mb = max(self.rss_mb, self._target.rss_mb())
                self.descriptors = max(self.descriptors, self._target.descriptors())


class Pool:
    """Services that attacks share while they hold: one of each kind, a new one after an attack that did harm."""

    def __init__(self) -> None:
        self._running: dict[Kind, Target] = {}

    def prepare(self, *kinds: Kind) -> None:
        """Start some at once, without waiting for them."""
        for kind in kinds:
            if kind not in self._running:
                self._running[kind] = Target(kind)

    def take(self, kind: Kind) -> Target:
        """One that is ready."""
        self.prepare(kind)
        return self._running[kind].ready()

    def drop(self, kind: Kind) -> None:
        """End one."""
        if kind in self._running:
            self._running.pop(kind).close()

    def close(self) -> None:
        """End all."""
        for kind in tuple(self._running):
            self.drop(kind)


def trusting() -> ssl.SSLContext:
    """A client's TLS that takes the certificate as it is."""
    made = ssl.create_default_context()
    made.check_hostname, made.verify_mode = False, ssl.CERT_NONE
    return made


def _certificate(folder: Path) -> None:
    command = "openssl req -x509 -newkey rsa:2048 -nodes -subj /CN=localhost -out certificate.pem -keyout key.pem"
    subprocess.run(command.split(), cwd=folder, check=True, capture_output=True)
