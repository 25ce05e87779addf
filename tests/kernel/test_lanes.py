"""Eight targets side by side: the vector type against numpy, and results against Pinocchio, limits and the scalar loop."""

import math

import numpy as np
import pytest
import robots
from numba import config, njit

import ik_toolkit as ik
from ik_toolkit.compile import simd
from ik_toolkit.kernel.algebra import M3, V3, Blocks, Sym3, at3, put3, sincos
from ik_toolkit.kernel.checks import CODE
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.kernel.records import AT, SIZE
from ik_toolkit.kernel.simd_search import LEFT, lanes

pytestmark = pytest.mark.skipif(config.DISABLE_JIT, reason="vectors exist in compiled code only")
W = simd.WIDTH
ARMS = ("hydrolek_7w", "inspection_7dof", "planar_3r", "cartesian_pp", "panda", "ur5", "kinova", "slides_mix")


@njit
def arithmetic(a, b, out):
    x, y = simd.lane_load(a, 0), simd.lane_load(b, 0)
    simd.store(out, 0, -x + y * 2.0 - 3.0 / y)
    simd.store(out, W, simd.lane_select((x < y) & (x > 0.0) | (y >= 4.0), abs(x), np.rint(y)))
    simd.store(out, 2 * W, math.sqrt(y) + simd.full(1.5))
    s, c = sincos(x)
    simd.store(out, 3 * W, s)
    simd.store(out, 4 * W, c)
    return simd.bits(x <= y)


def test_vectors_compute_as_numpy_does():
    rng = np.random.default_rng(0)
    a, b, out = rng.normal(size=W) * 3, rng.uniform(0.5, 6.0, W), np.zeros(5 * W)
    bits = arithmetic(a, b, out)
    assert bits == sum(1 << i for i in range(W) if a[i] <= b[i]) and 0 < bits < 2**W - 1
    wanted = [-a + b * 2 - 3 / b, np.where((a < b) & (a > 0) | (b >= 4), abs(a), np.rint(b)), np.sqrt(b) + 1.5]
    np.testing.assert_allclose(out.reshape(5, W), [*wanted, np.sin(a), np.cos(a)], atol=2e-15, rtol=1e-14)


@njit
def blocks(M, e, y):
    P = Sym3(M[0, 0], M[0, 1], M[0, 2], M[1, 1], M[1, 2], M[2, 2])
    S = Sym3(M[3, 3], M[3, 4], M[3, 5], M[4, 4], M[4, 5], M[5, 5])
    Q = M3(V3(M[3, 0], M[4, 0], M[5, 0]), V3(M[3, 1], M[4, 1], M[5, 1]), V3(M[3, 2], M[4, 2], M[5, 2]))
    linear, angular = Blocks(P, Q, S).solve(at3(e, 0), at3(e, 3))
    put3(y, 0, linear)
    put3(y, 3, angular)


def test_the_blocks_solve_the_whole():
    rng = np.random.default_rng(1)
    for _ in range(20):
        J, e, y = rng.normal(size=(6, 7)), rng.normal(size=6), np.zeros(6)
        blocks(J @ J.T + 0.1 * np.eye(6), e, y)
        np.testing.assert_allclose(y, np.linalg.solve(J @ J.T + 0.1 * np.eye(6), e), rtol=1e-9)


def run(robot, T, kind=KIND.pose, q0=None, **options):
    """Rows of the lanes and of the loop."""
    plan = ik.Solver(robot, "lm", **options).plan
    start = plan.home if q0 is None else np.atleast_2d(q0)
    opt = plan.orders((kind,), q0 is not None)
    side, loop = np.zeros((len(T), SIZE.answer + robot.n)), np.zeros((len(T), SIZE.answer + robot.n))
    lanes()(*plan.arrays((kind,), start), T, start, side, opt)
    plan.run(T, (kind,), start, q0 is not None, loop)
    return side, loop


def correct(robot, rows, T, position_only=False, tolerance=1e-6):
    """Assert that converged rows are at their targets by Pinocchio, inside the limits, and say their errors."""
    solved = np.flatnonzero(rows[:, AT.status] == CODE.converged)
    for k in solved:
        q = rows[k, SIZE.answer :]
        assert not robot.outside(q)
        position, rotation = robot.errors(q, T[k, :3, 3] if position_only else T[k])
        assert position <= tolerance and abs(position - rows[k, AT.position]) < 1e-11
        assert position_only or (rotation <= tolerance and abs(rotation - rows[k, AT.rotation]) < 1e-9)
    return solved


