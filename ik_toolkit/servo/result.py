"""Result of a tracking run: arrays over the samples, figures, files, and the verdict.

The verdict says whether the run followed its reference (after the time allowed to settle) and, if not, how far off,
when and why.
"""

import json
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..files import as_output, whole_file, write_table, write_whole
from ..robot.constraints import first_open
from ..robot.ros import joint_trajectory
from ..text import angle, length
from ..validate import number
from .loop import STOP
from .path_reach import Survey
from .stability import GainCheck
from .viability import BIT

ROUNDING = 1e-6  # share of a time step by which a run may lag behind its reference without counting as slowed


class TrackStatus(Enum):
    """How a run ended.

    COMPLETED: the errors were inside the tolerances at every sample, in the reference's own time. SLOWED: inside, but the
    reference was run more slowly. LEFT: outside for a while, inside again at the end. LOST: outside at the end, or the run
    ended before the reference did. DIVERGED: the joint motion grew without bound. NOT_FINITE: a step was not finite.
    CONSTRAINT_OPEN: the reference was followed, but a loop of the robot's description is open.
    """

    COMPLETED = "completed"
    SLOWED = "slowed"
    LEFT = "left"
    LOST = "lost"
    DIVERGED = "diverged"
    NOT_FINITE = "not finite"
    CONSTRAINT_OPEN = "constraint open"


