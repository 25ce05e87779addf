"""Tuning of a solver: search its parameters for the fewest failures, and judge the best on targets it has not seen."""

import importlib.util
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..errors import InvalidOption, MissingExtra, UnknownSolver, check_progress, whole
from ..files import as_path, check_arrays, whole_file
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch.solve_batch import solve_batch
from ..solvers.presets import write_preset
from ..solvers.protocol import misfit
from ..solvers.registry import find_row, make_rule
from ..solvers.rows import Row
from ..solvers.solve import require_robot
from ..solvers.tuning_space import Space
from ..validate import not_negative, one_of
from .benchmark import wilson
from .engines import Evolution, Swarm, make_space
from .targets import fingerprint, sample_targets

METHODS = ("cma", "pso")
# number of held-out target sets in the final comparison if Ctrl-C ended the search; one, so that it ends soon
JUDGED_SOON = 1
FINALISTS = 8  # number of best candidates that are compared on the validation targets
# Largest number of iterations of a solve during tuning, where failures take most of the time and slow solves count as failures.
SEARCH_ITERATIONS = 300
# Each set of targets has a random stream of its own, so no target is in two sets.
TRAIN, VALIDATION, HELD_OUT = 1, 2, 3


@dataclass
class Score:
    """Success counts of a configured solver (rule) on sets of targets."""

    successes: list[int]  # number of solved targets in each set
    targets: int  # number of targets in each set
    iterations: float  # mean number of iterations of the solved targets, NaN if there are none

    @property
    def total(self) -> int:
        """Number of targets in all sets together."""
        return self.targets * len(self.successes)

    @property
    def share(self) -> float:
        """Share of all targets that were solved."""
        return sum(self.successes) / self.total

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval (low, high) of the share of solved targets."""
        return wilson(sum(self.successes), self.total)

    @property
    def rank(self) -> tuple[float, float]:
        """Return a sort key of scores: larger for a larger share of solved targets, and among equal shares for fewer iterations."""
        return self.share, -self.iterations if self.iterations == self.iterations else -math.inf

    def to_dict(self) -> dict[str, Any]:
        """Return counts, share with its interval, and iterations as numbers and lists, ready for JSON."""
        return {
            "successes": self.successes,
            "targets_a_set": self.targets,
            "share": self.share,
            "wilson_95": list(self.interval),
            "mean_iterations": self.iterations,
        }

    def __str__(self) -> str:
        """Return the successes per thousand targets, with their interval and their range over the sets."""
        low, high = self.interval
        text = f"{1000 * self.share:.1f} of 1000 [{1000 * low:.1f}, {1000 * high:.1f}]"
        if len(self.successes) > 1:
            text += f", sets of {self.targets}: {min(self.successes)} to {max(self.successes)}"
        return f"{text}, {self.iterations:.1f} iterations"


def _share(one: Score) -> str:
    return f"{1000 * one.share:.1f} of 1000, {one.iterations:.1f} iterations"


def score(robot: Robot | Tree, rule: Any, sets: Iterable[np.ndarray], **options: Any) -> Score:
    """Solve equally large sets of targets with a configured solver (rule) or a solver by name, and count the successes."""
    successes, iterations, targets = [], [], np.empty(0)
    for targets in sets:
        result = solve_batch(robot, targets, rule, check=0.0, **options)
        successes.append(int(result.success.sum()))
        iterations.append(result.iterations[result.success])
    steps = np.concatenate(iterations)
    return Score(successes, len(targets), float(steps.mean()) if len(steps) else math.nan)


@dataclass
class TuneResult:
    """Result of `tune`: the best parameters found for a solver, and how they compare on fresh targets.

    Three solvers with parameters (rules) are compared on held-out targets: the tuned one, the one that the search started from,
    and the solver's default. The default is not chosen if the options maps or initial asked for another structure.
    """

    robot: str  # name of the robot
    solver: str  # name of the solver
    method: str  # method of the search: 'cma' or 'pso'
    position_only: bool  # whether the targets are positions
    rule: Any  # the best of the three rules, for solve, Solver and solve_batch
    train: Score  # score of the tuned rule on the targets that the search used
    scores: dict[str, Score]  # scores on the held-out targets of the rules 'tuned', 'start' and 'default'
    kept: str  # name of the kept rule: 'tuned', 'start' or 'default'
    options: dict[str, Any]  # options with which the targets were solved
    history: np.ndarray  # (generations, 3) after each generation: lowest cost so far; lowest and median cost in it
    evaluations: int  # number of candidates that were evaluated
    elapsed: float  # time of the whole tuning [s]
    seed: int  # seed of the search and its targets
    interrupted: bool = False  # whether Ctrl-C ended the search, so that the rules were judged on one set only

    @property
    def held_out(self) -> Score:
        """Score of the tuned rule on the held-out targets."""
        return self.scores["tuned"]

    @property
    def before(self) -> Score:
        """Score on the held-out targets of the rule that the search started from."""
        return self.scores["start"]

    @property
    def verdict(self) -> str:
        """Sentence that says which rule is kept, and why if it is not the tuned one, or if the default is better."""
        names = {"tuned": "the tuned rule", "start": "the search's starting point", "default": "the default"}
        kept = self.scores[self.kept]
        text = f"kept: {names[self.kept]}"
        if self.kept != "tuned":
            text += f"; the tuned one is no better on held-out targets ({_share(self.held_out)} against {_share(kept)})"
        if self.scores["default"].rank > kept.rank:
            default = _share(self.scores["default"])
            text += f"; the solver's default is better ({default}), but does not have the requested structure"
        return text

    def save(self, file: str | Path) -> Path:
        """Write the rule to a file for `ik solve --preset`, PID.preset and StateSpace.preset. Returns its path."""
        kept = self.scores[self.kept]
        low, high = kept.interval
        about = {
            "robot": self.robot,
            "position": self.position_only,
            "source": f"{self.kept}: {self.method}, seed {self.seed}, {self.evaluations} evaluations; held out {kept}",
            "held_out_share": kept.share,
            "held_out_wilson_95": [low, high],
        }
        path = as_path(file, "file")
        values = {key: value for key, value in self.rule._asdict().items() if value is not None and key != "tuned"}
        write_preset(path, self.solver, values, self.options, about)
        return path

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, strings and lists."""
        names = "robot solver method position_only evaluations elapsed seed interrupted options kept verdict".split()
        default = self.scores["default"]
        scores = {"train": self.train, "held_out": self.held_out, "before": self.before, "default": default}
        return {
            **{name: getattr(self, name) for name in names},
            **{name: one.to_dict() for name, one in scores.items()},
            "history": self.history.tolist(),
        }


