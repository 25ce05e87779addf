"""The panel's Learn tab without a browser: forward, inverse, branches, the free parameter, and errors for wrong input."""

import re

import numpy as np
import pytest
from folders import read_data

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration
from ik_toolkit.papers.shanmugasundar_2012.formulas import PRINTED_POSE, pose_matrix
from ik_toolkit.show.panel.learn_tab import Lesson
from ik_toolkit.show.panel.session import Session

pytest.importorskip("viser", reason="viser is not installed (extra 'panel')")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra 'view')")

ROBOT = "inspection_7dof"  # of the panel, see conftest.py
SAMPLE = read_data("closed_form")["sample"]


def test_the_sample_is_the_papers():
    T = pose_matrix(PRINTED_POSE)
    T[:3, 3] /= 1000.0
    assert np.array_equal(Lesson(Session(ROBOT)).sample().round(9), T.round(9))
    assert Lesson(Session("planar_2r")).sample() is None


def test_forward_is_pinocchios(desk):
    learn, robot = desk.learn, desk.session.robot
    q = robot.random_q(np.random.default_rng(0))
    for i, field in enumerate(learn.values):
        field.value = learn.lesson.scale(i) * q[i]
    desk._guard(learn._forward)()
    assert np.allclose(desk.session.q, q) and np.isclose(learn.values[1].value, 1000.0 * q[1], atol=1e-4)
    T = robot.fk(q)
    for x in (*(1000.0 * T.translation), *T.rotation.ravel()):
        assert f"{x:.3f}"[:-1] in learn.pose.content
    learn.values[1].value = float("nan")
    desk._guard(learn._forward)()
    assert "not a finite number" in desk.status.content and np.allclose(desk.session.q, q)
    with pytest.raises(InvalidConfiguration):
        learn.lesson.read([np.inf] * 7, learn.shown)


def test_the_papers_sample_and_its_lifts(desk):
    """The printed pose is brought to a rotation, solved on the nearest lift, and every lift of the slider reaches it."""
    learn, robot = desk.learn, desk.session.robot
    learn._fill(learn.lesson.sample())
    desk._guard(learn._inverse)()
    assert "closed form" in learn.outcome.content.lower() and "rotation" in learn.outcome.content
    goal = learn.lesson.made.targets["tool"]
    assert np.allclose(goal, SAMPLE["projected"], atol=1e-9)
    assert np.allclose(robot.fk(desk.session.q).homogeneous, goal, atol=1e-6)
    (low, high), lifts = learn.lesson.span(), np.array(SAMPLE["lift_intervals"]).ravel()
    assert low == pytest.approx(1000 * lifts[0], abs=1e-3) and high == 440.0  # where the lift's own limit is
    label = learn.lesson.label
    learn.pick(0)
    for lift in np.linspace(low + 5.0, high, 4):
        learn.free.value = lift
        desk._guard(lambda lift=lift: learn._at(lift))()
        assert len(learn.lesson.branches) == 8 == sum(button.visible for button in learn.buttons)
        for branch in learn.lesson.branches:
            assert branch.q[1] == pytest.approx(lift / 1000.0, abs=1e-9)
            assert np.allclose(robot.fk(branch.q).homogeneous, goal, atol=1e-6)
    assert learn.formulas.content.count("<math ") == learn.formulas.content.count("</math>") > 100
    assert label


def test_a_branch_is_shown_and_one_outside_its_limits_only_drawn(desk):
    learn, robot = desk.learn, desk.session.robot
    q = robot.random_q(np.random.default_rng(4))
    desk._guard(lambda: learn._fill(robot.fk(q).homogeneous))()
    desk._guard(learn._inverse)()
    assert len(learn.buttons) == len(learn.lesson.branches) == 8
    for k, branch in enumerate(learn.lesson.branches):
        learn.pick(k)
        assert learn.buttons[k].label.startswith(f"{k + 1}: {branch.label}")
        assert np.allclose(desk.stage.tips[0].position, robot.fk(q).translation, atol=1e-6)
        assert ("only drawn" in desk.status.content) == bool(branch.outside)
        assert np.array_equal(desk.session.q, branch.q) != bool(branch.outside)
        assert branch.label in learn.formulas.content


def test_wrong_input_is_told_in_a_sentence(desk):
    learn, robot = desk.learn, desk.session.robot
    desk._guard(learn._clear)()
    desk._guard(learn._inverse)()
    assert "rotation" in learn.outcome.content and "bug" not in desk.status.content
    T = robot.fk(robot.home).homogeneous
    T[0, 3] = 5.0
    learn._fill(T)
    desk._guard(learn._inverse)()
    assert "out of reach" in learn.outcome.content and " m out of reach" in learn.formulas.content
    assert "gap" in desk.stage.lines
    learn.fields["p"].value = (0.0, float("inf"), 0.0)
    desk._guard(learn._inverse)()
    assert "finite" in learn.outcome.content and "bug" not in desk.status.content


def test_other_robots(desk):
    desk._guard(lambda: desk._switch("planar_2r"))()
    learn = desk.learn
    assert not learn.fields["n"].visible
    learn._fill(ik.pose((0.9, 0.9, 0.0), rpy=(0, 0, 0)))
    desk._guard(learn._inverse)()
    assert [b.label for b in learn.lesson.branches] == ["elbow right (+)", "elbow left (-)"] and learn.free is None
    assert any(handle.visible for handle in desk.stage.shade)  # the other elbow
    assert learn.way.visible and learn.way.label == "Iterations of newton"
    assert re.search(r"Converged in [1-9]\d* iterations", learn.iterations.content)
    desk._guard(lambda: desk._switch("hydrolek_7w"))()
    learn = desk.learn
    learn._fill(desk.session.robot.fk(desk.session.robot.random_q(np.random.default_rng(1))).homogeneous)
    desk._guard(learn._inverse)()
    assert "No closed form" in learn.formulas.content and learn.way.visible and not learn.found.visible
    desk._guard(lambda: desk._switch("brokk_hydrolek"))()
    assert not desk.learn.alone and "bug" not in desk.status.content
