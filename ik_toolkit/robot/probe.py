"""Makes the joint arrays of the compiled code from a Pinocchio model, by reading each joint's screw, whatever its type.

A joint's pose in its parent is placement . M(0) . exp(S q) with a constant S: its motion subspace, which holds the axis
and a mimic multiplier, while M(0) holds a mimic offset. Both are used directly, so no angle is ever extracted from a
matrix and none can wrap. Revolute, prismatic, continuous, unaligned and mimic joints need no special code; a joint that
moves along anything but one fixed screw is rejected by name.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import ModelError
from ..kernel.chain import ROW, WINDING, Chain, evaluate, pack
from .formats.urdf_values import reversed_advice
from .rotation import turn_onto

SAMPLES = 24  # The arrays for the compiled solvers are compared with Pinocchio at this many configurations.
# In comparisons with Pinocchio the size of a robot counts as at least this share of its distance from the origin of the model,
# because rounding errors grow with that distance.
FAR = 1e-5
# The arrays for the compiled solvers may differ from Pinocchio by this [rad, or share of the robot's size], a thousandth of the
# default tolerance of a solve.
AGREE = 1e-9
# Relative rounding error of a large angle: half an ulp (last digit), and as much again for its reduction modulo 2 pi.
HELD = 2.5e-16
# A limit of at least this [m, rad or per s] counts as none, because files write 1e16 or 1e308 for "no limit".
NO_LIMIT = 1e15
# A limit beyond 1e6 [rad or m] is read as 1e6, which the notes say.
# Near 1e7 rad one ulp (last digit) of an angle reaches AGREE.
# Near 1e9 m one ulp (last digit) of a length reaches a tenth of the default tolerance.
LARGEST_ANGLE, LARGEST_STROKE = 1e6, 1e6
# Two axes count as parallel if the sine of the angle between them is below this, the rounding of a few matrix products.
PARALLEL = 1e-14
# A configuration is unsuitable as home if the smallest singular value of its Jacobian (lengths over reach) is below this.
SINGULAR = 0.02


class JointPath(NamedTuple):
    """The joints between base and tip of a Pinocchio model, and where their n coordinates are in its configuration (nq,)."""

    joints: list[int]  # Ids of the joints, from base to tip.
    # Of the joints of the path, the first `up` lead from the base towards the root, the others from there to the tip.
    up: int
    # The id of the joint of each coordinate, in the order of the path; a mimic joint counts as its leader.
    leaders: list[int]
    # The first `own` coordinates move the tip relative to the root. The others move only the base's branch of the model; they are
    # coordinates because they move another tip of a Tree.
    own: int
    owner: dict[int, int]  # By id of a joint that a coordinate moves (also mimic joints): the index of that coordinate.
    idx_q: np.ndarray  # For each of the n coordinates, where it begins in a Pinocchio configuration (nq,).
    circle: np.ndarray  # For each of the n coordinates, whether Pinocchio stores it as cosine and sine.


def mimics(model: pin.Model) -> dict[int, tuple[int, float, float]]:
    """Return for each mimic joint of a Pinocchio model, by id: the id of its leader, the ratio, and the offset [rad or m]."""
    followers = zip(model.mimicking_joints, model.mimicked_joints, strict=True)
    found = ((j, leader, model.joints[j].extract()) for j, leader in followers)
    return {j: (leader, joint.scaling, joint.offset) for j, leader, joint in found}


class Motionless(ModelError):
    """Raised if no joint moves the tip relative to the base."""


def find_path(model: pin.Model, base: int, tip: int, locked: set[int], others: Sequence[int] = ()) -> JointPath:
    """Find the joints from a base frame to a tip frame, given by frame id, and the coordinates that move the tip.

    Coordinates are the joints above the tip that are not `locked` (ids), where a mimic joint counts as its leader. If the base is
    on another branch, the joints of its branch rest, unless they mimic (or lead) a coordinate or are in `others`: ids of joints
    that move for another tip of a Tree. Raises Motionless, ModelError.
    """

    def above(frame: int) -> list[int]:
        joints = []
        j = model.frames[frame].parentJoint
        while j:
            joints.append(j)
            j = model.parents[j]
        return joints

    up, down = above(base), above(tip)[::-1]
    shared = set(up) & set(down)
    up, down = ([j for j in joints if j not in shared] for joints in (up, down))
    ties = mimics(model)
    lead = {j: leader for j, (leader, _, _) in ties.items()}
    still = {j for j, (_, ratio, _) in ties.items() if ratio == 0.0}
    leaders: list[int] = []
    for j in down:
        leader = lead.get(j, j)
        if leader in locked or j in still:
            continue
        if model.joints[leader].nv != 1:
            raise ModelError(
                f"joint '{model.names[j]}' on the path to '{model.frames[tip].name}' is a {model.joints[j].shortname()} "
                "with more than one degree of freedom; only revolute, continuous, prismatic and mimic joints are supported"
            )
        if leader not in leaders:
            leaders.append(leader)
    own = len(leaders)
    carry = {lead.get(j, j) for j in up if j not in still}
    leaders += [j for j in others if j in carry and j not in locked and j not in leaders]
    if not leaders:
        ends = f"base '{model.frames[base].name}' and tip '{model.frames[tip].name}'"
        below = [j for j in up if j not in locked]
        resting = f" but those that carry the base ({', '.join(model.names[j] for j in below)}), which rest"
        raise Motionless(f"no moving joint between {ends}{resting * bool(below)}: nothing to solve")
    joints = up + down
    place = {j: i for i, j in enumerate(leaders)}
    owner = {
        j: place[leader] for j in range(1, model.njoints) if (leader := lead.get(j, j)) in place and j not in still
    }
    idx_q = np.array([model.joints[j].idx_q for j in leaders])
    circle = np.array([model.joints[j].nq == 2 for j in leaders])
    return JointPath(joints, len(up), leaders, own, owner, idx_q, circle)


def _turns(model: pin.Model, j: int) -> bool:
    """Return whether joint j turns, so that its unit is rad and not m."""
    return bool(np.asarray(model.joints[j].createData().S).reshape(6)[3:].any())


def _leader_range(ratio: float, offset: float, low: float, high: float) -> tuple[float, float]:
    """Return the range of a leader q for which its follower ratio * q + offset, as rounded, stays inside low..high."""

    def end(value: float, inward: float) -> float:
        if abs(value) >= NO_LIMIT:
            return math.copysign(math.inf, value / ratio)
        step = inward * 2.0 * math.ulp(max(abs(value), abs(offset)))
        tries = ((value + k * step - offset) / ratio for k in range(4))
        return next((x for x in tries if low <= ratio * x + offset <= high), (value - offset) / ratio)

    first, last = sorted((end(low, 1.0), end(high, -1.0)))
    return first, last


def limits(
    model: pin.Model, path: JointPath, followers: Mapping[str, tuple[str, float, float, float, float]]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return the joint limits lower, upper (n,) [rad or m] along a path, infinite where there are none, and notes for the user.

    The limits of the model are narrowed so that each mimic joint stays inside its own limits; the notes say where. `followers`
    gives for each mimic joint: leader, ratio, offset, lower and upper limit [rad or m]. Raises ModelError if no position of a joint
    is left.
    """
    own_lower = np.where(path.circle, -np.inf, model.lowerPositionLimit[path.idx_q])
    own_upper = np.where(path.circle, np.inf, model.upperPositionLimit[path.idx_q])
    lower, upper = own_lower.copy(), own_upper.copy()
    narrowed: dict[int, list[tuple[str, float, float]]] = {}
    notes = []
    for joint, (leader, ratio, offset, low, high) in followers.items():
        i = path.owner.get(model.getJointId(joint)) if model.existJointName(joint) else None
        if i is not None and model.names[path.leaders[i]] == joint:
            notes.append(
                f"joint '{joint}' mimics '{leader}' in the URDF but is free in this model; build it with mimic=True"
            )
            continue
        if ratio == 0.0 and model.existJointName(joint) and not low <= offset <= high:
            notes.append(f"joint '{joint}' stays at {offset:g}, outside its limits: its multiplier of '{leader}' is 0")
        if i is None or min(-low, high) >= NO_LIMIT:
            continue
        first, last = _leader_range(ratio, offset, low, high)
        words = f"'{joint}' ({low:g} to {high:g}) from {first:g} to {last:g}"
        narrowed.setdefault(i, []).append((words, first, last))
        lower[i], upper[i] = max(lower[i], first), min(upper[i], last)
        rounding = 8.0 * math.ulp(max(abs(low), abs(high), abs(offset))) / abs(ratio)
        # Limits that are in the wrong order only by rounding are equal.
        if 0.0 < lower[i] - upper[i] <= rounding:
            lower[i] = upper[i] = min(max(lower[i], own_lower[i]), own_upper[i])
    turns = [_turns(model, j) for j in path.leaders]
    for i in np.flatnonzero(~(lower <= upper)).tolist():
        own = f"lower limit {own_lower[i]:g}, upper limit {own_upper[i]:g}"
        if own_lower[i] > own_upper[i]:
            own += f"; {reversed_advice(own_lower[i], own_upper[i], bool(turns[i]))}"
        allow = ", ".join(words for words, _, _ in narrowed.get(i, ()))
        by = f"; the limits of the joints that mimic it allow: {allow}" if allow else ""
        raise ModelError(f"joint '{model.names[path.leaders[i]]}' has no legal position: {own}{by}")
    for i, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        name = model.names[path.leaders[i]]
        most, unit = (LARGEST_ANGLE, "rad") if turns[i] else (LARGEST_STROKE, "m")
        if max(-high, low) > most:
            raise ModelError(
                f"joint '{name}' moves from {low:g} to {high:g} {unit}; values above {most:g} are not computed"
            )
        # Adding 0 turns -0.0 into 0.0, because numpy's random generators refuse the range from 0.0 to -0.0.
        lower[i] = -np.inf if low <= -NO_LIMIT else max(low, -most) + 0.0
        upper[i] = np.inf if high >= NO_LIMIT else min(high, most) + 0.0
        if (np.abs([lower[i], upper[i]]) < np.abs([low, high])).any():
            notes.append(
                f"joint '{name}' has limits of {low:g} to {high:g} {unit}, more than is computed with; it is kept within "
                f"{lower[i]:g} to {upper[i]:g} {unit}"
            )
        if (f"{low:g}", f"{high:g}") != (f"{own_lower[i]:g}", f"{own_upper[i]:g}"):
            by = [words for words, first, last in narrowed[i] if first > own_lower[i] or last < own_upper[i]]
            notes.append(
                f"joint '{name}' is kept within {lower[i]:g} to {upper[i]:g} {unit}, less than its own limits; the limits of "
                f"the joints that mimic it allow: {', '.join(by)}"
            )
    return lower, upper, notes


