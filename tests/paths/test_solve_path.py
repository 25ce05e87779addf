"""Whole paths: every pose reached by one motion where there is one, and what is said where there is none."""

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.paths.result import PathStatus


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("hydrolek_7w")


@pytest.fixture(scope="module")
def flat():
    return ik.Robot.load("planar_3r")


def between(robot, a, b, count):
    """Poses (count, 4, 4) of a motion that is linear in the joints."""
    return np.array([robot.fk(q).homogeneous for q in np.linspace(a, b, count)])


def planar_pose(x, y, angle):
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:2, 3] = x, y
    return T


def test_one_motion_where_there_is_one(arm):
    rng = np.random.default_rng(4)
    a, b = arm.random_q(rng), arm.random_q(rng)
    T = between(arm, a, b, 60)
    made = ik.solve_path(arm, T, seed=1)
    assert made.status == PathStatus.FOLLOWED and made.success
    assert made.lower_bound == 0 and not made.reconfigurations
    errors = np.array([arm.errors(q, one) for q, one in zip(made.q, T, strict=True)])
    assert errors.max() <= 1e-6
    assert (made.q >= arm.lower).all() and (made.q <= arm.upper).all()
    assert made.largest_step[0] <= made.max_step[0]
    assert made.deviation[0] <= made.path_tolerance[0]
    assert (made.q == ik.solve_path(arm, T, seed=1, threads=1).q).all(), "the same for any number of threads"


def test_fewest_reconfigurations_of_a_branch_that_ends(flat):
    """No branch is legal all along this curve; enumeration (scripts/benchmarks/path_truth.py) says one change does."""
    s = np.linspace(0.0, 1.0, 101)[:, None]
    curve = (1 - s) ** 2 * [5.06, -0.36, -0.82] + 2 * s * (1 - s) * [5.78, -1.06, -0.45] + s * s * [5.02, -1.58, 0.28]
    T = np.array([planar_pose(*one) for one in curve])
    made = ik.solve_path(flat, T)
    assert made.status == PathStatus.RECONFIGURES and len(made.reconfigurations) == 1
    at = made.reconfigurations[0].index
    assert np.sign(made.q[at, 1]) != np.sign(made.q[at + 1, 1])
    none = ik.solve_path(flat, T, reconfigurations="none")
    assert none.status == PathStatus.INCOMPLETE and not none.success
    ends = int(np.flatnonzero(np.isfinite(none.q[:, 0]))[-1])
    assert f"pose {ends + 1} cannot be passed" in none.message and np.isnan(none.q[ends + 1 :]).all()
    assert ends >= at, "the best partial path is as long as it can be"
    assert ik.solve_path(flat, T, reconfigurations=1).success


def test_poses_out_of_reach_are_named(flat):
    made = ik.solve_path(flat, np.array([planar_pose(x, 0.0, 0.0) for x in np.linspace(5.5, 6.5, 41)]))
    assert made.status == PathStatus.INCOMPLETE
    assert [one.index for one in made.unreachable] == list(range(21, 41))
    assert all(one.proven and "beyond reach" in one.reason for one in made.unreachable)
    assert np.isfinite(made.q[:21]).all() and np.isnan(made.q[21:]).all()


def test_a_path_begins_and_ends_where_it_is_asked_to(arm):
    rng = np.random.default_rng(11)
    a, b = arm.random_q(rng), arm.random_q(rng)
    T = between(arm, a, b, 50)
    made = ik.solve_path(arm, T, q0=a, q_end=b, free_turn=(0.0, 0.0, 1.0))
    assert made.success
    assert np.abs(made.q[0] - a).max() < 1e-5 and np.abs(made.q[-1] - b).max() < 1e-5


def test_mistakes_are_named(arm):
    T = between(arm, arm.home, arm.home + 0.1, 5)
    with pytest.raises(InvalidOption, match="reconfigurations is 'fewest'"):
        ik.solve_path(arm, T, reconfigurations="few")
    with pytest.raises(InvalidOption, match="max_step must be"):
        ik.solve_path(arm, T, max_step=(0.1, -1.0))
    with pytest.raises(InvalidOption, match="takes no 'closest'"):
        ik.solve_path(arm, T, closest=True)
    with pytest.raises(InvalidTarget, match="at least one pose"):
        ik.solve_path(arm, T[:0])
    with pytest.raises(InvalidConfiguration, match="q0"):
        ik.solve_path(arm, T, q0=[1.0])
    T[3, :3, :3] *= 2.0
    with pytest.raises(InvalidTarget, match="target 3"):
        ik.solve_path(arm, T)
