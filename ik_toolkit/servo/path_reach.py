"""Which poses of a reference can be reached at all, found by following it continuously from its start."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..motion.reference import Reference
from ..robot.joints import Joints
from ..robot.rotation import angles_between
from ..text import angle, length


class SurveyConstants(NamedTuple):
    """Constants that say how finely a path is sampled, and which changes are tried if a part of it is out of reach."""

    # [m, rad] errors up to which a pose counts as reached: about a tenth of the default tolerances of `track`
    close: tuple[float, float] = (1e-4, 2e-4)
    dense: int = 1000  # number of samples from which the length of a path is measured
    # largest distance between two poses: as a share of the arm's reach, and in rad
    step: tuple[float, float] = (0.02, 0.05)
    fewest: int = 40  # least number of poses tested along a path
    most: int = 1000  # largest number of poses tested along a path
    # number of bisections between the last pose reached and the first one not reached, which find the edge to 1/1000 of their
    # distance
    halvings: int = 10
    # A joint nearer to a limit than this share of its range counts as at the limit, because the arm stops just short of it.
    boundary: float = 1e-3
    starts: int = 24  # number of random postures from which another solution for the start of a path is sought
    apart: float = 0.1  # [rad or arm reaches] two postures count as different if some joint differs by more
    shorter: float = 0.95  # The first size factor suggested is this times the share of the path that can be reached.
    # These size factors are tried as well, because a smaller closed path may be in reach as a whole.
    sizes: tuple[float, ...] = (0.95, 0.75, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05)
    probe: float = 1e-4  # [rad or arm reaches] step of the difference quotient for the gradient of a singular value
    # format of joint values in a message; with 4 digits instead of 7, the tip would start up to 1 mm off its path
    digits: str = ".7g"


SURVEY = SurveyConstants()
References = Reference | Mapping[str, Reference]


@dataclass(frozen=True)
class Survey:
    """What can be reached along a reference, from K poses on it.

    t (K,) [s]: times of the poses; q (K, n) [rad or m]: joint values there, as near as the arm gets. along (K,): length
    of the path up to each pose [m], or [rad] if the tip only turns (turning). posed: whether an orientation is asked
    for. until: index of the first pose out of reach, None if all are reached; stop [m or rad]: length of the part of the path
    that can be reached. joints: names of the joints that are at a limit at its end. pace: largest ratio of a joint's speed to
    its limit, and the joint's name.
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
        """A clause that says how much of the path can be reached and what stops the arm there; '' if all of it can be reached."""
        if self.until is None:
            return ""
        far, whole = ((angle(float(x)) if self.turning else length(float(x))) for x in (self.stop, self.along[-1]))
        where = f"reachable up to {far} of {whole}" if self.until else "its start is out of reach"
        at = f"{', '.join(self.joints)} at {'their limits' if len(self.joints) > 1 else 'its limit'}"
        # Positions are taken to need four joints, because three may only be able to move the tip in a plane.
        few = self.robot.n < (6 if self.posed else 4)
        few = f", or its {self.robot.n} joints cannot move the tip along this path" if few else ""
        return f"{where}: {at if self.joints else f'the arm is at the edge of its reach{few}'}"

    def to_dict(self) -> dict[str, Any]:
        """Return the findings as a dict for JSON; lengths in m, or in rad for a path that only turns."""
        return {
            "whole": self.whole,
            "reached": self.stop,
            "length": float(self.along[-1]),
            "unit": "rad" if self.turning else "m",
            "joints": list(self.joints),
            "message": self.message,
            "speed": {"share_of_limit": self.pace[0], "joint": self.pace[1]},
        }


