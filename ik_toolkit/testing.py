"""The contract that every solver keeps, as a test that you can run on your own iterative solver (rule) or closed form.

    from ik_toolkit.testing import check_solver
    check_solver(HalfStep)

Each clause of the contract is a function of a `Case` (a solver, a robot, a kind of target) that raises AssertionError with a
sentence; `CLAUSES` lists them by name. Poses are compared by Pinocchio and numpy, never by the code that computed the result.
"""

import functools
import pickle
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from .errors import InvalidOption, NotSolved, UnknownSolver
from .kernel.counted_error import KIND
from .kernel.kinematics import TAU
from .robot.robot import Robot
from .robot.tree import Tree
from .solvers.batch.solve_batch import solve_batch
from .solvers.protocol import Asked
from .solvers.registry import find_row
from .solvers.result import Result
from .solvers.rows import Row
from .solvers.solve import Solver
from .solvers.status import Status

KINDS = ("pose", "position")
# Tolerances, position [m] and rotation [rad], wide enough for slow methods too.
LOOSE: dict[str, Any] = {"position_tolerance": 1e-3, "orientation_tolerance": 1e-2}
SAMPLES = 8  # number of targets for which each clause of the contract is tested; most faults show at the first one
SHORT = 20  # [characters] A shorter message is not a proper sentence.
ROUNDING = 1e-9  # [m] largest difference from the pose that Pinocchio computes, with another order of operations
# [rad] largest difference of angles; near the identity a computed angle has only half of the digits
ANGLE_ROUNDING = 1e-7


def default_robots() -> list[Any]:
    """Return shipped robots of different kinds: six revolute joints, planar, prismatic, mixed, and two tips on one base."""
    arms = [Robot.load(name) for name in ("hydrolek_7w", "planar_2r", "planar_3r", "cartesian_pp", "inspection_7dof")]
    wrist = Robot.load("inspection_7dof", locked={"lift": 0.25})
    return [*arms, wrist, Tree.load("brokk_hydrolek")]


def check_solver(solver: Any, robots: Iterable[Any] | None = None, seed: int = 0) -> None:
    """Check that a solver keeps the contract, what every solver must do, on every robot that it accepts.

    Args:
        solver: A registered name, a class marked by `@ik_toolkit.rule` or `@ik_toolkit.closed_form`, or an instance of one.
        robots: Robots, trees or names. Default: shipped robots of different kinds.
        seed: Seed of the targets.

    Raises:
        AssertionError: "SOLVER on ROBOT (KIND): what is wrong", also if the solver accepts none of the robots.
        UnknownSolver: It is not a solver.
    """
    row = find_row(solver)
    made = default_robots() if robots is None else [Robot.load(r) if isinstance(r, str) else r for r in robots]
    fitting = [case for case in cases(solver, made, seed) if case.fits()]
    names = ", ".join(robot.name for robot in made)
    _hold(bool(fitting), f"{row.name} fits none of the robots ({names}); pass suitable ones with robots=")
    for case in fitting:
        for name, clause in CLAUSES.items():
            try:
                clause(case)
            except AssertionError:
                raise
            except Exception as error:
                what = f"{type(error).__name__}: {error}"
                raise AssertionError(f"{case}: {name.replace('_', ' ')}: it raises {what}") from error


def cases(solver: Any, robots: Iterable[Any], seed: int = 0) -> Iterator["Case"]:
    """Yield a test case for every robot and kind of target; arms that cannot orient their tip freely get positions only."""
    for robot in robots:
        for kind in KINDS:
            free = all(Asked(arm, (KIND.pose,)).rows == 6 for arm in robot.arms)
            if kind == "position" or free:
                yield Case(solver, robot, kind, seed)