def mid_range(lower: np.ndarray, upper: np.ndarray, centred: np.ndarray) -> np.ndarray:
    """Return a start value (n,) [rad or m] for each joint: the middle of its limits, or the legal value nearest 0.

    The latter is for joints with an infinite limit, and where `centred` (n,) is False.
    """
    found = np.clip(0.0, lower, upper)
    bounded = np.isfinite(lower) & np.isfinite(upper) & centred
    found[bounded] = lower[bounded] + 0.5 * (upper - lower)[bounded]
    return found


def kinds(chain: Chain) -> tuple[str, ...]:
    """Return the kind of each coordinate of a Chain: 'revolute', 'continuous' (revolute without limits) or 'prismatic'."""
    turns = np.isin(np.arange(chain.n), chain.rows[chain.rows[:, 9] > 0.0, 8])
    endless = np.isinf(chain.lower) & np.isinf(chain.upper)
    return tuple(
        "prismatic" if not turn else "continuous" if free else "revolute"
        for turn, free in zip(turns.tolist(), endless.tolist(), strict=True)
    )


def speed_limits(
    model: pin.Model, path: JointPath, followers: Mapping[str, tuple[float, float]]
) -> tuple[np.ndarray, list[str]]:
    """Return the velocity limits (n,) [rad/s or m/s] along a path, infinite where there are none, and notes for the user.

    The limits of the model are lowered so that each mimic joint keeps its own limit; the notes say where. `followers` gives for
    each mimic joint its ratio and its velocity limit.
    """
    own = np.asarray(model.upperVelocityLimit)[[model.joints[j].idx_v for j in path.leaders]]
    own = np.where((own > 0.0) & (own <= NO_LIMIT), own, np.inf)
    most, slowest = own.copy(), {}
    for joint, (ratio, speed) in followers.items():
        i = path.owner.get(model.getJointId(joint)) if model.existJointName(joint) else None
        if i is not None and speed <= NO_LIMIT and speed / abs(ratio) < most[i]:
            most[i], slowest[i] = speed / abs(ratio), f"'{joint}', which mimics it, has a limit of {speed:g}"
    notes = []
    for i, why in slowest.items():
        unit = "rad/s" if _turns(model, path.leaders[i]) else "m/s"
        if f"{most[i]:g}" != f"{own[i]:g}":
            notes.append(f"joint '{model.names[path.leaders[i]]}' moves at {most[i]:g} {unit} at most: {why}")
    return most, notes