def survey(robot: Joints, reference: References, q0: Any, *, fewest: int = SURVEY.fewest, **options: Any) -> Survey:
    """Follow a reference pose by pose with a solver, without speed limits, to see which of its poses can be reached.

    Args:
        robot: The robot.
        reference: A reference, or a mapping with one per tip.
        q0: Joint values (n,) to begin at.
        fewest: Least number of poses tested.
        options: Which errors count, as for `ik.solve` (mask, slack, free_turn, frame, relative_to, limits).

    Returns:
        What was found: the joint values at the poses, and how far the path can be reached.
    """
    t, along, turning = path_samples(robot, reference, fewest)
    q = np.empty((len(t), robot.n))
    until, stop = None, float(along[-1])
    joints: tuple[str, ...] = ()
    for k, found in enumerate(_followed(robot, targets_at(reference, t), robot.check_q(q0, "q0"), options)):
        q[k] = found.q
        if not found.success and until is None:
            until, joints = k, near_limits(robot, found.q)
            stop = _edge(bound_search(robot, follow=True, **options), reference, t, along, q, k)
    posed = not all(one.position_only for one in _each(reference))
    return Survey(robot, t, q, along, turning, posed, until, stop, joints, pace(robot, t, q))


def trace(
    robot: Joints, reference: References, q0: Any, *, fewest: int = SURVEY.fewest, **options: Any
) -> tuple[np.ndarray, np.ndarray] | None:
    """Follow a reference pose by pose; return times (K,) [s] and joint values (K, n) there, or None if a pose is out of reach.

    Arguments are those of `survey`.
    """
    t, _, _ = path_samples(robot, reference, fewest)
    q = []
    for found in _followed(robot, targets_at(reference, t), q0, options):
        if not found.success:
            return None
        q.append(found.q)
    return t, np.array(q)


def _followed(robot: Joints, targets: list[Any], q: Any, options: dict[str, Any]) -> Iterator[Any]:
    """Yield what a search finds for each target, the first from q (n,), the others near the joint values found before."""
    first, then = bound_search(robot, restarts=0, **options), bound_search(robot, follow=True, **options)
    for k, target in enumerate(targets):
        found = (then if k else first)(target, q)
        q = found.q
        yield found


def other_start(robot: Joints, reference: References, **options: Any) -> np.ndarray | None:
    """Return joint values (n,) for the start of a reference from which all of it can be reached, or None if none are found.

    options: as for `survey`.
    """
    start = targets_at(reference, np.zeros(1))[0]
    solver, tried = bound_search(robot, restarts=0, **options), []
    for q in robot.random_q(np.random.default_rng(0), SURVEY.starts):
        found = solver(start, q)
        new = found.success and not any(
            (np.abs(found.q - other) < SURVEY.apart * robot.chain.unit).all() for other in tried
        )
        if new and trace(robot, reference, found.q, **options) is not None:
            return found.q
        if new:
            tried.append(found.q)
    return None


def bound_search(robot: Joints, **options: Any) -> Any:
    """Return the general-purpose iterative solver for a robot, with tolerances SURVEY.close and the options of `ik.solve` given."""
    from ..solvers.registry import search_for
    from ..solvers.solve import bound_solver

    return bound_solver(
        robot,
        search_for(options.get("priority")),
        {"position_tolerance": SURVEY.close[0], "orientation_tolerance": SURVEY.close[1]} | options,
    )


def freed(reference: Reference) -> Reference:
    """Return a reference with the same path and time law, but without asking for an orientation."""

    def free(T: np.ndarray, V: np.ndarray, A: np.ndarray) -> None:
        V[:, 3:] = A[:, 3:] = 0.0

    return _changed(reference, free, True)


def scaled(reference: Reference, factor: float) -> Reference:
    """Return a reference with all distances from its start multiplied by `factor`; rotations and times do not change."""
    origin = reference.at(0.0)[0][:3, 3]

    def scale(T: np.ndarray, V: np.ndarray, A: np.ndarray) -> None:
        T[:, :3, 3] = origin + factor * (T[:, :3, 3] - origin)
        V[:, :3] *= factor
        A[:, :3] *= factor

    return _changed(reference, scale, reference.position_only)


def _changed(reference: Reference, change: Callable, position_only: bool) -> Reference:
    """Return a reference whose poses, twists and accelerations `change` has changed in place."""

    def function(t: np.ndarray) -> Any:
        samples = tuple(part.copy() for part in reference.at(t))
        change(*samples)
        return samples

    return Reference(function, reference.duration, position_only=position_only, name=reference.name)


