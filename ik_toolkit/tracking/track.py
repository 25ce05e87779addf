"""`track`: follow a whole reference, one step each sample, with the steps of `Tracker`.

Both run the same compiled step (kernel/motion.py), so a run of `track` equals the same targets fed to `Tracker.update`.
"""

import time
import warnings
from typing import Any

import numpy as np

from ..errors import InvalidOption, InvalidTarget
from ..kernel import motion
from ..robot.pose import PROJECT_WITHIN
from ..robot.robot import Robot
from ..robot.tree import require_one_tip
from .inputs import positive
from .methods import Method, interpolate
from .reachable import explain
from .reference import Reference, Samples
from .result import TrackResult, TrackStatus, figures
from .tracker import JUMP, Tracker
from .verdict import ORIENTATION_TOLERANCE, POSITION_TOLERANCE, settling, verdict

RUNAWAY = 100.0  # mean joint move [rad, or reaches] in one step beyond which a run has diverged
FRACTIONS = (0.25, 0.5, 0.75)  # where between two samples the error is looked at


def track(
    robot: Robot,
    reference: Reference,
    method: str | Method = "cv",
    *,
    dt: float = 0.01,
    q0: Any = None,
    rate0: Any = None,
    limits: bool = True,
    acceleration_limits: Any = None,
    position_tolerance: float = POSITION_TOLERANCE,
    orientation_tolerance: float = ORIENTATION_TOLERANCE,
    settle: float | None = None,
    **options: Any,
) -> TrackResult:
    """Follow a reference with a method, one step each dt [s]; returns a TrackResult with arrays and figures.

    method: cv, av, ca, aa or aad, options as in `Method` (kappa, kp, kd, reading, gamma, null_damping, damping). q0 (n,):
    default home if the reference starts there, else a solution for the reference's start. rate0, limits and
    acceleration_limits as in `Tracker`. COMPLETED or SLOWED when no sample from settle [s] on has an error above
    position_tolerance [m] and orientation_tolerance [rad], else LEFT or LOST (see `TrackStatus`); settle is 0 by default, and
    0.5 (half of a run shorter than 1 s) when the arm starts at rest: with acceleration_limits, or with a rate0 of zeros. Warns
    (UserWarning) before the run when the gains are unstable at dt. A run that diverges ends there, with a status and a
    sentence; the arrays hold only what was reached. Of a run that leaves its reference `reach` and the message say where along
    it the poses can be reached at all, and what was tried and would work. Raises InvalidOption, InvalidTarget,
    InvalidConfiguration.
    """
    require_one_tip(robot, "tracking")
    if not isinstance(reference, Reference):
        raise InvalidTarget(f"track follows a Reference (ik.circle, ik.line, ...), not {type(reference).__name__}")
    dt = positive(dt, "dt [s]")
    times = reference.times(dt)
    if len(times) < 2:
        raise InvalidOption(f"dt = {dt:g} s is longer than the reference ({reference.duration:g} s)")
    tolerances = (
        positive(position_tolerance, "position_tolerance [m]"),
        positive(orientation_tolerance, "orientation_tolerance [rad]"),
    )
    T, V, A = _samples(reference, times)
    q0 = _start(robot, reference) if q0 is None else q0
    tracker = Tracker(
        robot, method, q0=q0, rate0=rate0, limits=limits, acceleration_limits=acceleration_limits, **options
    )
    engine = tracker.engine
    check = engine.check(dt)
    if check is not None and check.verdict == "unstable":
        warnings.warn(check.message, stacklevel=2)
    tracker._m = 3 if reference.position_only else 6
    at_rest = tracker._state[motion.STATE.start] == motion.GIVEN and not tracker._rate.any()
    settle = settling(settle, at_rest, times[-1])
    n, steps = robot.n, len(times) - 1
    Q, R, E = np.zeros((steps + 1, n)), np.zeros((steps + 1, n)), np.zeros((steps + 1, 6))
    C, D = np.zeros((steps, n), np.uint8), np.zeros(steps)
    # No step yet: this compiles (or loads) the loop, so that the time reported is that of tracking.
    tracker._steps(T[:1], V[:1], A[:1], dt, False, RUNAWAY, Q, R, E, C, D)
    began = time.perf_counter()
    done = tracker._steps(T, V, A, dt, False, RUNAWAY, Q, R, E, C, D)
    elapsed = time.perf_counter() - began
    keep = slice(0, done + 1)  # at a stop, row `done` is the last state reached; it has been evaluated
    unit = robot.chain.unit
    Q, R, E = Q[keep] * unit, R[keep] * unit, E[keep]
    between = _between(robot, reference, Q, R, engine.gamma, dt) if done else (None, None)
    stop = int(tracker._state[motion.STATE.stop])
    result = TrackResult(
        robot=robot.name,
        method=engine.name,
        options=engine.settings(dt),
        dt=float(dt),
        joint_names=robot.joint_names,
        t=times[keep],
        q=Q,
        rate=R,
        xyz=T[keep, :3, 3] - E[:, :3],
        target_xyz=T[keep, :3, 3],
        position_error=np.linalg.norm(E[:, :3], axis=1),
        orientation_error=None if reference.position_only else np.linalg.norm(E[:, 3:], axis=1),
        limited=C[:done],
        damped=D[:done] > 0.0,
        between_position=between[0],
        between_orientation=between[1],
        elapsed=elapsed,
        gain_check=check,
        position_tolerance=tolerances[0],
        orientation_tolerance=tolerances[1],
        settle=settle,
    )
    result.figures = figures(result, robot.chain.unit * JUMP)
    result.status, result.message = verdict(result, stop, steps)
    if result.status in (TrackStatus.LEFT, TrackStatus.LOST):
        result.reach, words = explain(robot, reference, q0, limits=limits)
        result.message = f"{result.message} {words}".rstrip()
    return result


