"""Try what the documentation promises on many random cases, with any seed; exit code 1 when a promise does not hold.

Usage: python scripts/claims.py [--seed N] [--count N] [--only NAME ...]. Each claim draws its own cases: targets are made
from legal configurations, so an answer exists. --count is the number of cases of a claim; slow claims take a share of it.
"""

import argparse
import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Callable
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

import ik_toolkit as ik
from ik_toolkit import cli
from ik_toolkit.robot.library import list_robots


class Outcome(NamedTuple):
    """What a claim found: cases tried, those that contradict it, and words on the worst of them."""

    cases: int
    broken: int
    words: str = ""


CLAIMS: dict[str, Callable[[int, int], Outcome]] = {}


def claim(name: str) -> Callable:
    """Register the decorated function (count, seed) -> Outcome; its docstring is the promise."""

    def add(function: Callable[[int, int], Outcome]) -> Callable:
        CLAIMS[name] = function
        return function

    return add


# ---------------------------------------------------------------------------------------------------------- closed forms
def uniform(robot: ik.Robot, count: int, rng: np.random.Generator) -> np.ndarray:
    """Legal configurations (count, n); endless joints within half a turn."""
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return rng.uniform(low, high, (count, robot.n))


def lost(robot: ik.Robot, Q: np.ndarray, position: bool = False, move: Any = 0.0, **options: Any) -> Outcome:
    """Count the targets made from Q (N, n), moved by `move` (N, 3) [m], that a batch does not solve or solves outside limits."""
    T = robot.chain.forward(Q)[0]
    T[:, :3, 3] += move
    batch = ik.solve_batch(robot, T[:, :3, 3] if position else T, **options)
    bad = ~batch.success | (batch.q < robot.lower).any(axis=1) | (batch.q > robot.upper).any(axis=1)
    words = f"first: q={Q[np.argmax(bad)].tolist()}, {ik.Status(int(batch.status[np.argmax(bad)])).name}"
    return Outcome(len(Q), int(bad.sum()), words if bad.any() else "")


def inspection(lift: float | None = None) -> ik.Robot:
    """The inspection robot, with its lift free or locked."""
    return ik.Robot.load("inspection_7dof", locked=None if lift is None else {"lift": lift})


def together(*outcomes: Outcome) -> Outcome:
    """Sum of several outcomes."""
    words = "; ".join(o.words for o in outcomes if o.words)
    return Outcome(sum(o.cases for o in outcomes), sum(o.broken for o in outcomes), words)


def drawn(robot: ik.Robot, count: int, rng: np.random.Generator, **values: float) -> np.ndarray:
    """Legal configurations with some joints at given values."""
    Q = uniform(robot, count, rng)
    for name, value in values.items():
        Q[:, robot.joint_names.index(name)] = value
    return Q


SHOULDER, ELBOW = "arm_pitch", "elbow_pitch"


@claim("level-arms")
def level_arms(count: int, seed: int) -> Outcome:
    """No target of a legal configuration with a level arm (one angle is free there) is lost, lift free or locked."""
    rng = np.random.default_rng(seed)
    return together(
        *(
            lost(robot, drawn(robot, count // 2, rng, **{SHOULDER: 0.0}))
            for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4))))
        )
    )