def smaller(found: Survey) -> list[float]:
    """Return factors by which a path that is partly out of reach might be scaled down, largest first.

    found: the survey of the path. The result is empty if the path is reached, or if scaling would not help.
    """
    if not found.until or found.turning:
        return []
    reached = float(found.stop / found.along[-1])
    within = float(np.floor(100.0 * SURVEY.shorter * reached) / 100.0)
    return sorted({within, *(size for size in SURVEY.sizes if not within < size <= reached)} - {0.0}, reverse=True)


def position_options(options: dict[str, Any]) -> dict[str, Any] | None:
    """Return a copy of the options of `ik.solve` that is changed so that only the position of a pose counts.

    The result is None if nothing would then count, or if mask or slack is a dict.
    """
    kept = {name: value for name, value in options.items() if name != "free_turn"}
    for name in ("mask", "slack"):
        value = kept.get(name)
        if value is not None:
            if isinstance(value, dict):
                return None
            kept[name] = (*np.asarray(value, float)[:3].tolist(), 0.0, 0.0, 0.0)
    mask = kept.get("mask")
    return kept if mask is None or any(mask) else None


def explain(robot: Joints, reference: References, q0: Any, **options: Any) -> tuple[Survey, str]:
    """Find out why a robot cannot follow a reference, and what would work instead.

    The arguments are those of `survey`. Returns the survey, and a sentence ('' if nothing is in the way).
    """
    found = survey(robot, reference, q0, **options)
    if found.whole:
        share, joint = found.pace
        if share <= 1.0:
            return found, ""
        return found, f"Every pose can be reached, but {joint} would need {share:.3g} times its speed limit: go slower."
    ways: list[tuple[str, References, dict[str, Any]]] = []
    if isinstance(reference, Reference):
        if not reference.position_only and (kept := position_options(options)) is not None:
            ways.append(("with the orientation free", freed(reference), kept))
        ways += [
            (f"scaled by {factor:g} about its start", scaled(reference, factor), options) for factor in smaller(found)
        ]
    works: list[str] = []
    for words, other, kept in ways:
        if not any(one.startswith("scaled") for one in works) and trace(robot, other, q0, **kept) is not None:
            works.append(words)
    if works and works[0].endswith("free") and not options.get("priority"):
        works.insert(1, "with the position before it (priority)")
    elsewhere = other_start(robot, reference, **options)
    if elsewhere is not None:
        works.append(f"from q0 = [{', '.join(f'{x:{SURVEY.digits}}' for x in elsewhere)}]")
    tried = f"; it works {', or '.join(works)}" if works else ""
    return found, f"{'The path is ' if found.until else 'Of the path, '}{found.message}{tried}."


def singular_sides(robot: Joints, posed: list[bool], path: np.ndarray) -> np.ndarray:
    """Return unit vectors (N, n) along which the joints move away from the nearest singular pose, at configurations path (N, n).

    They are the normalised gradients of the least singular value of J. posed: for each tip, whether an orientation is asked for.
    """
    J = _jacobians(robot, posed, path)
    U, sigma, V = np.linalg.svd(J)
    least = sigma.shape[1] - 1
    # With J = sum of u sigma v', entry i of u' (dJ along v) is the derivative of sigma with respect to joint i: second derivatives
    # commute.
    change = _jacobians(robot, posed, path + SURVEY.probe * V[:, least] * robot.chain.unit) - J
    slope = np.einsum("km,kmn->kn", U[:, :, least], change)
    return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), np.finfo(float).tiny)


def _jacobians(robot: Joints, posed: list[bool], path: np.ndarray) -> np.ndarray:
    """Return the Jacobians (N, m, n) of the tips' positions and, where `posed`, orientations; lengths in arm reaches."""
    J = robot.chain.forward(path, jacobian=True)[1].reshape(len(path), len(posed), 2, 3, -1)
    J[:, :, 0] /= robot.chain.scale
    counted = [(True, angular) for angular in posed]
    return J[:, np.array(counted)].reshape(len(path), -1, J.shape[-1]) * robot.chain.unit


