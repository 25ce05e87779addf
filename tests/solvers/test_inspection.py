"""The closed form of the inspection arm: oracle cases, completeness of the branches, choices of the lift."""

import math
import subprocess
import sys

import numpy as np
import pytest
import robots
from folders import read_data
from serial_arms import apart

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.solvers.closed_form import fits, inspection, reach
from ik_toolkit.text import length

DATA = read_data("closed_form")
PI = math.pi


def all_branches(robot, T, lift):
    """Every branch at a lift, limits ignored."""
    return ik.solve_all(robot, T, ik.Inspection(lift=float(lift)), limits=False)


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("inspection_7dof")


@pytest.fixture(scope="module")
def every(arm):
    """Fast access to the compiled branches: (T, lift) -> (k, 7)."""
    p = ik.Inspection().pack(arm)
    box = np.vstack([np.full(7, -np.inf), np.full(7, np.inf), np.zeros(7), np.ones(7)])
    out, broken = np.empty((8, 7)), np.empty(8)

    def call(T, lift, near=None):
        box[2] = 0.0 if near is None else near
        return out[: inspection.every_branch(p, T, box, np.array([lift]), out, broken)].copy()

    return call


# ------------------------------------------------------------------------------------------------ inspection: oracles
@pytest.mark.parametrize("case", DATA["configurations"])
def test_reference_configurations(arm, case):
    T = np.array(case["T"])
    found = all_branches(arm, T, case["q"][1])
    expected = np.array(case["solutions_at_lift"])
    assert len(found) == len(expected) == 8 and found.complete
    d = apart(found.q, expected)
    assert d.min(axis=0).max() < 1e-9 and d.min(axis=1).max() < 1e-9
    assert found.position_error.max() < 1e-12 and found.orientation_error.max() < 1e-12
    spans = inspection.feasible_lifts(ik.Inspection().pack(arm), T)
    assert np.shape(spans) == np.shape(case["lift_intervals"])
    assert np.abs(np.array(spans) - case["lift_intervals"]).max() < 1e-9


@pytest.mark.parametrize("case", DATA["singular"], ids=lambda c: c["name"])
def test_singular_configurations_merge_and_still_solve(arm, every, case):
    T, q = np.array(case["T"]), np.array(case["q"], dtype=float)
    found = every(T, q[1], near=q)
    assert len(found) == case["solutions_at_lift"]
    assert np.abs(arm.chain.forward(found)[0] - T).max() < 1e-12
    assert apart([q], found).min() < 1e-9  # what is free is taken from the reference, so q itself is found


@pytest.mark.parametrize("case", DATA["unreachable"], ids=lambda c: c["name"])
def test_unreachable_poses(arm, case):
    T = np.array(case["T"])
    result = ik.solve(arm, T, ik.Inspection(lift=0.22))
    assert result.status == ik.Status.UNREACHABLE and not result.success
    gap = -case["reach_margin_at_0_220"]
    assert length(gap, 4) in result.message
    p = ik.Inspection().pack(arm)
    P = np.empty(12)
    inspection.wrist_pose(p, T, P)
    assert reach.inspection_nearest(P, 0.22, p[inspection.A4], p[inspection.A6]) == pytest.approx(gap, abs=1e-12)
    tip = P[9:] + 0.045 * P[[0, 3, 6]] + [0.0, 0.0, 0.53]
    assert np.abs(tip - case["closest_position_at_0_220"]).max() < 1e-9
    spans = inspection.feasible_lifts(p, T)
    assert np.allclose(spans, case["lift_intervals"], atol=1e-9) and len(spans) == len(case["lift_intervals"])
    free = ik.solve(arm, T, "inspection")
    expected = {
        "ok": ("CONVERGED", "LIMIT_BLOCKED"),
        "out-of-reach": ("UNREACHABLE",),
        "lift-range": ("LIMIT_BLOCKED",),
    }
    assert free.status.name in expected[case["reason"]]
    if case["reason"] == "lift-range":
        assert "the stroke of lift is" in free.message


def test_nearest_reachable_position_is_nearest(arm):
    """No sampled reachable wrist point with the same orientation is nearer than the projection."""
    rng = np.random.default_rng(3)
    p = ik.Inspection().pack(arm)
    a4, a6 = p[inspection.A4], p[inspection.A6]
    phi, psi = np.meshgrid(np.linspace(0, 2 * PI, 181), np.linspace(0, 2 * PI, 361))
    for _ in range(15):
        R = arm.fk(arm.random_q(rng)).rotation
        P = np.concatenate([R.ravel(), rng.uniform(-0.7, 0.7, 3)])
        moved = P.copy()
        gap = reach.inspection_nearest(moved, 0.1, a4, a6)
        assert np.linalg.norm(moved[9:] - P[9:]) == pytest.approx(gap, abs=1e-12)
        assert reach.inspection_margin(moved, 0.1, a4, a6) > -1e-12
        # Reachable set: shoulder minus the torus about the tool axis.
        ring = (a6 + a4 * np.cos(psi))[..., None] * (
            np.cos(phi)[..., None] * R[:, 0] + np.sin(phi)[..., None] * R[:, 1]
        )
        torus = np.array([0.0, 0.0, 0.1]) - ring - (a4 * np.sin(psi))[..., None] * R[:, 2]
        distance = np.linalg.norm(torus - P[9:], axis=-1).min()
        assert gap == 0.0 or abs(distance - gap) < 0.01


