"""CSV files of poses as spreadsheets write them: what cannot be read is refused with its line, and names run nothing."""

import csv
import json
import tracemalloc
import zipfile

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.cli import main
from ik_toolkit.errors import InvalidConfiguration, InvalidTarget
from ik_toolkit.files import inert, without_mark, write_table
from ik_toolkit.motion.trajectory import read_motion
from ik_toolkit.robot.pose_files import Convention, read_poses


def poses_of(tmp_path, text):
    file = tmp_path / "poses.csv"
    file.write_bytes(text.encode())
    return np.concatenate([block.poses for block in read_poses(file, "targets")[1]])


REFUSED = {
    "x,y,z\n1,2,3\n0,5,-1,0,2\n": "line 3: 5 columns, more than in the header; are decimals written with a comma",
    "x,y,z\n0,5,1,5,0,0\n": "line 2: 6 columns, more",
    "x,y,z\n1,2,3,\n": "line 2: 4 columns, more",
    "x,y,z,note\n1,2,3\n": "line 2: 3 columns, fewer than in the header",
    "x,y,z\n1,2\n": "line 2: 2 columns, fewer",
    "0.5,1,0\n0.5,1,0.1\n": "has no column x, y, z; its first line must be x,y,z",
    "x,y,z,x\n1,2,3,4\n": "has the column x more than once",
    'x,y,z\n"0,5",1,0\n': "line 2: '0,5' is not a finite number",
    'x,y,z\n1,"2,3\n': "line 2: .*unclosed quote",
    "x,y,z\n1,2,3\n\n1,2,3,4\n": "line 4: 4 columns",
    "x;y;z\n1;2;3;4\n": "line 2: 4 columns, more than in the header$",
    "x\ty\tz\n0.5\t1\n": "line 2: 2 columns, fewer",
    "x,y,z\n1,2,3\n1_0,2,3\n": "line 3: '1_0' is not a finite number",
    "x,y,z\n0.5;1;0\n": "line 2: 1 columns, fewer",
    "x,y,z,rx,ry,rz\n0,0,0,1,0,0\n": "columns rx, ry, rz: say with --euler about which axes the angles turn",
    "x,y,z,w,p,r\n0,0,0,1,0,0\n": "the columns w, p, r are not read; .* x,y,z, .* or with --euler x,y,z,rx,ry,rz or x,y,z,a,b,c",
    "x,y,z,roll_deg,pitch_deg\n0,0,0,1,0\n": "the columns roll_deg, pitch_deg are not read",
    "x,y,z,q1,q2,q3,q4\n0,0,0,1,0,0,0\n": "the columns q1, q2, q3, q4 are not read",
    "x,y,z,w,i,j,k\n0,0,0,1,0,0,0\n": "the columns i, j, k, w are not read",
    "x,y,z,orientation.x,orientation.w\n0,0,0,0,1\n": "the columns orientation.x, orientation.w are not read",
    "x,y,z,Rot_X\n0,0,0,1\n": "the columns rot_x are not read",
    "x,y,z,a,b,c\n0,0,0,1,0,0\n": "columns a, b, c: say with --euler",
    "x,y,z,roll,pitch\n0,0,0,1,0\n": "has the columns roll, pitch; the first line must be",
}


@pytest.mark.parametrize("text", REFUSED)
def test_rows_that_do_not_fit_their_header_are_refused_with_their_line(tmp_path, text):
    with pytest.raises(InvalidTarget, match=REFUSED[text]):
        poses_of(tmp_path, text)


def test_euler_axes_are_refused_where_no_angles_are_read(tmp_path):
    (tmp_path / "q.csv").write_text("x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,1\n")
    np.savez(tmp_path / "T.npz", targets=np.eye(4)[None])
    (tmp_path / "T.json").write_text(json.dumps({"targets": [np.eye(4).tolist()]}))
    for name in ("q.csv", "T.npz", "T.json"):
        assert len(list(read_poses(tmp_path / name, "targets")[1])) == 1
        with pytest.raises(InvalidTarget, match="--euler"):
            read_poses(tmp_path / name, "targets", given=Convention(euler="zyx"))


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z\n0.5,1,-2\n",
        '"x","y","z"\r\n"0.5","1","-2"\r\n',
        '\ufeffnote,x,y,z\n"a, b",0.5,1,-2\n',
        " X , y,z\n 0.5, 1 ,-2",
        "x;y;z\n0.5;1;-2\n",
        '\ufeffnote;x;y;z\r\n"a; b, c";0,5;1,0;-2\r\n',
        "x\ty\tz\n0,5\t1\t-2\n",
    ],
)
def test_what_is_meant_is_read(tmp_path, text):
    assert poses_of(tmp_path, text).tolist() == [[0.5, 1.0, -2.0]]


