"""Search for counterexamples to the analysis of Burrell's solvers: `ik.analyse` of state space, and `gain_margins` of IK-PID.

    python scripts/theory_burrell.py [COUNT] [--seed N]

What is claimed of random arms (planar and spatial, with slides), gains and configurations, to first order, without limits: where
the spectral radius is below 1 the loop takes a small error to zero, and where it is above 1 the error grows; with a K_p below the
gain margin some joint, moved one way by K_p |e|, lowers a small error e of any direction in which the arm can move.
"""

import collections
import itertools

import numpy as np
from theory_newton import arm, main

import ik_toolkit as ik
from ik_toolkit.study.analyse import gain_margins

ARMS = {"planar 2R": ("rr", "z"), "planar 3R": ("rrr", "z"), "spatial 3R": ("rrr", "any"), "spatial 6R": ("rrrrrr", "any"),
        "slide and 3R": ("prrr", "any"), "three slides": ("ppp", "any")}  # fmt: skip
SMALL = 1e-7  # size of the errors [of the arm's scale]
EACH = 10  # configurations of each arm and gains
CLEAR = 0.03  # radii nearer to 1 take too many steps to tell


def search(count, seed=0):
    """Test `count` loops and as many gain margins; return how many of each kind of arm, and descriptions of what is wrong."""
    rng, tested, wrong = np.random.default_rng(seed), collections.Counter(), []
    for name in itertools.cycle(ARMS):
        if tested.total() >= count:
            return tested, wrong
        robot = ik.Robot.load(arm(rng, *ARMS[name]), tip="tip")
        a, n, unit = rng.uniform(-0.8, 0.8), robot.n, robot.chain.unit
        J = robot.jacobian(robot.random_q(rng))[:3]
        S = rng.uniform(0.1, 1.3) * np.linalg.pinv(J * unit, rcond=1e-6) * unit[:, None]
        # B in rad per m with C = -I: S = C (1 - a)^-1 B.
        rule = ik.StateSpace(A=a * np.eye(n), B=-(1.0 - a) * S, C=-np.eye(n))
        Q = robot.random_q(rng, EACH)
        found = ik.analyse(robot, rule, Q, position_only=True)
        margins = gain_margins(robot, Q)
        for q, radius, margin in zip(Q, found.spectral_radius, margins, strict=True):
            tested[name] += 1
            where = f"{name}, q {q.tolist()}, a {a:.3f}"
            goal = robot.chain.forward(q[None])[0][0, :3, 3]
            at = q + SMALL * rng.normal(size=n) * unit
            if abs(radius - 1.0) > CLEAR:
                ratio = run(robot, found.matrices, goal, at, steps=int(12.0 / abs(np.log(radius))) + 20)
                if (ratio > 1e-2) if radius < 1.0 else (ratio < 10.0):
                    wrong.append(f"{where}: radius {radius:.4f}, but the error changes {ratio:.3g}-fold")
            if margin > 0.0 and not lowered(robot, goal, at, 0.95 * margin):
                wrong.append(f"{where}: no joint lowers the error at 0.95 of the margin {margin:.4g}")


def run(robot, M, goal, q, steps):
    """Return the error after some steps of the loop from q over the first one; it stops where the error is no longer small."""
    x, B, D = np.zeros(len(M.A)), M.B[0], M.D[0]
    first = None
    for _ in range(steps):
        e = goal - robot.chain.forward(q[None])[0][0, :3, 3]
        size = np.linalg.norm(e)
        first = first or size
        if size > 1e3 * first:
            break
        q, x = q + M.C @ x + D @ e, M.A @ x + B @ e
    return size / first


def lowered(robot, goal, q, kp):
    """Return whether some joint, moved by K_p |e| one way or the other, lowers the error."""
    e = np.linalg.norm(goal - robot.chain.forward(q[None])[0][0, :3, 3])
    moves = np.vstack([np.diag(kp * e * np.ones(robot.n)), -np.diag(kp * e * np.ones(robot.n))])
    return np.linalg.norm(goal - robot.chain.forward(q + moves)[0][:, :3, 3], axis=1).min() < e


if __name__ == "__main__":
    main(search, __doc__, "loops and gain margins")
