"""`track`: follow a whole reference, one step each sample, with the steps of `Tracker`.

Both run the same compiled loop (servo/loop.py). A run of `track` with on_limit="leave" therefore gives the same result as a
`Tracker` of that mode that is fed the same targets.
"""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..errors import Interrupted, InvalidConfiguration, InvalidOption, InvalidTarget
from ..kernel.counted_error import KIND
from ..motion.reference import Reference
from ..robot.narrow import with_limits
from ..robot.robot import Robot
from ..robot.rotation import angles_between
from ..robot.tree import Tree
from ..solvers.batch.targets import doubt_far
from ..solvers.collision_free import collision_model
from ..validate import number, one_of, positive
from .adapters import check_options
from .methods import Method, interpolate
from .path_reach import explain
from .result import (
    ORIENTATION_TOLERANCE,
    POSITION_TOLERANCE,
    TrackResult,
    TrackStatus,
    figures,
    hold_against,
    settling,
    verdict,
)
from .retimed_run import Run, Taken
from .tracker import JUMP, Tracker
from .workspace import STATE

MODES = ("slow", "leave", "clip")
# names of the options that select which errors count
COUNTS = ("mask", "slack", "free_turn", "frame", "priority", "relative_to")
MAX_STRETCH = 10.0  # By default a run may take up to this many times the duration of its reference.
FRACTIONS = (0.0, 0.25, 0.5, 0.75, 1.0)  # fractions of a step at which the error between samples is evaluated


class TrackInterrupted(Interrupted):
    """Ctrl-C during a run; `result` is the TrackResult of the steps until then, or of the best run if one had ended."""


