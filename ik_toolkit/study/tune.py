"""Tuning: search a solver's parameters for the fewest failures and judge the best on held-out targets."""

import importlib.util
import math
import zipfile
from collections.abc import Callable
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
from ..solvers.registry import Row, find_row, make_rule
from ..solvers.solve import require_robot
from ..solvers.tuning_space import Space
from ..validate import number, one_of
from .engines import Evolution, Swarm
from .spaces import make_space
from .statistics import wilson
from .targets import sample_targets

METHODS = ("cma", "pso")
JUDGED_SOON = 1  # held-out sets after Ctrl-C, which must not take long
FINALISTS = 8  # best candidates of the search, compared on the validation targets
# Limit while searching: failures cost most of the time, and slow solves should count as failures.
SEARCH_ITERATIONS = 300
TRAIN, VALIDATION, HELD_OUT = 1, 2, 3  # random streams: the three sets never share a target


@dataclass
class Score:
    """Success rate: successes per set of targets, overall with a 95 % Wilson interval, and mean iterations of solved targets."""

    successes: list[int]
    targets: int
    iterations: float

    @property
    def total(self) -> int:
        """Number of targets in all sets."""
        return self.targets * len(self.successes)

    @property
    def share(self) -> float:
        """Successes over targets."""
        return sum(self.successes) / self.total

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson interval of the share."""
        return wilson(sum(self.successes), self.total)

    @property
    def rank(self) -> tuple[float, float]:
        """Larger is better: the share, then fewer iterations."""
        return self.share, -self.iterations if self.iterations == self.iterations else -math.inf

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "successes": self.successes,
            "targets_a_set": self.targets,
            "share": self.share,
            "wilson_95": list(self.interval),
            "mean_iterations": self.iterations,
        }

    def __str__(self) -> str:
        """Per thousand, with interval and range over the sets."""
        low, high = self.interval
        text = f"{1000 * self.share:.1f} of 1000 [{1000 * low:.1f}, {1000 * high:.1f}]"
        if len(self.successes) > 1:
            text += f", sets of {self.targets}: {min(self.successes)} to {max(self.successes)}"
        return f"{text}, {self.iterations:.1f} iterations"


def _share(one: Score) -> str:
    return f"{1000 * one.share:.1f} of 1000, {one.iterations:.1f} iterations"


def score(robot: Robot | Tree, rule: Any, sets: list[np.ndarray], **options: Any) -> Score:
    """Solve equally large sets of targets with a rule or solver name, and count successes."""
    successes, iterations = [], []
    for targets in sets:
        result = solve_batch(robot, targets, rule, check=0.0, **options)
        successes.append(int(result.success.sum()))
        iterations.append(result.iterations[result.success])
    steps = np.concatenate(iterations)
    return Score(successes, len(sets[0]), float(steps.mean()) if len(steps) else math.nan)


@dataclass
class TuneResult:
    """What `tune` found.

    rule: the best on held-out targets (pass it to solve, Solver, solve_batch) of the `tuned` one, the `start` of the search and the
    solver's `default`; kept names it. The default is not eligible if maps= or initial= asked for another structure. scores: Score
    on the held-out targets, by those names. train, held_out, before: Score of the tuned rule on the training and on the held-out
    targets, and of the start on the latter. history: best cost so far, best and median of each generation. interrupted: stopped by
    Ctrl-C and judged on one set only.
    """

    robot: str
    solver: str
    method: str
    position_only: bool
    rule: Any
    train: Score
    scores: dict[str, Score]
    kept: str
    options: dict[str, Any]
    history: np.ndarray
    evaluations: int
    elapsed: float
    seed: int
    interrupted: bool = False

    @property
    def held_out(self) -> Score:
        """Score of the tuned rule on the held-out targets."""
        return self.scores["tuned"]

    @property
    def before(self) -> Score:
        """Score of the rule the search started from, on the same targets."""
        return self.scores["start"]

    @property
    def verdict(self) -> str:
        """One sentence: which rule is kept, and why if it is not the tuned one or the default is better."""
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
        """Write the preset that `ik solve --preset FILE` and `preset(FILE)` read."""
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
        """Plain values."""
        scores = {
            "train": self.train,
            "held_out": self.held_out,
            "before": self.before,
            "default": self.scores["default"],
        }
        names = (
            "robot",
            "solver",
            "method",
            "position_only",
            "evaluations",
            "elapsed",
            "seed",
            "interrupted",
            "options",
            "kept",
            "verdict",
        )
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
    """Search parameters and start configurations of a solver with CMA-ES or a particle swarm.

    robot: for a Tree, all tips are solved together; a target then has one pose per tip, and its errors are the largest of them.
    maps: for a solver with maps, the number of starts (default: its own); 1 tunes the published structure (a, B, start; C fixed,
    without loss), more tunes starts whose maps are designed. initial: the rule to start from; one with maps keeps its structure
    (a, B, C, literal delay), and with several starts each B is searched between the given one and its own. targets: training
    targets; held_out: number of sets of 1000 fresh targets for the final score. Cost of a candidate: failure rate, plus a tenth
    of the remaining error (over the length scale), plus 0.02 mean iterations / max_iterations. seconds: stop the search after
    this time. checkpoint: file with the candidates evaluated so far; if it exists, the search continues from there.
    progress(generation, costs). The tuned rule, the start and the solver's default are compared on the held-out targets, and
    the best is kept. Ctrl-C keeps the best so far. Deterministic for a given seed (unless `seconds` ends it). Raises
    InvalidOption, UnknownSolver, MissingExtra.
    """
    row, default = _tunable(robot, solver, method)
    seed, generations = whole(seed, "seed", 0), whole(generations, "generations", 0)
    held_out, max_iterations = whole(held_out, "held_out"), whole(max_iterations, "max_iterations")
    seconds = None if seconds is None else number(seconds, "seconds")
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
    what = "positions" if position_only else "poses"
    task = f"{robot.name} {robot.base} {'+'.join(robot.tips)} {what} {how} {targets} {seed} {options}"
    record = _Record(checkpoint, f"{row.name} {method} {space.size} {size} {task}")
    engine = (Evolution if method == "cma" else Swarm)(space.start, space.spread, size, seed)
    interrupted = False
    rule: Any = None
    rules = {"tuned": rule, "start": space.initial, "default": default}
    fresh = [draw(HELD_OUT, 1000, k) for k in range(held_out)]

    def judge(sets: list[np.ndarray]) -> tuple[Score, dict[str, Score], str]:
        rules["tuned"] = rule
        scores = {name: score(robot, one, sets, **options) for name, one in rules.items()}
        best = max((name for name in rules if not (as_asked and name == "default")), key=lambda name: scores[name].rank)
        return score(robot, rule, [train], **options), scores, best

    try:
        search.run(engine, record, generations, seconds, progress)
        validation = draw(VALIDATION, 2 * targets)
        judged = [(search.cost(x, validation), k, x) for k, (_, x) in enumerate(search.best)]
        rule = space.build(min(judged)[2])
        train_score, scores, kept = judge(fresh)
    except KeyboardInterrupt:
        interrupted = True
        if not search.best:
            raise
        rule = rule or space.build(search.best[0][1])
        train_score, scores, kept = judge(fresh[:JUDGED_SOON])
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
    """Row and default rule of a solver to be tuned. Raises InvalidOption, UnknownSolver, MissingExtra."""
    require_robot(robot)
    if one_of(method, METHODS, "tuning method") == "cma" and importlib.util.find_spec("cma") is None:
        raise MissingExtra("cma", "tune")
    row = find_row(solver)
    default = make_rule(row, {})
    if reason := misfit(row, default, robot):
        raise UnknownSolver(reason)
    return row, default


class _Search:
    """Cost of candidates and the best of them; history: one row per generation, see TuneResult."""

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
        """Search for a number of generations or seconds; sets the best candidate."""
        begun = perf_counter()
        for generation in range(generations):
            if seconds is not None and perf_counter() - begun > seconds:
                break
            costs = self.generation(engine, record)
            if progress is not None:
                progress(generation + 1, costs)
        if not self.best:  # no generation was requested, or there was no time for one
            self.note(self.space.start[None], np.array([self.cost(self.space.start)]))

    def generation(self, engine: Any, record: "_Record") -> np.ndarray:
        """Costs of the engine's next candidates, from the record if they are known."""
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
    """Raise InvalidOption if a file is not the record of a search."""
    _Record.read(file)


