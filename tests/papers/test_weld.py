"""Inspection of a canister's welds: exact intervals of the lift, the least travel, the certified motion, masses and torques."""

import math
import re
import xml.etree.ElementTree as ET
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
import second_fk
from folders import ROOT

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, InvalidTarget, UnknownSolver
from ik_toolkit.papers.shanmugasundar_2012.weld import Canister, inspect_weld, least_travel
from ik_toolkit.paths.result import PathStatus
from ik_toolkit.solvers.closed_form.lift_windows import LiftWindow, at_lifts, lift_windows

CASES = 200


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("inspection_7dof")


def random_poses(arm, rng, count):
    """Poses of random configurations; every fifth has a level gaze, where axes 1 and 4 can be parallel or joint 3 at its limit."""
    made = []
    for k in range(count):
        T = arm.fk(arm.random_q(rng)).homogeneous
        if k % 5 == 0:
            turn = rng.choice([0.0, 0.5 * math.pi, rng.uniform(-math.pi, math.pi)])
            T[:3, :3] = Canister().seam(rng.uniform(-0.5, 0.5), 0.1, turn=turn)[0, :3, :3]
        made.append(T)
    return np.array(made)


def variant(rng):
    """The arm with random limits, of which few are symmetric, and with some axes reversed, perhaps that of the lift."""
    root = ET.parse(ROOT / "urdf" / "inspection_7dof.urdf").getroot()
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        if limit is not None:
            low, high = (float(limit.get(end)) for end in ("lower", "upper"))
            low, high = low + rng.uniform(0.0, 0.3) * (high - low), high - rng.uniform(0.0, 0.3) * (high - low)
            if rng.uniform() < 0.5:
                joint.find("axis").set("xyz", "0 0 -1")
                low, high = -high, -low
            limit.set("lower", repr(low))
            limit.set("upper", repr(high))
    return ik.Robot.load(ET.tostring(root, encoding="unicode"), base="base_link", tip="tool")


def variants(arm, rng, count, robots=5):
    """The arm and variants of it, each with its share of `count` random poses and their windows."""
    made = []
    for k in range(robots):
        robot = variant(rng) if k else arm
        poses = random_poses(robot, rng, count // robots)
        made += [(robot, *one) for one in zip(poses, lift_windows(robot, poses), strict=True)]
    return made


@pytest.fixture(scope="module")
def listed(arm):
    """Robots, poses and their windows."""
    return variants(arm, np.random.default_rng(0), CASES)


def outside_of(windows, rng, low, high):
    """A lift that is in no window and at least 1 mm from all, or None."""
    for d in rng.uniform(low, high, 20):
        if all(d < w.low - 1e-3 or d > w.high + 1e-3 for w in windows):
            return float(d)
    return None


def search_at(arm, T, lift, restarts=20):
    """Whether an iterative search finds a solution at one lift; it knows nothing of the closed form."""
    limits = {"lift": (lift, lift)}
    return ik.solve(arm, T, "lm", restarts=restarts, seed=1, limits=limits).success


def test_inside_the_windows_are_solutions_and_beyond_their_ends_none(listed):
    for arm, T, windows in listed:
        if not windows:
            continue
        inside = [w.low + np.array([1e-7, 0.3, 1.0 - 1e-7]) * (w.high - w.low) for w in windows]
        lifts = np.concatenate([(w.low - 1e-6, *d, w.high + 1e-6) for w, d in zip(windows, inside, strict=True)])
        Q, broken = at_lifts(arm, T, lifts)
        for i, w in enumerate(windows):
            q, over = Q[w.branch, 5 * i : 5 * i + 5], broken[w.branch, 5 * i : 5 * i + 5]
            off = np.abs(arm.chain.forward(q)[0] - T).max(axis=(1, 2))
            assert off[1:4].max() < 2e-9  # A joint that exceeds a limit by 1e-9 is put on it.
            assert np.abs(arm.fk(q[2]).homogeneous - T).max() < 1e-9  # Pinocchio
            assert (q[1:4] >= arm.lower - 1e-8).all() and (q[1:4] <= arm.upper + 1e-8).all()
            for end, k in ((w.low, 0), (w.high, 4)):
                another = any(
                    o is not w and o.branch == w.branch and abs(end - x) < 1e-6 for o in windows for x in o[1:]
                )
                assert another or over[k] > 0.0 or off[k] > 1e-9


def test_a_branch_is_continuous_in_its_window():
    """With the tool upright, axes 1 and 4 become parallel at one lift, where a branch turns joint 1 by half a turn."""
    text = (ROOT / "urdf" / "inspection_7dof.urdf").read_text()
    wide = ik.Robot.load(
        re.sub(r'lower="-[^"]*" upper="[^"]*"', 'lower="-3.1" upper="3.1"', text), base="base_link", tip="tool"
    )
    split, share = 0, 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, 201))
    for height in np.linspace(0.05, 0.65, 13):
        T = Canister().seam(0.3, height)[0]
        (windows,) = lift_windows(wide, [T])
        split += any(abs(a.high - b.low) < 1e-5 and a.branch == b.branch for a, b in pairwise(windows))
        for w in windows:
            q = at_lifts(wide, T, w.low + (w.high - w.low) * share)[0][w.branch]
            assert np.abs(np.diff(q[:, 0])).max() < 1.0
    assert split > 5


