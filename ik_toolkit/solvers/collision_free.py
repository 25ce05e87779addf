"""Finds collision-free solutions: if a solver's answer collides, the search continues from other starts."""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..kernel.checks import CODE
from ..kernel.records import AT
from ..robot.geometry.collision import CollisionModel
from .options import AVOID, PLAIN, avoided
from .status import Status

STARTS = 256  # number of random starts tried for a solution free of contact, unless the option `restarts` gives another
ROUND = 16  # number of random starts that are solved together in one call of the compiled search
COUNTS = [AT.iterations, AT.restarts, AT.evaluations]


def collision_model(robot: Any, asked: Any) -> CollisionModel:
    """Return the collision model that the option `avoid_collisions` asks for. Raises InvalidOption.

    A given CollisionModel must be of this robot. True, or a margin [m], asks for a model of the robot's own links. A
    variant of a robot with narrower limits has the same shapes and pairs, so it shares the robot's model.
    """
    found = avoided(asked)
    if isinstance(found, CollisionModel):
        if found.robot is not robot and found.robot is not robot._wide:
            raise InvalidOption(
                f"the CollisionModel was made for another Robot object ('{found.robot.name}'); make one with this robot"
            )
        return found
    if found is False:
        raise InvalidOption(f"{AVOID}, not {asked!r}")
    robot = robot if robot._wide is None else robot._wide
    key = "collision model", 0.0 if found is True else found
    if key not in robot.memo:
        robot.memo[key] = CollisionModel(robot, margin=key[1])
    return robot.memo[key]


def avoiding(plan: Any, then: tuple[Callable[[Any], Any], ...]) -> Callable[[Any], Any]:
    """Return a function that replaces a solution in contact by one free of contact; it runs after a solve has converged.

    The function solves again from random starts, in rounds of ROUND starts (with `closest` in a single round of all). The first
    round with solutions free of contact ends the search, and of these the one nearest the start is chosen. If no round has one,
    the status is COLLISION. The counts of iterations and evaluations are those of all starts together. `then`: steps that improve
    the answer afterwards; a step that causes a contact is undone.
    """
    model = collision_model(plan.robot, plan.options.avoid_collisions)
    single = plan.varied(**PLAIN, timeout=None, **({} if plan.options.follow else {"restarts": 0}))

    def step(outcome: Any) -> Any:
        if outcome.row[AT.status] != CODE.converged:
            return outcome
        if model.collides(outcome.row[plan.q_columns]):
            outcome = _another(single, model, outcome)
        for improve in then:
            better = improve(outcome)
            if not model.collides(better.row[plan.q_columns]):
                outcome = better
        return outcome

    return step


def _from(Q0: np.ndarray, single: Any, outcome: Any, budget: float) -> np.ndarray:
    """Return the result rows of attempts from the starts Q0 (m, n), or from as many as the `budget` of evaluations allows."""
    out = np.empty((len(Q0), len(outcome.row)))
    if budget == np.inf:
        single.run(np.repeat(outcome.T, len(Q0), axis=0), outcome.kinds, Q0, True, out)
        return out
    for k in range(len(Q0)):
        if budget <= 0:
            return out[:k]
        single.varied(max_evaluations=int(budget)).run(outcome.T, outcome.kinds, Q0[k : k + 1], True, out[k : k + 1])
        budget -= out[k, AT.evaluations]
    return out


def _another(single: Any, model: CollisionModel, outcome: Any) -> Any:
    """Return the outcome with a solution that touches nothing, or with the pair that touches and the status COLLISION."""
    o, robot, row = outcome.plan.options, single.robot, outcome.row.copy()
    q = single.q_columns
    left = 0 if o.follow else STARTS if o.restarts is None else o.restarts
    size = max(left, 1) if o.closest else ROUND
    rng = np.random.default_rng(o.seed)
    end = np.inf if o.timeout is None else perf_counter() + o.timeout - outcome.elapsed
    while left > 0 and perf_counter() < end and not (o.max_evaluations and row[AT.evaluations] >= o.max_evaluations):
        count = min(size, left)
        left -= count
        Q0 = robot.random_q(rng, count)
        Q0[:, single.held] = outcome.start[0, single.held]
        out = _from(Q0, single, outcome, (o.max_evaluations or np.inf) - row[AT.evaluations])
        row[AT.iterations] += out[:, AT.iterations].sum()
        row[AT.evaluations] += out[:, AT.evaluations].sum()
        row[AT.restarts] += len(out)
        out = out[out[:, AT.status] == CODE.converged]
        away = (((out[:, q] - outcome.start) / robot.chain.unit) ** 2).sum(axis=1)
        for k in np.argsort(away, kind="stable"):
            if not model.collides(out[k, q]):
                out[k, COUNTS] = row[COUNTS]
                out[k, AT.attempt] = row[AT.restarts]
                return outcome._replace(row=out[k])
    row[AT.status] = Status.COLLISION
    return outcome._replace(row=row, collision=model.collisions(row[q])[0])
