"""What a robot reaches, cell by cell: reached (with a configuration), out of reach (with a proof), or no configuration found.

A few solver attempts per cell find most configurations. In a grid, those of neighbouring cells are then tried as starts, and many
attempts are made only where a cell without a solution touches a reached one. If a closed form or an algebraic elimination decides
every cell, one pass is enough.
"""

import json
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ..errors import IKError, Interrupted, InvalidOption, check_progress, whole
from ..files import PARTIAL, as_output, require_place
from ..kernel.counted_error import KIND
from ..robot.geometry.collision import CollisionModel
from ..robot.robot import Robot
from ..robot.rotation import angles_between
from ..robot.tree import require_one_tip
from ..solvers.batch.result import BatchResult
from ..solvers.batch.solve_batch import solve_parts
from ..solvers.collision_free import collision_model
from ..solvers.decide import Deciding
from ..solvers.options import BatchOptions, Options
from ..solvers.plan import Plan
from ..solvers.solve import Solver
from .reachability_grid import EFFORT, Grid, grid_of, require_memory
from .reachability_map import Audit, Log, Reach, ReachabilityMap
from .targets import fingerprint


class ReachabilityInterrupted(Interrupted):
    """Ctrl-C during a study of reachability; `result` is the ReachabilityMap of what was finished before it."""


class MapNotSaved(IKError):
    """The map was computed, but its file could not be written; `result` is the ReachabilityMap."""

    def __init__(self, result: ReachabilityMap, error: OSError) -> None:
        """Keep the map and the error that occurred while it was written."""
        super().__init__(f"{error.strerror or error}: {error.filename}; the map is in the error's `result`")
        self.result = result


def require_reaching(options: Options, what: str) -> None:
    """Raise InvalidOption for solver options that make no sense here: those about a start, and orientation before position."""
    for name in ("closest", "follow"):
        if getattr(options, name):
            raise InvalidOption(f"{name} is about the start of one solve, and {what} chooses the starts; omit {name}")
    if options.priority is not None and all(group == "orientation" for _, group in options.priority[0]):
        raise InvalidOption(
            f"{what} is about poses that are reached; with the orientation first the position is not kept"
        )


def decides(plan: Plan) -> bool:
    """Return whether a plan's solver decides every target (finds a solution or proves there is none), so one attempt is enough."""
    return plan.row.closed or isinstance(plan, Deciding)


