"""Calibration: planted errors are found, named and written into a URDF; what the data do not tell is said; files and mistakes."""

import numpy as np
import pinocchio as pin
import pytest
import robots
import second_fk
from folders import write_csv

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.robot.formats.dh import dh_fk

NOISE = 5e-4
ELSEWHERE = ik.pose(xyz=(5.0, -3.0, 1.0), rpy=(0.3, -0.2, 2.9))


class True_:
    """An arm with errors of every joint, link and the tool: a changed Pinocchio model, none of the package's own."""

    def __init__(self, robot, seed, length=5e-3, turn=np.radians(1.0)):
        rng = np.random.default_rng(seed)

        def error():
            return pin.SE3(pin.exp3(rng.normal(0.0, turn, 3)), rng.normal(0.0, length, 3))

        self.robot, self.model = robot, robot.model.copy()
        for j in range(1, self.model.njoints):
            self.model.jointPlacements[j] = self.model.jointPlacements[j] * error()
        self.tool, self.data = robot.tool * error(), self.model.createData()

    def __call__(self, Q):
        found = []
        for q in Q:
            pin.forwardKinematics(self.model, self.data, self.robot.to_pinocchio(q))
            ends = [
                pin.updateFramePlacement(self.model, self.data, self.model.getFrameId(name))
                for name in (self.robot.base, self.robot.tip)
            ]
            found.append((ends[0].actInv(ends[1]) * self.tool).homogeneous)
        return np.array(found)


def drawn(robot, seed, count):
    low, high = np.maximum(robot.lower, -3.0), np.minimum(robot.upper, 3.0)
    return np.random.default_rng(seed).uniform(low, high, (count, robot.n))


def measured(truth, Q, seed, noise=NOISE):
    T = truth(Q)
    T[:, :3, 3] += np.random.default_rng(seed).normal(0.0, noise, (len(Q), 3))
    return T


def off(found, truth, H, world=np.eye(4)):
    """Root mean square of the predicted positions, per coordinate [m], and the share inside their intervals."""
    p, half = found.predict(H)
    e = p - (world @ truth(H))[:, :3, 3]
    return float(np.sqrt((e**2).mean())), float((np.abs(e) < half).mean())


@pytest.fixture(scope="module")
def arm():
    return robots.load("hydrolek_7w")


@pytest.fixture(scope="module")
def good(arm):
    """A calibration from 30 positions, with what it was made from."""
    truth, Q = True_(arm, 1), drawn(arm, 2, 30)
    return ik.calibrate(arm, Q, measured(truth, Q, 3)[:, :3, 3]), truth, Q


# --------------------------------------------------------------------------------------------------------- accuracy
def test_planted_errors_are_found(arm, good):
    found, truth, _ = good
    H = drawn(arm, 4, 300)
    error, inside = off(found, truth, H)
    assert error < 0.9 * NOISE and inside > 0.85
    assert 0.8 * NOISE < found.noise[0] < 1.25 * NOISE
    assert found.rms[0] > 10e-3 > 1.5e-3 > found.rms[1] and found.held_out < 2.5e-3
    assert not found.outliers and not found.reversed and found.converged


def test_rank_and_names_of_what_cannot_be_told(good):
    found = good[0]
    # Tip on the last axis: its tilt acts only through the tool's offset, so the arm as drawn shows two fewer.
    assert (found.rank, found.rank_drawn) == (27, 25)
    fixed = {one.fixed: one.shared for one in found.fixed}
    assert len(fixed) == 15 and not set(fixed) & set(found.errors)
    assert fixed["tool.rz"] == () and "wrist_roll.offset" in fixed  # nothing of a position on the axis depends on them
    assert "pitch" in " ".join(fixed["elbow_pitch.y"])  # two parallel axes share a translation along or across
    assert set(found.errors) | set(fixed) == {one.name for one in found.unknowns}


