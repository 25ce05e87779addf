"""One contract for every solver in the registry, on every kind of robot."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, UnknownSolver
from ik_toolkit.solvers.options import make_options
from ik_toolkit.solvers.registry import ROWS

ARMS = (
    "hydrolek_7w",
    "planar_2r",
    "planar_3r",
    "cartesian_pp",
    "inspection_7dof",
    "continuous_mix",
    "mimic_mix",
    "slides_mix",
    "locked",
)
LOOSE = dict(position_tolerance=1e-3, orientation_tolerance=1e-2)


# What the rows that are not for every robot claim of ARMS, written down here: a row that refuses more than that fails, and one
# that takes more is not told off by silence.
CLAIMED = {
    "newton": {
        ("hydrolek_7w", "pose"),
        ("continuous_mix", "pose"),
        ("mimic_mix", "pose"),
        ("locked", "pose"),
        ("planar_2r", "position"),
        ("cartesian_pp", "position"),
    },
    "planar-2r": {("planar_2r", "position")},
    "inspection": {("inspection_7dof", "pose"), ("locked", "pose")},
    "eaik": {("locked", "pose")},
}


def cases(claimed=True):
    """Rows, arms and kinds of target that a row claims, or those it does not."""
    for row in ROWS:
        for name in ARMS:
            for kind in ("pose", "position"):
                if kind == "pose" and name in robots.PLANAR:
                    continue  # three of six rows cannot be reached by design: planar arms are asked for positions
                if (row.name not in CLAIMED or (name, kind) in CLAIMED[row.name]) == claimed:
                    yield pytest.param(row, name, kind, id=f"{row.name}-{name}-{kind}")


def make(row, name, kind, **options):
    """Solver that has met a target of the kind; skips only where the row's package is not installed."""
    robots.needs(row)
    robot = robots.load(name)
    solver = ik.Solver(robot, row.name, **options)
    solver(of(robot.fk(robot.home).homogeneous, kind))
    return solver


def of(T, kind):
    return T if kind == "pose" else T[:3, 3].copy()


@pytest.mark.parametrize(("row", "name", "kind"), list(cases(claimed=False)))
def test_what_a_row_does_not_claim_is_refused_in_words(row, name, kind):
    robots.needs(row)
    with pytest.raises((UnknownSolver, InvalidOption), match=rf"{row.name}.{{20,}}"):
        make(row, name, kind)


@pytest.mark.parametrize(("row", "name", "kind"), list(cases()))
def test_contract(row, name, kind):
    solver = make(row, name, kind, **LOOSE)
    robot = solver.robot
    rng = np.random.default_rng(3)
    Q = robot.random_q(rng) * np.ones((12, 1))
    Q = np.array([robot.random_q(rng) for _ in Q])
    for k, q in enumerate(Q):
        T = robot.fk(q).homogeneous
        near = np.clip(q + rng.uniform(-0.02, 0.02, robot.n), robot.lower, robot.upper)
        target, before = of(T, kind), of(T, kind)
        start = near.copy() if k < 8 else robot.home.copy()
        result = solver(target, q0=start)
        # inputs are left alone
        assert (target == before).all()
        assert (start == (near if k < 8 else robot.home)).all()
        # q finite, inside the limits, and it is the q whose errors are reported
        assert np.isfinite(result.q).all()
        assert (result.q >= robot.lower).all() and (result.q <= robot.upper).all()
        position, orientation = robot.errors(result.q, target)
        assert abs(position - result.position_error) < 1e-9
        assert (orientation is None) == (result.orientation_error is None)
        if orientation is not None:
            assert abs(orientation - result.orientation_error) < 1e-7
        # success means both errors are inside their tolerances, and nothing else does
        inside = result.position_error <= 1e-3 and (result.orientation_error or 0.0) <= 1e-2
        assert result.success == inside
        assert result.success == (result.status == ik.Status.CONVERGED)
        assert len(result.message) > 10
        # same seed, same bytes
        again = solver(target, q0=start)
        assert again.q.tobytes() == result.q.tobytes()
        assert (again.iterations, again.fk_evaluations) == (result.iterations, result.fk_evaluations)
        # counts
        assert result.fk_evaluations >= 1 and result.iterations >= 0 and result.restarts >= 0
        assert result.limited_joints == tuple(robot.at_limits(result.q))


