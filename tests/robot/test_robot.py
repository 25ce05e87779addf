"""The robot: loading, tips, configurations, locking, tools, mimic and continuous joints, pickling, threads."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit import errors
from ik_toolkit.robot.library import shipped_robots

BRANCHED = robots.branches(
    robots.joint("j0", "revolute", "l0", "l1"),
    robots.joint("j1", "revolute", "l1", "l2", axis="0 1 0"),
    robots.joint("side", "revolute", "l1", "other", axis="1 0 0"),
    root="l0",
)


def test_q_has_one_number_per_moving_joint_of_the_path():
    robot = robots.load("mimic_mix")
    assert robot.joint_names == ("j0", "j1", "j3", "j5", "j6", "j7")
    assert robot.model.nq == 6
    robot = robots.load("continuous_mix")
    assert robot.joint_kinds == ("continuous", "revolute", "continuous", "revolute", "continuous", "revolute")
    assert np.isinf(robot.lower[[0, 2, 4]]).all() and np.isinf(robot.upper[[0, 2, 4]]).all()
    assert robot.model.nq == 9 and robot.n == 6


@pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")
def test_panda_hand_has_seven_joints_not_nine():
    robot = robots.load("panda")
    assert robot.n == 7 and robot.model.nq == 8
    assert robot.tip == "panda_hand_tcp"


def test_tip_may_be_omitted_only_when_there_is_one():
    with pytest.raises(errors.FrameNotFound, match="l2, other"):
        ik.Robot.load(BRANCHED)
    robot = ik.Robot.load(BRANCHED, tip="other")
    assert robot.joint_names == ("j0", "side")
    with pytest.raises(errors.FrameNotFound, match="Did you mean 'other'"):
        ik.Robot.load(BRANCHED, tip="othr")


def test_base_may_be_any_link_and_joints_below_it_rest():
    robot = ik.Robot.load(BRANCHED, tip="l2", base="other")
    assert robot.joint_names == ("j1",)
    full = ik.Robot.load(BRANCHED, tip="l2")
    side = ik.Robot.load(BRANCHED, tip="other")
    q = np.array([0.0, 0.7])
    expected = side.fk([0.0, 0.0]).inverse() * full.fk(q)
    assert np.allclose(robot.fk([0.7]).homogeneous, expected.homogeneous, atol=1e-15)


@pytest.mark.parametrize("name", [*robots.SHIPPED, *robots.MADE])
def test_full_configuration_and_back(name):
    robot = robots.load(name)
    q = robot.random_q(np.random.default_rng(2))
    full = robot.to_pinocchio(q)
    assert full.shape == (robot.model.nq,)
    assert np.allclose(robot.q_from_pinocchio(full), q, atol=1e-12)
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, full)
    tip = data.oMf[robot.model.getFrameId(robot.tip, pin.BODY)]
    base = data.oMf[robot.model.getFrameId(robot.base, pin.BODY)]
    assert np.allclose((base.inverse() * tip).homogeneous, robot.fk(q).homogeneous, atol=1e-14)


@pytest.mark.parametrize("name", shipped_robots())
def test_home_is_the_listed_one_inside_the_limits_and_not_singular(name):
    entry = shipped_robots()[name]
    robot = ik.Robot.load(name, tip=entry.tip) if entry.tip else ik.Tree.load(name, tips=entry.tips)
    assert robot.base == entry.base and robot.home.tolist() == list(entry.home)
    assert (robot.lower < robot.home).all() and (robot.home < robot.upper).all()
    for arm, place in zip(robot.arms, robot.places, strict=True):
        assert np.linalg.svd(arm.jacobian(robot.home[place]), compute_uv=False)[min(6, arm.n) - 1] > 0.05


@pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("name", ["ur5", "kinova", "xarm7", "z1"])
def test_home_of_a_foreign_robot_is_moved_off_singular_poses(name):
    robot = robots.load(name)
    assert robot.outside(robot.home) == []
    assert np.linalg.svd(robot.jacobian(robot.home), compute_uv=False)[5] > 0.01


def test_one_package_folder_may_be_given_by_itself(tmp_path):
    for given in (str(tmp_path), tmp_path, [tmp_path]):
        assert ik.Robot.load(BRANCHED, tip="l2", package_dirs=given).package_dirs[0] == tmp_path
    with pytest.raises(errors.InvalidOption, match="there is no folder"):
        ik.Robot.load(BRANCHED, tip="l2", package_dirs=tmp_path / "meshes")


@pytest.mark.parametrize(
    ("name", "held"), [("inspection_7dof", {"lift": 0.3, "arm_yaw": 0.2}), ("mimic_mix", {"j1": 0.5})]
)
def test_locked_joints_are_constants(name, held):
    robot = robots.load(name)
    before = robot.joint_names
    locked = robot.locked(held)
    assert locked.joint_names == tuple(j for j in before if j not in held) and robot.joint_names == before
    q = locked.random_q(np.random.default_rng(0))
    whole = dict(zip(locked.joint_names, q, strict=True)) | held
    expected = robot.fk([whole[j] for j in before]).homogeneous
    assert np.allclose(locked.fk(q).homogeneous, expected, atol=1e-14)


def test_joints_that_cannot_be_locked():
    robot = robots.load("inspection_7dof")
    with pytest.raises(errors.JointNotFound, match="Did you mean 'lift'"):
        robot.locked({"lfit": 0.0})
    with pytest.raises(errors.InvalidConfiguration, match="'lift' must be a finite number, not 'down'"):
        robot.locked({"lift": "down"})


@pytest.mark.parametrize("locked", ["lift", 3, ["lift"], np.zeros(2)])
def test_locked_takes_a_dict(locked):
    calls = (
        lambda: robots.load("inspection_7dof").locked(locked),
        lambda: ik.Robot.load("inspection_7dof", locked=locked),
        lambda: ik.Tree.load("brokk_hydrolek", locked=locked),
    )
    for call in calls:
        with pytest.raises(errors.InvalidConfiguration, match="locked takes a dict"):
            call()


@pytest.mark.parametrize("folders", [None, 3, [3]])
def test_package_folders_are_named(folders):
    with pytest.raises(errors.InvalidOption, match="package_dirs must be a list of folders"):
        ik.Robot.load("planar_2r", package_dirs=folders)


def test_a_joint_locked_outside_its_limits_is_warned_about(caplog):
    panda, both = ik.Robot.load("panda"), ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    panda.locked({"panda_joint4": -1.0})
    assert not caplog.messages
    assert panda.locked({"panda_joint4": 1.0}).locked_joints == {"panda_joint4": 1.0}  # what is measured may be there
    assert caplog.messages == ["locked outside the limits: panda_joint4 (1 rad, limits -3.072 to -0.0698)"]
    caplog.clear()
    both.locked({"turret": 40.0})
    assert len(caplog.messages) == 1 and "turret (40 rad" in caplog.messages[0]  # one warning, though both arms have it


def test_tool_moves_the_tip():
    robot, tool = robots.load("hydrolek_7w"), robots.load("tool")
    q = robot.random_q(np.random.default_rng(4))
    offset = ik.pose((0.05, -0.02, 0.1), rpy=(0.3, 0.2, 0.1))
    assert np.allclose(tool.fk(q).homogeneous, robot.fk(q).homogeneous @ offset, atol=1e-14)
    result = ik.solve(tool, tool.fk(q), tolerance=1e-8)
    assert result.success


@pytest.mark.parametrize("kind", ["fixed", "floating"])
def test_a_robot_without_a_joint_to_move_is_refused(kind):
    with pytest.raises(errors.ModelError, match=r"no mov(able|ing) joint.*: nothing to solve"):
        ik.Robot.load(robots.urdf(dict(kind=kind)))


def test_wrong_configurations_are_refused():
    robot = robots.load("hydrolek_7w")
    for bad in ([0.0], np.full(6, np.nan), "abc", np.zeros((2, 6)), None):
        with pytest.raises((errors.InvalidConfiguration, errors.ConfigurationNotFound)):
            robot.errors(bad, (1.0, 0.1, 0.2))
    for bad in ([0.0], np.zeros((2, 6)), None, {}, 10**400):
        for call in (robot.outside, robot.at_limits):
            with pytest.raises(
                errors.InvalidConfiguration, match="q has no value" if isinstance(bad, dict) else "q must"
            ):
                call(bad)


def test_errors_and_limits_of_lists():
    robot = robots.load("hydrolek_7w")
    beside = robot.home + 0.01
    target = robot.fk(beside)
    found = robot.errors(robot.home.tolist(), target)
    assert found == robot.errors(robot.home, target.homogeneous.tolist())
    apart = robot.fk(robot.home).actInv(target)
    assert np.allclose(found, (np.linalg.norm(apart.translation), np.linalg.norm(pin.log3(apart.rotation))), atol=1e-12)
    assert robot.errors(robot.home, target.translation.tolist()) == (found[0], None)
    for bad in ("here", None, np.zeros((2, 2)), [0.0, np.nan, 0.0], {}):
        with pytest.raises(errors.InvalidTarget):
            robot.errors(robot.home, bad)
    q = robot.home.copy()
    q[:2] = robot.upper[0], robot.upper[1] + 0.1
    assert robot.outside(q.tolist()) == [robot.joint_names[1]]
    assert robot.at_limits(tuple(q.tolist())) == list(robot.joint_names[:2])
    q[2] = np.nan
    assert robot.outside(q) == list(robot.joint_names[1:3])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        *(((rng,), r"rng must be a numpy\.random\.Generator") for rng in (0, None, "seed", np.random)),
        *(((np.random.default_rng(0), count), "count must be a whole number") for count in (-1, 1.5, True, "two")),
    ],
)
def test_random_configurations_need_a_generator_and_a_count(given, said):
    with pytest.raises(errors.InvalidOption, match=said):
        robots.load("hydrolek_7w").random_q(*given)


@pytest.mark.parametrize(
    "source", ["panda", robots.urdf(dict(kind="prismatic", limits=(3.0, 9.0)), dict(kind="revolute"))]
)
def test_random_configurations_fill_the_limits(source):
    """A slide's limits do not begin at 0, and its kernel unit is not 1 m."""
    robot = ik.Robot.load(source) if source.startswith("<") else robots.load(source)
    Q, span = robot.random_q(np.random.default_rng(3), 400), robot.upper - robot.lower
    assert (Q.min(axis=0) - robot.lower < 0.02 * span).all() and (robot.upper - Q.max(axis=0) < 0.02 * span).all()
    assert np.allclose(Q.mean(axis=0), 0.5 * (robot.lower + robot.upper), atol=0.06 * span.max())


