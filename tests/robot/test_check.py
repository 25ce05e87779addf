"""A corpus of broken and hostile URDF files: each is rejected in one sentence, or loads correctly."""

import json
import os
import sys

import pinocchio as pin
import pytest
from folders import DATA
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import joint, tie

from ik_toolkit.errors import ModelError, near_match
from ik_toolkit.robot.formats.mimic import mimic_limits
from ik_toolkit.robot.formats.urdf import parse
from ik_toolkit.robot.formats.urdf_check import check_urdf, require_loadable, safe_read
from ik_toolkit.robot.formats.urdf_model import build_model
from ik_toolkit.robot.library import shipped_robots

CORPUS = DATA / "bad_urdf"
EXPECTED = json.loads((CORPUS / "expected.json").read_text())
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def chain(count, joint="revolute"):
    links = "".join(f'<link name="l{i}"/>' for i in range(count + 1))
    joints = "".join(
        f'<joint name="j{i}" type="{joint}"><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="0 0 1"/>{LIMIT}</joint>'
        for i in range(count)
    )
    return f'<robot name="chain">{links}{joints}</robot>'


def robot(inside):
    return f'<robot name="r">{inside}</robot>'


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
    """Pinocchio reads what we let through, and `check_urdf` has the remarks expected and no other."""
    model = build_model(load(CORPUS / name))
    assert model.njoints > 1
    findings = check_urdf(CORPUS / name)
    assert not [f for f in findings if f.severity == "error"]
    expected = EXPECTED["loaded"][name]
    assert bool(findings) == bool(expected) and all(expected in str(f) for f in findings)


def test_mesh_found_beside_the_file_or_in_a_package(tmp_path):
    (tmp_path / "arm" / "meshes").mkdir(parents=True)
    (tmp_path / "arm" / "meshes" / "a.stl").write_text("solid")  # not opened
    text = '<robot name="r"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link></robot>'
    (tmp_path / "arm" / "r.urdf").write_text(text.format("meshes/a.stl"))
    assert check_urdf(tmp_path / "arm" / "r.urdf") == []
    packaged = text.format("package://arm/meshes/a.stl")
    assert check_urdf(packaged, [tmp_path]) == check_urdf(packaged, [tmp_path / "arm"]) == []
    assert "not there" in str(check_urdf(packaged, [CORPUS])[0])
    (tmp_path / "out").mkdir()
    os.symlink(tmp_path / "arm" / "meshes" / "a.stl", tmp_path / "out" / "a.stl")
    assert "leads outside the allowed folders" in str(check_urdf(text.format("a.stl"), [tmp_path / "out"])[0])


def test_all_errors_are_listed():
    text = chain(3).replace('parent link="l1"', 'parent link="x"').replace('xyz="0 0 1"', 'xyz="0 0 0"')
    problems = [str(f) for f in check_urdf(text)]
    assert len(problems) == 4
    assert problems[0] == "joint 'j0': its axis is zero, so it has no direction to move in"
    assert "and 3 more" in refusal(text)


def test_what_a_planar_joint_does():
    """It is held still; its plane is that of its axis (test_read.py), which is x where none is given."""
    text = chain(2, "planar").replace(LIMIT, "")
    first = [str(f) for f in check_urdf(text) if str(f).startswith("joint 'j0'")]
    assert len(first) == 1 and "is held still, and poses are given in the link it carries" in first[0]
    text = text.replace('<axis xyz="0 0 1"/>', "", 1)
    assert "its plane is that of y and z" in [str(f) for f in check_urdf(text) if str(f).startswith("joint 'j0'")][1]


def test_limits_that_a_controller_keeps_and_we_do_not_are_said():
    soft = '<safety_controller soft_lower_limit="{}" soft_upper_limit="{}" k_velocity="1"/>'
    for low, high, said in (("-0.5", "1", True), ("-1", "0.9", True), ("-1", "1", False), ("-2", "2", False)):
        text = chain(1).replace(LIMIT, LIMIT + soft.format(low, high))
        narrower = f"soft limits {low} to {high} are narrower than -1 to 1"
        assert [narrower in note for note in require_loadable(text)] == [True] * said
    assert require_loadable(chain(1).replace(LIMIT, LIMIT + '<safety_controller k_velocity="1"/>')) == ()