def test_ten_thousand_random_configurations(arm, every):
    rng = np.random.default_rng(0)
    Q = rng.uniform(-PI, PI, (10_000, 7))
    Q[:, 1] = rng.uniform(-0.2, 0.8, len(Q))
    T = arm.chain.forward(Q)[0]
    worst = 0.0
    for q, goal in zip(Q, T, strict=True):
        found = every(goal, q[1])
        assert len(found) == 8
        worst = max(worst, np.abs(arm.chain.forward(found)[0] - goal).max())
        assert apart([q], found).min() < 1e-6
    assert worst < 1e-9


def test_four_thousand_near_singular_configurations(arm, every):
    rng = np.random.default_rng(1)
    worst = 0.0
    for k in range(4000):
        q = rng.uniform(-PI, PI, 7)
        q[1] = rng.uniform(0.0, 0.44)
        near = 10.0 ** rng.uniform(-17, -4, 3) * rng.choice((-1, 1), 3) * (rng.random(3) < 0.8)
        sets = [(2, rng.choice((0.0, PI))), (5, rng.choice((0.0, PI))), (4, rng.choice((-1, 1)) * PI / 2)]
        for i in rng.permutation(3)[: 1 + k % 3]:
            joint, value = sets[i]
            q[joint] = value + near[i]
        T = arm.chain.forward(q)[0][0]
        found = every(T, q[1], near=q)
        assert len(found) >= 1
        worst = max(worst, np.abs(arm.chain.forward(found)[0] - T).max())
    assert worst < 1e-10  # 4e-9 where the reach is not kept inside what the elbow spans


# -------------------------------------------------------------------------------------- inspection: the public solver
def test_lift_choices(arm):
    q = arm.home + 0.05
    T = arm.fk(q)
    assert ik.solve(arm, T, "inspection", q0=q).q[1] == pytest.approx(q[1], abs=1e-12)
    assert ik.solve(arm, T, ik.Inspection(lift=0.3)).q[1] == 0.3
    spans = inspection.feasible_lifts(ik.Inspection().pack(arm), T.homogeneous, arm.lower[1], arm.upper[1])
    middle = ik.solve(arm, T, "inspection", lift="mid")
    assert middle.q[1] == pytest.approx(np.mean(max(spans, key=lambda s: s[1] - s[0])), abs=1e-9)
    for wrong in ("top", math.nan):
        with pytest.raises(InvalidOption, match="lift"):
            ik.solve(arm, T, ik.Inspection(lift=wrong))


def test_lift_moves_when_its_first_choice_has_no_legal_branch(arm):
    rng = np.random.default_rng(5)
    moved = 0
    for _ in range(100):
        T = arm.fk(arm.random_q(rng))
        result = ik.solve(arm, T, "inspection")
        assert result.success and not arm.outside(result.q)
        moved += not ik.solve(arm, T, ik.Inspection(lift=0.22)).success
    assert moved > 16


def test_answer_is_the_legal_branch_nearest_q0(arm):
    rng = np.random.default_rng(6)
    solver = ik.Inspection(lift=0.25)
    for _ in range(50):
        q = arm.random_q(rng)
        q[1] = 0.25
        q0 = arm.random_q(rng)
        found = ik.solve_all(arm, arm.fk(q), solver, q0=q0)
        assert found.complete and (np.diff(found.distance) >= 0).all()
        assert not any(arm.outside(x) for x in found)
        assert np.abs(ik.solve(arm, arm.fk(q), solver, q0=q0).q - found[0]).max() < 1e-12
        branches = np.remainder(ik.solve_all(arm, arm.fk(q), solver, q0=q0, limits=False).q + PI, 2 * PI) - PI
        assert sum(not arm.outside(x) for x in branches) == len(found)


