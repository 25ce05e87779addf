"""The public call for every distinct solution of one target."""

from typing import Any, Unpack

from ..errors import InvalidOption
from ..robot.robot import Robot
from ..robot.tree import Tree
from .every import find_all
from .options import AllOptions
from .solutions import Solutions
from .solve import bound_solver, require_robot

CHOOSING = ("closest", "objective", "history", "follow", "timeout")  # options about one answer


def solve_all(
    robot: Robot | Tree,
    target: Any,
    solver: Any = "auto",
    q0: Any = None,
    *,
    starts: int = 1000,
    count: int = 64,
    **options: Unpack[AllOptions],
) -> Solutions:
    """Find every distinct solution inside the limits, nearest to q0 (default home) first.

    target: as for `solve`. 'auto' uses a closed form where one fits (complete, unless the fit is only near or a family exists:
    `families` says what is free, and the rows are a spread sample of at most `count`) and otherwise a search from `starts` random
    starts, answers a turn or less than 1e-3 apart merged (never proven complete). A closed form that may miss some is completed by
    the same starts. Options as for `solve`, but for closest, objective, follow and history; limits=False lists what the limits
    forbid too. Each is checked with Pinocchio. Raises as `solve` does.
    """
    require_robot(robot)
    for name in CHOOSING:
        if options.get(name):
            raise InvalidOption(f"solve_all lists every solution, nearest to q0 first, so it takes no '{name}'")
    options.setdefault("check", True)
    return find_all(bound_solver(robot, solver, options), target, q0, starts, count)
