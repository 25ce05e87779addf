"""What the certificate of Newton's method proves, against runs, lists of solutions and second derivatives by differences."""

import importlib

import numpy as np
import pinocchio as pin
import pytest
import robots
from folders import SCRIPTS
from serial_arms import urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption
from ik_toolkit.papers.chinyai import formulas

# Three axes that meet at the tip, so that only the rotation changes.
WRIST = urdf(
    [("revolute", (0, 0, 0), (0, 0, 0), axis, -3, 3) for axis in ((0, 0, 1), (0, 1, 0), (1, 0, 0))], ((0,) * 3,) * 2
)


def test_no_counterexample_in_random_cases(monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    theory = importlib.import_module("theory_newton")
    tested, wrong = theory.search(140)
    assert tested.total() == 140 and len(tested) == len(theory.ARMS) and not wrong, "\n".join(wrong)


def test_the_planar_arm_by_hand():
    """For lengths 1 and 1 the equation in the links' directions has L = 1, and its inverse is that of (tangent 1, tangent 2)."""
    robot, X, q = robots.load("planar_2r"), np.array([1.1, 0.6, 0.0]), np.array([-0.3, 1.7])
    made = ik.newton_certificate(robot, X, q)
    angles = np.array([q[0], q.sum()])
    J = np.array([-np.sin(angles), np.cos(angles)])
    e = X[:2] - [np.cos(angles).sum(), np.sin(angles).sum()]
    beta, eta = np.linalg.norm(np.linalg.inv(J), 2), np.linalg.norm(np.linalg.solve(J, e))
    assert made.lipschitz == pytest.approx([1.0, 0.0]) and made.beta == pytest.approx([beta, 0.0])
    assert made.eta == pytest.approx(eta) and made.h == pytest.approx(beta * eta) and made.proven
    root = np.sqrt(1.0 - 2.0 * beta * eta)
    assert made.radius == pytest.approx((1.0 - root) / beta) and made.unique_radius == pytest.approx(
        (1.0 + root) / beta
    )
    assert made.norm([0.1, 0.2]) == pytest.approx(np.hypot(0.1, 0.3)) and made.bound(0) == pytest.approx(2.0 * eta)
    assert made.bound(2) == pytest.approx(2.0 * eta * (2.0 * beta * eta) ** 3 / 4.0)
    solutions = ik.solve_all(robot, X)
    assert solutions[int(made.leads_to(solutions))][1] > 0.0 and made.leads_to(solutions.q[:0]) == -1
    assert "within" in str(made) and "2 of 2" in str(ik.newton_certificate(robot, X, [q, q]))


def test_every_proven_start_of_a_grid_leads_where_it_says():
    robot, side = robots.load("planar_2r"), np.radians(np.linspace(-180.0, 180.0, 121))
    starts = np.stack(np.meshgrid(side, side), axis=-1)
    target = (1.1, 0.6, 0.0)
    made = ik.newton_certificate(robot, target, starts, limits=False)
    assert made.proven.shape == (121, 121) and made.beta.shape == (121, 121, 2)
    solutions = ik.solve_all(robot, target, limits=False)
    index = made.leads_to(solutions)
    good = made.proven
    rows = formulas.converge(np.tile(target[:2], (good.sum(), 1)), 1.0, 1.0, starts[good], formulas.PLAIN)
    assert (rows[:, 2] >= 0).all() and {*index[good]} == {0, 1} and (index[~good] == -1).all()
    assert np.abs(np.exp(1j * rows[:, :2]) - np.exp(1j * solutions.q[index[good]])).max() < 1e-8
    assert 0.015 < good.mean() < 0.04  # most starts that converge are not proven


@pytest.mark.parametrize("name", ["ur5", "planar_3r", "scara", "hydrolek_7w", "wrist"])
def test_second_derivatives_stay_below_the_bound(name):
    """|F'(q0)^-1 (F'(a) - F'(b))| <= omega |a - b| in the norm, for a and b within 2 eta of q0."""
    rng, worst = np.random.default_rng(3), 0.0
    robot = ik.Robot.load(WRIST, tip="tip") if name == "wrist" else robots.load(name)
    for _ in range(20):
        q = robot.random_q(rng)
        T = robot.fk(q)
        q0 = q + 10.0 ** rng.uniform(-3.0, -0.3) * rng.normal(size=robot.n) * robot.chain.unit
        made = ik.newton_certificate(robot, T, q0, limits=False)
        M = made._to_norm
        if not np.isfinite(made.h):
            continue

        def jacobian(at, T=T):
            phi = pin.log3(robot.fk(at).rotation @ T.rotation.T)
            J = robot.jacobian(at)
            J[3:] = np.linalg.solve(pin.Jexp3(-phi), J[3:])  # Jexp3 is the right Jacobian, the left one that of -phi.
            return J

        inverse = M @ np.linalg.pinv(jacobian(q0))
        for _ in range(20):
            ends = rng.normal(size=(2, robot.n))
            ends *= (2.0 * made.eta * rng.uniform(0.0, 1.0, 2) / np.linalg.norm(ends, axis=1))[:, None]
            a, b = q0 + np.linalg.solve(M, ends.T).T
            change = np.linalg.norm(inverse @ (jacobian(a) - jacobian(b)) @ np.linalg.inv(M), 2)
            worst = max(worst, change / (made.beta @ made.lipschitz * made.norm(a - b)))
    assert (0.4 if name == "wrist" else 0.1) < worst <= 1.0


def test_limits_count_where_they_are_kept():
    robot, target = robots.load("planar_2r"), (1.1, 0.6, 0.0)
    q = np.array([robot.upper[0] - 1e-3, 1.79])
    turned = pin.exp3(np.array([0.0, 0.0, q[0] + 0.394])) @ target
    kept, free = (ik.newton_certificate(robot, turned, q, limits=limits) for limits in (True, False))
    assert kept.h <= 0.5 and not kept.proven and free.proven and "joint limit" in str(kept)
    assert kept.bound(1) == np.inf and kept.leads_to([q]) == -1


def test_nothing_is_claimed_where_nothing_is_known():
    robot = robots.load("planar_2r")
    for target, q0 in (((1.1, 0.6, 0.0), (0.3, 0.0)), ((1.1, 0.6, 0.1), (-0.3, 1.7)), ((2.1, 0.0, 0.0), (0.0, 1e-3))):
        made = ik.newton_certificate(robot, target, q0, limits=False)
        assert not made.proven and made.radius == np.inf and made.unique_radius == 0.0 and "Not proven" in str(made)
    many = ik.newton_certificate(robot, (1.1, 0.6, 0.0), [(2e3 * np.pi * k - 0.3, 1.7) for k in (0, 1)], limits=False)
    assert many.proven.tolist() == [True, False]  # Angles of thousands of turns are known to few digits.
    arm = robots.load("ur5")  # Half a turn away, the rotation vector jumps.
    T = arm.fk(arm.home)
    T.rotation = pin.exp3(np.array([np.pi - 1e-3, 0.0, 0.0])) @ T.rotation
    assert not ik.newton_certificate(arm, T, arm.home).proven


def test_mistakes_are_named():
    robot = robots.load("planar_2r")
    with pytest.raises(InvalidOption, match="as many task rows as joints"):
        ik.newton_certificate(robots.load("panda"), robots.load("panda").fk(robots.load("panda").home), np.zeros(7))
    with pytest.raises(InvalidConfiguration, match=r"\(\.\.\., 2\)"):
        ik.newton_certificate(robot, (1.0, 0.5, 0.0), [0.1, 0.2, 0.3])
    with pytest.raises(InvalidOption, match="limits is True or False"):
        ik.newton_certificate(robot, (1.0, 0.5, 0.0), [0.1, 0.2], limits="no")
    with pytest.raises(InvalidOption, match="one tip"):
        ik.newton_certificate(ik.Tree.load("baxter"), (1.0, 0.5, 0.0), [0.1, 0.2])
