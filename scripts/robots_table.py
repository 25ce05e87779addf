"""Load every robot of a folder or an installed package, solve for reachable poses, and print a table of the results.

Usage: python scripts/robots_table.py WHERE... [--targets 100] [--json FILE] [-o docs/robots_table.md]. WHERE is a folder, the name
of an installed distribution, or NAME=FOLDER. Answers are checked by Pinocchio, forward kinematics by yourdfpy or MuJoCo.
"""

import argparse
import contextlib
import importlib.metadata
import io
import json
import logging
import os
import platform
import statistics
import sys
import time
from datetime import date
from pathlib import Path

import numpy as np
import pinocchio as pin

import ik_toolkit as ik
from ik_toolkit.errors import IKError
from ik_toolkit.robot.load import read_source
from ik_toolkit.robot.rotation import rpy_matrix
from ik_toolkit.robot.tips import guess_tip, tip_candidates

SUFFIXES = (".urdf", ".xacro", ".xml")
AGREE = 1e-9  # [m, entries of rotations] largest difference of two FKs, over the robot's size
TOLERANCE = 1e-6  # of the solves [m, rad]
LIMITS = (-1.0, 1.0)  # m, of floating bases


def files(where: str) -> tuple[str, Path, list[Path]]:
    """Name, folder and descriptions of a folder or an installed distribution."""
    name, _, folder = where.partition("=")
    if folder or Path(where).is_dir():
        root = Path(folder or where)
        found = [path for path in root.rglob("*") if path.suffix in SUFFIXES]
    else:
        distribution = importlib.metadata.distribution(where)
        found = [Path(str(distribution.locate_file(f))) for f in distribution.files or () if f.suffix in SUFFIXES]
        root = Path(str(distribution.locate_file(".")))
    return name or where, root, sorted(path for path in found if path.is_file() and is_robot(path))


def is_robot(path: Path) -> bool:
    """Whether a file is a robot description: an .xml may be anything."""
    head = path.read_text(encoding="utf-8", errors="replace")[:20_000]
    return path.suffix != ".xml" or "<mujoco" in head


def row(path: Path, targets: int) -> dict:
    """Results for one file."""
    out: dict = {"loaded": False, "tip": "", "joints": 0, "solved": None, "fk": None, "seconds": 0.0, "reason": ""}
    began = time.perf_counter()
    try:
        entry, made = read_source(path, (path.parent,))
        out["seconds"] = time.perf_counter() - began
        guess = guess_tip(made["model"]).tips
        model = made["model"]
        joints = {frame.name: len(model.supports[frame.parentJoint]) for frame in model.frames}
        tips = guess if len(guess) == 1 else sorted(tip_candidates(model), key=lambda tip: -joints[tip])
        out["tips"] = len(tips)
        if not tips:
            out["reason"] = "no movable joint"
            return out
        robot, said = None, ""
        for tip in tips:  # the first that can be moved: a free object in a scene has none
            try:
                began = time.perf_counter()
                robot = ik.Robot.load(path, tip=tip, package_dirs=(path.parent,))
                out["seconds"] = time.perf_counter() - began
                break
            except IKError as error:
                said = said or str(error)
        if robot is None:
            out["reason"] = "no movable joint" if said.startswith("no moving joint between") else said  # but a free one
            return out
    except IKError as error:
        out["reason"] = str(error)
        return out
    out |= {"loaded": True, "tip": robot.tip, "joints": robot.n, "name": made["name"]}
    solve(robot, targets, out)
    out["fk"] = second_opinion(path, robot)
    return out


def solve(robot: ik.Robot, targets: int, out: dict) -> None:
    """Solve for the poses of random joint values; each answer is checked by Pinocchio here."""
    rng = np.random.default_rng(0)
    Q = robot.random_q(rng, targets)
    T = np.array([robot.fk(q).homogeneous for q in Q])
    result = ik.solve_batch(robot, T, seed=1)
    good = 0
    for q, target, success in zip(result.q, T, result.success, strict=True):
        d, angle = robot.errors(q, target)
        inside = bool(np.all(q >= robot.lower) and np.all(q <= robot.upper))
        good += bool(success) and d <= TOLERANCE * 1.001 and (angle or 0.0) <= TOLERANCE * 1.001 and inside
    out["solved"] = good
    if good < targets:
        left = {name: count for name, count in result.counts().items() if name != "CONVERGED"}
        out["reason"] = ", ".join(f"{count} {name}" for name, count in left.items())


