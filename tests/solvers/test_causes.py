"""What a failure blames was tested, and what it says of the arm, the target and the errors is so."""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import FAR_AWAY
from ik_toolkit.solvers.status import Status
from ik_toolkit.text import angle, figure, length

SCARA = robots.urdf(
    dict(kind="revolute", xyz="0 0 0.39", limits=(-2.6, 2.6)),
    dict(kind="revolute", xyz="0.32 0 0", limits=(-2.5, 2.5)),
    dict(kind="prismatic", xyz="0.27 0 0", axis="0 0 -1", limits=(0.0, 0.2)),
    dict(kind="continuous", xyz="0 0 0", rpy="3.141592653589793 0 0", axis="0 0 1"),
    dict(kind="fixed", xyz="0 0 0"),
)
GANTRY = robots.urdf(
    dict(kind="prismatic", xyz="0 0 0", axis="1 0 0", limits=(-1.0, 1.0)),
    dict(kind="prismatic", xyz="0 0 0.5", axis="0 1 0", limits=(-1.0, 1.0)),
    dict(kind="fixed", xyz="0 0 0.1"),
)


def skewed(arm, rng, angle):
    """A pose that the arm reaches, turned by an angle about a random axis."""
    M, axis = arm.fk(arm.random_q(rng)), rng.normal(size=3)
    return pin.SE3(M.rotation @ pin.exp3(angle * axis / np.linalg.norm(axis)), M.translation)


@pytest.mark.parametrize("solver", ["lm", "dls"])
@pytest.mark.parametrize("name", ["hydrolek_7w", "inspection_7dof"])
def test_limits_are_blamed_only_for_what_is_solved_without_them(name, solver):
    arm, rng = robots.load(name), np.random.default_rng(3)
    targets = np.array([skewed(arm, rng, 0.5).homogeneous for _ in range(40)])
    batch = ik.solve_batch(arm, targets, solver)
    blamed = 0
    for k, T in enumerate(targets):
        result = ik.solve(arm, T, solver)
        for status in (result.status, Status(int(batch.status[k]))):
            if status == Status.LIMIT_BLOCKED:
                blamed += 1
                assert ik.solve(arm, T, "lm", limits=False, restarts=300).success
        assert (result.status == Status.LIMIT_BLOCKED) == ("reached without them" in result.message)
    assert blamed if solver == "lm" else True


@pytest.mark.parametrize("name", ["so100", "xarm7"])
def test_limits_are_named_where_the_nearest_pose_touches_none(name):
    """Pushed past a limit, the nearest pose inside may rest on no limit; more restarts cannot help, wider limits do."""
    arm, rng, named = ik.Robot.load(name), np.random.default_rng(5), 0
    for k in range(40):
        q, j = arm.random_q(rng), k % arm.n
        q[j] = arm.upper[j] + 0.3 * min(arm.upper[j] - arm.lower[j], 2.0)
        result = ik.solve(arm, arm.fk(q))
        if result.status == Status.STALLED and ik.solve(arm, arm.fk(q), limits=False).success:
            named += 1
            assert "reached without joint limits" in result.message and "restarts" not in result.message
            assert any(joint in result.message for joint in arm.joint_names) and "widen" in result.message
    assert named


@pytest.mark.parametrize("solver", ["dls", "ccd"])
def test_an_attempt_that_stops_at_a_limit_blames_no_limit_for_what_others_reach(solver):
    arm, rng = robots.load("hydrolek_7w"), np.random.default_rng(0)
    found = [
        ik.solve(arm, arm.fk(arm.random_q(rng)).translation, solver, tolerance=1e-3, q0=arm.home) for _ in range(100)
    ]
    stopped = [one for one in found if one.status == Status.STALLED]
    assert stopped and all("at a limit" in one.message for one in stopped)
    assert not any(one.status == Status.LIMIT_BLOCKED for one in found)


