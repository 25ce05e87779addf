"""Shared parts of the benchmark commands: robots, targets, summaries of times, the machine, and output files."""

import argparse
import importlib.metadata
import json
import os
import platform
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from ik_toolkit import Robot, __version__
from ik_toolkit.study.benchmark import wilson

ROBOTS = ("panda", "ur5", "xarm7", "kinova", "z1", "hydrolek_7w")
TOLERANCES = {"loose": (1e-4, 1e-3), "strict": (1e-6, 1e-6)}  # m, rad
ROW = 600  # characters of a line in the output files: a row of a table fits, and a diff shows which rows changed
NEAR = 0.1  # rad (m), largest distance of a near start from a solution, each joint


def parser(description: str, output: str) -> argparse.ArgumentParser:
    """Command line parser with the options common to all commands."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("-o", "--output", type=Path, default=Path(output), help=f"JSON to write (default {output})")
    made.add_argument("--seed", type=int, default=0, help="seed of the targets and starts")
    return made


def machine() -> dict[str, Any]:
    """Processor, cores and versions, without anything that identifies the machine."""
    cpu = platform.machine()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        cpu = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), cpu)
    names = ("pin", "numpy", "numba")
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "nice": os.nice(0),
        "python": platform.python_version(),
        "ik_toolkit": __version__,
        **{name: importlib.metadata.version(name) for name in names},
    }


def load_average() -> float:
    """Load average over the last minute: above 1, the machine was shared."""
    return round(os.getloadavg()[0], 2)


def one_thread() -> None:
    """Limit the numerical libraries of this process and its children to one thread (call before importing them)."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
        os.environ[name] = "1"


def microseconds(seconds: np.ndarray) -> dict[str, float]:
    """Median, mean and 99th percentile [us] of times [s]."""
    us = 1e6 * np.asarray(seconds)
    return {"median": float(np.median(us)), "mean": float(us.mean()), "p99": float(np.percentile(us, 99))}


def rate(solved: int, count: int) -> dict[str, Any]:
    """Counts of successes and targets, with the 95 % Wilson interval."""
    low, high = wilson(solved, count)
    return {"solved": int(solved), "targets": int(count), "low": low, "high": high}


def percent(part: dict[str, Any]) -> str:
    """Success for a table: percent and interval."""
    share = 100 * part["solved"] / part["targets"]
    return f"{share:.5g} ({100 * part['low']:.5g} to {100 * part['high']:.5g})"


def short(value: float) -> str:
    """Three significant digits without an exponent."""
    if value >= 1000:
        return f"{float(f'{value:.3g}'):,.0f}"
    return f"{value:.3g}"


def table(head: list[str], rows: list[list[Any]]) -> str:
    """Markdown table; the first column left-aligned, the others right-aligned."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" + "---:|" * (len(head) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(map(str, row)) + " |" for row in rows)])


def write(output: Path, payload: dict[str, Any], *tables: str) -> None:
    """`keep`, and print the tables."""
    print(keep(output, payload, *tables))


def keep(output: Path, payload: dict[str, Any], *tables: str) -> str:
    """Write the JSON with the tables as Markdown in it; returns the tables."""
    # no folders of this machine
    words = [Path(word).name if Path(word).is_absolute() else word for word in sys.argv[1:]]
    payload = {
        "command": "python " + " ".join([f"scripts/benchmarks/{Path(sys.argv[0]).name}", *words]),
        **payload,
    }
    text = "\n\n".join(tables) + "\n"
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(compact({**payload, "tables": text}) + "\n", encoding="utf-8")
    return text


def read(path: Path) -> dict[str, Any]:
    """What `keep` wrote."""
    return json.loads(path.read_text(encoding="utf-8"))


def compact(value: Any) -> str:
    """JSON with every figure in full, where whatever is shorter than ROW characters, such as a row of a table, takes one line."""
    line = json.dumps(value, separators=(",", ":"))
    if len(line) <= ROW or not isinstance(value, (dict, list)):
        return line
    if isinstance(value, dict):
        return "{\n" + ",\n".join(f"{json.dumps(key)}:{compact(part)}" for key, part in value.items()) + "\n}"
    return "[\n" + ",\n".join(map(compact, value)) + "\n]"


# ------------------------------------------------------------------------------------------------------------- robots
def serial_urdf(robot: Robot) -> str:
    """URDF of the path base -> tip only, without shapes, so that every peer can read it.

    Links get a mass of 1 kg (some peers reject massless links) and continuous joints become revolute within two turns either
    way (some peers do not support continuous joints).
    """
    root = ET.fromstring(robot.urdf or "")
    parents = {j.find("child").get("link"): j for j in root.findall("joint")}  # type: ignore[union-attr]
    joints, link = [], robot.tip
    while link != robot.base:
        joints.append(parents[link])
        link = parents[link].find("parent").get("link")  # type: ignore[union-attr]
    made = ET.Element("robot", name=robot.name)
    links = [robot.base, *(str(j.find("child").get("link")) for j in reversed(joints))]  # type: ignore[union-attr]
    for name in links:
        inertial = ET.SubElement(ET.SubElement(made, "link", name=name), "inertial")
        ET.SubElement(inertial, "mass", value="1")
        ET.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
    for joint in reversed(joints):
        name = str(joint.get("name"))
        if name in links:  # some peers look up a frame by its name only
            name += "_joint"
        copy = ET.SubElement(made, "joint", name=name, type=str(joint.get("type")))
        fixed = joint.get("type") == "fixed"
        for tag in ("origin", "parent", "child") if fixed else ("origin", "parent", "child", "axis", "limit"):
            part = joint.find(tag)
            if part is not None:
                copy.append(ET.Element(tag, dict(part.attrib)))
        if copy.get("type") == "continuous":
            copy.set("type", "revolute")
            for part in copy.findall("limit"):
                copy.remove(part)
            turn = repr(2 * np.pi)
            ET.SubElement(copy, "limit", lower=f"-{turn}", upper=turn, effort="100", velocity="1")
    return ET.tostring(made, encoding="unicode")


def random_targets(robot: Robot, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Configurations (N, n) inside the limits and their poses (N, 4, 4): reachable targets."""
    Q = np.array([robot.random_q(rng) for _ in range(count)])
    return Q, robot.chain.forward(Q)[0]