def track(
    robot: Robot | Tree,
    reference: Reference | Mapping[str, Reference],
    method: str | Method = "cv",
    *,
    dt: float = 0.01,
    q0: Any = None,
    rate0: Any = None,
    limits: Any = True,
    acceleration_limits: Any = None,
    on_limit: str = "slow",
    max_stretch: float = MAX_STRETCH,
    position_tolerance: float = POSITION_TOLERANCE,
    orientation_tolerance: float = ORIENTATION_TOLERANCE,
    settle: float | None = None,
    **options: Any,
) -> TrackResult:
    """Follow a reference with a tracking method, one step each dt.

    A run that diverges ends early, with a status and a sentence; its arrays hold the samples up to then. If a run leaves its
    reference, `reach` and the message of the result say which poses can be reached at all, and which of the changes that were
    tried would work. A UserWarning before the run says that the gains are unstable at dt.

    Args:
        robot: A Robot, or a Tree (several tips).
        reference: The reference to follow; for a Tree a dict by tip.
        method: A Method, its name (cv, av, ca, aa or aad), or a solver that tracks.
        dt: Sample time [s].
        q0: Joint values (n,) [rad or m] at the start; default home if the reference starts there, else a solution for
            its start.
        rate0: Joint rates (n,) at the start, as in `Tracker`.
        limits: Whether to keep joint position and speed limits, or narrower limits as in `ik.solve`.
        acceleration_limits: Limits of joint accelerations [rad/s^2 or m/s^2], as in `Tracker`.
        on_limit: "slow" follows the reference in its own time; if a sample is out of tolerance, it slows the reference's
            clock, ds/dt <= 1, as little as joint limits and tolerances allow. (A solver always lags behind a moving target,
            so with a solver the clock is slowed for limits only.) "leave" keeps time, with the least error possible. "clip"
            is the published form, each joint clipped on its own; if limits is False, it is always used.
        max_stretch: With "slow", the run ends when it has taken this many times the duration of the reference.
        position_tolerance: Largest position error [m] from settle on for COMPLETED or SLOWED; above it the run is LEFT or LOST.
        orientation_tolerance: Largest rotation angle [rad] from settle on, likewise.
        settle: Time [s] from which on errors are judged. Default 0; if the arm starts at rest (with acceleration_limits, or
            with a rate0 of zeros), 0.5, or half the duration of a run shorter than 1 s.
        options: Options of the method (kappa, kp, kd, share, reading, gamma, null_damping, damping, see `Method`), and
            those of `Tracker`.

    Returns:
        The TrackResult, with arrays and figures.

    Raises:
        TrackInterrupted: Ctrl-C was pressed; it is a KeyboardInterrupt whose `result` holds the steps taken (before the
            first step, a plain KeyboardInterrupt is raised).
        InvalidOption: An option is unknown or out of range.
        InvalidTarget: `reference` is no Reference, is not finite, or lacks a tip.
        InvalidConfiguration: q0 is outside the limits or in collision, or has the wrong shape.
    """
    references = _references(robot, reference)
    robot, limits = with_limits(robot, limits)
    own, passed_on = track.__kwdefaults__ or (), Tracker.__init__.__kwdefaults__ or ()
    check_options(method, (name for name in options if name not in passed_on), (*own, *passed_on))
    dt = positive(dt, "dt [s]")
    duration = references[0].duration
    times = references[0].times(dt)
    if len(times) < 2:
        raise InvalidOption(f"dt = {dt:g} s is longer than the reference ({duration:g} s)")
    tolerances = (
        positive(position_tolerance, "position_tolerance [m]"),
        positive(orientation_tolerance, "orientation_tolerance [rad]"),
    )
    # Without limits there is no reason to slow down.
    mode = "clip" if limits is False else one_of(on_limit, MODES, "on_limit")
    stretch = number(max_stretch, "max_stretch")
    if stretch < 1.0:
        raise InvalidOption(f"max_stretch must be at least 1, not {stretch:g}")
    seen = np.linspace(0.0, duration, 65)  # times [s] at which poses are sampled to see how far the path extends
    doubt_far(robot, np.stack([one.at(seen)[0] for one in references], axis=1), "the path")
    wishes = {name: options[name] for name in ("avoid_collisions", "priority") if name in options}
    q0 = _start(robot, references, wishes) if q0 is None else q0
    tracker = Tracker(
        robot, method, q0=q0, rate0=rate0, limits=limits, acceleration_limits=acceleration_limits,
        on_limit="clip" if mode == "clip" else "leave", **options,
    )  # fmt: skip
    outside = ", ".join(robot.outside(tracker.q)) if limits else ""
    if outside:
        raise InvalidConfiguration(f"q0 is outside the limits of {outside}; move it inside or use limits=False")
    engine = tracker.engine
    check = engine.check(dt)
    if check is not None and check.verdict == "unstable":
        warnings.warn(check.message, stacklevel=2)
    settle = settling(settle, tracker.stepper.begins_at_rest(), times[-1])
    tracker.stepper.prepare(tuple(KIND.position if one.position_only else KIND.pose for one in references))
    counts = {name: value for name, value in options.items() if name in COUNTS}
    # Positions are judged only if they have the highest priority at some tip; likewise orientations.
    tolerances = tuple(np.where(tracker.stepper.judged.firm.any(axis=0), tolerances, np.inf))
    run = Run(tracker.stepper, references, times, tolerances, settle, stretch, counts)
    best = run.go(mode == "slow")

    result = None
    try:
        result = _judged(run, best, check)
        if result.status in (TrackStatus.LEFT, TrackStatus.LOST) and not run.interrupted:
            asked = robot.for_tips(dict(zip(robot.tips, references, strict=True)))
            reach, words = explain(robot, asked, q0, limits=limits, **counts)
            result.reach, result.message = reach, f"{result.message} {words}".rstrip()
    except KeyboardInterrupt:
        run.interrupted = True
    if run.interrupted or result is None:
        raise TrackInterrupted(result or _judged(run, best, check))
    return result


def _references(robot: Any, reference: Any) -> list[Reference]:
    """Return one reference per tip. Raises InvalidOption if `robot` is not a robot, InvalidTarget if a reference is missing."""
    if not isinstance(robot, Robot | Tree):
        raise InvalidOption(f"tracking takes a Robot (see Robot.load) or a Tree, not {type(robot).__name__}")
    kinds = f"a dict of References, one for each of {', '.join(robot.tips)}"
    each = robot.each_tip(reference)
    found = (
        [one for one in map(each.get, robot.tips) if isinstance(one, Reference)] if isinstance(each, Mapping) else []
    )
    if len(found) < len(robot.tips):
        wanted = kinds if robot.named_tips else "a Reference (ik.circle, ik.line, ...)"
        given = type(reference).__name__
        if isinstance(reference, Mapping):
            given = f"{{{', '.join(f'{tip}: {type(one).__name__}' for tip, one in reference.items())}}}"
        raise InvalidTarget(f"track follows {wanted}, not {given}")
    if len({one.duration for one in found}) > 1:
        raise InvalidTarget(
            f"the references of the tips must last equally long, not {[one.duration for one in found]} s"
        )
    return found


def _judged(run: Run, best: Taken, check: Any) -> TrackResult:
    """Return the result of a run with its figures and verdict; check: the verdict on its gains, or None."""
    made = _result(run, best, check)
    made.figures = figures(made, run.stepper.robot.chain.unit * JUMP)
    made.status, made.message = verdict(made, int(run.stepper.state[STATE.stop]), run.count)
    hold_against(made, run.stepper.robot)
    return made


