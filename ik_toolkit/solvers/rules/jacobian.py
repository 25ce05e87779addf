"""Rules that use the Jacobian: pseudo-inverse, transpose, damped least squares, Newton-Raphson, Levenberg-Marquardt.

Each class is a rule: its fields are its parameters, which its compiled `step` reads.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from ...compile.jit import compiled
from ...kernel.limits import integrate
from ...kernel.linalg import lu_solve
from ...kernel.search import SINGULAR_STEP, WAITING
from ...text import how_many
from ...validate import switch
from ..protocol import Asked, rule

FLOOR = 1e-12  # smallest damping in J J' + damping I, needed because J J' of a planar arm has no inverse


def negative(name: str, value: Any) -> str:
    """Return an error text that the parameter `name` must be at least 0 if `value` is negative, otherwise ''."""
    return f"needs a {name} of at least 0, not {value:g}" if isinstance(value, int | float) and value < 0 else ""


@rule
class LM(NamedTuple):
    """Levenberg-Marquardt: dq = J'(J J' + damping |e|^2 I)^-1 e; joints pushed past a limit are held and the step is repeated.

    Source: Sugihara, IEEE Trans. Robotics 27 (2011), eq. (11); held joints as an active set.

    Args:
        damping: Factor of the squared error, whose lengths are divided by the robot's reach.
    """

    damping: float = 0.02
    hold = True
    wrap = True

    def refuses(self, asked: Asked) -> str:
        """Return why the rule cannot solve this task or work with its parameters, or '' if it can."""
        return negative("damping", self.damping)

    def lanes(self) -> Callable:
        """Return the compiled function that solves eight targets side by side, see `kernel.simd_search.lanes`."""
        from ...kernel.simd_search import lanes

        return lanes()

    def step(self, p, e):
        p.damped(e, self.damping * e.ee + FLOOR)
        return 0


@rule
class DLS(NamedTuple):
    """Damped least squares: dq = J'(J J' + damping^2 I)^-1 e with constant damping.

    Source: Wampler, IEEE Trans. SMC 16 (1986); Buss (2004), eq. (11).

    Args:
        damping: The damping lambda, for errors whose lengths are divided by the robot's reach (scale).
        hold: Whether a step is computed again without the joints that it would push past a limit. False cuts the step off at
            the limit, as the published method does.
    """

    damping: float = 0.03
    hold: bool = True

    def refuses(self, asked: Asked) -> str:
        """Return why the rule cannot solve this task or work with its parameters, or '' if it can."""
        return negative("damping", self.damping)

    def step(self, p, e):
        p.damped(e, self.damping * self.damping + FLOOR)
        return 0


@rule
class Pinv(NamedTuple):
    """Pseudo-inverse: dq = gain pinv(J) e by singular values.

    Limits are kept only by clamping q. Source: Whitney, IEEE Trans. Man-Machine Systems 10 (1969); Burrell et al.
    (2016), eqs. (7)-(8).

    Args:
        gain: Factor of the step; 1 is the whole step.
        rcond: Singular values below this fraction of the largest count as zero.
    """

    gain: float = 1.0
    rcond: float = 1e-8

    def refuses(self, asked: Asked) -> str:
        """Return why the rule cannot solve this task or work with its parameters, or '' if it can."""
        return negative("gain", self.gain)

    def step(self, p, e):
        s = p.desk
        for i in range(s.q.shape[0]):
            if not s.w[i] > 0.0:
                for k in range(s.J.shape[1]):
                    s.J[i, k] = 0.0
        p.pseudo(e, self.rcond)
        for i in range(s.dq.shape[0]):
            s.dq[i] *= self.gain
        return 0


@rule
class Transpose(NamedTuple):
    """Jacobian transpose: dq = gain alpha J'e with alpha = <e, JJ'e> / <JJ'e, JJ'e>, the best step along J'e to first order.

    Where J'e = 0, alpha is 0/0 and the arm does not move. Source: Buss (2004), eq. (8); Burrell et al. (2016), eqs.
    (11)-(12).

    Args:
        gain: Factor of the step; 1 is the whole step.
    """

    gain: float = 1.0

    def refuses(self, asked: Asked) -> str:
        """Return why the rule cannot solve this task or work with its parameters, or '' if it can."""
        return negative("gain", self.gain)

    def step(self, p, e):
        s = p.desk
        n, m = s.J.shape
        p.stack(e)
        top = 0.0
        for i in range(n):
            g = 0.0
            for k in range(m):
                g += s.J[i, k] * s.y[k]
            s.dq[i] = s.w[i] * g
            top += s.w[i] * g * g
        below = 0.0
        for k in range(m):
            g = 0.0
            for i in range(n):
                g += s.J[i, k] * s.dq[i]
            below += g * g
        alpha = self.gain * top / below if below > 0.0 else 0.0
        for i in range(n):
            s.dq[i] *= alpha
        return 0


@compiled
class Inverse(NamedTuple):
    """The compiled step of Newton-Raphson: the Jacobian is inverted by LU decomposition."""

    # largest number of times that the line search halves the step; 0 takes the whole step without a trial
    trials: float

    def step(self, p, e):
        s = p.desk
        n, m = s.J.shape
        p.stack(e)
        for k in range(m):
            for i in range(min(n, m)):
                s.A[k, i] = s.J[i, k]
        if n > m or not lu_solve(s.A, s.y, n, m):
            return SINGULAR_STEP
        for i in range(n):
            s.dq[i] = s.y[i]
        return self.shorten(p, e) if self.trials > 0.0 else 0

    def shorten(self, p, e):
        """Line search: halve the step s.dq until it lowers the squared error e.ee inside the limits; set it to 0 if none does.

        Returns WAITING if the evaluations run out first, else 0. s = p.desk is the scratch of the problem p; e: the errors at s.q.
        """
        s = p.desk
        for i in range(s.q.shape[0]):
            s.x[i] = s.q[i]
        done, cut = False, False
        for _ in range(int(self.trials)):
            cut = not s.affords(1)
            if done or cut:
                break
            integrate(s.q, s.dq, p.boxed, p.bounds_of_step())
            done = p.try_out(s.q).ee < e.ee
            for i in range(s.q.shape[0]):
                s.q[i] = s.x[i]
                s.dq[i] *= 1.0 if done else 0.5
        if not done:
            for i in range(s.q.shape[0]):
                s.dq[i] = 0.0
        return WAITING if cut and not done else 0


@rule(step=Inverse)
class Newton(NamedTuple):
    """Newton-Raphson: dq = J^-1 e, for tasks with as many rows as joints; it ends as SINGULAR where J has no inverse.

    Source: Chinyai, eqs. (6)-(9), planar 2R. There the error is f(q) - x with a minus sign, here it is target - actual.
    `newton_certificate` says where the whole step provably converges.

    Args:
        line_search: Whether the step is halved until the squared error falls. Each trial is an evaluation.
    """

    line_search: bool = False

    def refuses(self, asked: Asked) -> str:
        """Return why the rule cannot solve this task or work with its parameters, or '' if it can."""
        switch(self.line_search, "line_search")
        n = asked.robot.n
        if asked.rows == n:
            return ""
        return (
            f"needs as many task rows as joints, and here the task has {asked.rows} and the path {how_many(n, 'joint')}"
        )

    def pack(self, robot: Any, asked: Asked | None = None) -> Inverse:
        """Return the compiled step of Newton-Raphson, with the number of trials of its line search."""
        return Inverse(40.0 if self.line_search else 0.0)  # After 40 halvings a trial is 1e-12 of the whole step.
