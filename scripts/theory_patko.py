"""Search for counterexamples to the stability of tracking methods in motion: 10,000 random cases by default.

    python scripts/theory_patko.py [COUNT]

The statement: the gains of cv, av, ca or aad are stable along a path if, and only if, the product of the exact derivatives of all
steps along the motion without error shrinks a small error. Each case is a random arm of 3 to 7 joints (some slide), a closed path
of its tip and gains at rates of 24 to 60 samples a lap; it compares the product with the difference of two simulated runs. Paths
that are nearly singular, or on which a joint moves by more than 0.15 rad in a sample, are left out. Cases in which one of the two
factors over two laps is between 1/10 and 10 are counted separately.
"""

import sys
from collections import Counter
from itertools import count
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from disturbed_runs import cases


def main() -> None:
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
    found: Counter[tuple[str, str, str]] = Counter()
    paths = 0
    for seed in count():
        some = list(cases(seed))
        paths += bool(some)
        for case in some:
            found[case.method, "redundant" if case.joints > case.errors else "not redundant", case.verdict] += 1
            if case.verdict == "contradict":
                print(f"path {seed}: {case}", file=sys.stderr)
        if found.total() >= wanted:
            break
    print(f"{found.total()} cases on {paths} paths")
    print("| method | arm | agree | within 10 of 1 | contradict |\n| --- | --- | --- | --- | --- |")
    for method, arm in sorted({key[:2] for key in found}):
        numbers = (found[method, arm, verdict] for verdict in ("agree", "near 1", "contradict"))
        print(f"| {method} | {arm} | {' | '.join(map(str, numbers))} |")


if __name__ == "__main__":
    main()
