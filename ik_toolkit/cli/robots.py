"""`ik robots`, `ik info`, `ik fk`: list of robots, description of one, and pose of its tip."""

import contextlib
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import FrameNotFound, InvalidOption
from ..text import how_many, plain
from .command import command, flag, option, options
from .options import JsonOutput, OneTip, TableOutput, assignments, joint_vector, kind_of
from .output import fixed, heading, notice, number, show, table, turns, unit, write_json, write_rows


@options()
class ListOptions(TableOutput):
    """Options of `ik robots`: which robots are listed, and the files written."""

    everything: bool = flag(
        "--all", "Also list the legs, hands and humanoids of example-robot-data, whose tips are guessed."
    )


@options("Robot")
class InfoOptions(OneTip):
    """Options of `ik info`: the robot, and whether its possible tips are listed instead."""

    list_tips: bool = flag("--list-tips", "List the possible tip frames, most likely first.", without=["--tip"])


@options()
class FkOptions(OneTip):
    """Options of `ik fk`: the robot and its joint values."""

    q: str | None = option("Q1 Q2 ...", "Joint values, one per joint; default: home.")


@command
def robots(out: ListOptions) -> None:
    """List the robots that can be given by name.

    Examples:
    ik robots
    ik robots --all --json
    """
    from ..robot.library import list_robots, shipped_robots

    entries = list_robots(out.everything)
    shipped = shipped_robots()
    names = ("name", "tips", "description", "paper", "path")
    told = [{key: getattr(entry, key) for key in names} | {"shipped": entry.name in shipped} for entry in entries]
    write_json({"robots": told}, out.as_json)
    write_rows(out.csv_file, names, ([_cell(getattr(entry, key)) for key in names] for entry in entries))
    if out.as_json:
        return
    ours = table("<name", "<tips", "description", "paper")
    theirs = table("<name", "<tips", "<file")
    for entry in entries:
        tips = "\n".join(entry.tips)
        if entry.name in shipped:
            ours.add_row(entry.name, tips, entry.description, entry.paper)
        else:
            theirs.add_row(entry.name, tips, entry.description.partition(": ")[2])
    show(heading("Shipped"), ours)
    if theirs.row_count:
        show(heading("From example-robot-data"), theirs)
        hint = "" if out.everything else "; --all lists its other robots"
        notice(f"also: any URDF or xacro file, and robot_descriptions:NAME{hint}")
    else:
        notice("more arms by name (panda, ur5, ...): pip install example-robot-data; or give the path of a URDF file")


def _cell(value: Any) -> str:
    """Return a value of the list of robots as text; several tips are joined by spaces."""
    return " ".join(value) if isinstance(value, tuple | list) else str(value or "")


@command
def info(robot: InfoOptions, out: TableOutput) -> None:
    """Show a robot: joints, limits, home, frames, reach, D-H table, and where it comes from.

    Examples:
    ik info hydrolek_7w
    ik info brokk_hydrolek --list-tips
    """
    from ..robot.configuration import follower_limits
    from ..robot.formats.dh import read_dh_table
    from ..robot.library import find
    from ..robot.load import read_source
    from ..robot.tips import tip_candidates
    from ..solvers.closed_form import describe_fit as closed_form

    entry, deg = find(robot.robot), robot.deg
    if robot.list_tips:
        read_args = assignments(robot.xacro_arg, "--xacro-arg", ":=")
        ends = tip_candidates(read_source(robot.robot, robot.package_dir or (), read_args)[1]["model"])
        _show_tips(entry, [robot.load(name) for name in dict.fromkeys((*entry.tips, *ends))], out)
        return
    try:
        names = [robot.tip] if robot.tip or robot.group or len(entry.tips) < 2 else entry.tips
        arms = [arm for one in map(robot.load, names) for arm in one.arms]
    except FrameNotFound as several:
        if not several.tips:
            raise
        _show_tips(entry, [robot.load(name) for name in several.tips], out)
        return
    dh = read_dh_table(entry.dh_file) if entry.dh_file else None
    rows = [{**describe(arm), "package_dirs": arm.package_dirs} for arm in arms]
    source = {"description": entry.description, "paper": entry.paper, "table": entry.table, "path": entry.path}
    payload = {**rows[0], **source, "dh": dh and dh.to_dict(), "srdf": _srdf_dict(arms[0])}
    if len(rows) > 1:
        payload["arms"] = rows
    _write_joints(out.csv_file, rows)
    write_json(payload, out.as_json)
    if out.as_json:
        return
    show(heading(entry.name))
    papers = "; ".join(filter(None, (entry.paper, entry.table)))
    show({"robot": entry.description or None, "source": papers or None, "file": entry.path}, _srdf_facts(arms[0]))
    for arm in arms:
        reach = f"at most {arm.reach:.4g} m from the first joint (a bound; limits may allow less)"
        kinds = {joint: kind_of(arm, joint) for joint in arm.locked_joints}
        locked = ", ".join(
            f"{joint} = {number(value, kinds[joint], deg)} {unit(kinds[joint], deg)}"
            for joint, value in arm.locked_joints.items()
        )
        own = follower_limits(arm)
        mimic = "; ".join(_tie(arm, joint, tie, own[joint], deg) for joint, tie in arm.mimic_joints.items())
        told = {
            "base -> tip": f"{arm.base} -> {arm.tip}",
            "joints": arm.n,
            "reach": reach,
            "mobility": str(arm.mobility).partition(", ")[2],
            "locked": locked or None,
            "mimic joints": mimic or None,
            "configurations": ", ".join(arm.named),
            "closed form": closed_form(arm) or None,
            "read as": "; ".join(arm.notes) or None,
        }
        show("", told, _joint_table(arm, deg))
    if dh:
        show(heading(f"D-H table, {dh.convention}; q is the joint's value"), _dh_table(dh, deg))


