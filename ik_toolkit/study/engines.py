"""Optimisers for tuning, a particle swarm and CMA-ES, and the spaces of parameters that they search."""

import inspect
from typing import Any

import numpy as np

from ..errors import InvalidOption, whole
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.registry import find_row, make_rule
from ..solvers.tuning_space import Parameter, Space
from ..validate import switch

# Range in which a parameter of this name is tuned, for every solver that has it: lowest and highest value, and whether the scale is
# logarithmic.
RANGES = {"damping": (1e-4, 1.0, True), "gain": (0.05, 1.9, False)}
# largest number of starts that can be tuned at once; it keeps a mistyped number from filling the memory
MOST_MAPS = 4096


class Swarm:
    """A particle swarm optimiser in the unit box (every parameter from 0 to 1); particles stop at its walls.

    Its inertia 0.729 and accelerations 1.494 are those of Clerc and Kennedy (2002).
    """

    def __init__(self, start: np.ndarray, spread: float, population: int, seed: int) -> None:
        """Place the particles around `start` (d,), with standard deviation `spread`; the first one is `start` itself."""
        self.rng = np.random.default_rng(seed)
        self.x = np.clip(start + spread * self.rng.standard_normal((population, len(start))), 0.0, 1.0)
        self.x[0] = start
        self.v = spread * self.rng.uniform(-1.0, 1.0, self.x.shape)
        self.own = self.x.copy()
        self.cost = np.full(population, np.inf)

    def ask(self) -> np.ndarray:
        """Return the particles' positions (population, d) in the unit box, to be evaluated next."""
        return self.x

    def tell(self, costs: np.ndarray) -> None:
        """Take the costs (population,) of the candidates that `ask` returned, and move the particles."""
        better = costs < self.cost
        self.own[better], self.cost[better] = self.x[better], costs[better]
        leader = self.own[np.argmin(self.cost)]
        a, b = self.rng.random((2, *self.x.shape))
        self.v = 0.729 * self.v + 1.494 * (a * (self.own - self.x) + b * (leader - self.x))
        moved = np.clip(self.x + self.v, 0.0, 1.0)
        self.v[moved != self.x + self.v] = 0.0
        self.x = moved


class Evolution:
    """CMA-ES (Hansen 2016) in the unit box, by the package `cma`."""

    def __init__(self, start: np.ndarray, spread: float, population: int, seed: int) -> None:
        """Start at `start` (d,) with standard deviation `spread`."""
        import cma

        # A population that does not fit into memory is refused at once; `cma` would fill the memory first.
        np.empty((population, len(start)))
        options = {"bounds": [0.0, 1.0], "popsize": population, "seed": seed % 2**31 + 1, "verbose": -9}
        self.size = len(start)
        if self.size == 1:  # The package `cma` fails in one dimension, so a dummy dimension is added.
            start = np.append(start, 0.5)
        self.engine = cma.CMAEvolutionStrategy(start, spread, options)

    def ask(self) -> np.ndarray:
        """Return candidates (population, d) in the unit box, to be evaluated next."""
        self.asked = self.engine.ask()
        return np.array(self.asked)[:, : self.size]

    def tell(self, costs: np.ndarray) -> None:
        """Take the costs (population,) of the candidates that `ask` returned, and update the distribution."""
        self.engine.tell(self.asked, list(costs))


def make_space(
    robot: Robot | Tree, solver: str, position_only: bool, maps: int | None = None, initial: Any = None
) -> Space:
    """Return the parameter space in which a solver is tuned: the one its class defines (`space`), or its damping and gain.

    Args:
        robot: The robot to tune for.
        solver: Name of the solver.
        position_only: Whether targets are positions.
        maps: For a state-space solver, the number of starts, each with its own gain matrices. Default: its own choice.
        initial: The configured solver that the search starts from. Default: the solver's own parameters.

    Raises:
        InvalidOption: The solver has no parameters or no maps, or cannot start from `initial`.
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