@pytest.mark.parametrize(
    ("name", "kind"),
    [*[(name, KIND.position) for name in ARMS], *[(name, KIND.pose) for name in ARMS if name not in robots.PLANAR]],
)
def test_answers_are_those_of_the_loop_in_all_but_choice(name, kind):
    robot = robots.load(name)
    T = robots.sample(robot, 300, seed=4)[1]
    side, loop = run(robot, T, kind)
    solved = correct(robot, side, T, kind == KIND.position)
    assert set(side[:, AT.status]) <= {CODE.converged, LEFT}
    assert len(solved) >= 0.98 * (loop[:, AT.status] == CODE.converged).sum()
    counted = side[solved]
    assert (counted[:, AT.evaluations] >= counted[:, AT.iterations] + counted[:, AT.restarts] + 1).all()
    assert (counted[:, AT.evaluations] <= counted[:, AT.iterations] + counted[:, AT.restarts] + 2).all()
    assert counted[:, AT.iterations].mean() < 1.3 * loop[:, AT.iterations].mean() + 1


def test_a_start_at_the_solution_takes_no_step():
    robot = robots.load("panda")
    Q, T = robots.sample(robot, 50, seed=5)
    side, _ = run(robot, T, q0=Q)
    assert (side[:, AT.status] == CODE.converged).all() and (side[:, AT.iterations] == 0).all()
    assert np.abs(side[:, SIZE.answer :] - Q).max() < 1e-12


def test_endless_joints_come_back_at_the_turn_nearest_the_start():
    robot = robots.load("kinova")
    Q, T = robots.sample(robot, 50, seed=6)
    wound = Q + 4 * math.pi * np.isinf(robot.upper)
    side, loop = run(robot, T, q0=wound)
    assert len(correct(robot, side, T)) == 50
    np.testing.assert_allclose(side[:, SIZE.answer :], loop[:, SIZE.answer :], atol=1e-5)
    assert np.abs(side[:, SIZE.answer :] - wound).max() < 1e-5


def test_what_needs_care_is_left_to_the_loop():
    robot = robots.load("panda")
    T = robots.sample(robot, 20, seed=7)[1]
    T[3, :3, 3] += 50.0
    T[8, 0, 0] = np.nan
    T[13, :3, :3] *= 1.5
    side, _ = run(robot, T)
    assert (side[[3, 8, 13], AT.status] == LEFT).all() and (
        np.delete(side[:, AT.status], [3, 8, 13]) == CODE.converged
    ).all()


def test_half_a_turn_off_is_no_answer():
    robot = robots.load("panda")
    Q, T = robots.sample(robot, 64, seed=8)
    T[:, :3, :3] = T[:, :3, :3] @ np.diag([1.0, -1.0, -1.0])
    side, loop = run(robot, T, q0=Q)
    solved = correct(robot, side, T)  # by a restart: about half of these poses can be reached at all
    assert set(side[:, AT.status]) <= {CODE.converged, LEFT}
    assert len(solved) >= 0.9 * (loop[:, AT.status] == CODE.converged).sum() > 20
    alone, _ = run(robot, T, q0=Q, restarts=0)  # from the start itself the axis cannot be told: none is answered
    assert (alone[:, AT.status] == LEFT).all()


@pytest.mark.parametrize("tolerance", [1e-10, 1e-3, 1.0, 3.1])
def test_tolerances_are_kept(tolerance):
    robot = robots.load("ur5")
    T = robots.sample(robot, 100, seed=9)[1]
    solved = correct(robot, run(robot, T, tolerance=tolerance)[0], T, tolerance=tolerance)
    assert len(solved) > 90


def test_one_attempt_is_one_attempt():
    robot = robots.load("panda")
    T = robots.sample(robot, 200, seed=10)[1]
    one, loop = run(robot, T, restarts=0, max_iterations=60)
    assert (one[one[:, AT.status] == CODE.converged, AT.restarts] == 0).all()
    assert 0.2 < (one[:, AT.status] == CODE.converged).mean() < 0.9 and (loop[:, AT.restarts] == 0).all()


@pytest.mark.parametrize(
    "options",
    [{"limits": False}, {"joint_weights": [1, 2, 1, 1, 1, 1, 1]}, {"mask": [1, 1, 1, 1, 1, 0]}, {"max_evaluations": 9}],
)
def test_options_that_lanes_do_not_know_go_to_the_loop(options):
    robot = robots.load("panda")
    T = robots.sample(robot, 20, seed=12)[1]
    many = ik.solve_batch(robot, T, "lm", **options)
    for k, target in enumerate(T):
        assert many.q[k].tobytes() == ik.solve(robot, target, "lm", **options).q.tobytes()


def test_the_batch_leaves_nothing_behind():
    robot = robots.load("panda")
    T = robots.sample(robot, 300, seed=11)[1]
    T[::50, :3, 3] += 20.0
    many = ik.solve_batch(robot, T, "lm")
    far = np.zeros(300, dtype=bool)
    far[::50] = True
    assert (many.status[far] == ik.Status.UNREACHABLE).all()
    assert many.success[~far].mean() > 0.99  # what is lost of reachable ones depends on the starts
    again = ik.solve_batch(robot, T[37:38], "lm")
    assert again.table.tobytes() == many.table[37:38].tobytes()
