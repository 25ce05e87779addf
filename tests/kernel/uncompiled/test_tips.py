"""Problems of several tips, against matrices and finite differences."""

import math

import numpy as np
import pinocchio as pin
import pytest
import random_arms as arms
from random_arms import PARTS, errors, orders, task

from ik_toolkit.compile.array_view import space
from ik_toolkit.kernel.chain import pack_tree
from ik_toolkit.kernel.counted_error import AXES, KIND
from ik_toolkit.kernel.records import WHAT, Ends
from ik_toolkit.kernel.tree import tree_on


def make_tree(rows, ends, tasks, n, orders):
    """The problem of several tips, with scratch arrays of its own."""
    block = np.zeros(space(n, 6 * len(ends), len(rows), 0))
    return tree_on(block, rows, ends, tasks, n, orders)


def pair(rng, left="tttstt", right="tttst"):
    """Two arms that share their first two coordinates: the tree, and rows, base, tip and places of each."""
    parts, chains_, places = [], [], []
    count = 0
    for f, kinds in enumerate((left, right)):
        rows, n, slides = arms.table(rng, kinds)
        rows[:, [2, 3, 7]] *= 1.0 + 3.0 * f  # of another size, so of another scale
        base, tip = arms.frame(rng), arms.frame(rng)
        place = np.arange(n) if f == 0 else np.array([0, 1, *range(count, count + n - 2)])
        count = max(count, place.max() + 1)
        parts.append((rows, base, tip))
        places.append(place)
        slide = slides if f == 0 else np.append(slide, slides[2:])  # noqa: F821
    half = np.where(slide, 0.4, 1.5)
    for (rows, base, tip), place in zip(parts, places, strict=True):
        chains_.append(arms.packed(rows, base, tip, -half[place], half[place]))
    tree = pack_tree(chains_, places, -half, half, 0.1 * half)
    return tree, [(*part, place) for part, place in zip(parts, places, strict=True)]


def test_a_tree_joins_its_chains():
    rng = np.random.default_rng(60)
    tree, parts = pair(rng)
    n = len(tree.lower)
    Q = rng.uniform(tree.lower, tree.upper, (3, n))
    T, J = tree.forward(Q, True)
    for k, q in enumerate(Q):
        for f, (rows, base, tip, place) in enumerate(parts):
            np.testing.assert_allclose(T[k, f], arms.fk(rows, base, tip, q[place])[0], atol=1e-13)
            want = np.zeros((6, n))
            want[:, place] = arms.jacobian(rows, base, tip, q[place])
            np.testing.assert_allclose(J[k, 6 * f : 6 * f + 6], want, atol=2e-9)
    ends = tree.ends
    np.testing.assert_array_equal(ends[:, -n - 1], [6, 5])
    for f, (rows, base, tip, place) in enumerate(parts):
        np.testing.assert_array_equal(np.flatnonzero(ends[f, -n:]), np.unique(place))
        box = Ends(ends[f], n)
        assert [box.upper(i) * box.unit(i) for i in range(n)] == pytest.approx(list(tree.upper))
        assert [box.home(i) * box.unit(i) for i in range(n)] == pytest.approx(list(0.1 * tree.upper))
        single = arms.packed(rows, base, tip, tree.lower[place], tree.upper[place])
        for k in range(6):
            assert box.bound(k) * box.scale() == pytest.approx(Ends(single.ends, single.n).bound(k) * single.scale)
        q = tree.seeds[7] * tree.unit
        pose, frames = arms.fk(rows, np.eye(4), tip, q[place])
        point = pose[:3, 3] / tree.scale
        want = [*(-2.0 * point), *(-0.1 * frames[-1][:3, :3].ravel()), point @ point]
        np.testing.assert_allclose(tree.features[f][:, 7], want, atol=1e-5)
    assert len(tree.parts) == 2 and not tree.turns.any() and tree.seeds.shape == (2048, n)


