"""Where along a reference the poses can be reached at all, found before the run: from the start, moving continuously."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..motion.reference import Reference
from ..robot.joints import Joints
from ..robot.rotation import angles_between
from ..text import angle, length

CLOSE = (1e-4, 2e-4)  # [m, rad] error that counts as reached: a tenth of what a run is allowed by default
DENSE = 1000  # samples from which the length of a path is measured
STEP = (0.02, 0.05)  # of the reach, and [rad]: distance between the poses tested
FEWEST, MOST = 40, 1000  # of these poses
HALVINGS = 10  # of the stretch in which the reach ends: a thousandth of a step
BOUNDARY = 1e-3  # of a joint's range, from its limit: the arm stops there just before the edge of its reach
STARTS = 24  # attempts to find another posture for the start of a path
APART = 0.1  # [rad, or reaches] by which a joint must differ for another posture
SHORTER = 0.95  # of the stretch that can be reached: what is suggested
SIZES = (0.95, 0.75, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05)  # factors tried besides: of a closed path, more may be in reach
PROBE = 1e-4  # [rad, or reaches] of the difference that tells whether a singular value grows
DIGITS = ".7g"  # of joint values suggested: with 4, the tip starts up to a millimetre beside its path

References = Reference | Mapping[str, Reference]


@dataclass(frozen=True)
class Survey:
    """What was found along a reference.

    t (K,) [s] and q (K, n) [rad or m]: joint values along it, as near as they get. along (K,): how far the tip has gone [m]
    (where it only turns, [rad]). posed: whether an orientation is asked for. until: number of the first pose out of reach,
    None when all are reached; stop [m or rad]: how far the reach goes. joints: names of those at a limit there. pace: largest
    joint speed over its limit, and whose.
    """

    robot: Joints
    t: np.ndarray
    q: np.ndarray
    along: np.ndarray
    turning: bool
    posed: bool
    until: int | None
    stop: float
    joints: tuple[str, ...]
    pace: tuple[float, str]

    @property
    def whole(self) -> bool:
        """Whether every pose can be reached."""
        return self.until is None

    @property
    def message(self) -> str:
        """One clause: how far along the path is reachable, and what ends it; '' when all of it is."""
        if self.until is None:
            return ""
        far, whole = ((angle(float(x)) if self.turning else length(float(x))) for x in (self.stop, self.along[-1]))
        where = f"reachable up to {far} of {whole}" if self.until else "its start is out of reach"
        at = f"{', '.join(self.joints)} at {'their limits' if len(self.joints) > 1 else 'its limit'}"
        few = self.robot.n < (6 if self.posed else 4)  # three may move the tip in a plane alone
        few = f", or its {self.robot.n} joints cannot move the tip along this path" if few else ""
        return f"{where}: {at if self.joints else f'the arm is at the edge of its reach{few}'}"

    def to_dict(self) -> dict[str, Any]:
        """What was found, for JSON; lengths in m, or rad of a path that only turns."""
        return {
            "whole": self.whole,
            "reached": self.stop,
            "length": float(self.along[-1]),
            "unit": "rad" if self.turning else "m",
            "joints": list(self.joints),
            "message": self.message,
            "speed": {"share_of_limit": self.pace[0], "joint": self.pace[1]},
        }


def survey(robot: Joints, reference: References, q0: Any, *, fewest: int = FEWEST, **options: Any) -> Survey:
    """Follow a reference from q0 (n,), pose by pose; a mapping gives one reference per tip.

    fewest: of the poses looked at. options: what counts, as for `ik.solve` (mask, slack, free_turn, frame, relative_to, limits).
    """
    t, along, turning = samples_of(robot, reference, fewest)
    first, then = bound_lm(robot, restarts=0, **options), bound_lm(robot, follow=True, **options)
    targets = targets_at(reference, t)
    q = np.empty((len(t), robot.n))
    until, stop = None, float(along[-1])
    joints: tuple[str, ...] = ()
    last = robot.check_q(q0, "q0")
    for k, target in enumerate(targets):
        found = (then if k else first)(target, last)
        q[k] = found.q
        if not found.success and until is None:
            until = k
            stop = _edge(then, reference, t, along, q, k)
            joints = near_limits(robot, found.q)
        last = q[k]
    posed = not all(one.position_only for one in _each(reference))
    return Survey(robot, t, q, along, turning, posed, until, stop, joints, pace(robot, t, q))


def trace(
    robot: Joints, reference: References, q0: Any, *, fewest: int = FEWEST, **options: Any
) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (K,) and joint values (K, n) along a reference as `survey` has them, None when a pose is out of reach."""
    t, _, _ = samples_of(robot, reference, fewest)
    first, then = bound_lm(robot, restarts=0, **options), bound_lm(robot, follow=True, **options)
    q, last = np.empty((len(t), robot.n)), q0
    for k, target in enumerate(targets_at(reference, t)):
        found = (then if k else first)(target, last)
        if not found.success:
            return None
        q[k] = last = found.q
    return t, q