def test_poses_tell_the_tool_and_errors_of_one_joint_are_where_they_were_planted(arm):
    """An offset and a lengthened link, nothing else: they are found by name and size, and all else is nothing."""
    model = arm.model.copy()
    j, k = model.getJointId("elbow_pitch"), model.getJointId("forearm_roll")
    axis = np.asarray(model.joints[j].createData().S).reshape(6)[3:]
    model.jointPlacements[j] = model.jointPlacements[j] * pin.SE3(pin.exp3(0.02 * axis), np.zeros(3))
    truth = True_(arm, 0, 0.0, 0.0)
    truth.model = model
    truth.model.jointPlacements[k] = model.jointPlacements[k] * pin.SE3(np.eye(3), np.array([0.004, 0.0, 0.0]))
    truth.data = truth.model.createData()
    Q = drawn(arm, 5, 25)
    found = ik.calibrate(arm, Q, truth(Q), "pose")
    assert found.errors["elbow_pitch.offset"][0] == pytest.approx(0.02, abs=1e-4)
    assert found.errors["forearm_roll.x"][0] == pytest.approx(0.004, abs=1e-4)
    rest = [abs(x) for name, (x, _) in found.errors.items() if name not in ("elbow_pitch.offset", "forearm_roll.x")]
    assert max(rest) < 1e-4


def test_outliers_are_named_and_left_out(arm, good):
    _, truth, Q = good
    T = measured(truth, Q, 3)
    T[[4, 11, 20], :3, 3] += np.array([[0.02, 0, 0], [0, -0.014, 0.014], [0, 0, 0.02]])
    found = ik.calibrate(arm, Q, T[:, :3, 3])
    assert found.outliers == (4, 11, 20) and any("4, 11, 20" in note for note in found.notes)
    H = drawn(arm, 4, 300)
    assert off(found, truth, H)[0] < 1.4 * off(good[0], truth, H)[0]