def reachability(
    robot: Robot,
    region: Any = None,
    *,
    resolution: float | None = None,
    orientations: Any = "any",
    audit: int | str = 2000,
    threads: int | None = None,
    executor: Executor | None = None,
    check: float = 0.01,
    file: str | Path | None = None,
    progress: Callable[[int], None] | None = None,
    **options: Unpack[BatchOptions],
) -> ReachabilityMap:
    """Compute, for every cell of a region, whether the tip reaches it inside the limits.

    A yes comes with a configuration that was checked. A no is proven (by a bound, a closed form or a certificate), or it is
    unproven because no attempt found a configuration. The audit tries a sample of the unproven answers again, and estimates how
    often they are wrong.

    Args:
        robot: The Robot.
        region: Lower and upper corner of a box, (3,) each [m] in the base frame; by default the box around the reach. Corners that
            agree in a coordinate make a plane. Or single poses (N, 4, 4), without a grid.
        resolution: Width of a cell [m], by default a fortieth of the longest side. A cell is answered at its centre.
        orientations: 'any' leaves the orientation free; a number K asks for K directions of the tool axis (the tip's z, or
            `free_turn`), spread evenly, about which the tip may turn; rotations (K, 3, 3) or poses (K, 4, 4) are asked for exactly.
        audit: How many of the unproven answers are tried again with 1,000 attempts; 'full' for all.
        threads: As for `solve_batch`.
        executor: As for `solve_batch`.
        check: Share of the yeses that Pinocchio verifies; all yeses to positions and poses are checked by forward kinematics.
        file: An .npz file for the map. Until it is complete, finished parts are in NAME.partial, also if the process is killed; the
            same call then continues from there.
        progress: Called as progress(done) with the number of answers computed so far.
        **options: As for `solve_batch`, but for closest, follow and restarts: tolerances, seed, limits, avoid_collisions, priority,
            free_turn, ...; with `priority`, yes means that the solver's status is CONVERGED.

    Returns:
        The map.

    Raises:
        InvalidOption, InvalidTarget: An argument is wrong, or the map would not fit into memory.
        ReachabilityInterrupted: Ctrl-C, as a KeyboardInterrupt; its `result` has what was finished.
        MapNotSaved: The file cannot be written, as on a full disk; its `result` is the map.
        BatchCheckFailed: As for `solve_batch`.
    """
    require_one_tip(robot, "reachability")
    check_progress(progress, "the number of answers tried")
    if "restarts" in options:
        raise InvalidOption("reachability chooses the number of attempts; omit restarts, and see audit=")
    if "solver" in options:
        raise InvalidOption("reachability chooses the solver; omit solver")
    grid = grid_of(robot, region, resolution, orientations)
    if grid.free:
        options.setdefault("free_turn", "z")
    full = isinstance(audit, str) and audit == "full"
    tried_again = grid.answers if full else whole(audit, "audit (or 'full')", 0)
    require_memory(grid, robot.n)
    solver = Solver(robot, "auto", **options)
    plan = solver.plan_for((KIND.position if grid.rotations is None and grid.poses is None else KIND.pose,))
    require_reaching(plan.options, "reachability")
    # If the options narrow the limits, the solver works on a copy of the robot with the narrower limits.
    whole_robot, robot = robot, solver.robot  # pyright: ignore[reportAssignmentType]
    if grid.free or robot is not whole_robot:
        grid = grid_of(robot, region, resolution, orientations, plan.options.free_turn if grid.free else None)
    asked = {
        key: value if isinstance(value, int | float | str | bool) else repr(value) for key, value in options.items()
    }
    said = json.dumps(asked, sort_keys=True)
    log = None
    if file is not None:
        file = as_output(file, "a map", ".npz")
        require_place(file)
        avoided = plan.options.avoid_collisions
        world = None if avoided is False else collision_model(robot, avoided)
        log = Log(file.with_name(file.name + PARTIAL), _question(robot, grid, said, world))
    work = {"threads": threads, "executor": executor, "check": check, **options}
    study = _Study(robot, grid, plan, work, log, progress)
    audited = None
    try:
        study.search()
        audited = study.audit(tried_again, plan.options.seed)
    except KeyboardInterrupt:
        if not (tried := int((study.states != Reach.UNTRIED).sum())):
            raise
        done = f"after {tried:,} of {study.states.size:,} answers"
        raise ReachabilityInterrupted(study.result(audited, said), done) from None
    finally:
        if log is not None:
            log.close(False)
    found = study.result(audited, said)
    if log is not None and file is not None:
        try:
            found.save(file)
        except OSError as error:
            raise MapNotSaved(found, error) from None
        log.close(True)
    return found


def _question(robot: Robot, grid: Grid, options: str, world: CollisionModel | None) -> str:
    """Return a text that identifies a study, to recognise the file of an earlier run."""
    of = "" if world is None else world.contents()
    mark = fingerprint(robot, grid.low, grid.size, grid.rotations, grid.poses, of)
    about = [robot.name, robot.tip, robot.base, list(grid.shape), options, mark]
    return json.dumps(about)


