"""Random arms, closed paths, methods and gains, to compare the product of step derivatives with simulated runs.

A case says by which factor a small error should change over a path, and by which the difference of two runs does that start
1e-7 apart. scripts/theory_patko.py compares 10,000 of them, the suite 60. The laws of the methods are
written here again, in numpy.
"""

import functools
from typing import NamedTuple

import numpy as np
from serial_arms import urdf

import ik_toolkit as ik
from ik_toolkit.errors import IKError
from ik_toolkit.servo.orbit_stability import PathMotion, jacobians, tip_errors
from ik_toolkit.servo.stability import p_limit

ARMS, LAPS, APART = 24, 2, 1e-7
EACH = {"cv": 12, "ca": 12, "av": 3, "aad": 3}  # sets of gains for each path
REGULAR = 0.08  # least singular value of the Jacobian along a path, with lengths over the reach
CLEAR = 10.0  # a factor between 1 / CLEAR and CLEAR over LAPS laps says neither that errors grow nor that they fall
FAST = 0.15  # [rad or reach] largest move of a joint in a sample of a path; beyond it errors are not small
LOST = 0.3  # a run that is this far off, over the reach, has left its path
NULL = 0.4  # damping of null-space motion times the sample time


class Case(NamedTuple):
    """What the product says of LAPS laps, what two runs show, and how far off its path (over the reach) the undisturbed one was."""

    method: str
    joints: int
    errors: int
    samples: int
    gains: dict
    foretold: float
    seen: float
    off: float

    @property
    def verdict(self):
        """Whether both agree ("agree"), contradict each other, or one is too near 1 to tell ("near 1")."""
        if not (abs(np.log(self.foretold)) > np.log(CLEAR) and abs(np.log(self.seen)) > np.log(CLEAR)):
            return "near 1"
        return "agree" if (self.foretold > 1.0) == (self.seen > 1.0) else "contradict"


@functools.cache
def arm(seed):
    """A random arm of 3 to 7 joints, some of them prismatic, with links of 0.1 to 0.5 m."""
    rng = np.random.default_rng([7, seed])
    joints = []
    for k in range((3, 3, 4, 5, 6, 6, 7)[int(rng.integers(7))]):
        axis = rng.normal(size=3)
        kind = "prismatic" if k and rng.random() < 0.15 else "revolute"
        joints.append(
            (kind, rng.uniform(-0.4, 0.4, 3), rng.uniform(-np.pi, np.pi, 3), axis / np.linalg.norm(axis), -3.0, 3.0)
        )
    return ik.Robot.load(urdf(joints, (rng.uniform(-0.3, 0.3, 3), np.zeros(3))))


def closed_path(robot, rng, pose, laps):
    """A reference along which the tip goes while each joint swings in sines of one or two periods a lap of 1 s."""
    middle, size = rng.uniform(-1.5, 1.5, robot.n), rng.uniform(0.0, 0.5, robot.n) * robot.chain.unit
    w, phase = 2.0 * np.pi * rng.integers(1, 3, robot.n), rng.uniform(0.0, 2.0 * np.pi, robot.n)
    m = 6 if pose else 3

    def at(t):
        x = w * t[:, None] + phase
        q, qd, qdd = middle * robot.chain.unit + size * np.sin(x), size * w * np.cos(x), -size * w * w * np.sin(x)
        T, bent = robot.chain.forward(q)[0], jacobians(robot, q, m)
        V, A = np.zeros((2, len(t), 6))
        V[:, :m] = np.einsum("kmj,kj->km", bent.J, qd)
        A[:, :m] = np.einsum("kmj,kj->km", bent.J, qdd) + np.einsum("kmji,ki,kj->km", bent.H, qd, qd)
        return T, V, A

    return ik.Reference(at, float(laps), position_only=not pose)


def random_gains(method, rng):
    """Gains for a sample time of 1 s, many of them near the border at rest."""
    if method == "cv":
        return {"kappa": rng.uniform(0.5, 1.15)}
    if method == "ca":
        d = rng.uniform(0.4, 1.05)
        return {"kp": rng.uniform(0.3, 1.1) * float(p_limit(d)), "kd": d}
    return {"share": rng.uniform(0.3, 1.0)} | ({"gamma": rng.uniform(0.45, 0.8)} if method == "aad" else {})


