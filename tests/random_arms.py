"""Random chains with every kind of row, and their forward kinematics by 4x4 matrices."""

import math

import numpy as np
import pinocchio as pin

from ik_toolkit.kernel.chain import pack
from ik_toolkit.kernel.counted_error import AXES, KIND
from ik_toolkit.kernel.records import WHAT, Orders, Task

KINDS = "tttstt"  # turning, sliding; "m" a turning follower of joint 0, "n" a sliding one, "o" of a slide


def table(rng, kinds=KINDS):
    """Rows (L, 10) in metres, how many coordinates they have, and which of these slide."""
    rows, n, slides = [], 0, []
    for i, kind in enumerate(kinds):
        b = rng.uniform(-3.0, 3.0) if i else 0.0
        shift = rng.uniform(-0.4, 0.4, 2) if i else np.zeros(2)
        turn, slide = {"t": (1.0, 0.0), "s": (0.0, 1.0), "m": (-0.6, 0.0), "n": (0.0, 0.1), "o": (0.0, -1.4)}[kind]
        place = {"m": 0, "n": 0, "o": slides.index(True) if True in slides else 0}.get(kind, n)
        turned, moved = rng.uniform(-1, 1), rng.uniform(0.1, 0.5)
        rows.append([math.cos(b), math.sin(b), *shift, turn, turned, slide, moved, place, kind in "tm"])
        if kind in "ts":
            n += 1
            slides.append(kind == "s")
    return np.array(rows, float), n, np.array(slides)


def frame(rng):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3)
    return T


def numbers(T):
    return np.concatenate([T[:3, :3].ravel(), T[:3, 3]])


def steps(rows, q):
    for cb, sb, tx, ty, turn, a0, slide, d0, k, _ in rows:
        X, T, Z = np.eye(4), np.eye(4), np.eye(4)
        X[1:3, 1:3] = [[cb, -sb], [sb, cb]]
        T[:3, 3] = tx, ty, slide * q[int(k)] + d0
        a = turn * q[int(k)] + a0
        Z[:2, :2] = [[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]]
        yield X @ T @ Z


def fk(rows, base, tip, q):
    """T_base_tip and the frames of all joints."""
    T, frames = base, []
    for step in steps(rows, q):
        T = T @ step
        frames.append(T)
    return T @ tip, frames


def arm(rng, kinds=KINDS, wide=False):
    """A packed chain, and its rows, base and tip as they were."""
    rows, n, slides = table(rng, kinds)
    base, tip = frame(rng), frame(rng)
    half = np.where(slides, 0.4, 3.5 if wide else 1.5)
    lower, upper = -half * rng.uniform(0.8, 1.0, n), half * rng.uniform(0.8, 1.0, n)
    return pack(rows, numbers(base), numbers(tip), lower, upper, 0.25 * (lower + 3 * upper)), rows, base, tip


def jacobian(rows, base, tip, q, d=1e-6):
    """By differences (6, n), base axes, linear first."""
    J = np.empty((6, len(q)))
    for i in range(len(q)):
        step = np.zeros(len(q))
        step[i] = d
        a, b = fk(rows, base, tip, q - step)[0], fk(rows, base, tip, q + step)[0]
        J[:3, i] = (b[:3, 3] - a[:3, 3]) / (2 * d)
        J[3:, i] = pin.log3(b[:3, :3] @ a[:3, :3].T) / (2 * d)
    return J


def orders(**values):
    return Orders(**{**dict.fromkeys(Orders._fields, 0.0), "tol_p": 1e-6, "tol_r": 1e-6, "limits": 1.0, **values})


def task(kind=KIND.pose, **values):
    return np.array(Task(float(kind), **values))


def turn_about(a, b):
    """Least rotation vector that brings direction a onto b."""
    axis = np.cross(a, b)
    size = np.linalg.norm(axis)
    return axis / size * math.atan2(size, a @ b) if size > 1e-9 else np.zeros(3) * size


def errors(rows, base, tip, q, T, t, scale):
    """What counts of the error, from the words of task.py: base axes [kernel units]."""
    now = fk(rows, base, tip, q)[0]
    e = (T[:3, 3] - now[:3, 3]) / scale
    r = pin.log3(T[:3, :3] @ now[:3, :3].T)
    if t[WHAT.free] > 0.0:
        axis = tip[:3, :3].T @ t[WHAT.ax : WHAT.az + 1]  # in the tip's axes
        r = turn_about(now[:3, :3] @ axis, T[:3, :3] @ axis)
    E = {AXES.base: np.eye(3), AXES.tip: now[:3, :3], AXES.target: T[:3, :3]}[int(t[WHAT.frame])]
    both = np.concatenate([E.T @ e, E.T @ r])
    s, w = t[WHAT.s0 : WHAT.s5 + 1], t[WHAT.w0 : WHAT.w5 + 1]
    return w * (np.sign(both) * np.maximum(np.abs(both) - s, 0.0))


PARTS = [
    {}, {"w0": 0.5, "w4": 0.0, "w5": 2.0}, {"s0": 0.05, "s1": 3.0, "s3": 0.1, "s5": 3.0},
    {"free": 1.0, "ax": 0.6, "ay": 0.0, "az": 0.8}, {"free": 1.0, "ax": 0.0, "ay": 1.0, "az": 0.0, "w1": 0.3, "s4": 0.02},
]  # fmt: skip


def packed(rows, base, tip, lower, upper, home=None):
    """A chain of rows, from base to tip."""
    return pack(rows, numbers(base), numbers(tip), lower, upper, np.zeros(len(lower)) if home is None else home)
