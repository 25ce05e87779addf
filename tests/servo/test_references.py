"""References: exact derivatives, waypoints, and invalid files."""

import zipfile

import numpy as np
import pinocchio as pin
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidOption, InvalidTarget
from ik_toolkit.servo.default_path import eight, joint_motion
from ik_toolkit.servo.methods import Method, make_method
from ik_toolkit.servo.path_reach import scaled
from ik_toolkit.servo.stability import best_gains, check_gains

START = pin.SE3(pin.exp3(np.array([0.3, -0.8, 0.5])), np.array([0.4, -0.2, 0.6])).homogeneous
END = pin.SE3(pin.exp3(np.array([-0.9, 0.4, 1.1])), np.array([0.1, 0.3, 0.2])).homogeneous
MIDDLE = pin.SE3(pin.exp3(np.array([0.1, 0.9, 0.2])), np.array([0.3, 0.1, 0.7])).homogeneous

SHAPES = {
    "line": lambda a, b, c: ik.line(a, b, duration=3.0),
    "line at minimum jerk": lambda a, b, c: ik.line(a, b, duration=3.0, law="minimum-jerk"),
    "line there and back": lambda a, b, c: ik.line(a, b, duration=3.0, rounds=2),
    "circle": lambda a, b, c: ik.circle(a, 0.2, normal=(0.2, -0.5, 1.0), turns=1.5, duration=4.0),
    "circle at minimum jerk": lambda a, b, c: ik.circle(a, 0.2, duration=4.0, law="minimum-jerk"),
    "lissajous": lambda a, b, c: ik.lissajous(
        a, (0.1, 0.2, 0.05), cycles=(1, 2, 3), phases=(0.1, 0.2, 0.3), duration=4.0
    ),
    "waypoints": lambda a, b, c: ik.waypoints([a, b, c, a], duration=6.0),
    "spline": lambda a, b, c: ik.waypoints([a, b, c, a], times=[0.0, 1.0, 3.5, 6.0], law="spline"),
    "eight": lambda a, b, c: eight(a, 0.07, (0.2, -0.5, 1.0), turns=2.0, duration=3.0),
    "scaled eight": lambda a, b, c: scaled(eight(a, 0.1, (0.0, 0.0, 1.0), duration=3.0, law="minimum-jerk"), 0.6),
}


def derivatives_are_those_of_the_poses(ref, t, d=1e-5):
    """Compare twists and accelerations with differences."""
    (T0, V0, _), (T, V, A), (T1, V1, _) = ref.at(t - d), ref.at(t), ref.at(t + d)
    assert V[:, :3] == pytest.approx((T1[:, :3, 3] - T0[:, :3, 3]) / (2 * d), abs=1e-8)
    turned = np.array([pin.log3(b @ a.T) for a, b in zip(T0[:, :3, :3], T1[:, :3, :3], strict=True)])
    assert V[:, 3:] == pytest.approx(turned / (2 * d), abs=1e-8)
    assert A == pytest.approx((V1 - V0) / (2 * d), abs=1e-7)
    assert T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2) == pytest.approx(
        np.tile(np.eye(3), (len(t), 1, 1)), abs=1e-12
    )


@pytest.mark.parametrize("pose", [True, False], ids=["pose", "position"])
@pytest.mark.parametrize("name", SHAPES)
def test_twist_and_acceleration_are_the_derivatives(name, pose):
    ref = SHAPES[name](*((START, END, MIDDLE) if pose else (START[:3, 3], END[:3, 3], MIDDLE[:3, 3])))
    assert ref.position_only is not pose
    derivatives_are_those_of_the_poses(ref, np.linspace(0.013, ref.duration - 0.017, 41))


@pytest.mark.parametrize("name", SHAPES)
def test_starts_where_it_should(name):
    T = SHAPES[name](START, END, MIDDLE).at(0.0)[0]
    wanted = START.copy()
    if name == "lissajous":
        wanted[:3, 3] += np.array([0.1, 0.2, 0.05]) * np.sin([0.1, 0.2, 0.3])
    assert T == pytest.approx(wanted, abs=1e-12)


