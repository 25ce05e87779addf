"""D-H tables: the written URDF read by Pinocchio equals the plain product of the rows; errors name row and column."""

import math

import numpy as np
import pinocchio as pin
import pytest
from folders import read_data
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_arms import drawn

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, ModelError
from ik_toolkit.robot.formats.dh import dh_fk, dh_table, read_dh_table, to_urdf
from ik_toolkit.robot.formats.urdf_check import check_urdf
from ik_toolkit.robot.library import shipped_robots

GOOD = {"name": "r", "convention": "classic", "angles": "deg", "lengths": "m"}
TABLED = [name for name, entry in shipped_robots().items() if entry.tip and entry.dh_file]


def largest_difference(table, text, count, rng):
    model = pin.buildModelFromXML(text, True)
    data, tip = model.createData(), model.getFrameId("tool")
    worst = 0.0
    for _ in range(count):
        low, high = (np.clip(x, -3.0, 3.0) for x in (model.lowerPositionLimit, model.upperPositionLimit))
        values, full = [], []
        for joint in model.joints[1:]:
            value = rng.uniform(low[joint.idx_q], high[joint.idx_q]) if joint.nq == 1 else rng.uniform(-9.0, 9.0)
            values.append(value)
            full += [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
        pin.framesForwardKinematics(model, data, np.array(full))
        worst = max(worst, np.abs(data.oMf[tip].homogeneous - dh_fk(table, values)).max())
    return worst


@pytest.mark.parametrize("name", TABLED)
def test_shipped_urdf_is_the_product_of_its_table(name):
    entry = shipped_robots()[name]
    table = read_dh_table(entry.dh_file)
    assert largest_difference(table, entry.path.read_text(), 200, np.random.default_rng(1)) < 1e-12


def test_hydrolek_poses():
    table = read_dh_table(shipped_robots()["hydrolek_7w"].dh_file)
    poses = read_data("hydrolek_poses")["poses"]
    assert len(poses) == 30
    for pose in poses:
        assert np.abs(dh_fk(table, pose["q"]) - pose["T"]).max() < 1e-12


def test_inspection_sample():
    """The pose of the paper's sample calculation, with the true pi."""
    table = read_dh_table(shipped_robots()["inspection_7dof"].dh_file)
    q = [math.radians(20), 0.22, math.radians(20), 0, math.radians(20), 0, math.radians(20)]
    assert dh_fk(table, q)[:3, 3] == pytest.approx([0.4615787, 0.0870954, 0.9350900], abs=5e-8)


def test_planar_and_cartesian_formulas():
    q = [0.3, -0.7]
    xyz = dh_fk(read_dh_table(shipped_robots()["planar_2r"].dh_file), q)[:3, 3]
    assert xyz == pytest.approx([math.cos(0.3) + math.cos(-0.4), math.sin(0.3) + math.sin(-0.4), 0.0])
    T = dh_fk(read_dh_table(shipped_robots()["cartesian_pp"].dh_file), q)
    assert pytest.approx(np.block([[np.eye(3), np.array([[0.8], [-0.2], [0.0]])], [0, 0, 0, 1]])) == T


angles = st.sampled_from([0.0, 90.0, -90.0, 180.0]) | st.floats(-180, 180)
lengths = st.just(0.0) | st.floats(-2, 2)
triples = st.lists(st.floats(-3, 3), min_size=3, max_size=3)


@st.composite
def tables(draw):
    joints = []
    for _ in range(draw(st.integers(1, 7))):
        row = {"theta": draw(angles), "d": draw(lengths), "a": draw(lengths), "alpha": draw(angles)}
        row["type"] = draw(st.sampled_from(["revolute", "prismatic", "continuous"]))
        if row["type"] != "continuous":
            row |= {"lower": draw(st.floats(-2, 0)), "upper": draw(st.floats(0, 2))}
        joints.append(row)
    frames = {key: {"xyz": draw(triples), "rpy": [60 * x for x in draw(triples)]} for key in ("base", "tool")}
    return {**GOOD, "convention": draw(st.sampled_from(["classic", "modified"])), "joint": joints, **frames}


@settings(max_examples=30, deadline=None, derandomize=True)
@given(tables())
def test_any_table_becomes_a_valid_urdf_of_the_same_kinematics(raw):
    table = dh_table(raw)
    text = to_urdf(table)
    assert check_urdf(text) == [] or all("cannot move" in f.problem for f in check_urdf(text))
    assert largest_difference(table, text, 3, np.random.default_rng(0)) < 1e-12


def test_classic_and_modified_differ():
    rows = [{"a": 1.0, "alpha": 30, "d": 0.2, "lower": -1, "upper": 1}] * 2
    rows = [{**row, "name": f"j{i}"} for i, row in enumerate(rows)]
    both = [dh_table({**GOOD, "convention": c, "joint": rows}) for c in ("classic", "modified")]
    assert np.abs(dh_fk(both[0], [0.3, 0.4]) - dh_fk(both[1], [0.3, 0.4])).max() > 0.1


CSV = """# convention = modified
# angles = rad
# lengths = mm
# base_xyz = 0 0 100
name,type,theta,d,a,alpha,lower,upper,velocity
swing,,0,50,,0,-1.5,1.5,2
slide,prismatic,,,250,1.5707963267948966,-300,400,
spin,continuous,0.1,,,,,,
"""


def test_csv(tmp_path):
    file = tmp_path / "arm.csv"
    file.write_text(CSV)
    table = read_dh_table(file)
    assert [row.type for row in table.rows] == ["revolute", "prismatic", "continuous"]
    assert (table.name, table.rows[1].lower, table.rows[1].a, table.base[2, 3]) == ("arm", -0.3, 0.25, 0.1)
    assert largest_difference(table, to_urdf(table), 20, np.random.default_rng(2)) < 1e-12


def test_limits_are_always_written():
    text = to_urdf(read_dh_table(shipped_robots()["inspection_7dof"].dh_file))
    assert text.count("<limit ") == text.count("effort=") == text.count("velocity=") == 7


ROW = {"name": "j1", "a": 1.0, "lower": -10, "upper": 10}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint": [ROW, {**ROW, "name": "j2", "alpha": "ninety"}]}, "row 2, column 'alpha'"),
        ({"joint": [{**ROW, "d": math.nan}]}, "row 1, column 'd'"),
        ({"joint": [{**ROW, "d": True}]}, "row 1, column 'd'"),
        ({"joint": [{**ROW, "alhpa": 1}]}, "unknown column 'alhpa'. Did you mean 'alpha'?"),
        ({"joint": [{"name": "j1", "lower": 1}]}, "row 1, column 'upper' of the D-H table is missing"),
        ({"joint": [{**ROW, "lower": 20}]}, "row 1, column 'lower' of the D-H table is above 'upper' (20 > 10)"),
        ({"joint": [{**ROW, "type": "turning"}]}, "row 1, column 'type'"),
        ({"joint": [{**ROW, "velocity": 0}]}, "row 1, column 'velocity'"),
        ({"joint": [{**ROW, "type": "continuous"}]}, "row 1 of the D-H table is continuous"),
        ({"joint": [ROW, ROW]}, "row 2, column 'name'"),
        ({"joint": [{**ROW, "name": ""}]}, "row 1, column 'name'"),
        ({"joint": [{**ROW, "name": "tool_fixed"}]}, "row 1, column 'name'"),
        ({"joint": [ROW], "name": "a\nb"}, "setting 'name' must be printable text"),
        ({"joint": [7]}, "row 1 of the D-H table must be a table"),
        ({"joint": []}, "has no joint"),
        ({"joint": [ROW], "angles": "grad"}, "setting 'angles' is 'grad'"),
        ({"joint": [ROW], "convention": None}, "setting 'convention' is missing"),
        ({"joint": [ROW], "colour": "red"}, "unknown setting 'colour'"),
        ({"joint": [ROW], "tool": {"xyz": [1, 2]}}, "setting 'tool.xyz' must be three numbers"),
        ({"joint": [ROW], "base": {"rpy": [1, 2, "x"]}}, "setting 'base', column 'rpy'"),
        ({"joint": [{**ROW, "name": f"j{i}"} for i in range(1001)]}, "at most 1000"),
    ],
)
def test_errors_name_row_and_column(change, message):
    with pytest.raises(ModelError) as caught:
        dh_table({**GOOD, **change})
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("t.toml", b"name = [", "not valid TOML"),
        ("t.toml", b"\xff\xfe", "not UTF-8"),
        (
            "t.csv",
            b"# convention = classic\n# angles = deg\n# lengths = m\nname,a\nj1,1,2\n",
            "row 1 of the D-H table has 3 cells",
        ),
        ("t.csv", b"", "setting 'convention' is missing (in a CSV file, a line '# convention = ...')"),
        ("t.csv", b"name,a,a,lower,upper\nj,1,2,-1,1\n", "the column a more than once"),
        ("t.txt", b"", ".toml or .csv"),
        ("t.toml", b"d = " + b"9" * 10_000, "not valid TOML"),
        ("t.toml", b"#" * 1_000_001, "larger than 1 MB"),
    ],
)
def test_unreadable_files(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ModelError) as caught:
        read_dh_table(tmp_path / name)
    assert message in str(caught.value)


