"""The panel's further controls, without a browser: undo, random pose, self-motion, limits off, matrices, boxes, collisions."""

import asyncio
import re
from types import SimpleNamespace

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidOption
from ik_toolkit.motion.trajectory import read_motion
from ik_toolkit.show.panel.scene_tab import null_directions, slide
from ik_toolkit.show.panel.session import Session

ROBOT = "hydrolek_7w"  # of the panel, see conftest.py


@pytest.mark.parametrize(
    ("name", "turns", "free"), [("inspection_7dof", True, 1), ("hydrolek_7w", False, 3), ("planar_3r", False, 1)]
)
def test_self_motion_holds_the_tip_and_comes_back(name, turns, free):
    robot = ik.Robot.load(name)
    rng = np.random.default_rng(3)
    q = robot.lower + (0.3 + 0.4 * rng.random(robot.n)) * (robot.upper - robot.lower)
    assert len(null_directions(robot, q, turns)) == free
    along = np.cos(np.arange(robot.n))
    to = slide(robot, q, along, 0.1, turns, True)
    target = robot.fk(q).homogeneous
    position, angle = robot.errors(to, target)
    assert np.abs(to - q).max() > 0.01 and position < 1e-6 and (angle < 1e-6 or not turns)
    if free == 1:
        assert np.allclose(slide(robot, to, along, -0.1, turns, True), q, atol=2e-3)
    end = slide(robot, q, along, 50.0, turns, True)
    assert not robot.outside(end) and robot.errors(end, target)[0] < 1e-6


def test_an_arm_without_freedom_has_no_self_motion():
    robot = ik.Robot.load("hydrolek_7w")
    assert not len(null_directions(robot, robot.home, True))
    assert np.array_equal(slide(robot, robot.home, np.ones(6), 1.0, True, True), robot.home)


@pytest.mark.parametrize("rows", [3, 4])
def test_a_matrix_can_be_typed_as_it_is_printed(rows):
    session = Session("hydrolek_7w")
    T = session.poses()["tool"]
    for text in (str(T[:rows].tolist()), str(T[:rows]), session.words(T, "matrix")[1]):
        assert np.allclose(session.typed("", "matrix", text), T, atol=1e-6)
    for text, words in (("1 2 3", "takes 12 or 16 numbers; got 3"), ("1 x", "not '1 x'"), ("1 " * 12, "rotation")):
        with pytest.raises(ik.IKError, match=words):
            session.typed("", "matrix", text)


def test_limits_that_are_off_are_not_kept():
    session = Session("planar_2r")
    T = session.robot.fk([3.0, 0.5])  # the limits are 150 deg
    assert not session.solve(T).success
    session.limits = False
    assert session.range(0) == (-180.0, 180.0)
    assert session.solve(T).success and session.robot.outside(session.q)
    assert session.follow(T.translation).success


def test_boxes_are_avoided_and_measured():
    session = Session("hydrolek_7w")
    goal = session.poses()["tool"]
    goal[:3, 3] += (0.05, 0.0, 0.02)
    T = np.eye(4)
    T[:3, 3] = goal[:3, 3]
    name = session.add_box([0.3, 0.3, 0.3], T)
    assert session.solve(goal).success
    touching, near = session.contacts()
    assert any(name in pair for pair in touching) and near.distance <= 0.0
    session.avoid = True
    assert session.solve(goal).status.name == "COLLISION"
    session.avoid, session.q = False, session.robot.home.copy()
    T[2, 3] += 5.0
    session.move_box(name, T)
    touching, near = session.contacts()
    assert not touching and near.distance > 0.01
    session.load("hydrolek_7w")  # the same robot anew keeps what is around it
    assert list(session.boxes) == [name] and session.world.obstacles == (name,)
    session.load("planar_2r")
    assert session.boxes == {}


def test_ellipsoids_are_those_of_the_jacobian():
    session = Session("hydrolek_7w")
    axes, radii = session.ellipsoids()["tool"]
    J = session.robot.jacobian(session.q)[:3]
    assert np.allclose(axes @ np.diag(radii**2) @ axes.T, J @ J.T)
    _, radii = Session("planar_2r").ellipsoids()["tool"]
    assert radii.shape == (3,) and radii[2] < 1e-9  # a plane


@pytest.mark.parametrize("name", ["planar_2r", "planar_3r", "hydrolek_7w"])
def test_manipulability_counts_the_directions_in_which_the_tip_can_move(name):
    session = Session(name)
    session.q = session.robot.random_q(np.random.default_rng(4))
    rows = "position" if name == "hydrolek_7w" else (0, 1)  # planar arms move in the xy plane
    wanted = session.robot.manipulability(session.q, rows)
    assert wanted > 1e-3 and np.isclose(session.manipulability()["tool"], wanted, rtol=1e-9)
    session.q = 0.0 * session.q  # stretched
    assert name == "hydrolek_7w" or session.manipulability()["tool"] < 1e-9