class _Record:
    """Costs of every generation, on disk; a resumed search replays them if its first candidates are the same."""

    def __init__(self, file: str | Path | None, key: str) -> None:
        self.file, self.key = None if file is None else as_path(file, "checkpoint"), key
        self.first: list[np.ndarray] = []
        self.costs: list[np.ndarray] = []
        if self.file is not None and self.file.exists():
            known, self.first, self.costs = self.read(self.file)
            if known != key:
                raise InvalidOption(f"{file} belongs to another search: {known}")

    @staticmethod
    def read(file: Path) -> tuple[str, list[np.ndarray], list[np.ndarray]]:
        try:
            check_arrays(file, ("key", "first", "costs"), ("key",), InvalidOption)
            with np.load(file) as old:
                return str(old["key"]), list(old["first"]), list(old["costs"])
        except (OSError, ValueError, KeyError, EOFError, AttributeError, TypeError, zipfile.BadZipFile):
            raise InvalidOption(f"{file} is not the record of a search: move it, or choose another file") from None

    def replay(self, generation: int, X: np.ndarray) -> np.ndarray | None:
        if generation >= len(self.costs):
            return None
        if not np.allclose(X[0], self.first[generation], atol=1e-9):
            raise InvalidOption(
                f"{self.file} cannot be continued: the optimiser now proposes other candidates; delete it"
            )
        return self.costs[generation]

    def add(self, X: np.ndarray, costs: np.ndarray) -> None:
        self.first.append(X[0].copy())
        self.costs.append(costs.copy())
        if self.file is not None:
            with whole_file(self.file) as out:
                np.savez(out, key=self.key, first=np.array(self.first), costs=np.array(self.costs))
