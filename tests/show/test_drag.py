"""Targets dragged in the panel and in `ik view --follow`: the arm follows as far as it can."""

import json

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidTarget
from ik_toolkit.show.panel.drag_follower import Hand
from ik_toolkit.show.panel.session import Session

ROBOT = "hydrolek_7w"  # of the panel, see conftest.py


@pytest.mark.parametrize("robot", ["hydrolek_7w", "planar_2r", "inspection_7dof"])
def test_a_dragged_target_out_of_reach_is_followed_to_the_closest_pose(robot):
    """A position moved away step by step: the arm stays as near as it can, and returns with the target."""
    session = Session(robot)
    arm, start = session.robot, session.robot.fk(session.q).translation.copy()
    way = np.array([1.0, 0.4, 0.0]) / np.hypot(1.0, 0.4)
    for far in (0.05, 0.3, 0.6, 1.5, 3.0):
        target = start + far * arm.reach * way
        assert any(session.follow(target).settled for _ in range(60)), far
        best = min(ik.solve(arm, target, q0=q).position_error for q in (session.q, arm.home))
        assert session.poses()[arm.tip].shape == (4, 4)
        left = session.followed.errors[arm.tip][0]
        assert left < 1.02 * best + 1e-5, (far, left, best)
        assert session.followed.success == (left < 1e-6)
    assert "the closest pose is" in session.followed.message
    assert any(session.follow(start).settled for _ in range(60))
    assert session.followed.success and "converged" in session.followed.message
    with pytest.raises(InvalidTarget, match="1000 times the reach"):
        session.follow(start + 1e200)


@pytest.mark.parametrize("name", ["hydrolek_7w", "panda"])
def test_a_target_that_only_another_posture_reaches_is_reached(name):
    """Dragged in one go from home to poses of random joint values: every one can be reached, and so it is."""
    session = Session(robots.load(name).name)
    rng, changed = np.random.default_rng(1), 0
    for _ in range(16):
        session.q = session.robot.home.copy()
        target = session.poses(session.robot.random_q(rng))[session.robot.tip]
        stiff = Hand(session.robot, session.q, tolerance=1e-6, reconfigure=False)
        at = session.q
        for _ in range(20):
            found = stiff.follow(at, target)
            at = found.q
            if found.settled:
                break
        changed += not found.success
        assert any(session.follow(target).settled for _ in range(20)) and session.followed.success
    assert changed  # a target that every arm reaches as it stands would prove nothing


@pytest.mark.parametrize("seed", [0, 3])
def test_targets_dragged_one_after_the_other_are_all_reached(seed):
    """On the way to a target that jumped the error may grow for a while: the arm has not arrived before its joints rest."""
    arm = ik.Robot.load("hydrolek_7w")
    rng, at, hand = np.random.default_rng(seed), arm.home, Hand(arm, arm.home, tolerance=1e-6)
    for _ in range(8):
        target = arm.fk(arm.random_q(rng)).homogeneous
        for _ in range(20):
            found = hand.follow(at, target)
            assert (np.abs(found.q - at) <= arm.velocity_limits + 1e-9).all()  # a call is one second
            at = found.q
            if found.settled:
                break
        assert found.success, found.message


def test_a_hand_goes_on_where_it_was_and_starts_again_where_it_is_put():
    session = Session("hydrolek_7w")
    arm, start = session.robot, session.robot.home
    far = arm.fk(start).translation + np.array([-0.6, 0.6, 0.2]) * arm.reach
    hand = Hand(arm, start, tolerance=1e-6)
    first = hand.follow(start, far)
    assert not first.settled
    on = hand.follow(first.q, far)
    rest = Hand(arm, start, tolerance=1e-6).follow(start, far)
    assert np.array_equal(first.q, rest.q) and not np.array_equal(first.q, on.q)
    assert np.array_equal(hand.follow(start, far).q, first.q)  # put back: from rest, as at first
    assert hand.follow(start, arm.fk(start).homogeneous).success  # a pose after positions
    session.follow(far)
    kept = session._hand
    session.follow(far)
    assert session._hand is kept
    session.limits = False
    session.follow(far)
    assert session._hand is not kept