def other_start(robot: Joints, reference: References, **options: Any) -> np.ndarray | None:
    """Joint values (n,) at the start of a reference from which all of it can be reached, if some attempts find them."""
    start = targets_at(reference, np.zeros(1))[0]
    solver, tried = bound_lm(robot, restarts=0, **options), []
    for q in robot.random_q(np.random.default_rng(0), STARTS):
        found = solver(start, q)
        new = found.success and not any((np.abs(found.q - other) < APART * robot.chain.unit).all() for other in tried)
        if new and trace(robot, reference, found.q, **options) is not None:
            return found.q
        if new:
            tried.append(found.q)
    return None


def bound_lm(robot: Joints, **options: Any) -> Any:
    """LM on a robot, exact enough to say what can be reached."""
    from ..solvers.solve import bound_solver

    return bound_solver(robot, "lm", {"position_tolerance": CLOSE[0], "orientation_tolerance": CLOSE[1]} | options)


def freed(reference: Reference) -> Reference:
    """The same path with the orientation free."""

    def function(t: np.ndarray) -> Any:
        T, V, A = (part.copy() for part in reference.at(t))
        V[:, 3:] = A[:, 3:] = 0.0
        return T, V, A

    return Reference(function, reference.duration, position_only=True, name=reference.name)


def scaled(reference: Reference, factor: float) -> Reference:
    """The same path, its distances from the start times a factor; turns stay as they are."""
    origin = reference.at(0.0)[0][:3, 3]

    def function(t: np.ndarray) -> Any:
        T, V, A = (part.copy() for part in reference.at(t))
        T[:, :3, 3] = origin + factor * (T[:, :3, 3] - origin)
        V[:, :3] *= factor
        A[:, :3] *= factor
        return T, V, A

    return Reference(function, reference.duration, position_only=reference.position_only, name=reference.name)


def smaller(found: Survey) -> list[float]:
    """Factors of the size of a path out of reach that are worth a try, largest first."""
    if not found.until or found.turning:
        return []
    reached = float(found.stop / found.along[-1])
    within = float(np.floor(100.0 * SHORTER * reached) / 100.0)
    return sorted({within, *(size for size in SIZES if not within < size <= reached)} - {0.0}, reverse=True)


def explain(robot: Joints, reference: References, q0: Any, **options: Any) -> tuple[Survey, str]:
    """What prevents a robot from following a reference, and what would work instead: the survey, and a sentence or ''."""
    found = survey(robot, reference, q0, **options)
    if found.whole:
        share, joint = found.pace
        if share <= 1.0:
            return found, ""
        return found, f"Every pose can be reached, but {joint} would need {share:.3g} times its speed limit: go slower."
    ways: list[tuple[str, References]] = []
    if isinstance(reference, Reference):
        if not reference.position_only:
            ways.append(("with the orientation free", freed(reference)))
        ways += [(f"scaled by {factor:g} about its start", scaled(reference, factor)) for factor in smaller(found)]
    works: list[str] = []
    for words, other in ways:
        if not any(one.startswith("scaled") for one in works) and trace(robot, other, q0, **options) is not None:
            works.append(words)
    elsewhere = other_start(robot, reference, **options)
    if elsewhere is not None:
        works.append(f"from q0 = [{', '.join(f'{x:{DIGITS}}' for x in elsewhere)}]")
    tried = f"; it works {', or '.join(works)}" if works else ""
    return found, f"{'The path is ' if found.until else 'Of the path, '}{found.message}{tried}."


