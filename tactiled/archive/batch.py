"""One job over many inputs, in this process or on Dask's workers; what is complete already is skipped."""

import json
import logging
import pickle
import signal
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import ExitStack
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from secrets import token_hex
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

from tactiled import __version__, files
from tactiled.archive.jobs import Job
from tactiled.archive.places import Place
from tactiled.errors import ConfigError, TactileError

SCHEDULER_TIMEOUT_S = 10.0  # to reach one
LOG = logging.getLogger(__name__)


class Task(NamedTuple):
    """One input and its output."""

    source: Place
    target: Place


class Outcome(NamedTuple):
    """What became of a task."""

    state: str  # written, complete (already), failed
    text: str


def run(
    job: Job, tasks: list[Task], workers: int | None = None, scheduler: str | None = None
) -> Generator[Outcome]:
    """Do all tasks, and yield each outcome when it comes. No temporary file stays beside the outputs."""
    label = f"{token_hex(8)}-"  # of this run's temporary files
    try:
        if workers is None and scheduler is None:
            for task in tasks:
                yield process(job, task, label, __version__)
        else:
            yield from _on_dask(job, tasks, label, workers, scheduler)
    finally:
        for folder in {each.target.beside(f".tactiled-{label}*") for each in tasks}:
            for path in folder.call("glob"):
                Place(path, folder.files).remove()


def process(job: Job, task: Task, label: str, version: str) -> Outcome:
    """Do one task, unless a record beside its output says that the output is complete and of the same digest.

    The record is written last. An output without a record was made by another program, and is never replaced.
    """
    source, target = task
    began, record = time.perf_counter(), target.beside(f".{target.name}.tactiled")
    try:
        if version != __version__:
            raise ConfigError(f"a worker has tactiled {__version__}, not {version}: install the same")
        with source.local() as path:
            digest = _digest(job, path)
            if sizes := target.sizes():
                if not record.call("exists"):
                    raise ConfigError(f"{target} is there already: name another file, or remove it first")
                if record.call("cat_file") == _record(digest, sizes):
                    return Outcome("complete", f"{target}: complete")
            target.beside("").call("makedirs", exist_ok=True)
            with target.written(replace=True, label=label) as part, threadpool_limits(1):
                text = job.make(path, part)
                record.call("pipe_file", b"{}")  # from here on the output is ours, but may be incomplete
            record.call("pipe_file", _record(digest, target.sizes()))
    except TactileError as error:
        return Outcome("failed", str(error))
    except Exception as error:  # a fault at one input does not stop the others
        LOG.exception("%s failed", source)
        return Outcome("failed", f"{source}: {type(error).__name__}: {error}")
    return Outcome("written", f"{target}: {text} in {time.perf_counter() - began:.1f} s")


def _digest(job: Job, path: Path) -> str:
    """SHA-256 of all that an output is made from."""
    parts = {"version": __version__, "input": [path.name, files.sha256(path)], "job": job.settings()}
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _record(digest: str, sizes: Mapping[str, int]) -> bytes:
    """What stands beside a complete output."""
    return json.dumps({"digest": digest, "sizes": sizes}).encode()


def _on_dask(
    job: Job, tasks: list[Task], label: str, workers: int | None, scheduler: str | None
) -> Iterator[Outcome]:
    """Outcomes from a scheduler's workers, or from `workers` processes of this machine."""
    if not find_spec("distributed"):
        raise ConfigError("--workers and --scheduler need Dask: pip install 'tactiled[dask]'")
    from distributed import Client, as_completed

    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # a lost scheduler is an outcome
    with ExitStack() as stack:
        try:
            if scheduler is None:
                cluster = stack.enter_context(_cluster(workers))
                client = stack.enter_context(Client(cluster))
            else:
                client = stack.enter_context(Client(scheduler, timeout=SCHEDULER_TIMEOUT_S))
        except (OSError, RuntimeError, ValueError) as error:
            option = f"--workers {workers}" if scheduler is None else f"--scheduler {scheduler}"
            raise TactileError(f"{option}: {error}") from error
        shared = client.submit(pickle.loads, pickle.dumps(job), pure=False)  # once a worker, not once a task
        futures = {
            client.submit(process, shared, task, label, __version__, pure=False): task.source for task in tasks
        }
        for future in as_completed(futures):
            yield _outcome(future, futures[future])


def _cluster(workers: int | None) -> Any:
    """Processes of this machine with one thread each; they ignore Ctrl-C, which their parent handles."""
    from distributed import LocalCluster

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # they inherit it
    try:
        return LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    finally:
        signal.signal(signal.SIGINT, before)


def _outcome(future: Any, source: Place) -> Outcome:
    """What a worker answered; failed where workers died with it, or their scheduler did."""
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    error = future.exception() if future.status == "error" else f"{future.status}: the scheduler is gone"
    return Outcome("failed", f"{source}: {error}")