def test_a_longer_row_far_down_a_large_file_is_found(tmp_path):
    rows = ["0.1,0.2,0.3"] * 40_000
    rows[30_000] = "0,1,0,2,0,3"
    with pytest.raises(InvalidTarget, match="line 30002: 6 columns"):
        poses_of(tmp_path, "x,y,z\n" + "\n".join(rows))


def test_blank_lines_between_rows_are_skipped_and_said(tmp_path, caplog):
    """Of those that a spreadsheet leaves below a table nothing is said."""
    rows = [[0.5, 1.0, -2.0], [0.5, 1.0, -3.0]]
    for text, said in (
        ("x,y,z\n0.5,1,-2\n0.5,1,-3\n\n,,\n", ""),
        ("\n\nx;y;z\n0,5;1;-2\n0,5;1;-3\n;;\n", ""),
        ("x,y,z\n0.5,1,-2\n\n0.5,1,-3\n", "1 blank line skipped, at line 3; the answers have no rows for it"),
        ("x,y,z\n\n0.5,1,-2\n,,\n\n0.5,1,-3\n\n", "3 blank lines skipped, at lines 2 and 4; the answers have no rows"),
    ):
        caplog.clear()
        assert poses_of(tmp_path, text).tolist() == rows
        assert said in caplog.text and bool(said) == bool(caplog.records)


def test_many_rows_without_numbers_are_counted(tmp_path):
    rows = ["0.1,0.2,0.3"] * 30
    rows[3::3] = ["0.1,nan,"] * 9
    said = "line 5: 'nan' is not .*; lines 8, 11, 14, 17, 20 and 3 more lack a number"
    with pytest.raises(InvalidTarget, match=said):
        poses_of(tmp_path, "x,y,z\n" + "\n".join(rows))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "'poses.json' is empty; JSON has a list of positions"),
        ("[]", "targets has no rows; JSON has a list of positions"),
        ('{"xyz": []}', "xyz has no rows; JSON has"),
        ("{}", "no array 'targets' or 'xyz', and no other. JSON has"),
        ("[[1, 2, 3], [null, 2, 3], [1, 2, 3], [4]]", r"row 1 .* is \[null, 2, 3\], not 3 numbers; so is row 3"),
        ("[[1, 2, 3], [NaN, 2, 3]]", "row 1 of targets .* has numbers that are not finite"),
        ('{"xyz": [[1, 2, 3]], "quat_xyzw": [[0, 0, 0, 2]]}', "row 0 .*: the quaternion .* has length 2, not 1$"),
    ],
)
def test_rows_of_json_are_named(tmp_path, text, said):
    (tmp_path / "poses.json").write_text(text)
    with pytest.raises(InvalidTarget, match=said):
        read_poses(tmp_path / "poses.json", "targets")


def test_ros_messages_in_json_are_read(tmp_path):
    """As rosbridge logs them: a list of poses, a PoseArray, a nav_msgs/Path; in the frame asked for."""
    file = tmp_path / "poses.json"
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 3.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}}
    stamped = {"header": {"frame_id": "base"}, "pose": pose}
    T = np.diag([-1.0, -1.0, 1.0, 1.0])
    T[:3, 3] = 1, 2, 3
    for content in (
        [pose, stamped],
        {"targets": [stamped, T.tolist()]},
        {"header": {"frame_id": "base"}, "poses": [pose, pose]},
        {"header": {"frame_id": ""}, "poses": [stamped, stamped]},
    ):
        file.write_text(json.dumps(content))
        (block,) = read_poses(file, "targets", base="base")[1]
        assert np.allclose(block.poses, [T, T])
    file.write_text(json.dumps([pose["position"], pose["position"]]))
    assert read_poses(file, "targets")[1].__next__().poses.tolist() == [[1.0, 2.0, 3.0]] * 2
    for content, said in (
        ([pose, stamped], r"row 1 \(.*\): the target is given in the frame 'base', and the robot's base is 'arm'"),
        ({"header": {"frame_id": "map"}, "poses": [pose]}, "given in the frame 'map'"),
        ([pose, {"position": [1, 2, 3]}], r"row 1 \(counted from 0\): a pose that is a dict has the fields"),
        ([pose, pose["position"]], r"row 1 of targets \(counted from 0\) is \{"),
        ([pose, {**pose, "position": {"x": None, "y": 0, "z": 0}}], "row 1 of targets .* numbers that are not finite"),
    ):
        file.write_text(json.dumps(content))
        with pytest.raises(InvalidTarget, match=said):
            read_poses(file, "targets", base="arm")
    both = {"left": [pose, pose], "right": [pose["position"]] * 2}
    file.write_text(json.dumps(both))
    (block,) = read_poses(file, "targets", tips=("left", "right"))[1]
    assert block.poses["left"].shape == (2, 4, 4) and block.poses["right"].shape == (2, 3)