def test_every_branch_outside_the_limits_is_limit_blocked(arm):
    q = np.array([0.0, 0.22, 0.3, 0.2, 0.4, 0.9, 3.0])  # no branch of it has the last joint within 120 degrees
    result = ik.solve(arm, arm.fk(q), ik.Inspection(lift=0.22))
    assert result.status == ik.Status.LIMIT_BLOCKED
    assert result.limited_joints and all(joint in result.message for joint in result.limited_joints)
    assert not arm.outside(result.q)
    assert result.position_error == pytest.approx(arm.errors(result.q, arm.fk(q).homogeneous)[0], abs=1e-12)
    assert ik.solve(arm, arm.fk(q), ik.Inspection(lift=0.22), limits=False).success
    assert result.q[1] == pytest.approx(0.22, abs=1e-12)
    assert not ik.solve(arm, arm.fk(q), ik.Inspection(lift=0.6)).success


def test_poses_that_need_more_stroke_name_the_lift(arm):
    """Out of reach at every legal lift but not at others: the lift's limit blocks; no lift at all: unreachable."""
    rng = np.random.default_rng(8)
    p = ik.Inspection().pack(arm)
    blocked = unreachable = 0
    for _ in range(120):
        q = arm.random_q(rng)
        q[1] = rng.uniform(-1.0, 1.5)
        T = arm.chain.forward(q)[0][0]
        if rng.random() < 0.3:
            T[:2, 3] *= 1.5
        result = ik.solve(arm, T, "inspection")
        spans = inspection.feasible_lifts(p, T)
        legal = inspection.feasible_lifts(p, T, arm.lower[1], arm.upper[1])
        if legal:
            assert result.status in (ik.Status.CONVERGED, ik.Status.LIMIT_BLOCKED)
        elif spans:
            blocked += 1
            assert result.status == ik.Status.LIMIT_BLOCKED and "the stroke of lift is" in result.message
        else:
            unreachable += 1
            assert result.status == ik.Status.UNREACHABLE
    assert blocked > 12 and unreachable > 6


def test_sample_pose_of_the_paper(arm):
    sample = DATA["sample"]
    result = ik.solve(arm, sample["target"], ik.Inspection(lift=0.22))
    assert "projected" in result.notice and result.status == ik.Status.UNREACHABLE
    assert f"{length(-sample['margin_at_0_220'], 4)} with its orientation kept" in result.message
    assert result.position_error <= -sample["margin_at_0_220"] + 1e-9
    free = ik.solve(arm, sample["target"])
    assert free.success and free.solver == "inspection"
    assert free.q[1] == pytest.approx(sample["lift_intervals"][0][0], abs=1e-9)
    found = ik.solve_all(arm, sample["target"], ik.Inspection(lift="mid"), limits=False)
    low, high = sample["lift_intervals"][0]
    at = ik.solve_all(arm, sample["projected"], ik.Inspection(lift=(low + high) / 2), limits=False)
    assert apart(at.q, sample["solutions_at_middle"]).min(axis=0).max() < 1e-9 and len(at) == len(found) == 8


def test_free_lift_lists_a_spread_and_says_so(arm):
    found = ik.solve_all(arm, arm.fk(arm.home))
    assert not found.complete and len(found) > 5 and "infinitely many" in found.message
    assert len(set(found.q[:, 1].round(6))) > 2 and found.position_error.max() < 1e-9
    lift = next(family for family in found.families if family.joints[0] == "lift")
    assert arm.lower[1] <= lift.lower < arm.home[1] < lift.upper <= arm.upper[1]
    assert ik.solve_all(arm, arm.fk(arm.home), count=3).distance[0] == found.distance[0]  # the nearest is among them
    few = ik.solve_all(arm, arm.fk(arm.home), ik.Inspection(lift=0.22), count=2, limits=False)
    assert len(few) == 2 and not few.complete