def _result(run: Run, best: Taken, check: Any) -> TrackResult:
    """Return the result of a run in m and rad, without figures and verdict."""
    robot, references, clock = run.stepper.robot, run.references, best.clock.s
    Q, R = best.Q * robot.chain.unit, best.R * robot.chain.unit
    t, done = np.arange(len(Q)) * run.dt, len(Q) - 1
    targets = np.stack([one.at(clock)[0] for one in references], axis=1)
    tips = robot.chain.forward(Q)[0].reshape(targets.shape)
    errors = best.E.reshape(done + 1, -1, 6)
    posed = [tip for tip, one in enumerate(run.stepper.judged.posed) if one]
    tip = slice(None) if robot.by_tip else 0
    between = (
        _between(robot, references[0], Q, R, run.stepper.engine, run.dt, clock) if done and tip == 0 else (None, None)
    )
    return TrackResult(
        robot=robot.name,
        method=run.stepper.engine.name,
        options=run.stepper.engine.settings(run.dt),
        dt=run.dt,
        joint_names=robot.joint_names,
        t=t,
        q=Q,
        rate=R,
        xyz=tips[:, tip, :3, 3],
        target_xyz=targets[:, tip, :3, 3],
        position_error=np.linalg.norm(errors[:, :, :3], axis=2).max(axis=1),
        orientation_error=np.linalg.norm(errors[:, posed, 3:], axis=2).max(axis=1) if posed else None,
        limited=best.C,
        damped=best.S[:done] > 0.0,
        between_position=between[0],
        between_orientation=between[1],
        elapsed=best.elapsed,
        searched=run.searched,
        between=best.between,
        gain_check=check,
        position_tolerance=float(run.tolerances[0]),
        orientation_tolerance=float(run.tolerances[1]),
        settle=run.settle,
        clock=clock,
        sigma=np.minimum(np.diff(clock) / np.diff(t), 1.0),  # `clock.rate` is at the samples, this the mean of a step
        pace=best.clock.joint[:done],
        end=float(run.times[-1]),
        tips=robot.tips,
    )


def _apart(T: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (M,) [m] and angles (M,) [rad] between two sets of poses (M, 4, 4)."""
    away = np.linalg.norm(T[:, :3, 3] - wanted[:, :3, 3], axis=1)
    return away, angles_between(T[:, :3, :3], wanted[:, :3, :3])


def _start(robot: Any, references: list[Reference], wishes: Mapping[str, Any]) -> np.ndarray:
    """Return home if the tips are then at the start of their references, else joint values that bring them there.

    If no such joint values are found, the best attempt is returned. wishes: the options `avoid_collisions` and `priority`; if
    something touches at home, another start is sought.
    """
    avoid = wishes.get("avoid_collisions", False)
    targets = robot.for_tips({tip: one.target(0.0) for tip, one in zip(robot.tips, references, strict=True)})
    errors = np.array(robot.errors(robot.home, targets), dtype=float).reshape(-1, 2)  # NaN where orientation is free
    touches = avoid is not False and collision_model(robot, avoid).collides(robot.home)
    if not touches and not (errors >= 1e-9).any():
        return robot.home
    from ..solvers.solve import solve

    return solve(robot, targets, q0=robot.home, **wishes).q


def _between(
    robot: Any, reference: Reference, Q: np.ndarray, R: np.ndarray, engine: Any, dt: float, clock: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return the largest position error [m] and orientation error [rad] in each step, (N,), its ends included.

    The joint motion in a step is the one that the method assumes. Q, R (N + 1, n): joint values and rates; clock (N +
    1,) [s]: the reference's time. Both results are None if only part of an error counts.
    """
    if any(one is not None for one in (engine.options.mask, engine.options.slack, engine.options.free_turn)):
        return None, None  # Only the compiled loop knows which part of the error counts with these options.
    worst_p, worst_o = np.zeros(len(Q) - 1), np.zeros(len(Q) - 1)
    for f in FRACTIONS:
        T = robot.chain.forward(interpolate(Q, R, engine.gamma, dt, f))[0]
        wanted = reference.at(clock[:-1] + f * np.diff(clock))[0]
        away, turn = _apart(T, wanted)
        worst_p, worst_o = np.maximum(worst_p, away), np.maximum(worst_o, turn)
    return worst_p, None if reference.position_only else worst_o