def test_arrays_of_several_tips_are_named(tmp_path):
    T = np.tile(np.eye(4), (3, 1, 1))
    np.savez(tmp_path / "a.npz", left=T, right=np.array([[0.0, 0, 0], [0, np.nan, 0], [0, 0, 0]]))
    said = r"'a\.npz': row 1 of right \(counted from 0\) has numbers that are not finite"
    with pytest.raises(InvalidTarget, match=said):
        read_poses(tmp_path / "a.npz", "targets", tips=("left", "right"))
    (tmp_path / "a.csv").write_text("")
    with pytest.raises(InvalidTarget, match=r"'a\.csv' is empty; .* such as left\.x,left\.y,left\.z,right\.x"):
        read_poses(tmp_path / "a.csv", "targets", tips=("left", "right"))


# --------------------------------------------------------------------------------------------------------------- formulas
NAMES = ["=1+1", "+a", "-a", "@sum", "\tx", "\rx", "'=1", "''+a", "'", "'a", "a=b", "", "q_=1", "-", "- 0.5"]
NUMBERS = ["-0.5", "+1", "-inf", "1e-3", "-1e300"]


@pytest.mark.parametrize(
    ("arrays", "tips"),
    [
        ({"xyz": np.zeros((2, 3)), "quat": np.zeros((2, 4))}, ()),
        ({"xyz": np.zeros((2, 3)), "rpy": np.zeros((2, 3))}, ()),
        ({"targets": np.zeros((2, 3)), "quat_xyzw": np.zeros((2, 4))}, ()),
        ({"a": np.zeros((2, 3)), "a.quat_xyzw": np.zeros((2, 4))}, ("a", "b")),
        ({"targets": np.zeros((2, 2, 3)), "rotations": np.zeros((2, 2, 3, 3))}, ("left", "right")),
    ],
)
def test_arrays_of_rotations_that_would_not_be_read_are_refused(arrays, tips, tmp_path):
    np.savez(tmp_path / "poses.npz", **arrays)
    (tmp_path / "poses.json").write_text(json.dumps({name: array.tolist() for name, array in arrays.items()}))
    for name in ("poses.npz", "poses.json"):
        with pytest.raises(InvalidTarget, match=f"{list(arrays)[1]}(\\.| would not be read)"):
            read_poses(tmp_path / name, "targets", tips=tips)


def test_the_rotations_that_would_not_be_read_are_named_in_the_order_of_the_file(tmp_path):
    names = [f"rot_{k}" for k in "hbfdgcea"]
    np.savez(tmp_path / "poses.npz", targets=np.zeros((2, 2, 3)), **dict.fromkeys(names, np.zeros(2)))
    with pytest.raises(InvalidTarget, match=f"'poses.npz': {', '.join(names)} would not be read"):
        read_poses(tmp_path / "poses.npz", "targets", tips=("left", "right"))


def test_errors_and_tolerances_of_orientation_beside_positions_are_no_rotations(tmp_path):
    beside = {"orientation_error": np.zeros(2), "Orientation_Tolerance": np.array(1e-6)}
    np.savez(tmp_path / "run.npz", t=[0.0, 1.0], xyz=np.eye(3)[:2], **beside)
    assert next(read_poses(tmp_path / "run.npz", "reference", times=True)[1]).poses.shape == (2, 3)


def test_whole_numbers_are_millimetres_as_well(tmp_path):
    np.savez(tmp_path / "poses.npz", targets=np.array([[1000, 100, 200]]))
    (read,) = read_poses(tmp_path / "poses.npz", "targets", given=Convention("mm"))[1]
    np.testing.assert_allclose(read.poses, [[1.0, 0.1, 0.2]], rtol=1e-15)
    np.savez(tmp_path / "tips.npz", a=np.array([[1000, 100, 200]]))
    (read,) = read_poses(tmp_path / "tips.npz", "targets", given=Convention("mm"), tips=("a", "b"))[1]
    np.testing.assert_allclose(read.poses["a"], [[1.0, 0.1, 0.2]], rtol=1e-15)


