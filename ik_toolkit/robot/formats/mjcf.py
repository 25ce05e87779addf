"""Reads MJCF by letting MuJoCo compile it (defaults, includes, frames, angles) and writing the result as URDF, link by link.

MJCF thus has the same safety limits, meshes, collisions and pictures as a URDF. What a URDF cannot express is noted:
ball joints become revolute joints, loops become constraints that results are checked against, shapes of other kinds are
left out. Keyframes become named configurations, sites become links.
"""

import functools
import importlib.util
import math
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import MissingExtra, ModelError
from ..base import BALL_PITCH, BASES, ROOT, TURNS
from ..geometry.meshes import mesh_folders
from ..rotation import matrix_rpy, quat_matrix
from .description import Urdf
from .mjcf_constraints import TieReader, Ties
from .mjcf_text import Flat, flatten
from .sandbox import ask
from .srdf import Srdf
from .urdf import ENDLESS, attribute_numbers, source_text
from .urdf_write import add_joint, add_link, numbers_text, origin, shift, to_text

WORKER = Path(__file__).with_name("mjcf_worker.py")
MEMORY = 2_000_000_000  # Memory cap [bytes] of the process that runs MuJoCo. A humanoid takes 0.2 GB, most of it for MuJoCo itself.
SECONDS = 4  # Cap on the processor time [s] of the process that runs MuJoCo. A large robot takes 1 s.
HIDDEN = 3  # Shapes of MJCF group 3 and above are not drawn, as in the viewer of MuJoCo.
# A ball joint with a limited range becomes five joints, whose names end in these words.
AXIS_ANGLE = ("azimuth", "tilt", "angle", "tilt_back", "azimuth_back")
BALL_AXES = ((0, 0, 1), (0, 1, 0), (1, 0, 0))


def read_mjcf(source: str | Path, package_dirs: Iterable[str | Path] = (), *_: Any) -> Urdf:
    """Convert an MJCF file (a path) or text to URDF, with the constraints and named configurations beside it.

    Raises MissingExtra if mujoco is not installed, ModelError if the text cannot be read.
    """
    text = source_text(source, "MJCF")
    if importlib.util.find_spec("mujoco") is None:
        raise MissingExtra("mujoco", "formats")
    path = source if isinstance(source, Path) else None
    name = path.name if path else "MJCF text"
    flat = flatten(text, path, mesh_folders(path, package_dirs))
    model = _compile(flat.xml, name)
    return _Writer(model, path.stem if path else "", flat).read()


@functools.lru_cache(maxsize=4)  # A robot is often loaded again, and compiling it takes a third of a second.
def _compile(xml: str, name: str) -> dict[str, Any]:
    """Compile MJCF text in a subprocess and return the model as MuJoCo describes it, which must not be changed."""
    silent = "it crashed MuJoCo, or took too much time or memory"
    # MuJoCo writes its log to the current folder, so the process runs in a temporary folder of its own.
    with tempfile.TemporaryDirectory(prefix="ik_mjcf_") as folder:
        answer = ask(WORKER, "reads MJCF", silent, memory=MEMORY, seconds=SECONDS, folder=folder, xml=xml)
    if "error" in answer:
        raise ModelError(f"MuJoCo cannot read '{name}': {answer['error']}")
    return answer