@pytest.mark.parametrize(("low", "either"), [(2, True), (1.5, True), (1, False)])
def test_advice_on_reversed_limits_names_each_range_once(low, either):
    text = chain(1, "prismatic").replace('lower="-1"', f'lower="{low}"').replace('upper="1"', 'upper="-1"')
    assert [("or change their signs" in f.advice) for f in check_urdf(text)] == [either]


def test_long_chains():
    assert "more than 1,000 joints" in refusal(chain(1001, "fixed"))
    assert pin.buildModelFromXML(load(chain(1000, "fixed")), True).nframes == 2002
    followers = chain(1000).replace("</joint>", '<mimic joint="j0"/></joint>').replace('<mimic joint="j0"/>', "", 1)
    assert pin.buildModelFromXML(load(followers), True).nv == 1
    assert pin.buildModelFromXML(load(chain(128)), True).nv == 128
    assert "129 degrees of freedom; at most 128" in refusal(chain(129))
    floating = chain(22, "floating")  # 22 of six each
    assert "132 degrees of freedom" in refusal(floating.replace("</joint>", '<mimic joint="j0"/></joint>'))
    assert "132 degrees of freedom" in refusal(floating) and "132 degrees" in str(check_urdf(floating)[0])


def test_million_joint_chain_stops_early():
    assert "more than 1,000 joints" in refusal('<robot name="r">' + '<joint name="j"/>' * 1_000_000 + "</robot>")


def test_too_large_too_deep_too_many(tmp_path):
    file = tmp_path / "big.urdf"
    file.write_bytes(b" " * 20_000_001)
    assert "larger than 20 MB" in refusal(file)
    assert "larger than 20 MB" in refusal("<robot name='r'>" + " " * 20_000_001)
    assert "nested more than 64 deep" in refusal("<robot name='r'>" + "<a>" * 100_000)
    assert "more than 200,000 elements" in refusal("<robot name='r'>" + "<a/>" * 300_000)


def test_names_attributes_and_tags_are_capped():
    long = "ab" * 16_000
    two = f'<link name="{long}x"/>' + joint("j", "fixed", f"{long}y", "b")
    assert "the URDF has a name of more than 255 characters in line 1" in refusal(robot(two))
    many = " ".join(f'a{i}="1"' for i in range(100_000))
    for text in (f'<robot name="r" {many}/>', robot(f"<link {many}/>"), robot(f"<a {many}/>")):
        assert refusal(text).startswith("the URDF has an element with 100,00")
    for opened in ("<!--", "<a b='", "<a ", "<?x "):
        assert "a tag or comment of more than 1 MB" in refusal(f'<robot name="r">{opened}{"x" * 5_000_000}')
    declared = '<?xml version="1.0" encoding="iso-8859-1"?>' + robot('<link name="\u00e9"/>')
    assert parse(declared)[1].name == "\u00e9"


def counted(text):
    """Calls of Python functions and lines run while a URDF is checked: work that does not depend on the machine."""
    steps = 0

    def step(frame, event, argument):
        nonlocal steps
        steps += 1
        return step

    sys.settrace(step)
    try:
        check_urdf(text)
    finally:
        sys.settrace(None)
    return steps


def joints(count, row, kind="fixed"):
    return "".join(f'<joint name="j{i}" type="{kind}">{row.format(i, i + 1)}{LIMIT}</joint>' for i in range(count))


def links(count):
    return "".join(f'<link name="l{i}"/>' for i in range(count))


