"""The search loop: what ends an attempt, for every rule, with one tip and with several."""

import math

import numpy as np
import pinocchio as pin
import pytest
import robots
from numba import config, njit

import ik_toolkit as ik
from ik_toolkit.compile.jit import OPTIONS
from ik_toolkit.kernel.records import Ends

TIPS = ["left_tip", "right_tip"]
RULES = ("lm", "dls", "pinv", "transpose", "ccd", "pid", "state-space")


@pytest.fixture(scope="module")
def brokk():
    return ik.Tree.load("brokk_hydrolek", tips=TIPS)


def poses(tree, q):
    return np.array([T.homogeneous for T in tree.fk(q).values()])


# ------------------------------------------------------------------------------------------------ inside the tolerances
@pytest.mark.parametrize("rule", ["ccd", "pid"])
@pytest.mark.parametrize(("allowed", "off"), [(2.0, 2.5), (2.6, 3.0), (0.5, 0.6)])
def test_wide_tolerances_of_angles_are_angles_for_sweeping_rules_too(rule, allowed, off):
    """2 sin(off/2) is below `allowed` where off is not: the rule must not think that it has arrived."""
    robot = robots.load("panda")
    Q, _ = robots.sample(robot, 4, seed=31)
    for q in Q:
        T = robot.fk(q).homogeneous
        T[:3, :3] = pin.exp3(off * np.array([0.0, 0.6, 0.8])) @ T[:3, :3]
        result = ik.solve(robot, T, rule, q0=q, position_tolerance=0.5, orientation_tolerance=allowed)
        assert result.success and result.iterations > 0
        assert robot.errors(result.q, T)[1] <= allowed


# ------------------------------------------------------------------------------------------------ budget of evaluations
def budget_targets(robot):
    """A pose in reach, one out of reach, and one in reach from a start several turns away."""
    Q, T = robots.sample(robot, 2, seed=32)
    far = T[0].copy()
    far[:3, 3] *= 3.0 * robot.reach / np.linalg.norm(far[:3, 3])
    turned = np.where(np.isinf(robot.upper), robot.home + 4.0 * math.pi, robot.home)
    return [(T[0], robot.home), (far, robot.home), (T[1], turned), (T[1], None), (robot.fk(Q[0]).homogeneous, Q[0])]


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("name", ["panda", "kinova"])
def test_the_budget_of_evaluations_is_never_overrun(rule, name):
    robot = robots.load(name)
    for T, q0 in budget_targets(robot):
        for budget in (1, 2, 3, 4, 7, 15, 40):
            result = ik.solve(robot, T, rule, q0=q0, max_evaluations=budget)
            assert result.fk_evaluations <= budget
            error = robot.errors(result.q, T)
            assert result.position_error == pytest.approx(error[0], abs=1e-9)
            assert result.orientation_error == pytest.approx(error[1], abs=1e-7)
            assert not robot.outside(result.q)


@pytest.mark.parametrize("options", [{"mask": (1, 1, 1, 0, 0, 1), "frame": "tip"}, {"closest": True}, {"restarts": 5}])
@pytest.mark.parametrize("rule", ["lm", "ccd"])
def test_the_budget_holds_with_every_option(rule, options):
    robot = robots.load("kinova")
    for T, q0 in budget_targets(robot):
        for budget in (1, 2, 6, 25):
            result = ik.solve(robot, T, rule, q0=q0, max_evaluations=budget, **options)
            assert result.fk_evaluations <= budget


def test_a_sweep_that_the_budget_cuts_off_is_no_standstill():
    robot = robots.load("panda")
    T = robots.sample(robot, 1, seed=33)[1][0]
    for rule in ("ccd", "pid"):
        for budget in (1, 2, 3, 5):
            result = ik.solve(robot, T, rule, q0=robot.home, max_evaluations=budget)
            assert result.status is ik.Status.ITERATION_LIMIT
            assert "max_evaluations" in result.message


def test_the_budget_of_several_tips_is_never_overrun(brokk):
    rng = np.random.default_rng(34)
    for rule in ("lm", "ccd"):
        for _ in range(3):
            T = poses(brokk, brokk.random_q(rng))
            for budget in (1, 2, 5, 30):
                assert ik.solve(brokk, T, rule, q0=brokk.home, max_evaluations=budget).fk_evaluations <= budget


# ------------------------------------------------------------------------------------------------ several tips
# Compiled for several tips, each rule takes 4 to 7 s.
@pytest.mark.parametrize(
    ("rule", "near", "least", "tolerance"),
    [
        pytest.param("dls", 0.3, 10, 1e-6, marks=pytest.mark.slow),
        pytest.param("pinv", 0.1, 8, 1e-6, marks=pytest.mark.slow),
        pytest.param("transpose", 0.05, 8, 1e-3, marks=pytest.mark.slow),
        ("ccd", 0.1, 3, 1e-2),
        pytest.param("pid", 0.1, 3, 1e-2, marks=pytest.mark.slow),
    ],
)
def test_rules_solve_for_several_tips(brokk, rule, near, least, tolerance):
    rng = np.random.default_rng(3)
    good = 0
    for _ in range(10):
        q = brokk.random_q(rng)
        start = np.clip(q + near * rng.uniform(-1, 1, brokk.n), brokk.lower, brokk.upper)
        result = ik.solve(brokk, poses(brokk, q), rule, q0=start, tolerance=tolerance)
        good += result.success
        worst = max(error[0] for error in brokk.errors(result.q, poses(brokk, q)))
        assert result.position_error == pytest.approx(worst, abs=1e-9)
        assert not brokk.outside(result.q)
    assert good >= least


@pytest.mark.parametrize("frame", ["base", "tip"])
def test_a_mask_counts_at_every_tip(brokk, frame):
    rng = np.random.default_rng(5)
    for _ in range(5):
        q = brokk.random_q(rng)
        result = ik.solve(brokk, poses(brokk, q), mask=(1, 1, 1, 0, 0, 1), frame=frame)
        assert result.success, result.message
        for T, goal in zip(poses(brokk, result.q), poses(brokk, q), strict=True):
            axes = np.eye(3) if frame == "base" else T[:3, :3].T
            assert np.linalg.norm(T[:3, 3] - goal[:3, 3]) <= 1e-6
            assert abs((axes @ pin.log3(goal[:3, :3] @ T[:3, :3].T))[2]) <= 1e-6


def test_the_closest_answer_for_several_tips_is_no_further(brokk):
    rng = np.random.default_rng(7)
    nearer = 0
    for _ in range(6):
        T = poses(brokk, brokk.random_q(rng))
        first, closest = ik.solve(brokk, T, q0=brokk.home), ik.solve(brokk, T, q0=brokk.home, closest=True)
        assert first.success and closest.success
        away = [np.linalg.norm(result.q - brokk.home) for result in (first, closest)]
        assert away[1] <= away[0] + 1e-9
        nearer += away[1] < away[0] - 1e-3
    assert nearer > 0


# ------------------------------------------------------------------------------------------------ how it is compiled
@pytest.mark.skipif(config.DISABLE_JIT, reason="there is nothing to look at without compilation")
def test_records_of_arrays_are_passed_without_counting_references():
    @njit(**OPTIONS)
    def total(flat):
        box = Ends(flat, 2)
        value = 0.0
        for i in range(2):
            value += box.lower(i) + box.upper(i)
        return value

    assert total(np.arange(60.0)) == 24 + 25 + 26 + 27
    (text,) = total.inspect_llvm().values()
    body = text[text.index("define") :]
    assert "call void @NRT_incref" not in body.split("wrapper")[0]