@pytest.mark.parametrize("name", ["hydrolek_7w", "mimic_mix", "locked", "tool"])
def test_pickling_keeps_the_robot(name):
    robot = robots.load(name)
    copy = pickle.loads(pickle.dumps(robot))
    q = robot.random_q(np.random.default_rng(0))
    assert copy.joint_names == robot.joint_names
    assert np.array_equal(copy.fk(q).homogeneous, robot.fk(q).homogeneous)
    T = robot.fk(q)
    assert ik.solve(copy, T).q.tobytes() == ik.solve(robot, T).q.tobytes()


def test_one_robot_from_many_threads():
    robot = robots.load("hydrolek_7w")
    Q, T = robots.sample(robot, 200, seed=9)
    alone = [(robot.fk(q).homogeneous.tobytes(), ik.solve(robot, t).q.tobytes()) for q, t in zip(Q, T, strict=True)]
    with ThreadPoolExecutor(8) as pool:
        together = list(
            pool.map(lambda k: (robot.fk(Q[k]).homogeneous.tobytes(), ik.solve(robot, T[k]).q.tobytes()), range(200))
        )
    assert together == alone


def test_example_files_are_found_by_path(tmp_path, monkeypatch):
    path = tmp_path / "arm with space.urdf"
    path.write_text(robots.SLIDES)
    assert ik.Robot.load(path).n == 7
    assert ik.Robot.load(str(path)).path == path
    monkeypatch.chdir(tmp_path)
    assert ik.Robot.load(Path("arm with space.urdf")).n == 7


