"""How many solutions the HydroLek-7W has, which Burrell et al. (2016) say has no closed form."""

from typing import Any, NamedTuple

import numpy as np

from ...robot.robot import Robot
from ...solvers.closed_form.elimination import Elimination, solutions_of
from ...solvers.closed_form.geometry import into_limits
from ...study.targets import sample_targets
from ..report import Report


class Numbers(NamedTuple):
    """The numbers of IK solutions of N poses, as `numbers` counts them."""

    all: np.ndarray  # (N,) The number of solutions of each pose if joint limits are ignored.
    legal: np.ndarray  # (N,) The number of solutions of each pose within the joint limits.
    certified: np.ndarray  # (N,) Whether it is proven for a pose that no solution is missing.


def numbers(robot: Robot, T: np.ndarray) -> Numbers:
    """Count the IK solutions of poses T (N, 4, 4) [m] of a robot."""
    form: Any = Elimination()
    p = form.pack(robot)
    box = np.array([robot.lower, robot.upper, robot.home])
    found = []
    for pose in T:
        said = solutions_of(p, pose)
        q, excess = np.empty_like(said.q), np.empty_like(said.q)
        into_limits(said.q, box, q, excess)
        legal = (excess.max(axis=1, initial=0.0) == 0.0).sum()
        found.append((len(said.q), legal, said.certificate.status == "CERTAIN"))
    every, legal, certified = np.array(found).T
    return Numbers(every, legal, certified.astype(bool))


def solutions(report: Report, robot: Robot, seeds: Any) -> None:
    """Add the section on the number of solutions to the report."""
    report.heading("Beyond the paper: every solution")
    whole = np.random.default_rng(seeds[0]).uniform(-np.pi, np.pi, (1000 * len(seeds), robot.n))
    sets = {
        "joints anywhere": numbers(robot, robot.chain.forward(whole)[0]),
        "the goals' joints": numbers(robot, np.concatenate([sample_targets(robot, 1000, k) for k in seeds])),
    }
    most = max(one.all.max() for one in sets.values())
    shares = {
        f"{name}: {kind}": 100.0 * np.bincount(counts, minlength=most + 1) / len(counts)
        for name, one in sets.items()
        for kind, counts in (("exist", one.all), ("within limits", one.legal))
    }
    rows = [
        [k, *(share[k] for share in shares.values())] for k in range(most + 1) if any(s[k] for s in shares.values())
    ]
    report.table("solutions", ["solutions", *(f"{name} (%)" for name in shares)], rows)
    report.number("solutions_certified", {name: float(one.certified.mean()) for name, one in sets.items()})
    anywhere, goals = sets.values()
    report.text(
        f"""The paper says that the geometry excludes a closed-form solution. It excludes a formula, not the answer: elimination
        (`ik solvers elimination`) lists every solution of a pose and certifies in
        {100 * anywhere.certified.mean():.2f} and {100 * goals.certified.mean():.2f} % that there are no others. {len(whole)}
        poses each: joints uniform over full turns, and uniform within the limits as the goals are (their poses, not their
        positions alone, which have infinitely many solutions). The arm has up to {most} solutions, {anywhere.all.mean():.1f} on
        average over its whole workspace. Its limits leave {anywhere.legal.mean():.3f} of them there, and
        {goals.legal.mean():.2f} at a pose that was made within the limits: {100 * (goals.legal == 1).mean():.2f} % of
        those poses have just one."""
    )
