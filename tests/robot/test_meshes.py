"""Untrusted meshes: allowed locations and references, and files that crash their reader."""

import json
import os
import struct

import numpy as np
import pytest
from robots import ball, filled, urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, ModelError
from ik_toolkit.robot.formats.urdf_check import check_urdf
from ik_toolkit.robot.geometry import link_shapes as shapes
from ik_toolkit.robot.geometry import meshes
from ik_toolkit.robot.geometry.link_shapes import link_shapes
from ik_toolkit.show.body import Body

SOLID = "solid a\nfacet normal 0 0 1\nouter loop\nvertex {} 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n"
STL = SOLID.format(0)
OBJ = "mtllib {}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"
RED = "newmtl red\nKd 1 0 0\n"
DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>
<accessor source="#pa" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
</library_geometries>
<library_nodes>{nodes}</library_nodes>
<library_visual_scenes><visual_scene id="s">{scene}</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
FACE = '<instance_geometry url="#g"/>'


def gltf(uri, children=()):
    """A triangle whose corners lie in a buffer of their own."""
    return json.dumps({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "children": list(children)}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"uri": uri, "byteLength": 36}], "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
    })  # fmt: skip


def robot(name, folder, package_dirs=(), role="both"):
    """A robot in `folder` whose second link is a mesh, as a visual and a collision shape."""
    shape = f'<geometry><mesh filename="{name}"/></geometry>'
    tags = ("visual", "collision") if role == "both" else (role,)
    text = urdf({"kind": "revolute"}, {"kind": "revolute", "axis": "0 1 0"})
    file = folder / "r.urdf"
    file.write_text(filled(text, {"l1": "".join(f"<{tag}>{shape}</{tag}>" for tag in tags)}))
    return ik.Robot.load(file, package_dirs=package_dirs)


def refusals(name, folder, package_dirs=()):
    """What the check, a picture and a collision model say of a mesh; '' where it is read."""
    arm = robot(name, folder, package_dirs)
    found = [str(finding) for finding in check_urdf(folder / "r.urdf", package_dirs)]
    checked = next((said for said in found if "mesh" in said), "")
    try:
        ik.CollisionModel(arm)
        tested = ""
    except ModelError as error:
        tested = str(error)
    return checked, Body(arm).notice, tested


