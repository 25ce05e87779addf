"""The EAIK adapter: its solutions through our call, evaluated again, inside the limits, nearest q0."""

import importlib.util
import sys

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, MissingExtra, UnknownSolver

INSTALLED = importlib.util.find_spec("eaik") is not None
needs_eaik = pytest.mark.skipif(not INSTALLED, reason="EAIK is not installed (extra 'analytic')")
ARMS = ["locked", *(["ur5", "kinova", "z1"] if robots.have_data() else [])]


def test_without_the_package_it_says_what_to_install(monkeypatch):
    from ik_toolkit.solvers.closed_form import eaik

    for name in ("eaik", "eaik.IK_HP"):
        monkeypatch.setitem(sys.modules, name, None)
    eaik._arm.cache_clear()
    robot = robots.load("locked")
    with pytest.raises(MissingExtra, match=r"(?i)pip install eaik"):
        ik.solve(robot, robot.fk(robot.home), "eaik")
    assert ik.solve(robot, robot.fk(robot.home)).success  # nothing else needs it


@needs_eaik
@pytest.mark.parametrize("name", ARMS)
def test_random_poses_are_solved_and_the_first_configuration_is_among_the_branches(name):
    robot = robots.load(name)
    Q, T = robots.sample(robot, 200, seed=5)
    batch = ik.solve_batch(robot, T, "eaik", check=1.0, tolerance=1e-9)
    assert batch.success.mean() > 0.99  # near a singular pose EAIK's own answer is off by more, and that is said
    assert (batch.q >= robot.lower).all() and (batch.q <= robot.upper).all()
    found = 0
    for q, pose in zip(Q[:50], T[:50], strict=True):
        every = ik.solve_all(robot, pose, "eaik", q0=q)
        found += len(every.q) > 0 and np.abs(every.q[0] - q).max() < 1e-6
    assert found >= 49


@needs_eaik
def test_it_agrees_with_our_own_closed_form():
    robot = robots.load("locked")
    _, T = robots.sample(robot, 30, seed=2)
    for pose in T:
        ours, theirs = ik.solve_all(robot, pose, "inspection"), ik.solve_all(robot, pose, "eaik")
        assert len(ours.q) == len(theirs.q)
        assert np.allclose(ours.q, theirs.q, atol=1e-6)


@needs_eaik
def test_a_pose_out_of_reach_and_a_position():
    robot = robots.load("locked")
    T = robot.fk(robot.home).homogeneous
    far = T.copy()
    far[:3, 3] += 50.0
    lost = ik.solve(robot, far, "eaik")
    assert lost.status == ik.Status.UNREACHABLE and "out of reach" in lost.message and np.isfinite(lost.q).all()
    with pytest.raises(InvalidOption, match="positions"):
        ik.solve(robot, T[:3, 3], "eaik")


@needs_eaik
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("planar_3r", "3 joints"),
        ("mimic_mix", "mimic"),
        ("hydrolek_7w", "no decomposition"),
        ("inspection_7dof", "7 joints"),
    ],
)
def test_robots_it_does_not_fit(name, words):
    robot = robots.load(name)
    with pytest.raises(UnknownSolver, match=words):
        ik.solve(robot, robot.fk(robot.home), "eaik")
