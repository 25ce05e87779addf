"""Arms that split into geometric subproblems: each subproblem, all branches, their certificates, families and their ranges."""

import numpy as np
import pinocchio as pin
import pytest
import robots
from second_fk import SecondFK
from serial_arms import away

import ik_toolkit as ik
from ik_toolkit.kernel.algebra import V3
from ik_toolkit.kernel.elimination.binding import answers, arm_tip, make_arm, make_forms
from ik_toolkit.kernel.elimination.closure import Line
from ik_toolkit.kernel.elimination.subproblems import (
    Sum,
    angle_from,
    arcs_between,
    circle_about,
    height_on,
    solve_sum,
    square_on,
)
from ik_toolkit.kernel.elimination.terms import VERDICT
from ik_toolkit.solvers.closed_form.elimination import recognise_six_revolute

# Structures, with the axes (from 0) that are parallel, those that meet, and how many joints later the loop begins.
KINDS = {
    "wrist": (((1, 2),), ((3, 4, 5),)),
    "wrist, elbow axes meet": ((), ((3, 4, 5), (1, 2))),
    "wrist, first axes parallel": (((0, 1),), ((3, 4, 5),)),
    "wrist, first axes meet": ((), ((3, 4, 5), (0, 1))),
    "wrist at the base": (((3, 4),), ((0, 1, 2),)),
    "wrist in the middle": ((), ((1, 2, 3), (4, 5))),
    "three parallel": (((1, 2, 3),), ((4, 5),)),
    "three parallel at the end": (((3, 4, 5),), ((1, 2),)),
}


def plain(function):
    """The Python function of a compiled one."""
    return getattr(function, "py_func", function)