def test_waypoints_and_ends():
    for law in ("minimum-jerk", "spline"):
        ref = ik.waypoints([START, END, MIDDLE], times=[2.0, 3.0, 5.5], law=law)
        assert ref.duration == 3.5  # the first time becomes 0
        for t, T in ((0.0, START), (1.0, END), (3.5, MIDDLE)):
            assert ref.at(t)[0] == pytest.approx(T, abs=1e-9)
        assert ref.at(0.0)[1][:3] == pytest.approx(np.zeros(3), abs=1e-9)
    stop = ik.waypoints([START, END, MIDDLE], duration=4.0)
    leg = [np.linalg.norm(b[:3, 3] - a[:3, 3]) + 0.25 * np.linalg.norm(pin.log3(a[:3, :3].T @ b[:3, :3])) for a, b in
           ((START, END), (END, MIDDLE))]  # fmt: skip
    assert stop.at(4.0 * leg[0] / sum(leg))[1] == pytest.approx(np.zeros(6), abs=1e-6)
    assert ik.line(START, END, duration=2.0).at(2.0)[0] == pytest.approx(END, abs=1e-12)
    assert ik.line(START, END, duration=2.0, rounds=3).at(2.0)[0] == pytest.approx(START, abs=1e-9)


def test_circle_geometry():
    ref = ik.circle(START, 0.2, normal=(0, 0, 1), duration=1.0)
    p = ref.at(np.linspace(0, 1, 50))[0][:, :3, 3]
    center = START[:3, 3] - (0.2, 0, 0)
    assert np.linalg.norm(p - center, axis=1) == pytest.approx(np.full(50, 0.2))
    assert p[:, 2] == pytest.approx(np.full(50, START[2, 3]))
    assert p[12, 1] > center[1]  # counter-clockwise
    about = ik.circle(center=center, radius=0.2, duration=1.0)
    assert about.position_only and about.target(0.0) == pytest.approx(START[:3, 3])


def test_times_and_custom_references():
    ref = ik.line((0, 0, 0), (1, 0, 0), duration=1.0)
    assert len(ref.times(0.1)) == 11 and ref.times(0.3)[-1] == pytest.approx(0.9)
    own = ik.Reference(lambda t: ref.at(t), 1.0, position_only=True)
    assert own.target(0.25) == pytest.approx([0.25, 0, 0])
    assert own.at(0.25)[0].shape == (4, 4) and own.at([0.25])[0].shape == (1, 4, 4)
    with pytest.raises(InvalidTarget, match="must give"):
        ik.Reference(lambda t: (np.eye(4), np.zeros(6), np.zeros(6)), 1.0).at(0.0)
    with pytest.raises(InvalidOption, match="steps"):
        ref.times(1e-9)


def test_files_are_read_back(tmp_path):
    source = ik.lissajous(START, duration=2.0)
    t = np.linspace(5.0, 7.0, 81)
    T = source.at(t - 5.0)[0]
    quat = np.array([pin.Quaternion(R).coeffs() for R in T[:, :3, :3]])
    np.savez(tmp_path / "path.npz", t=t, xyz=T[:, :3, 3], quat_xyzw=quat)
    lines = [
        "t,x,y,z,qx,qy,qz,qw",
        *(",".join(map(repr, row)) for row in np.column_stack([t, T[:, :3, 3], quat]).tolist()),
    ]
    (tmp_path / "path.csv").write_text("\n".join(lines) + "\n")
    inner = np.linspace(0.05, 1.95, 77)
    for name in ("path.npz", "path.csv"):
        ref = ik.reference_from_file(tmp_path / name)
        assert not ref.position_only and ref.duration == pytest.approx(2.0)
        for got, wanted, tolerance in zip(ref.at(inner), source.at(inner), (1e-6, 1e-4, 2e-2), strict=True):
            assert got == pytest.approx(wanted, abs=tolerance)
    (tmp_path / "positions.csv").write_text("t, x, y, z\n0,0,0,0\n1,1,0,0\n")
    ref = ik.reference_from_file(str(tmp_path / "positions.csv"))
    assert ref.position_only and ref.at(0.5)[1][:3] == pytest.approx([1, 0, 0])


BAD_CSV = {
    "": "is empty; its first line names the columns, such as t,x,y,z,",
    "x,y,z\n1,2,3\n": "no column t",
    "t,x,y,z,qx,qy\n0,0,0,0,0,0\n1,0,0,0,0,0\n": "the columns qx, qy",
    "t,x,y,z\n0,0,0,0\n": "at least 2",
    "t,x,y,z\n0,0,0,0\n1,one,0,0\n": "line 3: 'one' is not a finite number",
    "t,x,y,z\n0,0,0,0\n1,0,0\n": "line 3: 3 columns, fewer than in the header",
    "t,x,y,z,X\n0,0,0,0,1\n1,0,0,0,1\n": "has the column x more than once",
    "t,x,y,z\n0,0,0,0\n1,nan,0,0\n": "line 3: 'nan' is not a finite",
    "t,x,y,z\n0,0,0,0\ninf,0,0,0\n": "line 3: 'inf' is not a finite",
    "t,x,y,z\n0,0,0,0\n2,0,0,0\n1,0,0,0\n": "line 4: t must increase, and 1 comes after 2",
    "t,x,y,z\n0,0,0,0\n2,0,0,0\n\n1,0,0,0\n": "line 5: t must increase",
    "t,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,0\n": "line 3: the quaternion qx,qy,qz,qw has length 0",
}