def five_joints():
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0")
    joints = (dict(kind="revolute", xyz="0.2 0.05 0.1", axis=axis) for axis in axes)
    return robots.load(robots.urdf(*joints, dict(kind="fixed", xyz="0.1 0 0")))


def test_an_arm_with_too_few_joints_is_told_so():
    arm, rng = five_joints(), np.random.default_rng(5)
    assert (arm.mobility.joints, arm.mobility.directions, arm.mobility.turns, arm.mobility.moves) == (5, 5, 3, 3)
    for _ in range(5):
        T = skewed(arm, rng, 0.25)
        result = ik.solve(arm, T)
        assert not result.success and "the arm has 5 joints, and the target fixes 6" in result.message
        assert "free_turn" in result.message and "more restarts" not in result.message
        alone = ik.solve(arm, T.translation).success
        assert alone == ("the position alone can be reached" in result.message)
        row = ik.solve_batch(arm, T.homogeneous[None])[0]
        assert "the arm has 5 joints, and the target fixes 6" in row.message
    assert "joints, and the target" not in ik.solve(arm, (3.0, 0.0, 0.0)).message


def test_an_axis_that_cannot_tilt_is_named():
    arm = robots.load(SCARA)
    m = arm.mobility
    assert (m.directions, m.turns, m.moves) == (4, 1, 3)
    assert np.allclose(m.tip_axis, [0, 0, 1]) and np.allclose(m.axis, [0, 0, -1])
    T = arm.fk(arm.random_q(np.random.default_rng(1)))
    told = "the tip's z axis always points along -z of the base, and the target's points"
    for turn, how in (
        (pin.exp3(np.array([np.pi, 0.0, 0.0])), "the opposite way, 180 deg"),
        (pin.exp3(np.array([0.0, 0.5, 0.0])), "28.6 deg"),
    ):
        assert f"{told} {how} from it" in ik.solve(arm, pin.SE3(T.rotation @ turn, T.translation)).message
    assert ik.solve(arm, T).success and told not in ik.solve(arm, T, limits={arm.joint_names[0]: (2.0, 2.1)}).message


def test_a_plane_that_is_never_left_and_a_turn_that_never_happens_are_named():
    flat = robots.load("planar_3r")
    T = flat.fk([0.3, 0.4, 0.5])
    T.translation = T.translation + np.array([0.0, 0.0, 0.05])
    assert "the tip never moves along z of the base, and the target is 50 mm off" in ik.solve(flat, T).message
    gantry = robots.load(GANTRY)
    assert (gantry.mobility.turns, gantry.mobility.moves) == (0, 2)
    off = "the tip never moves along z of the base, and the target is 50 mm off"
    assert off in ik.solve(gantry, ik.pose((0.2, 0.1, 0.65), rpy=(0, 0, 0))).message
    assert ik.solve(gantry, ik.pose((0.2, 0.1, 0.6), rpy=(0, 0, 0))).success
    turned = ik.solve(gantry, ik.pose((0.2, 0.1, 0.6), rpy=(0, 0, 1)))
    assert "the tip never turns, and the target is turned by 57.3 deg" in turned.message


@pytest.mark.parametrize(("beyond", "said"), [(-1e-5, True), (0.0, True), (1e-5, False), (1e-2, False)])
def test_a_position_is_said_to_be_reached_alone_only_if_it_is(beyond, said):
    joints = [
        dict(kind="prismatic", xyz="0 0 0", axis=axis, limits=(-1.0, 1.0)) for axis in ("1 0 0", "0 1 0", "0 0 1")
    ]
    arm = ik.Robot.load(robots.urdf(*joints, dict(kind="revolute", xyz="0 0 0", limits=(-2.0, 2.0))))
    target = ik.pose((1.0 + beyond, 0.2, 0.1), rpy=(0.3, 0.0, 0.4))
    result = ik.solve(arm, target)
    assert not result.success and ("position alone can be reached" in result.message) == said
    assert ik.solve(arm, target[:3, 3]).success == said