def test_no_branch_keeps_the_limits_outside_its_windows(listed):
    """A grid of 501 lifts finds no lift outside, without the polynomials."""
    for arm, T, windows in listed:
        lifts = np.linspace(arm.lower[1], arm.upper[1], 501)
        Q, broken = at_lifts(arm, T, lifts)
        inside = np.zeros((8, len(lifts)), dtype=bool)
        for w in windows:
            inside[w.branch] |= (lifts >= w.low - 1e-6) & (lifts <= w.high + 1e-6)
        doubtful = Q[(broken == 0.0) & ~inside]  # Those must be out of reach: at another pose.
        if len(doubtful):
            assert np.abs(arm.chain.forward(doubtful)[0] - T).max(axis=(1, 2)).min() > 1e-9


def test_an_independent_search_finds_nothing_outside_the_windows(listed):
    rng, tried = np.random.default_rng(2), 0
    for arm, T, windows in listed[::10]:
        lift = outside_of(windows, rng, arm.lower[1], arm.upper[1])
        if lift is not None:
            assert not search_at(arm, T, lift)
            tried += 1
        if windows:
            w = max(windows, key=lambda one: one.high - one.low)
            assert search_at(arm, T, 0.5 * (w.low + w.high), restarts=60)
    assert tried > 15


def test_windows_are_refused_where_they_mean_nothing(arm):
    with pytest.raises(UnknownSolver):
        lift_windows(ik.Robot.load("hydrolek_7w"), np.eye(4)[None])
    locked = ik.Robot.load("inspection_7dof", locked={"lift": 0.2})
    with pytest.raises(InvalidOption, match="no lift"):
        lift_windows(locked, np.eye(4)[None])
    with pytest.raises(InvalidTarget, match="orientation"):
        lift_windows(arm, [[0.4, 0.0, 0.7]])
    with pytest.raises(InvalidTarget):
        lift_windows(arm, np.eye(4))


def random_rows(rng, count=12):
    """A random walk of windows whose neighbours overlap, as pairs and as windows of branch 0."""
    middle = np.clip(0.22 + np.cumsum(rng.uniform(-0.04, 0.04, count)), 0.07, 0.36)
    half = rng.uniform(0.02, 0.06, count)
    rows = [[(m - h, m + h)] for m, h in zip(middle, half, strict=True)]
    return rows, [[LiftWindow(0, a, b) for a, b in row] for row in rows]


def dense_program(rows, step):
    """The least travel over a grid of lifts, by dynamic programming."""
    c = np.arange(0.0, 0.44, step)
    inside = np.array([[any(a <= x <= b for a, b in row) for x in c] for row in rows])
    cost = np.where(inside[0], 0.0, np.inf)
    for mask in inside[1:]:
        cost = np.where(mask, (cost[None] + np.abs(c[:, None] - c[None])).min(axis=1), np.inf)
    return cost.min()


