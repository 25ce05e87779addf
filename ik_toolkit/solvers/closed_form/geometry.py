"""Functions shared by the closed forms: reading a chain's joint screws, and shifting joint angles by 2 pi into the limits.

A structure is recognised from geometry alone: every joint's axis is read at q = 0 from the Jacobian, so names, axis signs, angle
offsets, intermediate frames and the pose of the base do not matter.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import cached, inline, shared
from ...kernel.algebra import at3
from ...kernel.chain import Chain, evaluate
from ...kernel.checks import CODE
from ...kernel.counted_error import KIND
from ...kernel.kinematics import TAU, aim, fk, pose_error, rotation_angle
from ...kernel.limits import LIGHTEST, legal
from ...kernel.records import SIZE, Answer, Ends, Orders, read, write

# A robot fits a closed form exactly if its axes deviate by less than FIT [rad, or length / reach] from what the form
# assumes.
FIT = 1e-9
# A robot does not fit a closed form if its axes deviate by more than NEAR [rad, or length / reach] from what the form
# assumes. Robot files written with five digits are off by up to 1e-4, and Newton steps correct that.
NEAR = 1e-4
SNAP = 1e-9  # [rad or m] a joint value that exceeds a limit by less than this is put on the limit


class Fit(NamedTuple):
    """The result of comparing a chain with the geometry that a closed form assumes."""

    # the numbers (link lengths, axes, ...) from which the closed form computes; empty if the chain does not fit
    parameters: np.ndarray
    reason: str  # The reason why the chain does not fit, or ''.
    off: float  # By how much the axes deviate from what the form assumes [rad, or length / reach].


def no_fit(reason: str) -> Fit:
    """Return the Fit of a chain for which a closed form cannot be used, with the reason."""
    return Fit(np.zeros(0), reason, math.inf)


class Family(NamedTuple):
    """A continuum of solutions (self-motion).

    `joints` names the joints that move along it, the leading one first; `lower` and `upper` are the range of the leading joint [rad
    or m], or None if the family was found numerically and not followed to its ends; `message` is one sentence. On a curve of an arm
    of seven joints, the range may leave the limits of a joint that has a full turn or more: whole turns lead back into them.
    """

    joints: tuple[str, ...]
    lower: float | None
    upper: float | None
    message: str


class Branches(NamedTuple):
    """The solutions (branches) that a closed form lists for one target, and what is known about the list."""

    # (K, n) joint values of the branches [rad or m]; angles are shifted by 2 pi k to be nearest a reference, such as q0
    q: np.ndarray
    broken: np.ndarray  # (K,) by how much [rad or m] each branch exceeds its most exceeded joint limit
    marks: np.ndarray  # (K, 3) signs of shoulder, elbow and wrist; 0 where two branches merge or there is no such joint
    complete: bool  # Whether it is proven that there are no other branches.
    # text for the message of a solve: at which value of a prismatic joint the branches are, such as ' at lift 0.2 m'; or ''
    words: str
    families: tuple[Family, ...] = ()  # Continuous families of solutions, of which the branches are a sample.
    steps: int = 0  # Number of Newton steps that refine each branch on the actual chain.
    fixed: int = -1  # index in q of a joint that refining by Newton steps must not move, or -1
    partial: bool = False  # whether the list is known to lack some solutions, so that a search must add them
    certificate: Any = None  # Evidence that the list is complete (`elimination.Certificate`), or None.


class Screws(NamedTuple):
    """The joint axes of a chain at q = 0, in the axes of the base."""

    turns: np.ndarray  # (n,) whether each joint is revolute
    axis: np.ndarray  # unit direction of each joint axis (n, 3)
    point: np.ndarray  # The point (n, 3) [m] of a revolute joint's axis that is nearest the tip.
    T: np.ndarray  # The pose T_base_tip (4, 4) [m].


def read_screws(chain: Chain) -> Screws | str:
    """Return the joint axes of a chain at q = 0; if one coordinate moves several joints (mimic), return a text that says so.

    A mimic joint rules out a closed form.
    """
    if not chain.plain:
        return "it has mimic joints"
    # Only NumPy is used here, so that recognising a robot does not wait for the compiler.
    T, J = evaluate(chain.rows, chain.ends, np.zeros((1, chain.n)), chain.unit, jacobian=True)
    linear, angular = J[0, :3].T, J[0, 3:].T
    turns = chain.rows[:, 9] > 0.0
    axis = np.where(turns[:, None], angular, linear)
    return Screws(turns, axis, T[0, :3, 3] + np.cross(angular, linear), T[0])


def read_revolute(chain: Chain, count: int) -> Screws | str:
    """Return the joint axes of a chain of `count` revolute joints, or a text with the reason why it is not such a chain."""
    if chain.n != count:
        return f"it has {chain.n} joints on the path, not {count}"
    screws = read_screws(chain)
    if isinstance(screws, str) or screws.turns.all():
        return screws
    return "one of its joints is prismatic; all must be revolute"


def angle_about(axis: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Return the angle [rad] about `axis` that rotates `start` into `end`; unit vectors, the last two perpendicular to `axis`."""
    return math.atan2(float(axis @ np.cross(start, end)), float(start @ end))


