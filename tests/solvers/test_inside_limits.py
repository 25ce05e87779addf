"""Results exactly inside the limits: targets at limits, ranges over full turns, wound-up joints."""

import math

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration

TAU = 2.0 * math.pi


def arm(ranges, seed):
    """A robot of revolute joints with these ranges (lower, width), None for an endless one; axes and offsets at random."""
    rng = np.random.default_rng(seed)
    joints = []
    for i, pair in enumerate(ranges):
        axis = " ".join("1" if k == (2 * i + i // 3) % 3 else "0" for k in range(3))
        xyz = " ".join(str(x) for x in rng.uniform(-0.3, 0.3, 3).round(3))
        if pair is None:
            joints.append(dict(kind="continuous", axis=axis, xyz=xyz))
        else:
            lower, width = pair
            joints.append(dict(kind="revolute", axis=axis, xyz=xyz, limits=(repr(lower), repr(lower + width))))
    return ik.Robot.load(robots.urdf(*joints))


def at_limits(robot, count, rng):
    """Configurations (count, n) with about half of the joints on a limit, exactly."""
    low, high = np.fmax(robot.lower, -3.0), np.fmin(robot.upper, 3.0)
    Q, which = low + (high - low) * rng.random((count, robot.n)), rng.random((count, robot.n))
    return np.where(which < 0.25, low, np.where(which < 0.5, high, Q))


def random_ranges(seed):
    """Ranges of six joints: most of them a full turn and a little, by numbers without any system."""
    rng = np.random.default_rng(seed)
    extra = (0.0, 4e-13, -5e-10, 1e-6, 1.0, 7.0)
    return [(-float(rng.uniform(math.pi, 7.0)), TAU + extra[int(rng.integers(6))]) for _ in range(6)]


URDF_PI = [(-3.14159265359, 2 * 3.14159265359)] * 6  # as URDFs write half a turn
ARMS = {
    "written": URDF_PI,
    "once": [(-3.1, 6.2)] * 3 + URDF_PI[:3],
    **{f"random {k}": random_ranges(k) for k in range(6)},
}


@pytest.mark.parametrize("name", list(ARMS))
def test_no_answer_is_outside_and_each_is_taken_as_a_start(name):
    robot, rng = arm(ARMS[name], seed=3), np.random.default_rng(len(name))
    Q = at_limits(robot, 600, rng)
    T = robot.chain.forward(Q)[0]
    near = np.clip(Q + rng.normal(0.0, 0.3, Q.shape), robot.lower, robot.upper)
    solved = 0
    for targets, q0 in ((T, None), (T[:, :3, 3], None), (T, near), (T, Q)):
        many = ik.solve_batch(robot, targets, "lm", q0=q0, check=0.0, restarts=16)
        assert ((robot.lower <= many.q) & (many.q <= robot.upper)).all()
        again = ik.solve_batch(robot, targets, "lm", q0=many.q, q0_outside="refuse", check=0.0, restarts=0)
        assert (again.iterations[many.success] == 0).all() and again.success[many.success].all()
        solved += many.success.sum()
    assert solved > 0.95 * 4 * len(T)
    for solver in (
        ik.Solver(robot, "lm"),
        ik.Solver(robot, "dls", restarts=3),
        ik.Solver(robot, "lm", objective="mid-range"),
    ):
        for target in T[:20]:
            one = solver(target)
            assert robot.outside(one.q) == [] and not solver(target, one.q).notice


def test_every_branch_listed_is_inside():
    robot = arm(URDF_PI, seed=3)
    for q in at_limits(robot, 6, np.random.default_rng(2)):
        for found in ik.solve_all(robot, robot.fk(q), "lm", starts=60):
            assert robot.outside(found) == []


def test_several_tips_keep_their_limits():
    tree = '<robot name="two"><link name="l0"/>'
    for k, (parent, axis) in enumerate(
        ((0, "0 0 1"), (1, "0 1 0"), (2, "1 0 0"), (3, "0 1 0"), (2, "0 0 1"), (5, "0 1 0"), (6, "1 0 0"))
    ):
        half = 3.14159265359
        tree += robots.joint(f"j{k}", "revolute", f"l{parent}", f"l{k + 1}", axis, "0.1 0.05 0.3", limits=(-half, half))
    tree = ik.Tree.load(tree + "</robot>", tips=["l4", "l7"])
    solver, rng = ik.Solver(tree), np.random.default_rng(4)
    for q in at_limits(tree, 150, rng):
        result = solver([T.translation for T in tree.fk(q).values()])
        assert ((tree.lower <= result.q) & (result.q <= tree.upper)).all()


def test_a_limit_on_one_side_only():
    """Full turns bring a joint near its one limit, not near infinity."""
    robot = arm([(-3.0, 1e17), (-1e17, 1e17)] + [(-2.0, 4.0)] * 4, seed=1)  # beyond 1e15 is no limit
    assert np.isfinite(robot.lower).tolist() == [True, False, True, True, True, True]
    assert np.isfinite(robot.upper).tolist() == [False, True, True, True, True, True]
    Q = at_limits(robot, 300, np.random.default_rng(6))
    T = robot.chain.forward(Q)[0]
    many = ik.solve_batch(robot, T, "lm", check=1.0)
    single = [ik.solve(robot, x, "lm") for x in T[:40]]
    assert many.success.mean() > 0.97 and sum(one.success for one in single) >= 38
    for q in (many.q, np.array([one.q for one in single])):
        assert ((robot.lower <= q) & (q <= robot.upper)).all()


@pytest.mark.parametrize("width", [1e3, 1e6, 1e10, 1e14])
def test_limits_in_name_only_hide_no_solution(width):
    """Starts drawn from all of such a range have no digits left for the angle."""
    robot = arm([(-width, 2.0 * width)] * 6, seed=3)
    Q = np.random.default_rng(4).uniform(-3.0, 3.0, (300, 6))
    T = robot.chain.forward(Q)[0]
    many = ik.solve_batch(robot, T, "lm", check=1.0)
    solver = ik.Solver(robot, "lm")
    assert many.success.mean() > 0.99 and np.mean([solver(x).success for x in T[:60]]) > 0.95
    assert np.abs(many.q).max() < 100.0 or width < 1e4


# ---------------------------------------------------------------------------------------------------- many turns away
def wound(robot, q, turns):
    """q with its endless joints so many turns further."""
    return q + TAU * turns * np.isinf(robot.upper)


@pytest.mark.parametrize("turns", [0, 4, 7, -30, 1000])
@pytest.mark.parametrize("objective", [None, "mid-range", "reference", "manipulability"])
def test_a_held_joint_stays_at_any_turn(turns, objective):
    robot = robots.load("continuous_mix")
    rng, better = np.random.default_rng(7), 0
    weights = np.ones(robot.n)
    weights[2] = 0.0
    for q in robots.sample(robot, 12, seed=7)[0]:
        q0 = np.clip(wound(robot, q + rng.uniform(-0.2, 0.2, robot.n), turns), robot.lower, robot.upper)
        target = robot.fk(np.where(weights == 0.0, q0, q)).translation
        plain = ik.solve(robot, target, "lm", q0=q0, joint_weights=weights)
        result = ik.solve(robot, target, "lm", q0=q0, joint_weights=weights, objective=objective)
        assert plain.success and result.success
        assert plain.q[2] == result.q[2] == q0[2]
        assert np.abs(result.q - q0).max() < 1.5 * TAU  # nor is another unwound
        better += np.abs(result.q - plain.q).max() > 1e-3
    assert better >= 9 or objective is None


@pytest.mark.parametrize("objective", ["mid-range", "reference", "manipulability"])
def test_objectives_work_beyond_the_limits_when_they_do_not_count(objective):
    robot = robots.load("inspection_7dof")
    moved = 0
    for q in robots.sample(robot, 10, seed=8)[0]:
        q[3] = robot.upper[3] + 0.5
        target = robot.fk(q)
        plain = ik.solve(robot, target, "lm", q0=q + 0.2, limits=False)
        result = ik.solve(robot, target, "lm", q0=q + 0.2, limits=False, objective=objective)
        assert result.success
        moved += np.abs(result.q - plain.q).max() > 1e-3
    assert moved >= 8


@pytest.mark.parametrize("size", [1e3, 1e6, 9e8])
def test_angles_of_many_turns_are_evaluated_exactly(size):
    """To the rounding of the angles; once sine and cosine were off by 4e-17 of them as well."""
    robot = robots.load("continuous_mix")
    Q, T = robots.sample(robot, 50, seed=9)
    q0 = Q + TAU * np.rint(size / TAU) * np.isinf(robot.upper)
    many = ik.solve_batch(robot, T, "lm", q0=q0, check=0.0, position_tolerance=1e-5, orientation_tolerance=1e-5)
    for q, target, one in zip(many.q, T, many.position_error, strict=True):
        position, angle = robot.errors(q, target)
        assert abs(position - one) < 1e-12 + robot.n * np.spacing(size) and angle < 1.1e-5
    with pytest.raises(InvalidConfiguration, match="too large a number"):
        ik.solve_batch(robot, T, q0=q0 + 1e9 * np.isinf(robot.upper))