def _matrix(pos: Sequence[float], quat: Sequence[float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = quat_matrix(quat, "wxyz"), pos
    return T


def _origin(given: tuple[str, str] | None, scale: Sequence[float]) -> np.ndarray | None:
    """Return the pose (4x4) [m] of a scaled mesh that MuJoCo moves by -refpos and turns back by refquat before it scales it.

    Return None if the mesh is stretched as well as turned, which a URDF cannot express, or if the texts are not numbers.
    """
    T = np.eye(4)
    if given is not None:
        pos, quat = (attribute_numbers(text) or [] for text in given)
        length = math.hypot(*quat)
        if len(pos) != 3 or len(quat) != 4 or not 0.0 < length < math.inf or not np.isfinite(pos).all():
            return None
        R = quat_matrix([x / length for x in quat], "wxyz").T
        T[:3, :3], T[:3, 3] = R, -np.array(scale) * (R @ pos)
        if np.abs(R - np.eye(3)).max() > 1e-9 and np.ptp(scale) > 1e-9:
            return None
    return T


def _free(name: str, taken: set[str]) -> str:
    """Return a name that is not in the set `taken`: the given one or a variant of it, which is added to the set."""
    k, free = 1, name
    while free in taken:
        k += 1
        free = f"{name}_{k}"
    taken.add(free)
    return free


class _Writer:
    """Writes one compiled MJCF model as URDF."""

    def __init__(self, model: dict[str, Any], name: str, flat: Flat) -> None:
        self.model, self.flat, self.notes = model, flat, list(dict.fromkeys(flat.notes))
        self.robot = ET.Element("robot", name=model["name"] or name or "robot")
        self.links: set[str] = set()
        self.names: set[str] = set()
        # Functions that each take the vector qpos of an MJCF keyframe and return pairs of joint name and value.
        self.values: list[Any] = []
        # The leader, ratio and offset of each mimic joint that is made for a ball joint with a limited range. Such a joint is
        # replaced by five joints, of which the last two mimic the first two.
        self.back: dict[str, tuple[str, float, float]] = {}
        self.left_out: set[str] = set()

    def read(self) -> Urdf:
        """Convert the whole compiled model, and return the URDF with all that a URDF cannot hold."""
        model = self.model
        bodies = [self._link(body["name"] or (f"body{i}" if i else "world")) for i, body in enumerate(model["bodies"])]
        self._shapes(bodies)
        joints = [_free(joint["name"] or f"{bodies[joint['body']]}_joint", self.names) for joint in model["joints"]]
        self._doubtful(joints)
        ties = TieReader(model, joints, bodies).read()
        self.notes += ties.notes
        for i, body in enumerate(model["bodies"][1:], 1):
            own = [j for j, joint in enumerate(model["joints"]) if joint["body"] == i]
            self._body(body, bodies[i], bodies[body["parent"]], [(j, joints[j]) for j in own], ties)
        for site in model["sites"]:
            if site["name"]:
                link = self._link(site["name"] if site["name"] not in self.links else f"{site['name']}_site")
                self._fix(link, bodies[site["body"]], link, _matrix(site["pos"], site["quat"]))
        if self.left_out:
            self.notes.append(f"shapes that a URDF cannot hold are left out: {', '.join(sorted(self.left_out))}")
        pairs = {(bodies[i], bodies[j]): "exclude" for i, j in model["excludes"]}
        srdf = Srdf(states=self._states(), disabled=pairs)
        return Urdf(to_text(self.robot), tuple(self.notes), srdf, ties.constraints)

    def _states(self) -> dict[str, dict[str, dict[str, tuple[float, ...]]]]:
        """Return the configurations of the keyframes; one whose qpos has a value that is not finite is left out, with a note."""
        states = {}
        for k, key in enumerate(self.model["keys"]):
            name = key["name"] or f"key{k}"
            if np.isfinite(key["qpos"]).all():
                states[name] = {"": {joint: (x,) for one in self.values for joint, x in one(key["qpos"])}}
            else:
                self.notes.append(f"keyframe '{name}' is left out: a value in its qpos is not a finite number")
        return states

    def _doubtful(self, joints: Sequence[str]) -> None:
        """Add notes on ranges that MuJoCo ignores because their ends are reversed or equal, and on radians read as degrees."""
        hinges = [joint["range"] for joint in self.model["joints"] if joint["type"] == "hinge" and joint["range"]]
        if len(hinges) > 1 and np.abs(hinges).max() <= math.radians(2.0 * math.pi):
            self.notes.append(
                'no hinge may turn further than 6.28 degrees: were radians meant? Then write <compiler angle="radian"/>'
            )
        for name, joint in zip(joints, self.model["joints"], strict=True):
            low, high = joint["given"]
            if joint["range"] is None and low >= high and (low, high) != (0.0, 0.0):
                self.notes.append(
                    f"joint '{name}' has no limits, as in MuJoCo: its range {low:g} {high:g} does not go from lower to upper"
                )

    # ------------------------------------------------------------------------------------------------ elements
    def _link(self, name: str) -> str:
        """Append a link of this name, or of a variant if the name is taken, and return its name."""
        name = _free(name, self.links)
        add_link(self.robot, name)
        return name

    def _fix(self, name: str, parent: str, link: str, T: np.ndarray) -> None:
        """Append a fixed joint of this name, or of a variant if the name is taken."""
        add_joint(self.robot, _free(name, self.names), "fixed", parent, link, T)

    def _body(
        self, body: dict[str, Any], link: str, parent: str, joints: Sequence[tuple[int, str]], ties: Ties
    ) -> None:
        """Write the joints between a body and its parent.

        Empty links are added between several joints, and below the last one if it is not at the body's origin.
        """
        T = _matrix(body["pos"], body["quat"])
        if not joints:
            self._fix(f"{link}_fixed", parent, link, T)
            return
        if self.model["joints"][joints[0][0]]["type"] == "free":
            self._free_body(*joints[0], link, T)
            return
        steps: list[tuple[str, str, np.ndarray, Sequence[float], Sequence[float] | None]] = []
        for j, name in joints:
            joint = self.model["joints"][j]
            T = T @ shift(*joint["pos"])
            if joint["type"] == "ball":
                self._ball(name, joint, steps, T)
            else:
                steps.append(self._single(name, joint, T, ties.held.get(j), ties.ranges.get(j) or joint["range"]))
            T = shift(*(-x for x in joint["pos"]))
        off = bool(np.abs(T[:3, 3]).max() > 0.0)
        for k, (name, kind, at, axis, limits) in enumerate(steps):
            child = link if k == len(steps) - 1 and not off else self._link(f"{link}_at_{name}")
            ends = dict(zip(("lower", "upper"), limits or (), strict=False))
            limit = None if kind == "fixed" else {**ends, "effort": ENDLESS, "velocity": ENDLESS}
            made = add_joint(self.robot, name, kind, parent, child, at, limit, axis)
            mimic = ties.tied.get(name) or self.back.get(name)
            if mimic is not None:
                leader, ratio, offset = mimic
                ET.SubElement(made, "mimic", joint=leader, multiplier=repr(ratio), offset=repr(offset))
            parent = child
        if off:
            self._fix(f"{link}_fixed", parent, link, T)

    def _free_body(self, j: int, name: str, link: str, T: np.ndarray) -> None:
        """Write a free joint, whose values count from T, the body's pose in the file; those of MuJoCo are poses in the world."""
        self.notes.append(
            f"free joint '{name}' of '{link}' is held still; that of the robot's own base moves with base_limits="
        )
        add_joint(self.robot, name, "floating", "world", link, T)
        joints, place = self.model["joints"], self.model["joints"][j]["place"]
        alone = len({self._top(joint["body"]) for joint in joints}) == 1

        def values(qpos: Sequence[float]) -> list[tuple[str, float]]:
            M = np.linalg.inv(T) @ _matrix(qpos[place : place + 3], qpos[place + 3 : place + 7])
            parts = (*M[:3, 3].tolist(), *matrix_rpy(M[:3, :3])[::-1].tolist())
            names = (f"{ROOT if alone else name}_{part}" for part in BASES["floating"])
            return list(zip(names, parts, strict=True))

        self.values.append(values)

    def _top(self, body: int) -> int:
        """Return the body below the world that carries a body."""
        while parent := self.model["bodies"][body]["parent"]:
            body = parent
        return body

    def _single(
        self, name: str, joint: dict[str, Any], T: np.ndarray, held: float | None, limits: Sequence[float] | None
    ) -> tuple:
        """Describe a hinge or slide joint, as a fixed one if it is held at a value; values count from MuJoCo's `ref`."""
        axis, place = np.array(joint["axis"]), joint["place"]
        moved = (0.0 if held is None else held) - joint["ref"]
        if joint["type"] == "slide":
            T = T @ shift(*(moved * axis))
        else:
            T = T @ _matrix((0, 0, 0), (math.cos(0.5 * moved), *(math.sin(0.5 * moved) * axis)))
        if held is not None:
            return name, "fixed", T, axis, None
        self.values.append(lambda qpos: [(name, qpos[place])])
        if joint["type"] == "slide":
            return name, "prismatic", T, axis, limits or (-ENDLESS, ENDLESS)
        # A joint limited by a tendon may have a limit on one side only, and the other is infinite, which URDF cannot hold.
        if limits is not None and not np.isfinite(limits).all():
            limits = np.nan_to_num(limits, posinf=ENDLESS, neginf=-ENDLESS).tolist()
        return name, "revolute" if limits else "continuous", T, axis, limits

    def _ball(self, name: str, joint: dict[str, Any], steps: list, T: np.ndarray) -> None:
        """Write a ball joint as revolute joints: as Rz Ry Rx, or, if it has a range, as a rotation about a variable axis."""
        most = joint["range"][1] if joint["range"] else math.inf
        place = joint["place"]
        if most < math.pi:  # A range of pi or more allows every rotation.
            self._limited_ball(name, most, place, steps, T)
            return
        names = [_free(f"{name}_{turn}", self.names) for turn in TURNS]

        def values(qpos: Sequence[float]) -> list[tuple[str, float]]:
            return list(
                zip(names, matrix_rpy(quat_matrix(qpos[place : place + 4], "wxyz"))[::-1].tolist(), strict=True)
            )

        self.values.append(values)
        self._turns(names, BALL_AXES, {names[1]: (-BALL_PITCH, BALL_PITCH)}, steps, T)
        self.notes.append(f"ball joint '{name}' becomes three revolute joints: {', '.join(names)}")

    def _limited_ball(self, name: str, most: float, place: int, steps: list, T: np.ndarray) -> None:
        """Write a ball joint as Rz(a) Ry(b) Rz(angle) Ry(-b) Rz(-a), which makes MuJoCo's range the limit of the one joint `angle`.

        The last two joints mimic the first two.
        """
        a, b, angle, down, back = (_free(f"{name}_{part}", self.names) for part in AXIS_ANGLE)
        self.back |= {down: (b, -1.0, 0.0), back: (a, -1.0, 0.0)}

        def values(qpos: Sequence[float]) -> list[tuple[str, float]]:
            w, x, y, z = qpos[place : place + 4]
            turn = 2.0 * math.atan2(math.hypot(x, y, z), w)
            turn -= 2.0 * math.pi * (turn > math.pi)
            return [(a, math.atan2(y, x)), (b, math.atan2(math.hypot(x, y), z)), (angle, turn)]

        self.values.append(values)
        z, y = BALL_AXES[:2]
        self._turns((a, b, angle, down, back), (z, y, z, y, z), {angle: (-most, most)}, steps, T)
        self.notes.append(
            f"ball joint '{name}' becomes a turn by {angle} about an axis whose direction {a} and {b} set (Rz Ry Rz); "
            f"its range is the limit of {angle}: +-{math.degrees(most):.6g} degrees"
        )

    def _turns(
        self, names: Sequence[str], axes: Sequence, limits: dict[str, tuple[float, float]], steps: list, T: np.ndarray
    ) -> None:
        """Add revolute joints through one point, the first at T; those without limits are continuous."""
        for name, axis in zip(names, axes, strict=True):
            steps.append((name, "revolute" if name in limits else "continuous", T, axis, limits.get(name)))
            T = np.eye(4)

    # ------------------------------------------------------------------------------------------------ shapes
    def _shapes(self, bodies: Sequence[str]) -> None:
        by_name = {link.get("name"): link for link in self.robot.iter("link")}
        for geom in self.model["geoms"]:
            roles = ["visual"] * (geom["group"] < HIDDEN) + ["collision"] * geom["touches"]
            made = self._geometry(geom) if roles else None
            if made is None:
                continue
            element, T = made
            for role in roles:
                part = ET.SubElement(by_name[bodies[int(geom["body"])]], role)
                origin(part, T)
                ET.SubElement(part, "geometry").append(element)
                if role == "visual":
                    colour = ET.SubElement(part, "material", name=" ".join(f"{x:.3g}" for x in geom["rgba"]))
                    ET.SubElement(colour, "color", rgba=numbers_text(geom["rgba"]))

    def _geometry(self, geom: dict[str, Any]) -> tuple[ET.Element, np.ndarray] | None:
        """Return the URDF element of a shape and its pose (4x4) [m], or None if a URDF cannot express it."""
        size, kind, T = geom["size"], geom["type"], _matrix(geom["pos"], geom["quat"])
        if kind == "mesh":
            mesh = self.model["meshes"][geom["mesh"]]
            file = self.flat.meshes.get(mesh["name"])
            own = _origin(self.flat.origins.get(mesh["name"]), mesh["scale"])
            if file is None or own is None:
                self.left_out.add("meshes written out" if file is None else "meshes that are turned and stretched")
                return None
            T = T @ np.linalg.inv(_matrix(mesh["pos"], mesh["quat"])) @ own
            return ET.Element("mesh", filename=file, scale=numbers_text(mesh["scale"])), T
        if kind == "box":
            return ET.Element("box", size=numbers_text([2.0 * x for x in size])), T
        if kind == "sphere" or (kind == "ellipsoid" and len(set(size)) == 1):
            return ET.Element("sphere", radius=repr(size[0])), T
        if kind in ("cylinder", "capsule"):
            return ET.Element(kind, radius=repr(size[0]), length=repr(2.0 * size[1])), T
        if kind != "plane":  # A plane is the floor of a scene, not a part of the robot.
            self.left_out.add(kind)
        return None