class _Study:
    """The answers of a study so far, and the passes over the cells that find them."""

    def __init__(
        self,
        robot: Robot,
        grid: Grid,
        plan: Plan,
        work: dict[str, Any],
        log: Log | None,
        progress: Callable[[int], None] | None,
    ) -> None:
        self.robot, self.grid, self.plan, self.work, self.log, self.progress = robot, grid, plan, work, log, progress
        self.states = np.zeros(grid.answers, np.int8)
        self.q = np.full((grid.answers, robot.n), np.nan)
        for rows, states, q in log.entries if log is not None else ():
            self.states[rows] = states
            self.q[rows[states == Reach.YES]] = q

    def search(self) -> None:
        """Compute whether each cell is reached in each orientation, and write finished parts to the file."""
        rest = np.flatnonzero(self.states == Reach.UNTRIED)
        if decides(self.plan):
            self.solve(rest, Reach.MANY)
        elif self.grid.poses is not None:
            self.solve(rest, Reach.MANY, restarts=EFFORT.many - 1)
        else:
            self.solve(rest, Reach.FEW, restarts=EFFORT.few - 1)
            tried = np.zeros((*self.grid.shape, self.grid.turns), np.uint8)
            self.flood(tried)
            rng = np.random.default_rng(self.plan.options.seed)
            while len(rows := self.open_beside_yes()):
                # All targets of one call get the same random starts. The cells are shuffled into groups, so that neighbours mostly
                # get different starts; then `flood` lets each try its neighbours' solutions as starts.
                for k, some in enumerate(np.array_split(rng.permutation(rows), EFFORT.groups), 1):
                    self.solve(np.sort(some), Reach.MANY, restarts=EFFORT.many - 1, seed=self.plan.options.seed + k)
                self.flood(tried)

    def open_beside_yes(self) -> np.ndarray:
        """Return the indices of undecided answers (cell and orientation) beside a cell that is reached in the same orientation."""
        near = (self.states == Reach.YES).reshape(*self.grid.shape, self.grid.turns)
        for axis in range(3):
            one = np.moveaxis(near, axis, 0)
            before = one.copy()
            one[1:] |= before[:-1]
            one[:-1] |= before[1:]
        return np.flatnonzero(near.ravel() & (self.states == Reach.FEW))

    def solve(self, rows: np.ndarray, failed: int, q0: np.ndarray | None = None, **more: Any) -> int:
        """Solve the targets of some answers (indices `rows` (m,)), from q0 (m, n) if given, and store what is found.

        Those with neither a solution nor a proof get the state `failed`. Returns the number of targets that are newly reached.
        """
        yes = 0
        for a in range(0, len(rows), EFFORT.chunk):
            end = min(a + EFFORT.chunk, len(rows))
            done = a
            start = None if q0 is None else q0[a:end]
            asked = {**self.work, **more}
            for part in solve_parts(self.robot, self.grid.targets(rows[a:end]), q0=start, finish=False, **asked):
                yes += self.take(rows[done : done + len(part)], part, failed)
                done += len(part)
                if self.progress is not None:
                    self.progress(int((self.states != Reach.UNTRIED).sum()))
        return yes

    def take(self, rows: np.ndarray, batch: BatchResult, failed: int) -> int:
        """Store the results of a batch as answers (indices `rows` (m,)); a known yes stays so. Return the number of yes."""
        good = batch.success & self.inside(rows, batch)
        left = np.where(batch.proven, Reach.NO, np.maximum(self.states[rows], failed))
        states = np.where(good, Reach.YES, left).astype(np.int8)
        changed = states != self.states[rows]
        self.states[rows] = states
        self.q[rows[good]] = batch.q[good]
        if self.log is not None and changed.any():
            self.log.add(rows[changed], states[changed], batch.q[good & changed])
        return int(good.sum())

    def inside(self, rows: np.ndarray, batch: BatchResult) -> np.ndarray:
        """Check solutions by forward kinematics; return which (m,) are within the limits and the tolerances."""
        robot, o, q = self.robot, self.plan.options, batch.q
        good = ((q >= robot.lower) & (q <= robot.upper)).all(axis=1) if o.limits is True else np.ones(len(q), bool)
        if o.in_part or o.priority is not None:
            return good
        T, P = self.grid.targets(rows), robot.chain.forward(q)[0]
        at = T if T.ndim == 2 else T[:, :3, 3]
        good &= np.linalg.norm(P[:, :3, 3] - at, axis=1) <= o.position_tolerance * (1.0 + 1e-6) + 1e-9
        if T.ndim == 3:
            left = angles_between(P[:, :3, :3], T[:, :3, :3])
            good &= left <= o.orientation_tolerance * (1.0 + 1e-6) + 1e-8
        return good

    def flood(self, tried: np.ndarray) -> None:
        """Solve unreached targets again, starting at solutions of neighbouring cells, until no more are found.

        tried: (nx, ny, nz, K) bits, one for each of the six neighbours whose configuration has been tried as a start.
        """
        open_, found = (Reach.FEW, Reach.MANY), 1
        flat, shape = tried.reshape(-1), tried.shape
        steps = [(axis, step) for axis in range(3) if shape[axis] > 1 for step in (1, -1)]
        while found:
            found = 0
            for bit, (axis, step) in enumerate(steps):
                yes = (self.states == Reach.YES).reshape(shape)
                beside = np.zeros(shape, bool)
                ahead, behind = [slice(None)] * 4, [slice(None)] * 4
                parts = slice(1, None), slice(None, -1)
                ahead[axis], behind[axis] = parts if step > 0 else parts[::-1]
                beside[tuple(ahead)] = yes[tuple(behind)]
                new = beside.ravel() & np.isin(self.states, open_) & (flat >> bit & 1 == 0)
                rows = np.flatnonzero(new)
                flat[rows] |= 1 << bit
                stride = step * int(np.prod(shape[axis + 1 :]))
                if len(rows):
                    found += self.solve(rows, Reach.FEW, self.q[rows - stride], restarts=0)

    def audit(self, count: int, seed: int) -> Audit:
        """Search again for a random sample of the targets that were not reached but not proven unreachable; correct those found."""
        left = np.flatnonzero((self.states == Reach.FEW) | (self.states == Reach.MANY))
        rows = np.sort(np.random.default_rng(seed).permutation(left)[:count])
        found = 0
        for a in range(0, len(rows), 256):  # in small parts, so that Ctrl-C loses little
            found += self.solve(rows[a : a + 256], Reach.MANY, restarts=EFFORT.audited - 1, seed=seed + 1)
        return Audit(len(left), len(rows), found, EFFORT.audited)

    def result(self, audit: Audit | None, options: str) -> ReachabilityMap:
        """Return the ReachabilityMap of the answers computed so far."""
        audit = Audit(int((self.states >= Reach.FEW).sum())) if audit is None else audit
        grid, robot = self.grid, self.robot
        K, cells = grid.turns, grid.cells
        best, margin, q = np.zeros(cells, np.float32), np.zeros(cells, np.float32), np.full((cells, robot.n), np.nan)
        measure = quality(robot, position_only=grid.rotations is None and grid.poses is None)
        for a in range(0, cells, max(EFFORT.chunk // K, 1)):
            some = slice(a, a + max(EFFORT.chunk // K, 1))
            yes = (self.states == Reach.YES).reshape(cells, K)[some]
            values = np.full((2, *yes.shape), -1.0)
            values[:, yes] = measure(self.q.reshape(cells, K, robot.n)[some][yes])
            pick = values[0].argmax(axis=1)
            any_yes = yes.any(axis=1)
            best[some], margin[some] = np.where(any_yes, values.max(axis=2), 0.0)
            q[some][any_yes] = self.q.reshape(cells, K, robot.n)[some][any_yes, pick[any_yes]]
        states = self.states.reshape(cells, K)
        return ReachabilityMap(
            robot.name, robot.tip, robot.base, robot.joint_names, grid, states, best, margin, q, audit, options
        )


def quality(robot: Robot, position_only: bool) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that computes for configurations (N, n) their manipulability and their margin to the joint limits (2, N).

    Manipulability is the product of the k largest singular values, where k is the rank of the Jacobian at random configurations
    (Yoshikawa 1985; k allows for arms that cannot move in all directions).
    """
    rows = 3 if position_only else 6
    J = robot.chain.forward(robot.random_q(np.random.default_rng(0), 32), True)[1][:, :rows]
    rank = int(np.linalg.matrix_rank(J, tol=1e-9 * float(np.abs(J).max())).max())
    half = 0.5 * (robot.upper - robot.lower)
    bounded = np.isfinite(half) & (half > 0.0)

    def of(q: np.ndarray) -> np.ndarray:
        J = robot.chain.forward(q, True)[1][:, :rows] if len(q) else np.zeros((0, rows, robot.n))
        if rank in (rows, robot.n):
            square = J @ J.swapaxes(1, 2) if rank == rows else J.swapaxes(1, 2) @ J
            size = np.sqrt(np.maximum(np.linalg.det(square), 0.0))
        else:
            size = np.prod(np.linalg.svd(J, compute_uv=False)[:, :rank], axis=1)
        if not bounded.any():
            return np.array([size, np.ones(len(q))])
        room = np.minimum(q - robot.lower, robot.upper - q)[:, bounded] / half[bounded]
        return np.array([size, np.clip(room.min(axis=1), 0.0, 1.0)])

    return of
