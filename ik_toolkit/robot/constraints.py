"""Constraints that a robot description has: loops, and relations between joints that no mimic joint can express.

Solvers ignore them. They are evaluated at a finished q, with Pinocchio on the whole model. Joints off the path are first moved to
close the loops that depend on joints of q; loops that stay open are reported. Robots without constraints pay nothing for this.
"""

import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import ModelError
from ..text import angle, equations, length
from .base import joint_value, put_joint
from .formats.mimic import mimic_limits
from .probe import JointPath, limits, mimics

# A loop is closed by moving joints off the path to the tip: at most STEPS Levenberg-Marquardt steps from each of TRIES starts.
STEPS, TRIES = 40, 5
CLOSED = 1e-10  # The iteration that closes a loop ends below this residual [m or rad].
SLOW = 1e-4  # The iteration also ends after a step that reduces the residual by less than this share.
LINKS = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


class End(NamedTuple):
    """A frame fixed to a link: its origin [m] and rotation (9 numbers, row by row) in the axes of the link."""

    link: str
    point: tuple[float, ...]
    rotation: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class Loop(NamedTuple):
    """A loop constraint: two frames that must coincide in position, and for a weld in rotation too."""

    name: str
    ends: tuple[End, End]
    weld: bool

    @property
    def kind(self) -> str:
        """The word for this constraint in messages: 'weld' if it also fixes the rotation, else 'loop'."""
        return "weld" if self.weld else "loop"


class LinearLength(NamedTuple):
    """A length or angle that depends on q: a sum of joint values and distances between points, each times a factor.

    `joints` has names and factors of joints, `lines` the two points and the factor of each distance, and `zero` [m or rad] is
    subtracted from the sum. `metres` tells whether it is a length. `known` is False for a tendon around a shape, whose length is
    not computed.
    """

    joints: tuple[tuple[str, float], ...]
    lines: tuple[tuple[End, End, float], ...] = ()
    zero: float = 0.0
    metres: bool = True
    known: bool = True


class Relation(NamedTuple):
    """A relation low <= y - (c0 + c1 x + c2 x^2 + ...) <= high between two lengths y and x [m or rad], or on y alone.

    `curve` has the coefficients c0, c1, ...; `name` is for messages.
    """

    name: str
    y: LinearLength
    x: LinearLength | None
    curve: tuple[float, ...]
    low: float = 0.0
    high: float = 0.0

    @property
    def kind(self) -> str:
        """The word for this relation in messages: 'equality' if low equals high, else 'range of tendon'."""
        return "equality" if self.low == self.high else "range of tendon"


Constraint = Loop | Relation


class ConstraintCheck(NamedTuple):
    """Whether all constraints of a robot hold at a configuration, and a text with the state of each that depends on q."""

    holds: bool
    text: str


def constraints_at(robot: Any, q: np.ndarray, position: float, orientation: float) -> ConstraintCheck:
    """Check the loops of a robot and the relations between its joints at q (n,); return a ConstraintCheck.

    The tolerances are `position` [m] and `orientation` [rad].
    """
    if not robot.constraints:
        return ConstraintCheck(True, "")
    closure = robot.memo.get("closure")
    if closure is None:
        closure = robot.memo["closure"] = Closure(robot)
    return closure.at(robot._filled(q), position, orientation)


def first_open(robot: Any, Q: np.ndarray, position: float, orientation: float) -> tuple[int, str] | None:
    """Return the index of the first configuration in Q (N, n) that violates a constraint, and a text that says how; else None.

    Rows with NaN are skipped. The tolerances are `position` [m] and `orientation` [rad].
    """
    if robot.constraints:
        for k in np.flatnonzero(np.isfinite(Q).all(axis=1)):
            kept = constraints_at(robot, Q[k], position, orientation)
            if not kept.holds:
                return int(k), kept.text
    return None


class CoupledConstraints(NamedTuple):
    """Constraints that must be satisfied together, because they depend on the same m joints off the path to the tip.

    `joints` has the ids of these joints, `lower` and `upper` their limits (m,) [rad or m].
    """

    constraints: list[Constraint]
    joints: list[int]
    lower: np.ndarray
    upper: np.ndarray