@pytest.mark.parametrize("name", ["hydrolek_7w", "inspection_7dof", "panda"])
def test_an_arm_that_can_do_everything_is_not_accused(name):
    if name == "panda" and not robots.have_data():
        pytest.skip("needs example-robot-data")
    arm = robots.load(name)
    assert (arm.mobility.directions, arm.mobility.turns, arm.mobility.moves) == (6, 3, 3)
    assert str(arm.mobility) == f"{arm.n} joints, 6 of 6 directions at once"


def test_a_tree_tells_its_mobility_by_tip():
    tree = robots.load("two_arms")
    assert set(tree.mobility) == set(tree.tips)


@pytest.mark.parametrize("weight", [0.01, 0.5, 20.0])
def test_errors_in_a_sentence_are_those_of_the_tip_whatever_their_weight(weight):
    arm, rng = five_joints(), np.random.default_rng(2)
    T = skewed(arm, rng, 0.5)
    result = ik.solve(arm, T, mask=(1, 1, 1, weight, weight, weight))
    true = np.degrees(np.linalg.norm(pin.log3(arm.fk(result.q).rotation.T @ T.rotation)))
    assert not result.success and angle(np.radians(true)) in result.message
    weighted = angle(result.orientation_error)
    assert weighted not in result.message
    good = arm.fk(arm.random_q(rng))
    row = ik.solve_batch(arm, [T, good], mask=(1, 1, 1, weight, weight, weight))[1]
    assert row.success and " deg" not in row.message  # what was solved keeps no target to take the weights out with
    assert f"a weighted error of {figure(row.position_error)}, {figure(row.orientation_error)}" in row.message


def test_millimetres_are_doubted_at_every_entrance(caplog, monkeypatch):
    monkeypatch.setattr("ik_toolkit.errors.DOUBTED", set())
    arm = robots.load("hydrolek_7w")
    near, far = (factor * FAR_AWAY * arm.reach for factor in (0.9, 1.1))
    for x, doubted in ((near, False), (far, True)):
        for call in (
            lambda x=x: ik.solve(arm, (x, 0.0, 0.0)).message,
            lambda x=x: ik.solve(arm, ik.pose((x, 0.0, 0.0), rpy=(0, 0, 0))).message,
        ):
            assert ("were millimetres meant?" in call()) == doubted
        ik.solve_batch(arm, [(x, 0.0, 0.0)])
        ik.solve_path(arm, [(x, 0.0, 0.0)])
        straight = ik.line((x, 0.0, 0.0), (0.99 * x, 0.0, 0.0), duration=0.1)
        ik.track(arm, straight, dt=0.02, on_limit="leave")
        assert ("were millimetres meant?" in ik.Tracker(arm).update((x, 0.0, 0.0), 0.01).reason) == doubted
        arm.with_tool((0.0, 0.0, x))
        ik.CollisionModel(arm).add_sphere(0.1, (x, 0.0, 0.0))
        said = [one for one in caplog.text.splitlines() if "were millimetres meant?" in one]
        assert [any(f"pose of a {what}:" in one for one in said) for what in ("tool", "shape")] == [doubted] * 2
        assert [any(f"{what} of tool" in one for one in said) for what in ("targets", "the path")] == [doubted] * 2


def test_raw_errors_of_each_tip_stand_beside_a_weighted_one():
    """A mask of one tip leaves the words on the other tip as they are."""
    tree = ik.Tree.load("brokk_hydrolek")
    left, right = tree.tips
    goal = {left: tree.fk(tree.home)[left].homogeneous, right: tree.fk(tree.home)[right].homogeneous}
    goal[left][:3, 3] += (9.0, 0.0, 0.0)
    result = ik.solve(tree, goal, mask={left: (1, 1, 1, 0.1, 0.1, 0.1)}, restarts=1)
    assert not result.success
    for tip, (position, turned) in zip(tree.tips, tree.errors(result.q, goal), strict=True):
        assert f"{tip} {length(position)} {angle(turned)}" in result.message