@claim("straight-elbows")
def straight_elbows(count: int, seed: int) -> Outcome:
    """No target of a legal configuration with a straight elbow is lost, with the arm level too, lift free or locked."""
    rng = np.random.default_rng(seed)
    robots = (inspection(), inspection(float(rng.uniform(0.05, 0.4))))
    cases = ({ELBOW: 0.0}, {ELBOW: 0.0, SHOULDER: 0.0})
    return together(*(lost(robot, drawn(robot, count // 4, rng, **at)) for robot in robots for at in cases))


@claim("limit-corners")
def limit_corners(count: int, seed: int) -> Outcome:
    """No target of a configuration with 2 to 5 joints at their limits is lost, lift free or locked."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4)))):
        Q = uniform(robot, count // 2, rng)
        ends = np.where(rng.random(Q.shape) < 0.5, robot.lower, robot.upper)
        rank = np.argsort(rng.random(Q.shape), axis=1)
        Q = np.where(rank < rng.integers(2, 6, (len(Q), 1)), ends, Q)
        outcomes.append(lost(robot, Q))
    return together(*outcomes)


@claim("loose-tolerances")
def loose_tolerances(count: int, seed: int) -> Outcome:
    """No target less than the tolerance away from a legal configuration, joints at limits among them, is called impossible."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4))), ik.Robot.load("planar_2r")):
        planar = robot.n == 2
        for tolerance in (1e-4, 1e-3, 1e-2):
            Q = uniform(robot, count // 9, rng)
            ends = np.where(rng.random(Q.shape) < 0.5, robot.lower, robot.upper)
            Q = np.where(rng.random(Q.shape) < 0.3, ends, Q)
            move = rng.normal(size=(len(Q), 3)) * (1.0, 1.0, 0.0 if planar else 1.0)
            move *= 0.9 * tolerance / np.linalg.norm(move, axis=1, keepdims=True)
            outcomes.append(lost(robot, Q, planar, move, tolerance=tolerance))
    return together(*outcomes)


def folding(rng: np.random.Generator) -> ik.Robot:
    """A planar arm with equal links that folds onto its base, with limits of its own."""
    low, high = rng.uniform(-3.0, -0.5), rng.uniform(0.5, 3.0)
    limits = (
        f'<limit lower="{low}" upper="{high}" effort="1" velocity="1"/>',
        '<limit lower="-4" upper="4" effort="1" velocity="1"/>',
    )
    joints = "".join(
        f'<link name="l{k + 1}"/><joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        f'<origin xyz="{0.5 * k} 0 0"/><axis xyz="0 0 1"/>{limit}</joint>'
        for k, limit in enumerate(limits)
    )
    tip = '<link name="tip"/><joint name="end" type="fixed"><parent link="l2"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>'
    return ik.Robot.load(f'<robot name="folding"><link name="l0"/>{joints}{tip}</robot>', tip="tip")


@claim("planar")
def planar(count: int, seed: int) -> Outcome:
    """A planar arm loses no target: equal links, on the base, stretched out, at its limits."""
    rng = np.random.default_rng(seed)
    outcomes = []
    for robot in (folding(rng), ik.Robot.load("planar_2r")):
        elbow = robot.joint_names[1]
        half = np.pi if robot.upper[1] > np.pi else robot.upper[1]
        for value in (0.0, half, float(robot.lower[1])):
            outcomes.append(lost(robot, drawn(robot, count // 6, rng, **{elbow: value}), True))
    return together(*outcomes)


def members(rng: np.random.Generator) -> list[tuple[ik.Robot, np.ndarray, bool]]:
    """Robots, configurations on a family of solutions, and whether the target is a position."""
    locked, arm = inspection(float(rng.uniform(0.05, 0.4))), inspection()
    cases = [(locked, drawn(locked, 1, rng, **{SHOULDER: 0.0})[0], False), (arm, drawn(arm, 1, rng)[0], False)]
    fold = folding(rng)
    cases.append((fold, drawn(fold, 1, rng, j1=np.pi)[0], True))
    try:
        ur5 = ik.Robot.load("ur5", tip="tool0")
        q = uniform(ur5, 1, rng)[0]
        q[4] = 0.0
        cases.append((ur5, q, False))
    except ik.IKError:
        pass  # example-robot-data is not installed
    return cases


@claim("families")
def families(count: int, seed: int) -> Outcome:
    """Where a family of solutions exists `solve_all` is never complete, says so, and lists at most `count`."""
    rng = np.random.default_rng(seed)
    cases = broken = 0
    words = ""
    for _ in range(max(count // 5000, 1)):
        for robot, q, position in members(rng):
            T = robot.fk(q)
            found = ik.solve_all(robot, T.translation if position else T, starts=200, count=16)
            cases += 1
            if found.complete or not found.families or not 0 < len(found) <= 16:
                broken += 1
                words = f"last: {robot.name} q={q.tolist()}: {found}"
    return Outcome(cases, broken, words)


def nearest(Q: np.ndarray, q: np.ndarray) -> float:
    """Largest joint difference of the row of Q nearest q, angles modulo turns."""
    apart = np.abs(Q - q)
    return float(np.minimum(apart, np.abs(2 * np.pi - apart)).max(axis=1, initial=0.0).min(initial=np.inf))


@claim("recall")
def recall(count: int, seed: int) -> Outcome:
    """`solve_all` lists the configuration a target was made from, at generic and singular poses; complete lists miss nothing.

    6R: by our closed form, and by starts; what starts find has to be in a list that is called complete. A list from starts
    alone, which claims nothing, may miss one case in a hundred: nearly level arms with a straight elbow are doubly singular.
    """
    rng = np.random.default_rng(seed)
    locked = inspection(float(rng.uniform(0.05, 0.4)))
    robots = [(locked, "auto", count // 500, ({}, {ELBOW: 0.0})), (locked, "lm", count // 5000, ({}, {ELBOW: 0.0}))]
    try:
        panda = ik.Robot.load("panda", tip="panda_hand_tcp").locked({"panda_joint5": float(rng.uniform(-1.0, 1.0))})
        robots.append((panda, "auto", count // 5000, ({},)))
        robots.append((ik.Robot.load("ur5", tip="tool0"), "auto", count // 5000, ({}, {"elbow_joint": 0.0})))
    except ik.IKError:
        pass  # example-robot-data is not installed
    cases = broken = missed = 0
    words = ""
    for robot, solver, number, poses in robots:
        for values in poses:
            for q in drawn(robot, max(number, 2), rng, **values):
                found = ik.solve_all(robot, robot.fk(q), solver, starts=1000)
                wrong = nearest(found.q, q) > 2e-3
                if found.complete:
                    other = ik.solve_all(robot, robot.fk(q), "lm", starts=50)
                    # At a nearly level, straight arm what meets 1e-9 is spread over 0.01 rad; other branches are further away.
                    wrong |= any(nearest(found.q, x) > 0.05 for x in other)
                cases += 1
                broken += wrong and found.complete
                missed += wrong and not found.complete
                words = f"last: {robot.name} q={q.tolist()}: {found}" if wrong else words
    return Outcome(cases, broken + missed * (missed > 0.01 * cases), f"{missed} missed by starts alone; {words}")


@claim("failures")
def failures(count: int, seed: int) -> Outcome:
    """A failed closed form returns a configuration no worse than that of `lm`, legal, with errors and sentence of its own."""
    rng = np.random.default_rng(seed)
    cases = broken = 0
    for robot in (inspection(), inspection(float(rng.uniform(0.05, 0.4)))):
        scale = robot.chain.scale
        for q in uniform(robot, max(count // 500, 2), rng):
            T = robot.fk(q).homogeneous
            T[:3, 3] *= rng.uniform(0.2, 1.6, 3)
            result, search = ik.solve(robot, T), ik.solve(robot, T, "lm")
            if result.success:
                continue
            cases += 1
            position, rotation = robot.errors(result.q, T)
            size, other = (
                (r.position_error / scale) ** 2 + 4.0 * np.sin(0.5 * r.orientation_error) ** 2 for r in (result, search)
            )
            said = f"{1000 * position:.3g} mm" in result.message or f"{position:.3g} m" in result.message
            right = abs(position - result.position_error) < 1e-9 and abs(rotation - result.orientation_error) < 1e-7
            broken += (
                search.success or size > other * (1 + 1e-9) or robot.outside(result.q) != [] or not (said and right)
            )
    return Outcome(cases, broken)


# ----------------------------------------------------------------------------------------------------------------- loops
LOOP_ROBOTS = ("hydrolek_7w", "inspection_7dof", "panda", "ur5", "xarm7", "kinova")


@claim("loops")
def loops(count: int, seed: int) -> Outcome:
    """A loop that moves the target by 1 mrad or 1 mm a call: no joint jumps with follow, and without it no jump is silent."""
    rng = np.random.default_rng(seed)
    calls, broken, words = 0, 0, ""
    while calls < count:
        robot = ik.Robot.load(LOOP_ROBOTS[int(rng.integers(len(LOOP_ROBOTS)))])
        following, plain = ik.Solver(robot, follow=True), ik.Solver(robot, "lm")
        q = uniform(robot, 1, rng)[0]
        T = robot.fk(q)
        step = pin.exp6(
            np.concatenate([1e-3 * unit(rng), np.zeros(3)] if rng.random() < 0.5 else [np.zeros(3), 1e-3 * unit(rng)])
        )
        size = np.where(np.array(robot.joint_kinds) == "prismatic", robot.reach, 1.0)
        for _ in range(min(1000, count)):
            T = T * step
            calls += 1
            near, free = following(T.homogeneous, q0=q), plain(T.homogeneous, q0=q)
            far = (np.abs(near.q - q) / size).max() > 0.5
            silent = (np.abs(free.q - q) / size).max() > 0.5 and free.attempt > 0 and not free.notice
            position, orientation = robot.errors(near.q, T.homogeneous)
            false = near.success and max(position, orientation) > 1e-6
            if far or silent or false:
                broken, words = broken + 1, f"{robot.name} from q={q.tolist()}: {near.status.name}, {free.notice!r}"
            if not near.success:
                break
            q = near.q
    return Outcome(calls, broken, words)


def unit(rng: np.random.Generator) -> np.ndarray:
    """Random direction (3,)."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


# ---------------------------------------------------------------------------------------------------------------- tracks
TOLERANCES = (1e-3, float(np.radians(0.1)))  # [m, rad] of `ik.track`


def excess(
    robot: ik.Robot, reference: ik.Reference, t: np.ndarray, Q: np.ndarray, limits: tuple[float, float]
) -> float:
    """Largest error of the samples over its tolerance, infinite for a run that ended early; the tip is where Pinocchio sees it."""
    worst = 0.0 if len(t) and t[-1] > reference.duration - 0.1 else np.inf  # no step here is longer than 0.1 s
    for now, q in zip(t, Q, strict=True):
        wanted, tip = reference.at(float(now))[0], robot.fk(q)
        worst = max(worst, float(np.linalg.norm(wanted[:3, 3] - tip.translation)) / limits[0])
        if not reference.position_only:
            worst = max(worst, float(np.linalg.norm(pin.log3(tip.rotation.T @ wanted[:3, :3]))) / limits[1])
    return worst


def contradiction(success: bool, worst: float) -> bool:
    """Whether a verdict and the errors disagree; two ways of adding up may differ in the last digits."""
    return success != (worst <= 1.0) and abs(worst - 1.0) > 1e-6


def command_track(words: list[str], robot: ik.Robot, reference: ik.Reference) -> Outcome:
    """Run `ik track`; its exit code and status against every sample that it writes."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()) as said:
        file = f"{folder}/run.npz"
        with contextlib.redirect_stderr(io.StringIO()):
            code = cli.main(["track", *words, "--json", "-o", file])
        with np.load(file) as data:
            worst = excess(robot, reference, data["t"], data["q"], TOLERANCES)
    status = json.loads(said.getvalue())["status"]
    bad = contradiction(status == "COMPLETED", worst) or (code == 0) != (status == "COMPLETED")
    return Outcome(1, int(bad), f"{' '.join(words)}: {status}, exit {code}, {worst:.3g} tolerances" if bad else "")


def python_track(
    robot: ik.Robot, reference: ik.Reference, limits: tuple[float, float] = TOLERANCES, **options
) -> Outcome:
    """Run `ik.track`; its status against every sample."""
    run = ik.track(robot, reference, position_tolerance=limits[0], orientation_tolerance=limits[1], **options)
    late = run.t >= run.settle
    worst = excess(robot, reference, run.t[late], run.q[late], limits)
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
        outcomes.append(command_track(words, robot, ik.circle(home, 0.1)))
        if name == "hydrolek_7w":  # of the guide, as the next
            eight = ik.lissajous(home, (0.08, 0.04, 0.0))
            outcomes.append(command_track([*words, "--path", "eight", "--radius", "0.08"], robot, eight))
        if name == "planar_2r":
            circle = ik.circle((1.35, 0.6, 0.0), radius=0.35, duration=10.0)
            outcomes.append(python_track(robot, circle, dt=0.02, q0=ik.solve(robot, (1.35, 0.6, 0.0)).q))
    outcomes += [random_track(names, rng) for _ in range(count // 200)]
    return together(*outcomes)


def main() -> None:
    """Run the claims asked for and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--only", nargs="+", choices=sorted(CLAIMS), metavar="NAME", default=list(CLAIMS))
    given = parser.parse_args()
    failed = 0
    for name in given.only:
        began = perf_counter()
        outcome = CLAIMS[name](given.count, given.seed)
        failed += outcome.broken > 0
        verdict = "holds" if outcome.broken == 0 else f"BROKEN in {outcome.broken}"
        print(
            f"{name:20} {verdict:18} {outcome.cases:9} cases  {perf_counter() - began:6.1f} s  {outcome.words}",
            flush=True,
        )
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