def _tie(robot: Any, joint: str, tie: Any, own: tuple[float, float], deg: bool) -> str:
    """Return a text on how a mimic joint follows its leader, and on its own limits [rad or m], if it has any."""
    kinds = kind_of(robot, joint), kind_of(robot, tie.leader)
    units = [unit(kind, deg) for kind in kinds]
    ratio = tie.ratio * math.prod(
        math.degrees(1.0) ** sign for sign, one in zip((1, -1), units, strict=True) if one == "deg"
    )
    sign, offset = "-" if tie.offset < 0.0 else "+", number(abs(tie.offset), kinds[0], deg)
    per = "" if units[0] == units[1] else f"{units[0]}/{units[1]} "
    low, high = (number(x, kinds[0], deg) for x in own)
    limits = "" if low == high == "none" else f", limits {low} to {high} {units[0]}"
    return f"{joint} = {ratio:g} {per}{tie.leader}" + f" {sign} {offset} {units[0]}" * (tie.offset != 0.0) + limits


def _write_joints(file: Path | None, rows: list[dict[str, Any]]) -> None:
    """Write the joints of each tip as CSV, in metres and radians; a joint that several tips share has a row for each."""
    if file is not None:
        joints = [{"tip": row["tip"], **joint} for row in rows for joint in plain(row["joints"])]
        write_rows(file, joints[0], (["" if value is None else value for value in joint.values()] for joint in joints))


def _show_tips(entry: Any, arms: list[Any], out: TableOutput) -> None:
    """Print a line for each possible tip of a robot, if it has several and none is known or recognised by name."""
    source = {"name": entry.name, "description": entry.description, "path": entry.path}
    rows = [describe(arm) for arm in arms]
    _write_joints(out.csv_file, rows)
    write_json({**source, "tips": [arm.tip for arm in arms], "arms": rows}, out.as_json)
    if out.as_json:
        return
    cells = [(arm.tip, str(arm.n), f"{arm.reach:.4g}", ", ".join(arm.joint_names)) for arm in arms]
    made = table("<tip", ">joints", ">reach at\nmost [m]", "moved by", rows=cells)
    show(heading(entry.name), {"file": entry.path, "tips": f"{len(arms)}; --tip NAME shows one"}, made)


def describe(robot: Any) -> dict[str, Any]:
    """Return a robot's frames, reach, joints with limits, and configurations as a dict for JSON, in metres and radians."""
    from ..robot.configuration import follower_limits
    from ..solvers.closed_form import describe_fit as closed_form

    joints = zip(
        robot.joint_names, robot.joint_kinds, robot.lower, robot.upper, robot.home, robot.velocity_limits, strict=True
    )
    names = ("name", "kind", "lower", "upper", "home", "velocity_limit")
    return {name: getattr(robot, name) for name in ("name", "base", "tip", "reach")} | {
        "joints": [dict(zip(names, joint, strict=True)) for joint in joints],
        "locked": robot.locked_joints,
        "mimic_joints": {
            joint: robot.mimic_joints[joint]._asdict() | {"kind": kind_of(robot, joint), "lower": low, "upper": high}
            for joint, (low, high) in follower_limits(robot).items()
        },
        "named": robot.named,
        "closed_form": closed_form(robot) or None,
        "notes": robot.notes,
    }


