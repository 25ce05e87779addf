"""The elimination: recall of planted solutions, certified share, certificates that are false, proofs that `lm` refutes, times.

python scripts/benchmarks/elimination.py [--targets 1000] [--seed 1] [--arms FILE.npz]
                                         [--parts arms kinds general hard proofs times] [-o elimination.json]

A planted solution is the configuration whose pose is the target, so it must be listed. FILE.npz may hold more arms: for each row
(name, joints, anything) of `meta` the arrays NAME_w (6, 3), NAME_r (6, 3) and NAME_M (4, 4), directions, points and tip at q = 0.
"""

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import ik_toolkit as ik
from ik_toolkit.kernel.elimination.binding import answers, arm_tip, make_arm, make_forms
from ik_toolkit.kernel.elimination.closure import joint_at
from ik_toolkit.kernel.elimination.decomposition import Split
from ik_toolkit.solvers.closed_form.elimination import moving_places, recognise_six_revolute

NAMED = ("hydrolek_7w", "ur3", "ur5", "ur10", "z1", "kinova", "talos_arm")
LIMITED = ("ur3_limited", "ur5_limited", "ur10_limited")  # half of each joint's turn
# Structures of a random arm, joints counted from 0: parN, meetN (in pairs), sphN: these axes are parallel, meet, have one point.
KINDS = (
    "general par01 par12 par23 par34 par45 par012 par123 par234 par345 meet01 meet12 meet23 meet34 meet45 meet0123 meet1234 "
    "meet2345 meet012345 sph012 sph123 sph234 sph345 par01+par23+par45 par01+meet23+par45 sph123+par45 par12+sph345 "
    "par12+meet01+sph345 par01+meet12+sph345 right right+sph345 right+meet01+sph345"
).split()
NEARLY = (0.0, 1e-9, 1e-7, 1e-5, 1e-3, 1e-2)  # distances from a singular configuration [rad]


class Count(NamedTuple):
    """What was found for some targets."""

    targets: int = 0
    listed: int = 0  # targets whose planted solution is listed, or is on a family that is
    certain: int = 0
    family: int = 0  # families of which all branches are accounted for
    double: int = 0
    false: int = 0  # certified, or a family, and the planted solution is not listed
    seconds: float = 0.0  # process time

    def plus(self, other: "Count") -> "Count":
        """Add two counts."""
        return Count._make(a + b for a, b in zip(self, other, strict=True))

    def row(self, name: str) -> str:
        """Return a row of a table."""
        n = max(self.targets, 1)
        shares = " | ".join(f"{100 * x / n:.2f}" for x in (self.listed, self.certain, self.family, self.double))
        return f"| {name} | {self.targets} | {shares} | {self.false} | {1e6 * self.seconds / n:.0f} |"


HEAD = (
    "| targets of | number | listed % | certified % | family % | double % | certified but lost | us |\n"
    "|---|---|---|---|---|---|---|---|"
)


def judged(arm: np.ndarray, forms: np.ndarray, Q: np.ndarray, within: float) -> Count:
    """Ask for the poses of the tip at Q (N, 6), and look whether Q is listed, to `within` [rad]."""
    T = np.array([arm_tip(arm, q) for q in Q])
    began = process_time()
    found = answers(forms, arm, T)
    seconds = process_time() - began
    apart = np.abs((found[:, 1:, :6] - Q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    apart[np.arange(apart.shape[1]) >= found[:, :1, 0]] = np.inf
    listed, verdict = apart.min(axis=1) < within, found[:, 0, 1]
    for k in np.flatnonzero(~listed & (verdict == 3)):
        listed[k] = any(
            on_family(forms[0], row, Q[k], within) for row in found[k, 1 : 1 + int(found[k, 0, 0])] if row[7] > 0.0
        )
    certain, family = verdict == 0, verdict == 3
    counts = [int(which.sum()) for which in (listed, certain, family, verdict == 1, (certain | family) & ~listed)]
    return Count._make([len(Q), *counts, seconds])


def on_family(form: np.ndarray, row: np.ndarray, planted: np.ndarray, within: float) -> bool:
    """Return whether a solution of the same pose is on the family of a row: the joints that do not move along it are the same."""
    split = Split(*form[: len(Split._fields)])
    moving = moving_places(split, int(row[7]) - 1)
    still = [joint_at(k, bool(split.backwards), int(split.shift)) for k in range(6) if k not in moving]
    return bool((np.abs((row[still] - planted[still] + np.pi) % (2 * np.pi) - np.pi) < within).all())


def random_arm(kind: str, seed: int) -> np.ndarray:
    """Return a random arm of a kind (see KINDS)."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(6, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    points = np.cumsum(rng.normal(size=(6, 3)) * 0.3, axis=0)
    for part in kind.split("+"):
        joints = [int(x) for x in part if x.isdigit()]
        if part == "right":
            axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
        elif part.startswith("par"):
            axes[joints] = axes[joints[0]]
        elif part.startswith("sph"):
            points[joints] = points[joints[1]]
        elif part.startswith("meet"):
            for i, j in zip(joints[::2], joints[1::2], strict=True):
                points[i] = points[j] = points[i] + axes[i] * rng.normal() * 0.3
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = pin.exp3(rng.normal(size=3)), points[5] + rng.normal(size=3) * 0.2
    return make_arm(axes, points, T)


def named_arms(extra: Path | None) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names and numbers of the named robots, and of those in a file."""
    for name in NAMED:
        yield name, recognise_six_revolute(ik.Robot.load(name).chain).parameters
    if extra is not None:
        data = np.load(extra, allow_pickle=True)
        for name, joints, _ in data["meta"]:
            if int(joints) == 6:
                yield str(name), make_arm(data[f"{name}_w"], data[f"{name}_r"], data[f"{name}_M"])


def random_targets(arms: Iterator[tuple[str, np.ndarray]], count: int, seed: int) -> dict[str, Count]:
    """Judge random targets of each arm; the last row is the sum."""
    rows, total = {}, Count()
    for name, arm in arms:
        Q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 6))
        rows[name] = judged(arm, make_forms(arm), Q, 1e-5)
        total = total.plus(rows[name])
    return {**rows, "all": total}


