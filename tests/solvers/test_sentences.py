"""The sentence of each status: its figures are those of the result, and it says what to try."""

import re

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.solvers.message import ADVICE
from ik_toolkit.solvers.status import Status
from ik_toolkit.text import angle, length

NARROW = robots.urdf(
    dict(kind="revolute", xyz="0 0 0", limits=(-0.5, 0.5)),
    dict(kind="revolute", xyz="1 0 0", limits=(-0.5, 0.5)),
    dict(kind="fixed", xyz="1 0 0"),
)


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


def left(result):
    turned = "" if result.orientation_error is None else f", {angle(result.orientation_error)}"
    return length(result.position_error) + turned


def target(arm):
    return arm.fk(arm.random_q(np.random.default_rng(1)))


def test_one_thing_is_not_said_as_several():
    one = ik.Robot.load(robots.urdf(dict(kind="prismatic", limits=(0.0, 1.0)), name="one"))
    result = ik.solve(one, one.fk([0.3]).translation, q0=[0.2], tolerance=0.01)
    assert result.iterations == 1 and "in 1 iteration to" in result.message
    assert "1 joint:" in repr(one) and "1 target," in repr(ik.solve_batch(one, [one.fk([0.3])]))


def test_converged():
    arm, again = robots.load("inspection_7dof"), set()
    for q in arm.random_q(np.random.default_rng(4), 25):
        for goal in (arm.fk(q), arm.fk(q).translation):
            result = ik.solve(arm, goal, "lm", q0=arm.home)
            told = f"converged in {result.iterations} iterations to {left(result)}"
            k = result.restarts
            assert result.success and result.message == told + (f" after {k} restart{'s' * (k > 1)}" if k else "")
            again.add(min(k, 2))
    assert again == {0, 1, 2}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (dict(max_iterations=1, restarts=0), "{left} away after 1 iteration; {advice}"),
        (dict(max_iterations=2, restarts=0), "{left} away after 2 iterations; {advice}"),
        (
            dict(max_iterations=1, restarts=2),
            "closest {left} after 3 starts, each cut off by the limit of iterations; {advice}",
        ),
        (
            dict(max_evaluations=3),
            "the limit of 3 evaluations was reached after 1 start; closest {left}; raise max_evaluations",
        ),
    ],
)
def test_cut_off(arm, options, told):
    result = ik.solve(arm, target(arm), "lm", q0=arm.home, **options)
    assert result.status == Status.ITERATION_LIMIT
    assert result.message == told.format(left=left(result), advice=ADVICE[result.status])


def test_followed(arm):
    small = ik.solve(arm, target(arm), "lm", q0=arm.home, follow=0.01)
    moved = np.abs(small.q - arm.home)
    assert small.status == Status.TOO_FAR and moved.max() == pytest.approx(0.01, abs=1e-9)
    ends = [
        f"{left(small)} away when joint {joint} reached the 0.01 rad it may move from q0; {ADVICE[small.status]}"
        for joint, far in zip(arm.joint_names, moved, strict=True)
        if far > 0.01 - 1e-9
    ]
    assert small.message in ends
    cut = ik.solve(arm, target(arm), "lm", q0=arm.home, follow=3.0, max_iterations=2)
    assert cut.status == Status.ITERATION_LIMIT
    assert cut.message == f"{left(cut)} away after 2 iterations; move the target in smaller steps, or use the tracker"


def test_the_bound_of_the_reach_does_not_look_larger_than_the_error():
    flat = robots.load("planar_2r")
    for x in np.linspace(5.0, 5.02, 21):
        result = ik.solve(flat, (x, 0.0, 0.0), "lm")
        beyond, closest = re.findall(r"(?:reach by|closest) (\S+) m ", result.message)
        assert x - 2.01 < float(beyond) <= float(closest)  # two links of 1 m
        assert result.position_error == pytest.approx(x - 2.0, abs=1e-6)  # no place within reach is nearer