def _split(R: np.ndarray) -> tuple[float, float, float]:
    """Return the angles a, b, c of R = Rz(a) Rx(b) Rz(c).

    Between nearly parallel axes a is determined by rounding only, so c is computed from Rz(a)^T R and not from R alone:
    the product then equals R to rounding whatever a is.
    """
    s = math.hypot(R[0, 2], R[1, 2])
    if s <= PARALLEL:
        return 0.0, 0.0 if R[2, 2] > 0.0 else math.pi, math.atan2(-R[0, 1], R[0, 0])
    cos, sin = -R[1, 2] / s, R[0, 2] / s
    x, y = cos * R[0, :2] + sin * R[1, :2]
    return math.atan2(sin, cos), math.atan2(s, R[2, 2]), math.atan2(-y, x)


def _turn(axis: int, angle: float) -> np.ndarray:
    return pin.AngleAxis(angle, np.eye(3)[axis]).matrix()


def screw(model: pin.Model, data: pin.Data, j: int) -> tuple[bool, float, np.ndarray]:
    """Return the screw of a Pinocchio joint: whether it is revolute (else prismatic), its ratio and its unit axis (3,).

    The ratio is its motion [rad or m] per unit of its coordinate in q. j: id of the joint. data: a pin.Data after forward
    kinematics. Raises ModelError for a joint that is neither revolute nor prismatic, or does not move.
    """
    screw = np.asarray(data.joints[j].S).reshape(6)
    slides, turns = screw[:3].any(), screw[3:].any()
    if slides and turns:
        raise ModelError(
            f"joint '{model.names[j]}' moves along a helix; only revolute and prismatic joints are supported"
        )
    if not (slides or turns):
        raise ModelError(f"joint '{model.names[j]}' does not move: its axis is zero")
    vector = screw[3:] if turns else screw[:3]
    ratio = math.hypot(*vector.tolist())
    return bool(turns), ratio, vector / ratio


