"""The constrained step on arrays, and random problems for it."""

import numpy as np
from numba import config

from ik_toolkit.compile.array_view import keep, view
from ik_toolkit.compile.jit import cached
from ik_toolkit.servo import constrained_step as rooms
from ik_toolkit.servo.constrained_step import LEAVE, constrain


def many(count):
    """So many cases, or a few when the kernel is not compiled: for scripts/mutate.py, which wants tests of a second."""
    return max(count // 20, 1) if config.DISABLE_JIT else count


@cached
def kernel(
    J, weight, feedback, forward, want, scale, low, high, A, b, count, mode, cap, singular, damping,
    x, active, kept, starts, push, step, mu,
):  # fmt: skip
    (n, m), rows = J.shape, A.shape[0]
    block = np.zeros(rooms.room_space(n, m, rows))
    status, rate = constrain(
        view(J), view(weight), view(feedback), view(forward), view(want), view(want), view(scale), view(low), view(high),
        view(A), view(b), count, mode, cap, singular, damping, rooms.room_on(view(block), n, m, rows),
        view(x), view(active), view(kept), view(starts), view(push), step, mu,
    )  # fmt: skip
    keep(block)
    return status, rate


class Step:
    """A problem, and what holds from one solution to the next."""

    def __init__(
        self, J, low, high, rows=None, mode=LEAVE, cap=1.0, singular=0.0, damping=0.0, weight=None, scale=None, step=0.0,
        mu=0.0,
    ):  # fmt: skip
        n, m = J.shape
        self.J, self.low, self.high, self.mode, self.cap = J, low, high, mode, cap
        self.singular, self.damping, self.step, self.mu = singular, damping, step, mu
        self.A, self.b = (np.empty((1, n)), np.empty(1)) if rows is None else rows
        self.count = 0 if rows is None else len(self.b)
        self.weight = np.ones(m) if weight is None else weight
        self.scale = np.ones(n) if scale is None else scale
        self.active, self.kept = np.zeros(n, np.int8), np.zeros(len(self.b) + 1, np.int8)
        self.starts = np.zeros((4, n + len(self.b) + 1), np.int8)
        self.x, self.push = np.empty(n), np.empty(n + len(self.b))

    def __call__(self, feedback, forward, want):
        self.status, self.rate = kernel(
            self.J, self.weight, feedback, forward, want, self.scale, self.low, self.high, self.A, self.b, self.count,
            self.mode, self.cap, self.singular, self.damping, self.x, self.active, self.kept, self.starts,
            self.push, self.step, self.mu,
        )  # fmt: skip
        return self.x.copy()


def problem(rng, n=None, tight=1.0):
    """Jacobian, of any rank, a task and a box with 0 inside."""
    n = int(rng.integers(2, 17)) if n is None else n
    J = rng.normal(size=(n, 6))
    if rng.random() < 0.2:
        J[:, 5] = J[:, 0] - J[:, 1]
    if rng.random() < 0.2:
        J[:, 3:] = 0.0
    if rng.random() < 0.2:
        J[rng.integers(n)] = 0.0
    return J, rng.normal(size=6), -tight * rng.uniform(0.02, 1.0, n), tight * rng.uniform(0.02, 1.0, n)


def some_rows(rng, low, high):
    """Half-planes with 0 inside."""
    A = rng.normal(size=(int(rng.integers(1, 7)), len(low)))
    return A, rng.choice([0.0, 0.05, 0.5], len(A))


def planar(q):
    """Jacobian (3, 2) of the tip of three unit links."""
    a = np.cumsum(q)
    x, y = np.cumsum(np.cos(a)[::-1])[::-1], np.cumsum(np.sin(a)[::-1])[::-1]
    return np.column_stack([-y, x])
