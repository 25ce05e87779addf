"""Tasks, and problems of one tip, against matrices and finite differences."""

import math

import numpy as np
import pinocchio as pin
import pytest
import random_arms as arms
from random_arms import PARTS, errors, orders, task

from ik_toolkit.kernel import counted_error as tasks
from ik_toolkit.kernel.counted_error import AXES, KIND
from ik_toolkit.kernel.records import Ends
from ik_toolkit.kernel.serial import make_serial


@pytest.mark.parametrize("frame", [AXES.base, AXES.tip, AXES.target])
@pytest.mark.parametrize("part", range(len(PARTS)))
@pytest.mark.parametrize("kinds", ["tttstt", "tmtsnt"])
def test_errors_that_count_and_their_derivative(frame, part, kinds):
    rng = np.random.default_rng(10 * part + frame)
    chain, rows, base, tip = arms.arm(rng, kinds)
    t = task(KIND.part, frame=float(frame), **PARTS[part])
    p = make_serial(chain.rows, chain.ends, t, chain.n, orders())
    for _ in range(2):
        q, goal = rng.uniform(chain.lower, chain.upper), rng.uniform(chain.lower, chain.upper)
        T = arms.fk(rows, base, tip, goal)[0]
        assert p.aim(T, orders()) == 0.0
        look = p.evaluate(q / chain.unit)
        p.stack(look)
        np.testing.assert_allclose(p.desk.y, errors(rows, base, tip, q, T, t, chain.scale), atol=1e-10)
        assert look.ee == pytest.approx(p.desk.y @ p.desk.y)
        p.jacobian(look)
        J, d = p.desk.J.copy(), 1e-6
        for i in range(chain.n):
            step = np.zeros(chain.n)
            step[i] = d * chain.unit[i]
            a, b = (
                errors(rows, base, tip, q - step, T, t, chain.scale),
                errors(rows, base, tip, q + step, T, t, chain.scale),
            )
            np.testing.assert_allclose(J[i], (a - b) / (2 * d), atol=3e-8)
            assert p.slope(look, i) == pytest.approx(J[i] @ p.desk.y)


# ------------------------------------------------------------------------------------------------------------ one tip


def test_targets_out_of_reach_and_no_poses():
    rng = np.random.default_rng(50)
    chain, rows, base, tip = arms.arm(rng)
    p = make_serial(chain.rows, chain.ends, task(), chain.n, orders())
    T = np.eye(4)
    T[0, 1] = 0.5
    assert p.aim(T, orders()) == -1.0
    T = np.eye(4)
    T[:3, 3] = 5.0 * chain.reach
    excess = p.aim(T, orders())
    assert excess > 3.0
    np.testing.assert_allclose(p.goal[12:15], base[:3, :3].T @ (T[:3, 3] - base[:3, 3]) / chain.scale)
    box, foot = Ends(chain.ends, chain.n), np.array([0.0, 0.0, 0.0])
    foot[2] = np.clip(p.goal[14], box.bound(4), box.bound(5))
    assert np.linalg.norm(p.goal[12:15] - foot) - np.linalg.norm(p.goal[9:12] - foot) == pytest.approx(excess)
    look = p.evaluate(chain.seeds[0])
    p.keep(look, 0)
    far = arms.fk(rows, base, tip, chain.seeds[0] * chain.unit)[0]
    assert p.left(0)[0] == pytest.approx(np.linalg.norm(T[:3, 3] - far[:3, 3]))
    part = make_serial(chain.rows, chain.ends, task(KIND.part), chain.n, orders())
    assert part.aim(T, orders()) > 3.0  # and the goal stays where it is
    np.testing.assert_array_equal(part.goal[12:15], part.goal[9:12])
    p.head_for(T[None])
    np.testing.assert_array_equal(p.goal[12:15], p.goal[9:12])
    x, q = np.empty(chain.n), rng.uniform(chain.lower, chain.upper) / chain.unit
    p.stand(q)
    again, look = p.see(), p.evaluate(q)
    np.testing.assert_array_equal(np.concatenate(again[:3]), np.concatenate(look[:3]))
    p.jacobian(look)
    a, b, out = rng.normal(size=chain.n), rng.normal(size=chain.n), np.empty(6)
    p.bending(look, a, b, out)
    d, moved = 1e-6, []
    for sign in (1.0, -1.0):
        p.jacobian(p.evaluate(q + sign * d * a))
        moved.append(p.desk.J.T @ b)
    np.testing.assert_allclose(out, (moved[0] - moved[1]) / (2 * d), atol=1e-7)
    position = make_serial(chain.rows, chain.ends, task(KIND.position), chain.n, orders())
    position.aim(T, orders())
    look = position.evaluate(q)
    position.jacobian(look)
    position.bending(look, a, b, x[:6] if len(x) >= 6 else out)
    assert not (x[:6] if len(x) >= 6 else out)[3:].any()


