"""Optimisers for tuning, which search the unit box: a particle swarm and CMA-ES."""

import numpy as np


class Swarm:
    """A particle swarm in the unit box, whose walls stop a particle.

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
        """Return the candidates (population, d) to be evaluated next."""
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

        options = {"bounds": [0.0, 1.0], "popsize": population, "seed": seed % 2**31 + 1, "verbose": -9}
        self.size = len(start)
        if self.size == 1:  # The package `cma` fails in one dimension, so a second one without effect is added.
            start = np.append(start, 0.5)
        self.engine = cma.CMAEvolutionStrategy(start, spread, options)

    def ask(self) -> np.ndarray:
        """Return the candidates (population, d) to be evaluated next."""
        self.asked = self.engine.ask()
        return np.array(self.asked)[:, : self.size]

    def tell(self, costs: np.ndarray) -> None:
        """Take the costs (population,) of the candidates that `ask` returned, and update the distribution."""
        self.engine.tell(self.asked, list(costs))