def probe(
    model: pin.Model,
    path: JointPath,
    rest: np.ndarray,
    base: int,
    tip: int,
    tool: pin.SE3,
    lower: np.ndarray,
    upper: np.ndarray,
    home: np.ndarray,
) -> Chain:
    """Build the Chain, the arrays by which compiled code computes the kinematics of a path from base to tip (frame ids).

    Joints off the path and locked joints keep their values in `rest` (nq,). `tool` is the pose of the working point in the tip
    frame. The limits `lower` and `upper` and the configuration `home`, where searches start, are (n,) [rad or m].
    """
    data, zero = model.createData(), rest.copy()
    for i, circle in zip(path.idx_q, path.circle, strict=True):
        zero[i : i + 1 + int(circle)] = (1.0, 0.0) if circle else 0.0
    pin.forwardKinematics(model, data, zero)
    # `before` is the transform from the frame of the previous moving joint (at first: the base) to the current link.
    before = model.frames[base].placement.inverse()
    rows = []
    places = []
    for count, j in enumerate(path.joints):
        upwards = count < path.up
        if j not in path.owner:
            before = before * (data.liMi[j].inverse() if upwards else data.liMi[j])
            continue
        turns, ratio, axis = screw(model, data, j)
        # On the way towards the root a joint is passed backwards: first exp(-S q), then the inverse of its pose at q = 0.
        z = pin.SE3(turn_onto(np.array([0.0, 0.0, 1.0]), -axis if upwards else axis), np.zeros(3))
        places.append(before * z if upwards else before * data.liMi[j] * z)
        before = z.inverse() * data.liMi[j].inverse() if upwards else z.inverse()
        row = np.zeros(ROW)
        # This is the cosine of the rotation about x before the joint. Only the first joint keeps the value of 1.
        row[0] = 1.0
        row[4 if turns else 6] = ratio
        row[8], row[9] = path.owner[j], turns
        if rows:
            a, b, c = _split(places[-1].rotation)
            rows[-1][5] += a
            row[5] += c
            t = _turn(0, b).T @ _turn(2, a).T @ places[-1].translation
            row[:4] = math.cos(b), math.sin(b), t[0], t[1]
            row[7] += t[2]
        rows.append(row)
    end = before * model.frames[tip].placement * tool

    def flat(M: pin.SE3) -> np.ndarray:
        return np.concatenate([M.rotation.ravel(), M.translation])

    return pack(np.array(rows), flat(places[0]), flat(end), lower, upper, home)