def test_where_q_comes_nearer_than_the_bound_the_bound_says_that_it_keeps_the_orientation():
    crank = ik.Robot.load(robots.urdf(dict(kind="continuous"), dict(kind="fixed", xyz="0.5 0 0")))
    pose = crank.fk([0.4]).homogeneous
    pose[:3, :3] = crank.fk([0.4 + np.pi]).rotation
    there = ik.solve(
        crank, pose, length_scale=0.01
    )  # the position comes first: the tip is nearly there, turned by half a turn
    assert there.status == Status.UNREACHABLE and there.position_error < 1e-3
    assert "beyond reach by 1 m with its orientation kept (a bound from" in there.message
    assert "orientation" not in ik.solve(crank, 3.0 * pose[:3, 3]).message


def test_a_bound_of_the_wrist_says_that_it_keeps_the_orientation():
    """A position that the tip reaches, in an orientation that needs the wrist where the arm cannot bring it."""
    turns = dict(kind="revolute", limits=(-0.3, 0.3)), dict(kind="revolute", xyz="0.5 0 0", limits=(-1, 1))
    arm = ik.Robot.load(robots.urdf(*turns, dict(kind="fixed", xyz="0.5 0 0")))
    pose = arm.fk([0.3, 0.9]).homogeneous
    pose[:3, :3] = pose[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    turned, far = ik.solve(arm, pose), ik.solve(arm, pose[:3, 3] * 3.0)
    assert ik.solve(arm, pose[:3, 3]).success and turned.status == far.status == Status.UNREACHABLE
    assert "with its orientation kept (a bound from" in turned.message and "kept" not in far.message


def test_all_limits_that_keep_the_arm_from_its_target_are_named():
    axes = "1 0 0", "0.6 0.8 0", "0.48 0.36 0.8"
    gantry = ik.Robot.load(robots.urdf(*[dict(kind="prismatic", axis=axis, limits=(-0.5, 0.5)) for axis in axes]))
    ways = np.array([axis.split() for axis in axes], dtype=float)
    result = ik.solve(gantry, gantry.fk([0.0, 0.0, 0.0]).translation + np.array([0.6, -0.9, 0.2]) @ ways)
    assert "with j1 400 mm and j0 100 mm outside their own; widen these limits, or move the target" in result.message


def test_beyond_reach(arm, brokk):
    for goal, restarts in (((9.0, 0.0, 0.0), 0), ((9.0, 0.0, 0.0), 2), (ik.pose((9.0, 0.0, 0.0)), 9)):
        result = ik.solve(arm, goal, "lm", q0=arm.home, restarts=restarts)
        assert result.status == Status.UNREACHABLE
        starts = f"after {min(restarts, 3) + 1} start{'s' * (restarts > 0)}"  # from q0 and three others at most
        head, _, tail = result.message.partition(" (a bound from the link lengths)")
        beyond = float(head.removeprefix("the target is beyond reach by ").removesuffix(" m"))
        assert 0.0 < beyond <= result.position_error + 1e-3
        assert tail.startswith(f"; closest {length(result.position_error)}") and tail.endswith(
            f"{starts}; {ADVICE[result.status]}"
        )
    first, second = brokk.tips
    both = ik.solve(brokk, {first: (9.0, 0.0, 0.0), second: (0.0, 9.0, 0.0)}, "lm", restarts=9)
    assert both.restarts <= 2
    head, _, tail = both.message.partition(" (a bound from the link lengths); ")
    assert head.startswith(f"beyond reach: {first} by ") and f", {second} by " in head
    errors = ", ".join(f"{tip} {length(both.position_errors[tip])}" for tip in brokk.tips)
    assert tail == f"{ADVICE[both.status]}; remaining error at each tip: {errors}"
    alone = ik.solve(brokk, {second: (0.0, 9.0, 0.0)}, "lm", restarts=1)
    assert alone.message.startswith(f"beyond reach: {second} by ") and first not in alone.message


def test_what_is_left_at_each_tip(brokk):
    result = ik.solve(brokk, brokk.fk(brokk.home + 0.1), "lm", q0=brokk.home, max_iterations=1, restarts=0)
    errors = ", ".join(
        f"{tip} {length(result.position_errors[tip])} {angle(result.orientation_errors[tip])}" for tip in brokk.tips
    )
    assert not result.success and result.message.endswith(f"; remaining error at each tip: {errors}")


def test_blocked_by_limits():
    robot = ik.Robot.load(NARROW)
    for restarts in (0, 3):
        result = ik.solve(robot, (-1.0, 1.0, 0.0), "lm", restarts=restarts)
        assert result.status == Status.LIMIT_BLOCKED and result.limited_joints
        starts = f"{restarts + 1} start{'s' * (restarts > 0)}"
        joints = ", ".join(result.limited_joints)
        told = f"joint limits ({joints}) block the target, which is reached without them; closest {left(result)}"
        assert result.message == f"{told} after {starts}; {ADVICE[result.status]}"
    shut = ik.solve(robot, (-1.0, 1.0, 0.0), "planar-2r")
    assert shut.status == Status.LIMIT_BLOCKED
    assert shut.message == (
        "the target is in reach but every branch violates a joint limit; the closest configuration found within limits is "
        f"{left(shut)} away, with {', '.join(shut.limited_joints)} at a limit; widen the limits or move the target"
    )


def test_closed_forms():
    robot = robots.load("planar_2r")
    result = ik.solve(robot, robot.fk([0.3, 0.9]).translation, "planar-2r")
    assert result.message == f"closed form: the branch within limits nearest q0; residual {left(result)}"
    away = ik.solve(robot, (5.0, 0.0, 0.0), "planar-2r")
    reach = np.linalg.norm(robot.fk([0.0, 0.0]).translation[:2])
    assert away.status == Status.UNREACHABLE
    told = f"the target is out of reach by about {length(5.0 - reach, 4)}; the closest configuration found is {left(away)} away"
    assert away.message.startswith(told)


def test_in_collision(arm):
    around = ik.CollisionModel(arm).add_sphere(0.3, arm.fk(arm.home).translation, name="ball")
    result = ik.solve(arm, arm.fk(arm.home), "lm", avoid_collisions=around, restarts=4)
    assert result.status == Status.COLLISION and "ball" in result.collision
    told = f"every solution found from 5 starts is in collision; here {' and '.join(result.collision)} touch"
    assert result.message == f"{told}; {ADVICE[result.status]}"


def test_notices():
    arm = robots.load("inspection_7dof")
    for q in arm.random_q(np.random.default_rng(4), 25):
        result = ik.solve(arm, arm.fk(q), "lm", q0=arm.home)
        joint, amount = result.largest_move
        assert amount == abs(result.q - arm.home)[arm.joint_names.index(joint)]
        moved = f"joint {joint} moved by {length(amount) if joint == 'lift' else f'{amount:.3g} rad'}"
        far = f"q was found by attempt {result.attempt}, not from q0: {moved}; in a loop use follow=True"
        assert result.notice == (far if result.attempt else "")
        assert ik.solve(arm, arm.fk(q), "lm").notice == ""  # without q0 there is nothing to be near to
    out = arm.upper + 0.1
    held = ik.solve(arm, arm.fk(arm.upper - 0.05), "lm", q0=out)
    assert held.notice.startswith("q0 was outside the limits at joint") and "clamped" in held.notice


def test_all_solutions():
    robot = ik.Robot.load(NARROW)
    both = ik.solve_all(robots.load("planar_2r"), robots.load("planar_2r").fk([0.3, 0.9]).translation)
    assert both.message.startswith("2 of 2 branches") and "are inside the limits" in both.message
    some = ik.solve_all(robot, robot.fk([0.45, 0.45]).translation)
    assert len(some) == 1 and some.message.startswith("1 of 2 branches")
    free = ik.solve_all(robot, robot.fk([0.45, 0.45]).translation, limits=False)
    assert len(free) == 2 and free.message.startswith("2 branches") and "inside the limits" not in free.message