# --------------------------------------------------------------------------------------------------------------- desk
pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")


def test_changes_are_undone_one_by_one(desk):
    home, seen = desk.session.q.copy(), []
    for name, job in (("anywhere", desk._anywhere), ("solve", desk._random)):
        desk._post(name, job)
        assert desk.worker.idle()
        seen.append(desk.session.q.copy())
    desk.past._last = "", 0.0
    for k in range(3):  # a slider that is pushed is one change
        desk.sliders[0].value = desk.sliders[0].min + 1.0 + k
        desk._post("joints", desk._moved)
        assert desk.worker.idle()
    for q in (seen[1], seen[0], home):
        desk._undo()
        assert np.array_equal(desk.session.q, q)
    assert np.allclose(desk.stage.handles[0].target, desk.session.poses()["tool"])
    desk._undo()
    assert "nothing to undo" in desk.status.content


def test_self_motion_by_slider(desk):
    q, T = desk.session.q.copy(), desk.session.poses()["tool"]
    desk.push.value = 0.1
    desk._push()
    assert np.array_equal(desk.session.q, q) and "no self-motion" in desk.status.content
    desk.goals[0].give("free")
    desk._push()
    assert not np.allclose(desk.session.q, q) and np.allclose(desk.session.poses()["tool"][:3, 3], T[:3, 3], atol=1e-6)


def test_boxes_in_the_page(desk):
    assert "Clearance" in desk.facts.content and "manipulability" in desk.facts.content
    around = desk.around
    around.size.value = "0.2 0.2 0.2"
    around.add()
    around.ellipsoid.value = True
    (name,) = around.handles
    around.handles[name].position = tuple(desk.stage.tips[0].position)
    around._moved(name)
    assert "In collision" in desk.facts.content and name in desk.facts.content
    assert desk.stage.ellipsoids[0].visible
    desk._again()  # as after a change of units
    assert list(desk.around.handles) == [name] and "In collision" in desk.facts.content
    desk.around.clear()
    assert "Clearance" in desk.facts.content and desk.session.boxes == {}
    for text, said in (("1 2", "the size of the box"), ("1 2 0", "the size of a box must be 3 positive numbers")):
        desk.around.size.value = text
        with pytest.raises(IKError, match=said):
            desk.around.add()
    assert desk.session.boxes == {}


def test_a_new_box_is_clear_of_arm_targets_and_other_boxes(desk):
    session, stage, around = desk.session, desk.stage, desk.around
    rng = np.random.default_rng(5)
    for q in [session.robot.home, *session.robot.random_q(rng, 4)]:
        session.q = q
        desk.show()
        desk._target_to_tip()
        for _ in range(3):
            around.add()
        for name in session.boxes:
            assert all(near.distance > 0.02 for near in session.world.distances(q, within=1.0) if name in near.pair)
        places = [stage.handles[0].gizmo.position, *(box.position for box in around.handles.values())]
        apart = [np.linalg.norm(a - b) for k, a in enumerate(places) for b in places[:k]]
        assert len(places) == 4 and min(apart) > 0.2
        around.clear()


def test_a_target_of_rounded_digits_leaves_its_handle_its_size(desk):
    handle = desk.stage.handles[0]
    size = handle.gizmo.scale
    handle.put(desk.session.poses()["tool"].round(6))  # not quite a rotation
    assert handle.gizmo.scale == size > 0.01 and np.isclose(np.linalg.norm(handle.gizmo.wxyz), 1.0, atol=1e-9)
    desk.around.add()


def test_names_of_objects_are_never_used_twice(desk):
    """A page puts a new object where an earlier one of its name was."""
    seen = set()
    for source in (ROBOT, "planar_3r", ROBOT):
        desk._switch(source)
        desk.around.add()
        desk.stage.ghost(desk.session.robot.lower)
        stage = desk.stage
        new = [*stage.parts, *stage.shade, *stage.tips, *stage.axes, *stage.boxes.values(), stage.handles[0].gizmo]
        names = {one.name for one in new}
        assert len(names) == len(new) and not names & seen
        seen |= names


def test_a_ghost_has_only_the_parts_that_differ(desk):
    stage, session = desk.stage, desk.session
    desk.show()
    q = session.q.copy()
    q[-1] += 0.3  # the last joint turns the last link only
    stage.ghost(q)
    moved = [one.name.rpartition("/")[2] for one in stage.shade if one.visible]
    assert moved and len(moved) < len(stage.shade) and not any("base_link" in name for name in moved)
    session.q = q
    desk.show()  # the robot is where its ghost is
    assert not any(one.visible for one in stage.shade)