def tune(
    robot: Robot | Tree,
    solver: str,
    *,
    position_only: bool = True,
    method: str = "cma",
    maps: int | None = None,
    initial: Any = None,
    targets: int = 2000,
    held_out: int = 10,
    generations: int = 200,
    population: int | None = None,
    seconds: float | None = None,
    seed: int = 0,
    tolerance: float = 1e-3,
    max_iterations: int = 1000,
    how: str = "joints",
    checkpoint: str | Path | None = None,
    progress: Callable[[int, np.ndarray], None] | None = None,
) -> TuneResult:
    """Search the parameters and starts of a solver for the fewest failures; keep the parameters that are best on fresh targets.

    The cost of a candidate is its failure rate, plus a tenth of the error that failures leave (over the length scale), plus 0.02
    times mean iterations / max_iterations. A seed gives the same result again, unless `seconds` or Ctrl-C ends the search.

    Args:
        robot: The robot. All tips of a Tree are solved together, and the error of a target is the largest of them.
        solver: Name of the solver.
        position_only: Tune for positions instead of poses.
        method: 'cma' (CMA-ES) or 'pso' (particle swarm).
        maps: Number of starts of a state-space solver (default: its own); each has its own gains. With 1, the published structure
            is tuned: a, B and the start (C is fixed without loss). With more, the starts are tuned, and their gains are designed.
        initial: The configured solver to start from. A state-space solver keeps its structure (a, B, C, literal delay); with
            several starts, each B is searched between the given one and the one designed for its start.
        targets: Number of training targets.
        held_out: Number of sets of 1000 fresh targets for the final score.
        generations: Highest number of generations.
        population: Number of candidates in a generation. Default: by the number of parameters.
        seconds: Time [s] after which no further generation begins.
        seed: Seed of the search and of all targets.
        tolerance: Tolerance of a solve [m and rad].
        max_iterations: Highest number of iterations of a solve.
        how: How targets are drawn, 'joints' or 'volume', see `sample_targets`.
        checkpoint: File of the candidates evaluated so far; if it exists, the search continues from there.
        progress: Called as progress(generation, costs) after each generation.

    Returns:
        The best solver found (rule) and all scores.

    Raises:
        InvalidOption: An option is out of range, or the checkpoint is that of another search.
        UnknownSolver: There is no such solver, or it does not fit the robot.
        MissingExtra: The package `cma` is not installed.
    """
    row, default = _tunable(robot, solver, method)
    seed, generations = whole(seed, "seed", 0), whole(generations, "generations", 0)
    held_out, max_iterations = whole(held_out, "held_out"), whole(max_iterations, "max_iterations")
    seconds = None if seconds is None else not_negative(seconds, "seconds")
    check_progress(progress, "a generation and its costs")
    as_asked = maps is not None or initial is not None
    space = make_space(robot, row.name, position_only, maps, initial)
    options = {"tolerance": tolerance, "max_iterations": max_iterations}
    size = 4 + 2 * int(3 * math.log(space.size)) if population is None else whole(population, "population", 2)

    def draw(stream: int, count: int, k: int = 0) -> np.ndarray:
        return sample_targets(robot, count, [seed, stream, k], how=how, position_only=position_only)

    train = draw(TRAIN, targets)
    begun = perf_counter()
    search = _Search(robot, space, train, {**options, "max_iterations": min(max_iterations, SEARCH_ITERATIONS)})
    what = f"{'positions' if position_only else 'poses'} {how} {targets} {seed} {options}"
    task = f"{robot.name} {robot.base} {'+'.join(robot.tips)} {what} {fingerprint(robot, *(initial or ()))[:16]}"
    record = _Record(checkpoint, f"{row.name} {method} {space.size} {size} {task}")
    engine = (Evolution if method == "cma" else Swarm)(space.start, space.spread, size, seed)
    interrupted = False
    rule: Any = None
    rules = {"tuned": rule, "start": space.initial, "default": default}

    def judge(count: int) -> tuple[Score, dict[str, Score], str]:
        rules["tuned"] = rule
        sets = ((draw(HELD_OUT, 1000, k) for k in range(count)) for _ in rules)  # each set is drawn when it is needed
        scores = {name: score(robot, one, next(sets), **options) for name, one in rules.items()}
        best = max((name for name in rules if not (as_asked and name == "default")), key=lambda name: scores[name].rank)
        return score(robot, rule, [train], **options), scores, best

    try:
        search.run(engine, record, generations, seconds, progress)
        validation = draw(VALIDATION, 2 * targets)
        judged = [(search.cost(x, validation), k, x) for k, (_, x) in enumerate(search.best)]
        rule = space.build(min(judged)[2])
        train_score, scores, kept = judge(held_out)
    except KeyboardInterrupt:
        interrupted = True
        if not search.best:
            raise
        rule = rule or space.build(search.best[0][1])
        train_score, scores, kept = judge(JUDGED_SOON)
    rule = rules[kept]
    return TuneResult(
        robot=robot.name,
        solver=row.name,
        method=method,
        position_only=position_only,
        rule=rule._replace(tuned=options) if "tuned" in rule._fields else rule,
        train=train_score,
        scores=scores,
        kept=kept,
        options=options,
        history=np.array(search.history).reshape(-1, 3),
        evaluations=len(search.history) * size,
        elapsed=perf_counter() - begun,
        seed=seed,
        interrupted=interrupted,
    )


