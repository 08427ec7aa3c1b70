"""Programs that run with another checkout of the package, 0.4.2 or later."""

import os
import subprocess
import sys
from pathlib import Path


def figures(tree: Path, program: str, *arguments: str) -> list[float]:
    """Run Python text with the package of a checkout, on one thread, and give the numbers that it prints."""
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-P", "-c", program, *arguments]
    return [float(each) for each in subprocess.check_output(command, env=environment, text=True).split()]
