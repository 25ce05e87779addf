"""How far a path goes that cannot be followed whole, against geometry and against single solves."""

import numpy as np
import pytest
import robots
from motions import moved

import ik_toolkit as ik
from ik_toolkit.paths.result import PathStatus

EXACT = 5e-3


@pytest.mark.parametrize("end", [1.2, 1.7, 4.0])
def test_a_line_out_of_reach_of_a_planar_arm(end):
    arm = robots.load("planar_2r")
    line = np.array([[0.5 * arm.reach, 0.0, 0.0], [end * arm.reach, 0.0, 0.0]])
    for q0 in (None, ik.solve(arm, line[0]).q):
        path = ik.solve_path(arm, line, q0=q0)
        assert path.status == PathStatus.INCOMPLETE
        assert abs(path.fraction - 0.5 / (end - 0.5)) < 0.1 * EXACT
        assert f"from the start {100 * path.fraction:.3g} % of its length can be followed" in path.message
        assert path.to_dict()["fraction"] == path.fraction
    none = ik.solve_path(arm, line[::-1])
    assert none.fraction == 0.0 and none.message.startswith("1 of 2 poses reached; not pose 0: beyond reach by ")
    assert ik.solve_path(arm, [line[0], 0.8 * line[0]]).fraction == 1.0


@pytest.mark.parametrize(("name", "count"), [("hydrolek_7w", 2), ("inspection_7dof", 7)])
def test_poses_of_an_arm_against_single_solves(name, count):
    """Where the reach ends at all, the motion ends as well; how many poses describe the line does not matter."""
    arm, rng = robots.load(name), np.random.default_rng(4)
    for _ in range(2):
        start, way = arm.fk(arm.random_q(rng)).homogeneous, rng.normal(size=3)
        line = moved(start, np.outer(np.linspace(0.0, 1.2 * arm.reach, 401), way / np.linalg.norm(way)))
        reached = np.flatnonzero(~ik.solve_batch(arm, line).success)[0] / 400
        path = ik.solve_path(arm, line[np.linspace(0, 400, count).round().astype(int)])
        assert path.fraction < reached + EXACT
        assert path.fraction > 0.5 * reached - EXACT


@pytest.mark.parametrize("name", ["hydrolek_7w", "so101"])
def test_with_a_priority_a_path_goes_at_least_as_far(name):
    """However many poses describe the line; a motion of which every level is met counts as well."""
    arm, rng = robots.load(name), np.random.default_rng(6)
    q0 = 0.5 * (arm.random_q(rng) + arm.home)
    start, way = arm.fk(q0).homogeneous, rng.normal(size=3)
    way *= 1.5 * arm.reach / np.linalg.norm(way)
    whole, first = ik.solve_path(arm, moved(start, np.outer([0.0, 1.0], way)), q0=q0).fraction, []
    for count in (2, 9, 150):
        line = moved(start, np.outer(np.linspace(0.0, 1.0, count), way))
        path = ik.solve_path(arm, line, q0=q0, priority="position")
        assert path.status == PathStatus.INCOMPLETE and "joints, and the target fixes" not in path.message
        first.append(path.fraction)
    assert np.ptp(first) < EXACT and min(first) > whole + EXACT


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_a_motion_ends_at_the_first_contact_even_between_the_poses(share):
    """One branch, a short way to the second of three poses; an obstacle is touched at a share of it, and at both poses after it."""
    arm = robots.load("planar_2r").narrowed({"joint_2": (0.0, None)})
    begin = arm.fk(np.array([0.3, 1.0])).translation
    way = arm.fk(np.array([0.31, 1.0])).translation - begin
    q = ik.solve(arm, begin + share * way, q0=[0.3, 1.0]).q
    near = ik.CollisionModel(arm).add_sphere(0.01, begin + 30.0 * way).distance(q).distance
    world = ik.CollisionModel(arm).add_sphere(0.01 + near, begin + 30.0 * way)
    path = ik.solve_path(arm, begin + np.outer([0.0, 1.0, 2.0], way), avoid_collisions=world)
    assert path.status == PathStatus.COLLISION and abs(path.fraction - 0.5 * share) < EXACT


def test_an_arm_with_few_joints_follows_as_far_as_single_solves_reach():
    arm = robots.load("so101")
    line = moved(arm.fk(arm.home).homogeneous, np.outer(np.linspace(0.0, 0.4, 101), [1.0, 0.0, 0.0]))
    reached = np.flatnonzero(~ik.solve_batch(arm, line).success)[0] / 100
    for given in (line[[0, -1]], line[::20]):
        assert abs(ik.solve_path(arm, given, q0=arm.home).fraction - reached) < 2e-2


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("so101", "the arm has 5 joints, and the target fixes 6 directions"),
        ("planar_3r", "the tip's z axis always points along z of the base, and the target's points 17.2 deg from it"),
    ],
)
def test_why_a_pose_is_not_reached_is_said_and_limits_are_not_blamed(name, cause):
    arm = robots.load(name)
    pose = arm.fk(arm.random_q(np.random.default_rng(1))).homogeneous
    pose[:3, :3] = pose[:3, :3] @ ik.pose((0, 0, 0), rpy=(0.3, 0, 0))[:3, :3]
    message = ik.solve_path(arm, [pose, pose]).message
    assert cause in message and "priority" in message and "widen" not in message