def _tunable(robot: Any, solver: str, method: str) -> tuple[Row, Any]:
    """Return the registry entry and the default parameters (rule) of a solver that can be tuned.

    Raises UnknownSolver, InvalidOption or MissingExtra as `tune` does.
    """
    require_robot(robot)
    if one_of(method, METHODS, "tuning method") == "cma" and importlib.util.find_spec("cma") is None:
        raise MissingExtra("cma", "tune")
    row = find_row(solver)
    default = make_rule(row, {})
    if reason := misfit(row, default, robot):
        raise UnknownSolver(reason)
    return row, default


class _Search:
    """A search in progress: the best candidates so far, and the costs of each generation."""

    def __init__(self, robot: Robot | Tree, space: Space, train: np.ndarray, options: dict[str, Any]) -> None:
        self.robot, self.space, self.train, self.options = robot, space, train, options
        self.best: list[tuple[float, np.ndarray]] = []
        self.history: list[tuple[float, float, float]] = []

    def run(
        self,
        engine: Any,
        record: "_Record",
        generations: int,
        seconds: float | None,
        progress: Callable[[int, np.ndarray], None] | None,
    ) -> None:
        """Search until the highest number of generations or seconds is reached."""
        begun = perf_counter()
        for generation in range(generations):
            if seconds is not None and perf_counter() - begun > seconds:
                break
            costs = self.generation(engine, record)
            if progress is not None:
                progress(generation + 1, costs)
        if not self.best:  # Before the first generation, the start is the best candidate.
            self.note(self.space.start[None], np.array([self.cost(self.space.start)]))

    def generation(self, engine: Any, record: "_Record") -> np.ndarray:
        """Return the costs of the optimiser's next generation of candidates, from the checkpoint file if that has them."""
        X = engine.ask()
        costs = record.replay(len(self.history), X)
        if costs is None:
            costs = np.array([self.cost(x) for x in X])
            record.add(X, costs)
        self.note(X, costs)
        engine.tell(costs)
        self.history.append((self.best[0][0], float(costs.min()), float(np.median(costs))))
        return costs

    def cost(self, x: np.ndarray, targets: np.ndarray | None = None) -> float:
        targets = self.train if targets is None else targets
        result = solve_batch(self.robot, targets, self.space.build(x), check=0.0, **self.options)
        failed = ~result.success
        scale = self.robot.chain.scale
        off = np.minimum(result.position_error[failed] / scale + (0 if result.position_only else 0.3), 1.0)
        steps = result.iterations[result.success].mean() if result.success.any() else self.options["max_iterations"]
        return (failed.sum() + 0.1 * off.sum()) / len(targets) + 0.02 * float(steps) / self.options["max_iterations"]

    def note(self, X: np.ndarray, costs: np.ndarray) -> None:
        found = [*self.best, *((float(c), x.copy()) for c, x in zip(costs, X, strict=True))]
        self.best = sorted(found, key=lambda pair: pair[0])[:FINALISTS]


