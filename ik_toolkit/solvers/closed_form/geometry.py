"""What the closed forms share: reading a chain's joint screws, and bringing joint angles to legal turns.

A structure is recognised from geometry alone: every joint's axis is read at q = 0 from the Jacobian, so names, axis signs,
angle offsets, intermediate frames and the pose of the base do not matter.
"""

import math
from typing import NamedTuple

import numpy as np

from ...kernel import slots
from ...kernel.chain import Chain
from ...kernel.checks import CONVERGED, LIMIT_BLOCKED, STALLED, UNREACHABLE
from ...kernel.jit import inline, jit
from ...kernel.kinematics import TAU, aim, error, fk, rotation_angle
from ...kernel.limits import legal
from ...kernel.task import POSITION

FIT = 1e-9  # how far [rad, or of the reach] axes may be off a structure that is taken as exact
NEAR = 1e-4  # how far off they may be at all: what people write with five digits is, and Newton's steps mend it
SNAP = 1e-9  # an answer this little [rad or m] beyond a limit is put on it


class Fit(NamedTuple):
    """How a chain fits a structure."""

    parameters: np.ndarray  # numbers of the closed form; empty where it does not fit
    reason: str  # why it does not fit, or ''
    off: float  # how far its axes are off the structure [rad, or of the reach]


def no_fit(reason: str) -> Fit:
    """Say why a chain does not fit."""
    return Fit(np.zeros(0), reason, math.inf)


class Family(NamedTuple):
    """A continuum of solutions.

    joints: names of the joints that move along it, the leading one first; lower, upper: range of the leading joint [rad or m],
    None where the family was found numerically and not followed to its ends; message: one sentence.
    """

    joints: tuple[str, ...]
    lower: float | None
    upper: float | None
    message: str


class Branches(NamedTuple):
    """What a closed form lists for one target."""

    q: np.ndarray  # (K, n) branches [rad or m], at the turn nearest the reference
    broken: np.ndarray  # (K,) by how much each breaks a limit
    marks: np.ndarray  # (K, 3) signs of shoulder, elbow and wrist
    complete: bool  # whether these are proven to be all
    words: str  # where they are, for the message
    families: tuple[Family, ...] = ()  # of which the rows are a sample
    steps: int = 0  # Newton steps that finish each on the real chain
    fixed: int = -1  # place of a joint that those steps do not move
    partial: bool = False  # whether the closed form is known to miss some, so that a search has to add them


class Screws(NamedTuple):
    """Joint axes of a chain at q = 0 in base axes [m]."""

    turns: np.ndarray  # (n,) True where the joint turns
    axis: np.ndarray  # (n, 3) unit direction
    point: np.ndarray  # (n, 3) the axis' point nearest the tip (turning joints)
    T: np.ndarray  # (4, 4) T_base_tip


def read_screws(chain: Chain) -> Screws | str:
    """Return the joint screws at q = 0, or a sentence when a coordinate drives several joints (mimic)."""
    if not chain.rows[0, 0] > 0.0:
        return "it has mimic joints"
    T, J = chain.forward(np.zeros(chain.n), jacobian=True)
    linear, angular = J[0, :3].T, J[0, 3:].T
    turns = chain.rows[:, 9] > 0.0
    axis = np.where(turns[:, None], angular, linear)
    return Screws(turns, axis, T[0, :3, 3] + np.cross(angular, linear), T[0])


