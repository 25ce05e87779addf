"""Timed paths: limits hold at every instant, on the verified curve, with stops where the branch changes."""

import functools
import itertools
import json

import motions
import numpy as np
import pytest
import trees

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidOption, NotSolved
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.paths.contact import connect
from ik_toolkit.paths.continuity import interpolate_poses
from ik_toolkit.paths.result import PathStatus
from ik_toolkit.paths.smooth_curve import sagittas
from ik_toolkit.paths.timing import through

pytest.importorskip("scipy")


@functools.cache
def retimed(name, count=40, acceleration=2.0):
    robot = ik.Tree.load(trees.mixed(), tips=["left_tip", "right_tip"]) if name == "two arms" else motions.load(name)
    result = motions.as_result(robot, motions.wave(robot, count))
    velocity = np.linspace(0.5, 1.5, robot.n)
    return result, result.retime(velocity, acceleration)


ROBOTS = ["hydrolek_7w", "planar_3r", "inspection_7dof", "two arms"]


@pytest.mark.parametrize("name", ROBOTS)
def test_limits_hold_when_sampled_ten_times_finer(name):
    result, made = retimed(name)
    t = np.linspace(0.0, made.duration, 10 * len(made.t))
    q, dq, ddq = made.at(t)
    assert (np.abs(dq) <= made.velocity * (1.0 + 1e-9)).all()
    assert (np.abs(ddq) <= made.acceleration * (1.0 + 1e-9)).all()
    assert (q >= result.robot.lower - 1e-9).all() and (q <= result.robot.upper + 1e-9).all()
    # Least time: at nearly every instant one joint is at a limit.
    busy = np.maximum((np.abs(dq) / made.velocity).max(axis=1), (np.abs(ddq) / made.acceleration).max(axis=1))
    assert np.median(busy) > 0.9


@pytest.mark.parametrize("name", ROBOTS)
def test_rates_and_accelerations_are_those_of_the_joints(name):
    _, made = retimed(name)
    h = 1e-5
    inside = np.random.default_rng(0).uniform(h, made.duration - h, 200)
    q, dq, _ = made.at(inside)
    (before, _, _), (after, _, _) = made.at(inside - h), made.at(inside + h)
    np.testing.assert_allclose((after - before) / (2.0 * h), dq, atol=2e-5)
    np.testing.assert_allclose(made.dq[[0, -1]], 0.0, atol=1e-6)
    assert made.t[0] == 0.0 and np.ptp(np.diff(made.t)[:-1]) < 1e-9 and made.t[-1] == made.duration


@pytest.mark.parametrize("name", ["hydrolek_7w", "planar_3r"])
def test_the_tip_stays_as_near_to_the_poses_as_is_said(name):
    result, made = retimed(name)
    within = np.maximum(result.path_tolerance, sagittas(result.targets, result.kinds).max(axis=1))
    assert (made.deviation <= within).all()
    tight = result.retime(np.linspace(0.5, 1.5, result.robot.n), 2.0, path_tolerance=result.path_tolerance)
    assert tight.success and not tight.stops and (np.array(tight.deviation) <= result.path_tolerance).all()
    # Joints and poses are functions of one parameter, so at a place the tip is where that pose is.
    for q, place in zip(made.q, made.place, strict=True):
        position, angle = result.robot.errors(
            q, interpolate_poses(result.targets, np.array([place]), result.kinds)[0, 0]
        )
        assert position <= made.deviation[0] and angle <= made.deviation[1]


def test_a_corner_is_rounded_within_the_tolerance():
    """The tip turns by a right angle at a pose: poses are inserted around it until the curve keeps to the path."""
    robot = motions.load("planar_3r")
    u = np.linspace(0.0, 0.4, 21)
    corner = np.column_stack([-np.minimum(u, 0.2), np.maximum(u - 0.2, 0.0), np.zeros(21)])
    T = motions.moved(robot.fk(robot.home).homogeneous, corner)[:, None]
    q = motions.followed(motions.plan_for(robot), KIND.position, T)
    result = motions.as_result(robot, q, kind=KIND.position)
    made = result.retime(1.0, 1.0)
    assert made.success and len(made.pieces) == 1 and made.deviation[0] <= 1e-3
    assert repr(made) == f"Trajectory({len(made.t)} samples, {made.duration:.4g} s, {robot.n} joints)"


def test_the_robot_stops_where_the_branch_changes_and_moves_freely_to_the_other():
    robot = motions.load("hydrolek_7w")
    q = motions.wave(robot)
    result = motions.as_result(robot, q, breaks=[19])
    made = result.retime(1.0, 2.0)
    assert made.success and len(made.pieces) == 3
    free = np.isnan(made.place)
    assert free.any() and (np.diff(np.flatnonzero(free)) == 1).all()
    ends = np.cumsum([piece.duration for piece in made.pieces])
    at, rates, _ = made.at(ends)
    np.testing.assert_allclose(at, q[[19, 20, -1]], atol=1e-9)
    np.testing.assert_allclose(rates, 0.0, atol=1e-6)