def test_representations_name_the_joints():
    robot = robots.load("hydrolek_7w")
    assert "azimuth_yaw" in repr(robot) and "azimuth_yaw" in robot._repr_html_()
    assert "base_link → tool, reach at most 1.44 m" in robot._repr_html_()
    fingers = robots.load("mimic_mix")
    assert fingers.mimic_joints and all(f"{joint} follows" in fingers._repr_html_() for joint in fingers.mimic_joints)


def test_a_slide_as_long_as_a_country_keeps_its_limits():
    """At the far end of 1,000 km a micrometre is 10,000 times what is rounded."""
    arm = robots.urdf(
        dict(kind="prismatic", axis="1 0 0", limits=(-999999, 999999)),
        *[dict(kind="revolute", axis=a, xyz="0.1 0 0.3") for a in ("0 1 0", "0 0 1", "0 1 0")],
    )
    robot = ik.Robot.load(arm)
    assert robot.lower[0] == -999999.0 and robot.upper[0] == 999999.0
    Q = robot.random_q(np.random.default_rng(0), 50)
    assert ik.solve_batch(robot, np.array([robot.fk(q).homogeneous for q in Q])).success.all()


def millimetres(scale, mass=0.0):
    """An arm of three joints, 0.7 m long at scale 1."""
    axes = ("0 0 1", "0 1 0", "0 1 0")
    text = robots.urdf(
        *(dict(kind="revolute", xyz=f"{0.3 * scale} 0 0", axis=axis) for axis in axes),
        dict(kind="fixed", xyz=f"{0.1 * scale} 0 0"),
    )
    inertia = f'<inertial><mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    return robots.filled(text, {"l2": inertia if mass else ""})


def test_lengths_that_look_like_millimetres_are_doubted_when_a_robot_is_loaded(caplog):
    gantry = robots.urdf(
        dict(kind="prismatic", axis="1 0 0", limits=(0.0, 400.0)),
        dict(kind="prismatic", axis="0 1 0", limits=(-300.0, 300.0)),
        dict(kind="fixed", xyz="0 0 1"),
    )
    none = "have no mass"
    for text, weight in ((millimetres(1000), none), (millimetres(1000, 5), "weigh 5 kg"), (gantry, none)):
        caplog.clear()
        robot = ik.Robot.load(text)
        (note,) = robot.notes
        assert f" m long and {weight}: were millimetres meant?" in note and note in caplog.text
        joint = robot.joint_names[0]
        assert robot.locked({joint: 0.0}).notes[0] == robot.narrowed({joint: (0.0, 0.1)}).notes[0] == note
    crane = millimetres(90, 30_000)  # 63 m
    # in the frame of a map
    far = robots.urdf(dict(kind="revolute", xyz="5000 0 0"), dict(kind="revolute", xyz="1 0 0"))
    for text in (millimetres(1), millimetres(50), crane, far):
        assert ik.Robot.load(text).notes == ()
    assert ik.Robot.load("panda", on_base="floating", base_limits=(-500, 500)).notes == ()
