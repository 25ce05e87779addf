"""Cyclic coordinate descent: one joint after the other, tip first, moves to where the error is least."""

from typing import Any, NamedTuple

from ...compile.jit import compiled
from ...kernel.search import WAITING
from ..protocol import Asked, rule


@compiled
class Sweep(NamedTuple):
    """The compiled step of CCD: one sweep over all joints.

    The class has a field only because numba cannot pass a NamedTuple without one to compiled code.
    """

    least: float  # a joint is skipped if the tip's squared speed at a joint speed of 1 is smaller than this

    JACOBIAN = False

    def step(self, p, e):
        s = p.desk
        n = s.q.shape[0]
        for i in range(n):
            s.x[i] = s.q[i]
        cut = False
        for k in range(n):
            i = n - 1 - k
            if e.good:
                break
            if not s.w[i] > 0.0:
                continue
            old = s.q[i]
            new = p.inside(i, old + p.best_move(e, i, self.least))
            if new == old:
                continue
            if not s.affords(2):  # Trying a joint's step costs one evaluation of FK, and undoing it another one.
                cut = True
                break
            s.q[i] = new
            f = p.try_out(s.q)
            if f.ee < e.ee:
                e = f
            else:
                s.q[i] = old
                p.undo(e)
        for i in range(n):
            s.dq[i] = s.q[i] - s.x[i]
            s.q[i] = s.x[i]
        return WAITING if cut else 0


@rule(step=Sweep)
class CCD(NamedTuple):
    """Cyclic coordinate descent: each joint in turn, the one nearest the tip first, moves the tip as near the target as it can.

    For a position the best move of a joint has a closed form. For a pose each joint takes the least-squares step on the six errors
    instead, which is kept if the error falls. Several tips are treated as poses are. Source: Wang and Chen, IEEE Trans. Robotics
    and Automation 7 (1991); Olsen and Petersen (2011) for positions.
    """

    def pack(self, robot: Any, asked: Asked | None = None) -> Sweep:
        """Return the compiled step of CCD, which is the same for every robot and task."""
        return Sweep(1e-14)