def singular_sides(robot: Joints, posed: list[bool], path: np.ndarray) -> np.ndarray:
    """Directions (N, n) of the joints at q (N, n) away from the nearest singular pose: the slope of the least singular value.

    posed: whether an orientation is asked for, by tip.
    """
    J = _jacobians(robot, posed, path)
    U, sigma, V = np.linalg.svd(J)
    least = sigma.shape[1] - 1
    # J changes along v; the change of u'J is that of sigma = u'J v along each joint.
    change = _jacobians(robot, posed, path + PROBE * V[:, least] * robot.chain.unit) - J
    slope = np.einsum("km,kmn->kn", U[:, :, least], change)
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), np.finfo(float).tiny)


def _jacobians(robot: Joints, posed: list[bool], path: np.ndarray) -> np.ndarray:
    """Jacobians (N, m, n) of what is asked for, lengths in reaches."""
    rows = []
    for arm, place, angular in zip(robot.arms, robot.places, posed, strict=True):
        J = np.zeros((len(path), 6, path.shape[1]))
        J[:, :, place] = arm.chain.forward(np.ascontiguousarray(path[:, place]), jacobian=True)[1]
        J[:, :3] /= robot.chain.scale
        rows.append(J[:, : 6 if angular else 3])
    return np.concatenate(rows, axis=1) * robot.chain.unit


# --------------------------------------------------------------------------------------------------------- samples
def _each(reference: References) -> tuple[Reference, ...]:
    return (reference,) if isinstance(reference, Reference) else tuple(reference.values())


def targets_at(reference: References, t: np.ndarray) -> list[Any]:
    """Targets at times t as the solvers take them."""
    if not isinstance(reference, Reference):
        each = {tip: targets_at(one, t) for tip, one in reference.items()}
        return [dict(zip(each, row, strict=True)) for row in zip(*each.values(), strict=True)]
    T = np.ascontiguousarray(reference.at(t)[0], dtype=float)
    return [*(T[:, :3, 3].copy() if reference.position_only else T)]


def samples_of(robot: Joints, reference: References, fewest: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """Times at even distances along a path, how far [m, or rad where it only turns] it is there, and whether it only turns."""
    every = _each(reference)
    t = np.linspace(0.0, min(one.duration for one in every), DENSE + 1)
    moved, turned = np.zeros(DENSE), np.zeros(DENSE)
    for one in every:
        T = one.at(t)[0]
        moved = np.maximum(moved, np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1))
        if not one.position_only:
            turned = np.maximum(turned, angles_between(T[1:, :3, :3], T[:-1, :3, :3]))
    share = np.cumsum([0.0, *np.maximum(moved / (STEP[0] * robot.reach), turned / STEP[1])])
    count = int(np.clip(np.ceil(share[-1]), fewest, MOST))
    chosen = np.unique(np.searchsorted(share, np.linspace(0.0, share[-1], count + 1)))
    turning = bool(moved.sum() < 1e-9)
    along = np.concatenate([[0.0], np.cumsum(turned if turning else moved)])
    return t[chosen], along[chosen], turning


def _edge(then: Any, reference: References, t: np.ndarray, along: np.ndarray, q: np.ndarray, k: int) -> float:
    """How far along the path the reach extends before pose k, the first out of reach."""
    if k == 0:
        return 0.0
    low, high, near = 0.0, 1.0, q[k - 1]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        found = then(targets_at(reference, np.array([t[k - 1] + middle * (t[k] - t[k - 1])]))[0], near)
        low, high, near = (middle, high, found.q) if found.success else (low, middle, near)
    return float(along[k - 1] + low * (along[k] - along[k - 1]))


def near_limits(robot: Joints, q: np.ndarray) -> tuple[str, ...]:
    """Names of the joints within a thousandth of their range of a limit."""
    span = np.where(np.isfinite(robot.upper - robot.lower), robot.upper - robot.lower, 1.0)
    near = np.minimum(q - robot.lower, robot.upper - q) <= BOUNDARY * span
    return tuple(name for name, hit in zip(robot.joint_names, near, strict=True) if hit)


def pace(robot: Joints, t: np.ndarray, q: np.ndarray) -> tuple[float, str]:
    """Largest joint speed over its limit along q (K, n) at times t (K,), and which joint has it."""
    limit = np.where(robot.velocity_limits > 0.0, robot.velocity_limits, np.inf)
    if len(t) < 2:
        return 0.0, robot.joint_names[0]
    share = (np.abs(np.diff(q, axis=0)) / np.diff(t)[:, None] / limit).max(axis=0)
    worst = int(np.argmax(share))
    return float(share[worst]), robot.joint_names[worst]
