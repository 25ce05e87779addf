"""Test the documentation's promises on many random cases, with any seed; exit code 1 if a promise does not hold.

Usage: python scripts/claims [--seed N] [--count N] [--only NAME ...]. Each claim draws its own cases: targets are made
from legal configurations, so a solution exists. --count is the number of cases per claim; slow claims use a fraction of it.
"""

import argparse
import sys
from time import perf_counter

import calls  # noqa: F401  importing registers the claims
import closed_forms  # noqa: F401
import tracks  # noqa: F401
from common import CLAIMS


def main() -> None:
    """Run the requested claims and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--only", nargs="+", choices=sorted(CLAIMS), metavar="NAME", default=list(CLAIMS))
    given = parser.parse_args()
    failed = 0
    for name in given.only:
        began = perf_counter()
        outcome = CLAIMS[name](given.count, given.seed)
        failed += outcome.broken > 0
        verdict = "holds" if outcome.broken == 0 else f"BROKEN in {outcome.broken}"
        print(
            f"{name:20} {verdict:18} {outcome.cases:9} cases  {perf_counter() - began:6.1f} s  {outcome.words}",
            flush=True,
        )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
