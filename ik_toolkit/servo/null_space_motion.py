"""What a tracker does besides its task: slack (dead bands) as inequalities, secondary null-space motion, free rotations.

The options of the null space are checked once (`Secondary`); the compiled part turns them into a motion at every step.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..compile.jit import compiled, inline, inner
from ..copying import Holds
from ..errors import InvalidOption, floats, near_match
from ..kernel.limits import LIMIT
from ..kernel.records import copy
from ..kernel.vectors import add_multiple, apply_transposed, clear, largest
from ..validate import number
from .laws import apply
from .workspace import STATE

# share of a joint's range, at each end of it, in which null-space motion moves the joint away from the limit
FADING = 0.15
# [rad, m or arm reaches] step of the difference quotients in this file; their error is about step^2 + 1e-16 / step
STEP = 1e-5


@compiled
class SlackRules(NamedTuple):
    """Constants by which an error with a slack (dead band) is kept inside the slack."""

    # an error inside its slack may use up at most this share of the distance to the end of the slack in one sample
    nearly: float = 0.5
    # An error that exceeds its slack by more than `far` [arm reaches, rad] is closed like an error without slack. While the
    # inequalities that keep errors in their slack cannot be met, `beyond` [share of the slack] applies instead of `far`; a smaller
    # excess may be rounding.
    beyond: float = 1e-3
    far: float = 1e-2
    pressed: float = 0.1  # [s] how long errors that left their slack are closed like errors without slack


SLACK = SlackRules()


@inline
def reflect(flip, y):
    """Mirror the rotation components of y (m,), three per tip, in place, so that the axis of a free rotation becomes the last one.

    flip (F, 3): the unit normal of the mirror plane of each tip, zero for a tip without a free rotation.
    """
    for f in range(flip.shape[0]):
        k = 6 * f + 3
        s = 2.0 * (flip[f, 0] * y[k] + flip[f, 1] * y[k + 1] + flip[f, 2] * y[k + 2])
        if s != 0.0:
            for c in range(3):
                y[k + c] -= s * flip[f, c]


@inline
def bend(task, look, s, weighed):
    """Write to s.bias (m,) the tip's acceleration that comes from the change of J: (dJ/dt at the joint rates s.x1) s.x2.

    task, look: the compiled problem and its evaluation at s.at; s: `Bench`; weighed: whether to multiply by the errors' weights.
    """
    if task.plain():
        task.bending(look, s.x1, s.x2, s.bias)
    else:
        by_difference(task, s)
    if weighed:
        for k in range(s.bias.shape[0]):
            s.bias[k] *= s.weight[k]


@inline
def by_difference(task, s):
    """Write (dJ/dt at the joint rates s.x1) s.x2 to s.bias by central differences, for free rotations or a moving target frame."""
    n, m = task.desk.J.shape
    size = largest(s.x1)
    clear(s.bias)
    if size > 0.0:
        for sign in (1.0, -1.0):
            copy(s.at, s.probe)
            add_multiple(s.probe, sign * STEP / size, s.x1, n)
            task.stand(s.probe)
            task.jacobian(task.see())
            for i in range(n):
                add_multiple(s.bias, sign * 0.5 * size / STEP * s.x2[i], task.desk.J[i], m)
    reflect(s.flip, s.bias)
    for k in range(s.bias.shape[0]):
        if s.weight[k] == 0.0:
            s.bias[k] = 0.0


@inner
def mirror_free_rows(flip, J, e):
    """Mirror J (n, m) and the error e (m,) at the planes flip (F, 3) as `reflect` does; set components about free axes to zero."""
    reflect(flip, e)
    for f in range(flip.shape[0]):
        if flip[f, 0] != 0.0 or flip[f, 1] != 0.0 or flip[f, 2] != 0.0:
            e[6 * f + 5] = 0.0
    for i in range(J.shape[0]):
        reflect(flip, J[i])
        for f in range(flip.shape[0]):
            if flip[f, 0] != 0.0 or flip[f, 1] != 0.0 or flip[f, 2] != 0.0:
                J[i, 6 * f + 5] = 0.0


@inner
def weigh(weight, J, e, ahead, f, a):
    """Multiply the task's rows by their weights (m,), in place, and return the largest weight.

    J (n, m), errors e and ahead, target twist f and acceleration a (m,).
    """
    most = 0.0
    for k in range(e.shape[0]):
        w = weight[k]
        most = max(most, w)
        e[k], ahead[k], f[k], a[k] = w * e[k], w * ahead[k], w * f[k], w * a[k]
        for i in range(J.shape[0]):
            J[i, k] *= w
    return most


@inner
def slack_rows(slack, s, count, h, state):
    """Replace errors with a slack (dead band) by inequalities, from row `count` of s.planes on; return the new count.

    slack (m,): 0 for an error without slack; s: `Bench`; h [s]: the step. Inside the band, an error may come closer to its edge by
    at most the share SLACK.nearly of the distance in one sample; slightly outside, it is brought back. An error further outside
    stays in the task, reduced by its slack. While inequalities block the task or contradict the limits (STATE.pressed), every error
    outside its band stays in the task, because hard inequalities would then let joints turn at full speed.
    """
    n, m = s.J.shape
    e = s.e
    pressed = state[STATE.pressed]
    state[STATE.pressed] = max(pressed - h, 0.0)
    for k in range(m):
        if not slack[k] > 0.0:
            continue
        inside = min(max(e[k], -slack[k]), slack[k])
        if abs(e[k] - inside) > (SLACK.beyond * slack[k] if pressed > 0.0 else SLACK.far):
            state[STATE.pressed] = SLACK.pressed
            e[k] -= inside
            s.ahead[k] -= inside
            continue
        for sign in (1.0, -1.0):
            for i in range(n):
                s.planes[count, i] = -sign * s.J[i, k]
            s.edges[count] = SLACK.nearly * (slack[k] - sign * e[k]) / h - sign * s.f[k]
            count += 1
        for i in range(n):
            s.J[i, k] = 0.0
        s.weight[k], e[k], s.f[k], s.ahead[k], s.a[k] = 0.0, 0.0, 0.0, 0.0, 0.0
    return count


@inner
def away_from_limits(q, limits, gain, g):
    """Add to g (n,) a joint velocity away from near position limits, which grows smoothly from 0 inside the range.

    q (n,): joint values; limits (4, n): lower and upper in the first two rows; gain [1/s].
    """
    for i in range(q.shape[0]):
        lower, upper = limits[LIMIT.lowest, i], limits[LIMIT.highest, i]
        wide = upper - lower
        if not (wide < np.inf and wide > 0.0):
            continue
        for sign in (1.0, -1.0):
            left = (upper - q[i]) if sign > 0.0 else (q[i] - lower)
            t = 1.0 - left / (FADING * wide)
            if t > 0.0:
                g[i] -= sign * gain * FADING * wide * t * t


@inner
def scale_secondary(g, x, low, top):
    """Scale the secondary motion g (n,) to use at most half of the margin between the rates x (n,) and their bounds low, top."""
    scale = 1.0
    for i in range(x.shape[0]):
        if g[i] > 0.0:
            room = 0.5 * max(top[i] - x[i], 0.0)
        else:
            room = 0.5 * max(x[i] - low[i], 0.0)
        if abs(g[i]) > room:
            scale = min(scale, room / abs(g[i]))
    for i in range(x.shape[0]):
        g[i] *= scale


@inner
def into_null_space(J, m, G, y, t, g, part):
    """Project joint rates g (n,) into the null space of the task, in place: g -= J^+ J g, with the factor G that `factor` wrote.

    t, y, part: scratch.
    """
    apply_transposed(J, g, t)
    apply(J, m, G, t, y, part)
    for i in range(g.shape[0]):
        g[i] -= part[i]


# [1/s] gain of the motion away from limits; at the limit itself a joint moves 15 % of its range in a second
AVOID = 1.0
POSTURE = 1.0  # [1/s] gain of the motion towards a posture


class Secondary(Holds):
    """What a `Tracker` does with redundant joints: its options for motion in the null space, checked and as numbers."""

    FUNCTION = "cost"

    def __init__(self, robot: Any, avoid: float, nimble: float, wish: np.ndarray, sides: np.ndarray, cost: Any) -> None:
        """Store the options; wish (3, n): posture [rad or arm reaches], gain towards it [1/s], and an additional velocity."""
        self.robot, self.avoid, self.nimble, self.wish, self.sides, self.cost = robot, avoid, nimble, wish, sides, cost
        # whether the caller's cost or the manipulability must be evaluated before every step
        self.each_step = cost is not None or nimble > 0.0

    def confine(self, limits: np.ndarray) -> None:
        """Narrow the position limits in limits (4, n), in place, to the side of zero that the option `elbow` gives for a joint."""
        limits[LIMIT.lowest] = np.where(self.sides > 0.0, np.maximum(limits[LIMIT.lowest], 0.0), limits[LIMIT.lowest])
        limits[LIMIT.highest] = np.where(
            self.sides < 0.0, np.minimum(limits[LIMIT.highest], 0.0), limits[LIMIT.highest]
        )

    def side(self, away: np.ndarray) -> None:
        """Write to away (n,) the direction in which joints leave a straight, singular pose.

        Without the option `elbow` its entries are 1 for all joints. With it, they are 1 or -1 for the joints that it names, and 0
        for the others.
        """
        away[:] = self.sides if self.sides.any() else 1.0

    def look(self, q: np.ndarray) -> None:
        """Set the desired null-space velocity, wish[2], to lower the cost and raise manipulability at q (n,) [rad or arm reaches].

        Raises InvalidOption if the cost is not finite or has a wrong shape.
        """
        unit = self.robot.chain.unit
        at = q * unit
        slope = np.zeros(len(at))
        if self.cost is not None:
            given = floats(self.cost(at.copy()), f"cost must return a number or its slope ({len(at)},)", InvalidOption)
            slope = self._slope(self.cost, at) if given.shape == () else given
            if slope.shape != at.shape:
                raise InvalidOption(f"cost must return a number or its slope ({len(at)},), not shape {slope.shape}")
            if not np.isfinite(slope).all():
                name, told = getattr(self.cost, "__name__", type(self.cost).__name__), np.array2string(at, precision=4)
                what = "is not finite" if np.isfinite(given).all() or given.shape else f"is {given:g}"
                raise InvalidOption(f"cost ({name}) {what} at or beside q = {told}")
        if self.nimble > 0.0:
            slope = slope - self.nimble * self._slope(self._volume, at)
        self.wish[2] = -slope / unit

    def _slope(self, cost: Callable, at: np.ndarray) -> np.ndarray:
        """Return the gradient (n,) of a scalar function by central differences."""
        steps = STEP * np.eye(len(at))
        return np.array([(float(cost(at + d)) - float(cost(at - d))) / (2.0 * STEP) for d in steps])

    def _volume(self, q: np.ndarray) -> float:
        """Return the logarithm of the manipulability (the product of the singular values of J) at q (n,) [rad or m]."""
        J = self.robot.chain.forward(q, jacobian=True)[1][0]
        return float(np.log(np.maximum(np.linalg.svd(J, compute_uv=False), STEP)).sum())


def read_secondary(
    robot: Any, avoid_limits: Any, posture: Any, elbow: Any, manipulability: Any, cost: Any
) -> Secondary:
    """Check the null-space options of a `Tracker` and return them as numbers.

    Raises InvalidOption, InvalidConfiguration.
    """
    if isinstance(avoid_limits, bool | np.bool_):
        avoid = AVOID if avoid_limits else 0.0
    else:
        avoid = number(avoid_limits, "avoid_limits [1/s]")
    nimble = number(manipulability, "manipulability [1/s]")
    if avoid < 0.0 or nimble < 0.0:
        raise InvalidOption("avoid_limits and manipulability must not be negative")
    n, unit = robot.n, robot.chain.unit
    wish = np.zeros((3, n))
    if posture is not None:
        rate = POSTURE
        if isinstance(posture, tuple) and len(posture) == 2 and np.ndim(posture[0]) == 1:
            posture, rate = posture[0], number(posture[1], "the rate of posture [1/s]")
            if rate < 0.0:
                raise InvalidOption("the rate of posture must not be negative")
        wish[0], wish[1] = robot.check_q(posture, "posture") / unit, rate
    sides = np.zeros(n)
    if elbow is not None:
        if not isinstance(elbow, Mapping):
            raise InvalidOption(f"elbow is a dict from joint names to 1 or -1, not {elbow!r:.60}")
        for joint, side in elbow.items():
            if joint not in robot.joint_names:
                raise InvalidOption(f"elbow: no joint '{joint}'.{near_match(joint, robot.joint_names)}")
            sign = floats(side, f"elbow of {joint} must be 1 or -1", InvalidOption)
            if sign.ndim or abs(sign) != 1.0:
                raise InvalidOption(f"elbow of {joint} must be 1 or -1, not {side!r:.60}")
            sides[robot.joint_names.index(joint)] = sign
    if cost is not None and not callable(cost):
        raise InvalidOption(f"cost is a function of q, not {type(cost).__name__}")
    return Secondary(robot, avoid, nimble, wish, sides, cost)