def _samples(reference: Reference, times: np.ndarray) -> Samples:
    """Pose, twist and acceleration at the samples. Raises InvalidTarget, with the time, where they are none."""
    T, V, A = reference.at(times)
    used = T[:, :3, 3] if reference.position_only else T.reshape(len(T), 16)
    bad = ~np.isfinite(np.hstack([used, V, A])).all(axis=1)
    what = "is not finite"
    if not (bad.any() or reference.position_only):  # as for a single target, see `check_target`
        R = T[:, :3, :3]
        bad = np.abs(T[:, 3] - (0.0, 0.0, 0.0, 1.0)).max(axis=1) > 1e-9
        bad |= np.abs(np.linalg.svd(R, compute_uv=False) - 1.0).max(axis=1) > PROJECT_WITHIN
        bad |= np.linalg.det(R) < 0.0
        what = "is no pose (a rotation, a position and the last row 0 0 0 1)"
    if bad.any():
        raise InvalidTarget(f"reference '{reference.name}' {what} at t = {times[int(np.argmax(bad))]:g} s")
    return T, V, A


def _start(robot: Robot, reference: Reference) -> np.ndarray:
    """Home if the tip is then at the reference's start, else a solution of it (the best one found, if none)."""
    target = reference.target(0.0)
    position, orientation = robot.errors(robot.home, target)
    if position < 1e-9 and (orientation or 0.0) < 1e-9:
        return robot.home
    from ..solvers.solve import solve

    return solve(robot, target, q0=robot.home).q


def _between(
    robot: Robot, reference: Reference, Q: np.ndarray, R: np.ndarray, gamma: float, dt: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """Largest position and orientation error (N,) inside each step, on the motion the method itself assumes."""
    worst_p, worst_o = np.zeros(len(Q) - 1), np.zeros(len(Q) - 1)
    start = np.arange(len(Q) - 1) * dt
    for f in FRACTIONS:
        T = robot.chain.forward(interpolate(Q, R, gamma, dt, f))[0]
        wanted = reference.at(start + f * dt)[0]
        worst_p = np.maximum(worst_p, np.linalg.norm(T[:, :3, 3] - wanted[:, :3, 3], axis=1))
        chord = np.linalg.norm(T[:, :3, :3] - wanted[:, :3, :3], axis=(1, 2)) / np.sqrt(8.0)
        worst_o = np.maximum(worst_o, 2.0 * np.arcsin(np.minimum(chord, 1.0)))
    return worst_p, None if reference.position_only else worst_o
