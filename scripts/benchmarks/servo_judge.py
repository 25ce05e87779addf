"""Figures of a run for servo.py, from commands q(t), targets and limits alone.

Freeze: for over 100 ms the tips move below 1 mm/s and 0.005 rad/s, the error is over 1 mm, and the way down is open: what is
left of the gradient of |W e|^2 / 2 after taking out the directions that limits and contacts block is over 1e-3 of the largest
gradient that error could have. Jump: a joint moves further than its speed limit allows, or changes its speed by more than its
acceleration limit. Break: a position, or what the reported motion does between samples, outside a limit. Chatter: more than 3
changes of sign of a joint's speed in 100 ms, beyond 5 % of its limit.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from servo_best import RADIUS, as_tips, best, errors, linearised
from servo_scenarios import DT, Scenario, elbow_height, usual

import ik_toolkit as ik

WINDOW = 10  # samples in 100 ms
EXACT = 1.0 + 1e-9
ROUND = 1e-12  # rad (m): rounding of a position
SETTLE = 0.3  # s given to an arm that starts from rest
SHARE = 0.8  # of its limits that the best achievable may need where errors are compared
NEAR = 0.02  # m: a pair this close blocks the way towards each other
FINE = 1e-3  # m: an error that is small


def runs(flags: np.ndarray, least: int = 1) -> list[tuple[int, int]]:
    """Begin and end of the stretches of at least so many True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= least]