def apart(parts, q, T, tasks_, scale):
    """Errors of all tips that count; a target relative to the other tip moves with it."""
    poses = [arms.fk(rows, base, tip, q[place])[0] for rows, base, tip, place in parts]
    out = []
    for f, (rows, base, tip, place) in enumerate(parts):
        other = int(tasks_[f][WHAT.other])
        goal = poses[other] @ T[f] if other >= 0 else T[f]
        if int(tasks_[f][WHAT.kind]) == KIND.position:
            out.append([*((goal[:3, 3] - poses[f][:3, 3]) / scale), 0, 0, 0])
        elif int(tasks_[f][WHAT.kind]) == KIND.free:
            out.append(np.zeros(6))
        else:
            out.append(errors(rows, base, tip, q[place], goal, tasks_[f], scale))
    return np.concatenate(out)


@pytest.mark.parametrize("other", [False, True])
@pytest.mark.parametrize("frame", [AXES.base, AXES.tip, AXES.target])
@pytest.mark.parametrize("part", [0, 2, 3])
def test_errors_of_several_tips_and_their_derivative(other, frame, part):
    rng = np.random.default_rng(70 + 10 * part + frame)
    tree, parts = pair(rng)
    n = len(tree.lower)
    each = [
        task(KIND.part, frame=float(frame), **PARTS[part]),
        task(KIND.part, frame=float(frame), other=0.0 if other else -1.0, **PARTS[part]),
    ]
    if part == 0 and frame == AXES.base:
        each[0] = task(KIND.position)
    if part == 0 and frame == AXES.tip:
        each[0] = task(KIND.free)
    p = make_tree(tree.rows, tree.ends, np.concatenate(each), n, orders())
    q, goal = (rng.uniform(tree.lower, tree.upper) for _ in range(2))
    T = np.array([arms.fk(rows, base, tip, goal[place])[0] for rows, base, tip, place in parts])
    if other:
        T[1] = np.linalg.inv(T[0]) @ T[1]
    assert p.aim(T, orders()) == 0.0
    x = q / tree.unit
    look = p.evaluate(x)
    p.stack(look)
    y = p.desk.y.copy()
    want = apart(parts, q, T, each, tree.scale)

    def turned_(e):
        """POSITION errors are in the first joint's axes."""
        e = e.copy()
        if int(each[0][WHAT.kind]) == KIND.position:
            e[:3] = parts[0][1][:3, :3].T @ e[:3]
        return e

    np.testing.assert_allclose(y, turned_(want), atol=1e-9)
    assert look.ee == pytest.approx(p.desk.e @ p.desk.e) and not look.good
    p.jacobian(look)
    J, d = p.desk.J.copy(), 1e-6
    for i in range(n):
        step = np.zeros(n)
        step[i] = d * tree.unit[i]
        a, b = apart(parts, q - step, T, each, tree.scale), apart(parts, q + step, T, each, tree.scale)
        np.testing.assert_allclose(J[i], turned_((a - b) / (2 * d)), atol=5e-8)
        assert p.slope(look, i) == pytest.approx(J[i] @ p.desk.e)
        size = J[i] @ J[i]
        assert p.best_move(look, i, 1e-12) == pytest.approx(J[i] @ y / size if size > 1e-12 else 0.0, rel=1e-8)
        assert p.best_move(look, i, 1e9) == 0.0
    assert p.norm(look, 0.3) == pytest.approx(
        math.sqrt(sum((y[k : k + 3] @ y[k : k + 3]) + 0.09 * (y[k + 3 : k + 6] @ y[k + 3 : k + 6]) for k in (0, 6)))
    )
    w = rng.uniform(0.5, 2.0, n)
    p.desk.w[:] = w
    A = J.T * w @ J + 0.01 * np.eye(12)
    p.damped(look, 0.01)
    np.testing.assert_allclose(p.desk.dq, w * (J @ np.linalg.solve(A, p.desk.e)), atol=1e-8)
    p.toward(np.arange(12.0), 0.01)
    np.testing.assert_allclose(p.desk.dq, w * (J @ np.linalg.solve(A, np.arange(12.0))), rtol=1e-6, atol=1e-6)
    p.keep(look, 2)
    free = int(each[0][WHAT.kind]) == KIND.free
    for f in range(2):
        left = p.left_at(2, f)
        e = y[6 * f : 6 * f + 6]
        assert left[0] == pytest.approx(np.linalg.norm(e[:3]) * tree.scale) and left[1] == pytest.approx(
            np.linalg.norm(e[3:])
        )
    assert p.left(2) == pytest.approx(tuple(np.max([p.left_at(2, f) for f in range(2)], axis=0)))
    row = np.zeros(20)
    p.report(2, row)
    np.testing.assert_allclose(row[-6:], [*p.left_at(2, 0), 0.0, *p.left_at(2, 1), 0.0])
    assert not row[:-6].any() and p.width() == 12 and not p.plain()
    q2 = p.try_out(goal / tree.unit)
    assert q2.good and p.desk.spent[0] == 1.0 and p.arrived(1) and p.arrived(0) == (not free)
    p.desk.q[:] = x
    p.undo(look)
    assert p.desk.spent[0] == 2.0
    p.head_for(T)
    np.testing.assert_allclose(p.evaluate(x).ee, look.ee)
    p.jacobian(look)
    p.pseudo(look, 1e-6)
    np.testing.assert_allclose(p.desk.dq, np.linalg.pinv(J.T, 1e-6) @ y, atol=1e-5)