def test_wrong_signs_are_named_and_corrected(arm, tmp_path):
    truth, Q = True_(arm, 6), drawn(arm, 7, 30)
    T = measured(truth, Q, 8)
    sign = np.array([1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
    found = ik.calibrate(arm, Q * sign, T[:, :3, 3])
    assert tuple(found.reversed) == arm.joint_names[2:4]
    assert found.rms[1] < 1.5e-3 and found.reversed[arm.joint_names[2]] < 0.3
    made = found.write(tmp_path / "arm.urdf")
    H = drawn(arm, 9, 50) * sign
    back = ik.Robot.load(tmp_path / "arm.urdf", tip=made.tip)
    assert max(np.abs(back.fk(q).homogeneous - found.fk(q).homogeneous).max() for q in H) < 1e-12
    assert any("reversed" in note for note in found.notes)


# ------------------------------------------------------------------------------------------------- files and other arms
CASES = {
    "tool off the last axis": lambda: (
        robots.load("hydrolek_7w")
        .locked({"elbow_pitch": 0.4})
        .with_tool(ik.pose(xyz=(0.08, 0.05, 0.1), rpy=(0.2, 0.3, 0.4)))
    ),
    "mimic joints": lambda: robots.load("palletizer"),
    "prismatic": lambda: robots.load("scara"),
    "on_base": lambda: ik.Robot.load("planar_3r", on_base=ELSEWHERE),
    "axes of all kinds": lambda: ik.Robot.load(robots.CONTINUOUS),
    "one joint": lambda: ik.Robot.load(robots.urdf(dict(kind="revolute", axis="0 1 1"))),
}


@pytest.mark.parametrize("name", CASES)
def test_the_corrected_urdf_is_the_calibrated_arm(name, tmp_path):
    robot = CASES[name]()
    truth, Q = True_(robot, 11), drawn(robot, 12, 20)
    found = ik.calibrate(robot, Q, measured(truth, Q, 13), "pose")
    assert found.rms[1] < 1.5e-3 and len(found.outliers) < 3
    made = found.write(tmp_path / "arm.urdf")
    more = {"on_base": robot.on_base} if robot.on_base is not None else {}
    back = ik.Robot.load(tmp_path / "arm.urdf", tip=made.tip, locked=robot.locked_joints, **more)
    H = drawn(robot, 14, 20)
    for q in H:
        assert np.abs(back.fk(q).homogeneous - found.fk(q).homogeneous).max() < 1e-12
        assert np.abs(made.fk(q).homogeneous - found.fk(q).homogeneous).max() < 1e-12
        assert np.abs(dh_fk(found.dh, q) - made.fk(q).homogeneous).max() < 1e-9 if found.dh else "mimic" in name
    assert off(found, truth, H)[0] < NOISE


def test_written_file_by_a_second_reading(arm, good, tmp_path):
    """The URDF's text alone, read with numpy, gives the calibrated poses."""
    found = good[0]
    made = found.write(tmp_path / "arm.urdf")
    text = (tmp_path / "arm.urdf").read_text()
    q = drawn(arm, 15, 1)[0]
    T = second_fk.SecondFK(text, arm.base, made.tip).fk(q, arm.joint_names)[0]
    assert np.abs(T - found.fk(q).homogeneous).max() < 1e-12


def test_an_instrument_with_a_frame_of_its_own(arm):
    truth, Q = True_(arm, 16), drawn(arm, 17, 30)
    m = (ELSEWHERE @ measured(truth, Q, 18))[:, :3, 3]
    with pytest.raises(InvalidTarget, match="'base' to parameters"):
        ik.calibrate(arm, Q, m)
    found = ik.calibrate(arm, Q, m, parameters=("joints", "frames", "tool", "base"))
    H = drawn(arm, 19, 200)
    assert off(found, truth, H, ELSEWHERE)[0] < NOISE
    assert np.abs(found.T_world_base - ELSEWHERE).max() < 0.1  # but for what the first joint's frame takes
    fixed = {one.fixed: one.shared for one in found.fixed}
    assert any("base" in word for word in fixed["azimuth_yaw.x"])
    q = H[0]
    assert np.abs(found.T_world_base @ found.robot.fk(q).homogeneous - found.fk(q).homogeneous).max() < 1e-12


# ------------------------------------------------------------------------------------------------- without an instrument
def touching(truth, robot, places, each, seed, noise=1e-4):
    """Configurations (K each, n) whose tip, on the true arm, is at places (K, 3) but for the noise."""
    rng, Q = np.random.default_rng(seed), []
    low, span = robot.lower + 0.05 * (robot.upper - robot.lower), 0.9 * (robot.upper - robot.lower)
    for k, place in enumerate(places, 1):
        for _ in range(60 * each):
            q, aim = low + span * rng.random(robot.n), place + rng.normal(0.0, noise, 3)
            for _ in range(12):
                p = truth([q])[0, :3, 3]
                J = np.array([(truth([q + 1e-6 * e])[0, :3, 3] - p) / 1e-6 for e in np.eye(robot.n)]).T
                q = np.clip(q + J.T @ np.linalg.solve(J @ J.T + 1e-9 * np.eye(3), aim - p), robot.lower, robot.upper)
            if np.linalg.norm(truth([q])[0, :3, 3] - aim) < 1e-7:
                Q.append(q)
            if len(Q) == k * each:
                break
    assert len(Q) == each * len(places)
    return np.array(Q)


def onto_plane(truth, q, n, d):
    """The configuration near q whose tip, on the true arm, is at the height d along n."""
    for _ in range(20):
        height = truth([q])[0, :3, 3] @ n - d
        slope = np.array([(truth([q + 1e-6 * e])[0, :3, 3] @ n - d - height) / 1e-6 for e in np.eye(len(q))])
        q = q - slope * height / (slope @ slope)
    return q


def aligned(X, Y):
    a, b = X - X.mean(0), Y - Y.mean(0)
    U, _, V = np.linalg.svd(a.T @ b)
    return a @ U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V + Y.mean(0)


def test_sockets_with_and_without_a_known_distance(arm):
    truth = True_(arm, 21, 1.25e-3, np.radians(0.25))
    places = truth([arm.home, arm.home + np.array([0.5, 0.2, -0.2, 0.3, 0.1, 0.0])])[:, :3, 3]
    distance = float(np.linalg.norm(places[0] - places[1]))
    Q, labels = touching(truth, arm, places, 20, 22), np.repeat([0, 1], 20)
    H = drawn(arm, 23, 200)
    t = truth(H)[:, :3, 3]
    free = ik.calibrate(arm, Q, labels, "socket")
    assert any("scale" in note for note in free.notes)
    assert any(one.shared == ("the sockets",) for one in free.fixed)
    known = ik.calibrate(arm, Q, labels, "socket", distances=distance)
    assert not any("scale" in note for note in known.notes) and any("aligning" in note for note in known.notes)
    before = aligned(np.array([arm.fk(q).translation for q in H]), t) - t
    after = aligned(known.predict(H)[0], t) - t
    assert np.sqrt((after**2).sum(1).mean()) < 0.4 * np.sqrt((before**2).sum(1).mean())
    assert np.linalg.norm(known.touched[0] - known.touched[1]) == pytest.approx(distance, abs=2e-4)
    placed = ik.calibrate(arm, Q, labels, "socket", places=places)
    assert any("turn about their line" in note for note in placed.notes)
    assert np.linalg.norm(placed.predict(Q[:1])[0] - places[0]) < 1e-3


def test_distances_and_planes(arm):
    truth, Q = True_(arm, 24, 1.25e-3, np.radians(0.25)), drawn(arm, 25, 60)
    T = measured(truth, Q, 26, 1e-4)
    ends = np.array([[1.5, 0.2, -0.4], [0.3, 1.6, 0.2], [-0.2, -1.0, 1.2]])
    labels = np.arange(60) % 3
    L = np.linalg.norm(T[:, :3, 3] - ends[labels], axis=1)
    found = ik.calibrate(arm, Q, np.column_stack([labels, L]), "distance", places=ends)
    assert found.rms[1] < 3e-4 < found.rms[0] / 5 and off(found, truth, Q)[0] < 1e-3
    assert ik.calibrate(arm, Q, np.column_stack([labels, L]), "distance").rms[1] < 3e-4
    # Three planes, each touched in 25 configurations.
    planes = [(np.array([0.0, 0.0, 1.0]), 0.1), (np.array([0.6, 0.0, 0.8]), 0.6), (np.array([0.0, 1.0, 0.0]), 0.2)]
    Q, rng = [], np.random.default_rng(27)
    for n, d in planes:
        tips = arm.random_q(rng, 400)
        near = tips[np.argsort([abs(arm.fk(q).translation @ n - d) for q in tips])[:25]]
        Q += [onto_plane(truth, q, n, d + rng.normal(0.0, 1e-4)) for q in near]
    found = ik.calibrate(arm, np.array(Q), np.repeat([0, 1, 2], 25), "plane")
    assert found.rms[1] < 2e-4 < found.rms[0] / 3 and any("planes" in note for note in found.notes)


# ---------------------------------------------------------------------------------------------------- poses to measure
def test_suggested_poses_tell_more(arm):
    Q = ik.suggest_poses(arm, 20, seed=1)
    assert Q.shape == (20, 6) and all(not arm.outside(q) for q in Q)
    crash = ik.CollisionModel(arm)
    assert not any(crash.collides(q) for q in Q)
    truth = True_(arm, 31)
    chosen, random = (ik.calibrate(arm, P, measured(truth, P, 32)[:, :3, 3]) for P in (Q, drawn(arm, 33, 20)))
    assert chosen.observability > 1.2 * random.observability
    H = drawn(arm, 34, 200)
    more = random.suggest(5)
    narrow = ik.calibrate(arm, np.vstack([random.q, more]), measured(truth, np.vstack([random.q, more]), 32)[:, :3, 3])
    assert narrow.predict(H)[1].mean() < 0.9 * random.predict(H)[1].mean()
    with pytest.raises(InvalidOption, match="touches"):
        ik.suggest_poses(arm, 3, what="socket")
    with pytest.raises(InvalidOption, match="avoid_collisions"):
        ik.suggest_poses(arm, 3, avoid_collisions="yes")
    with pytest.raises(InvalidOption, match="another Robot object"):
        ik.suggest_poses(arm, 3, avoid_collisions=ik.CollisionModel(ik.Robot.load("hydrolek_7w")))


def test_intervals_are_numbers_however_wide_the_prior_is(arm):
    q = arm.random_q(np.random.default_rng(0), 40)
    measured = [arm.fk(row).translation for row in q] + np.random.default_rng(1).normal(0.0, 2e-4, (40, 3))
    found = ik.calibrate(arm, q, measured, prior=(10.0, 0.035), noise=1e-6)
    assert all(half > 0.0 for _, half in found.errors.values())


def test_too_little_data_are_said(arm, good):
    """A wrist that never moved: its errors are assumed, and other poses could tell them."""
    truth, Q = good[1], drawn(arm, 35, 30)
    Q[:, 3:] = 0.2
    found = ik.calibrate(arm, Q, measured(truth, Q, 36)[:, :3, 3])
    assert found.rank_anywhere > found.rank and any("other poses" in note for note in found.notes)
    assert "frames" in " ".join(ik.calibrate(arm, Q, measured(truth, Q, 36)[:, :3, 3], parameters="joints").notes)


# ------------------------------------------------------------------------------------------------------------ mistakes
@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (dict(what="positon"), InvalidOption, "position"),
        (dict(parameters=("joint",)), InvalidOption, "joints"),
        (dict(q=lambda q: q[:, :5]), InvalidConfiguration, "azimuth_yaw"),
        (dict(q=lambda q: q[:20]), InvalidTarget, "20 rows"),
        (dict(q=np.degrees), InvalidConfiguration, "degrees"),
        (dict(q=lambda q: q * np.where(np.arange(30) == 7, np.nan, 1.0)[:, None]), InvalidConfiguration, "row 7"),
        (dict(q=lambda q: q * 0.0), InvalidConfiguration, "the same"),
        (dict(measured=lambda m: 1e3 * m), InvalidTarget, "millimetres"),
        (dict(measured=lambda m: m * np.where(np.arange(30) == 7, np.nan, 1.0)[:, None]), InvalidTarget, "row 7"),
        (dict(what="pose"), InvalidTarget, "what='position'"),
        (dict(measured=lambda m: np.tile(np.eye(4), (30, 1, 1))), InvalidTarget, "what='pose'"),
        (dict(q=lambda q: q[:6], measured=lambda m: m[:6]), InvalidTarget, "at least 10"),
        (dict(what="socket", measured=lambda m: np.arange(30) % 2 * 2), InvalidTarget, "no measurement names socket 1"),
        (dict(what="socket", measured=lambda m: np.arange(30) % 2, distances={(0, 2): 1.0}), InvalidOption, "sockets"),
        (dict(what="socket", measured=lambda m: np.arange(30) % 2, parameters=("base",)), InvalidOption, "base"),
        (dict(places=np.zeros((1, 3))), InvalidOption, "places"),
        (dict(noise=-1.0), InvalidOption, "noise"),
        (dict(noise=1e-12), InvalidOption, "at least 1e-06"),  # variances below rounding had intervals that were NaN
        (dict(prior=3.0), InvalidOption, "prior"),
    ],
)
def test_mistakes(arm, good, change, error, words):
    _, truth, Q = good
    given = {"q": Q, "measured": measured(truth, Q, 3)[:, :3, 3], **change}
    for name, value in (("q", Q), ("measured", measured(truth, Q, 3)[:, :3, 3])):
        given[name] = given[name](value) if callable(given[name]) else given[name]
    with pytest.raises(error, match=words):
        ik.calibrate(arm, **given)


