"""Claims about tracking: COMPLETED means that every sample was inside the tolerances."""

import contextlib
import io
import json
import tempfile

import numpy as np
import pinocchio as pin
from common import Outcome, claim, together, uniform, unit

import ik_toolkit as ik
from ik_toolkit import cli
from ik_toolkit.robot.library import list_robots

TOLERANCES = (1e-3, float(np.radians(0.1)))  # [m, rad] of `ik.track`


def excess(
    robot: ik.Robot, reference: ik.Reference, t: np.ndarray, Q: np.ndarray, limits: tuple[float, float]
) -> float:
    """Largest error of the samples over its tolerance, infinite for a run that ended early; tip poses by Pinocchio."""
    worst = 0.0 if len(t) and t[-1] > reference.duration - 0.1 else np.inf  # no step here is longer than 0.1 s
    for now, q in zip(t, Q, strict=True):
        wanted, tip = reference.at(float(now))[0], robot.fk(q)
        worst = max(worst, float(np.linalg.norm(wanted[:3, 3] - tip.translation)) / limits[0])
        if not reference.position_only:
            worst = max(worst, float(np.linalg.norm(pin.log3(tip.rotation.T @ wanted[:3, :3]))) / limits[1])
    return worst


def contradiction(success: bool, worst: float) -> bool:
    """Whether a verdict and the errors disagree, allowing for rounding."""
    return success != (worst <= 1.0) and abs(worst - 1.0) > 1e-6


def command_track(words: list[str], robot: ik.Robot, reference: ik.Reference) -> Outcome:
    """Run `ik track` and check its exit code and status against every sample it writes."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()) as said:
        file = f"{folder}/run.npz"
        with contextlib.redirect_stderr(io.StringIO()):
            code = cli.main(["track", *words, "--json", "-o", file])
        with np.load(file) as data:
            worst = excess(robot, reference, data["clock"], data["q"], TOLERANCES)
    status = json.loads(said.getvalue())["status"]
    followed = status in ("COMPLETED", "SLOWED")
    bad = contradiction(followed, worst) or (code == 0) != followed
    return Outcome(1, int(bad), f"{' '.join(words)}: {status}, exit {code}, {worst:.3g} tolerances" if bad else "")


def python_track(
    robot: ik.Robot, reference: ik.Reference, limits: tuple[float, float] = TOLERANCES, **options
) -> Outcome:
    """Run `ik.track` and check its status against every sample."""
    run = ik.track(robot, reference, position_tolerance=limits[0], orientation_tolerance=limits[1], **options)
    late = run.t >= run.settle
    worst = excess(robot, reference, run.clock[late], run.q[late], limits)
    bad = contradiction(run.success, worst)
    return Outcome(
        1, int(bad), f"{robot.name}, {reference!r}, {options}: {run.status.name}, {worst:.9g}" if bad else ""
    )


def random_track(names: list[tuple[str, str | None]], rng: np.random.Generator) -> Outcome:
    """A run on any robot, path, method and tolerance."""
    name, tip = names[rng.integers(len(names))]
    robot = ik.Robot.load(name, tip=tip)
    q0 = uniform(robot, 1, rng)[0] * 0.9 + 0.05 * (np.maximum(robot.lower, -np.pi) + np.minimum(robot.upper, np.pi))
    T = robot.fk(q0).homogeneous
    start, size, seconds = (T[:3, 3] if rng.random() < 0.4 else T), rng.uniform(0.005, 0.2), rng.uniform(1.0, 5.0)
    end = start.copy()
    (end if start.ndim == 1 else end[:3, 3])[:] += size * unit(rng)
    reference = (
        ik.circle(start, size, normal=unit(rng), duration=seconds),
        ik.line(start, end, duration=seconds, law="minimum-jerk"),
        ik.lissajous(start, (size, 0.5 * size, 0.0), duration=seconds),
    )[rng.integers(3)]
    limits = tuple(10.0 ** rng.uniform(-7.0, -1.0, 2)) if rng.random() < 0.5 else TOLERANCES
    return python_track(
        robot,
        reference,
        limits,
        method=str(rng.choice(["cv", "av", "ca", "aad", "dls"])),
        dt=float(rng.choice([0.002, 0.01, 0.03])),
        q0=q0,
        acceleration_limits=None if rng.random() < 0.6 else float(rng.uniform(1.0, 30.0)),
        settle=None if rng.random() < 0.6 else float(rng.uniform(0.0, 0.9)),
    )


@claim("tracks")
def tracks(count: int, seed: int) -> Outcome:
    """A run is COMPLETED, and `ik track` ends with 0, exactly when every sample is inside the tolerances."""
    rng = np.random.default_rng(seed)
    names = [(e.name, tip) for e in list_robots() for tip in (e.tips if len(e.tips) > 1 else (None,))]
    outcomes = []
    for name, tip in names:
        robot = ik.Robot.load(name, tip=tip)
        home = robot.fk(robot.home).homogeneous
        words = [name, *(["--tip", tip] if tip else [])]
        outcomes.append(command_track([*words, "--radius", "0.1"], robot, ik.circle(home, 0.1)))
        if name == "hydrolek_7w":  # of the guide, as the next
            eight = ik.lissajous(home, (0.08, 0.04, 0.0))
            outcomes.append(command_track([*words, "--path", "eight", "--radius", "0.08"], robot, eight))
        if name == "planar_2r":
            circle = ik.circle((1.35, 0.6, 0.0), radius=0.35, duration=10.0)
            outcomes.append(python_track(robot, circle, dt=0.02, q0=ik.solve(robot, (1.35, 0.6, 0.0)).q))
    outcomes += [random_track(names, rng) for _ in range(count // 200)]
    return together(*outcomes)