def arm_of(kind, seed, off=0.0):
    """Numbers of a random arm of a kind; off: how far its axes are turned and moved away from the structure."""
    rng = np.random.default_rng(seed)
    axes, points = rng.normal(size=(6, 3)), np.cumsum(rng.normal(size=(6, 3)) * 0.3, axis=0)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    parallel, meeting = KINDS[kind]
    for joints in parallel:
        axes[list(joints)] = axes[joints[0]] * rng.choice([-1.0, 1.0], (len(joints), 1))
    for joints in meeting:
        points[list(joints)] = points[joints[0]] + axes[list(joints)] * rng.normal(size=(len(joints), 1)) * 0.2
    axes += off * rng.uniform(-1, 1, (6, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    T = np.eye(4)
    T[:3, 3] = points[5] + 0.1
    return make_arm(axes, points + off * rng.uniform(-1, 1, (6, 3)), T)


def ask(arm, Q, forms):
    """Answers for the poses of the tip at Q (N, 6): lists of solutions, verdicts, and everything."""
    found = answers(forms, arm, np.array([arm_tip(arm, q) for q in Q]))
    return [one[1 : 1 + int(one[0, 0]), :6] for one in found], found[:, 0, 1], found


def wrist_robot(limit, scale=1.0, bend=0.0):
    """A robot with a wrist whose joints have the limits -limit and limit, straight at -bend; scale: a factor of all lengths."""
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    steps = ("0 0 0.4", "0.1 0 0", "0 0 0.7", "0.1 0 0.1", "0.6 0 0", "0 0 0")
    text = robots.urdf(*(
        dict(kind="revolute", axis=axis, xyz=" ".join(str(scale * float(x)) for x in xyz.split()), limits=(-limit, limit), rpy=rpy)
        for axis, xyz, rpy in zip(axes, steps, ["0 0 0"] * 5 + [f"0 {bend} 0"], strict=True)
    ))  # fmt: skip
    return ik.Robot.load(text), SecondFK(text)


# --------------------------------------------------------------------------------------------------------------- subproblems
def random_line(rng):
    along = rng.normal(size=3)
    return Line(V3(*(along / np.linalg.norm(along))), V3(*rng.normal(size=3)))


def turned_point(line, point, x):
    axis, at, p = (np.array(v) for v in (line.along, line.point, point))
    d = p - at
    return at + d * np.cos(x) + np.cross(axis, d) * np.sin(x) + axis * (axis @ d) * (1 - np.cos(x))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_heights_and_distances_of_a_turning_point(sense):
    rng = np.random.default_rng(1)
    for _ in range(20):
        line, point, other, x = random_line(rng), V3(*rng.normal(size=3)), random_line(rng), rng.uniform(-np.pi, np.pi)
        circle = plain(circle_about)(line, point, sense)
        at = turned_point(line, point, sense * x)
        assert np.allclose(np.array(circle.spot(np.cos(x), np.sin(x))), at)
        height, square = plain(height_on)(circle, other.along), plain(square_on)(circle, other.point)
        assert height.value(np.cos(x), np.sin(x)) == pytest.approx(at @ np.array(other.along))
        assert square.value(np.cos(x), np.sin(x)) == pytest.approx(0.5 * np.sum((at - np.array(other.point)) ** 2))


def test_a_sum_has_two_solutions_one_or_none_and_says_how_far_off_they_may_be():
    rng, solve = np.random.default_rng(2), plain(solve_sum)
    for _ in range(200):
        x, error = rng.uniform(-np.pi, np.pi), 10.0 ** rng.uniform(-14, -5)
        exact = Sum(*rng.normal(size=3))
        noisy = Sum(*(np.array(exact) + rng.uniform(-error, error, 3)))
        value = exact.value(np.cos(x), np.sin(x))
        found = solve(noisy, value + rng.uniform(-error, error), error)
        assert found.number > 0 and not found.free
        near = min(abs((y - x + np.pi) % (2 * np.pi) - np.pi) for y in (found.first, found.second))
        assert near <= 4.0 * found.error  # the band of `terms.DecompositionThresholds`
        assert solve(exact, exact.k + exact.swing() + 10.0 * error, error).number == 0
        top = solve(exact, exact.k + exact.swing(), 1e-15)
        assert top.merged and top.number > 0 and abs(top.first - np.arctan2(exact.b, exact.a)) < 1e-6
    free = solve(Sum(0.3, 1e-16, -1e-16), 0.3, 1e-15)
    assert free.free and not free.doubt and solve(Sum(0.3, 1e-16, -1e-16), 0.4, 1e-15).number == 0
    assert solve(Sum(0.3, 1e-4, 0.0), 0.3, 1e-4).doubt  # free only because the numbers are that rough


def test_the_turn_from_one_direction_to_another():
    rng = np.random.default_rng(3)
    for _ in range(50):
        line, start, x = random_line(rng), V3(*rng.normal(size=3)), rng.uniform(-np.pi, np.pi)
        end = V3(*turned_point(Line(line.along, V3(0.0, 0.0, 0.0)), start, x))
        assert plain(angle_from)(line.along, start, end, 1e-15).first == pytest.approx(x)
        assert plain(angle_from)(line.along, line.along * 2.0, end, 1e-15).free


def test_the_arcs_on_which_a_sum_is_between_bounds():
    rng, X = np.random.default_rng(4), np.linspace(-np.pi, np.pi, 2001)
    for k in range(100):
        one = Sum(*rng.normal(size=3))
        low, high = np.sort(one.k + one.swing() * rng.uniform(-1.3, 1.3, 2))
        arcs = plain(arcs_between)(one, low, high)
        inside = np.zeros(len(X), dtype=bool)
        for middle in (arcs.first, arcs.second)[: arcs.number]:
            inside |= np.abs((X - middle + np.pi) % (2 * np.pi) - np.pi) < arcs.half
        values = one.value(np.cos(X), np.sin(X))
        assert (inside != ((values > low) & (values < high))).sum() <= 8, k  # the ends, to one sample each


# ----------------------------------------------------------------------------------------------------------------- decompositions
@pytest.mark.parametrize("kind", KINDS)
def test_branches_are_what_the_elimination_finds(kind):
    Q, both = np.random.default_rng(5).uniform(-np.pi, np.pi, (18, 6)), 0
    for seed in (6, 7):
        arm = arm_of(kind, seed)
        forms = make_forms(arm)
        assert forms[0, 3] == 0.0 and (forms[1:, 3] > 0.0).all()
        (split, a, found), (other, b, _) = ask(arm, Q, forms[:1]), ask(arm, Q, forms[1:])
        assert (a == VERDICT.certain).all() and (found[:, 0, 2] == 0.0).all()
        for q, one, two, sure in zip(Q, split, other, b == VERDICT.certain, strict=True):
            assert away(one, q).min() < 1e-7 and all(
                np.abs(arm_tip(arm, x) - arm_tip(arm, q)).max() < 1e-9 for x in one
            )
            if sure:
                both += 1
                assert len(one) == len(two) and all(away(two, x).min() < 1e-6 for x in one)
    assert both > 30


@pytest.mark.parametrize("kind", ["wrist", "wrist at the base", "wrist, first axes meet", "three parallel"])
def test_hard_targets_are_listed_and_none_is_lost_under_a_certificate(kind):
    """Joints at half a turn and lattices of right angles for arms with right angles, whose singular poses these are."""
    parallel, meeting = KINDS[kind]
    axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
    points = np.array([[0, 0, 0], [0.1, 0.05, 0.4], [0.1, 0.1, 1.1], [0.3, 0.1, 1.2], [0.8, 0.1, 1.3], [0.9, 0.2, 1.4]])
    if kind == "wrist at the base":
        axes, points = axes[::-1].copy(), points[::-1].copy()
    if kind == "three parallel":
        axes[3:] = [[0, 1, 0], [0, 0, 1], [0, 1, 0]]
    for joints in meeting:
        points[list(joints)] = points[joints[0]]
    T = np.eye(4)
    T[:3, 3] = points[5] + 0.1
    arm, rng = make_arm(axes, points, T), np.random.default_rng(8)
    forms = make_forms(arm)
    half = rng.uniform(-np.pi, np.pi, (100, 6))
    half[rng.random((100, 6)) < 0.3] = np.pi
    near = rng.uniform(-np.pi, np.pi, (120, 6))
    near[np.arange(120), rng.integers(1, 5, 120)] = rng.choice([0.0, np.pi], 120) + np.repeat(
        [0, 1e-9, 1e-7, 1e-5, 1e-3, 1e-2], 20
    )
    for Q in (half, near, rng.choice([0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi], (150, 6))):
        lists, verdicts, _ = ask(arm, Q, forms[:1])
        lost = np.array([not (len(one) and away(one, q).min() < 1e-3) for one, q in zip(lists, Q, strict=True)])
        assert not (lost & (verdicts == VERDICT.certain)).any()
        assert (lost & (verdicts != VERDICT.family)).mean() <= 0.05 and (
            (verdicts == VERDICT.certain) | (verdicts == VERDICT.family)
        ).mean() > 0.8


@pytest.mark.parametrize(
    ("kind", "off"),
    [
        ("wrist", 1e-9),
        ("wrist", 1e-6),
        ("three parallel", 1e-9),
        ("three parallel", 1e-7),
        ("wrist, first axes meet", 1e-6),
    ],
)
def test_an_arm_that_is_a_little_off_is_certified_only_where_that_does_not_matter(kind, off):
    rng, unsure = np.random.default_rng(9), 0
    Q = rng.uniform(-np.pi, np.pi, (100, 6))
    Q[50:, 2:5] = rng.choice([0.0, np.pi], (50, 3)) + 10.0 ** rng.uniform(-9, -1, (50, 3))
    for seed in (10, 11):
        arm = arm_of(kind, seed, off)
        forms = make_forms(arm)
        assert forms[0, 3] == 0.0 and 0.1 * off < forms[0, 4] < 100.0 * off
        (split, a, _), (other, b, _) = ask(arm, Q, forms[:1]), ask(arm, Q, forms[1:])
        certain = a == VERDICT.certain
        unsure += (~certain).sum()
        for q, one, two, sure, both in zip(Q, split, other, certain, certain & (b == VERDICT.certain), strict=True):
            assert not sure or away(one, q).min() < 1e-3
            assert not both or (len(one) == len(two) and all(away(two, x).min() < 1e-3 for x in one))
    assert unsure <= (2 if off < 1e-8 else 180)


def test_a_pose_just_out_of_reach_is_no_proof():
    """Within the tolerances a stretched arm reaches a little farther than it does exactly."""
    robot, _ = wrist_robot(3.0)
    solver, search, rng, seen = ik.Solver(robot), ik.Solver(robot, "lm", restarts=60), np.random.default_rng(13), []
    arm = recognise_six_revolute(robot.chain).parameters
    forms = make_forms(arm)
    for push in np.repeat([1e-9, 1e-8, 1e-7, 9e-7, 1e-5, 1e-3], 5):
        q = rng.uniform(-1.0, 1.0, 6)
        q[2] = np.arctan2(-0.7, 0.1)  # the wrist's centre is as far from joint 2 as it can be
        T = robot.fk(q).homogeneous
        out = np.array([np.cos(q[0]) * np.sin(q[1]), np.sin(q[0]) * np.sin(q[1]), np.cos(q[1])])
        T[:3, 3] += push * out
        result = solver(T)
        assert result.success == search(T).success
        found = answers(forms, arm, T[None], 30.0 * np.sqrt(1e-6))[0]
        if push < 1e-6:  # It is listed, or among the places to try that come with the certificate.
            count, near = int(found[0, 0]), int(found[0, 7])
            assert near >= 0 and away(found[1 : 1 + count + near, :6], q).min() < 0.01
        seen.append(
            (push < 1e-6, result.success, result.solver == "elimination" and result.status == ik.Status.UNREACHABLE)
        )
    assert seen.count((True, True, False)) == 20 and seen.count((False, False, True)) >= 4


@pytest.mark.parametrize(("kind", "first"), [("wrist", 4), ("wrist, first axes meet", 3), ("three parallel", 1)])
def test_two_axes_on_one_line_are_never_certain(kind, first):
    """At every pose these joints turn against each other, so no list of branches is complete."""
    lines = arm_of(kind, 5)[:36].reshape(6, 6).copy()
    lines[first + 1] = lines[first] * (-1, -1, -1, 1, 1, 1)
    arm = make_arm(lines[:, :3], lines[:, 3:], np.eye(4))
    Q = np.random.default_rng(6).uniform(-np.pi, np.pi, (50, 6))
    listed, verdict, _ = ask(arm, Q, make_forms(arm))
    for some, certain, q in zip(listed, verdict == VERDICT.certain, Q, strict=True):
        assert not certain or (len(some) and away(some, q).min() < 1e-3)


def test_an_angle_that_rounded_axes_leave_almost_free_adds_no_wrong_solutions():
    """A folded elbow of two equal links, as the I2RT big YAM has; axes that are parallel to 1e-6."""
    rng, lines = np.random.default_rng(7), arm_of("three parallel", 3)[:36].reshape(6, 6).copy()
    along, step = lines[1, :3], lines[1, 3:] - lines[2, 3:]
    lines[3, 3:] = lines[2, 3:] + pin.exp3(0.7 * along) @ (step - along * (along @ step))
    fold = -0.7 * np.sign(lines[2, :3] @ along)
    lines[:, :3] += 1e-6 * rng.uniform(-1, 1, (6, 3))
    lines[:, :3] /= np.linalg.norm(lines[:, :3], axis=1, keepdims=True)
    arm = make_arm(lines[:, :3], lines[:, 3:], np.eye(4))
    Q = rng.uniform(-np.pi, np.pi, (200, 6))
    Q[:, 2] = fold + rng.uniform(-3e-3, 3e-3, 200)
    listed, verdict, _ = ask(arm, Q, make_forms(arm))
    assert (verdict == VERDICT.certain).mean() > 0.9  # the decomposition alone is sure of none of them
    for q, some in zip(Q, listed, strict=True):
        assert all(np.abs(arm_tip(arm, x) - arm_tip(arm, q)).max() < 1e-10 for x in some)


def test_a_list_is_not_called_complete_where_solving_finds_a_pose_within_the_tolerances():
    """As for an arm of millimetres, where 1e-6 m is much: its exact solution is beyond a limit, one at the limit will do."""
    robot, rng = wrist_robot(1.5, 1e-3)[0], np.random.default_rng(3)
    solver, seen = ik.Solver(robot, orientation_tolerance=1e-3), 0
    for _ in range(20):
        q = rng.uniform(-1.4, 1.4, 6)
        q[5] = 1.5 + rng.uniform(2e-4, 8e-4)
        T = robot.chain.forward(q[None])[0][0]
        found, result = solver.all(T), solver(T)
        assert not found.complete or len(found) or not result.success
        seen += result.success and len(found) > 0
    assert seen > 5


# ---------------------------------------------------------------------------------------------------------------------- families
@pytest.mark.parametrize(("limit", "bend"), [(2.0, 0.0), (3.3, 0.0), (2.0, 1.2)])
def test_a_straight_wrist_is_a_family_with_its_range(limit, bend):
    robot, second = wrist_robot(limit, bend=bend)
    q = np.array([0.3, -0.4, 0.6, 1.5, -bend, 0.9])
    T = robot.fk(q)
    found = ik.solve_all(robot, T, q0=q)
    assert found.certificate.status == "FAMILY" and found.certificate.decomposed and not found.complete
    ranges = [
        (one.lower, one.upper) for one in found.families if one.joints == (robot.joint_names[3], robot.joint_names[5])
    ]
    assert away(found.q, q).min() < 1e-6  # the member nearest to q0
    for x in np.linspace(-limit - 0.5, limit + 0.5, 200):  # joints 4 and 6 turn about one line, so that their sum stays
        last = q[3] + q[5] - x + 2 * np.pi * np.arange(-2, 3)
        legal = abs(x) <= limit and (np.abs(last) <= limit).any()
        assert legal == any(low <= x <= high for low, high in ranges)
        member = np.r_[q[:3], x, -bend, last[2]]
        assert np.abs(second.fk(member, robot.joint_names)[0] - T.homogeneous).max() < 1e-9
    single = ik.solve_all(robot, robot.fk([0.3, -0.4, 0.6, 1.5, 0.2, 0.9]))
    assert single.complete and single.certificate.decomposed and "no other solution" in single.certificate.message


@pytest.mark.skipif(not robots.have_data(), reason="needs the descriptions of example-robot-data")
def test_a_family_of_three_parallel_axes_ends_where_the_elbow_does():
    robot = robots.load("ur5")
    q = np.array([0.4, -1.2, 1.9, -0.6, 0.0, 0.8])
    T = robot.fk(q)
    narrow = robot.narrowed({robot.joint_names[5]: (0.0, 5.5)})
    listed = [one for one in ik.solve_all(narrow, T, q0=q).families if one.joints[0] == robot.joint_names[5]]
    assert {one.lower for one in listed} >= {0.0} and {one.upper for one in listed} >= {5.5}  # one arc, on two turns
    # The elbow reaches for every angle of the wrist, and rounding of the target does not cut the circle.
    for seed in range(10):
        near = T.homogeneous
        near[:3, 3] += 2e-16 * np.random.default_rng(seed).normal(size=3)
        found = ik.solve_all(robot, near, q0=q, limits=False)
        assert found.certificate.status == "FAMILY"
        assert [one.upper - one.lower for one in found.families] == [2 * np.pi] * 2
    q[2] = 0.15  # stretched: the wrist turns until the elbow is straight
    T = robot.fk(q)
    found = ik.solve_all(robot, T, q0=q, limits=False)
    ((low, high),) = {(one.lower, one.upper) for one in found.families if one.joints[0] == robot.joint_names[5]}
    assert 0.0 <= (q[5] - low) % (2 * np.pi) <= high - low < 2 * np.pi - 0.1
    for x in (end + step for end in (low, high) for step in (-1e-2, -1e-3, 1e-3, 1e-2)):
        box = {
            robot.joint_names[0]: (0.39, 0.41),
            robot.joint_names[4]: (-1e-2, 1e-2),
            robot.joint_names[5]: (x - 1e-9, x + 1e-9),
        }
        inside = (x - low) % (2 * np.pi) <= high - low
        assert ik.solve(robot, T, "lm", limits=box, restarts=60).success == inside


@pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")
def test_a_shoulder_that_turns_freely_only_between_the_angles_tried_is_no_proof():
    """The point where axes 5 and 6 meet is on axis 1, so joint 1 is free, but only in a narrow range can the wrist be placed."""
    robot = robots.load("z1")
    q = np.array([
        -2.5346705476368263, -1.7704237138981915, -2.534897894327414, 0.12378176423196185,
        -1.6359117737395439, -1.0812633013791575,
    ])  # fmt: skip
    T = robot.chain.forward(q)[0][0]
    assert not ik.solve_all(robot, T, limits=False).complete
