"""Whether a run followed its reference: every sample inside the tolerances, once the arm has had time to get going."""

import numpy as np

from ..errors import InvalidOption
from ..kernel import motion
from ..robot.pose import length
from .inputs import number
from .result import TrackResult, TrackStatus

POSITION_TOLERANCE = 1e-3  # [m] what a path is commonly followed to
ORIENTATION_TOLERANCE = np.radians(0.1)  # [rad] moves a tool of half a metre by about as much
SETTLE = 0.5  # [s] given to an arm that has to get going first


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
    if stop != motion.FINE:
        what = "moved joints without bound" if stop == motion.RUNAWAY else "gave a step that is not finite"
        check = result.gain_check
        hint = check.message if check is not None and not check.stable else "Try aad, a smaller dt, or limits=True."
        return (
            TrackStatus.DIVERGED if stop == motion.RUNAWAY else TrackStatus.NOT_FINITE,
            f"{result.method} {what} after {done} of {steps} steps (t = {result.t[-1]:.4g} s). {hint}",
        )
    limited = int(result.limited.any(axis=1).sum())
    note = f" A limit held a joint back in {limited} of {done} steps." if limited else ""
    note += _between_samples(result)
    outside = result.outside()
    judged = result.t >= result.settle
    after = f" after {result.settle:g} s" if result.settle else ""
    if not outside.any():
        worst = _error_words(result.position_error[judged].max(), result.orientation_error, judged)
        return TrackStatus.COMPLETED, f"followed the reference: at most {worst} off at every sample{after}.{note}"
    excess = result.position_error / result.position_tolerance
    if result.orientation_error is not None:
        excess = np.maximum(excess, result.orientation_error / result.orientation_tolerance)
    k = int(np.argmax(np.where(judged, excess, -1.0)))
    here = np.arange(len(result.t)) == k
    away = _error_words(result.position_error[k], result.orientation_error, here)
    allowed = length(result.position_tolerance)
    if result.orientation_error is not None:
        allowed += f" and {np.degrees(result.orientation_tolerance):.3g} deg"
    return (
        TrackStatus.LOST,
        f"{away} from the reference at t = {result.t[k]:.4g} s, where {allowed} are allowed; "
        f"outside in {outside.sum()} of {judged.sum()} samples{after}.{note}",
    )


def _between_samples(result: TrackResult) -> str:
    """Sentence on the error inside the steps, which the verdict does not read."""
    if result.between_position is None:
        return ""
    judged = result.t[:-1] >= result.settle
    if not judged.any():
        return ""
    words = _error_words(result.between_position[judged].max(), result.between_orientation, judged)
    return f" Between samples: at most {words}."


def _error_words(position: float, angle: np.ndarray | None, rows: np.ndarray) -> str:
    """A position error, and the largest orientation error of some rows, in words."""
    turned = "" if angle is None else f" and {np.degrees(angle[rows].max()):.3g} deg"
    return length(float(position)) + turned
