"""Solving for several tips at once: `ik.solve` and `ik.Solver` of a Tree."""

from time import perf_counter
from typing import Any

import numpy as np

from ..errors import InvalidOption, UnknownSolver
from ..kernel.chain import without_limits, without_wrap
from ..kernel.checks import BAD_TARGET
from ..kernel.records import ANSWER, AT, MISS, Miss
from ..kernel.search import entry
from ..kernel.task import FREE, POSE, POSITION
from ..robot.tree import Tree
from .registry import GENERAL, find_row
from .result import Result, Status, sentence
from .solve import Solver, is_auto
from .starts import held_joints
from .task import counted_errors, read_target


class TreeResult(Result):
    """Answer of a solve for several tips.

    As Result, where position_error [m] and orientation_error [rad] are the largest over the tips (None when every target
    leaves orientation free); position_errors and orientation_errors are dicts by tip.
    """

    __slots__ = ("_each", "_excess")

    def __init__(self, solver: "TreeSolver", row: np.ndarray, kinds: tuple, elapsed: float) -> None:
        """Keep the kernel's row; its end holds what is left at each tip."""
        end = ANSWER + solver.robot.n
        super().__init__(solver, row[:end], elapsed, all(kind in (POSITION, FREE) for kind in kinds))
        tips = [Miss._make(x) for x in row[end:].reshape(-1, MISS).tolist()]
        self._each = [
            (x.position, None if kind in (POSITION, FREE) else x.rotation) for x, kind in zip(tips, kinds, strict=True)
        ]
        self._excess = [x.excess for x in tips]

    @property
    def position_errors(self) -> dict[str, float]:
        """Distance of each tip from its target at q [m]."""
        return {tip: error[0] for tip, error in zip(self.robot.tips, self._each, strict=True)}

    @property
    def orientation_errors(self) -> dict[str, float | None]:
        """Rotation angle left at each tip [rad]; None where the target leaves orientation free."""
        return {tip: error[1] for tip, error in zip(self.robot.tips, self._each, strict=True)}

    @property
    def message(self) -> str:
        """One sentence on how the solve ended and, on failure, which tip is how far and what to try."""
        if self.success:
            return sentence(self)
        left = []
        for tip, (position, angle) in zip(self.robot.tips, self._each, strict=True):
            left.append(f"{tip} {1000 * position:.3g} mm" + ("" if angle is None else f" {np.degrees(angle):.3g} deg"))
        text = sentence(self)
        if self.status == Status.UNREACHABLE:
            beyond = [
                f"{tip} by {1000 * x:.4g} mm" for tip, x in zip(self.robot.tips, self._excess, strict=True) if x > 0.0
            ]
            text = (
                f"beyond reach: {', '.join(beyond)} (a bound from the link lengths); move the target inside the reach"
            )
        return f"{text}; left at each tip: {', '.join(left)}"

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON; errors by tip under `tips`."""
        pairs = zip(self.robot.tips, self._each, strict=True)
        tips = {tip: {"position_error": p, "orientation_error": r} for tip, (p, r) in pairs}
        return {**super().to_dict(), "tips": tips}


class TreeSolver(Solver):
    """Solver bound to a Tree: `solver(targets, q0=None) -> TreeResult`; made by `ik.Solver(tree, ...)`.

    The rules work on the stacked errors of all tips ('auto' is `lm`, here with 40 iterations an attempt and 400 attempts); the
    first starts of `lm` come from a table in which each tip picks its own joints. Options as for one tip, without objective,
    collisions and follow; a mask counts at every tip. fk_evaluations counts all tips as one.
    """

    robot: Tree  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(self, robot: Tree, solver: Any = "auto", **options: Any) -> None:
        """Validate everything once. Raises UnknownSolver (closed forms and rules for one tip), InvalidOption."""
        solver = GENERAL if is_auto(solver) else solver
        row = find_row(solver)
        if row.one_tip:
            raise UnknownSolver(f"solver '{row.name}' is for one tip; for several use '{GENERAL}'")
        super().__init__(robot, solver, **options)  # pyright: ignore[reportArgumentType]
        for name in ("objective", "avoid_collisions", "follow"):
            if getattr(self.options, name):
                raise InvalidOption(f"option '{name}' is for one tip; leave it out when several are solved together")

    def _bind(self) -> None:
        tree = self.robot
        chain = tree.chain
        ends = chain.ends
        if not self.options.limits:
            ends = np.array(
                [without_limits(rows, end, tree.n) for rows, end in zip(chain.parts, chain.ends, strict=True)]
            )
        if not self._wraps:
            ends = without_wrap(ends, tree.n)
        self._kernel = entry(type(self.rule))
        self._chain = (chain.rows, ends, chain.seeds, chain.features)
        self._width = ANSWER + tree.n + MISS * len(tree.tips)
        self._home = tree.home.reshape(1, -1).copy()
        self._silent = np.empty((0, 2 + tree.n))
        self._lower, self._upper = tree.lower, tree.upper
        self._packed = {}
        self._ready = {}
        self.held = held_joints(self.options)
        self._pinned = (None, ())
        self._own_starts = False

    def __call__(self, targets: Any, q0: Any = None) -> TreeResult:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Solve for one target a tip: a dict by tip, or a sequence in the order of `robot.tips`; q0 (n,), default home.

        Each target is T_base_tip (4, 4), pin.SE3, or a position (3,) [m]. Raises FrameNotFound, InvalidTarget and
        InvalidConfiguration; a failure to converge is a status in the result.
        """
        started = perf_counter()
        start, notice = (self._home, "") if q0 is None else self._start(q0)
        T, kinds, note = self._read(targets, self.options.check)
        row = self._run(T[None], kinds, start, q0 is not None)
        if row[AT.status] == BAD_TARGET:
            T, kinds, note = self._read(targets, True)
            row = self._run(T[None], kinds, start, q0 is not None)
        result = TreeResult(self, row, kinds, perf_counter() - started)
        result._notice = "; ".join(filter(None, (note, notice)))
        result._given = q0 is not None
        if self.options.history:  # once more with room for it; the counts of the first run say how much
            history = np.empty((result.fk_evaluations + 1, 2 + self.robot.n))
            out, orders = np.empty((1, self._width)), self.pack(kinds, q0 is not None)
            self._kernel(*self.arrays_for(kinds, start), T[None], start, out, orders, history)
            history = history[: int(out[0, AT.history])]
            if result.orientation_error is None:
                history[:, 1] = np.nan
            result._history = {"position_error": history[:, 0], "orientation_error": history[:, 1], "q": history[:, 2:]}
        if self.options.check:
            self._confirm(result, T, kinds)
            result.elapsed = perf_counter() - started
        return result

    def _read(self, targets: Any, strict: bool) -> tuple[np.ndarray, tuple, str]:
        """Targets as (F, 4, 4), their kinds and a notice; an array of poses is left to the kernel unless strict."""
        F = len(self.robot.tips)
        array = type(targets) is np.ndarray and targets.shape == (F, 4, 4) and targets.dtype == np.float64
        if array and targets.flags.carray and not strict:
            return targets, (POSE,) * F, ""
        T, kinds, notice = read_target(self.robot, targets)
        return T[0], kinds, notice

    def _confirm(self, result: TreeResult, T: np.ndarray, kinds: tuple) -> None:
        """Compute the errors of every tip again with Pinocchio; a success it does not confirm is no success."""
        o = self.options
        result._each = counted_errors(self.robot, result.q, T, kinds, o)
        angles = [angle for _, angle in result._each if angle is not None]
        worst = (max(position for position, _ in result._each), max(angles, default=None))
        result._checked = worst
        if result.success and not (worst[0] <= o.position_tolerance and (worst[1] or 0.0) <= o.orientation_tolerance):
            result._status = Status.CHECK_FAILED
