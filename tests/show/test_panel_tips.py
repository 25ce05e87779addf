"""The panel with several tips: a target to drag for each, solved for together."""

import json

import numpy as np
import pytest

from ik_toolkit.errors import InvalidTarget
from ik_toolkit.show.panel.session import NONE, Session

ROBOT = "brokk_hydrolek"  # of the panel, see conftest.py
LEFT, RIGHT = "left_tip", "right_tip"


# ------------------------------------------------------------------------------------------------------------ session
def test_a_session_solves_for_all_tips():
    session = Session("brokk_hydrolek")
    goal = session.random_poses()
    assert session.solve(goal).success
    assert all(np.allclose(session.poses()[tip], goal[tip], atol=1e-5) for tip in (LEFT, RIGHT))
    rows = dict(session.figures())
    assert set(rows) == {"status", LEFT, RIGHT, "iterations", "computed in"} and "rad" in rows[LEFT]
    far = {**goal, RIGHT: np.array([9.0, 0.0, 0.0])}
    assert not session.solve(far).success and session.followed is not None
    assert "free" in dict(session.figures())[RIGHT]
    assert session.follow({LEFT: goal[LEFT]}).success and dict(session.figures())[RIGHT] == NONE
    assert "solutions" in session.solve_all(goal)[0] and len(session.solutions) == len(session.distances) > 2
    made = json.loads(session.to_json())
    assert list(made["tips"]) == [LEFT, RIGHT] and np.allclose(made["target"][LEFT], goal[LEFT])


def test_random_poses_are_others_at_every_call_and_can_be_taken():
    session = Session("brokk_hydrolek")
    first, second = session.random_poses(), session.random_poses()
    assert not np.allclose(first[LEFT], second[LEFT])
    again = Session("brokk_hydrolek")
    assert np.array_equal(again.random_poses()[RIGHT], first[RIGHT])
    single = Session("planar_2r")
    assert single.solve(single.robot.for_tips(single.random_poses())).status.name in ("CONVERGED", "UNREACHABLE")


def test_tips_are_chosen_one_or_several():
    session = Session("brokk_hydrolek", RIGHT)
    assert session.robot.tips == (RIGHT,) and not session.robot.by_tip
    session.load("brokk_hydrolek", [RIGHT, LEFT])
    assert session.robot.tips == (RIGHT, LEFT) and session.robot.by_tip
    assert not {"inspection", "newton", "state-space"} & set(session.choices()) and "dls" in session.choices()
    assert [row[0] for row in session.axes()] == list(session.robot.joint_names)


# --------------------------------------------------------------------------------------------------------------- desk
pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")


def test_dragging_one_target_keeps_the_others(desk):
    before = desk.session.poses()
    T = before[LEFT].copy()
    T[:3, 3] += (0.05, 0.02, 0.03)
    desk.stage.handles[0].put(T)
    desk._dragged()
    after = desk.session.poses()
    assert "Converged" in desk.status.content
    assert np.allclose(after[LEFT], T, atol=1e-5) and np.allclose(after[RIGHT], before[RIGHT], atol=1e-5)
    assert np.allclose(desk.stage.tips[0].position, T[:3, 3], atol=1e-5)
    assert np.allclose([float(x) for x in desk.goals[0].xyz.value.split()], T[:3, 3], atol=1e-5)
    assert LEFT in desk.outcome.content and RIGHT in desk.outcome.content
    assert [handle.name.text for handle in desk.stage.handles] == [LEFT, RIGHT]


def test_every_tip_has_an_orientation_of_its_own(desk):
    desk.goals[1].give("free")
    assert not desk.goals[1].rotation.visible and desk.goals[0].rotation.visible
    assert desk.stage.handles[1].gizmo.disable_rotations and not desk.stage.handles[0].gizmo.disable_rotations
    goal = desk.session.random_poses()
    for one in desk.goals:
        one.put(goal[one.tip])
    desk._guard(desk._solve)()
    assert desk.session.target[LEFT].shape == (4, 4) and desk.session.target[RIGHT].shape == (3,)
    assert "Converged" in desk.status.content and desk.chart.plot.visible
    desk.goals[1].give(NONE)
    assert not desk.stage.handles[1].gizmo.visible and not desk.goals[1].xyz.visible
    desk._guard(desk._solve)()
    assert list(desk.session.target) == [LEFT] and "Converged" in desk.status.content
    desk.goals[0].give(NONE)
    desk._guard(desk._solve)()
    assert "give a target for at least one of" in desk.status.content


def test_units_keep_targets_and_orientations(desk):
    goal = desk.session.random_poses()
    desk.goals[1].give("free")
    for one in desk.goals:
        one.put(goal[one.tip])
    desk._guard(desk._solve)()
    desk._units(False)
    assert [one.kind for one in desk.goals] == ["roll pitch yaw", "free"] and "[rad]" in desk.goals[0].rotation.label
    for one, handle in zip(desk.goals, desk.stage.handles, strict=True):
        assert np.allclose(handle.target[:3, 3], goal[one.tip][:3, 3], atol=1e-5)


def test_random_targets_are_solved_and_solutions_picked(desk):
    before = desk.session.q.copy()
    desk._guard(desk._random)()
    assert "Converged" in desk.status.content and not np.allclose(desk.session.q, before)
    desk._guard(desk._solve_all)()
    assert desk.found.folder.visible and len(desk.session.solutions) > 2
    desk._pick(2)
    assert np.array_equal(desk.session.q, desk.session.solutions[2])
    desk._home()
    assert all(np.allclose(h.target, T) for h, T in zip(desk.stage.handles, desk.session.poses().values(), strict=True))


def test_what_is_typed_wrong_or_dragged_away_is_said(desk):
    desk.goals[1].xyz.value = "1 2"
    desk._guard(desk._solve)()
    assert "takes 3 numbers; got 2" in desk.status.content
    desk.stage.handles[1].gizmo.position = (np.nan, 0.0, 0.0)
    with pytest.raises(InvalidTarget, match="dragged target is not a valid pose"):
        desk._dragged()


def test_tips_are_chosen_in_the_page(desk):
    desk._guard(lambda: desk._switch("brokk_hydrolek", [RIGHT]))()
    assert len(desk.goals) == len(desk.stage.handles) == 1 and desk.stage.handles[0].name is None
    assert "to right_tip, 7 joints" in desk.status.content
    desk._guard(lambda: desk._switch("brokk_hydrolek", [RIGHT, LEFT]))()
    assert [one.tip for one in desk.goals] == [RIGHT, LEFT] and "right_tip and left_tip, 13" in desk.status.content
    desk._guard(lambda: desk._switch("planar_3r"))()
    assert len(desk.goals) == 1 and "planar_3r" in desk.status.content


def test_the_command_takes_several_tips(run, refused, monkeypatch):
    monkeypatch.setattr("ik_toolkit.cli.view.wait", lambda words, url, browse: print(words))
    code, out, _ = run("panel", "brokk_hydrolek", "--tip", LEFT, "--tip", RIGHT, "--no-open")
    assert code == 0 and "http://127.0.0.1:" in out
    twice = refused("panel", "brokk_hydrolek", "--tip", LEFT, "--tip", LEFT, "--no-open")
    assert "each tip can be given only once" in twice