class Closure:
    """Checks the constraints of a robot, such as loops, at a q, after moving joints off the path to the tip to satisfy them."""

    def __init__(self, robot: Any) -> None:
        """Find the joints of a Robot or Tree on which each of its constraints depends."""
        self.robot, self.model = robot, robot.model
        model = self.model
        single = [j for j in range(1, model.njoints) if model.joints[j].nvExtended == 1]
        self.ratio = {j: (j, 1.0, 0.0) for j in single} | mimics(model)
        moving = {model.getJointId(joint) for joint in robot.joint_names}
        locked = {model.getJointId(joint) for joint in robot.locked_joints}
        groups: list[tuple[list[Constraint], set[int]]] = []
        for constraint in robot.constraints:
            ids = {self.ratio[j][0] for j in self._joints(constraint) if j in self.ratio and self.ratio[j][1] != 0.0}
            own, depends = [constraint], ids
            free = ids - moving - locked
            for group in [one for one in groups if one[1] & free - moving - locked]:
                groups.remove(group)
                own, depends = group[0] + own, depends | group[1]
            groups.append((own, depends))
        self.groups = [self._group(own, sorted(ids - moving - locked)) for own, ids in groups if ids & moving]

    def _group(self, constraints: list[Constraint], joints: list[int]) -> CoupledConstraints:
        model = self.model
        place = {j: i for i, j in enumerate(joints)}
        owner = {j: place[leader] for j, (leader, ratio, _) in self.ratio.items() if leader in place and ratio != 0.0}
        idx_q = np.array([model.joints[j].idx_q for j in joints], dtype=int)
        circle = np.array([model.joints[j].nq == 2 for j in joints], dtype=bool)
        path = JointPath([], 0, joints, len(joints), owner, idx_q, circle)
        try:
            lower, upper, _ = limits(model, path, mimic_limits(self.robot.urdf))
        except ModelError:  # No position is inside all limits, so these joints cannot move to close a loop.
            lower = upper = np.array([0.0 if c else self.robot.rest[i] for i, c in zip(idx_q, circle, strict=True)])
        return CoupledConstraints(constraints, joints, lower, upper)

    def _joints(self, constraint: Constraint) -> Iterator[int]:
        """Yield the ids of the joints whose motion changes a constraint."""
        if isinstance(constraint, Loop):
            yield from self._between(*constraint.ends)
            return
        for one in (constraint.y, constraint.x):
            for name, _ in one.joints if one else ():
                yield self.model.getJointId(name)
            for a, b, _ in one.lines if one else ():
                yield from self._between(a, b)

    def _between(self, a: End, b: End) -> set[int]:
        above = [set(self.model.supports[self.model.frames[self._frames[end.link]].parentJoint]) for end in (a, b)]
        return (above[0] ^ above[1]) - {0}

    @functools.cached_property
    def _frames(self) -> dict[str, int]:
        return {f.name: i for i, f in enumerate(self.model.frames) if f.type in LINKS}

    # -------------------------------------------------------------------------------------------- evaluating
    def at(self, full: np.ndarray, position: float, orientation: float) -> ConstraintCheck:
        """Move joints off the path to the tip so that the constraints hold, then check the constraints.

        full: Pinocchio configuration (nq,), in which these joints are changed in place. position [m] and orientation [rad] are
        the tolerances.
        """
        holds, said = True, []
        for group in self.groups:
            moved = self._close(group, full, min(position, orientation))
            for constraint in group.constraints:
                off = self.residual(constraint, full)[0]
                open_by = self._open(constraint, off, position, orientation)
                holds &= not open_by
                said.append(
                    f"the {constraint.kind} '{constraint.name}' of the description {_state(constraint, open_by, moved)}"
                )
        return ConstraintCheck(holds, "; ".join(said))

    def _open(self, constraint: Constraint, off: np.ndarray, position: float, orientation: float) -> str:
        """Return as text how far a constraint is violated, '' if it is within the tolerances."""
        if np.isnan(off).any():
            return "unknown"
        metres = isinstance(constraint, Loop) or constraint.y.metres
        far = float(np.linalg.norm(off[:3])) if metres else 0.0
        turned = float(np.linalg.norm(off[3:] if metres else off))
        parts = [length(far)] if far > position else []
        parts += [angle(turned)] if turned > orientation else []
        return " and ".join(parts)

    def residual(self, constraint: Constraint, full: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residual (k,) [m, rad] of a constraint at a Pinocchio configuration `full` (nq,), and its Jacobian (k, nv)."""
        pin.computeJointJacobians(self.model, self.robot.arms[0].data, full)
        return self._residual(constraint, full)

    def _residual(self, constraint: Constraint, full: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residual and derivative of a constraint at the configuration at which Jacobians were last computed."""
        if isinstance(constraint, Relation):
            return self._relation(constraint, full)
        (p, J, R), (s, K, S) = (self._point(end) for end in constraint.ends)
        off, slope = p - s, J[:3] - K[:3]
        if not constraint.weld:
            return off, slope
        turn = pin.log3(S.T @ R)
        return np.concatenate([off, turn]), np.vstack([slope, pin.Jlog3(S.T @ R) @ R.T @ (J[3:] - K[3:])])

    def _point(self, end: End) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return position (3,) [m], Jacobian (6, nv) and rotation (3, 3) of a frame on a link, in root axes."""
        data, i = self.robot.arms[0].data, self._frames[end.link]
        at = pin.updateFramePlacement(self.model, data, i)
        J = pin.getFrameJacobian(self.model, data, i, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1).copy()
        arm = at.rotation @ np.array(end.point)
        J[:3] -= pin.skew(arm) @ J[3:]
        return at.translation + arm, J, at.rotation @ np.reshape(end.rotation, (3, 3))

    def _relation(self, one: Relation, full: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y, slope = self._length(one.y, full)
        x, tilt = (0.0, 0.0 * slope) if one.x is None else self._length(one.x, full)
        curve = np.polynomial.Polynomial(one.curve)
        off = y - float(curve(x))
        slope = slope - float(curve.deriv()(x)) * tilt
        beyond = off - min(max(off, one.low), one.high)
        if one.low < off < one.high:
            slope = 0.0 * slope
        return np.array([beyond]), slope[None]

    def _length(self, one: LinearLength, full: np.ndarray) -> tuple[float, np.ndarray]:
        model, slope = self.model, np.zeros(self.model.nv)
        total = -one.zero if one.known else np.nan
        for name, factor in one.joints:
            leader, ratio, offset = self.ratio[model.getJointId(name)]
            total += factor * (ratio * joint_value(model.joints[leader], full) + offset)
            slope[model.joints[leader].idx_v] += factor * ratio
        for a, b, factor in one.lines:
            (p, J, _), (s, K, _) = self._point(a), self._point(b)
            far = float(np.linalg.norm(p - s))
            total += factor * far
            if far > 0.0:
                slope += factor * (p - s) / far @ (J[:3] - K[:3])
        return total, slope

    # -------------------------------------------------------------------------------------------- closing
    def _close(self, group: CoupledConstraints, full: np.ndarray, tolerance: float) -> list[tuple[str, float]]:
        """Move a group's joints in `full` (nq,) so that its constraints are violated least; return names and values."""
        if not group.joints:
            return []
        rest = np.array([joint_value(self.model.joints[j], full) for j in group.joints]).clip(group.lower, group.upper)
        span = np.where(np.isfinite(group.upper - group.lower), group.upper - group.lower, 2.0 * np.pi)
        low = np.where(np.isfinite(group.lower), group.lower, rest - 0.5 * span)
        best, least = rest, np.inf
        for start in [rest, *(low + span * np.random.default_rng(0).random((TRIES - 1, len(rest))))]:
            x, left = self._descend(group, full, start.clip(group.lower, group.upper))
            if left < least:
                best, least = x, left
            if not least > 0.01 * tolerance:
                break
        self._write(group, full, best)
        return [(self.model.names[j], float(x)) for j, x in zip(group.joints, best, strict=True)]

    def _write(self, group: CoupledConstraints, full: np.ndarray, x: np.ndarray) -> None:
        for j, value in zip(group.joints, x, strict=True):
            put_joint(self.model.joints[j], full, value)

    def _stack(self, group: CoupledConstraints, full: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of a group, and their derivatives with respect to its joints."""
        self._write(group, full, x)
        pin.computeJointJacobians(self.model, self.robot.arms[0].data, full)
        columns = [self.model.joints[j].idx_v for j in group.joints]
        each = [self._residual(one, full) for one in group.constraints]
        parts = [part for part in each if not np.isnan(part[0]).any()]
        if not parts:
            return np.zeros(1), np.zeros((1, len(x)))
        return np.concatenate([off for off, _ in parts]), np.vstack([slope[:, columns] for _, slope in parts])

    def _descend(self, group: CoupledConstraints, full: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, float]:
        """Minimise the residual by Levenberg-Marquardt within the limits, from x; return joint values (m,) and residual norm."""
        damping = 1e-6
        off, J = self._stack(group, full, x)
        for _ in range(STEPS):
            slope = J.T @ off
            free = ~((x <= group.lower) & (slope > 0.0) | (x >= group.upper) & (slope < 0.0))
            if np.linalg.norm(off) < CLOSED or not np.abs(slope[free]).max(initial=0.0) > 0.0:
                break
            A = J[:, free]
            step = np.zeros(len(x))
            step[free] = np.linalg.solve(A.T @ A + damping * np.eye(A.shape[1]), -slope[free])
            near = (x + step).clip(group.lower, group.upper)
            new, K = self._stack(group, full, near)
            gained = np.linalg.norm(off) - np.linalg.norm(new)
            if gained > 0.0:
                stands = gained < SLOW * np.linalg.norm(new)
                x, off, J, damping = near, new, K, max(0.1 * damping, 1e-12)
                if stands:
                    break
            else:
                damping = 10.0 * damping
                if damping > 1e6:
                    break
        return x, float(np.linalg.norm(off))


def _state(constraint: Constraint, open_by: str, moved: Sequence[tuple[str, float]]) -> str:
    """Return the end of a sentence about a constraint: whether the constraint holds, and which joints were moved to close it.

    open_by: text that says how far it is violated, '' if it is kept, 'unknown' if it cannot be computed.
    """
    values = equations(dict(moved), 6)
    if open_by == "unknown":
        return "may not be kept: a tendon around a shape is not computed here"
    if open_by:
        names = ", ".join(name for name, _ in moved)
        off = f"opens it by {open_by}" if isinstance(constraint, Loop) else f"is {open_by} off"
        return f"is not kept: this q {off}" + (f", with {names} moved to close it" if moved else "")
    return f"is kept with {values}" if moved else "is kept"