def test_a_ball_moves_a_target_in_the_plane_of_the_picture(desk):
    handle = desk.stage.handles[0]
    (entry,) = handle.ball._impl.drag_cb
    place = handle.gizmo.position.copy()

    def event(phase, start, end):
        return SimpleNamespace(phase=phase, start_position=tuple(start), end_position=tuple(end))

    side, up = np.eye(3)[:2]
    rim = place + 0.01 * side
    for phase, end in (("start", rim), ("update", rim + 0.03 * up), ("end", rim + 0.04 * side + 0.05 * up)):
        asyncio.run(entry.callback(event(phase, rim, end)))
    assert desk.worker.idle()
    assert np.allclose(handle.gizmo.position - place, (0.04, 0.05, 0.0)) and "Converged" in desk.status.content
    asyncio.run(entry.callback(event("update", rim, (np.nan, 0.0, 0.0))))
    assert np.isfinite(handle.gizmo.position).all()


def test_every_joint_of_every_solution_is_listed_with_its_unit(desk):
    desk.goals[0].give("free")
    desk._solve_all()
    text, session = desk.found.table.content, desk.session
    assert len(session.solutions) > 1 and text.count("<tr>") == session.robot.n + 2  # numbers, joints, distances
    desk.stage.ghost(session.solutions[1])
    desk._dragged()  # of another target, perhaps: the list and its ghost are gone
    assert not desk.found.folder.visible and not any(one.visible for one in desk.stage.shade)
    for i, name in enumerate(session.robot.joint_names):
        row = text.partition(f"{name} [deg]</td>")[2].partition("</tr>")[0]
        shown = [float(x) for x in re.findall(r">(-?[\d.]+)</td>", row)]
        assert np.allclose(shown, np.degrees([q[i] for q in session.solutions]), atol=0.0051)


def test_recorded_postures_become_a_motion_in_files(desk, tmp_path):
    recorder, session = desk.recorder, desk.session
    recorder.record()
    with pytest.raises(InvalidOption, match="record two postures"):
        recorder.files()
    for q in session.robot.random_q(np.random.default_rng(2), 2):
        session.q = q
        recorder.record()
    words, files = recorder.files()
    assert words.startswith("all 3 configurations are passed in ")
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        t, Q = read_motion(session.robot, tmp_path / name)
        near = [np.abs(Q - q).max(axis=1).min() for q in session.recorded]
        assert t[0] == 0.0 and np.array_equal(Q[0], session.recorded[0]) and np.allclose(Q[-1], session.q, atol=1e-9)
        assert max(near) < 0.02 and not any(session.robot.outside(q) for q in Q)
        rates = np.diff(Q, axis=0) / np.diff(t)[:, None]
        assert (np.abs(rates) < session.robot.velocity_limits * 1.001).all()
    recorder.save()
    assert "configurations are passed" in desk.status.content
    desk._switch("planar_3r")
    assert desk.session.recorded == []


def test_limits_by_checkbox(desk):
    desk._limits(False)
    assert desk.sliders[0].max == 180.0
    desk.sliders[0].value = 170.0
    desk._moved()
    assert np.isclose(desk.session.q[0], np.radians(170.0))
    desk._limits(True)
    assert not desk.session.robot.outside(desk.session.q)


def test_all_solutions_are_those_of_the_method_and_the_tolerance_chosen():
    session = Session("planar_2r")
    target = session.robot.fk(session.q).translation
    session.solve_all(target)
    assert session.branches is not None and sorted(session.branches[:, 1]) == [-1, 1]
    session.solver = "lm"
    words, _ = session.solve_all(target)
    assert "these are all" not in words and len(session.solutions) == 2 and session.branches is None
    beyond = 1.00005 * session.robot.fk([0.0, 0.0]).translation  # 0.1 mm past the stretched arm
    session.solver = "auto"
    assert "no solution" in session.solve_all(beyond)[0]
    session.tolerance = 1e-3
    assert "no solution" not in session.solve_all(beyond)[0] and session.solutions
    session.solver, session.parameters = "dls", {"damping": "fast"}
    with pytest.raises(InvalidOption, match="takes a number"):
        session.solve_all(target)


def test_a_target_that_is_not_typed_keeps_all_its_digits(desk):
    desk._anywhere()
    target = desk.goals[0].typed()
    assert np.array_equal(target, desk.session.poses()["tool"])
    desk._solve()
    assert desk.session.result.iterations == 0  # the arm is there
    desk.goals[0].xyz.value += "1"
    assert not np.array_equal(desk.goals[0].typed(), target)


def test_arms_of_few_joints_are_given_positions_at_first(desk):
    assert desk.goals[0].kind == Session("inspection_7dof").kind == "roll pitch yaw"
    desk._switch("planar_2r")
    assert desk.goals[0].kind == "free"
    desk._solve_all()
    assert len(desk.session.solutions) == 2


def test_a_late_sentence_replaces_only_the_one_it_waits_for(desk):
    desk.say("loading")
    loading = desk.status.content
    desk.say("no such robot")
    desk.say("ready", instead_of=loading)
    assert "no such robot" in desk.status.content
    desk.say("ready", instead_of=desk.status.content)
    assert "ready" in desk.status.content and "no such robot" not in desk.status.content
