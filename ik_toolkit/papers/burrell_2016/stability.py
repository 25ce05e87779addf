"""Convergence and stability of the two solvers, which Burrell et al. (2016) announce for future articles; the analysis is ours."""

import numpy as np

from ...robot.robot import Robot
from ...solvers.batch.result import BatchResult
from ...solvers.rules.pid import PID
from ...solvers.rules.pid import UNITS as PID_UNITS
from ...solvers.rules.state_space import StateSpace
from ...study.analyse import LoopAnalysis, analyse, gain_margins
from ...study.benchmark import wilson
from ..report import Report
from .figures import draw_stability
from .published import attempt

# Without limits a run ends in the three-dimensional "slice" of joint space q0 + S w, where S is the static gain of the solver and w
# any sum of errors. A run within this distance [rad] of the slice counts as ended in it.
SETTLED = 1e-6
NEAR = 1e-9  # A joint nearer to a limit than this [rad] counts as at the limit.
# Gains K_p of IK-PID [degrees per mm] for which the share of goals that theory predicts is compared with the share that runs solve.
KP = (0.02, 0.05, 0.07, 0.1, 0.12, 0.15, 0.2)


def stability(report: Report, robot: Robot, starts: dict[str, np.ndarray], sets: list[np.ndarray]) -> None:
    """Add the section on convergence and stability of the paper's solvers to the report.

    starts: start configurations (n,) [rad] by name. sets: arrays of goals (N, 3) [m].
    """
    report.heading("Beyond the paper: the convergence and stability it announces")
    rule = StateSpace.preset("burrell-2016")
    found = analyse(robot, rule)
    goals = np.concatenate(sets)
    rows = [[name, *outcomes(found, attempt(robot, goals, rule, q0), goals, q0)] for name, q0 in starts.items()]
    head = ["start", "solved", "failed at a limit", "solved at a limit", "solved on the slice", "foretold"]
    report.table("stability", [f"{head[0]} ({len(goals)} goals)", *(f"{name} (%)" for name in head[1:])], rows)
    low, high = wilson(int(found.stable.sum()), len(found.q))
    gain = found.loop_gain.real
    report.number("locally_stable", {"share": float(found.stable.mean()), "wilson": [low, high]})
    report.number("loop_gain", [float(gain.min()), float(gain.max())])
    report.text(
        f"""**State space.** To first order a step is linear in the error and the state, so a configuration is locally stable if
        the spectral radius of that step is below 1: {100 * found.stable.mean():.1f} % of {len(found.q)} random configurations
        are ({100 * low:.1f}-{100 * high:.1f} %). The loop gain is {gain.min():.3f} to {gain.max():.3f}; Jury's test allows 0 to
        {found.gain_bound:g}. Instability therefore does not explain the failures. Limits do: nearly all failed runs end with a
        joint at one. A run that none touches ends on the slice q0 + C (I - A)^-1 B w of three dimensions, whatever A is. Running
        that static map by itself, with the limits but without A ("foretold": share of goals with the same outcome), tells nearly
        every outcome from the middle of the ranges, and fewer from a start near the limits (fitted). Most runs from there that
        succeed have left their slice, because a joint that stops at a limit shifts it; what the state does at such a moment, the
        static map does not know. So the start and the slice decide what is reached,
        and A how fast: near a solution a tenth of the error takes {np.median(found.steps_per_decade):.0f} steps (median)."""
    )
    margins, swept = margin_sweep(robot, goals, starts["mid-range"])
    report.table("gain_margin", ["K_p (degrees a mm)", "margin above K_p (%)", "solved (%)"], swept)
    report.text(
        f"""**IK-PID.** A small error shrinks, whatever its direction, if K_p is below the gain margin of the configuration: the
        least over all directions u of the largest 2 |J_i . u| / |J_i|^2. At the goals' solutions it is
        {np.median(margins):.3f} degrees per mm (median; 5 to 95 %: {np.percentile(margins, 5):.3f} to
        {np.percentile(margins, 95):.3f}). The share of goals whose margin exceeds K_p is, without any run, close to the share
        that runs with this K_p solve from mid-range. The published threshold between 0.0847 and 0.0848 at one goal lies in the
        middle of these margins. The margin is a bound for small errors in the worst direction: some goals below it are solved,
        because the error arrives from another direction, and some above it are lost far from the solution."""
    )
    caption = (
        "Left: loop gain of the published A, B, C at random configurations. Right: share of goals with a gain margin above K_p, "
        "and goals solved"
    )
    report.figure("stability.png", caption, draw_stability, found.loop_gain, found.gain_bound or np.inf, margins, swept)


def outcomes(found: LoopAnalysis, run: BatchResult, goals: np.ndarray, q0: np.ndarray) -> list[float]:
    """Return a row of the table that compares actual with predicted outcomes, for solves from q0 (n,).

    The numbers are shares [%]: goals solved, failures with a joint at a limit, successes with a joint at a limit, successes in the
    slice of joint space that theory predicts, and goals whose outcome is as predicted.
    """
    robot, good = found.robot, run.success
    held = ((run.q <= robot.lower + NEAR) | (run.q >= robot.upper - NEAR)).any(axis=1)
    on_slice = found.off_slice(run.q[good], q0) < SETTLED
    shares = (good, held[~good], held[good], on_slice, good == found.predict(goals, q0))
    return [round(100.0 * float(np.mean(share)), 1) for share in shares]


def margin_sweep(robot: Robot, goals: np.ndarray, q0: np.ndarray) -> tuple[np.ndarray, list[list[float]]]:
    """Compare gain margins of IK-PID with runs.

    Returns the margins [degrees per mm] at solutions of the goals, and a row for each gain of KP: the gain, the share [%] of
    margins above it, and the share [%] of goals solved with it.
    """

    def runs(kp: float) -> BatchResult:
        return attempt(robot, goals, PID(kp=kp, units="mm-deg"), q0)

    slow = runs(0.01)
    margins = gain_margins(robot, slow.q[slow.success]) / PID_UNITS["mm-deg"]
    rows = [[kp, *(round(100.0 * float(x), 1) for x in ((margins > kp).mean(), runs(kp).success.mean()))] for kp in KP]
    return margins, rows
