"""`python -m tests.attack [--connections 100000] [--seconds N] [names ...]`: the attacks by hand."""

import argparse
import sys

from tests.attack.attacks import ATTACKS
from tests.attack.harness import Size, attack
from tests.attack.service import Pool

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*ATTACKS, []], help="attacks, all if left out")
    parser.add_argument("--connections", type=int, default=100_000, help="of the fuzzer")
    parser.add_argument("--seconds", type=float, default=1800.0, help="that the fuzzer may take")
    parser.add_argument("--seed", type=int, default=1, help="of the fuzzer")
    options = parser.parse_args()
    failures = 0
    with Pool() as pool:
        for name in options.names or ATTACKS:
            findings = attack(ATTACKS[name], pool, Size(options.connections, options.seconds, options.seed))
            print(findings.report(name), flush=True)
            failures += len(findings.failures)
    sys.exit(int(failures > 0))
