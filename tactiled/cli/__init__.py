"""One file a verb; importing a file here gives the command line its verb."""

from tactiled.cli import bench_bus as bench_bus
from tactiled.cli import bench_cover as bench_cover
from tactiled.cli import bench_frontier as bench_frontier
from tactiled.cli import bench_latency as bench_latency
from tactiled.cli import bench_picard as bench_picard
from tactiled.cli import bench_restore as bench_restore
from tactiled.cli import bench_stability as bench_stability
from tactiled.cli import check as check
from tactiled.cli import cover as cover
from tactiled.cli import demo as demo
from tactiled.cli import init as init
from tactiled.cli import paper as paper
from tactiled.cli import restore as restore
from tactiled.cli import record as record
from tactiled.cli import run as run
from tactiled.cli import simulate as simulate
from tactiled.cli.app import main

__all__ = ["main"]
