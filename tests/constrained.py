"""The constrained step on arrays, and random problems for it."""

import numpy as np
from numba import config

from ik_toolkit.compile.array_view import keep, view
from ik_toolkit.compile.jit import cached
from ik_toolkit.servo import constrained_step as rooms
from ik_toolkit.servo.constrained_step import MODE, Allowed, StepTaken, TaskRate, constrain
from ik_toolkit.servo.laws import LAW, Law


def many(count):
    """So many cases, or a few when the kernel is not compiled: for scripts/mutate.py, which wants tests of a second."""
    return max(count // 20, 1) if config.DISABLE_JIT else count


@cached
def kernel(J, weight, ask, want, size, low, high, A, b, count, mode, step, mu, x, active, kept):
    (n, m), rows = J.shape, A.shape[0]
    block, none, rank = np.zeros(rooms.room_space(n, m, rows)), np.zeros(n), np.full(m, weight.max())
    asked = TaskRate(
        view(J), view(weight), view(rank), view(ask), view(want), view(none), view(size), mode, step, mu
    )  # fmt: skip
    allowed = Allowed(view(low), view(high), view(A), view(b), count)
    taken = StepTaken(view(x), view(active), view(kept))
    status = constrain(asked, allowed, rooms.room_on(view(block), n, m, rows), taken)
    keep(block)
    keep(none)
    keep(rank)
    return status


class Step:
    """A problem, and what holds from one solution to the next."""

    def __init__(
        self, J, low, high, rows=None, mode=MODE.leave, weight=None, scale=None, step=0.0, mu=0.0,
    ):  # fmt: skip
        n, m = J.shape
        self.J, self.low, self.high, self.mode = J, low, high, mode
        self.step, self.mu = step, mu
        self.A, self.b = (np.empty((1, n)), np.empty(1)) if rows is None else rows
        self.count = 0 if rows is None else len(self.b)
        self.weight = np.ones(m) if weight is None else weight
        self.scale = np.ones(n) if scale is None else scale
        self.active, self.kept = np.zeros(n, np.int8), np.zeros(len(self.b), np.int8)
        self.x = np.empty(n)

    def __call__(self, ask, want):
        self.status = kernel(
            self.J, self.weight, ask, want, self.scale, self.low, self.high, self.A, self.b, self.count,
            self.mode, self.step, self.mu, self.x, self.active, self.kept,
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


def law(code=LAW.cv, **values):
    """A law of a tracker in which everything else is 0."""
    return Law(**{**dict.fromkeys(Law._fields, 0.0), "code": code, "gamma": 1.0, "mode": MODE.leave, **values})
