"""Optimisers for tuning: a particle swarm and CMA-ES, both in the unit box."""

import numpy as np


class Swarm:
    """Particle swarm in the unit box, inertia 0.729, both accelerations 1.494 (Clerc and Kennedy 2002); walls stop a particle."""

    def __init__(self, start: np.ndarray, spread: float, population: int, seed: int) -> None:
        """Place the particles around `start`; the first one is `start` itself."""
        self.rng = np.random.default_rng(seed)
        self.x = np.clip(start + spread * self.rng.standard_normal((population, len(start))), 0.0, 1.0)
        self.x[0] = start
        self.v = spread * self.rng.uniform(-1.0, 1.0, self.x.shape)
        self.own = self.x.copy()
        self.cost = np.full(population, np.inf)

    def ask(self) -> np.ndarray:
        """Candidates (population, d)."""
        return self.x

    def tell(self, costs: np.ndarray) -> None:
        """Update the swarm with the costs."""
        better = costs < self.cost
        self.own[better], self.cost[better] = self.x[better], costs[better]
        leader = self.own[np.argmin(self.cost)]
        a, b = self.rng.random((2, *self.x.shape))
        self.v = 0.729 * self.v + 1.494 * (a * (self.own - self.x) + b * (leader - self.x))
        moved = np.clip(self.x + self.v, 0.0, 1.0)
        self.v[moved != self.x + self.v] = 0.0
        self.x = moved


class Evolution:
    """CMA-ES of the `cma` package in the unit box (Hansen 2016)."""

    def __init__(self, start: np.ndarray, spread: float, population: int, seed: int) -> None:
        """Start at `start` with standard deviation `spread`."""
        import cma

        options = {"bounds": [0.0, 1.0], "popsize": population, "seed": seed % 2**31 + 1, "verbose": -9}
        self.size = len(start)
        if self.size == 1:  # the package fails on one dimension: an idle second one
            start = np.append(start, 0.5)
        self.engine = cma.CMAEvolutionStrategy(start, spread, options)

    def ask(self) -> np.ndarray:
        """Candidates (population, d)."""
        self.asked = self.engine.ask()
        return np.array(self.asked)[:, : self.size]

    def tell(self, costs: np.ndarray) -> None:
        """Update the distribution with the costs."""
        self.engine.tell(self.asked, list(costs))