# --------------------------------------------------------------------------------------------------------- samples
def _each(reference: References) -> tuple[Reference, ...]:
    return (reference,) if isinstance(reference, Reference) else tuple(reference.values())


def targets_at(reference: References, t: np.ndarray) -> list[Any]:
    """Return the targets at times t (N,) [s] as solvers take them: poses, positions, or dicts of these by tip."""
    if not isinstance(reference, Reference):
        each = {tip: targets_at(one, t) for tip, one in reference.items()}
        return [dict(zip(each, row, strict=True)) for row in zip(*each.values(), strict=True)]
    T = np.ascontiguousarray(reference.at(t)[0], dtype=float)
    return [*(T[:, :3, 3].copy() if reference.position_only else T)]


def path_samples(robot: Joints, reference: References, fewest: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return times [s] of evenly spaced poses along a path, the path's length up to each, and whether the tip only turns.

    fewest: least number of distances. Lengths are in m, or in rad if the tip only turns.
    """
    every = _each(reference)
    t = np.linspace(0.0, min(one.duration for one in every), SURVEY.dense + 1)
    moved, turned = np.zeros(SURVEY.dense), np.zeros(SURVEY.dense)
    for one in every:
        T = one.at(t)[0]
        moved = np.maximum(moved, np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1))
        if not one.position_only:
            turned = np.maximum(turned, angles_between(T[1:, :3, :3], T[:-1, :3, :3]))
    share = np.cumsum([0.0, *np.maximum(moved / (SURVEY.step[0] * robot.reach), turned / SURVEY.step[1])])
    count = int(np.clip(np.ceil(share[-1]), fewest, SURVEY.most))
    chosen = np.unique(np.searchsorted(share, np.linspace(0.0, share[-1], count + 1)))
    turning = bool(moved.sum() < 1e-9)
    along = np.concatenate([[0.0], np.cumsum(turned if turning else moved)])
    return t[chosen], along[chosen], turning


def _edge(then: Any, reference: References, t: np.ndarray, along: np.ndarray, q: np.ndarray, k: int) -> float:
    """Return the length of the reachable part of the path, by bisection between poses k - 1 and k, the first one out of reach.

    then: bound solver that stays near the joint values given to it; t, along, q: as in `Survey`.
    """
    if k == 0:
        return 0.0
    low, high, near = 0.0, 1.0, q[k - 1]
    for _ in range(SURVEY.halvings):
        middle = 0.5 * (low + high)
        found = then(targets_at(reference, np.array([t[k - 1] + middle * (t[k] - t[k - 1])]))[0], near)
        low, high, near = (middle, high, found.q) if found.success else (low, middle, near)
    return float(along[k - 1] + low * (along[k] - along[k - 1]))


def near_limits(robot: Joints, q: np.ndarray) -> tuple[str, ...]:
    """Return the names of the joints that at q (n,) are nearer to a position limit than a thousandth of their range."""
    span = np.where(np.isfinite(robot.upper - robot.lower), robot.upper - robot.lower, 1.0)
    near = np.minimum(q - robot.lower, robot.upper - q) <= SURVEY.boundary * span
    return tuple(name for name, hit in zip(robot.joint_names, near, strict=True) if hit)


def pace(robot: Joints, t: np.ndarray, q: np.ndarray) -> tuple[float, str]:
    """Return the largest ratio of joint speed to limit along q (K, n) at times t (K,) [s], and the name of that joint."""
    limit = np.where(robot.velocity_limits > 0.0, robot.velocity_limits, np.inf)
    if len(t) < 2:
        return 0.0, robot.joint_names[0]
    share = (np.abs(np.diff(q, axis=0)) / np.diff(t)[:, None] / limit).max(axis=0)
    worst = int(np.argmax(share))
    return float(share[worst]), robot.joint_names[worst]
