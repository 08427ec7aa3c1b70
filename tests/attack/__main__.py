"""`python -m tests.attack [--connections 100000] [--seconds N] [names ...]`: the attacks by hand."""

import argparse
import sys

from tests.attack.harness import Size, held, table
from tests.attack.names import ATTACKS
from tests.attack.service import Pool


def main() -> int:
    """Run attacks; 1 where one did harm."""
    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="name", help=f"attacks, all if left out: {', '.join(ATTACKS)}")
    parser.add_argument("--connections", type=int, default=100_000, help="of the fuzzer")
    parser.add_argument("--seconds", type=float, default=1800.0, help="that the fuzzer may take")
    parser.add_argument("--factor", type=int, default=1, help="times the attempts of every other attack")
    parser.add_argument("--seed", type=int, default=1, help="of the fuzzer")
    given = parser.parse_args()
    unknown = [each for each in given.names if each not in ATTACKS]
    if unknown:
        parser.error(f"unknown attack {unknown[0]!r}; available: {', '.join(ATTACKS)}")
    size = Size(given.factor, given.connections, given.seconds, given.seed)
    pool, outcomes = Pool(), []
    try:
        for name in given.names or ATTACKS:
            outcomes.append(held(ATTACKS[name], pool, size))
            print(table(outcomes[-1:]), file=sys.stderr, flush=True)
    finally:
        pool.close()
        print(table(outcomes))
    return int(any(each.failures for each in outcomes))


if __name__ == "__main__":
    sys.exit(main())