def test_whole_poses_of_several_tips():
    rng = np.random.default_rng(80)
    tree, parts = pair(rng)
    n = len(tree.lower)
    tol = orders(tol_p=1e-3, tol_r=1e-3)
    p = make_tree(tree.rows, tree.ends, np.concatenate([task(), task(KIND.position)]), n, tol)
    assert p.plain()
    q = rng.uniform(tree.lower, tree.upper)
    T = np.array([arms.fk(rows, base, tip, q[place])[0] for rows, base, tip, place in parts])
    now = q + 0.1 * rng.normal(size=n) * tree.unit
    assert p.aim(T, tol) == 0.0 and p.evaluate(q / tree.unit).good
    look = p.evaluate(now / tree.unit)
    p.stack(look)
    out = np.empty(12)
    p.base_axes(p.desk.y, out)
    own = [arms.fk(rows, base, tip, now[place])[0] for rows, base, tip, place in parts]
    want = [
        T[0, :3, 3] - own[0][:3, 3],
        pin.log3(T[0, :3, :3] @ own[0][:3, :3].T),
        T[1, :3, 3] - own[1][:3, 3],
        np.zeros(3),
    ]
    np.testing.assert_allclose(out, np.concatenate(want), atol=1e-11)
    V = rng.normal(size=12)
    p.moving(V, out)
    R = [part[1][:3, :3].T for part in parts]
    np.testing.assert_allclose(
        out, [*(R[0] @ V[:3] / tree.scale), *(R[0] @ V[3:6]), *(R[1] @ V[6:9] / tree.scale), 0, 0, 0], atol=1e-13
    )
    p.jacobian(look)
    a, b = rng.normal(size=n), rng.normal(size=n)
    p.bending(look, a, b, out)
    moved = []
    for sign in (1.0, -1.0):
        p.jacobian(p.evaluate(now / tree.unit + sign * 1e-6 * a))
        moved.append(p.desk.J.T @ b)
    np.testing.assert_allclose(out, (moved[0] - moved[1]) / 2e-6, atol=1e-6)
    flip = np.ones((2, 3))
    p.mirrors(flip)
    assert not flip.any()
    far = T.copy()
    far[1, :3, 3] += 10.0 * tree.scale
    excess = p.aim(far, tol)
    assert excess > 5.0 and p.tips[0, 0] == 0.0 and p.tips[1, 0] == excess
    bad = T.copy()
    bad[0, 0, 0] = np.nan
    assert p.aim(bad, tol) == -1.0
    linked = make_tree(tree.rows, tree.ends, np.concatenate([task(), task(KIND.pose, other=0.0)]), n, tol)
    assert linked.aim(T[:, :, :], tol) == 0.0 and not linked.plain()
    bad = T.copy()
    bad[1, 3, 3] = 2.0
    assert linked.aim(bad, tol) == -1.0
    linked.aim(np.array([T[0], np.linalg.inv(T[0]) @ T[1]]), tol)
    assert linked.evaluate(q / tree.unit).good
    linked.moving(V, out)
    A = T[0, :3, :3]
    np.testing.assert_allclose(out[6:], [*(R[1] @ A @ V[6:9] / tree.scale), *(R[1] @ A @ V[9:])], atol=1e-12)
    assert p.inside(0, 9.0) == Ends(tree.ends[0], n).upper(0) and p.inside(0, -9.0) == Ends(tree.ends[0], n).lower(0)