@pytest.mark.parametrize("text", BAD_CSV)
def test_bad_csv(tmp_path, text):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(InvalidTarget, match=BAD_CSV[text]):
        ik.reference_from_file(file)


def test_bad_npz_and_bytes(tmp_path):
    file = tmp_path / "bad.npz"
    with pytest.raises(InvalidTarget, match="no reference file"):
        ik.reference_from_file(file)
    for content in (b"", b"not a zip", b"PK\x03\x04" + bytes(range(256))):
        file.write_bytes(content)
        with pytest.raises(InvalidTarget):
            ik.reference_from_file(file)
    for arrays, words in (
        (dict(t=[0, 1], positions=np.zeros((2, 3))), "no array 'xyz'"),
        (dict(t=[0, 1], xyz=np.zeros((3, 2))), "shape"),
        (dict(t=[0, 1, 2], xyz=np.zeros((2, 3))), "2 numbers"),
        (dict(t=[0.0], xyz=np.zeros((1, 3))), r"'bad.npz' has 1 row\(s\); a path needs at least 2"),
        (dict(t=[0.0, 1e-101, 1.0], xyz=np.zeros((3, 3))), "bad.npz: times less than .* s apart make no curve"),
        (
            dict(t=np.array([{}, {}], dtype=object), xyz=np.zeros((2, 3))),
            "the type object, not real numbers",
        ),  # pickled objects are never loaded
    ):
        np.savez(file, **arrays)
        with pytest.raises(InvalidTarget, match=words):
            ik.reference_from_file(file)
    np.savez(file, t=[0.0, 0.5, 1.0], xyz=np.zeros((3, 3)))
    assert ik.reference_from_file(file).duration == 1.0
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InvalidTarget):
        ik.reference_from_file(tmp_path / "bytes.csv")


def test_angles_of_a_file_are_those_of_its_poses(tmp_path):
    rows = [(0.0, 0.1, 0.2, 0.3, 0.4, -0.5, 0.6), (2.0, 0.2, 0.2, 0.3, 0.1, 0.5, -0.6)]
    lines = ["yaw,t,x,y,z,roll,pitch,note", *(f"{row[6]},{','.join(map(str, row[:6]))},far" for row in rows)]
    (tmp_path / "angles.csv").write_text("\n".join(lines))
    ref = ik.reference_from_file(tmp_path / "angles.csv")
    for t, *xyz_rpy in rows:
        assert ref.at(t)[0] == pytest.approx(ik.pose(xyz_rpy[:3], rpy=xyz_rpy[3:]), abs=1e-12)


