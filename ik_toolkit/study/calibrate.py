"""`ik.calibrate`: kinematic calibration from measured poses, positions or distances of the tip, or from its contacts."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import FEW_TURNS, InvalidConfiguration, InvalidOption, InvalidTarget, floats
from ..robot.robot import Robot
from ..robot.tree import require_one_tip
from .calibration import Calibration, FixedUnknown
from .calibration_fit import UNTOLD, ArmFit, first_guess, joint_signs, reversible, untold_directions
from .drawn_arm import GROUPS, DrawnArm, read_groups
from .measurements import TOUCHED, Measurements, prior_spread, read_noise

# If measured points are farther than ELSEWHERE times the reach from the nominal arm's, they may be in another frame.
ELSEWHERE = 0.2
# If the median error after the fit exceeds DOUBTFUL times NOISE, joints with a wrong sign are searched for once more.
DOUBTFUL = 4.0
# number of random configurations that tell how many errors measurements all over the joint ranges could determine
SAMPLES = 200


def calibrate(
    robot: Robot,
    q: Any,
    measured: Any,
    what: str = "position",
    parameters: Sequence[str] = GROUPS[:3],
    *,
    places: Any = None,
    distances: Any = None,
    noise: Any = None,
    prior: Any = None,
) -> Calibration:
    """Find the errors of an arm's joints, links, tool and base from measurements of where its tip goes.

    A wrong sign of a joint is found first. Then all errors are fitted by least squares with a robust loss. Outliers are reported
    and left out; errors that the measurements do not determine are reported and fixed at 0, the nominal value. The `notes` of the
    result are sentences on such errors and on missing convergence.

    Args:
        robot: The nominal robot (as drawn), with one tip; use with_tool if the measured point is not the tip's origin.
        q: Joint values (N, n) [rad or m] of the measurements.
        measured: For 'pose' (N, 4, 4), for 'position' (N, 3) [m], in the base frame unless parameters has base. For 'distance'
            lengths (N,) [m] from a fixed end, or (N, 2) with the index of the end first. For 'socket' and 'plane' the index (N,),
            from 0, of the socket or plane that the tip touches.
        what: What was measured.
        parameters: What may be wrong: 'joints' (their offsets), 'frames' (the placement of each moving link's joint on its parent
            link), 'tool' (the measured point), 'base' (the measurements are in another frame, such as a laser tracker's).
        places: Known positions (K, 3) [m] of the sockets, or of the fixed ends, in the base frame.
        distances: Known distances between sockets: one number [m] for two sockets, or {(0, 1): metres}.
        noise: Standard deviation of the measurements (length [m], angle [rad]), or a length, at least 1e-6; by default estimated.
        prior: Expected size (standard deviation) of the errors of links and joints, (length [m], angle [rad]), by default
            (0.01, 0.035). It is ten times as large for the tool.

    Returns:
        The errors with 95 % intervals, the corrected robot, residuals, outliers, and what the data do not determine.

    Raises:
        InvalidOption: An argument is unknown or does not fit, or robot has several tips.
        InvalidConfiguration, InvalidTarget: q or measured has the wrong shape, too few rows, or is in other units.
        MissingExtra: SciPy is not installed.
    """
    require_one_tip(robot, "a calibration")
    groups = read_groups(parameters)
    data = Measurements(what, measured, places, distances)
    for pair, far in data.pairs.items():
        if far > 2.0 * robot.reach:
            raise InvalidOption(
                f"the tip touches both sockets {pair}, so they are not {far:g} m apart; were millimetres meant?"
            )
    Q = _configurations(robot, q, len(data))
    data.require_metres(robot.reach, robot.chain.forward(Q)[0][:, :3, 3])
    if "base" in groups and what not in ("pose", "position"):
        raise InvalidOption(
            f"parameters has base, which needs measured poses or positions; what is '{what}': leave base out"
        )
    spread, sigma = prior_spread(prior), read_noise(noise)
    arm = DrawnArm(robot, groups)
    _require_enough(arm, data, Q)
    sign, share = joint_signs(robot, groups, data, Q)
    arm = DrawnArm(robot, groups, sign)
    if what in ("pose", "position"):
        _require_same_frame(arm, data, Q)
    fit = ArmFit(arm, data, Q, arm.scales(*spread), sigma)
    fit.settle()
    fit, better = _with_last_sign(fit, sigma)
    before = fit.errors(*fit.first)
    fixed, ranks = _settle_convention(fit)
    names = [joint for joint, one in zip(robot.joint_names, fit.arm.sign, strict=True) if one < 0.0]
    return Calibration.of(fit, before, fixed, ranks, spread, dict.fromkeys(names, share * better))


def _configurations(robot: Robot, q: Any, count: int) -> np.ndarray:
    Q = floats(q, f"q must be (N, {robot.n}) numbers", InvalidConfiguration)
    if Q.ndim != 2 or Q.shape[1] != robot.n:
        raise InvalidConfiguration(
            f"q must have the shape (N, {robot.n}), a column for each of {', '.join(robot.joint_names)}; not {Q.shape}"
        )
    if len(Q) != count:
        raise InvalidTarget(f"q has {len(Q)} rows and measured {count}; each measurement needs its joint values")
    for k, row in enumerate(Q):
        if not np.isfinite(row).all():
            raise InvalidConfiguration(f"row {k} of q (counted from 0) is not finite: leave it out, in measured too")
    turning = Q[:, ~robot.slides]
    if np.abs(turning).max(initial=0.0) > 2.0 * FEW_TURNS:
        raise InvalidConfiguration(
            f"q has angles of {np.abs(turning).max():.4g} rad; were degrees meant? Use numpy.radians(q) (--deg)"
        )
    if count < 2 or not (np.ptp(Q, axis=0) > 0.0).any():
        raise InvalidConfiguration(
            "all rows of q are the same: measure in different configurations (ik.suggest_poses gives some)"
        )
    return Q


def _require_enough(arm: DrawnArm, data: Measurements, Q: np.ndarray) -> None:
    """Raise InvalidTarget if there are too few measured numbers: they must determine about two thirds of the arm's unknowns."""
    known = len(data.pairs) + (0 if data.places is None else data.places.size)
    unknowns = (2 * len(arm.unknowns) + 2) // 3 + data.size - known
    count = len(np.unique(np.column_stack([Q, data.labels]), axis=0))
    if count * data.per < unknowns:
        need = -(-unknowns // data.per)
        which = "measurements" if count == len(data) else f"configurations that differ, of {len(data)} measurements"
        raise InvalidTarget(
            f"{count} {which} of kind '{data.what}' are {count * data.per} numbers for some {unknowns} unknowns: "
            f"measure at least {need}, better {2 * need} (ik.suggest_poses says where), or look for less: parameters=('joints',)"
        )


def _require_same_frame(arm: DrawnArm, data: Measurements, Q: np.ndarray) -> None:
    """Raise InvalidTarget if the measurements fit the nominal arm only after its base is moved, which is not a parameter here."""
    if "base" in arm.groups:
        return
    off = np.median(np.linalg.norm(arm.poses(np.zeros(len(arm.unknowns)), Q)[:, :3, 3] - data.positions, axis=1))
    moved = DrawnArm(arm.robot, ("base",), arm.sign)
    left = np.median(np.linalg.norm(moved.poses(first_guess(moved, data, Q), Q)[:, :3, 3] - data.positions, axis=1))
    if off > ELSEWHERE * arm.robot.reach and left < 0.2 * off:
        raise InvalidTarget(
            f"the measurements are {off:.3g} m from where the arm is drawn, and {left:.3g} m once its base is moved: they are in "
            "a frame of their own; add 'base' to parameters (--parameters joints,frames,tool,base)"
        )


def _with_last_sign(fit: ArmFit, sigma: Any) -> tuple[ArmFit, float]:
    """Return the fit, or if it is poor a better one with one more joint reversed, and the ratio of the errors after to before.

    This finds reversals that a fit of offsets alone cannot show, such as that of a last joint on whose axis the tip is drawn.
    """
    left = fit.typical()
    found, least = fit, 1.0
    for i in reversible(fit.arm.robot, fit.Q) if left > DOUBTFUL else []:
        sign = fit.arm.sign.copy()
        sign[i] *= -1.0
        arm = DrawnArm(fit.arm.robot, fit.arm.groups, sign)
        other = ArmFit(arm, fit.measured, fit.Q, fit.scales, sigma)
        other.x, other.z = other.run(other.kept, robust=True, most=30)
        if other.typical() < least * left:
            found, least = other, other.typical() / left
    if least >= 0.5:
        return fit, 1.0
    found.settle()
    return found, least


def _settle_convention(fit: ArmFit) -> tuple[list[FixedUnknown], tuple[int, int, int]]:
    """Fix the unknowns that the data do not determine, and fit again.

    Returns the fixed unknowns, and how many are identifiable with these data, at the nominal arm, and with poses all over its
    range.
    """
    names = [one.name for one in fit.arm.unknowns]
    N = fit.untold(fit.x, fit.z, fit.kept)
    drawn = could = len(names) - N.shape[1]
    if fit.measured.what in ("pose", "position"):
        drawn = len(names) - fit.untold(fit.first[0], fit.z, fit.kept).shape[1]
        could = _could_tell(fit)
    seen = np.linalg.norm(fit.weighted(fit.x, fit.z, fit.kept)[1], axis=0) > UNTOLD
    fixed = fit.fix(N) if N.shape[1] else {}
    if fixed:
        fit.x, fit.z = fit.run(fit.kept)
    touched = (f"the {TOUCHED[fit.measured.what]}",) if fit.measured.count else ()
    told_by = {p: tuple(names[k] for k in others) or (touched if seen[p] else ()) for p, others in fixed.items()}
    rank = len(names) - len(fixed)
    return [FixedUnknown(names[p], shared) for p, shared in told_by.items()], (rank, int(drawn), max(could, rank))


def _could_tell(fit: ArmFit) -> int:
    """Return how many parameter directions the same number of measurements, spread over the arm's range, would determine."""
    Q = fit.arm.robot.random_q(np.random.default_rng(0), SAMPLES)
    T, J = fit.arm.evaluate(fit.x, Q)
    taken = fit.measured.taken(np.zeros(SAMPLES, dtype=int))
    A = taken.errors(T, fit.z)[1] @ J * fit.scales / taken.sigma(fit.noise)[:, None]
    share = np.sqrt(fit.kept.sum() / SAMPLES)
    return A.shape[2] - untold_directions(A.reshape(-1, A.shape[2]) * share).shape[1]
