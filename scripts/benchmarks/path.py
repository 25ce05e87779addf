"""Whole paths: problems from CppFlow and in the style of TORM, a pipe, two arms, true minima, memory, cost against length.

python scripts/benchmarks/path.py

Validity is checked here, by Pinocchio and coal, as in CppFlow: every pose within 0.1 mm and 0.1 deg, steps of at most 7 deg and
2 cm, limits, no contact at the poses and at three places between neighbours. Times start with robot, collision model and kernels
loaded and include the result's own checks and proof of continuity. The output is written after every part.
"""

import functools
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import common
import numpy as np
import path_truth
from path_problems import Problem, names, problem

import ik_toolkit as ik

POSITION, ANGLE, TURN, SLIDE = 1e-4, np.radians(0.1), np.radians(7.0), 0.02  # m, rad, rad, m
BETWEEN = 3


def off(robot: Any, q: np.ndarray, T: np.ndarray, axis: np.ndarray | None) -> tuple[float, float]:
    """Errors [m] and [rad] of the worst tip at q (n,); with a free turn, the angle between its axis and that of the pose."""
    if robot.by_tip:
        return tuple(np.max(robot.errors(q, T), axis=0))
    if axis is None:
        return robot.errors(q, T)
    tip = robot.fk(q)
    between = np.cross(tip.rotation @ axis, T[:3, :3] @ axis), tip.rotation @ axis @ T[:3, :3] @ axis
    return float(np.linalg.norm(tip.translation - T[:3, 3])), float(np.arctan2(np.linalg.norm(between[0]), between[1]))


def faults(given: Problem, q: np.ndarray) -> list[str]:
    """Faults of a path q (N, n)."""
    robot, model = given.robot, given.model
    if not np.isfinite(q).all():
        return ["rows without numbers"]
    found = []
    errors = np.array([off(robot, x, one, given.axis) for x, one in zip(q, given.T, strict=True)])
    if errors[:, 0].max() > POSITION or errors[:, 1].max() > ANGLE:
        found.append(f"off by {1000 * errors[:, 0].max():.3g} mm, {np.degrees(errors[:, 1].max()):.3g} deg")
    moves = np.abs(np.diff(q, axis=0)).max(axis=0, initial=0.0)
    if (moves > np.where(robot.slides, SLIDE, TURN)).any():
        found.append(f"a step of {np.degrees(moves[~robot.slides].max(initial=0.0)):.3g} deg")
    if (q < robot.lower).any() or (q > robot.upper).any():
        found.append("outside the limits")
    shares = np.arange(BETWEEN + 1) / (BETWEEN + 1)
    dense = np.concatenate([q[:-1, None] + shares[:, None] * np.diff(q, axis=0)[:, None], q[1:, None][:, :0]], axis=1)
    touching = sum(model.collides(x) for x in [*dense.reshape(-1, robot.n), q[-1]])
    return [*found, f"{touching} contacts"] if touching else found


def solve_problem(name: str, seeds: int) -> dict[str, Any]:
    """Solve a problem with every seed; the first call, which loads kernels, is reported separately."""
    one = problem(name)
    call = functools.partial(ik.solve_path, one.robot, one.T, **one.options)
    began = perf_counter()
    call(avoid_collisions=one.model, seed=seeds)
    cold = perf_counter() - began
    seconds, processor, lengths, wrong, free, moves = ([] for _ in range(6))
    for seed in range(seeds):
        began, busy = perf_counter(), os.times()
        made = call(avoid_collisions=one.model, seed=seed)
        seconds.append(perf_counter() - began)
        processor.append(sum(os.times()[:2]) - sum(busy[:2]))
        lengths.append(made.length[0])
        wrong.append([*faults(one, made.q), *([] if made.success else [made.status.name])])
        moves.append(len(made.reconfigurations))
        began = perf_counter()
        call(seed=seed)
        free.append(perf_counter() - began)
    return {
        "problem": name, "poses": len(one.T), "valid": sum(not one for one in wrong), "seeds": seeds, "faults": wrong,
        "seconds": seconds, "processor": processor, "without_obstacles": free, "cold": cold, "lengths": lengths,
        "reconfigurations": moves, "known": one.known,
    }  # fmt: skip