@pytest.mark.parametrize("kind", ["pose", "weights", "free turn"])
@pytest.mark.parametrize("other", [False, True])
def test_second_derivatives_of_the_errors(other, kind):
    """Of what is minimised anywhere, and of a constraint along its null space, where it is met."""
    rng = np.random.default_rng(80)
    tree, parts = pair(rng)
    n, link = len(tree.lower), 0.0 if other else -1.0
    second = {
        "pose": task(other=link),
        "weights": task(KIND.part, other=link, w0=0.6, w1=0.6, w2=0.6, w3=0.3, w4=0.3, w5=0.3),
        "free turn": task(KIND.part, other=link, free=1.0, ax=0.48, ay=0.6, az=0.64),
    }[kind]
    p = make_tree(tree.rows, tree.ends, np.concatenate([task(), second]), n, orders())
    q, goal = (rng.uniform(tree.lower, tree.upper) for _ in range(2))
    T = np.array([arms.fk(rows, base, tip, goal[place])[0] for rows, base, tip, place in parts])
    if other:
        T[1] = np.linalg.inv(T[0]) @ T[1]
    p.aim(T, orders())
    turned = np.array([1.0 if g % 2 and (g == 1 or kind == "pose") else 0.0 for g in range(4)])

    def gradient(x, weights):
        """Of half the squared errors, or of the errors times `weights`; a pose's rotation error counts as 1 - cos(angle)."""
        p.jacobian(look := p.evaluate(x))
        p.stack(look)
        factors = p.desk.y.copy() if weights is None else weights
        for g in np.flatnonzero(turned) if weights is None else ():
            factors[3 * g : 3 * g + 3] *= p.tilt(g)
        return -p.desk.J @ factors

    def differences(x, weights=None):
        steps = 1e-6 * np.eye(n)
        return np.array([gradient(x + d, weights) - gradient(x - d, weights) for d in steps]) / 2e-6

    def second_derivatives(x, weights, chosen):
        p.jacobian(look := p.evaluate(x))
        p.stack(look)
        H = np.zeros((n, n))
        p.curvature(-p.desk.y if weights is None else -weights, np.full(4, chosen), H)
        return H

    x = q / tree.unit
    np.testing.assert_allclose(second_derivatives(x, None, 1.0), differences(x), atol=1e-8)
    x, weights = goal / tree.unit, rng.normal(size=12)
    for f in range(2):
        only = weights * (np.arange(12) // 6 == f)
        H = second_derivatives(x, only, 0.0)
        _, sizes, V = np.linalg.svd(p.desk.J[:, 6 * f : 6 * f + 6].T)
        Z = V[np.count_nonzero(sizes > 1e-9) :].T
        assert Z.shape[1] >= n - 6
        np.testing.assert_allclose(Z.T @ H @ Z, Z.T @ differences(x, only) @ Z, atol=1e-8)
