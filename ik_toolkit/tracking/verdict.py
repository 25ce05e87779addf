"""Whether a run followed its reference, once the arm has had time to get going; and if it did not, how far off, when and why."""

from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..kernel import box, motion
from ..robot.constraints import first_open
from ..robot.pose import length
from .inputs import number
from .result import ROUNDING, TrackResult, TrackStatus

POSITION_TOLERANCE = 1e-3  # [m] what a path is commonly followed to
ORIENTATION_TOLERANCE = np.radians(0.1)  # [rad] moves a tool of half a metre by about as much
SETTLE = 0.5  # [s] given to an arm that has to get going first
LOOKED = 200  # samples in which the constraints of a description are evaluated
MORE = 1.01  # times the error at the samples, from which on that between them is a larger one
LIMITS = ((box.POSITION, "position"), (box.VELOCITY, "speed"), (box.ACCELERATION, "acceleration"))


def settling(settle: float | None, at_rest: bool, duration: float) -> float:
    """Time [s] from which on the error is judged."""
    if settle is None:
        return min(SETTLE, 0.5 * float(duration)) if at_rest else 0.0
    given = number(settle, "settle [s]")
    if not 0.0 <= given < duration:
        raise InvalidOption(f"settle must be between 0 and the length of the run ({duration:g} s), not {given:g} s")
    return given


def verdict(result: TrackResult, stop: int, steps: int) -> tuple[TrackStatus, str]:
    """Status of a whole run and one sentence."""
    done = len(result.t) - 1
    if stop in (motion.RUNAWAY, motion.NOT_FINITE):
        what = "moved joints without bound" if stop == motion.RUNAWAY else "produced a step that is not finite"
        check = result.gain_check
        hint = check.message if check is not None and not check.stable else "Try aad, a smaller dt, or limits=True."
        return (
            TrackStatus.DIVERGED if stop == motion.RUNAWAY else TrackStatus.NOT_FINITE,
            f"{result.method} {what} after {done} of {steps} steps (t = {result.t[-1]:.4g} s). {hint}",
        )
    limited, blocked = (int(one.any(axis=1).sum()) for one in (result.at_limits, result.limited & box.ROW))
    note = f" A joint limit was active in {limited} of {done} steps." if limited else ""
    pair = " between '{}' and '{}'".format(*result.between) if result.between else ""
    note += f" A contact ahead{pair} held the robot back in {blocked} of {done} steps." if blocked else ""
    note += _between_samples(result)
    outside = result.outside()
    if result.clock[-1] < result.end - ROUNDING * result.dt:
        return TrackStatus.LOST, _stopped(result, outside) + note
    if outside.any():
        status = TrackStatus.LOST if outside[-1] else TrackStatus.LEFT
        if outside[0]:
            note += " It begins off the reference: leave out q0, or give it time to get there with settle."
        if result.gain_check is not None and result.gain_check.verdict == "unstable":
            note += " The gains are unstable at this sample time."
        return status, f"{_away(result, outside)}{_added(result, '; took ')}.{note}"
    judged = result.t >= result.settle
    worst = _error_words(result.position_error[judged].max(), result.orientation_error, judged)
    after = f" after {result.settle:g} s" if result.settle else ""
    off = f"error at most {worst} at every sample{after}.{note}"
    if result.added_time:
        why = "" if result.pace_joint or result.settle else ", to keep within its tolerance"  # or to get going
        return TrackStatus.SLOWED, f"followed the reference{_added(result, ', ')}{why}: {off}"
    return TrackStatus.COMPLETED, f"followed the reference: {off}"


def hold_against(result: TrackResult, robot: Any) -> None:
    """A run followed with a constraint of the robot's description open is no success: looked at in at most LOOKED samples."""
    if not result.success or not robot.constraints:
        return
    rows = np.unique(np.linspace(0, len(result.q) - 1, LOOKED).round().astype(int))
    broken = first_open(robot, result.q[rows], result.position_tolerance, result.orientation_tolerance)
    if broken is not None:
        result.status = TrackStatus.CONSTRAINT_OPEN
        result.message += f" But at t = {result.t[rows[broken[0]]]:.4g} s {broken[1]}."


def _away(result: TrackResult, outside: np.ndarray) -> str:
    """How far a run was from its reference, when, what was allowed, and whether it came back."""
    judged = result.t >= result.settle
    k = _worst(result, judged)
    away = _error_words(result.position_error[judged].max(), result.orientation_error, judged)
    allowed = length(result.position_tolerance)
    if result.orientation_error is not None:
        allowed += f" and {np.degrees(result.orientation_tolerance):.3g} deg"
    first, last = result.t[outside][[0, -1]]
    when = f"from t = {first:.4g} s to " + ("the end" if outside[-1] else f"{last:.4g} s, within it again at the end")
    after = f" after {result.settle:g} s" if result.settle else ""
    return (
        f"up to {away} from the reference, worst at t = {result.t[k]:.4g} s (tolerance {allowed}); "
        f"out of tolerance in {outside.sum()} of {judged.sum()} samples{after}, {when}"
    )


def _worst(result: TrackResult, judged: np.ndarray) -> int:
    """Sample with the largest error over its tolerance."""
    excess = result.position_error / result.position_tolerance
    if result.orientation_error is not None:
        excess = np.maximum(excess, result.orientation_error / result.orientation_tolerance)
    return int(np.argmax(np.where(judged, excess, -1.0)))


def _stopped(result: TrackResult, outside: np.ndarray) -> str:
    """Why a run ended before its reference did."""
    at = f"reached {result.clock[-1]:.4g} of {result.end:.4g} s of the reference in {result.t[-1]:.4g} s"
    held = result.pace[result.pace >= 0]
    if len(held):
        at += f", limited by {_limit(result, int(held[-1]))}"
    return f"{at}; {_away(result, outside)}." if outside.any() else f"{at}."


def _added(result: TrackResult, before: str) -> str:
    """How much longer a run took than its reference, and which joint set the pace; '' when the clock was not slowed."""
    if not result.added_time:
        return ""
    words = f"{before}{result.added_time:.3g} s longer than its {result.clock[-1]:.4g} s"
    joint = result.pace_joint
    return words if joint is None else f"{words}, limited by {_limit(result, result.joint_names.index(joint))}"


def _limit(result: TrackResult, joint: int) -> str:
    """Name of a joint, with the limit that held it most often while it held the clock back."""
    codes = result.limited[result.pace == joint, joint]
    counts = [int((codes & bit > 0).sum()) for bit, _ in LIMITS]
    name = result.joint_names[joint]
    return f"{name} ({LIMITS[int(np.argmax(counts))][1]} limit)" if any(counts) else name


def _between_samples(result: TrackResult) -> str:
    """Sentence on the error inside the steps as well, which the verdict does not read."""
    if result.between_position is None:
        return ""
    judged = result.t[:-1] >= result.settle
    if not judged.any():
        return ""
    at_samples = result.t >= result.settle
    more = result.between_position[judged].max() > MORE * result.position_error[at_samples].max()
    if result.between_orientation is not None and result.orientation_error is not None:
        more = more or result.between_orientation[judged].max() > MORE * result.orientation_error[at_samples].max()
    words = _error_words(result.between_position[judged].max(), result.between_orientation, judged)
    return f" Between samples: at most {words}." if more else " No more between samples."


def _error_words(position: float, angle: np.ndarray | None, rows: np.ndarray) -> str:
    """A position error, and the largest orientation error of some rows, in words."""
    turned = "" if angle is None else f" and {np.degrees(angle[rows].max()):.3g} deg"
    return length(float(position)) + turned
