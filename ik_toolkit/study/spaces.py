"""The parameter space of a solver on a robot, for tuning."""

import inspect
from typing import Any

from ..errors import InvalidOption, whole
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.registry import find_row, make_rule
from ..solvers.tuning_space import Parameter, Space
from ..validate import switch

RANGES = {
    "damping": (1e-4, 1.0, True),
    "gain": (0.05, 1.9, False),
}  # low, high, on a log scale; for any rule that has them
MOST_MAPS = 4096  # far more than any use of them; a mistyped number would fill the memory


def make_space(
    robot: Robot | Tree, solver: str, position_only: bool, maps: int | None = None, initial: Any = None
) -> Space:
    """Parameter space of a solver on a robot: that of its class (`space`), or its damping and gain.

    maps: for a solver with maps, their number; default its own choice. Raises InvalidOption for solvers without parameters and
    rules it cannot start from, UnknownSolver.
    """
    switch(position_only, "position_only")
    row = find_row(solver)
    cls = row.load()
    own = cls.space
    if maps is not None and whole(maps, "maps") > MOST_MAPS:
        raise InvalidOption(f"maps must be at most {MOST_MAPS}, not {maps!r}")
    if initial is not None and not isinstance(initial, cls):
        raise InvalidOption(f"initial must be an instance of {cls.__name__}, not {initial!r:.60}")
    several = own is not None and "maps" in inspect.signature(own).parameters
    if not several and maps not in (None, 1):
        raise InvalidOption(f"solver '{row.name}' has no maps")
    if own is not None:
        return own(robot, position_only, initial, **({"maps": maps} if several else {}))
    defaults = getattr(cls, "_field_defaults", {})
    parameters = tuple(
        Parameter(name, *RANGES[name][:2], float(getattr(initial, name, value)), log=RANGES[name][2])
        for name, value in defaults.items()
        if name in RANGES
    )
    if not parameters:
        raise InvalidOption(f"solver '{row.name}' has no parameters to tune")
    return Space(parameters, initial or make_rule(row, {}), lambda values: make_rule(row, values))