def across(axis: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the component of v (3,) perpendicular to the unit vector `axis`."""
    return v - axis * (axis @ v)


@shared
def legal_turn(angle, low, high, near):
    """Shift an angle by 2 pi k into [low, high] (all [rad]); of several values in this range, take the one nearest to `near`.

    Returns the angle, and by how much it is outside [low, high]; 0 if it is inside.
    """
    x = angle + TAU * np.rint((near - angle) / TAU)
    if x > high + SNAP:
        x -= TAU * math.ceil((x - high - SNAP) / TAU)
    if x < low - SNAP:
        y = x + TAU * math.ceil((low - SNAP - x) / TAU)
        if y <= high + SNAP or y - high < low - x:
            x = y
    return clamp(x, low, high)


@shared
def clamp(x, low, high):
    """Return x, moved onto a limit (low or high) that it exceeds by less than SNAP, and by how much it still exceeds one."""
    if x > high:
        return (high, 0.0) if x - high <= SNAP else (x, x - high)
    if x < low:
        return (low, 0.0) if low - x <= SNAP else (x, low - x)
    return x, 0.0


@shared
def one_turn(low, high, near):
    """Return a part of the joint range [low, high], at most one turn wide and about `near`, that holds every angle modulo 2 pi."""
    start = max(low, min(near - 0.5 * TAU, high - TAU))
    return start, min(start + TAU, high)


@cached
def into_limits(Q, box, out, excess):
    """Fill out (K, n) with solutions Q (K, n) [rad], each angle shifted by 2 pi k into its limits and near a reference.

    The rows of box (at least 3, n) are lower limits, upper limits and reference [rad]. excess (K, n) receives by how much each
    joint breaks its limits [rad].
    """
    for k in range(Q.shape[0]):
        for i in range(Q.shape[1]):
            out[k, i], excess[k, i] = legal_turn(Q[k, i], box[0, i], box[1, i], box[2, i])


@inline
def copy_limits(ends, opt, q0, box):
    """Fill the rows of box (4, n): lower limits, upper limits, reference (q0 if given, else home) [rad or m], distance weights.

    ends: limits of the chain (`records.Ends`); opt: option array (`records.Orders`); q0 (n,): start of the call. Returns False,
    with box unfinished, if the caller gave a start that is not finite or, if limits are kept, outside them.
    """
    n = box.shape[1]
    o, chain = read(Orders, opt), Ends(ends, n)
    limited = o.limits > 0.0
    if o.given > 0.0 and not legal(q0, chain, limited):
        return False
    for i in range(n):
        unit = chain.unit(i)
        box[0, i] = chain.lower(i) * unit if limited else -np.inf
        box[1, i] = chain.upper(i) * unit if limited else np.inf
        box[2, i] = q0[i] if o.given > 0.0 else chain.home(i) * unit
        box[3, i] = 1.0 / (max(opt[SIZE.weights + i], LIGHTEST) * unit * unit)
    return True


@inline
def measure_tip(rows, ends, opt, T, q, box, broken, gap, slack, goal, joints, trig, hist, out):
    """Compute the errors of the answer q (n,) [rad or m] of a closed form, and write q, errors and status to the result row `out`.

    rows, ends, opt: geometry, limits and options of the chain; T (4, 4): target; box (4, n): see `copy_limits`. broken: by how
    much the best branch exceeds a limit; gap: how far [m] the target is out of reach with its orientation kept; slack: how much of
    that [m] the orientation tolerance may make up for. goal, joints, trig: scratch, see `kinematics.room`; hist: a row of history,
    or none.
    """
    n = box.shape[1]
    o, chain = read(Orders, opt), Ends(ends, n)
    for i in range(n):
        q[i] = min(max(q[i], box[0, i]), box[1, i])
        out[SIZE.answer + i] = q[i]
        q[i] /= chain.unit(i)
    aim(chain, T, goal)
    now = fk(rows, q, joints, trig)
    linear, angular = pose_error(goal, now.axes, now.point + now.axes.times(at3(ends, 21)))
    position = math.sqrt(linear.square()) * chain.scale()
    rotation = 0.0 if int(opt[SIZE.orders]) == KIND.position else rotation_angle(angular.square())
    if position < o.tol_p and rotation < o.tol_r:
        status = CODE.converged
    elif gap >= o.tol_p + slack:
        status = CODE.unreachable
    elif broken > 0.0 and gap < o.tol_p:
        status = CODE.limit_blocked
    else:
        status = CODE.stalled  # This status leaves open whether there is a solution.
    noted = 0.0
    if hist.shape[0] > 0:
        noted = 1.0
        hist[0, 0] = position
        hist[0, 1] = rotation
        hist[0, 2] = 0.0
        for i in range(n):
            hist[0, SIZE.past + i] = out[SIZE.answer + i]
    excess = gap if status == CODE.unreachable else 0.0
    write(out, 0, Answer(float(status), 0.0, 0.0, position, rotation, 1.0, noted, excess, 0.0, -1.0, 0.0))