@pytest.fixture
def place(tmp_path):
    """A robot's folder with a good mesh, and a neighbouring folder that must not be read."""
    for name in ("robot", "secret"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.stl").write_text(STL)
        (tmp_path / name / "a.mtl").write_text(RED)
        (tmp_path / name / "a.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    return tmp_path


def test_one_rule_for_check_pictures_and_collisions(place):
    folder = place / "robot"
    os.symlink(place / "secret" / "a.stl", folder / "out.stl")
    os.symlink(folder / "a.stl", folder / "in.stl")
    os.symlink(folder / "loop.stl", folder / "loop.stl")
    os.symlink(place / "secret", folder / "way")
    os.mkfifo(folder / "pipe.stl")
    (folder / "my a.stl").write_text(STL)
    files = ["a.stl", "./a.stl", f"{folder}/a.stl", "package://robot/a.stl", "in.stl", "my a.stl", "my%20a.stl"]
    for name in [*files, f"file://{folder}/a.stl", f"file:{folder}/a.stl", f"file://{folder}/my%20a.stl"]:
        assert refusals(name, folder) == ("", "", ""), name
    outside = [
        "../secret/a.stl",
        f"file:{place}/secret/a.stl",
        f"{place}/secret/a.stl",
        f"file://{place}/secret/a.stl",
        "package://../secret/a.stl",
    ]
    for name in [*outside, "package://robot/../../secret/a.stl", "out.stl", "way/a.stl"]:
        link = name in ("out.stl", "way/a.stl")
        said = "is a link that leads outside the allowed folders" if link else "outside the allowed folders"
        assert all(said in sentence for sentence in refusals(name, folder)), name
    for name in (*outside, "out.stl"):
        assert refusals(name, folder, [place / "secret"]) == ("", "", ""), name  # named, so allowed
    others = {
        "loop.stl": "is not there",
        "pipe.stl": "is not there",
        "%2e%2e/secret/a.stl": "is not there",
        "r.urdf": "is not a supported format",
        "http://x/a.stl": "network",
    }
    for name, said in others.items():
        assert all(said in sentence for sentence in refusals(name, folder)), name


def test_the_ros_package_of_a_urdf_is_its_own(place):
    (place / "robot" / "urdf").mkdir()
    assert "outside the allowed folders" in refusals("../a.stl", place / "robot" / "urdf")[0]
    (place / "robot" / "package.xml").write_text("<package/>")
    for name in ("../a.stl", "package://robot/a.stl"):
        assert refusals(name, place / "robot" / "urdf") == ("", "", ""), name
    assert "outside" in refusals("../../secret/a.stl", place / "robot" / "urdf")[0]


def crowd(folder, names):
    """A robot whose second link has a mesh of each name beside the good one, visual and collision."""
    arm = robot("a.stl", folder)
    shape = '<{0}><geometry><mesh filename="{1}"/></geometry></{0}>'
    more = "".join(shape.format(role, name) for name in names for role in ("visual", "collision"))
    vars(arm)["urdf"] = arm.urdf.replace("<visual>", f"{more}<visual>", 1)
    return arm


def test_files_that_a_mesh_refers_to_stay_inside(place):
    folder = place / "robot"
    colors = {
        "0.obj": "a.mtl", "1.obj": "../secret/a.mtl", "2.obj": f"{place}/secret/a.mtl", "3.obj": "http://127.0.0.1:9/a.mtl",
    }  # fmt: skip
    buffers = {
        "0.gltf": "a.bin", "1.gltf": "../secret/a.bin", "2.gltf": f"{place}/secret/a.bin", "3.gltf": "%2e%2e/secret/a.bin",
    }  # fmt: skip
    for name, other in (colors | buffers).items():
        (folder / name).write_text(OBJ.format(other) if name in colors else gltf(other))
    tree = gltf("../secret/a.bin").encode()
    tree += b" " * (-len(tree) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(tree), len(tree), b"JSON")
    (folder / "a.glb").write_bytes(head + tree)
    arm = crowd(folder, [*colors, *buffers, "a.glb"])

    drawn, problems = link_shapes(arm, "look", 100)
    red = {shape.file for shape in drawn if shape.mesh.pieces[0].color == (1.0, 0.0, 0.0)}
    assert red == {"0.obj"} and {shape.file for shape in drawn} == {*colors, "0.gltf", "a.stl"}
    said = {problem.split("'")[1]: problem for _, problem in problems}
    assert set(said) == {"1.obj", "2.obj", "3.obj", "1.gltf", "2.gltf", "3.gltf", "a.glb"}
    assert "is a network address and is not read" in said.pop("3.obj") and "in other files" in said.pop("a.glb")
    assert all("lies outside the folders of the robot and is not read" in problem for problem in said.values())

    tested, problems = link_shapes(arm, "surface", 100)  # colours are none of its business
    assert {shape.file for shape in tested} == {*colors, "0.gltf", "a.stl"} and len(problems) == 4


NESTED = f'<node id="n">{"<node>" * 20_000}{FACE}{"</node>" * 20_000}</node>'
CALL = '<instance_node url="#n{}"/>'
CHAIN = (
    "".join(f'<node id="n{k}">{CALL.format(k + 1)}</node>' for k in range(5_000)) + f'<node id="n5000">{FACE}</node>'
)
DOUBLED = (
    "".join(f'<node id="n{k}">{CALL.format(k + 1) * 2}</node>' for k in range(40)) + f'<node id="n40">{FACE}</node>'
)
RING = '<node id="a"><node><instance_node url="#b"/></node></node><node id="b"><instance_node url="#a"/></node>'
M = '<instance_node url="#m"/>'
SELF, FIRST = '<node id="n"><instance_node url="#n"/></node>', '<node><instance_node url="#n0"/></node>'
HOSTILE = {
    "self.dae": (DAE.format(nodes=SELF, scene='<instance_node url="#n"/>'), "contains itself"),
    "ring.dae": (DAE.format(nodes=RING, scene='<instance_node url="#a"/>'), "contains itself"),
    "around.dae": (DAE.format(nodes="", scene=f'<node id="m">{FACE}<node id="n">{M}</node></node>'), "contains itself"),
    "inside.dae": (DAE.format(nodes="", scene=SELF.replace("<inst", f"{FACE}<inst")), "contains itself"),
    "deep.dae": (DAE.format(nodes="", scene=NESTED), "nested more than 200 deep"),
    "chain.dae": (DAE.format(nodes=CHAIN, scene=FIRST), "nested more than 200 deep"),
    "doubled.dae": (DAE.format(nodes=DOUBLED, scene=FIRST), "more than 100,000 others"),
    "entity.dae": ('<!DOCTYPE a [<!ENTITY b "c">]>' + DAE.format(nodes="", scene=f"<node>{FACE}</node>"), "DOCTYPE"),
    "cut.dae": (DAE.format(nodes="", scene="")[:300], "not well-formed"),
    "loop.gltf": (gltf("a.bin", [0]), "contains itself"),
    "cut.gltf": (gltf("a.bin")[:90], "JSON is broken"),
    "list.gltf": ("[]", "JSON is broken"),
    "empty.stl": ("", "cannot be read"),
    "count.stl": ("\0" * 80 + "\xff\xff\xff\x7f", "cannot be read"),
    "nan.stl": (SOLID.format("nan"), "cannot be read"),
    "huge.stl": (SOLID.format("1e30"), "cannot be read"),
    "index.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999\n", "cannot be read"),
    "none.obj": ("v 0 0 0\n", "cannot be read"),
    "count.ply": ("ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n0\n", ""),
    "count.off": ("OFF\n4000000000 4000000000 0\n0 0 0\n", ""),
}


@pytest.mark.parametrize("kind", ["surface", "look"])
def test_hostile_meshes_are_refused_by_name(kind, place):
    """Each of them ended the process, hung or filled the memory in one reader or the other, or is simply broken."""
    folder = place / "robot"
    for name, (text, _) in HOSTILE.items():
        (folder / name).write_text(text, encoding="latin-1")
    arm = crowd(folder, HOSTILE)
    found, problems = link_shapes(arm, kind, 100)
    assert [shape.file for shape in found] == ["a.stl"] and len(problems) == len(HOSTILE)
    for name, (_, said) in HOSTILE.items():
        (problem,) = [problem for element, problem in problems if f"mesh '{name}'" in problem]
        assert said in problem and len(problem) < 300, problem
    if kind == "look":
        body = Body(arm)
        assert [part.name for part in body.parts if part.name[:3] == "l1_"] == [f"l1_{len(HOSTILE)}"]
        assert f"and {len(HOSTILE) - 3} more" in body.notice
    else:
        with pytest.raises(ModelError, match=rf"link 'l1': mesh .*self\.dae.*and {len(HOSTILE) - 3} more"):
            ik.CollisionModel(arm)
        said = r"mesh file .*self\.dae' cannot be read: its node 'n' contains itself"
        with pytest.raises(InvalidConfiguration, match=said):
            ik.CollisionModel(robot("a.stl", folder)).add_mesh(folder / "self.dae", (0, 0, 3))


@pytest.mark.parametrize(
    ("body", "said", "seconds"),
    [("os.kill(os.getpid(), 11)", "crashed", meshes.SECONDS), ("[0 for _ in iter(int, 1)]", "too much time", 0.2)],
)
def test_a_file_that_kills_its_reader_is_named_and_the_others_are_read(place, monkeypatch, body, said, seconds):
    """Readers have more bugs than we know: here any file of 6 bytes is one."""
    worker = place / "worker.py"
    text = meshes.WORKER.read_text().replace(
        "    raw = file.read_bytes()\n", f"    raw = file.read_bytes()\n    if len(raw) == 6: {body}\n"
    )
    assert body in text
    worker.write_text(text)
    monkeypatch.setattr(meshes, "WORKER", worker)
    monkeypatch.setattr(meshes, "SECONDS", seconds)
    monkeypatch.setattr(meshes, "CAPS", meshes.CAPS._replace(crashes=2))
    folder = place / "robot"
    killer, good = folder / "b.stl", folder / "a.stl"
    killer.write_text("killer")
    found = meshes.read_meshes([killer, good], "surface", [folder])
    assert said in found[killer].refused and len(found[good].pieces[0].faces) == 1
    many = [folder / f"{k}.stl" for k in range(3)] if "kill" in body else []
    for path in many:
        path.write_text("killer")
    assert all("crashed" in mesh.refused for mesh in meshes.read_meshes(many, "surface", [folder]).values())


def test_counts_of_shapes_are_capped(place):
    for tag, most in (("collision", 300), ("visual", 2_000)):
        arm = robot("a.stl", place / "robot", role="visual")
        more = ball(0.1).replace("collision", tag) * (most + 1)
        vars(arm)["urdf"] = arm.urdf.replace("</visual></link>", f"</visual>{more}</link>")
        if tag == "collision":
            with pytest.raises(ModelError, match="301 collision shapes; at most 300"):
                ik.CollisionModel(arm)
        else:
            assert "2,002 visual shapes; at most 2,000" in Body(arm).notice and "stick figure" in Body(arm).notice


def test_a_mesh_that_is_used_over_and_over_is_counted_each_time(place, monkeypatch):
    arm = robot("a.stl", place / "robot")
    again = "<geometry><mesh filename='a.stl'/></geometry></visual><visual>" * 9
    vars(arm)["urdf"] = arm.urdf.replace("<visual>", f"<visual>{again}")
    monkeypatch.setattr(shapes, "MAX_TOTAL", 9)
    assert "have 10 triangles; at most 9" in Body(arm).notice and "stick figure" in Body(arm).notice
    monkeypatch.setattr(shapes, "MAX_TOTAL", 10)
    assert sum(part.name[:3] == "l1_" for part in Body(arm).parts) == 10


SIZES = [
    *(f'sphere radius="{radius}"' for radius in ("0", "-1", "1e300")), *(f'box size="{size}"' for size in ("0 0 0", "1 -1 1")),
    'cylinder radius="0" length="1"', 'cylinder radius="1" length="-1"', 'mesh filename="a.stl" scale="0 1 1"',
    "sphere", "blob", "",
]  # fmt: skip


@pytest.mark.parametrize("shape", SIZES)
def test_shapes_without_extent_are_said(shape, place):
    arm = robot("a.stl", place / "robot")
    vars(arm)["urdf"] = arm.urdf.replace('<mesh filename="a.stl"/>', f"<{shape}/>" if shape else "")
    said = "(is not a valid shape|is zero or too large|has no|<blob> is not a shape; use one of: mesh)"
    with pytest.raises(ModelError, match=f"link 'l1': .*{said}"):
        ik.CollisionModel(arm)
    scene = ik.view(arm)
    assert "link 'l1': " in scene.body.notice and "stick figure" in scene.body.notice and "</html>" in scene.html()