def limits_of(s: Scenario, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits (N + 1, n) at each sample; a locked joint's are where it was locked."""
    lower, upper = (np.repeat(x[None], len(Q), axis=0) for x in (s.robot.lower, s.robot.upper))
    if s.lock:
        joint, at = s.lock[0], locked_at(s)
        lower[at + 1 :, joint] = upper[at + 1 :, joint] = Q[at, joint]
    return lower, upper


def locked_at(s: Scenario) -> int:
    """Sample from which a joint that locks has to stand: it may brake first."""
    return s.lock[1] + round(SETTLE / DT)


def achievable(s: Scenario, Q: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """Best achievable motion; the same for all methods, unless a joint locks where this one has it."""
    if not s.lock:
        return shared
    lower, upper = limits_of(s, Q)
    at = locked_at(s)
    rest = best(s.robot, s.targets[at:], Q[at], lower[-1], upper[-1], s.speed * DT)
    return np.concatenate([shared[: at + 1], rest[1:]])


# ----------------------------------------------------------------------------------------------------------- freezes
def still(s: Scenario, Q: np.ndarray) -> np.ndarray:
    """Which steps (N,) leave all tips where they are."""
    T = as_tips(s.robot.chain.forward(Q)[0])
    speed = np.linalg.norm(np.diff(T[..., :3, 3], axis=0), axis=2).max(axis=1) / DT
    chord = np.linalg.norm(np.diff(T[..., :3, :3], axis=0), axis=(2, 3)).max(axis=1) / np.sqrt(2.0) / DT
    return (speed < 1e-3) & (chord < 5e-3)


def open_gradient(s: Scenario, q: np.ndarray, target: np.ndarray, lower, upper, collision) -> float:
    """Share of the gradient that nothing blocks, of the largest that this error could have (0: stationary)."""
    from scipy.optimize import nnls

    e, J = linearised(s.robot, q, target)
    unit = usual(s.robot)  # joints compared by what they can do
    g = unit * (J.T @ e)
    walls = [*(-np.eye(len(q))[q <= lower + 1e-7]), *(np.eye(len(q))[q >= upper - 1e-7])]
    if collision is not None:
        walls += [unit * a for a in contacts(collision, q)]
    left = nnls(np.array(walls).T, g)[1] if walls else np.linalg.norm(g)
    return float(left / (np.linalg.norm(J * unit, 2) * np.linalg.norm(e)))


def contacts(collision: Any, q: np.ndarray) -> list[np.ndarray]:
    """Gradients (n,) of minus the distance of each near pair, by finite differences."""
    near = np.flatnonzero(distances(collision, q) < NEAR)
    if not len(near):
        return []
    step = 1e-5
    change = [(distances(collision, q + step * e) - distances(collision, q - step * e))[near] for e in np.eye(len(q))]
    return [-row for row in np.array(change).T / (2.0 * step)]


def distances(collision: Any, q: np.ndarray) -> np.ndarray:
    """Distance [m] of every pair that is tested."""
    import pinocchio as pin

    robot = collision.robot
    data, found = robot.model.createData(), collision.geometry.createData()
    pin.computeDistances(robot.model, data, collision.geometry, found, robot.to_pinocchio(q))
    return np.array([r.min_distance for r in found.distanceResults])


def freezes(s: Scenario, Q: np.ndarray, error: np.ndarray, collision: Any) -> list[dict[str, float]]:
    """Freezes of a run: when, how long, how open the way was."""
    lower, upper = limits_of(s, Q)
    out = []
    for a, b in runs(still(s, Q) & (error[1:] > FINE), WINDOW + 1):
        middle = (a + b) // 2
        share = open_gradient(s, Q[middle + 1], s.targets[middle], lower[middle + 1], upper[middle + 1], collision)
        if share > 1e-3:
            out.append(
                {"from": a * DT, "seconds": (b - a) * DT, "open": share, "error": float(error[a + 1 : b + 1].max())}
            )
    return out


# ------------------------------------------------------------------------------------------------- jumps and breaks
def jumps(s: Scenario, Q: np.ndarray) -> int:
    """Steps that move a joint further, or change its speed by more, than its limits allow; the start is at rest."""
    move = np.diff(Q, axis=0, prepend=Q[:1])
    change = np.diff(move, axis=0)
    bad = (np.abs(move[1:]) > s.speed * DT * EXACT + 1e-15).any(axis=1)
    most = s.acceleration * DT * DT * EXACT + 1e-14
    over = np.abs(change) > most
    if s.lock:  # its lock stops a joint at once
        over[s.lock[1], s.lock[0]] = False
    return int((bad | over.any(axis=1)).sum())


def breaks(s: Scenario, Q: np.ndarray, R: np.ndarray, gamma: float) -> tuple[int, int]:
    """Samples outside the position limits, and steps whose reported motion is outside a limit between its samples."""
    lower, upper = limits_of(s, Q)
    outside = ((lower - ROUND > Q) | (upper + ROUND < Q)).any(axis=1)
    if gamma == 1.0:
        return int(outside.sum()), 0
    d = np.diff(Q, axis=0)
    # q + f (1 - f) h rate + f^2 d: speed is linear in f, position has its extreme where it is zero.
    begin, curve = R[:-1], 2.0 * (d / DT - R[:-1])
    end = begin + curve
    fast = (np.maximum(np.abs(begin), np.abs(end)) > s.speed * EXACT + 1e-12).any(axis=1)
    hard = (np.abs(curve) / DT > s.acceleration * EXACT + 1e-9).any(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(begin * end < 0.0, -begin / curve, 0.0)
    top = Q[:-1] + f * (1.0 - f) * DT * begin + f * f * d
    past = ((top < lower[1:] - ROUND) | (top > upper[1:] + ROUND)).any(axis=1)
    return int(outside.sum()), int((fast | hard | past).sum())


def chatter(s: Scenario, Q: np.ndarray) -> int:
    """Windows of 100 ms, one after another, in which a joint's speed changes its sign more than 3 times."""
    v = np.diff(Q, axis=0) / DT
    count = 0
    for joint, limit in enumerate(usual(s.robot)):
        sign = np.sign(v[:, joint]) * (np.abs(v[:, joint]) > 0.05 * limit)
        places = np.flatnonzero(sign)
        flips = places[1:][np.diff(sign[places]) != 0]
        k = 0
        while k + 3 < len(flips):
            if flips[k + 3] - flips[k] < WINDOW:
                count += 1
                k += 4
            else:
                k += 1
    return count


def touched(s: Scenario, Q: np.ndarray, collision: Any) -> int:
    """Times the arm comes into contact, on the exact shapes, between samples too."""
    fine = np.concatenate([Q[:1], *([0.5 * (a + b), b] for a, b in pairwise(Q))])
    return len(runs(np.array([collision.collides(q) for q in fine])))


# --------------------------------------------------------------------------------------------------- error and jerk
def returns(s: Scenario, Q: np.ndarray, error: np.ndarray) -> list[dict[str, float | None]]:
    """After each event: time until the error stays under 1 mm, and the least time the joints' speeds allow for that."""
    out = []
    ends = [*s.events[1:], len(error) - 1][: len(s.events)]
    for begin, end in zip(s.events, ends, strict=True):
        outside = np.flatnonzero(error[begin + 1 : end + 1] > FINE)
        back = begin + 1 + (int(outside[-1]) + 1 if len(outside) else 0)
        if back > end:
            out.append({"seconds": None, "bound": None, "error": float(error[end])})
            continue
        bound = least_time(s, np.abs(Q[back] - Q[begin]))
        out.append({"seconds": (back - begin) * DT, "bound": bound, "error": float(error[end])})
    return out


def least_time(s: Scenario, way: np.ndarray) -> float:
    """Least time [s] for joint moves (n,) at the speed limits, from rest to rest where accelerations are limited."""
    v, a = usual(s.robot), s.acceleration
    if not s.accelerate:
        return float((way / v).max())
    return float(np.where(way > v * v / a, way / v + v / a, 2.0 * np.sqrt(way / a)).max())


def compared(s: Scenario, ideal: np.ndarray) -> np.ndarray:
    """Samples (N,) after the start at which the best achievable stays well inside speed and acceleration limits."""
    v = np.abs(np.diff(ideal, axis=0) / DT / usual(s.robot)).max(axis=1)
    a = np.abs(np.diff(ideal, n=2, axis=0, prepend=ideal[:1]) / DT**2 / s.acceleration).max(axis=1)
    hard = (v > SHARE) | (a > SHARE)
    behind = round(SETTLE / DT)  # an arm that was left behind needs time, too
    recent = np.convolve(hard, np.ones(behind + 1))[: len(hard)] > 0.0
    recent[:behind] = True
    return ~recent


def judge(
    s: Scenario, Q: np.ndarray, R: np.ndarray, gamma: float, ideal: np.ndarray, collision: ik.CollisionModel | None
) -> dict[str, Any]:
    """Every figure of one run."""
    plant = np.concatenate([np.repeat(Q[:1], s.delay, axis=0), Q])[: len(Q)]
    after = np.concatenate([s.targets[:1], s.targets])
    error = np.linalg.norm(errors(s.robot, plant, after), axis=1)
    least = np.linalg.norm(errors(s.robot, ideal, after), axis=1)
    keep = compared(s, ideal)
    outside, between = breaks(s, Q, R, gamma)
    found: dict[str, Any] = {
        "freezes": freezes(s, plant, error, collision),
        "jumps": jumps(s, Q),
        "breaks": outside,
        "breaks_between": between,
        "contacts": None if collision is None else touched(s, Q, collision),
        "chatter": chatter(s, Q) if s.slow else None,
        "peak": float(error[1:].max()),
        "rms": rms(error[1:]),
        "final": float(error[-1]),
        "returns": returns(s, plant, error),
    }
    if s.compared and keep.any():
        found |= {
            "compared": float(keep.mean()), "rms_compared": rms(error[1:][keep]), "rms_best": rms(least[1:][keep]),
            "peak_compared": float(error[1:][keep].max()), "peak_best": float(least[1:][keep].max()),
        }  # fmt: skip
        jerk, ideal_jerk = (np.diff(x, n=3, axis=0) / DT**3 for x in (Q, ideal))
        rows = keep[2:]
        found |= {"excess_jerk": rms((jerk - ideal_jerk)[rows]), "best_jerk": rms(ideal_jerk[rows])}
    if s.elbow:
        found["elbow"] = min(elbow_height(s.robot, q) for q in Q) / elbow_height(s.robot, Q[0])
    if s.delay:
        T = np.concatenate([s.targets[:1], s.targets])
        move = T[1:, :, :3, 3] - T[:-1, :, :3, 3], RADIUS * turns(T)
        speed = np.sqrt((move[0] ** 2).sum(axis=(1, 2)) + (move[1] ** 2).sum(axis=1)).max() / DT
        third = len(error) // 3
        found["delay_ratio"] = float(error[round(SETTLE / DT) :].max() / (speed * s.delay * DT))
        found["growth"] = float(error[-third:].max() / error[third : 2 * third].max())
    return found


def turns(T: np.ndarray) -> np.ndarray:
    """Angles (N, F) [rad] from each sample of T (N + 1, F, 4, 4) to the next."""
    chord = np.linalg.norm(np.diff(T[..., :3, :3], axis=0), axis=(2, 3)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.minimum(chord, 1.0))


def rms(x: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt((np.asarray(x) ** 2).mean()))


# ------------------------------------------------------------------------------------------------------- the aims
def missed(s: Scenario, found: dict[str, Any]) -> list[str]:
    """What the figures of a run do not reach of what a tracker should."""
    out = [f"{found[k]} {k}" for k in ("jumps", "breaks", "breaks_between", "contacts", "chatter") if found[k]]
    if found["freezes"]:
        first = found["freezes"][0]
        out.append(
            f"{len(found['freezes'])} freezes, first at {first['from']:.2f} s, {1e3 * first['error']:.0f} mm off"
        )
    if "rms_best" in found and found["rms_compared"] > 1.1 * found["rms_best"] + 5e-4:
        out.append(f"RMS {1e3 * found['rms_compared']:.2f} mm, best {1e3 * found['rms_best']:.2f}")
    for back in found["returns"]:
        if back["seconds"] is None:
            out.append(f"not back: {1e3 * back['error']:.1f} mm")
        elif back["seconds"] > 1.3 * back["bound"] + DT:
            out.append(
                f"back after {back['seconds']:.2f} s, {back['seconds'] / max(back['bound'], DT):.2f} of the bound"
            )
    if found.get("elbow", 1.0) <= 0.0:
        out.append("elbow below the line")
    if found.get("delay_ratio", 0.0) > 1.2:
        out.append(f"error {found['delay_ratio']:.2f} of speed x delay")
    if found.get("growth", 0.0) > 1.05:
        out.append(f"error grows by {found['growth']:.2f}")
    return out