@dataclass
class TrackResult:
    """Result of `track`: a tracking run of N steps.

    t (N+1,) [s]; q, rate (N+1, n): joint values and the method's joint rates [rad or m (per s)]; xyz, target_xyz (N+1, 3) [m]: tip
    and target in base axes, (N+1, tips, 3) for several `tips`; position_error (N+1,) [m], orientation_error (N+1,) [rad] or None:
    for several tips the largest error; limited (N, n): bits that say why a joint was held back: 1 position limit, 2 speed limit, 4
    acceleration limit, 8 a step that was not finite, 16 the joint was outside its limits, 32 a contact ahead, 64 the joint
    oscillated; damped (N,): whether the pseudo-inverse was damped; between_position, between_orientation (N,): largest error during
    each step, its ends included; figures (see `figures`); elapsed [s]: time of stepping; searched [s]: time of other runs and
    checks; gain_check: stability of the gains. The verdict compares the errors with position_tolerance [m] and
    orientation_tolerance [rad] at every sample from settle [s] on.

    clock (N+1,) [s]: the reference's time at each t, at which the errors are taken; sigma (N,): rate of this clock in each
    step, 0 to 1; pace (N,): index of the joint that slowed the clock, -1 for none; end [s]: the reference's time that the run
    was to reach. If these four are left out, the reference is run in its own time.

    between: names of the two parts that would most often have touched, if a contact held the robot back, else None. reach:
    for a run that left its reference, which poses of the reference can be reached at all (a `Survey`), else None.
    """

    robot: str
    method: str
    options: dict[str, float]
    dt: float
    joint_names: tuple[str, ...]
    t: np.ndarray
    q: np.ndarray
    rate: np.ndarray
    xyz: np.ndarray
    target_xyz: np.ndarray
    position_error: np.ndarray
    orientation_error: np.ndarray | None
    limited: np.ndarray
    damped: np.ndarray
    between_position: np.ndarray | None
    between_orientation: np.ndarray | None
    elapsed: float
    gain_check: GainCheck | None
    position_tolerance: float
    orientation_tolerance: float
    settle: float
    clock: np.ndarray = None  # type: ignore[assignment]
    sigma: np.ndarray = None  # type: ignore[assignment]
    pace: np.ndarray = None  # type: ignore[assignment]
    end: float = float("nan")
    searched: float = 0.0
    between: tuple[str, str] | None = None
    figures: dict[str, Any] = field(default_factory=dict)
    status: TrackStatus = TrackStatus.COMPLETED
    message: str = ""
    reach: Survey | None = None
    tips: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Fill in the clock if it was left out: the reference was then followed in its own time."""
        steps = len(self.t) - 1
        self.clock = self.t if self.clock is None else self.clock
        self.sigma = np.ones(steps) if self.sigma is None else self.sigma
        self.pace = np.full(steps, -1) if self.pace is None else self.pace
        self.end = float(self.clock[-1]) if np.isnan(self.end) else self.end

    def __repr__(self) -> str:
        """Return status and message, without the arrays."""
        return f"TrackResult({self.status.name}, {self.message})"

    @property
    def success(self) -> bool:
        """Whether the reference was followed to its end, with every sample from settle [s] on inside the tolerances."""
        return self.status in (TrackStatus.COMPLETED, TrackStatus.SLOWED)

    @property
    def added_time(self) -> float:
        """How much longer [s] the run took than the part of the reference that it followed; 0 if it was not slowed."""
        added = float(self.t[-1] - self.clock[-1])
        return added if added > ROUNDING * self.dt else 0.0

    @property
    def pace_joint(self) -> str | None:
        """Name of the joint whose limits delayed the run most, or None."""
        held = self.pace >= 0
        if not (self.added_time and held.any()):
            return None
        lost = np.bincount(self.pace[held], weights=1.0 - self.sigma[held], minlength=len(self.joint_names))
        return self.joint_names[int(np.argmax(lost))]

    @property
    def at_limits(self) -> np.ndarray:
        """Which joints (N, n) their own position, speed or acceleration limit held back in each step."""
        return self.limited & (BIT.position | BIT.velocity | BIT.acceleration) > 0

    def outside(self) -> np.ndarray:
        """Return which samples (N+1,) from settle [s] on have an error above a tolerance."""
        inside = self.position_error <= self.position_tolerance
        if self.orientation_error is not None:
            inside &= self.orientation_error <= self.orientation_tolerance
        return ~inside & (self.t >= self.settle)

    def to_dict(self) -> dict[str, Any]:
        """Return a summary for JSON: names, settings, status and figures; the arrays are written by `save`."""
        check = self.gain_check
        return {
            "robot": self.robot,
            "method": self.method,
            "options": self.options,
            "dt": self.dt,
            "steps": len(self.t) - 1,
            "status": self.status.name,
            "success": self.success,
            "message": self.message,
            "position_tolerance": self.position_tolerance,
            "orientation_tolerance": self.orientation_tolerance,
            "settle": self.settle,
            "samples_outside": int(self.outside().sum()),
            "duration": float(self.t[-1]),
            "clock": float(self.clock[-1]),
            "added_time": self.added_time,
            "pace_joint": self.pace_joint,
            "elapsed": self.elapsed,
            "searched": self.searched,
            "between": self.between,
            "stability": check and {"verdict": check.verdict, "radius": check.radius, "message": check.message},
            "reach": None if self.reach is None else self.reach.to_dict(),
            "figures": self.figures,
        }

    def to_ros(self) -> dict[str, Any]:
        """Return the fields of a ROS trajectory_msgs/JointTrajectory, one point per sample, without accelerations."""
        return joint_trajectory(self.joint_names, "", self.t, self.q, self.rate)

    def save(self, path: str | Path) -> Path:
        """Write all arrays to .npz, one row per sample to .csv, or the fields of `to_ros` to .json; return the path.

        Raises InvalidOption for another suffix.
        """
        file = as_output(path, "a run", ".npz", ".csv", ".json")
        if file.suffix.lower() == ".npz":
            optional = {"orientation_error": self.orientation_error, "between_orientation": self.between_orientation}
            optional["between_position"] = self.between_position
            names = ("t", "q", "rate", "xyz", "target_xyz", "position_error", "limited", "damped")
            names += ("clock", "sigma", "pace")
            arrays: dict[str, Any] = {name: getattr(self, name) for name in names}
            arrays |= {name: array for name, array in optional.items() if array is not None}
            with whole_file(file) as stream:
                np.savez_compressed(stream, joint_names=np.array(self.joint_names), **arrays)
        elif file.suffix.lower() == ".csv":
            places = "xyz" if len(self.tips) < 2 else [f"{tip}.{axis}" for tip in self.tips for axis in "xyz"]
            head = ["t", *(f"q_{j}" for j in self.joint_names), *places, "position_error"]
            parts = [self.t[:, None], self.q, self.xyz.reshape(len(self.t), -1), self.position_error[:, None]]
            if self.orientation_error is not None:
                head.append("orientation_error")
                parts.append(self.orientation_error[:, None])
            head.append("clock")
            parts.append(self.clock[:, None])
            write_table(file, head, np.hstack(parts).tolist())
        else:
            write_whole(file, json.dumps(self.to_ros(), allow_nan=False) + "\n")
        return file


def figures(result: TrackResult, jump: np.ndarray) -> dict[str, Any]:
    """Return figures of a run, as plain numbers by name.

    position and orientation: max, rms, final, settled_max and settled_rms (second half of the run), and between_max and
    between_settled_max (which include the time between samples). By finite differences of the samples: peak_speed,
    peak_acceleration, peak_jerk (n,) [rad or m per s, s^2, s^3]. largest_move: largest joint move in a step, with joint and time.
    jumps: number of steps in which a joint moves by more than jump (n,). time_at_limits [s]: time in which any joint is held back
    (see `at_limits`); time_at_limits_by_joint: the same for each joint. damped_time [s]: time near a singularity. slowed_time [s]:
    time in which the reference's clock is slowed; added_time [s]: how much longer the run took; slowest: least rate of the clock.
    """
    out: dict[str, Any] = {"position": _errors(result.position_error, result.between_position)}
    if result.orientation_error is not None:
        out["orientation"] = _errors(result.orientation_error, result.between_orientation)
    moves = np.diff(result.q, axis=0)
    for order, name in enumerate(("peak_speed", "peak_acceleration", "peak_jerk"), start=1):
        d = np.diff(result.q, n=order, axis=0) / result.dt**order
        out[name] = np.abs(d).max(axis=0).tolist() if len(d) else [0.0] * result.q.shape[1]
    if len(moves):
        step, joint = np.unravel_index(int(np.argmax(np.abs(moves))), moves.shape)
        out["largest_move"] = {
            "value": float(abs(moves[step, joint])), "joint": result.joint_names[joint], "time": float(result.t[step])
        }  # fmt: skip
    out["jumps"] = int((np.abs(moves) > jump).any(axis=1).sum())
    hit = result.at_limits
    out["time_at_limits"] = float(hit.any(axis=1).sum() * result.dt)
    out["time_at_limits_by_joint"] = {
        j: float(x) for j, x in zip(result.joint_names, hit.sum(axis=0) * result.dt, strict=True)
    }
    out["damped_time"] = float(result.damped.sum() * result.dt)
    out["slowed_time"] = float((result.sigma < 1.0 - ROUNDING).sum() * result.dt)
    out["added_time"] = result.added_time
    out["slowest"] = float(result.sigma.min(initial=1.0))
    return out


def _errors(error: np.ndarray, between: np.ndarray | None) -> dict[str, float]:
    settled = error[len(error) // 2 :]
    out = {
        "max": float(error.max()),
        "rms": float(np.sqrt((error**2).mean())),
        "final": float(error[-1]),
        "settled_max": float(settled.max()),
        "settled_rms": float(np.sqrt((settled**2).mean())),
    }
    if between is not None:
        out["between_max"] = float(between.max())
        out["between_settled_max"] = float(between[len(between) // 2 :].max())
    return out


POSITION_TOLERANCE = 1e-3  # [m] default largest position error of a run: accuracy to which a path is commonly followed
ORIENTATION_TOLERANCE = np.radians(0.1)  # [rad] 0.1 degrees, which move the end of a tool of half a metre by about 1 mm
SETTLE = 0.5  # [s] default time for which an arm that starts at rest may still be off its path


def settling(settle: float | None, at_rest: bool, duration: float) -> float:
    """Return from which time [s] errors are judged: `settle` if given, else 0, or for a start at rest min(SETTLE, half the run)."""
    if settle is None:
        return min(SETTLE, 0.5 * float(duration)) if at_rest else 0.0
    given = number(settle, "settle [s]")
    if not 0.0 <= given < duration:
        raise InvalidOption(f"settle must be between 0 and the length of the run ({duration:g} s), not {given:g} s")
    return given


def verdict(result: TrackResult, stop: int, steps: int) -> tuple[TrackStatus, str]:
    """Return the status of a run for which `steps` were planned, and a sentence about it.

    stop: why the compiled loop ended, a code of `loop.STOP`.
    """
    done = len(result.t) - 1
    if stop in (STOP.runaway, STOP.not_finite):
        what = "moved joints without bound" if stop == STOP.runaway else "produced a step that is not finite"
        check = result.gain_check
        hint = check.message if check is not None and not check.stable else "Try aad, a higher rate, or joint limits."
        return (
            TrackStatus.DIVERGED if stop == STOP.runaway else TrackStatus.NOT_FINITE,
            f"{result.method} {what} after {done} of {steps} steps (t = {result.t[-1]:.4g} s). {hint}",
        )
    limited, blocked = (int(one.any(axis=1).sum()) for one in (result.at_limits, result.limited & BIT.row))
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
            note += " It begins off the reference: start nearer, or give it time to settle."
        if result.gain_check is not None and result.gain_check.verdict == "unstable":
            note += " The gains are unstable at this sample time."
        return status, f"{_away(result, outside)}{_added(result, '; took ')}.{note}"
    judged = result.t >= result.settle
    worst = _error_words(result.position_error[judged].max(), result.orientation_error, judged)
    after = f" after {result.settle:g} s" if result.settle else ""
    off = f"error at most {worst} at every sample{after}.{note}"
    if result.added_time:
        # With `settle`, no reason is given, because the run may have been slowed only at its start and for another reason.
        why = "" if result.pace_joint or result.settle else ", to keep within its tolerance"
        return TrackStatus.SLOWED, f"followed the reference{_added(result, ', ')}{why}: {off}"
    return TrackStatus.COMPLETED, f"followed the reference: {off}"


def hold_against(result: TrackResult, robot: Any) -> None:
    """Change the status of a successful run to CONSTRAINT_OPEN if a kinematic loop of the robot is open at one of 200 samples."""
    if not result.success or not robot.constraints:
        return
    rows = np.unique(np.linspace(0, len(result.q) - 1, 200).round().astype(int))
    broken = first_open(robot, result.q[rows], result.position_tolerance, result.orientation_tolerance)
    if broken is not None:
        result.status = TrackStatus.CONSTRAINT_OPEN
        result.message += f" But at t = {result.t[rows[broken[0]]]:.4g} s {broken[1]}."


def _away(result: TrackResult, outside: np.ndarray) -> str:
    """Return a clause: how far a run was from its reference, when, what was allowed, and whether it came back."""
    judged = result.t >= result.settle
    k = _worst(result, judged)
    away = _error_words(result.position_error[judged].max(), result.orientation_error, judged)
    allowed = length(result.position_tolerance) if result.position_tolerance < np.inf else ""
    if result.orientation_error is not None and result.orientation_tolerance < np.inf:
        allowed += f"{' and ' * bool(allowed)}{angle(result.orientation_tolerance)}"
    first, last = result.t[outside][[0, -1]]
    when = f"from t = {first:.4g} s to " + ("the end" if outside[-1] else f"{last:.4g} s, within it again at the end")
    after = f" after {result.settle:g} s" if result.settle else ""
    return (
        f"up to {away} from the reference, worst at t = {result.t[k]:.4g} s (tolerance {allowed}); "
        f"out of tolerance in {outside.sum()} of {judged.sum()} samples{after}, {when}"
    )


def _worst(result: TrackResult, judged: np.ndarray) -> int:
    """Return the index of the judged sample with the largest ratio of error to tolerance."""
    excess = result.position_error / result.position_tolerance
    if result.orientation_error is not None:
        excess = np.maximum(excess, result.orientation_error / result.orientation_tolerance)
    return int(np.argmax(np.where(judged, excess, -1.0)))


def _stopped(result: TrackResult, outside: np.ndarray) -> str:
    """Return a sentence on a run that ended before its reference did."""
    at = f"reached {result.clock[-1]:.4g} of {result.end:.4g} s of the reference in {result.t[-1]:.4g} s"
    held = result.pace[result.pace >= 0]
    if len(held):
        at += f", limited by {_limit(result, int(held[-1]))}"
    return f"{at}; {_away(result, outside)}." if outside.any() else f"{at}."


def _added(result: TrackResult, before: str) -> str:
    """Return words on how much longer a run took than its reference, and which joint slowed it.

    They are '' if the run was not slowed.
    """
    if not result.added_time:
        return ""
    words = f"{before}{result.added_time:.3g} s longer than its {result.clock[-1]:.4g} s"
    joint = result.pace_joint
    return words if joint is None else f"{words}, limited by {_limit(result, result.joint_names.index(joint))}"


def _limit(result: TrackResult, joint: int) -> str:
    """Return the name of a joint, with the limit that was active most often while it slowed the clock."""
    codes = result.limited[result.pace == joint, joint]
    bits = {"position": BIT.position, "speed": BIT.velocity, "acceleration": BIT.acceleration}
    counts = {limit: int((codes & bit > 0).sum()) for limit, bit in bits.items()}
    name = result.joint_names[joint]
    return f"{name} ({max(counts, key=counts.__getitem__)} limit)" if any(counts.values()) else name


def _between_samples(result: TrackResult) -> str:
    """Return a sentence on the error between samples, which the verdict does not judge.

    It is '' if the error between samples is not known or not judged.
    """
    if result.between_position is None:
        return ""
    judged = result.t[:-1] >= result.settle
    if not judged.any():
        return ""
    at_samples = result.t >= result.settle
    # Errors between samples are mentioned if they exceed those at the samples by more than 1 %.
    more = result.between_position[judged].max() > 1.01 * result.position_error[at_samples].max()
    if result.between_orientation is not None and result.orientation_error is not None:
        more = more or result.between_orientation[judged].max() > 1.01 * result.orientation_error[at_samples].max()
    words = _error_words(result.between_position[judged].max(), result.between_orientation, judged)
    return f" Between samples: at most {words}." if more else " No more between samples."


def _error_words(position: float, orientation: np.ndarray | None, rows: np.ndarray) -> str:
    """Return a position error [m], and the largest of the orientation errors (N+1,) [rad] in `rows`, in words."""
    turned = "" if orientation is None else f" and {angle(float(orientation[rows].max()))}"
    return length(float(position)) + turned
