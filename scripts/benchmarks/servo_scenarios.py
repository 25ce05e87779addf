"""The scenarios of servo.py: streams of targets made from a seed, sized to each robot so that they test what they claim.

A stream is independent of the method: targets (N, F, 4, 4), one per sample for each of F tips, to be reached at the end of the
sample. Sizes shrink until the best achievable motion reaches every pose (where that is intended), and speeds are set as a share
of the joint limits along that motion.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from servo_best import as_tips, best, closest, errors

import ik_toolkit as ik
from ik_toolkit.motion.reference import exp

DT = 0.01  # s
BRAKING = 5.0  # 1/s; acceleration limit over speed limit: full speed in 0.2 s, as on common arms
SPEED = 1.5  # rad/s (m/s) for a joint without a limit
STAND = 2.0  # [s] the target rests at the end, so that a method can return to it


@dataclass
class Scenario:
    """A stream of targets and its conditions.

    expected: OK (can be followed), LIMITED (reach or a joint interrupts it for a while), BLOCKED (an obstacle does). events:
    samples from which the return to within 1 mm is timed. slow: band-limited below 2 Hz, so that chatter is judged. compared:
    whether the error is compared with the best achievable.
    """

    name: str
    robot: Any
    q0: np.ndarray
    targets: np.ndarray
    expected: str = "OK"
    accelerate: bool = True
    events: tuple[int, ...] = ()
    slow: bool = True
    compared: bool = True
    delay: int = 0
    measured: bool = False
    noise: float = 0.0
    lock: tuple[int, int] | None = None
    elbow: bool = False
    posture: bool = False
    obstacles: list = field(default_factory=list)
    seed: int = 0

    @property
    def speed(self) -> np.ndarray:
        """Speed limits (n,)."""
        v = np.asarray(self.robot.velocity_limits, dtype=float)
        return np.where(v > 0.0, v, np.inf)

    @property
    def acceleration(self) -> np.ndarray:
        """Acceleration limits (n,)."""
        return BRAKING * usual(self.robot) if self.accelerate else np.full(self.robot.n, np.inf)


def usual(robot) -> np.ndarray:
    """Speed limits, with a default for joints without one."""
    v = np.asarray(robot.velocity_limits, dtype=float)
    return np.where((v > 0.0) & np.isfinite(v), v, SPEED)


def tip_poses(robot, q: np.ndarray) -> np.ndarray:
    """Poses (F, 4, 4) at q."""
    return as_tips(robot.chain.forward(q[None])[0])[0]


def inner(robot, share: float = 0.15) -> tuple[np.ndarray, np.ndarray]:
    """Limits (n,) moved inwards by a share of the range; one turn for a joint without limits."""
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return low + share * (high - low), high - share * (high - low)


def comfortable(robot, rng: np.random.Generator) -> np.ndarray:
    """A well-conditioned configuration near home, elbow above the line from shoulder to wrist."""
    low, high = inner(robot)
    near = np.clip(robot.home + rng.uniform(-0.5, 0.5, (400, robot.n)), low, high)
    Q = np.vstack([np.clip(robot.home, low, high), near])
    J = robot.chain.forward(Q, jacobian=True)[1]
    J[:, np.arange(J.shape[1]) % 6 > 2] *= 0.2
    smallest = np.linalg.svd(J, compute_uv=False)[:, -1]
    high_enough = np.array([elbow_height(robot, q) for q in Q]) > 0.02 * robot.reach
    return Q[int(np.argmax(np.where(high_enough, smallest, 0.1 * smallest)))]


def elbow_height(robot, q: np.ndarray) -> float:
    """Height [m] of the middle of the (first) arm above the line from its first joint to its tip."""
    arm, place = robot.arms[0], robot.places[0]
    data = arm.data
    pin.forwardKinematics(arm.model, data, arm._filled(q[place]))
    points = np.array([data.oMi[arm.model.getJointId(name)].translation for name in arm.joint_names])
    line = points[-1] - points[0]
    off = points - points[0] - np.outer((points - points[0]) @ line / (line @ line), line)
    return float(off[int(np.argmax(np.linalg.norm(off, axis=1))), 2])


# ------------------------------------------------------------------------------------------------- paths and pace
Path = Callable[[np.ndarray], np.ndarray]  # phase (N,) -> poses (N, F, 4, 4)


def eight(robot, q0: np.ndarray, size: float, tips: int | None = None) -> Path:
    """Vertical figure of eight across the arm, with a rotation of the tool; the tips of a tree move in opposite directions."""
    T0 = tip_poses(robot, q0)

    def path(phase: np.ndarray) -> np.ndarray:
        T = np.repeat(T0[None], len(phase), axis=0)
        for f in range(len(T0) if tips is None else tips):
            sign = 1.0 - 2.0 * (f % 2)
            T[:, f, 1, 3] += sign * size * np.sin(phase)
            T[:, f, 2, 3] += 0.5 * size * np.sin(2.0 * phase)
            turn = np.outer(np.sin(phase), [0.0, 1.5 * size, 0.0])
            T[:, f, :3, :3] = exp(turn) @ T0[f, :3, :3]
        return T

    return path


def fitted(robot, q0: np.ndarray, make: Callable[[float], Path], size: float) -> tuple[Path, np.ndarray]:
    """Largest path, from `size` down, that the best achievable motion follows, and that motion (N, n) over one lap."""
    phase = np.linspace(0.0, 2.0 * np.pi, 361)
    for _ in range(12):
        path = make(size)
        targets = path(phase[1:])
        Q = best(robot, targets, q0, robot.lower, robot.upper)
        if np.linalg.norm(errors(robot, Q[1:], targets), axis=1).max() < 1e-6:
            return path, Q
        size *= 0.75
    raise ValueError(f"no such path fits {robot.name}")


def rate_of(robot, Q: np.ndarray, h: float, share: float) -> float:
    """Phase rate at which the motion Q, sampled at phase steps h, uses a share of the speed and acceleration limits."""
    v = usual(robot)
    first = np.abs(np.diff(Q, axis=0) / h / v).max()
    second = np.abs(np.diff(Q, n=2, axis=0) / h**2 / (BRAKING * v)).max()
    return min(share / first, np.sqrt(share / second))


def ramp(x: np.ndarray) -> np.ndarray:
    """Smooth step from 0 to 1."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x * x)


