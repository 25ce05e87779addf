"""Hostile and broken input files through the public entry points: no crash, no hang, no traceback.

    python scripts/break/files.py [--seed 0] [--count 240] [--folder DIR]

Each case is a robot file, usually with a mesh, made from a few good ones by the rules below: truncation, flipped bytes, replaced
numbers, repeated or nested pieces, references that leave the folder. A separate process with time and memory limits checks it,
loads it, tests collisions and draws it; anything but an answer or an error of ik_toolkit is a failure. Exit code 1 if there is
one.
"""

import argparse
import json
import os
import random
import resource
import signal
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ik_toolkit as ik
from ik_toolkit.errors import IKError
from ik_toolkit.robot.formats.urdf_check import check_urdf

SECONDS, MEMORY = 60, 6_000_000_000  # [s] processor time and bytes per case, without the process that reads its meshes
NUMBERS = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "1e-320",
    "99999999999",
    "4294967295",
    "-0.0",
    "x",
    "",
    "1_0",
    "0x10",
    "1e",
]
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
DAE = """<COLLADA version="1.4.1"><asset><unit meter="1"/></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="9">0 0 0 1 0 0 0 1 0</float_array>
<technique_common><accessor source="#pa" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
</library_geometries><library_nodes>@N</library_nodes>
<library_visual_scenes><visual_scene id="s">@S</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
GLTF = {
    "asset": {"version": "2.0"},
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "buffers": [{"uri": "data:application/octet-stream;base64," + "A" * 48, "byteLength": 36}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}
    ],
}
MESHES = {
    "stl": "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
    "obj": "mtllib a.mtl\no a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl red\nf 1/1/1 2/1/1 3/1/1\n",
    "ply": "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "off": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    "dae": DAE.replace("@N", "").replace("@S", '<node id="n"><instance_geometry url="#g"/></node>'),
    "gltf": json.dumps(GLTF),
}


def chain(count: int, shape: str = "", more: str = "") -> str:
    """A robot whose second link has a shape; more: further text inside <robot>."""
    links = [f'<link name="l{k}">{shape if k == 1 else ""}</link>' for k in range(count + 1)]
    joints = [
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="0 0 0.3" rpy="0 1 0"/>'
        f'<axis xyz="0 1 0"/>{LIMIT}</joint>'
        for k in range(count)
    ]
    return f'<robot name="r">{"".join(links + joints)}{more}</robot>'


def shaped(inside: str) -> str:
    """The same geometry as a visual and a collision shape."""
    return "".join(f"<{tag}><geometry>{inside}</geometry></{tag}>" for tag in ("visual", "collision"))


def damaged(text: str, rng: random.Random) -> bytes:
    """Damage a text in one to four places."""
    raw = bytearray(text.encode())
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(raw) + 1)
        kind = rng.randrange(5)
        if kind == 0:
            del raw[at:]
        elif kind == 1:
            raw[at : at + 1] = bytes([rng.randrange(256)])
        elif kind == 2:
            raw[at:at] = raw[at : at + rng.randint(1, 60)] * rng.choice([1, 50, 5000])
        elif kind == 3:
            del raw[at : at + rng.randint(1, 40)]
        else:
            words = bytes(raw).split(b" ")
            words[rng.randrange(len(words))] = rng.choice(NUMBERS).encode()
            raw = bytearray(b" ".join(words))
    return bytes(raw)


def mesh_case(rng: random.Random) -> tuple[str, bytes]:
    """Name and bytes of a hostile mesh."""
    kind = rng.choice([*MESHES, "tree", "instances", "outside", "binary", "disguise"])
    if kind == "tree":
        depth = rng.choice([100, 1_000, 20_000, 200_000])
        nodes = "<node>" * depth + '<instance_geometry url="#g"/>' + "</node>" * depth
        return f"deep {depth}.dae", DAE.replace("@N", "").replace("@S", nodes).encode()
    if kind == "instances":
        count, times, back = rng.choice([1, 3, 40, 3_000]), rng.choice([1, 2, 30]), rng.random() < 0.5
        nodes = "".join(
            f'<node id="n{k}">' + f'<instance_node url="#n{k + 1}"/>' * times + "</node>" for k in range(count)
        )
        last = '<instance_node url="#n0"/>' if back else '<instance_geometry url="#g"/>'
        text = DAE.replace("@N", f'{nodes}<node id="n{count}">{last}</node>').replace(
            "@S", '<node><instance_node url="#n0"/></node>'
        )
        return f"instances {count} {times} {back}.dae", text.encode()
    if kind == "outside":
        where = rng.choice(
            ["../a.mtl", "/dev/zero", "/dev/stdin", "file:///etc/hostname", "http://127.0.0.1:9/a", "\0", "a" * 9_999]
        )
        if rng.random() < 0.5:
            return "outside.obj", MESHES["obj"].replace("a.mtl", where).encode()
        return "outside.gltf", json.dumps({**GLTF, "buffers": [{"uri": where, "byteLength": 36}]}).encode()
    if kind == "binary":
        count = rng.choice([0, 1, 2, 1_000, 2**31 - 1, 2**32 - 1])
        return f"count {count}.stl", bytes(80) + count.to_bytes(4, "little") + rng.randbytes(
            rng.choice([0, 49, 50, 5_000])
        )
    if kind == "disguise":
        return f"disguise.{rng.choice([*MESHES, 'glb'])}", MESHES[rng.choice([*MESHES])].encode()
    return f"damaged.{kind}", damaged(MESHES[kind], rng)


def robot_case(rng: random.Random) -> tuple[str, str | bytes]:
    """Name and text of a hostile robot."""
    n = rng.choice([10, 1_000, 30_000])
    ball = '<sphere radius="0.1"/>'
    cases = {
        "damaged": lambda: damaged(chain(3, shaped(ball)), rng),
        "numbers": lambda: chain(
            3, shaped(f'<sphere radius="{rng.choice(NUMBERS)}"/><box size="1 1 {rng.choice(NUMBERS)}"/>')
        ),
        "sizes": lambda: chain(3, shaped(f'<box size="{rng.choice(NUMBERS)} {rng.choice(NUMBERS)} 1"/>')),
        "axes": lambda: chain(3).replace("0 1 0", f"{rng.choice(NUMBERS)} 0 0", 2),
        "limits": lambda: chain(3).replace('upper="1"', f'upper="{rng.choice(NUMBERS)}"'),
        "origin": lambda: chain(3).replace("0 0 0.3", f"0 {rng.choice(NUMBERS)} 0"),
        "joints": lambda: chain(rng.choice([100, 129, 400, 999, 20_000])),
        "links": lambda: chain(2, more="".join(f'<link name="m{k}"/>' for k in range(n))),
        "shapes": lambda: chain(2, shaped(ball) * min(n, 20_000)),
        "meshes": lambda: chain(2, "".join(shaped(f'<mesh filename="m{k}.stl"/>') for k in range(min(n, 5_000)))),
        "attributes": lambda: chain(2, more="<a " + " ".join(f'a{k}="1"' for k in range(n)) + "/>"),
        "names": lambda: chain(2).replace("l1", "ab" * n),
        "depth": lambda: chain(2, more="<a>" * n + "</a>" * n),
        "materials": lambda: chain(2, more="".join(f'<material name="m{k}"/>' for k in range(n))),
        "mimics": lambda: chain(3).replace(
            "</joint>", f'<mimic joint="j{rng.choice([0, 1, 9])}"/>' * rng.choice([1, n]) + "</joint>"
        ),
        "doctype": lambda: '<!DOCTYPE a [<!ENTITY b "c"><!ENTITY d "&b;&b;&b;">]>' + chain(2),
        "comment": lambda: chain(2, more="<!--" + "x" * 100 * n),
        "escapes": lambda: chain(2).replace("j1", "&#x9b;31m&#x202e;<"[: rng.choice([6, 10, 18])]),
        "encoding": lambda: chain(2).encode(rng.choice(["utf-16", "utf-32", "utf-8-sig", "cp500"])),
        "file": lambda: chain(
            2, shaped(f'<mesh filename="{rng.choice(["../x.stl", "/dev/zero", "file:///dev/tty", ".", "%00"])}"/>')
        ),
    }
    name = rng.choice([*cases])
    return f"{name}", cases[name]()


def taken(file: str) -> str:
    """Outcome of the public calls on a robot file, in one line."""
    said = []

    def attempt(what: str, call: Callable[[], Any]) -> Any:
        try:
            return call()
        except IKError as error:
            text = str(error)
            if not text or len(text) > 5_000 or "Traceback" in text:
                raise AssertionError(f"no sentence: {text[:200]}") from None
            said.append(f"{what}: {text[:100]}")

    attempt("check", lambda: [str(finding) for finding in check_urdf(file)])
    arm = attempt("load", lambda: ik.Robot.load(file))
    if arm is not None:
        attempt("fk", lambda: arm.fk(arm.home))
        attempt("collisions", lambda: ik.CollisionModel(arm).collides(arm.home))
        attempt("picture", lambda: ik.view(arm).html())
    return "; ".join(said) or "taken"


def limited(file: Path, report: Path) -> int:
    """Wait status of a fork that runs a case and writes the outcome or the traceback to a file."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1]
    code = 1
    try:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(10 * SECONDS)  # wall time
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # Pinocchio's parser prints to stderr
        try:
            report.write_text(taken(str(file)))
            code = 0
        except BaseException:
            report.write_text(traceback.format_exc()[-800:])
    finally:
        os._exit(code)


