"""What the result of a path claims beyond its motion: how few reconfigurations there can be, and that contact is ruled out."""

import numpy as np
import pinocchio as pin
import pytest
from motions import between
from robots import load, planar_pose, urdf

import ik_toolkit as ik
from ik_toolkit.paths.result import PathStatus

WOUND = urdf(
    dict(kind="revolute", xyz="0 0 0", limits=(-1.0, 1.0)),
    dict(kind="revolute", xyz="1 0 0", limits=(-1.0, 1.0)),
    dict(kind="revolute", xyz="1 0 0", limits=(-3.5, 3.5)),
)


def flat_arm(*lengths, radius=0.0, links=()):
    """A planar arm of links of these lengths, with a ball around the origin of some of them (l1, ... from the first joint on)."""
    joints = [dict(kind="revolute", xyz=f"{x} 0 0") for x in (0, *lengths[:-1])]
    text = urdf(*joints, dict(kind="fixed", xyz=f"{lengths[-1]} 0 0"))
    for link in links:
        ball = f'<collision><geometry><sphere radius="{radius}"/></geometry></collision>'
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{ball}</link>')
    return ik.Robot.load(text)


def spun(degrees):
    """Path of a tip that turns on the spot, by an arm whose last joint has 401 degrees."""
    return ik.solve_path(ik.Robot.load(WOUND), np.array([planar_pose(1.8, 0.1, x) for x in np.radians(degrees)]))


# ------------------------------------------------------------------------------------------------- how few there can be
def test_fewest_is_called_proven_only_where_the_bound_is_the_number():
    """The last joint has 401 degrees: 340 take one piece if it starts a turn back, and 800 take three."""
    whole = spun(np.linspace(170.0, 510.0, 137))
    assert whole.success and not whole.reconfigurations and whole.lower_bound == 0
    dense = spun(np.arange(0.0, 801.0, 2.5))
    for made in (whole, dense):
        assert (made.q >= made.robot.lower).all() and (made.q <= made.robot.upper).all()
    assert dense.status == PathStatus.RECONFIGURES and len(dense.reconfigurations) == 2 == dense.lower_bound
    assert "with 2 reconfigurations (provably the fewest), after pose" in dense.message
    # Between poses far apart several breaks would count as one, so no more than one is proven to be needed.
    coarse = spun(np.arange(0.0, 801.0, 100.0))
    assert coarse.status == PathStatus.RECONFIGURES and len(coarse.reconfigurations) == 2
    assert coarse.lower_bound in (0, 1) and "with 2 reconfigurations (the fewest found), after pose" in coarse.message


def test_nothing_is_proven_where_a_turn_between_two_poses_may_go_either_way():
    """At the end it turns by 180 degrees from one pose to the next."""
    degrees = [*np.arange(0.0, 451.0, 2.5), 630.0]
    either = spun(degrees)
    robot = ik.Robot.load(WOUND)
    for q, x in zip(either.q, np.radians(degrees), strict=True):
        assert max(robot.errors(q, planar_pose(1.8, 0.1, x))) < 1e-5
    assert either.status == PathStatus.RECONFIGURES and len(either.reconfigurations) == 1
    assert either.lower_bound is None and "with 1 reconfiguration (the fewest found), after pose" in either.message


# ------------------------------------------------------------------------------------------------------------- contact
def test_a_motion_too_close_to_rule_out_contact_is_said_to_be():
    """A plate over an arm that moves in a plane: the gap of its ball is the same all the way."""
    robot = flat_arm(0.7, 0.7, 1.0, radius=0.05, links=["l4"])
    points = between(robot, [0.3, 0.8, 0.5], [0.302, 0.802, 0.5], 2)[:, :3, 3]
    for gap, proven in ((5e-5, False), (5e-4, True)):
        model = ik.CollisionModel(robot).add_box((9.0, 9.0, 0.01), (0.0, 0.0, 0.055 + gap), name="plate")
        made = ik.solve_path(robot, points, avoid_collisions=model)
        assert made.status == PathStatus.FOLLOWED and not made.continuity.contacts
        places = made.continuity.unproven
        assert (not places) == proven and (made.continuity.clearance > 0.0) == proven
        told = f"; at {len(places)} place{'s' * (len(places) != 1)} shapes are too close to rule out contact"
        assert made.message.endswith("rad" if proven else told)


def test_the_clearance_of_a_single_pose_is_the_distance_there():
    robot = flat_arm(1.0, 1.0, radius=0.05, links=["l3"])
    model = ik.CollisionModel(robot).add_box((9.0, 9.0, 0.01), (0.0, 0.0, 0.3), name="plate")
    made = ik.solve_path(robot, robot.fk([0.3, 0.8]).translation[None], avoid_collisions=model)
    assert made.status == PathStatus.FOLLOWED and made.clearance == pytest.approx(0.3 - 0.005 - 0.05, abs=1e-6)


# ---------------------------------------------------------------------------------------------------------- held joints
def test_a_path_holds_joints_of_weight_0_where_its_start_has_them():
    """One of them is the lift, a prismatic joint."""
    robot, held = load("inspection_7dof"), [1, 6]
    weights = [0 if j in held else 1 for j in range(7)]
    for start in (robot.home + 0.03, robot.home):
        end = start + np.array([0.2, 0.0, 0.1, -0.1, 0.2, 0.1, 0.0])
        points = between(robot, start, end, 8)[:, :3, 3]
        given = None if start is robot.home else start
        made = ik.solve_path(robot, points, q0=given, joint_weights=weights)
        assert made.success and np.abs(made.q[:, held] - start[held]).max() < 1e-12


