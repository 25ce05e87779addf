"""The method behind the option `priority`: sequential quadratic programming, one level of errors after the other."""

from typing import Any, NamedTuple

import numpy as np

from ...compile.jit import compiled
from ...kernel.level_search import PHASE, rank_errors, search_by_levels
from ...kernel.levels import QUADRATIC, step_by_levels
from ...kernel.records import Array, Ends
from ...kernel.starts import BEST, known_configurations
from ..protocol import Asked, rule
from ..task import counted_rows, group_levels, what_counts
from .jacobian import FLOOR


def posture_groups(starts: np.ndarray) -> np.ndarray:
    """Reorder start configurations (N, n) so that rows k, k + BEST, k + 2 BEST, ... hold similar postures, for each k < BEST.

    The groups come from repeated halving at the median of the joint that varies most.
    """
    groups = [starts]
    while len(groups) < BEST:
        sides = [(group, int(group.var(axis=0).argmax())) for group in groups]
        groups = [half for group, i in sides for half in np.array_split(group[group[:, i].argsort(kind="stable")], 2)]
    return np.stack(groups, axis=1).reshape(-1, starts.shape[1])


@compiled
class Tolerances(NamedTuple):
    """The two tolerances that the compiled search needs when a target is set (`aim`)."""

    tol_p: float  # position tolerance [m]
    tol_r: float  # rotation tolerance [rad]


@compiled
class LevelStep(NamedTuple):
    """The compiled step of SQP: one step that reduces errors in order of priority, level 0 first, then level 1, and so on."""

    # First the number of attempts that take all errors at one level. Then, for each of F tips, the priority levels of its position
    # and its orientation (2 F,); 0 is the highest.
    numbers: Array

    def aimed(self, p, T, orders):
        # A target counts as out of reach only if a position at level 0 is: the bound on the reach does not depend on the
        # orientation.
        return p.exact(p.aim(T, Tolerances(orders.tol_p, np.inf)), self.numbers[1:])

    def evaluated(self, p, q):
        p.stand(q)
        e = p.see()
        if int(p.desk.spent[2]) == PHASE.at_once:
            return e
        return rank_errors(p, e, self.numbers[1:])

    def step(self, p, e):
        if int(p.desk.spent[2]) == PHASE.at_once:
            p.damped(e, QUADRATIC.damping * e.ee + FLOOR)
            return 0
        # Once the errors of level 0 are within tolerance, the step keeps them there as a constraint, even if the target had been
        # judged out of reach before.
        return step_by_levels(p, e, self.numbers[1:], int(p.desk.spent[2]) == PHASE.out_of_reach and not e.ee < 0.0)

    def seek(self, p, job, excess):
        return search_by_levels(self, p, job, self.numbers[1:], int(self.numbers[0]), excess)


@rule(step=LevelStep)
class SQP(NamedTuple):
    """Sequential quadratic programming with exact second derivatives, for errors in order of priority (option `priority`).

    Without a priority all errors are at one level, and its steps are those of the solver `lm`.

    Source: Nocedal and Wright, Numerical Optimization, chapter 18; the null-space hierarchy is that of Nakamura and Hanafusa, J.
    Dynamic Systems 108 (1986).
    """

    hold = True
    wrap = True

    def start_table(self, robot: Any, position_only: bool) -> np.ndarray:
        """Return configurations (M, n) [rad or m] at which attempts begin, in groups of similar postures.

        Attempts take one start from each group in turn, because similar starts often lead to the same minimum.
        """
        chain = robot.chain
        box = Ends(chain.ends.reshape(-1, chain.ends.shape[-1])[0], robot.n)
        low, span, home = (np.array([read(i) for i in range(robot.n)]) for read in (box.low, box.span, box.home))
        starts = known_configurations(low, low + span, home, QUADRATIC.table if robot.n < 6 else QUADRATIC.table_six)
        return posture_groups(starts) * chain.unit

    def refuses(self, asked: Asked) -> str:
        """Return why the rule cannot solve this task with its options, or '' if it can."""
        o = asked.options
        if o.priority is not None and (o.closest or o.objective is not None):
            return f"takes no {'closest' if o.closest else 'objective'} with a priority"
        levels = np.array(group_levels(asked.robot, o)).reshape(-1, 2)
        for tip, counts, level in zip(asked.robot.tips, what_counts(asked.robot, o), levels, strict=True):
            widths = np.array(counts.slack or (0.0,) * 6).reshape(2, 3)
            bounded = ((widths > 0.0) & (widths < [[np.inf], [np.pi]])).any(axis=1)
            if (bounded & (level < levels.max())).any():
                return (
                    f"keeps no slack in a level that others come after ({tip}); a mask or a free turn may stand there"
                )
        return ""

    def pack(self, robot: Any, asked: Asked | None = None) -> np.ndarray:
        """Return the numbers that the compiled step `LevelStep` reads: its field `numbers`, as an array."""
        assert asked is not None
        counted = counted_rows(robot, asked.kinds, asked.options).sum()
        if counted <= robot.n:
            plain = QUADRATIC.at_once
        else:  # only here, because asked.rows computes Jacobians and singular values, which takes time
            plain = QUADRATIC.at_once_few if asked.rows <= robot.n else 0
        return np.array([plain, *group_levels(robot, asked.options)], dtype=float)
