"""A corpus of broken and hostile URDF files: each is refused in one sentence, or loads as it should."""

import json
import math
import os
from pathlib import Path

import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ik_toolkit.errors import ModelError
from ik_toolkit.robot.check import check_urdf, mimic_limits, require_loadable, safe_read
from ik_toolkit.robot.library import shipped_robots

CORPUS = Path(__file__).parent / "data" / "bad_urdf"
EXPECTED = json.loads((CORPUS / "expected.json").read_text())
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def chain(count, joint="revolute"):
    links = "".join(f'<link name="l{i}"/>' for i in range(count + 1))
    joints = "".join(
        f'<joint name="j{i}" type="{joint}"><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
        for i in range(count)
    )
    return f'<robot name="chain">{links}{joints}</robot>'


def load(source):
    text = safe_read(source)
    require_loadable(text)
    return text


def refusal(source):
    with pytest.raises(ModelError) as caught:
        load(source)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 400
    return message


def test_corpus_is_complete():
    files = {path.name for path in CORPUS.glob("*.urdf")}
    assert files == EXPECTED["refused"].keys() | EXPECTED["loaded"].keys()
    assert len(files) >= 40


@pytest.mark.parametrize("name", EXPECTED["refused"])
def test_refused(name):
    assert EXPECTED["refused"][name] in refusal(CORPUS / name)
    assert check_urdf(CORPUS / name)[0].severity == "error"


@pytest.mark.parametrize("name", EXPECTED["loaded"])
def test_loaded(name):
    """Pinocchio reads what we let through, and `check_urdf` has exactly the remark expected."""
    model = pin.buildModelFromXML(load(CORPUS / name), True)
    assert model.njoints > 1
    findings = check_urdf(CORPUS / name)
    assert not [f for f in findings if f.severity == "error"]
    expected = EXPECTED["loaded"][name]
    assert [expected in str(f) for f in findings] == ([True] if expected else [])


def test_mesh_found_beside_the_file_or_in_a_package(tmp_path):
    (tmp_path / "arm" / "meshes").mkdir(parents=True)
    (tmp_path / "arm" / "meshes" / "a.stl").write_text("solid")
    text = '<robot name="r"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link></robot>'
    (tmp_path / "arm" / "r.urdf").write_text(text.format("meshes/a.stl"))
    assert check_urdf(tmp_path / "arm" / "r.urdf") == []
    packaged = text.format("package://arm/meshes/a.stl")
    assert check_urdf(packaged, [tmp_path]) == check_urdf(packaged, [tmp_path / "arm"]) == []
    assert "not there" in str(check_urdf(packaged, [CORPUS])[0])
    (tmp_path / "out").mkdir()
    os.symlink(tmp_path / "arm" / "meshes" / "a.stl", tmp_path / "out" / "a.stl")
    assert "link out of the named folders" in str(check_urdf(text.format("a.stl"), [tmp_path / "out"])[0])


def test_all_errors_are_listed():
    text = chain(3).replace('parent link="l1"', 'parent link="x"').replace('xyz="0 0 1"', 'xyz="0 0 0"')
    problems = [str(f) for f in check_urdf(text)]
    assert len(problems) == 4
    assert problems[0] == "joint 'j0': its axis is zero, so it has no direction to move in"
    assert "and 3 more" in refusal(text)


def test_long_chains():
    assert "more than 1,000 joints" in refusal(chain(1001))
    assert pin.buildModelFromXML(load(chain(1000)), True).njoints == 1001


def test_million_joint_chain_stops_early():
    assert "more than 1,000 joints" in refusal('<robot name="r">' + '<joint name="j"/>' * 1_000_000 + "</robot>")


def test_too_large_too_deep_too_many(tmp_path):
    file = tmp_path / "big.urdf"
    file.write_bytes(b" " * 20_000_001)
    assert "larger than 20 MB" in refusal(file)
    assert "larger than 20 MB" in refusal("<robot name='r'>" + " " * 20_000_001)
    assert "nested more than 64 deep" in refusal("<robot name='r'>" + "<a>" * 100_000)
    assert "more than 200,000 elements" in refusal("<robot name='r'>" + "<a/>" * 300_000)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("nowhere.urdf", "there is no file 'nowhere.urdf'"),
        ("", "not a regular file"),
        (CORPUS, "not a regular file"),
        ("/dev/zero", "not a regular file"),
        ("a\0b", "there is no file 'a\\x00b'"),
        ("x" * 5000, "cannot read"),
        ("<robot name='\ud800'/>", "lone surrogates"),
    ],
)
def test_sources_that_are_no_file(source, message):
    assert message in refusal(source)


def test_text_and_file_give_the_same():
    path = shipped_robots()["hydrolek_7w"].path
    text = path.read_text()
    assert safe_read(path) == safe_read(str(path)) == safe_read(text) == safe_read("\ufeff \n" + text)


def test_mimic_limits():
    text = chain(4)
    text = text.replace('name="j1" type="revolute">', 'name="j1" type="revolute"><mimic joint="j0"/>')
    text = text.replace(
        'name="j2" type="revolute">', 'name="j2" type="continuous"><mimic joint="j0" multiplier="-2" offset=".5"/>'
    )
    assert mimic_limits(load(text)) == {
        "j1": ("j0", 1.0, 0.0, -1.0, 1.0),
        "j2": ("j0", -2.0, 0.5, -math.inf, math.inf),
    }


@pytest.mark.parametrize("name", list(shipped_robots()))
def test_shipped_robots_have_no_findings(name):
    assert check_urdf(shipped_robots()[name].path) == []


SEED = (CORPUS / "ok_mimic_negative.urdf").read_text()
PIECES = [
    "<",
    ">",
    '"',
    "/>",
    "<link/>",
    "nan",
    "-",
    "1e999",
    "&amp;",
    "&x;",
    "<!--",
    "]]>",
    "\0",
    "joint",
    "\ud800",
    "",
]


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(st.integers(0, len(SEED)), st.integers(0, 12), st.sampled_from(PIECES)), min_size=1, max_size=3)
)
def test_any_damage_is_refused_or_read(damages):
    """Cut and insert anywhere: a ModelError, or a text whose numbers can be read."""
    text = SEED
    for at, cut, piece in damages:
        text = text[:at] + piece + text[at + cut :]
    try:
        load(text if text.lstrip().startswith("<") else f"<{text}")
    except ModelError:
        return
    mimic_limits(text)
    assert not [f for f in check_urdf(text) if f.severity == "error"]


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.binary(max_size=300))
def test_any_bytes_are_refused(tmp_path_factory, raw):
    file = tmp_path_factory.getbasetemp() / "fuzz.urdf"
    file.write_bytes(raw)
    with pytest.raises(ModelError):
        load(file)


def test_what_only_pinocchio_refuses_is_reported():
    """A follower above its leader is legal URDF, but Pinocchio wants the leader first."""
    text = chain(2).replace('name="j0" type="revolute">', 'name="j0" type="revolute"><mimic joint="j1"/>')
    assert [f.severity for f in check_urdf(load(text))] == ["error"]
    assert "Pinocchio refuses it" in str(check_urdf(text)[0])
