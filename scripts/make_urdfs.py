"""Write the shipped robots: urdf/*.urdf from the D-H tables in urdf/dh. Run: python scripts/make_urdfs.py [FOLDER]."""

import math
import sys
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import numpy as np

from ik_toolkit.robot.formats.dh import add_arm, add_pedestal, read_dh_table, to_urdf
from ik_toolkit.robot.formats.urdf_write import (
    add_joint,
    add_link,
    add_shape,
    new_robot,
    numbers_text,
    origin,
    shift,
    to_text,
)
from ik_toolkit.robot.library import shipped_robots

URDF = Path(__file__).resolve().parent.parent / "urdf"
TABLES = [name for name, entry in shipped_robots().items() if entry.dh_file and entry.dh_file.stem == name]

# The machine of brokk_hydrolek is our assumption (the paper gives no dimensions): about the size of a small demolition
# machine, fixed on the ground; a turret on top carries both arms, mounted level and facing forward.
TURRET = shift(x=0.10, z=0.62)  # in base_link, which lies on the ground below the middle of the machine
MOUNTS = {"left": shift(x=0.22, y=0.27, z=0.44), "right": shift(x=0.22, y=-0.27, z=0.44)}  # in turret_link
TURRET_LIMIT = {"lower": -math.pi / 2, "upper": math.pi / 2, "effort": 1000.0, "velocity": math.radians(30)}
GRIPPER_LIMIT = {"lower": 0.0, "upper": 0.08, "effort": 1000.0, "velocity": 0.1}  # opening of one jaw


def brokk() -> str:
    """URDF of a fixed machine with a slewing turret that carries both arms, and a gripper jaw beyond each tip."""
    table = read_dh_table(URDF / "dh" / "hydrolek_7w.toml")
    robot = new_robot("brokk_hydrolek")
    add_link(robot, "world")
    _chassis(add_link(robot, "base_link"))
    add_joint(robot, "base_fixed", "fixed", "world", "base_link", np.eye(4))
    turret = add_link(robot, "turret_link")
    add_joint(robot, "turret", "revolute", "base_link", "turret_link", TURRET, TURRET_LIMIT)
    add_shape(turret, "cylinder", (0.24, 0.12), shift(z=0.06), "steel", solid=True)
    add_shape(turret, "box", (0.56, 0.42, 0.30), shift(x=-0.10, z=0.27), "orange", solid=True)
    add_shape(turret, "box", (0.30, 0.36, 0.04), shift(x=-0.16, z=0.44), "silver")
    add_shape(turret, "box", (0.16, 0.70, 0.14), shift(x=0.20, z=0.23), "steel", solid=True)
    for side, mount in MOUNTS.items():
        _arm(robot, turret, table, side, mount)
    return to_text(robot)