def phases(rates: list[float], lap: float = 2.0 * np.pi) -> np.ndarray:
    """Phase at each sample: one lap at each rate, from rest to rest, with transitions over a tenth of a lap."""
    out, phase, last = [], 0.0, 0.0
    for k, rate in enumerate(rates):
        while phase < (k + 1) * lap:
            local = phase / lap - k
            now = last + (rate - last) * float(ramp(np.array(local / 0.1)))
            if k == len(rates) - 1:
                now *= float(1.0 - ramp(np.array((local - 0.85) / 0.15)))
            now = max(now, 0.02 * rate)
            phase += now * DT
            # Only the last lap is cut at its end: after any other the target would jerk back for a sample.
            if k == len(rates) - 1:
                phase = min(phase, (k + 1) * lap + 1e-12)
            out.append(phase)
        last = rate
    return np.array(out)


def standing(T: np.ndarray, seconds: float = STAND) -> np.ndarray:
    """Targets with the last one repeated."""
    return np.concatenate([T, np.repeat(T[-1:], round(seconds / DT), axis=0)])


# --------------------------------------------------------------------------------------------------- the scenarios
def eight_faster(robot, q0, rng) -> Scenario:
    """Figure of eight, one lap each at 0.3, 0.6, 0.9, 1.5 and 3 times what the limits allow."""
    path, Q = fitted(robot, q0, lambda size: eight(robot, q0, size), 0.15 * robot.reach)
    unit = rate_of(robot, Q, 2.0 * np.pi / 360, 1.0)
    T = path(phases([unit * share for share in (0.3, 0.6, 0.9, 1.5, 3.0)]))
    return Scenario("figure of eight, faster and faster", robot, q0, standing(T), events=(len(T),), slow=False)


def jitter(robot, q0, rng) -> Scenario:
    """A pose held by an unsteady hand: noise of 0.2 to 8 Hz on position and orientation."""
    t = DT * np.arange(1, 601)
    frequency, shift = rng.uniform(0.2, 8.0, (6, 12)), rng.uniform(0.0, 2.0 * np.pi, (6, 12))
    wave = np.sin(2.0 * np.pi * frequency[:, :, None] * t + shift[:, :, None]).sum(axis=1) / np.sqrt(12.0)
    wave *= ramp(t)
    T0 = tip_poses(robot, q0)
    size = 0.004

    def made(size: float) -> np.ndarray:
        T = np.repeat(T0[None], len(t), axis=0)
        T[:, 0, :3, 3] += size * wave[:3].T
        T[:, 0, :3, :3] = exp(5.0 * size * wave[3:].T) @ T0[0, :3, :3]
        return T

    for _ in range(20):
        Q = best(robot, made(size), q0, robot.lower, robot.upper)
        if rate_of(robot, Q, DT, 0.7) > 1.0:
            break
        size *= 0.8
    return Scenario("operator's jitter", robot, q0, made(size), slow=False)


