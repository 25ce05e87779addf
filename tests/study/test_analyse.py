"""The linear analysis of the state-space solver and of IK-PID, against runs of the solvers themselves."""

import importlib

import numpy as np
import pinocchio as pin
import pytest
import robots
from folders import ROOT

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption
from ik_toolkit.study.analyse import analyse, gain_margins

PUBLISHED = ik.StateSpace.preset("burrell-2016")


def errors(robot, rule, q, q0, steps, pose):
    """Errors (k, r) along a run from q0 towards the tip at q."""
    T = robot.fk(q)
    # A given q0 chooses the map of the nearest start, as the analysis does.
    solver = ik.Solver(robot, rule, history=True, limits=False, tolerance=1e-14, max_iterations=steps, restarts=0)
    run = solver(T if pose else T.translation, q0=q0)
    found = []
    for one in run.history["q"]:
        now = robot.fk(one)
        turn = pin.log3(T.rotation @ now.rotation.T)
        found.append(np.concatenate([T.translation - now.translation, turn])[: 6 if pose else 3])
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "rule", "pose"),
    [("hydrolek_7w", PUBLISHED, False), ("hydrolek_7w", ik.StateSpace(), True), ("planar_3r", ik.StateSpace(), False)],
)
def test_small_errors_go_as_the_linear_loop_says(name, rule, pose):
    robot, rng, r = robots.load(name), np.random.default_rng(1), 6 if pose else 3
    for _ in range(25):
        q = robot.random_q(rng)
        found = analyse(robot, rule, q, position_only=not pose)
        M, J = found.matrices, robot.jacobian(q)[:r]
        (k,) = M.nearest(robot, q[None])
        path = errors(robot, rule, q, q + 1e-6 * rng.normal(size=robot.n), 6, pose)
        e, x = path[0], np.zeros(len(M.A))
        for after in path[1:]:
            e, x = e - J @ (M.C @ x + M.D[k] @ e), M.A @ x + M.B[k] @ e
            assert np.abs(after - e).max() <= 1e-3 * np.abs(path[0]).max()


def test_the_published_loop_is_stable_and_its_bound_is_that_of_jury():
    robot = robots.load("hydrolek_7w")
    found = analyse(robot, PUBLISHED, count=300)
    assert found.gain_bound == 1.5 and found.stable.mean() > 0.98
    alike = np.abs(found.loop_gain.imag).max(axis=1) < 1e-9
    inside = ((found.loop_gain.real > 0.0) & (found.loop_gain.real < 1.5)).all(axis=1)
    assert alike.sum() > 100 and (found.stable == inside)[alike].all()
    slow = analyse(robot, PUBLISHED._replace(A=0.9 * np.eye(6)), count=300)
    assert slow.gain_bound == pytest.approx(0.1) and not slow.stable.any()
    assert "% locally stable" in str(found) and np.isinf(slow.steps_per_decade).all()


def test_runs_that_no_limit_touches_end_on_the_slice_and_the_static_map_foretells_them():
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(2)
    q0 = 0.5 * (robot.lower + robot.upper)
    goals = np.array([robot.fk(robot.random_q(rng)).translation for _ in range(300)])
    found = analyse(robot, PUBLISHED, count=1)
    run = ik.solve_batch(robot, goals, PUBLISHED, q0=q0, tolerance=1e-3, max_iterations=1000)
    free = run.success & (run.q > robot.lower + 1e-3).all(axis=1) & (run.q < robot.upper - 1e-3).all(axis=1)
    assert np.median(found.off_slice(run.q[free], q0)) < 1e-9
    assert found.off_slice(robot.random_q(rng, 20), q0).min() > 1e-2
    assert (found.predict(goals, q0) == run.success).mean() >= 0.99


def test_the_gain_margin_is_where_some_step_still_lowers_every_small_error():
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(3)
    Q = robot.random_q(rng, 20)
    for q, margin in zip(Q, gain_margins(robot, Q), strict=True):
        J = robot.jacobian(q)[:3, :5]  # The last joint turns about the tip.
        u = rng.normal(size=(20_000, 3))
        u /= np.linalg.norm(u, axis=1)[:, None]
        allowed = (2.0 * np.abs(u @ J) / (J**2).sum(axis=0)).max(axis=1)
        assert margin <= allowed.min() + 1e-9 and margin >= 0.9 * allowed.min()
    assert gain_margins(robots.load("planar_2r"), [[0.3, 0.0]]) == [0.0]  # straight: both joints move the tip one way


def test_mistakes_are_named():
    robot = robots.load("hydrolek_7w")
    with pytest.raises(InvalidOption, match=r"takes ik\.StateSpace"):
        analyse(robot, "dls")
    with pytest.raises(InvalidOption, match="maps has a slice"):
        analyse(robot, count=1).off_slice(robot.home, robot.home)
    with pytest.raises(InvalidOption, match="three columns"):
        analyse(robot, PUBLISHED, position_only=False)


def test_planar_arms_are_judged_in_their_plane():
    """An error out of the plane, which no joint can change, is none of a target in reach."""
    arm = robots.load("planar_3r")
    found = analyse(arm, ik.StateSpace(), count=100, position_only=True)
    assert found.loop_gain.shape == (100, 2) and found.stable.all() and np.isfinite(found.steps_per_decade).all()
    margins = gain_margins(arm, found.q)
    J = arm.chain.forward(found.q, jacobian=True)[1][:, :2]
    u = np.stack([np.cos(np.linspace(0.0, np.pi, 40_001)), np.sin(np.linspace(0.0, np.pi, 40_001))])
    least = np.abs((2.0 * J / (J**2).sum(axis=1, keepdims=True)).transpose(0, 2, 1) @ u)
    assert margins == pytest.approx(least.max(axis=1).min(axis=1), rel=1e-2)


def test_no_counterexample_in_random_loops_and_margins(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    tested, wrong = importlib.import_module("theory_burrell").search(120)
    assert tested.total() == 120 and len(tested) == 6 and not wrong, "\n".join(wrong)


def test_what_is_no_configuration_is_refused():
    arm = robots.load("hydrolek_7w")
    for wrong in ([0, 1], np.zeros((6, 1)), np.zeros((2, 3, 6)), "home", np.full(6, np.nan)):
        for call in (lambda q: gain_margins(arm, q), lambda q: ik.analyse(arm, PUBLISHED, q)):
            with pytest.raises(InvalidConfiguration):
                call(wrong)