def test_what_is_in_the_way_is_named():
    """Not the edge of the arm's reach, where it could go on but for an obstacle."""
    session, place = Session("hydrolek_7w"), np.eye(4)
    goal = session.poses()["tool"]
    goal[:3, 3] += (-0.2, -0.1, -0.1)
    place[:3, 3] = goal[:3, 3]
    name = session.add_box([0.12, 0.12, 0.12], place)
    session.avoid = True
    session.follow(goal)
    assert session.follow(goal).message.endswith(f"from the target: link_6 and {name} would touch")
    assert any(session.follow(goal).settled for _ in range(20)) and not session.contacts()[0]
    assert session.followed.message.startswith("the closest pose is")
    assert session.followed.message.endswith(f"away: link_6 and {name} would touch")
    session.avoid = False
    assert any(session.follow(goal).settled for _ in range(20)) and "touch" not in session.followed.message


def test_a_drag_is_told_apart_from_a_solve():
    session = Session("hydrolek_7w")
    goal = session.poses()["tool"]
    goal[2, 3] += 0.02
    assert session.follow(goal).success and session.result is None
    assert list(dict(session.figures())) == ["tool"] and "converged" in json.loads(session.to_json())["followed"]
    assert session.solve(goal).success and session.followed is None


# --------------------------------------------------------------------------------------------------------------- desk
pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")


def test_dragging_follows(desk):
    q = np.clip(desk.session.q + 0.05, desk.session.robot.lower, desk.session.robot.upper)
    T = desk.session.robot.fk(q).homogeneous
    desk.stage.handles[0].put(T)
    desk._dragged()
    assert np.allclose(desk.stage.tips[0].position, T[:3, 3], atol=1e-5)
    assert np.allclose([float(x) for x in desk.goals[0].xyz.value.split()], T[:3, 3], atol=1e-5)
    desk.live = False
    kept = np.array(desk.stage.tips[0].position)
    desk.stage.handles[0].gizmo.position = (0.7, 0.1, 0.1)
    desk._dragged()
    assert np.array_equal(desk.stage.tips[0].position, kept) and desk.goals[0].xyz.value.startswith("0.7")


def test_a_target_dragged_out_of_reach_is_joined_to_the_tip_by_a_line(desk):
    T = desk.session.poses()["tool"]
    T[:3, 3] += (0.6, 0.2, 0.1)
    desk.goals[0].give("free")
    desk.stage.handles[0].put(T)
    before = desk.session.q.copy()
    desk._dragged(0)
    assert desk.worker.idle() and np.abs(desk.session.q - before).max() > 0.05
    points = desk.stage.lines["gap"].points[0]
    assert np.allclose(points[1], T[:3, 3], atol=1e-5)
    assert np.allclose(points[0], desk.stage.tips[0].position, atol=1e-5)
    for _ in range(20):
        desk._dragged(0)
    assert "The closest pose is" in desk.status.content and "tool" in desk.outcome.content
    desk._home()
    assert "gap" not in desk.stage.lines
    desk._dragged(0)
    assert "Converged" in desk.status.content


def test_the_page_of_view_follow_has_a_target_to_drag(panel):
    from ik_toolkit.show.panel.panel import Follower

    made = Follower(panel.server, "hydrolek_7w")
    assert made.worker.idle()
    try:
        T = made.session.poses()["tool"]
        T[2, 3] += 0.05
        made.stage.handles[0].put(T)
        made._dragged()
        assert "Converged" in made.status.content and np.allclose(made.stage.tips[0].position, T[:3, 3], atol=1e-5)
        assert np.allclose([float(x) for x in made.goals[0].xyz.value.split()], T[:3, 3], atol=1e-5)
        made._home()
        assert np.array_equal(made.session.q, made.session.robot.home)
    finally:
        made.close()


def test_view_follow_serves_that_page(run, monkeypatch):
    from ik_toolkit.cli import view

    served = []
    monkeypatch.setattr(view, "wait", lambda words, url, browse: served.append((words, url)))
    assert run("view", "planar_2r", "--follow", "--no-open")[0] == 0
    assert served[0][0].startswith("the robot is at http")