def test_missing_file_and_wrong_size_of_q():
    with pytest.raises(ModelError, match="cannot read"):
        read_dh_table("nowhere.toml")
    with pytest.raises(InvalidConfiguration, match="2 joints; q has 3"):
        dh_fk(read_dh_table(shipped_robots()["planar_2r"].dh_file), [0, 0, 0])
    with pytest.raises(ModelError, match="cannot read"):
        read_dh_table("a\0b.toml")


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=3), st.lists(st.integers(), max_size=3)
)
KEYS = st.sampled_from(["name", "type", "theta", "d", "a", "alpha", "lower", "upper", "velocity", "effort", "x"])


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.dictionaries(KEYS, VALUES, max_size=6), st.sampled_from(["joint", "base", "tool", "name", "angles"]), VALUES)
def test_any_row_is_refused_or_written(row, setting, value):
    for raw in ({**GOOD, "joint": [{**ROW, **row}]}, {**GOOD, "joint": [ROW], setting: value}):
        try:
            table = dh_table(raw)
        except ModelError:
            continue
        assert not [f for f in check_urdf(to_urdf(table)) if f.severity == "error"]


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.text(max_size=80))
def test_any_csv_is_refused_or_read(tmp_path_factory, text):
    file = tmp_path_factory.getbasetemp() / "fuzz.csv"
    file.write_text(CSV + text, encoding="utf-8", errors="replace", newline="")
    try:
        to_urdf(read_dh_table(file))
    except ModelError:
        pass