def _srdf_dict(robot: Any) -> dict[str, Any] | None:
    """Return the contents of the robot's SRDF as plain data; None without one."""
    said = robot.srdf
    if said.path is None and not said.remarks:
        return None
    groups = {}
    for name in said.groups:
        with contextlib.suppress(InvalidOption):  # A group of links that this robot does not have is left out.
            groups[name] = dict(zip(("base", "tips"), said.ends(name, robot.model), strict=True))
    return {
        "path": said.path,
        "groups": groups,
        "end_effectors": {name: asdict(one) for name, one in said.end_effectors.items()},
        "passive_joints": said.passive_joints,
        "may_touch": len(said.may_touch([frame.name for frame in robot.model.frames])),
        "remarks": said.against(robot.model),
    }


def _srdf_facts(robot: Any) -> dict[str, str | None]:
    """Return the contents of the robot's SRDF as text, by subject."""
    said = _srdf_dict(robot)
    if said is None:
        return {}
    groups = [f"{name} ({one['base'] or 'root'} -> {', '.join(one['tips'])})" for name, one in said["groups"].items()]
    ends = [f"{name} (on {one['parent_link']})" for name, one in said["end_effectors"].items()]
    return {
        "SRDF": str(said["path"]) if said["path"] else "none",
        "groups": "; ".join(groups) or None,
        "end effectors": "; ".join(ends) or None,
        "passive joints": ", ".join(said["passive_joints"]) or None,
        "may touch": f"{how_many(said['may_touch'], 'pair')} of links" if said["path"] else None,
        "SRDF, not used": "; ".join(said["remarks"]) or None,
    }


def _joint_table(robot: Any, deg: bool) -> Any:
    made = table(">#", "<joint", "<kind", ">lower", ">upper", ">home", ">max speed", "<unit")
    for i, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_kinds, strict=True)):
        columns = (robot.lower, robot.upper, robot.home, robot.velocity_limits)
        made.add_row(str(i + 1), name, kind, *(number(float(x[i]), kind, deg) for x in columns), unit(kind, deg))
    return made


def _dh_table(dh: Any, deg: bool) -> Any:
    angle = unit("revolute", deg)
    made = table("<joint", f">theta [{angle}]", ">d [m]", ">a [m]", f">alpha [{angle}]")
    for row in dh.rows:
        slides = row.type == "prismatic"
        theta, alpha = (number(x, "revolute", deg) for x in (row.theta, row.alpha))
        d, a = (number(x, "prismatic", deg) for x in (row.d, row.a))
        made.add_row(row.name, *((theta, _added(d)) if slides else (_added(theta), d)), a, alpha)
    return made


def _added(constant: str) -> str:
    """Return q plus a constant of the D-H table, as text."""
    if not float(constant):
        return "q"
    return f"q - {constant[1:]}" if constant.startswith("-") else f"q + {constant}"


@command
def fk(robot: FkOptions, out: JsonOutput) -> None:
    """Show the pose of the tip, in the robot's base frame, at given joint values.

    Examples:
    ik fk hydrolek_7w
    ik fk inspection_7dof --deg --q 20 0.22 20 0 20 0 20
    """
    from ..robot.rotation import matrix_quat, matrix_rpy

    arm, deg = robot.load(robot.tip), robot.deg
    values = arm.home if robot.q is None else joint_vector(arm, robot.q, "--q", deg)
    outside = arm.outside(values)
    if outside:
        notice(f"outside the limits: {', '.join(outside)}")
    T = arm.fk(values)
    at = arm.joint_values(values)
    rpy, quat = matrix_rpy(T.rotation), matrix_quat(T.rotation)
    payload = {"robot": arm.name, "base": arm.base, "tip": arm.tip, "joint_names": arm.joint_names, "q": values}
    payload["mimic_joints"] = {joint: at[joint] for joint in arm.mimic_joints}
    pose = {"xyz": T.translation, "rpy": rpy, "quat_xyzw": quat, "T_base_tip": T.homogeneous}
    write_json(payload | pose, out.as_json)
    if out.as_json:
        return
    angles = [math.degrees(x) if deg else x for x in rpy]
    shown = [
        f"{math.degrees(x) if deg and turns(kind) else float(x):.7g} {unit(kind, deg)}"
        for x, kind in zip(values, arm.joint_kinds, strict=True)
    ]
    told = {
        "robot": f"{arm.name}, {arm.base} -> {arm.tip}",
        "q" if robot.q is not None else "q (home)": ", ".join(shown),
        "position": f"({_numbers(T.translation, 7)}) m",
        "roll, pitch, yaw": f"({_numbers(angles, 4 if deg else 6)}) {'deg' if deg else 'rad'}",
        "quaternion xyzw": f"({_numbers(quat, 7)})",
    }
    show(told)


def _numbers(values: Any, digits: int) -> str:
    return ", ".join(fixed(float(x), digits) for x in values)
