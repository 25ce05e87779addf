"""The public call for every distinct solution of one target."""

from typing import Any, Unpack

from ..errors import InvalidOption
from ..robot.robot import Robot
from ..robot.tree import Tree
from .every import find_all
from .options import AllOptions
from .solutions import Solutions
from .solve import bound_solver, require_robot

CHOOSING = ("closest", "objective", "history", "follow", "timeout")  # options that make sense for one answer only


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
    """Find every distinct solution inside the limits, nearest to q0 first; Pinocchio checks each.

    'auto' uses a closed form if one fits. Its list is complete unless the fit is only near or a family exists:
    `families` says what is free, and the rows are a spread sample. Otherwise the search runs from random starts, and
    answers that differ by full turns or by less than 1e-3 are merged; these are never proven complete. A closed form
    that may miss some solutions is completed by such a search.

    Args:
        robot: The Robot or Tree.
        target: As for `solve`.
        solver: As for `solve`.
        q0: Configuration (n,) [rad or m], by default home.
        starts: Number of random starts of a search.
        count: Largest number of solutions.
        options: As for `solve`, but for closest, objective, follow, timeout and history; limits=False lists what the
            limits forbid too.

    Returns:
        The solutions, with their errors and how complete they are.

    Raises:
        InvalidTarget, InvalidConfiguration, UnknownSolver, InvalidOption: As `solve` does.
    """
    require_robot(robot)
    for name in CHOOSING:
        if options.get(name):
            raise InvalidOption(f"solve_all lists every solution, nearest to q0 first, so it takes no '{name}'")
    options.setdefault("check", True)
    return find_all(bound_solver(robot, solver, options), target, q0, starts, count)