def test_a_file_that_grows_without_measure_is_refused(tmp_path):
    file = tmp_path / "huge.npz"
    with zipfile.ZipFile(file, "w") as archive, archive.open("t.npy", "w") as stream:
        head = {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
        np.lib.format.write_array_header_1_0(stream, head)
    with zipfile.ZipFile(file, "a") as archive, archive.open("xyz.npy", "w") as stream:
        np.save(stream, np.zeros((2, 3)))
    with pytest.raises(InvalidTarget, match=r"t\.npy declares 8,000,000,000,000 bytes but holds"):
        ik.reference_from_file(file)


def timed(times):
    return ik.waypoints([START, END, MIDDLE], times=times)


@pytest.mark.parametrize(
    "make, error, words",
    [
        (lambda: ik.line(START, END[:3, 3], duration=1.0), InvalidTarget, "two poses or two positions"),
        (lambda: ik.line(START, END, duration=-1.0), InvalidOption, "duration"),
        (lambda: ik.line(START, END, duration=1.0, law="minimum-jrek"), InvalidOption, "Did you mean 'minimum-jerk'"),
        (lambda: ik.circle(duration=1.0), InvalidOption, "start= or center="),
        (lambda: ik.circle(START, 0.0), InvalidOption, "radius"),
        (
            lambda: ik.circle(START, duration=1e200),
            InvalidOption,
            r"duration \[s\] must be a positive number below 1e\+100",
        ),
        (lambda: ik.circle(START, 0.1, normal=(0, 0, 0)), InvalidOption, "normal"),
        (lambda: ik.circle(np.full(3, np.nan)), InvalidTarget, "finite"),
        (lambda: ik.lissajous(START, (0.1, 0.1)), InvalidOption, "amplitudes"),
        (lambda: ik.waypoints([START], duration=1.0), InvalidTarget, "at least 2"),
        (lambda: ik.waypoints([START, END[:3, 3]], duration=1.0), InvalidTarget, "all poses or all positions"),
        (lambda: ik.waypoints([START, END]), InvalidOption, "times= or duration="),
        (lambda: ik.waypoints([START, END, END], duration=1.0), InvalidTarget, "1 and 2 are the same"),
        (
            lambda: timed([0.0, 1.0]),
            InvalidTarget,
            r"times must be 3 numbers, one per pose, not an array of shape \(2,\)",
        ),
        (lambda: timed([0.0, np.nan, 1.0]), InvalidTarget, r"times has a value that is not finite \(number 2\)"),
        (lambda: timed([0.0, 2.0, 1.0]), InvalidTarget, "times must increase: number 3 is 1 after 2"),
        (lambda: timed([0.0, 1.0, 1.0]), InvalidTarget, "times must increase: number 3 is 1 after 1"),
        (lambda: ik.reference_from_file([1]), InvalidTarget, "a reference file is named by a path, not list"),
        (lambda: ik.waypoints([START, END], duration=1.0, law="linear"), InvalidOption, "no waypoint law"),
        (lambda: ik.Reference(lambda t: t, 1.0, position_only="no"), InvalidOption, "position_only is True or False"),
    ],
)
def test_mistakes_are_typed(make, error, words):
    with pytest.raises(error, match=words):
        make()


NO_NUMBERS = [None, "x", b"x", [], {}, np.nan, 10**400, np.eye(4), object(), 1j, np.datetime64("2020-01-01")]


@pytest.mark.parametrize("wrong", NO_NUMBERS, ids=lambda value: repr(value)[:12])
def test_wrong_inputs_are_typed(wrong):
    """Whatever is given for a number, a name or a list: a sentence, never an error of numpy's or Python's own."""
    start, three, legs = np.eye(4), (0.1, 0.1, 0.0), [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)]
    calls = [
        *(
            lambda name=name: ik.circle(start, **{name: wrong})
            for name in ("radius", "turns", "duration", "law", "normal")
        ),
        *(
            lambda name=name: ik.line(start, start, **{"duration": 1.0, name: wrong})
            for name in ("duration", "law", "rounds")
        ),
        *(lambda name=name: ik.lissajous(start, **{name: wrong}) for name in ("amplitudes", "cycles", "phases", "law")),
        lambda: ik.lissajous(start, three, duration=wrong),
        lambda: ik.waypoints(wrong, duration=1.0),
        lambda: ik.waypoints(legs, times=wrong if wrong is not None else [0.0, 0.0, 1.0]),
        lambda: ik.waypoints(legs, duration=wrong),
        lambda: ik.waypoints(legs, duration=1.0, law=wrong),
        lambda: ik.reference_from_file(wrong),
        lambda: ik.circle(start).at([wrong, [wrong]]),
        lambda: ik.circle(start).target(wrong),
        lambda: ik.circle(start).times(wrong),
        lambda: make_method(Method("cv", gamma=wrong)),
        lambda: make_method(wrong),
        lambda: check_gains("cv", wrong, kappa=1.0),
        lambda: check_gains("cv", 0.1, kappa=wrong),
        lambda: check_gains("aad", 0.1, gamma=wrong),
        lambda: check_gains(wrong, 0.1),
        lambda: best_gains("cv", wrong),
        lambda: best_gains(wrong, 0.1),
    ]
    for k, call in enumerate(calls):
        with pytest.raises(IKError):
            call()
            pytest.fail(f"call {k} took {wrong!r}")


@pytest.mark.parametrize("seconds", [3.0, 9.0])
def test_the_default_path_knows_its_velocity_and_acceleration(seconds):
    robot = ik.Robot.load("planar_3r")
    motion = joint_motion(robot, robot.home + 0.1, duration=seconds)
    derivatives_are_those_of_the_poses(motion, np.linspace(0.1, seconds - 0.1, 9))
