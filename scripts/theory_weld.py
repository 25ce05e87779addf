"""Search for counterexamples to the statements on the inspection of welds: python scripts/theory_weld.py [-n 10000] [--seed 0].

1. In a window of the lift (`lift_windows`) its branch solves the pose inside all limits, judged by Pinocchio.
2. Outside all windows of a branch that branch breaks a limit or does not reach the pose, at random lifts.
3. At a lift outside all windows, 1 mm from their ends, an iterative search with the lift locked finds nothing.
4. `least_travel` is a least: no grid programme of 2 mm finds less, and it finds at most its own rounding more.

The robots are the arm and nine variants with random limits and reversed axes. Poses are those of random configurations inside the
limits; every fifth gets a level gaze with the tool upright, flat or in between.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

import ik_toolkit as ik
from ik_toolkit.papers.shanmugasundar_2012.weld import least_travel
from ik_toolkit.solvers.closed_form.lift_windows import at_lifts

sys.path += [str(Path(__file__).resolve().parent.parent / "tests" / room) for room in ("", "papers")]
from test_weld import dense_program, outside_of, random_rows, search_at, variants


def windows(count: int, seed: int) -> None:
    """Check statements 1 to 3 and print the counts."""
    rng = np.random.default_rng(seed)
    worst, tried, none, wrong, lifts, searched, found = 0.0, 0, 0, 0, 0, 0, 0
    for arm, T, listed in variants(ik.Robot.load("inspection_7dof"), rng, count, robots=10):
        none += not listed
        for w in listed:
            q = at_lifts(arm, T, w.low + rng.uniform(0.001, 0.999) * (w.high - w.low))[0][w.branch, 0]
            worst, tried = max(worst, np.abs(arm.fk(q).homogeneous - T).max()), tried + 1
            wrong += len(arm.outside(q))
        d = rng.uniform(arm.lower[1], arm.upper[1], 50)
        Q, broken = at_lifts(arm, T, d)
        beyond = broken == 0.0
        for w in listed:
            beyond[w.branch] &= (d < w.low - 1e-6) | (d > w.high + 1e-6)
        lifts += 8 * len(d)
        if beyond.any():
            wrong += int((np.abs(arm.chain.forward(Q[beyond])[0] - T).max(axis=(1, 2)) < 1e-9).sum())
        lift = outside_of(listed, rng, arm.lower[1], arm.upper[1])
        if lift is not None:
            searched, found = searched + 1, found + search_at(arm, T, lift)
    print(f"{count} poses, {none} with no window; {tried} windows, pose error at most {worst:.1e} (m, matrix entries)")
    print(f"counterexamples among these and {lifts} lifts outside or inside: {wrong}")
    print(f"searches with a lift locked outside all windows: {searched}, solved: {found}")


def travel(count: int, seed: int) -> None:
    """Check statement 4 and print the counts."""
    rng = np.random.default_rng(seed)
    step, tried, below, above, most = 0.002, 0, 0, 0, 0.0
    for _ in range(count):
        rows, listed = random_rows(rng)
        plan = least_travel(listed, margin=0.0)
        if plan:
            ours, grid = float(np.abs(np.diff(plan[0])).sum()), dense_program(rows, step)
            tried, below, above = tried + 1, below + (grid < ours - 1e-9), above + (grid > ours + 2 * len(rows) * step)
            most = max(most, grid - ours)
    print(f"{tried} sequences of windows: a grid finds less in {below}, more than its rounding in {above}")
    print(f"a grid finds at most {1000 * most:.1f} mm more")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    windows(asked.n, asked.seed)
    travel(asked.n, asked.seed)
