"""`python -m tests.attack [--connections 100000] [--seconds N] [names ...]`: the attacks by hand."""

import argparse
import sys

from tests.attack.attacks import ATTACKS
from tests.attack.harness import Size, attack, report
from tests.attack.service import Pool


def main() -> int:
    """Run attacks; 1 where one did harm."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="name", help=f"attacks, all if left out: {', '.join(ATTACKS)}")
    parser.add_argument("--connections", type=int, default=100_000, help="of the fuzzer")
    parser.add_argument("--seconds", type=float, default=1800.0, help="that the fuzzer may take")
    parser.add_argument("--factor", type=int, default=1, help="times the attempts of every other attack")
    parser.add_argument("--seed", type=int, default=1, help="of the fuzzer")
    options = parser.parse_args()
    if unknown := set(options.names) - set(ATTACKS):
        parser.error(f"unknown attack {min(unknown)!r}; available: {', '.join(ATTACKS)}")
    size = Size(options.factor, options.connections, options.seconds, options.seed)
    pool, outcomes = Pool(), []
    try:
        for name in options.names or ATTACKS:
            outcomes.append(attack(name, ATTACKS[name], pool, size))
            print(report(outcomes[-1]), flush=True)
    finally:
        pool.close()
    return int(any(each.findings.failures for each in outcomes))


if __name__ == "__main__":
    sys.exit(main())