def test_least_travel_is_least():
    """Against a dense dynamic programme, which is never below the least and above it by its rounding at most."""
    rng, step, found = np.random.default_rng(3), 0.004, 0
    for _ in range(CASES):
        rows, windows = random_rows(rng)
        found += all(a[0] <= b[1] and b[0] <= a[1] for (a,), (b,) in pairwise(rows))
        for d in least_travel(windows, margin=0.0).values():
            assert all(a - 1e-12 <= x <= b + 1e-12 for x, ((a, b),) in zip(d, rows, strict=True))
            travel = np.abs(np.diff(d)).sum()
            assert travel - 1e-9 <= dense_program(rows, step) <= travel + 2 * len(rows) * step
            found -= 1
    assert found == 0  # There is a plan wherever neighbours overlap, and only there.


def test_the_lift_moves_at_least_as_far_along_the_motion_as_from_pose_to_pose(arm):
    seam = Canister().seam(0.0, np.linspace(0.05, 0.65, 11), turn=np.radians(337.5))
    plan = inspect_weld(arm, seam)
    assert plan.whole_travel >= plan.travel - 1e-9
    assert plan.whole_travel == pytest.approx(np.abs(np.diff(plan.path.curve[:, 1])).sum())
    assert "between them" in repr(plan)


def test_least_travel_chooses_among_windows():
    """The narrow window on the way is a detour; where neighbours do not overlap, there is no plan."""
    first, last = [LiftWindow(2, 0.1, 0.12)], [LiftWindow(2, 0.11, 0.13)]
    between = [LiftWindow(2, 0.0, 0.1), LiftWindow(2, 0.112, 0.114), LiftWindow(3, 0.0, 0.4)]
    plan = least_travel([first, between, last], margin=0.0)
    assert set(plan) == {2} and np.ptp(plan[2]) == 0.0 and 0.112 <= plan[2][0] <= 0.114
    assert least_travel([first, [LiftWindow(2, 0.0, 0.09)], last], margin=0.0) == {}
    assert least_travel([first, between, last], margin=0.011) == {}


@pytest.mark.parametrize("seam", [(np.radians(np.linspace(-40.0, 40.0, 21)), 0.35), (0.0, np.linspace(0.05, 0.65, 21))])
def test_a_seam_is_followed_in_one_certified_motion(arm, seam):
    canister, turn = Canister(), math.radians(60.0)
    poses = canister.seam(*seam, standoff=0.04, turn=turn)
    points = poses[:, :3, 3] + 0.04 * poses[:, :3, 0]  # along the line of sight
    assert np.allclose(np.hypot(*(points[:, :2] - canister.foot[:2]).T), canister.radius)
    plan = inspect_weld(arm, poses, canister)
    path = plan.path
    assert path.status == PathStatus.FOLLOWED and path.clearance > 0.01
    fk = second_fk.SecondFK((ROOT / "urdf" / "inspection_7dof.urdf").read_text(), arm.base, arm.tip)
    assert np.abs(fk.fk(path.q, arm.joint_names) - poses).max() < 1e-9
    assert np.allclose(path.q[:, 1], plan.lifts)
    for a, b in zip(path.curve[:-1], path.curve[1:], strict=True):
        assert (np.minimum(a, b) >= arm.lower - 1e-12).all() and (np.maximum(a, b) <= arm.upper + 1e-12).all()
    rng = np.random.default_rng(4)
    for _ in range(100):  # the bound holds wherever the motion is sampled
        k, s = rng.integers(len(path.curve) - 1), rng.uniform()
        at = path.at[k] + s * (path.at[k + 1] - path.at[k])
        i = min(int(at), len(poses) - 2)
        wanted = poses[i, :3, 3] + (at - i) * (poses[i + 1, :3, 3] - poses[i, :3, 3])
        q = path.curve[k] + s * (path.curve[k + 1] - path.curve[k])
        assert np.linalg.norm(fk.fk(q[None], arm.joint_names)[0, :3, 3] - wanted) <= path.continuity.deviation[k]