def test_a_branch_on_a_limit_is_inside_also_where_the_solve_leaves_limits_out(arm):
    for seed in range(2 * arm.n):
        q = arm.random_q(np.random.default_rng(seed))
        i = seed % arm.n
        q[i] = (arm.lower, arm.upper)[seed // arm.n][i]
        made = ik.solve(arm, arm.fk(q), q0=q, limits=False).explain()
        assert made.chosen is not None and not made.worked.branches[made.chosen].outside, seed


def test_locked_lift_is_complete_and_agrees_with_restarts(arm):
    held = arm.locked({"lift": 0.3})
    assert fits(held, KIND.pose) == "inspection" and fits(arm, KIND.position) is None
    T = held.fk(held.home + 0.1)
    exact = ik.solve_all(held, T, limits=False)
    search = ik.solve_all(held, T, "lm", limits=False)
    assert exact.complete and not search.complete and len(exact) == len(search) == 8
    assert apart(exact.q, search.q).min(axis=0).max() < 1e-6


LISTING = """
import numpy as np
from numba.core import event
import ik_toolkit as ik

with event.install_recorder("numba:compile") as compiled:
    arm = ik.Robot.load("inspection_7dof")
    T = arm.fk(arm.random_q(np.random.default_rng(0))).homogeneous
    ik.solve_all(arm, T), ik.solve_all(arm, T, "inspection")
print(len(compiled.buffer))
"""


def test_listing_compiles_nothing_in_a_second_process():
    exec(LISTING, {})
    done = subprocess.run([sys.executable, "-c", LISTING], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0"], done.stdout


def test_the_closed_form_takes_its_parameter_without_being_named(arm):
    T = arm.fk(arm.home)
    one = ik.solve(arm, T, lift=0.25)
    assert one.solver == "inspection" and one.success and one.q[1] == pytest.approx(0.25)
    assert ik.Solver(arm, lift=0.25)(T).q.tolist() == one.q.tolist()
    assert ik.solve_batch(arm, T.homogeneous[None], lift=0.25)[0].q.tolist() == one.q.tolist()
    assert all(q[1] == pytest.approx(0.25) for q in ik.solve_all(arm, T, lift=0.25).q)
    with pytest.raises(ik.IKError, match="'inspection' does not solve positions"):
        ik.solve(arm, T.translation, lift=0.25)
    with pytest.raises(ik.IKError, match=r"no option 'kp'.*Solvers with 'kp': pid"):
        ik.solve(arm, T, kp=2.0)
    with pytest.raises(ik.IKError, match="Solvers with 'lift': inspection"):
        ik.solve(ik.Robot.load("planar_3r"), (0.5, 0.2, 0.0), lift=0.25)
    with pytest.raises(ik.IKError, match="Solvers with 'lift': inspection"):
        ik.solve(arm, T, "lm", lif=0.25)
    with pytest.raises(ik.IKError, match=r"Did you mean 'max_iterations'\?(?!.*Solvers with)"):
        ik.solve(arm, T, "lm", maxiter=5)


AXES = ("0 0 1", "0 1 0", "1 0 0", "1 0 0", "0 0 1", "0 0 1")
PLACES = ("0 0 0.3", "0 0 0", "0 0 0", "0 0.4 0", "0 0 0", "0.3 0 0")


def shoulder_arm(limits):
    """An arm of the inspection robot's structure without a lift, with limits for each of its six joints, or `continuous`."""
    joints = [
        dict(kind="continuous" if box is None else "revolute", axis=axis, xyz=xyz, limits=box)
        for axis, xyz, box in zip(AXES, PLACES, limits, strict=True)
    ]
    return ik.Robot.load(robots.urdf(*joints, dict(kind="fixed", xyz="0.05 0.03 0.1"), name="shoulder"))


def test_one_value_of_a_free_elbow_proves_nothing():
    rng = np.random.default_rng(0)
    for _ in range(20):
        q = rng.uniform(-3.0, 3.0, 6)
        q[3] = np.pi / 2  # the shoulder is on the sixth axis, and the elbow turns freely
        robot = shoulder_arm([(x - 0.02, x + 0.02) for x in q])
        T, start = robot.fk(q), np.where(np.arange(6) == 4, robot.upper, q)
        alone = ik.solve(robot, T, "inspection", start, max_evaluations=1)  # the closed form, and no search after it
        assert alone.success or not alone.proven
        assert not ik.solve_all(robot, T, "inspection", start, max_evaluations=1).complete
        assert ik.solve(robot, T, q0=start).success


def test_a_pose_on_the_edge_of_reach_is_not_said_to_need_more_stroke(arm):
    rng = np.random.default_rng(0)
    for _ in range(300):
        level = arm.random_q(rng)
        snapped = rng.random(7) < 0.6
        snapped[1] = False
        q = np.where(snapped, np.clip((level / (PI / 2)).round() * (PI / 2), arm.lower, arm.upper), level)
        alone = ik.solve(arm, arm.fk(q), "inspection", max_evaluations=1)
        assert alone.success or not alone.proven, q


def test_a_level_arm_says_ranges_within_its_limits_and_each_once():
    for first, fourth in (((-4.0, 4.0), (-4.0, 4.0)), (None, (-1.0, 1.0)), ((-1.0, 1.0), None), (None, None)):
        robot = shoulder_arm([first, (-3.0, 3.0), fourth, (-1.4, 1.4), (-3.0, 3.0), (-3.0, 3.0)])
        for q0 in (-3.5, 0.0, 3.5):
            start = np.clip([q0, 0.4, 0.3, 0.5, 0.6, 0.7], robot.lower, robot.upper)
            found = ik.solve_all(robot, robot.fk([0.2, PI / 2, 0.5, 0.4, 0.9, -0.3]), q0=start)
            level = [one for one in found.families if one.joints == ("j0", "j2")]
            assert level and all(robot.lower[0] <= one.lower < one.upper <= robot.upper[0] for one in level)
            assert (first and fourth) or len(level) <= 4  # two each of elbow and wrist