def test_several_tips_and_no_urdf(arm, good, tmp_path):
    with pytest.raises(InvalidOption, match="left_tip, right_tip"):
        ik.calibrate(ik.Tree.load("brokk_hydrolek"), np.zeros((30, 12)), np.zeros((30, 3)))
    _, truth, Q = good
    bare = ik.Robot(arm.model, tip=arm.tip)
    found = ik.calibrate(bare, Q, measured(truth, Q, 3)[:, :3, 3])
    assert found.rank == 27 and found.dh is None
    with pytest.raises(ik.IKError, match="without a URDF"):
        found.write(tmp_path / "arm.urdf")


# --------------------------------------------------------------------------------------------------- text, page, command
def test_page_and_chart(good, tmp_path):
    found = good[0]
    for write, name in ((found.save, "page.txt"), (found.write, "arm.json")):
        with pytest.raises(InvalidOption, match=f"written as .*, not '{name}'"):
            write(tmp_path / name)
    page = found.save(tmp_path / "page.html").read_text()
    said = "http" not in page and "cannot tell" in page and found.fixed[0].fixed in page
    assert said and page.count("<circle") == 60 and f"{1e3 * found.dh.rows[2].a:.3f}" in page
    assert "elbow_pitch.offset" in str(found) and "<table>" in found._repr_html_()
    pytest.importorskip("matplotlib")
    ik.plot(found, file=tmp_path / "chart.svg")
    assert "corrected" in (tmp_path / "chart.svg").read_text()