def test_a_seam_that_is_not_reached_says_which_pose(arm):
    seam = Canister().seam(0.0, [0.2, 0.3], turn=0.3)
    for call, said in (
        (lambda: inspect_weld(arm, Canister().seam(np.radians([180.0, 170.0]), 0.3)), "pose 0 is not reached"),
        (lambda: Canister().seam(0.0, 0.8), r"between 0 and 0\.7 m"),
        (lambda: Canister().seam([0.0, 0.1, 0.2], [0.1, 0.2]), "each a number or"),
        (lambda: inspect_weld(arm, []), "two poses"),
        (lambda: inspect_weld(arm, seam, margin=-0.01), "margin"),
        (lambda: inspect_weld(arm, seam, margin=1.0), "no branch has lifts at every pose that keep 1 m"),
    ):
        with pytest.raises(InvalidOption, match=said):
            call()


def test_contact_with_the_canister_is_a_status(arm):
    plan = inspect_weld(arm, Canister().seam(0.0, [0.2, 0.3], turn=0.3), Canister(radius=0.3))
    assert plan.path.status == PathStatus.COLLISION and not plan.path.success


def bodies(arm):
    """Mass [kg] and centre (3,) [m, link frame] of each link, from the URDF text."""
    found = {}
    for link in ET.parse(ROOT / "urdf" / "inspection_7dof.urdf").getroot().iter("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            centre = [float(x) for x in inertial.find("origin").get("xyz").split()]
            found[link.get("name")] = float(inertial.find("mass").get("value")), np.array(centre)
    return found


def weights(arm, q, links):
    """Joint torques and forces (7,) that hold the links still, by hand: derivative of the height of the masses."""

    def energy(q):
        made = pin.Data(arm.model)
        pin.framesForwardKinematics(arm.model, made, q)
        return sum(9.81 * m * (made.oMf[arm.model.getFrameId(name)].act(c))[2] for name, (m, c) in links.items())

    h = 1e-6
    return np.array([(energy(q + h * e) - energy(q - h * e)) / (2 * h) for e in np.eye(7)])


def test_masses_are_those_of_steel_cylinders(arm):
    links = bodies(arm)
    assert set(links) == {f"link_{k}" for k in range(1, 8)}
    bar, drum = math.pi * 0.029**2 * 0.29, math.pi * (1.35 * 0.029) ** 2 * 2.7 * 0.029
    assert links["link_4"][0] == pytest.approx(7850.0 * (bar + drum), rel=1e-4)
    assert links["link_4"][1] == pytest.approx([0.145 * bar / (bar + drum), 0.0, 0.0], abs=1e-6)
    assert links["link_2"][0] == pytest.approx(7850.0 * math.pi * 0.03**2 * 0.44, rel=1e-4)


def test_torques_along_a_weld_are_those_of_weight_and_of_the_work_done(arm):
    pytest.importorskip("scipy")
    plan = inspect_weld(arm, Canister().seam(0.0, np.linspace(0.2, 0.5, 11), turn=math.radians(60.0)))
    motion, torques, weight = plan.torques(tip_speed=0.05)
    links = bodies(arm)
    for k in (0, len(motion.q) // 2, -1):
        assert weight[k] == pytest.approx(weights(arm, motion.q[k], links), abs=1e-5)
    carried = sum(m for name, (m, _) in links.items() if name != "link_1")
    assert weight[:, 1] == pytest.approx(9.81 * carried)
    # The work of the joints is the energy gained.
    data, model = arm.model.createData(), arm.model
    energy = [
        pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q)
        for q, v in zip(motion.q, motion.dq, strict=True)
    ]
    power = (torques * motion.dq).sum(axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(motion.t))])
    assert np.abs(work - (np.array(energy) - energy[0])).max() < 0.01 * np.ptp(energy)