@pytest.mark.parametrize(("row", "name", "kind"), list(cases()))
def test_returns_at_once_at_a_solved_start(row, name, kind):
    solver = make(row, name, kind)
    robot = solver.robot
    q = robot.random_q(np.random.default_rng(11))
    result = solver(of(robot.fk(q).homogeneous, kind), q0=q)
    assert result.success
    assert result.iterations == 0 and result.restarts == 0
    if not row.closed:
        assert np.allclose(result.q, q, atol=1e-15)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_solves_an_easy_target(row):
    robots.needs(row)
    easy = [("hydrolek_7w", "position"), ("planar_2r", "position"), ("inspection_7dof", "pose"), ("locked", "pose")]
    easy = [one for one in easy if row.name not in CLAIMED or one in CLAIMED[row.name]]
    assert easy
    for name, kind in easy:
        robot = robots.load(name)
        solver = ik.Solver(robot, row.name, tolerance=1e-3)
        assert solver(of(robot.fk(robot.home + 0.02).homogeneous, kind)).success, name


@pytest.mark.parametrize(("row", "name", "kind"), list(cases()))
def test_unreachable_target_returns_with_a_status(row, name, kind):
    solver = make(row, name, kind)
    T = np.eye(4)
    T[:3, 3] = (1e3, 2e3, -5e2)
    result = solver(of(T, kind))
    assert not result.success
    assert result.status not in (ik.Status.CONVERGED, ik.Status.CHECK_FAILED)
    assert np.isfinite(result.q).all()
    with pytest.raises(ik.NotSolved, match=result.status.name):
        result.raise_for_status()


@pytest.mark.parametrize("row", [row for row in ROWS if not row.closed], ids=lambda row: row.name)
def test_budgets_are_honoured(row):
    robot = robots.load("planar_2r" if row.name == "newton" else "hydrolek_7w")
    target = robot.fk(robot.upper * 0.8 + robot.lower * 0.2).translation
    for budget in (1, 3, 7):
        result = ik.Solver(robot, row.name, max_iterations=budget, restarts=0, tolerance=1e-12)(target)
        assert result.iterations <= budget
        assert result.restarts == 0
    result = ik.Solver(robot, row.name, max_evaluations=5, tolerance=1e-300)(target)
    assert result.fk_evaluations <= 5 + 2 * robot.n + 2  # one sweep, and the evaluations that say why it ended
    result = ik.Solver(robot, row.name, restarts=2, max_iterations=2, tolerance=1e-300)(target)
    assert result.restarts <= 2 and result.iterations <= 6


@pytest.mark.parametrize("row", [row for row in ROWS if not row.closed], ids=lambda row: row.name)
def test_history_holds_every_evaluation_of_the_loop(row):
    robot = robots.load("planar_2r" if row.name == "newton" else "hydrolek_7w")
    target = robot.fk(robot.home + 0.1).translation
    result = ik.Solver(robot, row.name, history=True, restarts=0, max_iterations=20)(target)
    history = result.history
    assert len(history["q"]) == result.iterations + 1
    assert history["position_error"].min() == result.position_error
    for q, error in zip(history["q"], history["position_error"], strict=True):
        assert abs(np.linalg.norm(robot.fk(q).translation - target) - error) < 1e-12
    assert (history["q"] >= robot.lower).all() and (history["q"] <= robot.upper).all()


@pytest.mark.parametrize(
    "row", [row for row in ROWS if row.name in ("pinv", "dls", "transpose", "lm")], ids=lambda row: row.name
)
def test_limits_can_be_left_out(row):
    robot = robots.load("hydrolek_7w")
    q = robot.upper + 0.1  # reachable only outside the limits
    result = ik.Solver(robot, row.name, limits=False, tolerance=1e-4, max_iterations=5000)(
        robot.fk(q).homogeneous, q0=q - 0.05
    )
    assert result.success
    assert ((result.q < robot.lower) | (result.q > robot.upper)).any()


def test_defaults_table_is_complete():
    assert make_options({}).position_tolerance == 1e-6
    assert {row.name for row in ROWS} >= {"pinv", "transpose", "dls", "newton", "lm", "ccd", "pid", "state-space"}