def test_a_reference_of_positions_is_followed():
    robot = load("planar_2r")
    points = between(robot, [0.3, 0.8], [0.5, 1.0], 2)[:, :3, 3]
    made = ik.solve_path(robot, ik.line(*points, duration=0.1))
    assert made.status == PathStatus.FOLLOWED and len(made.q) == 11
    assert np.allclose([robot.fk(q).translation for q in made.q], np.linspace(*points, 11), atol=1e-6)


# ---------------------------------------------------------------------------------------------------------- the sentence
def test_a_motion_is_told_by_its_length():
    flat, slides = load("planar_2r"), load("cartesian_pp")
    points = between(flat, [0.3, 0.8], [0.5, 1.0], 3)[:, :3, 3]
    made = ik.solve_path(flat, points)
    assert made.message == f"3 poses followed in one motion of {made.length[0]:.3g} rad" and made.length[1] == 0.0
    assert ik.solve_path(flat, points[:1]).message == "1 pose followed in one motion of 0 rad"
    points = between(slides, slides.home, slides.home + 0.02, 3)[:, :3, 3]
    made = ik.solve_path(slides, points)
    assert (
        made.message == f"3 poses followed in one motion of 0 rad and {made.length[1]:.3g} m" and made.length[1] > 0.0
    )


def test_a_path_that_only_collides_says_what_touches_and_where():
    robot = flat_arm(1.0, 1.0, radius=0.05, links=["l3"])
    points = between(robot, [0.3, 0.8], [0.5, 1.0], 5)[:, :3, 3]
    model = ik.CollisionModel(robot).add_sphere(0.02, points[2], name="post")
    made = ik.solve_path(robot, points, avoid_collisions=model)
    assert made.status == PathStatus.COLLISION and not made.success and made.clearance == 0.0
    touch = made.continuity.contacts[0]
    assert set(touch.pair) == {"l3", "post"} and 1.0 < touch.place < 2.5
    where = f"{' and '.join(touch.pair)} touch at pose {round(touch.place, 3):g}"
    assert made.message == f"5 poses followed, but only in collision ({where}); move the poses or the obstacle"


# ------------------------------------------------------------------------------------------------- places and distances
def test_a_contact_between_poses_far_apart_is_placed_between_them():
    robot = flat_arm(1.0, 1.0, radius=0.05, links=["l3"])
    ends = between(robot, [0.3, 0.8], [0.5, 1.0], 2)[:, :3, 3]
    model = ik.CollisionModel(robot).add_sphere(0.02, 0.5 * (ends[0] + ends[1]), name="post")
    made = ik.solve_path(robot, ends, avoid_collisions=model)
    assert len(made.at) > 3 and made.status == PathStatus.COLLISION
    assert all(0.2 < touch.place < 0.8 for touch in made.continuity.contacts)


def test_joints_that_move_two_links_alike_take_nothing_from_their_clearance():
    robot = flat_arm(1.0, 1.0, 0.5, radius=0.1, links=["l1", "l2", "l3", "l4"])
    model = ik.CollisionModel(robot)
    made = ik.solve_path(robot, between(robot, [0.0, 1.0, 0.5], [0.6, 1.0, 0.5], 25), avoid_collisions=model)
    assert made.status == PathStatus.FOLLOWED and np.ptp(made.q[:, 1:], axis=0).max() < 1e-5
    assert made.clearance == pytest.approx(model.distance(made.q[0]).distance, abs=1e-3)


# --------------------------------------------------------------------------------------------------------------- in time
@pytest.mark.parametrize("speed", [0.05, 0.3, 5.0])
def test_a_straight_motion_takes_the_time_it_must(speed):
    """One slide moves: full acceleration, full speed, full braking, or no full speed where the way is short."""
    robot, gain = load("cartesian_pp"), 0.8
    ends = robot.home + np.array([[-0.1, 0.0], [0.1, 0.0]])
    points = between(robot, *ends, 21)[:, :3, 3]
    made = ik.solve_path(robot, points).retime(velocity=speed, acceleration=gain)
    way = 0.2
    least = way / speed + speed / gain if speed**2 / gain < way else 2.0 * np.sqrt(way / gain)
    assert made.success and least * (1.0 - 1e-6) <= made.duration <= 1.02 * least
    assert f"all 21 poses are passed in {made.duration:.4g} s" in made.message
    t = np.linspace(0.0, made.duration, 500)
    q, dq, ddq = made.at(t)
    assert np.abs(dq).max() <= speed * (1 + 1e-9) and np.abs(ddq).max() <= gain * (1 + 1e-9)
    assert np.abs(np.gradient(q, t, axis=0) - dq)[2:-2].max() < 2e-3 * max(speed, 0.1) + gain * t[1]


# ------------------------------------------------------------------------------------------------------- what was asked
@pytest.mark.parametrize("axis", range(3))
def test_poses_less_than_half_a_turn_apart_stay_as_they_are(axis):
    robot = load("hydrolek_7w")
    T = np.tile(robot.fk(robot.home).homogeneous, (2, 1, 1))
    T[1, :3, :3] = T[0, :3, :3] @ pin.exp3(np.radians(150.0) * np.eye(3)[axis])
    assert np.abs(ik.solve_path(robot, T, q0=robot.home).targets[:, 0] - T).max() < 1e-12


@pytest.mark.parametrize("avoid", [False, True])
def test_a_path_of_which_nothing_is_reached_is_a_result(avoid):
    robot = load("hydrolek_7w")
    T = np.tile(robot.fk(robot.home).homogeneous, (3, 1, 1))
    T[:, :3, 3] *= 9.0
    found = ik.solve_path(robot, T, avoid_collisions=avoid)
    assert found.status is PathStatus.INCOMPLETE and np.isnan(found.q).all() and "0 of 3 poses reached" in found.message