# ------------------------------------------------------------------------------------------------------ a second opinion
def second_opinion(path: Path, robot: ik.Robot) -> float | None:
    """Largest difference of the forward kinematics from MuJoCo's (for MJCF) or yourdfpy's; None if that cannot read it."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            judge = by_mujoco(path, robot) if path.suffix == ".xml" else by_yourdfpy(robot)
    except Exception:
        return None
    rng = np.random.default_rng(2)
    worst = 0.0
    for q in robot.random_q(rng, 10):
        other = judge(q)
        if other is None:
            return None
        off = robot.fk(q).homogeneous - other
        off[:3, 3] /= max(1.0, robot.reach)
        worst = max(worst, float(np.abs(off).max()))
    return worst


def values(robot: ik.Robot, q: np.ndarray) -> dict[str, float]:
    """Value of every one-DOF joint, followers included."""
    model = robot.model
    full = robot._filled(q)
    lead = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    found = {}
    for j in range(1, model.njoints):
        joint, ratio, offset = model.joints[j], 1.0, 0.0
        if j in lead:
            own = joint.extract()
            joint, ratio, offset = model.joints[lead[j]], own.scaling, own.offset
        if joint.nv == 1:
            x = full[joint.idx_q : joint.idx_q + joint.nq]
            found[model.names[j]] = ratio * float(x[0] if len(x) == 1 else np.arctan2(x[1], x[0])) + offset
    return found


def by_yourdfpy(robot: ik.Robot):
    """Poses of the tip by yourdfpy."""
    import yourdfpy

    urdf = yourdfpy.URDF.load(
        io.BytesIO(robot.urdf.encode()), load_meshes=False, build_collision_scene_graph=False, build_scene_graph=True
    )

    def pose(q: np.ndarray) -> np.ndarray | None:
        known = values(robot, q)
        urdf.update_cfg({name: known.get(name, 0.0) for name in urdf.actuated_joint_names})
        return urdf.get_transform(robot.tip, robot.base)

    return pose


def by_mujoco(path: Path, robot: ik.Robot):
    """Poses of the tip by MuJoCo."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)

    def place(name: str) -> np.ndarray | None:
        T = np.eye(4)
        if name in ("world", "universe"):
            return T
        for kind, at, turned in (
            (mujoco.mjtObj.mjOBJ_BODY, data.xpos, data.xmat),
            (mujoco.mjtObj.mjOBJ_SITE, data.site_xpos, data.site_xmat),
        ):
            k = mujoco.mj_name2id(model, kind, name)
            if k >= 0:
                T[:3, :3], T[:3, 3] = turned[k].reshape(3, 3), at[k]
                return T
        return None

    def pose(q: np.ndarray) -> np.ndarray | None:
        known = values(robot, q)
        data.qpos[:] = model.qpos0
        for j in range(model.njnt):
            name, at = model.joint(j).name, model.jnt_qposadr[j]
            if int(model.jnt_type[j]) in (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)):
                data.qpos[at] = known.get(name or f"{model.body(model.jnt_bodyid[j]).name}_joint", 0.0)
            elif int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_BALL):
                turns = [known.get(f"{name}_{turn}", 0.0) for turn in ("roll", "pitch", "yaw")]
                mujoco.mju_mat2Quat(data.qpos[at : at + 4], rpy_matrix(turns).ravel())
        mujoco.mj_kinematics(model, data)
        base, tip = place(robot.base), place(robot.tip)
        return None if base is None or tip is None else np.linalg.inv(base) @ tip

    return pose