def test_command(run, told, refused, arm, good, tmp_path):
    _, truth, Q = good
    out, data, urdf, page = (tmp_path / name for name in ("poses.csv", "measured.csv", "out.urdf", "page.html"))
    assert run("calibrate", "hydrolek_7w", "--suggest", 4, "-o", out, "--deg")[0] == 0
    head, *rows = out.read_text().splitlines()
    assert head.split(",")[:6] == list(arm.joint_names) and len(rows) == 4
    m = measured(truth, Q, 3)[:, :3, 3]
    write_csv(data, ",".join([*arm.joint_names, "x", "y", "z"]), np.hstack([np.degrees(Q), 1e3 * m]).tolist())
    words = ["calibrate", "hydrolek_7w", "--data", data, "--deg", "--length-unit", "mm"]
    code, said, _ = run(*words, "-o", urdf, "--html", page)
    assert code == 0 and "fixed as drawn" in said and "elbow_pitch.offset" in said
    assert max(map(len, said.splitlines())) <= 100 and "<svg" in page.read_text()
    made = ik.Robot.load(urdf, tip="tool").fk(Q[0]).homogeneous
    assert np.abs(made - good[0].fk(Q[0]).homogeneous).max() < 1e-6
    for more in ((), ("--prior", 0.01, np.degrees(0.035))):  # the default, typed
        value = told(*words, *more)["errors"]["elbow_pitch.offset"]["value"]
        assert value == pytest.approx(good[0].errors["elbow_pitch.offset"][0], abs=1e-6)
    np.savez(tmp_path / "m.npz", q=Q, measured=m)
    code, said, _ = run("calibrate", "hydrolek_7w", "--data", tmp_path / "m.npz")
    assert code == 0 and "27 of 42 unknowns" in said
    for robot, words, wrong in (
        ("hydrolek_7w", [], "--suggest"),
        ("hydrolek_7w", ["--data", data], "degrees"),
        ("hydrolek_7w", ["--data", data, "--deg"], "millimetres"),
        ("hydrolek_7w", ["--data", out, "--deg"], "no column x"),
        ("planar_3r", ["--data", data], "no column"),
        ("hydrolek_7w", ["--suggest", 3, "-o", urdf], ".csv"),
        ("hydrolek_7w", ["--data", data, "-o", "x.csv"], ".urdf"),
        ("hydrolek_7w", ["--data", data, "--distance", "0:1"], "A:B:M"),
    ):
        assert wrong in refused("calibrate", robot, *words)