def jacobian(arm: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the joints' twists (6, 6) at q in the arm's lengths, one a column."""
    lines, R, p, J = arm[:36].reshape(6, 6), np.eye(3), np.zeros(3), np.empty((6, 6))
    for k, (line, angle) in enumerate(zip(lines, q, strict=True)):
        along, point = R @ line[:3], R @ line[3:] + p
        J[:3, k], J[3:, k] = np.cross(point, along), along
        turn = pin.exp3(line[:3] * angle)
        p, R = p + R @ (line[3:] - turn @ line[3:]), R @ turn
    return J


def singular(arm: np.ndarray, q: np.ndarray, joint: int) -> np.ndarray | None:
    """Return q moved along one joint to where the Jacobian's determinant changes sign, or None."""

    def value(x: float) -> float:
        return float(np.linalg.det(jacobian(arm, np.r_[q[:joint], x, q[joint + 1 :]])))

    grid = np.linspace(-np.pi, np.pi, 41)
    signs = np.sign([value(x) for x in grid])
    (changes,) = np.nonzero(signs[1:] != signs[:-1])
    if not len(changes):
        return None
    low, high = grid[changes[0]], grid[changes[0] + 1]
    for _ in range(55):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.sign(value(middle)) == signs[changes[0]] else (low, middle)
    return np.r_[q[:joint], low, q[joint + 1 :]]


def hard_targets(arms: Iterator[tuple[str, np.ndarray]], count: int, seed: int) -> dict[str, Count]:
    """Judge targets near singular configurations, at half turns, on lattices of right angles, and in millimetres and kilometres."""
    rows: dict[str, Count] = {}

    def note(name: str, arm: np.ndarray, forms: np.ndarray, Q: np.ndarray) -> None:
        if len(Q):
            one, split = judged(arm, forms, Q, 1e-3), Split(*forms[0, : len(Split._fields)])
            group = ", wrists" if split.off < 1e-9 else ", nearly wrists"  # the axes of some real arms are rounded
            for row in (name, name + group)[: 1 + (split.degree == 0.0 and split.parallel == 0.0)]:
                rows[row] = rows.get(row, Count()).plus(one)

    rng = np.random.default_rng(seed)
    for _, arm in arms:
        forms = make_forms(arm)
        tried = [(singular(arm, rng.uniform(-np.pi, np.pi, 6), joint), joint) for joint in rng.integers(1, 5, count)]
        for off in NEARLY:
            Q = np.array([q + off * (np.arange(6) == joint) for q, joint in tried if q is not None])
            note(f"{off:.0e} rad from singular", arm, forms, Q)
        Q = rng.uniform(-np.pi, np.pi, (count, 6))
        note("random", arm, forms, Q)
        for unit, name in ((1e-3, "in millimetres"), (1e3, "in kilometres")):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = arm[36:45].reshape(3, 3), unit * (arm[45:48] * arm[51] + arm[48:51])
            lines = arm[:36].reshape(6, 6)
            scaled = make_arm(lines[:, :3], unit * (lines[:, 3:] * arm[51] + arm[48:51]), T)
            note(name, scaled, make_forms(scaled), Q)
        half = Q.copy()
        half[rng.random(Q.shape) < 0.35] = np.pi
        note("joints at half a turn", arm, forms, half)
        note("all joints at right angles", arm, forms, rng.choice([0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi], (count, 6)))
    return rows


def proofs(names: tuple[str, ...], count: int, seed: int) -> dict[str, dict[str, int]]:
    """Ask `lm` with 1,000 attempts for targets that are proven blocked or unreachable: random, just beyond limits, beyond folds."""
    rng, table = np.random.default_rng(seed), {}
    for name in names:
        robot, seen = ik.Robot.load(name), Counter()
        arm, solver = recognise_six_revolute(robot.chain).parameters, ik.Solver(robot)
        hard, free = ik.Solver(robot, "lm", restarts=999), ik.Solver(robot, "lm", restarts=999, limits=False)
        for k in range(count):
            small = 10.0 ** rng.uniform(-8, -1)
            q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi))
            if k % 4 == 0:
                q = rng.uniform(-np.pi, np.pi, 6)
            elif k % 4 == 1:
                joint = int(rng.integers(6))
                q[joint] = min(robot.upper[joint], np.pi) + small
            T = robot.fk(q).homogeneous
            if k % 4 == 2:
                edge = singular(arm, rng.uniform(-np.pi, np.pi, 6), int(rng.integers(1, 5)))
                if edge is None:
                    continue
                T = robot.fk(edge).homogeneous
                push = (
                    np.linalg.svd(robot.chain.forward(edge, jacobian=True)[1][0])[0][:, -1]
                    * rng.choice([-1, 1])
                    * small
                )
                T[:3, :3], T[:3, 3] = pin.exp3(push[3:]) @ T[:3, :3], T[:3, 3] + push[:3]
            elif k % 4 == 3:
                T[:3, 3] = rng.uniform(-0.7, 0.7, 3) * robot.reach
            result = solver(T)
            decided = result.solver == "elimination"
            seen[f"{result.status.name}, {'decided' if decided else 'searched'}"] += 1
            if decided and not result.success:
                seen["refuted"] += (free if result.status == ik.Status.UNREACHABLE else hard)(T).success
        table[name] = dict(seen)
    return table


