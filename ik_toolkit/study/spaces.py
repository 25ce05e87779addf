"""The space of a solver's parameters that tuning searches."""

import inspect
from typing import Any

from ..errors import InvalidOption, whole
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.registry import find_row, make_rule
from ..solvers.tuning_space import Parameter, Space
from ..validate import switch

# Ranges of parameters that several rules have: lowest and highest value, and whether the scale is logarithmic.
RANGES = {"damping": (1e-4, 1.0, True), "gain": (0.05, 1.9, False)}
MOST_MAPS = 4096  # largest number of maps, so that a mistyped number does not fill the memory


def make_space(
    robot: Robot | Tree, solver: str, position_only: bool, maps: int | None = None, initial: Any = None
) -> Space:
    """Return the space of a solver's parameters on a robot: the one its class defines (`space`), or its damping and gain.

    Args:
        robot: The robot to tune for.
        solver: Name of the solver.
        position_only: Whether targets are positions.
        maps: Number of maps of a solver that has them. Default: its own choice.
        initial: The rule that the search starts from. Default: the solver's own.

    Raises:
        InvalidOption: The solver has no parameters or maps, or cannot start from that rule.
        UnknownSolver: There is no such solver.
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