POST = """
<robot name="boom"><link name="base"/>
<link name="column"/><joint name="turn" type="revolute"><parent link="base"/><child link="column"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<link name="boom"><collision><origin xyz="0.4 0 0"/><geometry><box size="0.8 0.05 0.05"/></geometry></collision></link>
<joint name="lift" type="revolute"><parent link="column"/><child link="boom"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>
<link name="tip"/><joint name="end" type="fixed"><parent link="boom"/><child link="tip"/><origin xyz="0.8 0 0"/></joint></robot>
"""


def test_a_free_motion_goes_around_what_stands_between():
    robot = ik.Robot.load(POST)
    model = ik.CollisionModel(robot).add_box((0.1, 0.1, 0.8), (0.6, 0.0, 0.0), name="post")
    a, b = np.array([-0.5, 0.0]), np.array([0.5, 0.0])
    for seed in (7, 0):  # the two search trees meet when the one from b grows, or the one from a
        way = connect(robot, model, a, b, seed=seed)
        np.testing.assert_array_equal(way[[0, -1]], [a, b])
    assert len(way) > 2
    for start, end in itertools.pairwise(way):
        assert not any(model.collides(start + s * (end - start)) for s in np.linspace(0.0, 1.0, 200))
    np.testing.assert_array_equal(way, connect(robot, model, a, b, seed=0))
    steps = np.outer(np.linspace(-0.2, 0.2, 9), [1.0, 0.3])
    q = np.vstack([a + steps[:5], b + steps[4:]])
    made = motions.as_result(robot, q, breaks=[4], collision=model, kind=KIND.position).retime(1.0, 1.0)
    assert made.success and not any(model.collides(row) for row in made.q)
    slow = motions.as_result(robot, q, breaks=[4], collision=model, kind=KIND.position).retime(1.0, 1.0, tip_speed=0.05)
    xyz = robot.chain.forward(slow.at(np.linspace(0.0, slow.duration, 20_001))[0])[0][:, :3, 3]
    assert np.linalg.norm(np.diff(xyz, axis=0), axis=1).max() < 1.002 * 0.05 * slow.duration / 20_000
    assert "the tip keeps 0.05 m/s on the path except from" in slow.message
    alone = motions.as_result(robot, q[:1], collision=model, kind=KIND.position).retime(1.0, 1.0)
    for motion in (made, through(robot, q[[0, -1]], 1.0, 1.0, collision=model), alone):
        least = min(model.distance(row).distance for row in motion.at(np.linspace(0.0, motion.duration, 2000))[0])
        assert 0.8 * least < motion.clearance < least + 1e-6


def test_it_is_said_when_there_is_no_free_motion(monkeypatch):
    monkeypatch.setattr("ik_toolkit.paths.contact.SECONDS", 0.05)
    robot = ik.Robot.load(POST)
    model = ik.CollisionModel(robot).add_box((1.0, 0.1, 2.0), (0.8, 0.0, 0.0))
    q = np.array([[-0.6, 0.0], [-0.55, 0.0], [0.55, 0.0], [0.6, 0.0]])
    made = motions.as_result(robot, q, breaks=[1], collision=model, kind=KIND.position).retime(1.0, 1.0)
    assert not made.success and "no collision-free motion" in made.message and "pose 2" in made.message
    np.testing.assert_allclose(made.q[-1], q[1], atol=1e-9)


def test_what_is_missing_is_said():
    result, made = retimed("hydrolek_7w")
    for write in (result.save, made.to_csv, made.to_json):
        with pytest.raises(InvalidOption, match="must be the path of a file, not 3"):
            write(3)
    failed = type(result)(**{**vars(result), "status": PathStatus.INCOMPLETE})
    with pytest.raises(NotSolved):
        failed.retime(1.0, 1.0)