def angle_about(axis: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Angle [rad] that turns direction `start` into `end` about `axis` (all unit, start and end across the axis)."""
    return math.atan2(float(axis @ np.cross(start, end)), float(start @ end))


def across(axis: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Part of v (3,) perpendicular to the unit axis."""
    return v - axis * (axis @ v)


@jit
def legal_turn(angle, low, high, near):
    """Angle + k 2 pi inside [low, high] nearest to `near`, and by how much it breaks the limits (0 when legal)."""
    x = angle + TAU * np.rint((near - angle) / TAU)
    if x > high + SNAP:
        x -= TAU * math.ceil((x - high - SNAP) / TAU)
    if x < low - SNAP:
        y = x + TAU * math.ceil((low - SNAP - x) / TAU)
        if y <= high + SNAP or y - high < low - x:
            x = y
    return clamp(x, low, high)


@jit
def clamp(x, low, high):
    """x, put on a limit it passes by less than SNAP, and by how much it breaks the limits otherwise."""
    if x > high:
        return (high, 0.0) if x - high <= SNAP else (x, x - high)
    if x < low:
        return (low, 0.0) if low - x <= SNAP else (x, low - x)
    return x, 0.0


@jit
def legal_start(ends, opt, q0):
    """Whether a start (n,) [rad or m] is finite and, when limits count, inside them."""
    n = q0.shape[0]
    v = slots.E_VECTORS
    unit, turns = ends[v + 3 * n : v + 4 * n], ends[v + 2 * n : v + 3 * n]
    return legal(q0, unit, ends[v : v + n], ends[v + n : v + 2 * n], turns, opt[slots.O_LIMITS] > 0.0)


@jit
def copy_limits(ends, opt, q0, box):
    """Fill box (4, n) with lower and upper limits, reference configuration [rad or m] and distance weights."""
    n = box.shape[1]
    v = slots.E_VECTORS
    for i in range(n):
        unit = ends[v + 3 * n + i]
        limited = opt[slots.O_LIMITS] > 0.0
        box[0, i] = ends[v + i] * unit if limited else -np.inf
        box[1, i] = ends[v + n + i] * unit if limited else np.inf
        box[2, i] = q0[i] if opt[slots.O_GIVEN] > 0.0 else ends[v + 6 * n + i] * unit
        box[3, i] = 1.0 / (max(opt[slots.OPT_HEAD + i], 1e-12) * unit * unit)


@inline
def measure_tip(rows, ends, opt, T, q, box, broken, gap, slack, goal, Z, trig, hist, out):
    """Evaluate q with the kernel's forward kinematics and write the result row: errors and status are of that evaluation.

    broken: by how much the best branch breaks a limit; gap: how far [m] the target is out of reach with its orientation
    kept; slack: how much of that [m] the orientation's tolerance may make up for.
    """
    n = box.shape[1]
    scale = ends[slots.E_VECTORS + 7 * n]
    tip = ends[12:24]
    for i in range(n):
        q[i] = min(max(q[i], box[0, i]), box[1, i])
        out[slots.OUT_HEAD + i] = q[i]
        q[i] /= ends[slots.E_VECTORS + 3 * n + i]
    aim(ends, tip, scale, T, goal)
    x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz = fk(rows, q, Z, trig[0], trig[1], trig[2])
    px, py, pz, e0, e1, e2, e3, e4, e5 = error(goal, tip, x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz)
    position = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2) * scale
    rotation = 0.0 if opt[slots.O_KIND] == POSITION else rotation_angle(e3 * e3 + e4 * e4 + e5 * e5)
    if position < opt[slots.O_TOL_P] and rotation < opt[slots.O_TOL_R]:
        out[slots.R_STATUS] = CONVERGED
    elif gap >= opt[slots.O_TOL_P] + slack:
        out[slots.R_STATUS] = UNREACHABLE
    elif broken > 0.0 and gap < opt[slots.O_TOL_P]:
        out[slots.R_STATUS] = LIMIT_BLOCKED
    else:
        out[slots.R_STATUS] = STALLED  # proves nothing
    out[slots.R_ITERATIONS] = 0
    out[slots.R_RESTARTS] = 0
    out[slots.R_ATTEMPT] = 0
    out[slots.R_POSITION] = position
    out[slots.R_ROTATION] = rotation
    out[slots.R_EVALUATIONS] = 1
    out[slots.R_EXCESS] = gap if out[slots.R_STATUS] == UNREACHABLE else 0.0
    out[slots.R_HISTORY] = 0
    if hist.shape[0] > 0:
        out[slots.R_HISTORY] = 1
        hist[0, 0] = position
        hist[0, 1] = rotation
        for i in range(n):
            hist[0, 2 + i] = out[slots.OUT_HEAD + i]