def test_a_tool_axis_that_the_arm_cannot_point_is_named():
    arm = robots.load("planar_3r")
    place = arm.fk([0.1, 0.5, 0.4]).translation
    for T, how in (
        (ik.pose(place, direction=(0.3, 0.0, 1.0)), {}),
        (ik.pose(place, rpy=(0.3, 0.0, 0.5)), {"free_turn": "z"}),
    ):
        result = ik.solve(arm, T, **how)
        assert not result.success and "the tip's z axis always stands at 0 deg to z of the base" in result.message
    assert ik.solve(arm, ik.pose(place, direction=(0.0, 0.0, 1.0))).success


def test_a_mask_or_slack_that_keeps_the_tilt_is_told_that_the_arm_cannot():
    """A turn may be freed about an axis of the base or of the tip: what stands still beside it is named, unless it is met."""
    arm, rng = ik.Robot.load("palletizer"), np.random.default_rng(5)
    M = arm.fk(arm.random_q(rng))
    tilt = pin.exp3(np.array([0.2, 0.3, 0.0]))
    T = pin.SE3(tilt @ M.rotation, M.translation)
    turned = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.4])) @ M.rotation, M.translation)
    for options in (
        {"mask": (1, 1, 1, 1, 1, 0)},
        {"mask": (1, 1, 0, 1, 1, 0), "frame": "tip"},
        {"mask": (1, 1, 1, 0.2, 0.2, 0.2)},
        {"slack": (0, 0, 0, 0, 0, 9)},
    ):
        said = ik.solve(arm, T, **options).message
        assert "the tip's z axis always" in said and "restarts" not in said, said
        assert ik.solve(arm, turned, **options).success
    assert "always stands at 90 deg to y of the base" in ik.solve(arm, T, mask=(1, 1, 1, 1, 0, 1)).message
    assert ik.solve(arm, T, mask=(1, 1, 1, 1, 0, 0)).success


@pytest.mark.parametrize("length", [1.0, 0.1, 0.01, 1e-3])
def test_a_failure_is_a_closest_configuration_in_the_measure_asked_for(length):
    """Neither a descent of SciPy's from there nor the place where the position is met is better by more than a little."""
    optimize = pytest.importorskip("scipy.optimize")
    arm, rng = five_joints(), np.random.default_rng(5)
    T = skewed(arm, rng, 0.6).homogeneous

    def size(q):
        position, turned = arm.errors(q, T)
        return (position / length) ** 2 + turned**2

    result = ik.solve(arm, T, length_scale=length)
    assert not result.success and arm.outside(result.q) == []
    ends = list(zip(arm.lower, arm.upper, strict=True))
    near = optimize.minimize(size, result.q, bounds=ends, method="L-BFGS-B", options={"ftol": 1e-14})
    assert size(result.q) <= near.fun * (1.0 + 1e-5)
    there = ik.solve(arm, T[:3, 3]).q  # where the position is met
    assert size(result.q) <= size(there) * (1.0 + 1e-5)


def test_a_position_fixes_three_directions():
    """An arm of three joints has enough of them, whatever else keeps it from the point."""
    joint = dict(kind="revolute", limits=(-0.4, 0.4))
    places = (dict(axis="0 0 1"), dict(axis="0 1 0", xyz="0 0 0.3"), dict(axis="0 1 0", xyz="0.5 0 0"))
    arm = ik.Robot.load(robots.urdf(*(joint | place for place in places), dict(kind="fixed", xyz="0.4 0 0")))
    result = ik.solve(arm, (-0.5, 0.1, 0.4))
    assert not result.success and "fixes" not in result.message