def outwards(robot, q0: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Direction from the first joint to the tip, distance [m] along it to the edge of reach, and the motion there."""
    T0 = tip_poses(robot, q0)
    arm = robot.arms[0]
    data = arm.data
    pin.forwardKinematics(arm.model, data, arm._filled(q0[robot.places[0]]))
    base = pin.updateFramePlacement(arm.model, data, arm.model.getFrameId(arm.base))
    first = base.actInv(data.oMi[arm.model.getJointId(arm.joint_names[0])]).translation
    direction = T0[0, :3, 3] - first
    direction /= np.linalg.norm(direction)
    Q, way, q = [q0], 0.0, q0
    while way < 3.0 * robot.reach:
        target = T0.copy()
        target[0, :3, 3] += (way + 0.005) * direction
        q, error = closest(robot, q, target, robot.lower, robot.upper)
        if error > 1e-3:
            break
        way += 0.005
        Q.append(q)
    return direction, way, np.array(Q)


def radial(robot, q0: np.ndarray, direction: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Targets: the first tip moved outwards by way (N,) [m], the others at rest."""
    T = np.repeat(tip_poses(robot, q0)[None], len(way), axis=0)
    T[:, 0, :3, 3] += np.outer(way, direction)
    return T


def out_and_back(robot, q0, past: float, rounds: int, hold: float) -> np.ndarray:
    """Targets to `past` [m] beyond the edge of reach and back, at 0.9 of the speed the limits allow in the first nine tenths."""
    direction, way, Q = outwards(robot, q0)
    inside = Q[: max(3, int(0.9 * len(Q)))]
    fastest = 0.9 / np.abs(np.diff(inside, axis=0) / 0.005 / usual(robot)).max()  # m/s
    seconds = np.pi * (way + past) / 2.0 / fastest
    x = np.arange(1, round(seconds / DT) + 1) / round(seconds / DT)
    there = 0.5 * (1.0 - np.cos(np.pi * x)) * (way + past)
    lap = np.concatenate([there, np.full(round(hold / DT), way + past), there[::-1][1:], [0.0]])
    return radial(robot, q0, direction, np.tile(lap, rounds))


def stretched(robot, q0, rng) -> Scenario:
    """Ten times 5 cm past full extension and back."""
    T = out_and_back(robot, q0, 0.05, 10, 0.0)
    return Scenario("stretched out and back, ten times", robot, q0, T, "LIMITED")


def far(robot, q0, rng) -> Scenario:
    """The target moves 0.5 m out of reach, waits for a second and returns."""
    return Scenario("0.5 m out of reach and back", robot, q0, out_and_back(robot, q0, 0.5, 1, 1.0), "LIMITED")


def elbow(robot, q0, rng) -> Scenario:
    """Three laps of the eight at 0.5 of the limits; the elbow must stay above the line from shoulder to tip."""
    path, Q = fitted(robot, q0, lambda size: eight(robot, q0, size), 0.25 * robot.reach)
    unit = rate_of(robot, Q, 2.0 * np.pi / 360, 0.5)
    return Scenario("elbow kept up", robot, q0, path(phases([unit] * 3)), elbow=True, posture=True)


def grazed(robot, q0, rng) -> Scenario:
    """Down into a table, along below its surface and up again."""
    model = ik.CollisionModel(robot)
    T0 = tip_poses(robot, q0)
    down, size = 0.16, [0.5, 0.5, 0.1]

    def table(gap: float) -> list:
        pose = np.eye(4)
        pose[:3, 3] = T0[0, :3, 3] - [0.0, 0.0, gap + 0.5 * size[2]]
        return [size, pose.tolist()]

    for gap in np.arange(0.02, 0.6, 0.02):  # the tool may reach below its tip point
        model = ik.CollisionModel(robot).add_box(table(gap)[0], np.array(table(gap)[1]))
        if not model.collides(q0):
            break
    box = table(gap + 0.08)
    t = DT * np.arange(1, 801)
    T = np.repeat(T0[None], len(t), axis=0)
    T[:, 0, 2, 3] -= down * (ramp(t / 2.0) - ramp((t - 6.0) / 2.0))
    T[:, 0, 1, 3] += 0.1 * np.sin(np.pi * ramp((t - 2.0) / 4.0) * 2.0)
    return Scenario("table grazed", robot, q0, T, "BLOCKED", obstacles=[box], compared=False)


def leaps(robot, q0, rng, accelerate: bool) -> Scenario:
    """The target jumps four times to poses up to 0.5 rad away in every joint."""
    low, high = inner(robot)
    poses, q = [], q0
    while len(poses) < 4:
        wanted = np.clip(q0 + rng.uniform(-0.5, 0.5, robot.n), low, high)
        T = tip_poses(robot, wanted)
        reached, error = closest(robot, q, T, low, high)
        if error < 1e-6:
            poses.append(T)
            q = reached
    each = round(3.0 * max(1.0, 1.0 / usual(robot).min()) / DT)
    T = np.concatenate([np.repeat(pose[None], each, axis=0) for pose in poses])
    name = "target leaps" + (", accelerations limited" if accelerate else "")
    return Scenario(
        name, robot, q0, T, accelerate=accelerate, events=tuple(each * k for k in range(4)), slow=False, compared=False
    )


def turned(robot, q0, rng) -> Scenario:
    """Two full turns about the tool's axis, then rest."""
    unit = 0.4 * usual(robot)[robot.places[0][-1]]
    angle = 4.0 * np.pi * ramp(np.arange(1, round(4.0 * np.pi / unit * 1.9 / DT) + 1) * DT * unit / (4.0 * np.pi * 1.9))
    T0 = tip_poses(robot, q0)
    T = np.repeat(T0[None], len(angle), axis=0)
    T[:, 0, :3, :3] = T0[0, :3, :3] @ exp(np.outer(angle, [0.0, 0.0, 1.0]))
    return Scenario(
        "720 deg about the tool", robot, q0, standing(T, 2.0 + 2.0 / unit), "LIMITED", events=(len(T),), compared=False
    )


def delayed(robot, q0, rng) -> Scenario:
    """Three laps of the eight at 0.5 of the limits; the joints follow the command, and are measured, with 20 ms delay."""
    path, Q = fitted(robot, q0, lambda size: eight(robot, q0, size), 0.15 * robot.reach)
    unit = rate_of(robot, Q, 2.0 * np.pi / 360, 0.5)
    T = path(phases([unit] * 3))
    return Scenario("20 ms of delay", robot, q0, T, delay=round(0.02 / DT), measured=True, compared=False)


def locked(robot, q0, rng) -> Scenario:
    """Two laps of the eight at 0.4 of the limits; half-way the middle joint locks."""
    path, Q = fitted(robot, q0, lambda size: eight(robot, q0, size), 0.15 * robot.reach)
    unit = rate_of(robot, Q, 2.0 * np.pi / 360, 0.4)
    T = path(phases([unit] * 2))
    return Scenario("a joint locks half-way", robot, q0, T, "LIMITED", lock=(robot.n // 2, len(T) // 2))


def wrist(robot, q0, rng) -> Scenario:
    """A motion of the joints through the most singular configuration of the wrist, at 0.6 of the limits."""
    low, high = inner(robot, 0.1)
    place = robot.places[0][-3:]
    Q = np.repeat(q0[None], 3000, axis=0)
    Q[:, place] = rng.uniform(low[place], high[place], (3000, 3))
    J = robot.chain.forward(Q, jacobian=True)[1]
    J[:, np.arange(J.shape[1]) % 6 > 2] *= 0.2
    singular = Q[int(np.argmin(np.linalg.svd(J, compute_uv=False)[:, -1]))]
    away = np.where(singular > 0.5 * (low + high), -1.0, 1.0) * rng.uniform(0.2, 0.5, robot.n)
    swing = np.minimum(0.5, 0.9 * np.minimum(singular - robot.lower, robot.upper - singular) / np.abs(away))
    start = -np.minimum(swing, 1.0).min()
    lap = np.linspace(0.0, 4.0 * np.pi, 721)
    motion = singular + np.outer(start * np.cos(lap), away)
    unit = rate_of(robot, motion, lap[1], 0.6)
    phase = phases([unit, unit])
    motion = singular + np.outer(start * np.cos(phase), away)
    q0 = singular + start * away
    return Scenario("singular wrist crossed", robot, q0, as_tips(robot.chain.forward(motion)[0]))


MAKERS: dict[str, Callable[..., Scenario]] = {
    "eight": eight_faster, "jitter": jitter, "stretched": stretched, "far": far, "elbow": elbow, "grazed": grazed,
    "leaps": lambda *a: leaps(*a, accelerate=False), "leaps_va": lambda *a: leaps(*a, accelerate=True), "turned": turned,
    "delayed": delayed, "locked": locked, "wrist": wrist,
}  # fmt: skip


def make(name: str, robot, seed: int) -> Scenario:
    """A scenario by its short name, for a robot and a seed."""
    rng = np.random.default_rng([seed, sorted(MAKERS).index(name)])
    made = MAKERS[name](robot, comfortable(robot, np.random.default_rng(seed)), rng)
    made.seed = seed
    return made
