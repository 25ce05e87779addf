"""Refinement of a whole piece: shorter, on every pose, inside limits and steps, and without new contacts."""

import functools
from xml.etree import ElementTree

import numpy as np
import pytest
import trees
from motions import plan_for, tips

import ik_toolkit as ik
from ik_toolkit.compile.jit import jit
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.paths.continuity import settle_on_targets
from ik_toolkit.paths.finish import smooth
from ik_toolkit.paths.smoothing import band_cholesky, band_solve

STEP = (np.radians(7.0), 0.02)


@jit
def solved(A, x):
    band_cholesky(A, 0.0)
    band_solve(A, x)


@pytest.mark.parametrize("size, width", [(1, 3), (7, 3), (60, 14), (40, 39)])
def test_a_band_is_solved_as_the_full_matrix(size, width):
    rng = np.random.default_rng(size)
    full = np.tril(np.triu(rng.normal(size=(size, size)), -width))
    full = np.tril(full @ full.T)
    full = np.tril(np.triu(full, -width)) + np.tril(np.triu(full, -width), -1).T + 10.0 * size * np.eye(size)
    band = np.zeros((size, width + 1))
    for i in range(size):
        for k in range(max(0, i - width), i + 1):
            band[i, k - i + width] = full[i, k]
    x = rng.normal(size=size)
    wanted = np.linalg.solve(full, x)
    solved(band, x)
    np.testing.assert_allclose(x, wanted, rtol=1e-9)


@functools.cache
def wavy(name, count=120):
    """A plan, kinds, poses (N, F, 4, 4) and joints that follow them with needless motion."""
    rng = np.random.default_rng(4)
    if name == "two arms":
        robot = ik.Tree.load(trees.mixed(), tips=["left_tip", "right_tip"])
    else:
        robot = ik.Robot.load(
            {"redundant": "inspection_7dof", "free turn": "hydrolek_7w", "position": "planar_3r"}[name]
        )
    options = {"free_turn": (0.0, 0.0, 1.0)} if name == "free turn" else {}
    kinds = ((KIND.position,) if name in ("position", "two arms") else (KIND.pose,)) * len(robot.tips)
    t = np.linspace(0.0, 1.0, count)
    start = robot.home
    q = start + 0.25 * np.sin(np.pi * t)[:, None] * rng.uniform(-1.0, 1.0, robot.n)
    q = np.clip(q, robot.lower, robot.upper)
    T = tips(robot, q)
    plan = plan_for(robot, **options)
    q = np.clip(
        q + 0.1 * np.sin(9.0 * t)[:, None] * rng.uniform(-1.0, 1.0, robot.n) + rng.uniform(-0.01, 0.01, q.shape),
        robot.lower,
        robot.upper,
    )
    q, good = settle_on_targets(plan, kinds, q, T)
    assert good.all()
    return plan, kinds, T, q


def length(q):
    return np.abs(np.diff(q, axis=0)).sum()


@pytest.mark.parametrize(
    "name", ["redundant", "free turn", "position", pytest.param("two arms", marks=pytest.mark.slow)]
)
def test_a_path_gets_shorter_and_stays_on_its_poses(name):
    plan, kinds, T, q = wavy(name)
    robot = plan.robot
    made = smooth(plan, kinds, q, T, STEP)
    assert length(made) < 0.995 * length(q)
    assert (robot.lower <= made).all() and (made <= robot.upper).all()
    again, good = settle_on_targets(plan, kinds, made, T)
    assert good.all() and np.abs(again - made).max() < 1e-9  # the task error is zero already
    assert np.abs(np.diff(made, axis=0)).max() <= max(STEP[0], np.abs(np.diff(q, axis=0)).max()) + 1e-12
    assert np.abs(np.diff(made, n=2, axis=0)).max() < 0.2 * np.abs(np.diff(q, n=2, axis=0)).max()


def test_poses_that_are_fixed_keep_their_joints():
    plan, kinds, T, q = wavy("redundant")
    fixed = np.zeros(len(q), dtype=bool)
    fixed[[0, 50, -1]] = True
    made = smooth(plan, kinds, q, T, STEP, fixed)
    np.testing.assert_array_equal(made[fixed], q[fixed])
    assert length(made) < length(q)


def test_where_the_refined_path_is_bad_the_old_one_stays():
    plan, kinds, T, q = wavy("redundant")
    changed = []

    def bad(made):
        changed.append(np.flatnonzero(np.abs(made - q).max(axis=1) > 1e-3))
        return [k for k in changed[-1] if 40 <= k < 45]

    made = smooth(plan, kinds, q, T, STEP, bad=bad)
    assert len(changed) == 2 and len(changed[0])
    np.testing.assert_array_equal(made[40:45], q[40:45])
    assert length(made) < length(q)
    assert smooth(plan, kinds, q, T, STEP, bad=lambda made: [len(q) // 2]) is q  # as it was, not a copy


def test_joints_at_their_limits_slide_along_them():
    """With a limit that the unconstrained refinement would exceed, the refined path stays at the limit and is still shorter."""
    plan, kinds, T, q = wavy("redundant")
    robot = plan.robot
    free = smooth(plan, kinds, q, T, STEP)
    beyond = np.maximum(free.max(axis=0) - q.max(axis=0), 0.0)
    joint = int(np.argmax(beyond))
    assert beyond[joint] > 0.02
    limit = q[:, joint].max() + 0.5 * beyond[joint]
    tree = ElementTree.fromstring(robot.urdf)
    found = tree.find(f"./joint[@name='{robot.joint_names[joint]}']/limit")
    found.set("upper", repr(float(limit)))
    narrow = plan_for(ik.Robot.load(ElementTree.tostring(tree, encoding="unicode"), tip=robot.tip, base=robot.base))
    made = smooth(narrow, kinds, q, T, STEP)
    assert made[:, joint].max() == pytest.approx(limit, abs=1e-5) and (made <= narrow.robot.upper).all()
    assert length(free) < length(made) < length(q)
    assert settle_on_targets(narrow, kinds, made, T)[1].all()
