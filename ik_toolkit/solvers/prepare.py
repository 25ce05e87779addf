"""Compiles solvers ahead of the first call."""

from collections.abc import Callable
from typing import Any

from ..errors import InvalidOption, UnknownSolver, check_progress
from ..robot.library import shipped_robots
from ..robot.robot import Robot
from ..robot.tree import Tree
from .batch.solve_batch import solve_batch
from .registry import find_row
from .solve import Solver


def prepare(*solvers: str, progress: Callable[[str], None] | None = None) -> None:
    """Compile what single calls and batches of solvers need, some ten seconds each; code compiled before is only loaded from disk.

    Args:
        solvers: Names of solvers. The default 'auto' is everything that `ik.solve`, `Solver` and `solve_batch` take by default,
            several tips included.
        progress: Function that is called with a text before each part.

    Raises:
        UnknownSolver: There is no solver of this name.
        InvalidOption: `progress` cannot be called.
    """
    check_progress(progress, "a text")
    for name in solvers or ("auto",):
        if name != "auto":
            find_row(name)
        for robot_name, entry in shipped_robots().items():
            robot = Robot.load(robot_name) if entry.tip else Tree.load(robot_name)
            if progress is not None:
                progress(f"{name} on {robot_name}")
            if _call(robot, name) and name != "auto":
                break


def _call(robot: Any, name: str) -> bool:
    """Call a solver for a pose, a position and an unreachable target, singly and in a batch.

    Returns False if it accepts none of them.
    """
    T, fits = robot.chain.forward(robot.home)[0][0], False
    calls: list[Callable[[], Any]] = []
    for one in (T, T[..., :3, 3].copy()):
        calls += [lambda one=one: Solver(robot, name)(one), lambda one=one: solve_batch(robot, one[None], name)]
    far = T.copy()
    far[..., :3, 3] += 9.0 * robot.reach
    calls.append(lambda: Solver(robot, name)(far))
    # A pose that no configuration inside the limits reaches makes the solver run, and so compile, the elimination as well.
    if name == "auto":
        beyond = robot.chain.forward(robot.home + 2.0)[0][0]
        calls += [lambda: Solver(robot)(beyond), lambda: Solver(robot).all(T, starts=1)]
    for call in calls:
        try:
            call()
            fits = True
        except (UnknownSolver, InvalidOption):
            continue
    return fits
