"""The contract of `ik_toolkit.testing`, clause by clause: every registered solver, on every kind of robot, one tip and several."""

import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.solvers.registry import BY_NAME
from ik_toolkit.solvers.rows import ROWS
from ik_toolkit.testing import CLAUSES, Case

ARMS = (*robots.SHIPPED, *robots.MADE, "locked", "two_arms")
# What the rows that are not for every robot (beyond what a row itself says: `pose`, `position`, `one_tip`) claim of ARMS, written
# down here: a row that refuses more than that fails, and one that takes more is not told off by silence.
CLAIMED = {
    "newton": {
        *((arm, "pose") for arm in ("hydrolek_7w", "continuous_mix", "mimic_mix", "locked")),
        *((arm, "position") for arm in ("planar_2r", "cartesian_pp")),
    },
    "planar-2r": {("planar_2r", "position")},
    "inspection": {("inspection_7dof", "pose"), ("locked", "pose")},
    "eaik": {("locked", "pose")},
    "elimination": {("hydrolek_7w", "pose"), ("continuous_mix", "pose"), ("locked", "pose")},
}
# Rules that differ from those tested on two arms by a line each; a search for several tips takes 4 to 7 s to compile for each.
ALIKE = ("pinv", "dls", "transpose", "pid")


def claims(row, arm, kind):
    """Whether a row is to solve targets of a kind on an arm."""
    if row.name in CLAIMED:
        return (arm, kind) in CLAIMED[row.name]
    return getattr(row, kind) and not (row.one_tip and arm == "two_arms")


def pairs(claimed):
    """Rows, arms and kinds of target that a row claims, or those it does not."""
    for row in ROWS:
        for arm in ARMS:
            for kind in ("pose", "position"):
                if kind == "pose" and arm in robots.PLANAR:
                    continue  # three of six rows cannot be reached by design: planar arms are asked for positions
                if claims(row, arm, kind) == claimed:
                    marks = [pytest.mark.slow] if claimed and arm == "two_arms" and row.name in ALIKE else []
                    yield pytest.param(row.name, arm, kind, id=f"{row.name}-{arm}-{kind}", marks=marks)


@pytest.mark.parametrize(("name", "arm", "kind"), list(pairs(claimed=False)))
def test_what_a_row_does_not_claim_is_refused_in_words(name, arm, kind):
    robots.needs(BY_NAME[name])
    assert not Case(name, robots.load(arm), kind, seed=3).fits()


@pytest.mark.parametrize(("name", "arm", "kind"), list(pairs(claimed=True)))
def test_what_a_row_claims_is_taken_and_every_clause_holds(name, arm, kind):
    robots.needs(BY_NAME[name])
    case = Case(name, robots.load(arm), kind, seed=3)
    assert case.fits()
    for clause in CLAUSES.values():
        clause(case)


@pytest.mark.parametrize("name", ["pinv", "dls", "transpose", "lm"])
def test_limits_can_be_left_out(name):
    robot = robots.load("hydrolek_7w")
    q = robot.upper + 0.1  # reachable only outside the limits
    solver = ik.Solver(robot, name, limits=False, tolerance=1e-4, max_iterations=5000)
    result = solver(robot.fk(q).homogeneous, q0=q - 0.05)
    assert result.success
    assert ((result.q < robot.lower) | (result.q > robot.upper)).any()