def test_names_run_nothing_and_are_read_back():
    for name in NAMES:
        assert inert(name)[:1] not in ("=", "+", "-", "@", "\t", "\r") and without_mark(inert(name)) == name, name
    assert [inert(number) for number in NUMBERS] == NUMBERS
    assert len({inert(name) for name in NAMES}) == len(NAMES)


def test_tables_keep_their_numbers(tmp_path):
    write_table(tmp_path / "a.csv", ["=cmd()", "b"], [["@x", -0.5], [-1.5, "-2"]])
    with (tmp_path / "a.csv").open(newline="") as stream:
        assert list(csv.reader(stream)) == [["'=cmd()", "b"], ["'@x", "-0.5"], ["-1.5", "-2"]]


def test_joints_whose_names_are_formulas(tmp_path, monkeypatch):
    """From a description through each of our files, and back."""
    text = robots.urdf(*({"kind": "revolute", "axis": "0 0 1", "xyz": "0.5 0 0"} for _ in range(3)))
    for k, name in enumerate(("=HYPERLINK()", "@j", "-j")):
        text = text.replace(f'name="j{k}"', f'name="{name}"')
    (tmp_path / "arm.urdf").write_text(text)
    (tmp_path / "in.csv").write_text("x,y,z\n1.2,0.3,0.0\n1.1,0.3,0.0\n")
    monkeypatch.chdir(tmp_path)
    robot = ik.Robot.load("arm.urdf")
    assert main(["solve", "arm.urdf", "--targets", "in.csv", "-o", "out.csv"]) == 0
    with open("out.csv", newline="") as stream:
        head = next(csv.reader(stream))
    assert head[:3] == ["'=HYPERLINK()", "'@j", "'-j"]
    ik.solve_path(robot, [robot.fk(q).translation for q in np.linspace((0.2,) * 3, (0.4,) * 3, 4)]).save("path.csv")
    t, Q = read_motion(robot, "path.csv")
    assert t is None and Q.shape == (4, 3)


def test_tips_whose_names_are_formulas(tmp_path):
    (tmp_path / "in.csv").write_text("'=tip.x,'=tip.y,'=tip.z\n1,2,3\n")
    (block,) = read_poses(tmp_path / "in.csv", "targets", tips=["=tip"])[1]
    assert block.poses["=tip"].tolist() == [[1.0, 2.0, 3.0]]