def others(path: Path) -> str:
    """Whether Pinocchio, xacro or MuJoCo load a file that we reject, in words; '' if none does."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            if path.suffix == ".xml":
                import mujoco

                return f"MuJoCo loads it, {mujoco.MjModel.from_xml_path(str(path)).njnt} joints"
            if path.suffix == ".xacro":
                import xacro

                text = xacro.process_file(str(path)).toxml()
            else:
                text = path.read_text(encoding="utf-8", errors="replace")
            return f"Pinocchio loads it, {pin.buildModelFromXML(text).njoints - 1} joints"
        except BaseException:
            return ""


# ---------------------------------------------------------------------------------------------------------------- page
def summary(rows: list[dict], targets: int) -> str:
    """Summary line of a source."""
    loaded = [r for r in rows if r["loaded"]]
    full = sum(r["solved"] == targets for r in loaded)
    solved, asked = sum(r["solved"] for r in loaded), targets * len(loaded)
    still = sum(r["reason"] == "no movable joint" for r in rows)
    refused = len(rows) - len(loaded) - still
    ours = sum(bool(r.get("others")) for r in rows)
    judged = [r["fk"] for r in loaded if r["fk"] is not None]
    load = 1000.0 * statistics.median([r["seconds"] for r in loaded]) if loaded else 0.0
    return (
        f"{len(rows)} files: {len(loaded)} loaded, {still} without a movable joint, {refused} refused ({ours} of them loaded by "
        f"others); {solved:,} of {asked:,} poses solved, all {targets} on {full} robots; forward kinematics compared on "
        f"{len(judged)}, at most {max(judged, default=0.0):.1e} apart; median time to load {load:.0f} ms"
    )


def page(found: dict[str, list[dict]], targets: int) -> str:
    """Markdown of the tables."""
    parts = [
        "# Robots that load",
        "Which robot descriptions load, and how well poses are solved on them: every description in a package is loaded, its tip "
        f"is guessed (of several, the one moved by the most joints), and {targets} reachable poses are solved, each result "
        "verified by Pinocchio. *FK* is the largest difference of the forward kinematics from yourdfpy, or from MuJoCo for MJCF. "
        "Objects without joints are counted but not listed. "
        f"Written by `python scripts/robots_table.py` on {date.today()}, Python {platform.python_version()}.",
    ]
    for name, rows in found.items():
        shown = [r for r in rows if r["reason"] != "no movable joint"]
        folder = os.path.commonpath([os.path.dirname(r["file"]) for r in shown]) if shown else ""
        place = f" Files are below `{folder}`." if folder else ""
        parts.append(f"## {name}\n\n{summary(rows, targets)}.{place}")
        lines = ["| file | joints | tip | solved | FK | load [ms] | remark |", "|---|--:|---|--:|--:|--:|---|"]
        for r in shown:
            solved = "" if r["solved"] is None else str(r["solved"])
            fk = "" if r["fk"] is None else f"{r['fk']:.0e}" if r["fk"] else "0"
            tip = f"{r['tip']}{' (of several)' if r.get('tips', 1) > 1 else ''}"
            words = "; ".join(filter(None, (r["reason"].replace("<", "\\<"), r.get("others", ""))))[:160]
            file, joints, load = (
                os.path.relpath(r["file"], folder or "."),
                str(r["joints"] or ""),
                f"{1000 * r['seconds']:.0f}",
            )
            cells = [file, joints, tip, solved, fk, load, words]
            lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def main() -> int:
    """Load, solve and write; exit code 1 if a file is rejected that others load."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("where", nargs="+")
    parser.add_argument("--targets", type=int, default=100)
    parser.add_argument("--json", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    found: dict[str, list[dict]] = {}
    for where in asked.where:
        name, root, paths = files(where)
        rows = found.setdefault(name, [])
        for path in paths:
            rows.append({"file": str(path.relative_to(root)), **row(path, asked.targets)})
            rows[-1]["reason"] = rows[-1]["reason"].replace(f"{root.resolve()}/", "").replace(f"{root}/", "")
            if not rows[-1]["loaded"] and rows[-1]["reason"] != "no movable joint":
                rows[-1]["others"] = others(path)
            print({k: v for k, v in rows[-1].items() if v not in ("", None)}, flush=True)
        print(f"{name}: {summary(rows, asked.targets)}", flush=True)
        if asked.json:
            asked.json.write_text(json.dumps(found, indent=1))
        if asked.output:
            asked.output.write_text(page(found, asked.targets), encoding="utf-8")
    return int(any(r.get("others") for rows in found.values() for r in rows))


if __name__ == "__main__":
    sys.exit(main())
