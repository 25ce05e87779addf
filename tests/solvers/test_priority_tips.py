"""The option `priority` with several tips."""

import math

import numpy as np
import pinocchio as pin
import pytest

import ik_toolkit as ik


def test_several_tips_in_an_order_of_their_own():
    tree = ik.Tree.load("brokk_hydrolek")
    rng = np.random.default_rng(8)
    for _ in range(10):
        at = tree.fk(tree.random_q(rng))
        T = {tip: at[tip].homogeneous.copy() for tip in tree.tips}
        for tip in tree.tips:
            T[tip][:3, :3] = pin.exp3(rng.uniform(-0.3, 0.3, 3)) @ T[tip][:3, :3]
        both = ik.solve(tree, T, priority="position")
        assert both.success and max(both.position_errors.values()) <= 1e-6
        order = [("left_tip", "position"), ("left_tip", "orientation"), "right_tip"]
        first = ik.solve(tree, T, priority=order)
        assert first.success and first.position_errors["left_tip"] <= 1e-6
        assert [list(level) for level in first.level_errors] == [
            ["left_tip position"], ["left_tip orientation"], ["right_tip position", "right_tip orientation"],
        ]  # fmt: skip
        assert first.orientation_errors["left_tip"] <= both.orientation_errors["left_tip"] + 1e-3
    equal = [["left_tip", "right_tip"]]
    assert ik.solve(tree, at, priority=equal).success


@pytest.mark.parametrize("seed", [2, 4])
def test_two_hands_that_hold_something_come_as_near_as_they_can(seed):
    tree, rng = ik.Tree.load("brokk_hydrolek"), np.random.default_rng(seed)
    left, right = "left_tip", "right_tip"
    home, T = tree.fk(tree.home), tree.fk(tree.random_q(rng))[left].homogeneous
    T[:3, 3] *= 1.0 + rng.uniform(0.0, 0.6)
    held = {left: T, right: home[left].actInv(home[right]).homogeneous}
    left_over = []
    for k in range(3):
        result = ik.solve(tree, held, relative_to={right: left}, priority=[right, left], seed=k)
        assert result.success and result.position_errors[right] < 1e-6
        away = result.position_errors[left] / tree.reach, 2.0 * math.sin(0.5 * result.orientation_errors[left])
        left_over.append(math.hypot(*away))
    least, next_to_it, _ = sorted(left_over)
    assert next_to_it < 1.01 * least


def test_what_three_levels_leave_is_a_minimum():
    """The second level, once it is met, is a constraint of the third."""
    tree = ik.Tree.load("brokk_hydrolek")
    P, rng = tree.fk(tree.home), np.random.default_rng(5)
    met = 0
    for _ in range(20):
        T = {tip: pose.homogeneous for tip, pose in P.items()}
        T["left_tip"][:3, 3] += rng.uniform(-0.3, 0.3, 3)
        T["left_tip"][:3, :3] = pin.exp3(rng.uniform(-3.0, 3.0, 3))
        result = ik.solve(tree, T, priority=["right_tip", ("left_tip", "position")], q0=tree.home, restarts=0)
        met += result.success and result.position_errors["left_tip"] < 1e-6
    assert met >= 19  # 17, if the second level never joins the constraint
