"""Run a command, on this machine's own files, in a kernel of its own that has CAN.

    python kernel.py COMMAND [ARGUMENT...]

The command finds `vcan0` (classic), `vcan1` (CAN FD) and `lo` up and no other network; it runs as root, in the
current directory, with the current environment but TMPDIR, which is in memory there. Its output is printed as it
comes and its exit status returned; 124: it took longer than VCAN_TIMEOUT (s, 600 by default); 125: the kernel did
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

MODULES = ("can/can", "can/can-raw", "can/can-gw")
DRIVERS = ("dev/can-dev", "vcan")
LINKS = """\
link set lo up
link add vcan0 type vcan
link set vcan0 mtu 16 up
link add vcan1 type vcan
link set vcan1 mtu 72 up
"""
MOUNTS = (
    ("proc", "/proc", ""),
    ("sysfs", "/sys", ""),
    ("tmpfs", "/run", "mode=755"),
    ("tmpfs", "/dev/shm", "mode=1777"),
    ("devpts", "/dev/pts", "ptmxmode=666"),
)
FINIT_MODULE = {"x86_64": 313}  # system call
POWER_OFF = 0x4321FEDC
BUFFER = 4 << 20  # bytes that a socket may hold, so that a burst is not lost to the buffer's default
MEMORY = 2 << 30  # bytes
TRIES = 3
TICK_S = 0.05


def main(command: list[str]) -> int:
    """Boot, run, print, return the command's exit status."""
    if not command:
        sys.exit(__doc__)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that nothing is left running
    with tempfile.TemporaryDirectory(prefix="vcan-", dir="/tmp") as folder:
        home = Path(folder)
        job = {"command": command, "folder": str(Path.cwd()), "environment": dict(os.environ)}
        (home / "job.json").write_text(json.dumps(job))
        start = home / "init"
        start.write_text(f"#!/bin/sh\nexec {shlex.join([sys.executable, __file__, '--inside', folder])}\n")
        start.chmod(0o755)
        for _ in range(TRIES):
            late = _boot(home)
            if late:
                return 124
            if (home / "status").exists():
                return int((home / "status").read_text())
            if (home / "began").exists():
                break
        sys.stderr.write((home / "boot").read_text(errors="replace")[-4000:])
        return 125


def _registers(home: Path) -> dict[str, str]:
    """What the kernel needs on processors with AMX, whose registers are more than it knows: see ptrace.c."""
    if " amx_tile" not in Path("/proc/cpuinfo").read_text():
        return {}
    library = home / "ptrace.so"
    if not library.exists():
        source = Path(__file__).with_name("ptrace.c")
        subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, source], check=True)
    return {"LD_PRELOAD": str(library)}


def _boot(home: Path) -> bool:
    """Run the kernel to its end, printing what the command writes; true if it had to be ended."""
    cpu = random.choice(sorted(os.sched_getaffinity(0)))  # one CPU is all it uses, and roaming costs
    kernel = [
        "linux.uml",
        f"mem={MEMORY}",
        "rootfstype=hostfs",
        "rw",
        f"init={home}/init",
        f"uml_dir={home}/",
        "quiet",
    ]
    kernel += [
        "con=null",
        "ssl=null",
        "con0=null,fd:1",
        "pty.legacy_count=0",
        "initcall_blacklist=raid6_select_algo",
    ]
    output = home / "output"
    output.touch()
    with (home / "boot").open("wb") as log, output.open("rb") as shown:
        running = subprocess.Popen(
            kernel,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=os.environ | {"TMPDIR": _memory()} | _registers(home),
            start_new_session=True,
        )
        os.sched_setaffinity(running.pid, {cpu})
        try:
            return _follow(running, shown)
        finally:
            _end(running)
            _show(shown)


def _memory() -> str:
    """The folder for the file that is the kernel's memory; a container's /dev/shm may be too small."""
    return "/dev/shm" if shutil.disk_usage("/dev/shm").free > MEMORY else "/tmp"


def _follow(running, shown) -> bool:
    end = time.monotonic() + float(os.environ.get("VCAN_TIMEOUT", "600"))
    while running.poll() is None:
        if time.monotonic() > end:
            print("kernel: took too long: VCAN_TIMEOUT sets how long it may", file=sys.stderr)
            return True
        time.sleep(TICK_S)
        _show(shown)
    return False


def _show(shown) -> None:
    sys.stdout.buffer.write(shown.read())
    sys.stdout.flush()


def _end(running) -> None:
    """End the kernel and all that it is made of."""
    for how in (signal.SIGTERM, signal.SIGKILL):
        if running.poll() is None:
            os.killpg(running.pid, how)
            try:
                running.wait(5)
            except subprocess.TimeoutExpired:
                continue


def inside(home: Path) -> None:
    """The first process in there: make the machine, run the command, power off."""
    output = os.open(home / "output", os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    try:
        _prepare()
        job = json.loads((home / "job.json").read_text())
        (home / "began").touch()
        done = subprocess.run(
            job["command"],
            cwd=job["folder"],
            env=job["environment"] | {"TMPDIR": "/run/tmp"},
            stdin=subprocess.DEVNULL,
            check=False,
        )
        (home / "status").write_text(str(done.returncode % 256))
    except Exception as error:
        print(f"kernel: {error}", flush=True)
    finally:
        os.sync()
        ctypes.CDLL(None).reboot(POWER_OFF)


def _prepare() -> None:
    os.environ["PATH"] = "/usr/sbin:/usr/bin:/sbin:/bin"
    for kind, place, options in MOUNTS:
        Path(place).mkdir(exist_ok=True)
        subprocess.run(["mount", "-t", kind, *(["-o", options] if options else []), kind, place], check=True)
    Path("/run/tmp").mkdir(mode=0o1777)
    for name, target in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        Path("/dev", name).symlink_to(f"/proc/self/fd{target}")
    for name in ("rmem", "wmem"):
        Path(f"/proc/sys/net/core/{name}_max").write_text(str(2 * BUFFER))
        Path(f"/proc/sys/net/core/{name}_default").write_text(str(BUFFER))
    modules = Path("/usr/lib/uml/modules", platform.release(), "kernel")
    for name in (*(f"net/{each}" for each in MODULES), *(f"drivers/net/can/{each}" for each in DRIVERS)):
        _load(modules / f"{name}.ko")
    subprocess.run(["ip", "-batch", "-"], input=LINKS.encode(), check=True)


def _load(module: Path) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    with module.open("rb") as file:
        if libc.syscall(FINIT_MODULE[platform.machine()], file.fileno(), b"", 0):
            raise OSError(ctypes.get_errno(), f"{module}: {os.strerror(ctypes.get_errno())}")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--inside"]:
        inside(Path(sys.argv[2]))
    else:
        sys.exit(main(sys.argv[1:]))