def test_a_table_given_as_a_robot_says_how_to_make_one(tmp_path):
    (tmp_path / "arm.toml").write_text('name = "arm"')
    with pytest.raises(ModelError, match=r"'arm.toml' is a D-H table; .*dh arm.toml -o OUT.urdf. makes a URDF of it"):
        ik.Robot.load(tmp_path / "arm.toml")


def nearly_parallel(pitch, y, last):
    """An arm whose second axis differs from the first by a rounded half turn about y; its third joint is at y, turned by `last`."""
    places = ((0, 0, 0), (0, 0, 0)), ((-0.2, 0, 0), (0, pitch, 0)), ((0, y, 0), (0, last, 0))
    return drawn([("revolute", *place, (0, 0, 1), -2.0, 2.0) for place in places], (0.2, 0.0, 0.1), (0.3, 0.2, 0.1))


@pytest.mark.parametrize("pitch", [3.14159, 3.141593, 3.1416])
def test_axes_rounded_to_parallel_have_a_table(pitch):
    """The common normal is kilometres away, so the rows are long, and the least error of a frame would be multiplied."""
    arm = nearly_parallel(pitch, 0.3, 0.0)
    table = ik.solve(arm, arm.fk(arm.home).translation).explain().tables["tip"]
    assert (
        max(np.abs(dh_fk(table, q) - arm.fk(q).homogeneous).max() for q in arm.random_q(np.random.default_rng(0), 5))
        < 1e-9
    )


def test_where_there_is_no_table_the_reason_is_true():
    arm = nearly_parallel(3.1415959717, 0.0, 3.1415926823)
    made = ik.solve(arm, arm.fk(arm.home).translation).explain()
    assert made.tables == {"tip": None}
    assert "None: axes that are parallel but for rounding" in str(made) and "drives others" not in str(made)