def size(count: int) -> dict[str, Any]:
    """Time and peak memory of a path of `count` poses: panda 1cube, stretched, without and with obstacles."""
    given = problem("panda__1cube")
    robot, T, model = given.robot, given.T, given.model
    ik.solve_path(robot, T[:20], avoid_collisions=model)
    there = T[:, :3, 3]
    places = np.linspace(0.0, len(there) - 1.0, count)
    long = np.tile(T[0], (count, 1, 1))
    long[:, :3, 3] = np.column_stack([np.interp(places, np.arange(len(there)), there[:, k]) for k in range(3)])
    found = {"poses": count}
    for what, options in (("free", {}), ("obstacles", {"avoid_collisions": model})):
        began, busy = perf_counter(), os.times()
        made = ik.solve_path(robot, long, **options)
        seconds, processor = perf_counter() - began, sum(os.times()[:2]) - sum(busy[:2])
        found[what] = {
            "seconds": seconds, "processor": processor, "status": made.status.name, "length": made.length[0],
        }  # fmt: skip
    found["memory"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return found


def main() -> None:
    parser = common.parser(__doc__, "benchmark_path.json")
    parser.add_argument("--problems", nargs="*", default=names(), help="of: " + "; ".join(names()))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--sizes", nargs="*", type=int, default=[100, 1000, 10_000])
    parser.add_argument("--paths", type=int, default=100, help="random paths whose true minimum is enumerated")
    parser.add_argument("--truth", nargs="*", default=path_truth.COMPARED, help="of: " + "; ".join(path_truth.COMPARED))
    parser.add_argument("--one", type=int, metavar="POSES", help="(internal) measure one size in this process")
    given = parser.parse_args()
    if given.one:
        print(json.dumps(size(given.one)))
        return
    before = common.load_average()
    made: dict[str, Any] = {"machine": common.machine(), "problems": [], "sizes": [], "truth": []}
    for name in given.problems:
        one = solve_problem(name, given.seeds)
        made["problems"].append(one)
        faulty = {seed: wrong for seed, wrong in enumerate(one["faults"]) if wrong}
        print(f"{name}: {one['valid']} of {one['seeds']} {faulty or ''}", file=sys.stderr)
        keep(given.output, made, before)
    for count in given.sizes:
        command = [sys.executable, __file__, "--one", str(count)]
        made["sizes"].append(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
        keep(given.output, made, before)
    for what in given.truth:
        made["truth"].append({"what": what, **path_truth.COMPARED[what](given.paths, given.seed)})
        keep(given.output, made, before)
    print(keep(given.output, made, before))


def keep(output: Path, made: dict[str, Any], before: float) -> str:
    """Write what is measured so far; returns the tables."""
    return common.keep(output, {**made, "load_average": [before, common.load_average()]}, *tables(made))


def tables(made: dict[str, Any]) -> list[str]:
    """Markdown: the problems, cost against length, and the true minima. Times are processor times; the data have both."""
    problems = [
        [
            one["problem"].replace("__", ", "), one["poses"], f"{one['valid']} of {one['seeds']}",
            common.short(np.median(one["processor"])), common.short(max(one["processor"])), f"{np.median(one['lengths']):.2f}",
            f"{max(one['lengths']):.2f}", "" if one["known"] is None else one["known"],
        ]
        for one in made["problems"]
    ]  # fmt: skip
    sizes = [
        [
            f"{one['poses']:,}",
            *(common.short(one[what]["processor"]) for what in ("free", "obstacles")),
            f"{one['memory'] / 1e6:.0f}",
        ]
        for one in made["sizes"]
    ]
    counts = ("what", "paths", "equal", "more", "fewer")
    truth = [
        [*map(one.get, counts), common.short(one["processor"]), common.short(one["longest"])] for one in made["truth"]
    ]
    head = [
        "problem",
        "poses",
        "valid",
        "processor, s, median",
        "most",
        "length, rad, median",
        "longest",
        "shortest known",
    ]
    cost = ["poses", "processor, s", "with obstacles", "memory, MB"]
    least = ["task", "paths", "as few as there can be", "more", "fewer", "processor, s, median", "most"]
    return [
        "### Problems\n\n" + common.table(head, problems),
        "### Cost against length\n\n" + common.table(cost, sizes),
        "### True minima, by enumeration or planted\n\n" + common.table(least, truth),
    ]


if __name__ == "__main__":
    main()