def test_what_a_task_allows_and_counts():
    t = task(KIND.part, w0=0.5, w1=2.0, s0=3.0, s1=4.0, w3=0.0)
    assert tasks.allowance(t, 0, 0.1) == pytest.approx(5.2) and tasks.allowance(t, 3, 0.1) == np.inf
    assert tasks.allowance(task(KIND.part, w5=4.0, s3=1.0), 3, 0.1) == pytest.approx(1.1)
    for values, want in (
        ({}, (1.0, 1.0)), ({"w0": 0.0, "w1": 0.0}, (1.0, 1.0)), ({"w0": 0.0, "w1": 0.0, "w2": 0.0}, (0.0, 1.0)),
        ({"free": 1.0}, (1.0, 0.0)), ({"s3": 4.0, "s4": 4.0, "s5": math.pi}, (1.0, 0.0)), ({"s3": 4.0, "s4": 4.0}, (1.0, 1.0)),
        ({"s0": np.inf, "s1": np.inf, "s2": np.inf}, (0.0, 1.0)), ({"w3": 0.0, "w4": 0.0, "w5": 0.0}, (1.0, 0.0)),
    ):  # fmt: skip
        assert tasks.counts(task(KIND.part, **values)) == want
    for size in (1e-3, 0.99e-2, 1.01e-2, 0.5, 2.0, 3.1):
        r = size * np.array([0.6, 0.0, 0.8])
        K = pin.skew(r)
        want = np.linalg.inv(pin.Jexp3(r)) - np.eye(3) - 0.5 * K
        np.testing.assert_allclose(tasks.log_curvature(size * size) * K @ K, want, atol=1e-9)
    assert tasks.vector_ratio(KIND.part, 0.5) == 1.0 and tasks.vector_ratio(KIND.pose, 0.5) > 1.0
    assert tasks.angle_left(KIND.part, 0.25) == 0.5 and tasks.angle_left(
        KIND.pose, 4.0 * math.sin(0.25) ** 2
    ) == pytest.approx(0.5)


@pytest.mark.parametrize("kind", [KIND.pose, KIND.position])
@pytest.mark.parametrize("kinds", ["tttstt", "tmtsnt"])
def test_moves_of_one_joint(kind, kinds):
    rng = np.random.default_rng(40 + kind)
    chain, rows, base, tip = arms.arm(rng, kinds)
    p = make_serial(chain.rows, chain.ends, task(kind), chain.n, orders())
    for _ in range(5):
        q, goal = (rng.uniform(chain.lower, chain.upper) for _ in range(2))
        T = arms.fk(rows, base, tip, goal)[0]
        p.aim(T, orders())
        look = p.try_out(q / chain.unit)
        for i in range(chain.n):
            move = p.best_move(look, i, 1e-12)
            p.jacobian(look)
            p.stack(look)
            if kind == KIND.position and kinds == "tttstt" and rows[i, 9]:  # the best turn of all
                far = []
                for angle in move + np.append(0.0, np.linspace(0.01, 6.27, 12)):
                    y = q.copy()
                    y[i] += angle
                    far.append(np.linalg.norm(arms.fk(rows, base, tip, y)[0][:3, 3] - T[:3, 3]))
                assert min(far) == far[0]
            else:
                assert move == pytest.approx(p.desk.J[i] @ p.desk.y / (p.desk.J[i] @ p.desk.J[i]), rel=1e-9)
            assert p.best_move(look, i, 1e9) == 0.0
    assert p.desk.spent[0] == 5.0
    p.undo(look)
    assert p.desk.spent[0] == 5.0
    box = Ends(chain.ends, chain.n)
    assert p.inside(0, 99.0) == box.upper(0) and p.inside(0, -99.0) == box.lower(0) and p.inside(0, 0.1) == 0.1
    loose = make_serial(chain.rows, chain.ends, task(), chain.n, orders(limits=0.0))
    assert loose.inside(0, 99.0) == 99.0
    assert make_serial(chain.rows, chain.ends, task(), chain.n, orders(limits=0.0, follow=0.1)).inside(0, 99.0) < 99.0
    part = make_serial(chain.rows, chain.ends, task(KIND.part), chain.n, orders())
    part.aim(np.eye(4), orders())
    part.desk.q[:] = 0.0
    part.undo(look)
    assert part.desk.spent[0] == 1.0
    assert p.desk.affords(1.0) == (5.0 + 1.0 < p.desk.spent[1])
    p.desk.spent[1] = 7.0
    assert p.desk.affords(1.0) and not p.desk.affords(2.0)