class Case:
    """A solver to be tested on one robot with one kind of target, poses or positions."""

    def __init__(self, solver: Any, robot: Any, kind: str, seed: int = 0) -> None:
        """Take a solver as for `check_solver`, a Robot or Tree, and the kind of target: 'pose' or 'position'."""
        self.solver, self.robot, self.kind, self.seed = solver, robot, kind, seed
        self.row: Row = find_row(solver)

    def __str__(self) -> str:
        """Return the beginning of all messages of the case."""
        return f"{self.row.name} on {self.robot.name} ({self.kind})"

    def claim(self, holds: Any, sentence: str) -> None:
        """Raise AssertionError with the solver, the robot and the sentence unless `holds` is true."""
        _hold(bool(holds), f"{self}: {sentence}")

    def bind(self, **options: Any) -> Solver:
        """Return the solver under test bound to the robot of this case, ready for targets of this kind."""
        return Solver(self.robot, self.solver, **options)

    def fits(self) -> bool:
        """Return whether the solver accepts this robot and kind of target.

        Raises AssertionError if it refuses without an explanation.
        """
        try:
            self.bind()(self.target(self.robot.home))
        except (UnknownSolver, InvalidOption) as refused:
            self.claim(self.row.name in str(refused), f"a refusal must name the solver, and this does not: {refused}")
            self.claim(
                len(str(refused)) > len(self.row.name) + SHORT, f"a refusal must say why, and this does not: {refused}"
            )
            return False
        except Exception as error:
            self.claim(False, f"it neither solves nor refuses but raises {type(error).__name__}: {error}")
        return True

    def target(self, q: np.ndarray, moved: Any = 0.0) -> Any:
        """Return the target that the robot reaches at q (n,), shifted by a vector (3,) [m].

        It is a pose (4, 4) or a position (3,), for several tips a dict of them by tip.
        """
        poses = {tip: pose + _shift(moved) for tip, pose in self.poses(q).items()}
        if self.kind == "position":
            poses = {tip: T[:3, 3].copy() for tip, T in poses.items()}
        return poses if len(poses) > 1 else next(iter(poses.values()))

    def poses(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Return T_base_tip (4, 4) [m] of each tip at q (n,), computed by Pinocchio."""
        arms = zip(self.robot.arms, self.robot.places, strict=True)
        return {arm.tip: arm.fk(np.asarray(q)[place]).homogeneous for arm, place in arms}

    def left(self, q: np.ndarray, target: Any) -> tuple[float, float | None]:
        """Return the largest position [m] and rotation error [rad] of any tip at q (n,); the rotation is None for positions."""
        wanted = target if isinstance(target, dict) else {self.robot.tips[0]: target}
        errors = [_error(T, np.asarray(wanted[tip])) for tip, T in self.poses(q).items()]
        angles = [angle for _, angle in errors if angle is not None]
        return max(distance for distance, _ in errors), max(angles, default=None)

    @functools.cached_property
    def sample(self) -> list[tuple[Any, np.ndarray, Result]]:
        """Solve for some targets with wide tolerances (LOOSE), as examples for all tests: tuples (target, start, result).

        Half of the starts are near a solution, half are home.
        """
        solver, robot, rng = self.bind(**LOOSE), self.robot, np.random.default_rng(self.seed)
        rows = []
        for k in range(SAMPLES):
            q = robot.random_q(rng)
            near = np.clip(q + rng.uniform(-0.02, 0.02, robot.n), robot.lower, robot.upper)
            start = near if k < SAMPLES // 2 else robot.home.copy()
            target = self.target(q)
            rows.append((target, start, solver(target, q0=start)))
        return rows


def _hold(holds: bool, sentence: str) -> None:
    if not holds:
        raise AssertionError(sentence)


def _shift(moved: Any) -> np.ndarray:
    T = np.zeros((4, 4))
    T[:3, 3] = moved
    return T


def _error(T: np.ndarray, target: np.ndarray) -> tuple[float, float | None]:
    """Return the distance [m] and angle [rad] from a pose (4, 4) to a target (4, 4); for a position (3,) the angle is None."""
    if target.shape == (3,):
        return float(np.linalg.norm(target - T[:3, 3])), None
    R = target[:3, :3] @ T[:3, :3].T
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    angle = float(np.arctan2(np.linalg.norm(axis), 0.5 * (np.trace(R) - 1.0)))
    return float(np.linalg.norm(target[:3, 3] - T[:3, 3])), angle


def _inside(case: Case, q: np.ndarray) -> str:
    """Return the name of a joint whose value is outside its limits or not finite, '' if there is none."""
    good = np.isfinite(q) & (q >= case.robot.lower) & (q <= case.robot.upper)
    return "" if good.all() else case.robot.joint_names[int(np.argmin(good))]


# ------------------------------------------------------------------------------------------------------------- clauses
def leaves_arguments_alone(case: Case) -> None:
    """Check that a call leaves its target and start unchanged."""
    solver, q = case.bind(**LOOSE), case.robot.random_q(np.random.default_rng(case.seed))
    target, start = case.target(q), case.robot.home.copy()
    before, began = pickle.dumps(target), start.copy()
    solver(target, q0=start)
    case.claim(pickle.dumps(target) == before, "the call changed its target")
    case.claim((start == began).all(), "the call changed its q0")


def answers_inside_the_limits(case: Case) -> None:
    """Check that the returned q is finite and inside the joint limits, whether the target is solved or not."""
    for _, _, result in case.sample:
        joint = _inside(case, result.q)
        case.claim(not joint, f"q is not finite or outside the limits at joint {joint} ({result.status.name})")
        case.claim(
            result.limited_joints == tuple(case.robot.at_limits(result.q)), "limited_joints are not those of its q"
        )


def reports_the_errors_of_its_q(case: Case) -> None:
    """Check that the reported errors are those of the returned q, according to Pinocchio."""
    for target, _, result in case.sample:
        distance, angle = case.left(result.q, target)
        said = result.position_error
        case.claim(abs(distance - said) < ROUNDING, f"it reports an error of {said:.3g} m, but it is {distance:.3g} m")
        case.claim((angle is None) == (result.orientation_error is None), "only poses have an orientation error")
        if angle is not None and result.orientation_error is not None:
            said = result.orientation_error
            case.claim(
                abs(angle - said) < ANGLE_ROUNDING, f"it reports an error of {said:.3g} rad, but it is {angle:.3g} rad"
            )


def succeeds_inside_the_tolerances_only(case: Case) -> None:
    """Check that success is reported if and only if both errors are inside their tolerances."""
    for _, _, result in case.sample:
        inside = result.position_error <= LOOSE["position_tolerance"]
        inside = inside and (result.orientation_error or 0.0) <= LOOSE["orientation_tolerance"]
        case.claim(result.success == inside, f"{result.status.name} with an error of {result.position_error:.3g} m")
        case.claim(result.success == (result.status == Status.CONVERGED), "success and status contradict each other")
        case.claim(len(result.message) >= 10, "the message is not a sentence")


def gives_the_same_bytes_again(case: Case) -> None:
    """Check that the same target, start and seed give exactly the same result and counts again, also with a newly bound solver."""
    again = case.bind(**LOOSE)
    for target, start, result in case.sample:
        other = again(target, q0=start)
        case.claim(other.q.tobytes() == result.q.tobytes(), "the same call gave another q")
        counts = [(r.iterations, r.restarts, r.fk_evaluations) for r in (result, other)]
        case.claim(counts[0] == counts[1], "the same call gave other counts")
        case.claim(
            min(counts[0]) >= 0 and counts[0][2] >= 1, "counts must not be negative, and q must be evaluated once"
        )


def solves_an_easy_target(case: Case) -> None:
    """Check that a solver reaches a target a hundredth of a radian (or metre) away, and takes no step if its start meets it."""
    solver, rng, solved = case.bind(tolerance=1e-3), np.random.default_rng(case.seed), 0
    robot = case.robot
    for _ in range(SAMPLES):
        q = robot.random_q(rng)
        target = case.target(q)
        near = np.clip(q + rng.uniform(-0.01, 0.01, robot.n), robot.lower, robot.upper)
        solved += solver(target, q0=near).success
        at_once = solver(target, q0=q)
        case.claim(at_once.success, f"it starts at the target and ends with {at_once.status.name}")
        case.claim(at_once.iterations == 0 and at_once.restarts == 0, "it starts at the target but still takes steps")
    case.claim(solved, f"none of {SAMPLES} targets a hundredth of a radian away is reached within 1e-3")


def says_why_it_fails(case: Case) -> None:
    """Check that a target far out of reach gives a failure status, a finite q, and NotSolved from raise_for_status."""
    result = case.bind()(case.target(case.robot.home, moved=(1e3, 2e3, -5e2)))
    case.claim(
        result.status not in (Status.CONVERGED, Status.CHECK_FAILED),
        f"a target 2 km away ends with {result.status.name}",
    )
    case.claim(np.isfinite(result.q).all(), "a target out of reach gives a q that is not finite")
    try:
        result.raise_for_status()
    except NotSolved as failure:
        case.claim(result.status.name in str(failure), "NotSolved does not name the status")
    else:
        case.claim(False, "raise_for_status does not raise for a failure")


def keeps_to_its_budget(case: Case) -> None:
    """Check that a solver never exceeds max_evaluations, max_iterations and restarts."""
    target = case.target(case.robot.upper * 0.8 + case.robot.lower * 0.2 if _bounded(case) else case.robot.home + 0.7)
    for budget in (1, 2, 5, 40):
        result = case.bind(max_evaluations=budget, tolerance=1e-14)(target)
        case.claim(result.fk_evaluations <= budget, f"{result.fk_evaluations} evaluations, but {budget} are allowed")
    if case.row.closed:
        return
    for budget in (0, 1, 7):
        result = case.bind(max_iterations=budget, restarts=0, tolerance=1e-12)(target)
        case.claim(result.iterations <= budget, f"{result.iterations} iterations, but {budget} are allowed")
        case.claim(result.restarts == 0, "it restarts although restarts=0 forbids it")
    result = case.bind(restarts=2, max_iterations=2, tolerance=1e-14)(target)
    case.claim(result.restarts <= 2 and result.iterations <= 6, "three attempts of two iterations take more")


def _bounded(case: Case) -> bool:
    return bool(np.isfinite(case.robot.lower).all() and np.isfinite(case.robot.upper).all())


def records_every_evaluation(case: Case) -> None:
    """Check that history=True records q and errors of every iteration, and that the result is one of them (modulo 2 pi)."""
    target = case.target(np.clip(case.robot.home + 0.1, case.robot.lower, case.robot.upper))
    result = case.bind(history=True, restarts=0, max_iterations=20)(target)
    history = result.history
    case.claim(history is not None and len(history["q"]) >= 1, "there is no history")
    assert history is not None
    if not case.row.closed:
        # The last step of a solve that stalls moves no joint and is not evaluated.
        last = 0 if result.status == Status.STALLED else 1
        case.claim(
            last <= len(history["q"]) - result.iterations <= 1,
            "the history must have one row more than there are iterations",
        )
    for q, distance in zip(history["q"], history["position_error"], strict=True):
        case.claim(abs(case.left(q, target)[0] - distance) < ROUNDING, "a row's error is not that of its q")
        case.claim(not _inside(case, q), "a row has a q outside the limits")
    least = history["position_error"].min()
    case.claim(result.position_error >= least - ROUNDING, "the result's error is in no row")


def holds_joints(case: Case) -> None:
    """Check that a joint with weight 0 keeps its value from q0, or that the solver rejects weights with a message."""
    robot = case.robot
    if robot.n == 1:  # A robot whose only joint is held cannot solve anything.
        return
    weights = np.ones(robot.n)
    weights[-1] = 0.0
    start = robot.random_q(np.random.default_rng(case.seed))
    target = case.target(robot.random_q(np.random.default_rng(case.seed + 1)))
    try:
        result = case.bind(joint_weights=weights.tolist(), restarts=3, max_iterations=50)(target, q0=start)
    except (InvalidOption, UnknownSolver) as refused:
        case.claim(case.row.name in str(refused), f"a refusal must name the solver, and this does not: {refused}")
        return
    case.claim(result.q[-1] == start[-1], f"joint {robot.joint_names[-1]} has weight 0 and moved")


def solves_batches(case: Case) -> None:
    """Check that every row of a batch keeps the contract, and that one thread and two give exactly the same results."""
    Q = [case.robot.random_q(np.random.default_rng([case.seed, k])) for k in range(SAMPLES)]
    targets = [case.target(q) for q in Q]
    several = isinstance(targets[0], dict)
    stacked = {tip: np.array([t[tip] for t in targets]) for tip in targets[0]} if several else np.array(targets)
    one, two = (solve_batch(case.robot, stacked, case.solver, threads=k, **LOOSE) for k in (1, 2))
    case.claim(one.q.tobytes() == two.q.tobytes(), "one and two threads give different results")
    for target, q, success in zip(targets, one.q, one.success, strict=True):
        distance, angle = case.left(q, target)
        inside = distance <= LOOSE["position_tolerance"] and (angle or 0.0) <= LOOSE["orientation_tolerance"]
        case.claim(success == inside, f"a batch row reports success={bool(success)} with an error of {distance:.3g} m")
        case.claim(not _inside(case, q), "a row of a batch is outside the limits")


def lists_solutions(case: Case) -> None:
    """Check that all solutions of `Solver.all` reach the target inside the limits, and that a list called complete is."""
    robot = case.robot
    known = robot.random_q(np.random.default_rng(case.seed))
    beyond = np.where(np.isfinite(robot.upper), robot.upper + 0.3, known)
    for planted in (known, beyond):
        target = case.target(planted)
        found = case.bind(max_iterations=100).all(target, starts=20, count=8)
        case.claim(len(found) <= 8, "it lists more solutions than requested")
        case.claim(len(np.unique(found.q.round(6), axis=0)) == len(found), "it lists a solution twice")
        for q in found.q:
            distance, angle = case.left(q, target)
            case.claim(distance <= 1e-6 and (angle or 0.0) <= 1e-6, f"a listed solution is off by {distance:.3g} m")
            case.claim(not _inside(case, q), "a listed solution is outside the limits")
        if found.complete and planted is known and len(found) < 8:
            apart = np.abs(found.q - known)
            apart = np.where(robot.slides, apart, np.minimum(apart % TAU, -apart % TAU)).max(axis=1)
            case.claim((apart < 1e-3).any(), "a list called complete lacks a solution")


def survives_pickling(case: Case) -> None:
    """Check that a solver bound to a robot gives the same result after pickling."""
    target, start, result = case.sample[0]
    sent = pickle.loads(pickle.dumps(case.bind(**LOOSE)))  # noqa: S301  made one line above
    case.claim(sent(target, q0=start).q.tobytes() == result.q.tobytes(), "a pickled solver gives another result")


CLAUSES: dict[str, Callable[[Case], None]] = {
    clause.__name__: clause
    for clause in (
        leaves_arguments_alone,
        answers_inside_the_limits,
        reports_the_errors_of_its_q,
        succeeds_inside_the_tolerances_only,
        gives_the_same_bytes_again,
        solves_an_easy_target,
        says_why_it_fails,
        keeps_to_its_budget,
        records_every_evaluation,
        holds_joints,
        solves_batches,
        lists_solutions,
        survives_pickling,
    )
}