def timed(work: Callable[[np.ndarray], object], T: list[np.ndarray], calls: int = 2000) -> list[float]:
    """Return median and 99th percentile [us] of calls with the targets T in turn, without the first tenth of the calls."""
    times = []
    for k in range(calls):
        began = perf_counter()
        work(T[k % len(T)])
        times.append(1e6 * (perf_counter() - began))
    return [float(np.median(times[calls // 10 :])), float(np.percentile(times[calls // 10 :], 99))]


def times(names: tuple[str, ...], seed: int) -> dict[str, dict[str, list[float]]]:
    """Time calls from Python: the list without limits, a solve that proves a no, and solves half of which may be out of reach."""
    table = {}
    for name in names:
        robot, rng = ik.Robot.load(name), np.random.default_rng(seed)
        T = [robot.fk(q).homogeneous for q in rng.uniform(-np.pi, np.pi, (200, 6))]
        solver = ik.Solver(robot)
        nothing = [t for t in T if solver(t).solver == "elimination" and not solver(t).success]
        mixed = [robot.fk(robot.random_q(rng)).homogeneous for _ in range(200)]
        for one in mixed[::2]:
            one[:3, 3] = rng.uniform(-0.7, 0.7, 3) * robot.reach
        table[name] = {
            "Solver.all": timed(ik.Solver(robot, limits=False).all, T),
            "Solver, mixed": timed(solver, mixed),
        }
        if nothing:
            table[name]["Solver, a no"] = timed(solver, nothing)
    return table


def main() -> None:
    """Run the parts that are asked for, print tables, and write everything as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--targets", type=int, default=1000, help="targets an arm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--arms", type=Path)
    parser.add_argument("--parts", nargs="+", default=["arms", "kinds", "general", "hard", "proofs", "times"])
    parser.add_argument("-o", "--output", type=Path)
    asked = parser.parse_args()
    n, seed, data = asked.targets, asked.seed, {}
    parts: dict[str, Callable[[], dict]] = {
        "arms": lambda: random_targets(named_arms(asked.arms), n, seed),
        "kinds": lambda: random_targets(((kind, random_arm(kind, seed)) for kind in KINDS), n, seed),
        "general": lambda: random_targets(
            ((f"arm {k}", random_arm("general", 1000 * seed + k)) for k in range(200)), n, seed
        ),
        "hard": lambda: hard_targets(named_arms(asked.arms), max(n // 10, 10), seed),
    }
    for name in asked.parts:
        print(f"\n## {name}\n")
        if name in parts:
            rows = parts[name]()
            shown = {
                key: row
                for key, row in rows.items()
                if name != "general" or key == "all" or row.certain < 0.99 * row.targets
            }
            print(HEAD, *(row.row(key) for key, row in shown.items()), sep="\n", flush=True)
            data[name] = {key: row._asdict() for key, row in rows.items()}
        else:
            data[name] = proofs((*NAMED, *LIMITED), n, seed) if name == "proofs" else times(NAMED[:6], seed)
            print(json.dumps(data[name], indent=1), flush=True)
    if asked.output is not None:
        asked.output.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