def configurations(chain: Chain, slides: np.ndarray) -> np.ndarray:
    """Return configurations (SAMPLES, n) [rad or m] at which a Chain is compared with Pinocchio: random ones, and each limit once.

    A revolute joint without limits covers five turns either way, a prismatic joint (`slides` (n,) is True) the reach of the arm.
    """
    lower, upper, n = chain.lower, chain.upper, chain.n
    half = np.where(slides, chain.reach, WINDING)
    low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2.0 * half, -half))
    high = np.where(np.isfinite(upper), upper, low + 2.0 * half)
    Q = low + (high - low) * np.random.default_rng(0).random((SAMPLES, n))
    joints = np.arange(n)
    for side, first in ((lower, 0), (upper, 1)):
        there = np.isfinite(side)
        Q[(2 * joints[there] + first) % SAMPLES, joints[there]] = side[there]
    return Q


def chain_deviation(chain: Chain, slides: np.ndarray, kinematics: Callable, far: float) -> float:
    """Return the largest difference between a Chain and kinematics(q), which gives the pose (pin.SE3) and the Jacobian (6, n).

    Lengths are divided by the robot's size: the largest of its reach, its largest offset, and a small share (FAR) of the distance
    `far` [m] of its base from the origin of the model. The Jacobian column of a joint with mimic joints is divided by the sum of
    all their ratios if that is above 1. The result is at least the rounding error of the largest angle.
    """
    Q = configurations(chain, slides)
    poses, jacobians = zip(*(kinematics(q) for q in Q), strict=True)
    T, J = np.array([pose.homogeneous for pose in poses]), np.array(jacobians)
    rows, ends, scale = chain.rows, chain.ends, chain.scale
    offsets = [ends[9:12], ends[21:24], *rows[:, [2, 3, 7]]]
    size = max(chain.reach, scale * max(math.hypot(*offset) for offset in offsets), FAR * far)
    mine, columns = evaluate(rows, ends, Q, chain.unit, jacobian=True)
    ratios = np.bincount(rows[:, 8].astype(int), np.abs(rows[:, 4] + rows[:, 6]), chain.n)
    off_T, off_J = mine - T, (columns - J) * chain.unit / np.maximum(1.0, ratios)
    off_T[:, :3, 3] /= size
    off_J[:, :3] /= size
    angles = rows[:, 4] * (Q / chain.unit)[:, rows[:, 8].astype(int)]
    return float(max(np.abs(off_T).max(), np.abs(off_J).max(), HELD * np.abs(angles).max()))


def good_start(chain: Chain, lower: np.ndarray, upper: np.ndarray, middle: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Return the configuration `middle` (n,) [rad or m] or, if it is near a singularity, one of 64 neighbours that is not.

    lower, upper (n,): joint limits. moves (n,): whether a joint may differ from `middle`.
    """
    span = np.where(np.isfinite(upper - lower), upper - lower, 2.0)
    offsets = np.random.default_rng(0).uniform(-0.25, 0.25, (64, len(middle))) * np.minimum(span, 2.0) * moves
    tries = np.clip(np.vstack([np.zeros(len(middle)), offsets]) + middle, lower, upper)
    J = evaluate(chain.rows, chain.ends, tries, chain.unit, jacobian=True)[1] * chain.unit
    J[:, :3] /= chain.scale
    rank = np.linalg.matrix_rank(J, tol=1e-9).max()
    smallest = np.linalg.svd(J, compute_uv=False)[:, max(rank, 1) - 1]
    good = np.flatnonzero(smallest > SINGULAR)
    return tries[good[0] if len(good) else int(np.argmax(smallest))]