def test_files_and_references_say_what_the_arrays_do(tmp_path):
    result, made = retimed("hydrolek_7w")
    robot = result.robot
    rows = np.genfromtxt(made.to_csv(tmp_path / "t.csv"), delimiter=",", skip_header=1)
    np.testing.assert_array_equal(rows, np.hstack([made.t[:, None], made.q, made.dq, made.ddq]))
    ros = json.loads(made.to_json(tmp_path / "t.json").read_text())
    assert ros == made.to_ros() and ros["header"]["frame_id"] == robot.base
    assert ros["joint_names"] == list(robot.joint_names) and len(ros["points"]) == len(made.t)
    stamp = ros["points"][-1]["time_from_start"]
    assert stamp["sec"] + 1e-9 * stamp["nanosec"] == pytest.approx(made.duration, abs=1e-9)
    assert ros["points"][3]["velocities"] == made.dq[3].tolist()
    reference = made.to_reference()
    t = np.linspace(0.05, made.duration - 0.05, 30)
    T, V, A = reference.at(t)
    h = 1e-5
    (Tb, Vb, _), (Ta, Va, _) = reference.at(t - h), reference.at(t + h)
    np.testing.assert_allclose((Ta - Tb)[:, :3, 3] / (2 * h), V[:, :3], atol=1e-4)
    smooth = np.abs((Va - Vb) / (2 * h) - A).max(axis=1) < 1e-2  # but where the acceleration itself jumps
    assert smooth.mean() > 0.8
    np.testing.assert_allclose(T[0], robot.fk(made.at(float(t[0]))[0]).homogeneous, atol=1e-9)
    with pytest.raises(FrameNotFound, match="not one of the tips"):
        made.to_reference(np.eye(4))


@pytest.mark.parametrize("name", ["hydrolek_7w", "planar_3r"])
def test_poses_that_repeat_and_joints_at_their_limits_need_no_stop(name):
    robot = motions.load(name)
    q = np.repeat(motions.wave(robot, 20), 2, axis=0)
    q[:, 0] = np.minimum(q[:, 0] + 0.6 * (robot.upper[0] - q[:, 0].max()) + 0.05, robot.upper[0])
    result = motions.as_result(robot, q, kind=KIND.position)
    made = result.retime(1.0, 2.0)
    assert len(made.pieces) == 1 and "stops" not in made.message
    assert (made.at(np.linspace(0.0, made.duration, 5000))[0] <= robot.upper + 1e-9).all()
    alone = motions.as_result(robot, q, breaks=[0], kind=KIND.position).retime(1.0, 2.0)
    assert "stops" not in alone.message  # the first pose alone is a piece of its own, in which nothing moves


def test_a_motion_that_stays_where_it_is_takes_no_time_and_has_no_rates():
    result, _ = retimed("planar_3r")
    T = np.repeat(result.targets[:1, 0], 3, axis=0)
    for poses in (T[:1], T):
        path = ik.solve_path(result.robot, poses, q0=result.q[0])
        made = path.retime(1.0, acceleration=1.0)
        assert made.success and made.duration == 0.0
        for values in (made.dq, made.ddq, *made.at([-1.0, 0.0, 1.0])[1:]):
            assert (values == 0.0).all()
        assert (made.q == path.q[0]).all() and (made.at([-1.0, 0.0, 1.0])[0] == path.q[0]).all()
        said = "the pose is" if len(poses) == 1 else "all 3 poses are"
        assert made.message == f"{said} passed in 0 s" and not made.stops


def test_not_even_a_hair_beyond_a_limit():
    """Between two rows at the limit the smooth spline swings out by 5e-11 rad."""
    robot = ik.Robot.load("planar_2r")
    Q = np.column_stack([np.linspace(0.1, 0.4, 4), robot.upper[1] - np.array([4e-10, 0.0, 0.0, 4e-10])])
    made = motions.as_result(robot, Q).retime(acceleration=2.0)
    assert (made.at(np.linspace(0.0, made.duration, 500))[0] <= robot.upper).all()


def test_only_the_first_of_many_stops_are_listed(monkeypatch):
    monkeypatch.setattr("ik_toolkit.paths.timing.smooth_curve", lambda *_: None)
    robot = ik.Robot.load("planar_3r")
    path = ik.solve_path(robot, [robot.fk(robot.home + k * 0.03).translation for k in range(8)], q0=robot.home)
    made = path.retime(1.0, acceleration=1.0)
    assert (
        f"it stops at pose {made.stops[0]:g}, {made.stops[1]:g}, {made.stops[2]:g} and {len(made.stops) - 3} more"
        in made.message
    )


def test_a_motion_through_configurations_is_at_rest_at_each():
    robot = ik.Robot.load("planar_3r")
    Q = robot.home + np.array([[0.0, 0.0, 0.0], [0.4, -0.2, 0.1], [0.1, 0.3, -0.2]])
    made = through(robot, Q, 1.0, 2.0)
    assert made.success and "all 3 configurations" in made.message
    for k, q in enumerate(Q):
        t = np.interp(k, made.place, made.t)
        at, rate, _ = made.at(t)
        np.testing.assert_allclose(at, q, atol=1e-6)
        assert np.abs(rate).max() < 5e-3
    assert np.abs(made.dq).max() <= 1.0 + 1e-9 and np.abs(made.ddq).max() <= 2.0 + 1e-9
    alone = through(robot, Q[1:2], 1.0, 2.0)
    assert alone.duration == 0.0 and (alone.q == Q[1]).all()
    with pytest.raises(InvalidOption, match="no configuration"):
        through(robot, [], 1.0, 2.0)