ENDS = '<parent link="l{0}"/><child link="l{1}"/>'
GROWING = {
    "links": links,
    "roots": lambda n: links(n) + joints(n // 2, ENDS.replace("{0}", "{1}")),
    "unknown parents": lambda n: links(n) + joints(n // 4, ENDS.replace("l{0}", "m{0}")),
    "unknown leaders": lambda n: links(n) + joints(n // 4, ENDS + '<mimic joint="k{0}"/>'),
    "leaders of leaders": lambda n: links(n // 4 + 1) + joints(n // 4, ENDS + '<mimic joint="j{1}"/>'),
    "one parent": lambda n: links(n) + joints(n // 4, '<parent link="l0"/><child link="l{1}"/>'),
    "one child": lambda n: links(n) + joints(n // 4, '<parent link="l{1}"/><child link="l0"/>'),
    "loop": lambda n: links(n // 4) + joints(n // 4, ENDS).replace(f'"l{n // 4}"', '"l0"'),
    "same names": lambda n: '<link name="l"/>' * n,
    "materials": lambda n: links(1) + "".join(f'<material name="{i}"/>' for i in range(n)),
    "shapes": lambda n: f'<link name="l0">{SPHERE * n}</link>',
    "meshes": lambda n: f'<link name="l0">{MESH * n}</link>',
    "numbers": lambda n: f'<link name="l0"><inertial><origin xyz="{"0 " * n}"/></inertial></link>',
    "unknown elements": lambda n: links(2) + joints(1, ENDS + "".join(f"<orgin{i} x{i}='1'/>" for i in range(n))),
    "unknown items": lambda n: links(2) + "".join(f"<Joint{i}/>" for i in range(n)),
    "several mimics": lambda n: links(2) + joints(1, ENDS + '<mimic joint="j0"/>' * n),
}
SPHERE = '<visual><geometry><sphere radius="0"/></geometry></visual>'
MESH = '<visual><geometry><mesh filename="../a.stl"/></geometry></visual>'


@pytest.mark.parametrize("kind", GROWING)
def test_work_grows_with_the_size_of_the_file(kind):
    """A file four times as long takes at most about five times the work (beyond the fixed cost of a file)."""
    few, many = (counted(robot(GROWING[kind](n))) for n in (200, 800))
    assert many < 5.0 * few, (few, many)


def test_a_long_misspelled_name_is_compared_in_part():
    """difflib takes time in the product of the lengths, and for every name there is."""
    assert near_match("ab" * 16_000, ["ba" * 16_000]).startswith(" Did you mean 'baba")
    options = [f"{'ab' * 16_000}{i}" for i in range(5_000)]
    assert len(near_match("b" + "ab" * 16_000, options)) < 5_000
    assert "Did you mean 'wrist'" in near_match("wirst", ["wrist", *options])


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


@pytest.mark.parametrize("name", list(shipped_robots()))
def test_shipped_robots_have_no_findings(name):
    assert check_urdf(shipped_robots()[name].path) == []


SEED = (CORPUS / "ok_mimic_negative.urdf").read_text()
PIECES = [*'< > " /> <link/> nan - 1e999 &amp; &x; <!-- ]]> joint'.split(), "\0", "\ud800", ""]


def test_links_in_a_circle_with_a_mimic_joint_are_refused():
    """Following such a circle to its root once took all memory."""
    ring = joint("one", "continuous", "a", "b") + joint("two", "continuous", "b", "a", mimic=tie("three"))
    with pytest.raises(ModelError):
        require_loadable(robot(ring + joint("three", "continuous", "b", "c")))


@settings(max_examples=100, deadline=None, derandomize=True)
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


def test_what_only_pinocchio_refuses_is_reported(monkeypatch):
    """A file that passes our own checks gets Pinocchio's message."""
    monkeypatch.setattr(pin, "buildModelFromXML", lambda *_: exec("raise ValueError('first\\nlast')"))
    assert [str(f) for f in check_urdf(chain(2))] == ["robot: Pinocchio rejects it: last"]


def test_an_inertia_that_is_none_is_left_out():
    text = chain(2).replace('<link name="l1"/>', '<link name="l1"><inertial><mass value="-"/></inertial></link>')
    assert [str(f) for f in check_urdf(text)] == ["link 'l1': <mass value=\"-\"> is not a number"]
    assert build_model(load(text)).inertias[1].mass == 0.0
