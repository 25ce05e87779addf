"""What a caller of the rooms of paths can get wrong is refused in words that say what would be right."""

import numpy as np
import pytest
import robots
from motions import between

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget


@pytest.fixture(scope="module")
def flat():
    return robots.load("planar_2r")


@pytest.fixture(scope="module")
def points(flat):
    return between(flat, [0.3, 0.8], [0.5, 1.0], 5)[:, :3, 3]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (dict(restarts=3), "solve_path takes no 'restarts': a path is searched as a whole"),
        (dict(reconfigurations="some"), "reconfigurations must be 'fewest' or 'none', or"),
        (dict(reconfigurations=-1), "reconfigurations must be 'fewest' or 'none', or"),
        (dict(max_step=0.0), "max_step must be one number, or two, above 0, not 0.0"),
        (dict(max_step=(0.1, np.inf)), "max_step must be one number, or two, above 0"),
        (dict(max_step=(0.1, -1.0)), "max_step must be one number, or two, above 0"),
        (dict(max_step=(0.1, 0.1, 0.1)), "max_step must be one number, or two, above 0"),
        (
            dict(path_tolerance=1e-6, position_tolerance=1e-5),
            "path_tolerance must be above position_tolerance, 1e-05 m, the tolerance at the poses; not 1e-06",
        ),
        (
            dict(path_tolerance=(0.1, 1e-6), orientation_tolerance=1e-5),
            "path_tolerance must be above orientation_tolerance, 1e-05 rad, the tolerance at the poses; not 1e-06",
        ),
        (dict(path_tolerance=1e-5, position_tolerance=1e-5), "path_tolerance must be above position_tolerance"),
        (dict(reconfigurations=np.array([1, 2])), "reconfigurations must be 'fewest' or 'none', or"),
        (dict(closest=True), "solve_path takes no 'closest'"),
        (dict(threads=0), "threads must be"),
        (dict(threads="two"), "threads must be"),
        (dict(seed=-1), "seed must be"),
        (dict(seed=1.5), "seed must be"),
        (dict(q0=[1.0]), "q0"),
        (dict(progress=3), "progress must be a function of a fraction and a text"),
    ],
)
def test_options(flat, points, options, said):
    with pytest.raises((InvalidOption, InvalidConfiguration), match=said):
        ik.solve_path(flat, points, **options)


def test_tolerances_between_the_poses_are_twice_those_at_them_at_least(flat, points):
    assert ik.solve_path(flat, points).path_tolerance == (1e-3, np.radians(1.0))
    wide = ik.solve_path(flat, points, position_tolerance=2e-3, orientation_tolerance=0.05)
    assert wide.path_tolerance == (4e-3, 0.1)
    assert ik.solve_path(flat, points, max_step=0.05).max_step == (0.05, 0.05)
    assert ik.solve_path(flat, points, max_step=(0.05, 0.01)).max_step == (0.05, 0.01)
    assert ik.solve_path(flat, points).max_step == (np.radians(7.0), 0.02)


def test_a_path_has_poses(flat):
    with pytest.raises(InvalidTarget, match="a path needs at least one pose"):
        ik.solve_path(flat, np.zeros((0, 3)))
    with pytest.raises(InvalidTarget, match="2"):  # which of them
        ik.solve_path(flat, [[0.1, 0.2, 0.0], [0.1, 0.3, 0.0], [np.nan, 0.0, 0.0]])
    T = np.tile(flat.fk(flat.home).homogeneous, (5, 1, 1))
    T[3, :3, :3] *= 2.0
    with pytest.raises(InvalidTarget, match="target 3"):
        ik.solve_path(flat, T)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "acceleration= is required: one number, or one per joint"),
        (dict(acceleration=0.0), "acceleration of joint 'joint_1' is 0: it must be positive"),
        (dict(acceleration=[1.0, np.inf]), "acceleration of joint 'joint_2' is inf: it must be positive"),
        (dict(acceleration=1.0, velocity=[1.0, -1.0]), "velocity of joint 'joint_2' is -1: it must be positive"),
        (dict(acceleration=[1.0, 1.0, 1.0]), r"acceleration must be one number, or 2, one per joint; not shape \(3,\)"),
        (dict(acceleration=1.0, rate=0.0), "rate"),
        (dict(acceleration=1.0, seed="one"), "seed"),
        (dict(acceleration=1.0, tip_speed=0.0), "tip_speed"),
        (dict(acceleration=1.0, path_tolerance=1e-9), "path_tolerance must be above position_tolerance, 1e-06 m"),
        (dict(acceleration=1.0, path_tolerance=(1.0, -1.0)), "path_tolerance"),
        (dict(acceleration=1.0, rate=1e9), r"rate = 1e\+09 gives .* samples in .*s; at most"),
    ],
)
def test_time_laws(flat, points, options, said):
    made = ik.solve_path(flat, points)
    with pytest.raises(InvalidOption, match=said):
        made.retime(**options)