def run(folder: Path, number: int, rng: random.Random) -> tuple[str, str, bool]:
    """Name of a case, its outcome, and whether it failed."""
    place = folder / str(number)
    place.mkdir()
    if rng.random() < 0.55:
        name, raw = mesh_case(rng)
        (place / f"mesh{Path(name).suffix}").write_bytes(raw)
        text: str | bytes = chain(2, shaped(f'<mesh filename="mesh{Path(name).suffix}"/>'))
    else:
        name, text = robot_case(rng)
    file, report = place / "robot.urdf", place / "report.txt"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    start = time.monotonic()
    status = limited(file, report)
    said = report.read_text() if report.exists() else "no answer: crashed, or over the limits"
    return name, f"{said[-500:]!a} ({time.monotonic() - start:.1f} s)", status != 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=240)
    parser.add_argument("--folder", type=Path, help="keep the files here (default: a temporary folder)")
    asked = parser.parse_args()
    failures = 0
    with tempfile.TemporaryDirectory() as made:
        folder = asked.folder or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        good = folder / "good.urdf"
        good.write_text(chain(2, shaped('<sphere radius="0.1"/>')))
        taken(str(good))  # load once what all forks need
        for number in range(asked.count):
            rng = random.Random(f"{asked.seed} {number}")  # noqa: S311
            name, said, failed = run(folder, number, rng)
            failures += failed
            print(f"{'FAILED' if failed else 'ok':6} {number:4} {name}: {said}", flush=True)
    print(f"{asked.count} files, {failures} failures (crashes, hangs, tracebacks), seed {asked.seed}")
    raise SystemExit(failures > 0)


if __name__ == "__main__":
    main()
