"""Which arms the closed forms recognise, and the messages for arms that do not fit."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_arms import apart, drawn

import ik_toolkit as ik
from ik_toolkit.errors import UnknownSolver
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.solvers.closed_form import describe_fit, fits, inspection, planar_2r

PI = math.pi


angle = st.floats(-3.1, 3.1)
length = st.floats(0.05, 2.0)
offset = st.floats(-1.0, 1.0)
triple = st.tuples(offset, offset, offset)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    triple, st.tuples(angle, angle, angle), length, length, angle, angle, offset, offset, st.booleans(), angle, angle
)
def test_any_planar_two_link_arm(xyz, rpy, l1, l2, turn_1, turn_2, rise_1, rise_2, reverse, q1, q2):
    """Any lengths, base pose, angle offsets, height offsets and axis sign: both branches verify and q is among them."""
    joints = [
        ("continuous", xyz, rpy, (0, 0, 1), -1.0, 1.0),
        (
            "continuous",
            (l1 * math.cos(turn_1), l1 * math.sin(turn_1), rise_1),
            (0, 0, 0.3),
            (0, 0, -1 if reverse else 1),
            0.0,
            0.0,
        ),
    ]
    robot = drawn(joints, (l2 * math.cos(turn_2), l2 * math.sin(turn_2), rise_2), (0.1, 0.2, 0.3))
    assert fits(robot, KIND.position) == "planar-2r" and fits(robot, KIND.pose) is None
    q = np.array([q1, q2])
    tip = robot.fk(q).translation
    found = ik.solve_all(robot, tip, q0=q)
    assert found.solver == "planar-2r" and found.complete
    for x in found:
        assert np.linalg.norm(robot.fk(x).translation - tip) < 1e-9
    bend = planar_2r.recognise_planar(robot.chain)[0]
    s2 = abs(math.sin(bend[planar_2r.ANGLES + 2] * q2 + bend[planar_2r.ANGLES + 3]))
    if s2 > 1e-3:
        assert len(found) == 2 and apart([q], found.q).min() < 1e-6


@settings(max_examples=20, deadline=None, derandomize=True)
@given(
    triple, st.tuples(angle, angle, angle), length, length, triple, st.tuples(angle, angle, angle),
    st.lists(st.sampled_from((1, -1)), min_size=7, max_size=7), st.lists(angle, min_size=7, max_size=7), st.booleans(), offset,
)  # fmt: skip
def test_any_arm_of_the_inspection_structure(xyz, rpy, a4, a6, tool, tool_rpy, signs, twist, lift_first, slide):
    """Axis signs, angle offsets, lengths, base, tool and the order of lift and column are read off the geometry."""
    h = PI / 2
    fixed = [
        ((0, 0, 0), (h, 0, 0)),
        ((0, 0, 0), (h, 0, 0)),
        ((a4, 0, 0), (0, 0, 0)),
        ((0, 0, 0), (-h, 0, 0)),
        ((a6, 0, 0), (0, 0, 0)),
    ]
    column = ("continuous", xyz, rpy, (0, 0, signs[0]), -1.0, 1.0)
    lift = ("prismatic", (0, 0, slide), (0, 0, 0.4), (0, 0, signs[1]), -1.0, 1.0)
    joints = [column, lift]
    if lift_first:
        joints = [
            ("prismatic", xyz, rpy, (0, 0, signs[1]), -1.0, 1.0),
            ("continuous", (0, 0, slide), (0, 0, 0.4), (0, 0, signs[0]), 0.0, 0.0),
        ]
    for (where, turned), sign in zip(fixed, signs[2:], strict=True):
        joints.append(("continuous", where, turned, (0, 0, sign), -1.0, 1.0))
    # Flip axes 5 and 7 as whole frames too, and turn the tool anyhow.
    robot = drawn(joints, tool, tool_rpy)
    assert fits(robot, KIND.pose) == "inspection", inspection.recognise(robot.chain)[1]
    q = np.array(twist)
    place = 0 if lift_first else 1
    q[place] = 0.3 * slide
    found = ik.solve_all(robot, robot.fk(q), ik.Inspection(lift=q[place]), q0=q)
    assert len(found) >= 1 and found.complete == (not found.families)
    assert found.position_error.max() < 1e-9 and found.orientation_error.max() < 1e-9


def test_what_does_not_fit_is_said_in_words():
    panda_like = [("revolute", (0, 0, 0.1), (0, 0.7, 0), (0, 0, 1), -1.0, 1.0)] * 7
    wrong = {
        "joints on the path": drawn(panda_like[:3], (0.1, 0, 0)),
        "prismatic": drawn([panda_like[0], ("prismatic", (0, 0, 0), (0, 0, 0), (1, 0, 0), -1.0, 1.0)], (0.1, 0, 0)),
        "not parallel": drawn(panda_like[:2], (0.1, 0, 0)),
        "coincide": drawn([("revolute", (0, 0, 0.1), (0, 0, 0), (0, 0, 1), -1.0, 1.0)] * 2, (0.1, 0, 0)),
        "tip lies on": drawn([("revolute", (0.1, 0, 0), (0, 0, 0), (0, 0, 1), -1.0, 1.0)] * 2, (0, 0, 0.3)),
    }
    for words, robot in wrong.items():
        assert fits(robot, KIND.position) is None
        with pytest.raises(UnknownSolver, match=words):
            ik.solve(robot, [0.1, 0.0, 0.0], "planar-2r")
    robot = drawn(panda_like, (0.1, 0, 0))
    with pytest.raises(UnknownSolver, match="lift"):
        ik.solve(robot, robot.fk(robot.home), "inspection")
    assert ik.solve(robot, robot.fk(robot.home)).solver == "lm"


def bent(angle):
    """A planar arm whose second axis is off parallel by an angle [rad]."""
    joint = ("revolute", (1, 0, 0), (angle, 0, 0), (0, 0, 1), -2.5, 2.5)
    return drawn([("revolute", (0, 0, 0), (0, 0, 0), (0, 0, 1), -2.5, 2.5), joint], (0.8, 0, 0))


def test_an_arm_that_nearly_fits_is_finished_on_the_real_chain_and_proves_nothing():
    robot = bent(3e-5)
    assert fits(robot, KIND.position) == "planar-2r"
    assert "3e-05" in describe_fit(robot) and "exactly" in describe_fit(bent(0.0))
    rng = np.random.default_rng(3)
    for _ in range(50):
        q = robot.random_q(rng)
        result = ik.solve(robot, robot.fk(q).translation, tolerance=1e-8)
        assert result.success and result.solver in ("planar-2r", "lm")
        assert not ik.solve_all(robot, robot.fk(q).translation, tolerance=1e-8).complete
    off = ik.solve(robot, [1.0, 0.5, 0.25])
    assert off.status not in (ik.Status.CONVERGED, ik.Status.UNREACHABLE)
    assert fits(bent(1e-3), KIND.position) is None
    with pytest.raises(UnknownSolver, match="not parallel"):
        ik.solve(bent(1e-3), [1.0, 0.5, 0.0], "planar-2r")


def test_an_inspection_arm_written_with_few_digits_is_solved():
    arm = ik.Robot.load("inspection_7dof")
    text = arm.urdf.replace("1.5707963267948966", "1.5708")
    robot = ik.Robot.load(text, tip=arm.tip, base=arm.base)
    assert fits(robot, KIND.pose) == "inspection" and "approximately" in describe_fit(robot)
    rng = np.random.default_rng(4)
    for held in (robot, robot.locked({"lift": 0.3})):
        Q = rng.uniform(held.lower, held.upper, (100, held.n))
        T = held.chain.forward(Q)[0]
        batch = ik.solve_batch(held, T, check=1.0)
        assert batch.success.all()
        assert sum(batch[k].solver == "inspection" for k in range(100)) > 90
        found = [ik.solve_all(held, pose, q0=q) for pose, q in zip(T[:20], Q, strict=False)]
        assert not any(one.complete for one in found) and all(len(one) for one in found)


H = PI / 2
STRUCTURE = [  # column, shoulder, elbow and wrist of an arm without a lift, at right angles and parallel in turn
    ((0, 0, 0), (0, 0, 0)),
    ((0, 0, 0), (H, 0, 0)),
    ((0, 0, 0), (H, 0, 0)),
    ((0.5, 0, 0), (0, 0, 0)),
    ((0, 0, 0), (-H, 0, 0)),
    ((0.4, 0, 0), (0, 0, 0)),
]


@pytest.mark.parametrize(
    ("joint", "moved", "turned", "words"),
    [
        (1, (0, 0, 0), (H - 0.5, 0, 0), "joints 1 and 2 are not at right angles"),
        (2, (0, 0, 0), (H - 0.5, 0, 0), "joints 2 and 3 are not at right angles"),
        (3, (0.5, 0, 0), (0.5, 0, 0), "joints 3 and 4 are not parallel"),
        (4, (0, 0, 0), (-H + 0.5, 0, 0), "joints 4 and 5 are not at right angles"),
        (5, (0.4, 0, 0), (0.5, 0, 0), "joints 5 and 6 are not parallel"),
        (2, (0.2, 0, 0), (H, 0, 0), "third revolute axis misses the point"),
        (4, (0, 0, 0.2), (-H, 0, 0), "fifth revolute axis does not cross the fourth"),
        (3, (0, 0, 0), (0, 0, 0), "parallel revolute axes coincide"),
    ],
)
def test_each_part_of_the_inspection_structure_is_required(joint, moved, turned, words):
    def recognised(places):
        joints = [("continuous", where, angles, (0, 0, 1), -1.0, 1.0) for where, angles in places]
        return inspection.recognise(drawn(joints, (0.1, 0, 0.2), (0, 0, 0.3)).chain)[1]

    assert recognised(STRUCTURE) == ""
    assert words in recognised([*STRUCTURE[:joint], (moved, turned), *STRUCTURE[joint + 1 :]])
