"""Run a command, on this machine's own files, in a kernel of its own that has CAN.

    python kernel.py COMMAND [ARGUMENT...]

The command finds `vcan0` (classic), `vcan1` (CAN FD) and `lo` up and no other network; it runs as root, in the
current directory, with the current environment but TMPDIR, which is in memory there. Its output is printed as it
comes and its exit status returned; 124: it took longer than VCAN_TIMEOUT (s, 1800 by default); 125: the kernel did
not start.

The kernel is Debian's package user-mode-linux: Linux as an ordinary process, which needs no privilege.
"""

import ctypes
import json
import os
import platform
import random
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MODULES = (
    "net/can/can",
    "net/can/can-raw",
    "net/can/can-gw",
    "drivers/net/can/dev/can-dev",
    "drivers/net/can/vcan",
)
LINKS = """\
link set lo up
link add vcan0 type vcan
link set vcan0 mtu 16 up
link add vcan1 type vcan
link set vcan1 mtu 72 up
"""
MOUNTS = (
    ("proc", "/proc", "rw"),
    ("sysfs", "/sys", "rw"),
    ("tmpfs", "/run", "mode=755"),
    ("tmpfs", "/dev/shm", "mode=1777"),
    ("devpts", "/dev/pts", "ptmxmode=666"),
)
BOOT = ("rootfstype=hostfs", "rw", "quiet", "con=null", "ssl=null", "con0=null,fd:1", "pty.legacy_count=0")
BOOT += ("initcall_blacklist=raid6_select_algo",)  # 0.5 s of benchmarks
FINIT_MODULE = {"x86_64": 313}  # system call
POWER_OFF = 0x4321FEDC
SOCKET_BYTES = 4 << 20  # that a socket may hold, so that a burst is not lost to the buffer's default
MEMORY_BYTES = 2 << 30
ATTEMPTS = 3
TICK_S = 0.05
TIMED_OUT, NOT_STARTED = 124, 125


def main(command: list[str]) -> int:
    """Boot, run, print, return the command's exit status."""
    if not command:
        sys.exit(__doc__)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: sys.exit(128 + number))  # ends the kernel, too
    with tempfile.TemporaryDirectory(prefix="vcan-", dir="/tmp") as folder:
        home = Path(folder)
        job = {"command": command, "folder": str(Path.cwd()), "environment": dict(os.environ)}
        (home / "job.json").write_text(json.dumps(job))
        (home / "init").write_text(
            f"#!/bin/sh\nexec {shlex.join([sys.executable, __file__, '--inside', folder])}\n"
        )
        (home / "init").chmod(0o755)
        for _ in range(ATTEMPTS):
            if _boot(home):
                return TIMED_OUT
            if (home / "status").exists():
                return int((home / "status").read_text())
            if (home / "began").exists():
                break
        sys.stderr.write((home / "boot").read_text(errors="replace")[-4000:])
        return NOT_STARTED


def _registers(home: Path) -> dict[str, str]:
    """What the kernel needs on processors with AMX, whose registers are more than it expects: see ptrace.c."""
    if " amx_tile" not in Path("/proc/cpuinfo").read_text():
        return {}
    library = home / "ptrace.so"
    if not library.exists():
        source = Path(__file__).with_name("ptrace.c")
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source], check=True)
    return {"LD_PRELOAD": str(library)}


def _boot(home: Path) -> bool:
    """Run the kernel to its end, printing what the command writes; true if it took too long."""
    kernel = ["linux.uml", f"mem={MEMORY_BYTES}", f"init={home}/init", f"uml_dir={home}/", *BOOT]
    memory = "/dev/shm" if shutil.disk_usage("/dev/shm").free > MEMORY_BYTES else "/tmp"
    environment = os.environ | {"TMPDIR": memory} | _registers(home)
    end = time.monotonic() + float(os.environ.get("VCAN_TIMEOUT", "1800"))
    (home / "output").touch()
    with (home / "boot").open("wb") as log, (home / "output").open("rb") as output:
        running = subprocess.Popen(
            kernel,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        )
        os.sched_setaffinity(running.pid, {random.choice(sorted(os.sched_getaffinity(0)))})  # it uses one CPU only
        try:
            while running.poll() is None and time.monotonic() < end:
                time.sleep(TICK_S)
                _print(output)
            if late := running.poll() is None:
                print("kernel: took too long: VCAN_TIMEOUT sets how long it may", file=sys.stderr)
            return late
        finally:
            _end(running)
            _print(output)


def _print(output) -> None:
    sys.stdout.buffer.write(output.read())
    sys.stdout.flush()


def _end(running) -> None:
    """End the kernel and all its processes."""
    for kind in (signal.SIGTERM, signal.SIGKILL):
        if running.poll() is None:
            os.killpg(running.pid, kind)
            try:
                running.wait(5)
            except subprocess.TimeoutExpired:
                continue


def inside(home: Path) -> None:
    """The first process of the kernel: set up the machine, run the command, power off."""
    output = os.open(home / "output", os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    try:
        _set_up()
        job = json.loads((home / "job.json").read_text())
        (home / "began").touch()
        environment = job["environment"] | {"TMPDIR": "/run/tmp"}
        done = subprocess.run(job["command"], cwd=job["folder"], env=environment, stdin=subprocess.DEVNULL)
        (home / "status").write_text(str(done.returncode % 256))
    except Exception as error:
        print(f"kernel: {error}", flush=True)
    finally:
        os.sync()
        ctypes.CDLL(None).reboot(POWER_OFF)


def _set_up() -> None:
    os.environ["PATH"] = "/usr/sbin:/usr/bin:/sbin:/bin"
    for kind, place, options in MOUNTS:
        Path(place).mkdir(exist_ok=True)
        subprocess.run(["mount", "-t", kind, "-o", options, kind, place], check=True)
    Path("/run/tmp").mkdir(mode=0o1777)
    for name, target in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        Path("/dev", name).symlink_to(f"/proc/self/fd{target}")
    for name in ("rmem", "wmem"):
        Path(f"/proc/sys/net/core/{name}_max").write_text(str(2 * SOCKET_BYTES))
        Path(f"/proc/sys/net/core/{name}_default").write_text(str(SOCKET_BYTES))
    libc = ctypes.CDLL(None, use_errno=True)
    for name in MODULES:
        module = Path("/usr/lib/uml/modules", platform.release(), "kernel", f"{name}.ko")
        with module.open("rb") as file:
            if libc.syscall(FINIT_MODULE[platform.machine()], file.fileno(), b"", 0):
                raise OSError(ctypes.get_errno(), f"{module}: {os.strerror(ctypes.get_errno())}")
    subprocess.run(["ip", "-batch", "-"], input=LINKS.encode(), check=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--inside"]:
        inside(Path(sys.argv[2]))
    else:
        sys.exit(main(sys.argv[1:]))