def _arm(robot, turret, table, side, mount) -> None:
    add_shape(turret, "box", (0.15, 0.13, 0.12), mount @ shift(z=-0.19), "steel", solid=True)
    add_pedestal(turret, table, mount)
    add_arm(robot, table, "turret_link", f"{side}_tip", prefix=f"{side}_", mount=mount, gripper=False)
    tip = next(link for link in robot.iter("link") if link.get("name") == f"{side}_tip")
    jaw = add_link(robot, f"{side}_jaw")
    add_shape(tip, "box", (0.15, 0.07, 0.04), shift(z=-0.11), "silver")
    add_shape(tip, "box", (0.02, 0.05, 0.13), shift(x=-0.04, z=-0.055), "orange")
    add_shape(jaw, "box", (0.05, 0.13, 0.02), shift(), "orange")
    slide = np.array([[0, 0, 1, 0.0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # z of the jaw along x of the tip
    place = shift(x=0.02, z=-0.055) @ slide
    add_joint(robot, f"{side}_gripper", "prismatic", f"{side}_tip", f"{side}_jaw", place, GRIPPER_LIMIT)


def _chassis(link) -> None:
    """Draw tracks with their wheels, a body, and four outriggers."""
    add_shape(link, "box", (0.95, 0.34, 0.30), shift(z=0.36), "steel", solid=True)
    add_shape(link, "box", (0.60, 0.40, 0.10), shift(x=-0.05, z=0.54), "orange", solid=True)
    across = np.array([[1, 0, 0, 0.0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # z of a wheel along y
    for y in (-0.29, 0.29):
        add_shape(link, "box", (0.80, 0.18, 0.26), shift(y=y, z=0.13), "steel", solid=True)
        for x in (-0.40, 0.40):
            add_shape(link, "cylinder", (0.13, 0.18), shift(x=x, y=y, z=0.13) @ across, "steel")
            add_shape(link, "cylinder", (0.08, 0.20), shift(x=x, y=y, z=0.13) @ across, "silver")
        for x in (-0.50, 0.50):
            add_shape(link, "box", (0.10, 0.46, 0.08), shift(x=x * 1.1, y=y * 1.3, z=0.38), "orange")
            add_shape(link, "cylinder", (0.035, 0.36), shift(x=x * 1.1, y=y * 2.05, z=0.20), "silver")
            add_shape(link, "cylinder", (0.08, 0.03), shift(x=x * 1.1, y=y * 2.05, z=0.015), "steel")


STEEL = 7850.0  # [kg/m^3]
RADII = (0.039, 0.030, 0.036, 0.029, 0.029, 0.022, 0.019)  # [m] of the cylinders, about as thick as the links are drawn


def with_masses(text: str, table) -> str:
    """Give the links of the inspection robot masses. The paper has none: ours are those of solid cylinders of steel.

    A link has a cylinder of its length d or a of the table (the lift: of its stroke, hanging down) and, if it turns, a drum about
    its joint's axis, twice as long as its radius.
    """
    robot = ET.fromstring(text)
    robot.insert(0, ET.Comment(" The masses are our assumption: solid cylinders of steel, see scripts/make_urdfs.py. "))
    for number, (row, r) in enumerate(zip(table.rows, RADII, strict=True), 1):
        slides = row.type == "prismatic"
        ends = [np.zeros(3), np.array([0.0, 0.0, -row.upper if slides else row.d]), np.array([row.a, 0.0, row.d])]
        parts = [] if slides else [(np.zeros(3), np.array([0.0, 0.0, 1.0]), 1.35 * r, 2.7 * r)]
        for a, b in pairwise(ends[:2] if slides else ends):
            if (length := float(np.linalg.norm(b - a))) > 0.0:
                parts.append((0.5 * (a + b), (b - a) / length, r, length))
        masses = np.array([STEEL * math.pi * radius**2 * length for _, _, radius, length in parts])
        centre = sum(m * part[0] for m, part in zip(masses, parts, strict=True)) / masses.sum()
        inertia = np.zeros((3, 3))
        for m, (place, axis, radius, length) in zip(masses, parts, strict=True):
            along, across, x = 0.5 * m * radius**2, m * (3.0 * radius**2 + length**2) / 12.0, place - centre
            inertia += (
                across * np.eye(3) + (along - across) * np.outer(axis, axis) + m * (x @ x * np.eye(3) - np.outer(x, x))
            )
        link = next(link for link in robot.iter("link") if link.get("name") == f"link_{number}")
        inertial = ET.SubElement(link, "inertial")
        origin(inertial, shift(*centre.round(6)))
        ET.SubElement(inertial, "mass", value=numbers_text([masses.sum().round(4)]))
        terms = {
            f"i{'xyz'[i]}{'xyz'[j]}": numbers_text([inertia[i, j].round(8)]) for i in range(3) for j in range(i, 3)
        }
        ET.SubElement(inertial, "inertia", terms)
    return to_text(robot)


def robots() -> dict[str, str]:
    """File name -> URDF text of every shipped robot."""
    tables = {name: read_dh_table(URDF / "dh" / f"{name}.toml") for name in TABLES}
    texts = {f"{name}.urdf": to_urdf(table) for name, table in tables.items()}
    texts["inspection_7dof.urdf"] = with_masses(texts["inspection_7dof.urdf"], tables["inspection_7dof"])
    return {**texts, "brokk_hydrolek.urdf": brokk()}


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else URDF
    for file, text in robots().items():
        (folder / file).write_text(text, encoding="utf-8")
        print(folder / file)