def check_record(file: Path) -> None:
    """Raise InvalidOption unless the content of a file is the checkpoint of a tuning search."""
    _Record.read(file)


class _Record:
    """The costs of every generation, kept in a file; a resumed search that proposes the same candidates reads them from there."""

    def __init__(self, file: str | Path | None, key: str) -> None:
        self.file, self.key = None if file is None else as_path(file, "checkpoint"), key
        self.done: list[tuple[np.ndarray, np.ndarray]] = []  # the first candidate and all costs of each generation
        if self.file is not None and self.file.exists():
            known, self.done = self.read(self.file)
            if known != key:
                raise InvalidOption(f"{file} belongs to another search: {known}")

    @staticmethod
    def read(file: Path) -> tuple[str, list[tuple[np.ndarray, np.ndarray]]]:
        try:
            check_arrays(file, ("key", "first", "costs"), ("key",), InvalidOption)
            with np.load(file) as old:
                key, first, costs = (old[name] for name in ("key", "first", "costs"))
            if first.ndim != 2 or costs.ndim != 2 or not np.isfinite(costs).all():
                raise ValueError
            return str(key), list(zip(first, costs, strict=True))
        except Exception:  # Damaged files raise errors of many types (zip, zlib, npy).
            raise InvalidOption(f"{file} is not the record of a search: move it, or choose another file") from None

    def replay(self, generation: int, X: np.ndarray) -> np.ndarray | None:
        if generation >= len(self.done):
            return None
        first, costs = self.done[generation]
        if first.shape != X[0].shape or len(costs) != len(X) or not np.allclose(X[0], first, atol=1e-9):
            raise InvalidOption(f"{self.file} cannot be continued: the optimiser proposes other candidates; delete it")
        return costs

    def add(self, X: np.ndarray, costs: np.ndarray) -> None:
        self.done.append((X[0].copy(), costs.copy()))
        if self.file is not None:
            first, every = zip(*self.done, strict=True)
            with whole_file(self.file) as out:
                np.savez(out, key=self.key, first=np.array(first), costs=np.array(every))
