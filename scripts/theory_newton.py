"""Search for a counterexample to `ik.newton_certificate`: random arms, targets and starts from which Newton is proven to converge.

    python scripts/theory_newton.py [COUNT] [--seed N]

What is claimed of a start with a certificate: the solver `newton` converges; every iterate is within r of the start; after k steps
the distance from the solution is at most bound(k); the solution is the one that `leads_to` names, where a list is complete; and no
other solution is nearer to the start than R. Arms have one to six joints, revolute and prismatic, whose axes are parallel, crossing
or skew.
"""

import argparse
import collections
import itertools
import sys

import numpy as np

import ik_toolkit as ik

# By name: joints (p: prismatic; others turn), the axes they may have, and whether targets are poses.
ARMS = {
    "slide, position": ("p", "x", False),
    "planar 2R, position": ("rr", "z", False),
    "planar slide and turn, position": ("pr", "z", False),
    "planar turn and slide, position": ("rp", "z", False),
    "planar 3R, pose": ("rrr", "z", True),
    "planar turn, slide, turn, pose": ("rpr", "z", True),
    "spatial 3R, position": ("rrr", "any", False),
    "spatial 3R with parallel axes, position": ("rrr", "zyy", False),
    "spatial 2R and slide, position": ("rrp", "any", False),
    "spatial slide and 2R, position": ("prr", "any", False),
    "three slides, position": ("ppp", "any", False),
    "wrist 3R, pose": ("rrr", "wrist", True),  # All axes meet at the tip.
    "spatial 6R, pose": ("rrrrrr", "any", True),
    "spatial 6R with parallel axes, pose": ("rrrrrr", "zyyxyx", True),
    "spatial 5R and slide, pose": ("rrprrr", "any", True),
}
NAMED = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
STARTS, TESTED = 60, 5  # starts drawn for each target, and how many of the proven ones are run
ROUNDING = 1e-8  # of what a run ends at, in the norm


def arm(rng, joints, axes):
    """A random arm as URDF text."""
    planar, parts, parent = axes in ("x", "z"), ['<robot name="random"><link name="base"/>'], "base"

    def vector():
        return " ".join(repr(float(x)) for x in rng.uniform(-1.0, 1.0, 3) * ((1.0, 1.0, 0.0) if planar else 1.0))

    def place():
        return "0 0 0" if axes == "wrist" else vector()

    for k, kind in enumerate(joints):
        axis = vector() if axes in ("any", "wrist") else NAMED[axes[min(k, len(axes) - 1)]]
        if kind == "p" and planar:
            axis = vector() if axes == "z" else NAMED["x"]
        elif axes == "z" and rng.random() < 0.3:
            axis = (0.0, 0.0, -1.0)
        axis = axis if isinstance(axis, str) else " ".join(map(repr, axis))
        low, high = -rng.uniform(0.3, 3.5), rng.uniform(0.3, 3.5)
        parts.append(
            f'<link name="l{k}"/><joint name="j{k}" type="{"prismatic" if kind == "p" else "revolute"}">'
            f'<parent link="{parent}"/><child link="l{k}"/><origin xyz="{place()}"/><axis xyz="{axis}"/>'
            f'<limit lower="{low!r}" upper="{high!r}" effort="1" velocity="1"/></joint>'
        )
        parent = f"l{k}"
    parts.append(
        f'<link name="tip"/><joint name="end" type="fixed"><parent link="{parent}"/><child link="tip"/>'
        f'<origin xyz="{place()}"/></joint></robot>'
    )
    return "".join(parts)


def faults(robot, target, made, k, solutions):
    """Return what is wrong with the claims of certificate `made` for its start number k, as words."""
    run = ik.solve(
        robot, target, "newton", q0=made.q0[k], limits=made.limits, tolerance=1e-10, max_iterations=100, restarts=0,
        history=True,
    )  # fmt: skip
    found = [] if run.success else [f"ended as {run.status.name}"]
    path = run.history["q"]
    if made.norm(path - made.q0[k]).max() > made.radius[k] + ROUNDING:
        found.append("left its ball")
    left = made.norm(path - path[-1])
    if any(x > made.bound(step)[k] + ROUNDING for step, x in enumerate(left)):
        found.append("slower than the bound")
    index = made.leads_to(solutions)[k]
    if index < 0 and solutions.complete:
        found.append("leads to no listed solution")
    turns = [(-1, 0, 1) if turning else (0,) for turning in robot.chain.rows[:, 9] > 0.0]
    shifts = 2.0 * np.pi * np.array(list(itertools.product(*turns)))
    for i, q in enumerate(solutions):
        away = made.norm(q + shifts - made.q0[k])
        ends = made.norm(q + shifts - path[-1])
        if i == index and ends.min() > 1e-5:
            found.append("ended at another solution than named")
        if away[ends > 1e-4].min(initial=np.inf) < made.unique_radius[k] - ROUNDING:
            found.append("another solution within R")
    return found


def search(count, seed=0, progress=lambda done: None):
    """Test `count` starts with a certificate; return how many of each kind of arm, and descriptions of what is wrong."""
    rng, tested, wrong = np.random.default_rng(seed), collections.Counter(), []
    for name in itertools.cycle(ARMS):
        if tested.total() >= count:
            return tested, wrong
        joints, axes, pose = ARMS[name]
        robot = ik.Robot.load(arm(rng, joints, axes), tip="tip")
        q = robot.random_q(rng)
        target = robot.fk(q) if pose else robot.fk(q).translation
        limits = bool(rng.random() < 0.7)
        starts = q + 10.0 ** rng.uniform(-3.0, 0.3, (STARTS, 1)) * rng.normal(size=(STARTS, robot.n)) * robot.chain.unit
        starts = np.clip(starts, robot.lower, robot.upper) if limits else starts
        made = ik.newton_certificate(robot, target, starts, limits=limits)
        proven = np.flatnonzero(made.proven)
        proven = proven[np.argsort(-made.h[proven])][: min(TESTED, count - tested.total())]
        # The hardest are those with the largest h.
        solutions = ik.solve_all(robot, target, starts=30, limits=False) if len(proven) else None
        for k in proven:
            tested[name] += 1
            for fault in faults(robot, target, made, k, solutions):
                wrong.append(f"{name}, start {made.q0[k].tolist()}, h {made.h[k]:.3g}: {fault}")
        progress(tested.total())


def main(search, doc, what) -> None:
    """Run a search as a command: search(count, seed) as here, the docstring of its script, and what it counts."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    tested, wrong = search(asked.count, asked.seed)
    for name, times in tested.items():
        print(f"{times:6} {name}")
    print(f"{tested.total()} {what}, {len(wrong)} counterexamples")
    print("\n".join(wrong[:20]))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main(search, __doc__, "starts with a certificate")