FAILING = {
    "an axis that cannot tilt": (lambda: robots.load(SCARA), 0.6, {}),
    "a plane that is never left": (lambda: robots.load("planar_3r"), 0.4, {}),
    "five joints": (five_joints, 0.25, {}),
    "weights": (five_joints, 0.25, {"mask": (1.0, 1.0, 1.0, 0.3, 0.3, 0.3)}),
    "several tips": (lambda: robots.load("two_arms"), 0.5, {}),
}


@pytest.mark.parametrize("executor", [None, 2])
@pytest.mark.parametrize("name", FAILING)
def test_rows_of_a_batch_that_fail_say_what_a_solve_says(name, executor):
    """Word for word, with q0 and without, also from workers; what was solved keeps nothing."""
    make, by, options = FAILING[name]
    arm, rng = make(), np.random.default_rng(7)
    options = {"solver": "lm", "restarts": 20, **options}
    good = [arm.tip_poses(q) for q in arm.random_q(rng, 6)]
    T = np.array([[M.homogeneous for M in poses] for poses in good])
    T[1::2, :, :3, :3] = T[1::2, :, :3, :3] @ pin.exp3(by * np.array([0.6, -0.64, 0.48]))
    T[3::4, :, :3, 3] *= 1.8
    T = T if arm.by_tip else T[:, 0]
    for q0 in (None, arm.home, arm.random_q(rng, 6)):
        starts = [None] * 6 if q0 is None else np.broadcast_to(q0, (6, arm.n))
        with ThreadPoolExecutor(executor or 1) as pool:
            batch = ik.solve_batch(arm, T, q0=q0, executor=pool if executor else None, **options)
        failed = np.flatnonzero(~batch.success).tolist()
        assert {3, 5} <= set(failed) and len(failed) < 6
        assert batch.failures.rows.tolist() == failed and len(batch.failures.T) == len(failed)
        for k in failed:
            alone = ik.solve(arm, T[k], q0=starts[k], **options)
            row = batch[k - 6]
            assert row.message == alone.message and batch[k].status == alone.status
            assert row.raw_error == pytest.approx(alone.raw_error, abs=1e-9, nan_ok=True)
            again = pickle.loads(pickle.dumps(batch))[k]
            assert again.message == alone.message


def test_a_failed_row_explains_itself():
    arm = robots.load(SCARA)
    T = skewed(arm, np.random.default_rng(7), 0.6).homogeneous
    batch = ik.solve_batch(arm, np.array([T, T]), q0=arm.home)
    assert str(batch[1].explain()) == str(ik.solve(arm, T, "lm", q0=arm.home).explain())


def test_the_tilt_is_the_cause_also_with_slack_or_the_orientation_first():
    """A tip whose axis cannot tilt misses the first level, and no restarts help; within its slack nothing is blamed."""
    arm = ik.Robot.load(SCARA)
    T = skewed(arm, np.random.default_rng(6), 0.0)
    T.rotation = T.rotation @ pin.exp3(np.array([0.3, 0.0, 0.0]))
    slack = (0.01, 0.0, 0.0, 0.1, 0.1, 0.1)
    for given in (dict(priority="orientation"), dict(slack=slack)):
        assert "17.2 deg from it; free what cannot be met" in ik.solve(arm, T, **given).message
    assert "always points" not in ik.solve(arm, T, priority="position").message
    assert ik.solve(arm, T, slack=(0.0, 0.0, 0.0, 0.3, 0.3, 0.3)).success
    flat = ik.Robot.load("planar_3r")
    above = flat.fk(flat.home).translation + np.array([0.0, 0.0, 0.2])
    assert "200 mm off" in ik.solve(flat, above, priority="position").message
    assert "200 mm off" in ik.solve(flat, above, slack=(0.1, 0.1, 0.1, 0, 0, 0)).message
    assert ik.solve(flat, above, slack=(0, 0, 0.3, 0, 0, 0)).success