def test_a_motion_of_ragged_rows_is_refused(tmp_path):
    (tmp_path / "m.csv").write_text("joint_1,joint_2\n0,1,0,2\n0,1,0,3\n")
    with pytest.raises(ik.IKError, match=r"m\.csv'.*line 2: 4 columns, more than in the header"):
        read_motion(robots.load("planar_2r"), tmp_path / "m.csv")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("m.csv", "", "it is empty"),
        ("m.csv", "\n,,\n", "has only blank lines; its first line names the columns, such as t,q_JOINT,"),
        ("m.csv", "joint_1,joint_2\n\n", "has no rows of numbers below its header"),
        ("m.csv", "joint_1,joint_2\n0,1\n\n0,one\n", "line 4: 'one' is not a finite number"),
        ("m.csv", "joint_1,joint_2\n0,\n", "no row in which every joint has a value"),
        ("m.json", "[]", "no object with joint_names"),
        ("m.csv", "t,q_joint_1,q_joint_2\n0,0,0\n2,1,1\n1,2,2\n", "its times go back, first after row 2"),
    ],
)
def test_a_motion_that_cannot_be_read_says_why(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(InvalidConfiguration, match=rf"'{name}'.*{said}") as caught:
        read_motion(robots.load("planar_2r"), tmp_path / name)
    assert str(caught.value).count(name) == 1


def test_a_motion_from_a_spreadsheet_is_read_as_poses_are(tmp_path):
    (tmp_path / "m.csv").write_text("sep=;\nt;q_joint_1;q_joint_2\n0;0,5;1\n0,1;;2\n")
    t, Q = read_motion(robots.load("planar_2r"), tmp_path / "m.csv")
    assert t.tolist() == [0.0] and Q.tolist() == [[0.5, 1.0]]


def test_a_joint_may_be_named_like_the_column_of_times(tmp_path):
    text = robots.load("planar_2r").urdf.replace('"joint_2"', '"t"')
    (tmp_path / "m.csv").write_text("t,q_joint_1,q_t\n0,1,2\n0.1,3,4\n")
    t, Q = read_motion(ik.Robot.from_urdf(text), tmp_path / "m.csv")
    assert t.tolist() == [0.0, 0.1] and Q.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_rows_of_a_motion_that_lack_values_are_said(tmp_path, caplog):
    (tmp_path / "m.csv").write_text("joint_1,joint_2\n0,1\n\n0,\nnan,2\n0,3\n")
    assert read_motion(robots.load("planar_2r"), tmp_path / "m.csv")[1].tolist() == [[0.0, 1.0], [0.0, 3.0]]
    assert "'m.csv': 2 of 4 rows lack joint values and are left out" in caplog.text


@pytest.mark.parametrize(
    ("names", "points", "said"),
    [
        ("[]", "[]", "it has no rows"),
        ('"joint_1"', "[{}]", "joint_names are not a list of names"),
        ('["joint_1", "joint_2"]', '[{"positions": [0]}]', "one value for each of the 2 joint_names"),
        ('["joint_1", "joint_2"]', '[{"positions": [[0, 1], [2, 3]]}]', "one value for each of the 2 joint_names"),
        ('["joint_1"]', '[{"positions": [0], "time_from_start": {"sec": 0}}]', "it lacks 'nanosec'"),
        (
            '["joint_1"]',
            '[{"positions": [0], "time_from_start": {"sec": 1e999, "nanosec": 0}}]',
            "one finite time each",
        ),
    ],
)
def test_trajectories_whose_rows_do_not_fit_their_joints_are_refused(names, points, said, tmp_path):
    timed = points.replace("{}", '{"positions": [0]}').replace("]}", '], "time_from_start": {"sec": 0, "nanosec": 0}}')
    (tmp_path / "m.json").write_text(f'{{"joint_names": {names}, "points": {timed}}}')
    with pytest.raises(InvalidConfiguration, match=rf"'m\.json': .*{said}"):
        read_motion(robots.load("planar_2r"), tmp_path / "m.json")


def test_motions_with_more_rows_than_times_are_refused(tmp_path):
    np.savez(tmp_path / "m.npz", joint_names=["joint_1", "joint_2"], q=np.zeros((3, 2)), t=np.arange(2.0))
    with pytest.raises(InvalidConfiguration, match="one finite time each"):
        read_motion(robots.load("planar_2r"), tmp_path / "m.npz")


def test_a_huge_header_is_not_taken_into_memory(tmp_path):
    """numpy takes the whole header of an array before it looks at its size: 50 kB of file would be 100 MB of memory."""
    file = tmp_path / "header.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("xyz.npy", "w") as stream:
        stream.write(b"\x93NUMPY\x02\x00" + (50 * 2**20).to_bytes(4, "little"))
        for _ in range(50):
            stream.write(bytes(2**20))
    tracemalloc.start()
    with pytest.raises(InvalidTarget, match=r"header\.npz"):
        read_poses(file, "targets")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2**24


def test_large_and_deep_json_is_refused_before_it_takes_memory(tmp_path):
    robot, file = ik.Robot.load("planar_2r"), tmp_path / "large.json"
    file.write_bytes(b" " * 20_000_001)
    with pytest.raises(InvalidTarget, match=r"large\.json.* larger than 20 MB; save it as NPZ or CSV"):
        read_poses(file, "targets")
    with pytest.raises(InvalidConfiguration, match=r"large\.json.* larger than 20 MB"):
        read_motion(robot, file)
    file.write_text("[" * 100_000)
    with pytest.raises(InvalidTarget, match="nested too deep"):
        read_poses(file, "targets")


def test_a_name_given_twice_in_json_is_refused(tmp_path):
    file = tmp_path / "twice.json"
    file.write_text('{"targets": [[1, 0, 0]], "targets": [[0, 1, 0]]}')
    with pytest.raises(InvalidTarget, match=r"twice\.json.* it has 'targets' twice"):
        read_poses(file, "targets")


@pytest.mark.parametrize("top", ["sep=;\n", "SEP=;\r\n", '"sep=;"\n\n', "\ufeffsep=;\n"])
def test_the_line_in_which_excel_names_the_separator_is_skipped(tmp_path, top):
    assert poses_of(tmp_path, top + "x;y;z\n0,5;1;2\n").tolist() == [[0.5, 1.0, 2.0]]
    with pytest.raises(InvalidTarget, match=f"line {top.count(chr(10)) + 2}: the cell of z is empty"):
        poses_of(tmp_path, top + "x;y;z\n0,5;1;\n")
    with pytest.raises(InvalidTarget, match="names the columns"):
        poses_of(tmp_path, top)
