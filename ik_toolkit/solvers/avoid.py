"""Solutions that touch nothing: when a solver's answer collides, the search goes on from other starts."""

from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..kernel.records import ANSWER, AT
from ..robot.collision import CollisionModel
from ..robot.robot import Robot
from .result import Status

STARTS = 256  # random starts tried before giving up, unless restarts= says otherwise
ROUND = 16  # starts in one call of the kernel
COUNTS = [AT.iterations, AT.restarts, AT.evaluations]


def collision_model(robot: Robot, asked: Any) -> CollisionModel:
    """What `avoid_collisions` stands for: a model made for this robot, or for True one with its own links only."""
    if isinstance(asked, CollisionModel):
        if asked.robot is not robot:
            raise InvalidOption(
                f"the CollisionModel was made for another Robot object ('{asked.robot.name}'); make one with this robot"
            )
        return asked
    if asked is not True:
        raise InvalidOption(f"avoid_collisions is True or a CollisionModel, not {asked!r}")
    if "collision model" not in robot.memo:
        robot.memo["collision model"] = CollisionModel(robot)
    return robot.memo["collision model"]


def avoid(solver: Any, row: np.ndarray, T: np.ndarray, kind: Any, start: np.ndarray) -> tuple[str, str] | None:
    """Replace a solution in `row` that collides by one that does not; if none is found return the pair that touches.

    solver: bound, with `collision` and `single` (the same without restarts); T (1, 4, 4); start (1, n). Random starts are
    solved ROUND at a time, and of each round the solution nearest the start that touches nothing is taken (with `closest` of
    all starts). The counts are those of all starts; a row without a free solution gets the status COLLISION.
    """
    model: CollisionModel = solver.collision
    if not model.collides(row[ANSWER:]):
        return None
    o, robot, single = solver.options, solver.robot, solver.single
    left = 0 if o.follow else STARTS if o.restarts is None else o.restarts
    size = max(left, 1) if o.closest else ROUND
    rng = np.random.default_rng(o.seed)
    opt = single.pack(kind, True)
    while left > 0 and not (o.max_evaluations and row[AT.evaluations] >= o.max_evaluations):
        count = min(size, left)
        left -= count
        Q0 = np.array([robot.random_q(rng) for _ in range(count)])
        Q0[:, solver.held] = start[0, solver.held]
        out = np.empty((count, len(row)))
        single._kernel(*single._chain, np.repeat(T, count, axis=0), Q0, out, opt, single._silent)
        row[AT.iterations] += out[:, AT.iterations].sum()
        row[AT.evaluations] += out[:, AT.evaluations].sum()
        row[AT.restarts] += count
        out = out[out[:, AT.status] == Status.CONVERGED]
        away = (((out[:, ANSWER:] - start) / robot.chain.unit) ** 2).sum(axis=1)
        for k in np.argsort(away, kind="stable"):
            if not model.collides(out[k, ANSWER:]):
                out[k, COUNTS] = row[COUNTS]
                out[k, AT.attempt] = row[AT.restarts]
                row[:] = out[k]
                return None
    row[AT.status] = Status.COLLISION
    return model.collisions(row[ANSWER:])[0]