def simulate(robot, path, samples, method, gains, q0, m):
    """Follow a path by a method from each of q0 (R, n), two rows for each set of gains; h = 1 s.

    Returns the state at the end of each run (position, orientation if it counts, tip velocity) and its largest error.
    """
    times = np.arange(LAPS * samples + 1) / samples
    T, V, A = path.at(times)
    V, A = V[:, :m] / samples, A[:, :m] / samples**2
    k = {name: np.repeat([one[name] for one in gains], 2)[:, None] for name in gains[0]}
    q, before, far = q0.copy(), None, np.zeros(len(q0))
    rate = np.tile(np.linalg.pinv(robot.chain.forward(q0[:1], jacobian=True)[1][0, :m]) @ V[0], (len(q0), 1))
    for i in range(LAPS * samples):
        tip = robot.chain.forward(q)[0]
        bent = jacobians(robot, q, m)
        P = np.linalg.pinv(bent.J)
        e, ahead = (tip_errors(np.broadcast_to(T[j], tip.shape), tip, m) for j in (i, i + 1))
        far = np.maximum(far, np.abs(e).max(axis=1))

        def inverse(b, P=P):
            return np.einsum("rij,rj->ri", P, b)

        def turned(x, y, bent=bent):
            return np.einsum("rmji,ri,rj->rm", bent.H, x, y)

        speed = np.einsum("rmj,rj->rm", bent.J, rate)
        free = rate - inverse(speed)
        if method == "cv":
            u = inverse(V[i] + k["kappa"] * e)
            q = q + 1.5 * u - 0.5 * (u if before is None else before)
            before = u
        elif method == "ca":
            u = inverse(A[i] + k["kd"] * (V[i] - speed) + k["kp"] * e - turned(rate, rate)) - NULL * free
            new = rate + 1.5 * u - 0.5 * (u if before is None else before)
            q, rate, before = q + 0.5 * (rate + new), new, u
        else:
            s = inverse(ahead - (1.0 - k["share"]) * e)
            if method == "av":
                q = q + s
                continue
            w, g = s + free, k["gamma"]
            a = (s - rate + free) / g - inverse(turned(w, w)) / (2.0 * g) - NULL * free
            q, rate = q + rate + g * a, rate + a
        q = np.where(np.abs(q) < 1e6, q, 1e6)  # a run that is lost stays lost
        rate = np.where(np.abs(rate) < 1e6, rate, 1e6)
    T, J = robot.chain.forward(q, jacobian=True)
    moving = np.einsum("rmj,rj->rm", J[:, :m], rate if method in ("ca", "aad") else 0.0 * rate)
    return np.concatenate([tip_errors(np.broadcast_to(np.eye(4), T.shape), T, m), moving], axis=1), far


def cases(seed):
    """The cases of path number `seed`; none if the path is nearly singular, too fast, or cannot be followed."""
    rng = np.random.default_rng([47, seed])
    robot = arm(int(rng.integers(ARMS)))
    pose = robot.n > 5 and rng.random() < 0.6
    samples, path = int(rng.integers(24, 61)), closed_path(robot, rng, pose, LAPS)
    try:
        motion = PathMotion(robot, path)
    except IKError:
        return
    m = motion.m
    rows = np.r_[np.full(3, 1.0 / robot.chain.reach), np.ones(3)][:m]
    J = jacobians(robot, motion.q, m).J * rows[:, None] * robot.chain.unit
    if np.linalg.svd(J, compute_uv=False)[:, -1].min() < REGULAR:
        return
    speed = np.abs(np.gradient(motion.q, motion.times, axis=0) / robot.chain.unit).max()
    if speed / samples > FAST:
        return
    for method, count in EACH.items():
        gains = [random_gains(method, rng) for _ in range(count)]
        aside = np.array([np.linalg.pinv(J[0]) @ rng.normal(size=m) for _ in gains]) * robot.chain.unit
        aside *= APART / np.linalg.norm(aside, axis=1, keepdims=True)
        q0 = motion.q[0] + np.stack([0.0 * aside, aside], axis=1).reshape(-1, robot.n)
        with np.errstate(all="ignore"):
            end, far = simulate(robot, path, samples, method, gains, q0, m)
        at = robot.chain.forward(q0)[0]
        start = tip_errors(at[::2], at[1::2], m)
        apart = np.abs(end[::2] - end[1::2]).max(axis=1) / np.abs(start).max(axis=1)
        for k, one in enumerate(gains):
            foretold = motion.growth(method, 1.0, one, NULL, pace=1.0 / samples).factor
            lost = not far[2 * k : 2 * k + 2].max() < LOST * robot.chain.reach
            seen = np.inf if lost else max(float(apart[k]), 1e-12)
            yield Case(method, robot.n, m, samples, one, foretold, seen, float(far[2 * k]) / robot.chain.reach)
