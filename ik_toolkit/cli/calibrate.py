"""`ik calibrate`: the errors of an arm from a file of measurements, and the poses to measure."""

import math
import shlex
from pathlib import Path
from typing import Any

import typer

from ..errors import InvalidOption, InvalidTarget
from ..files import as_output, write_table
from ..text import figure, length, numbers, vector
from .command import PLOTS, command, in_radians, option, options
from .options import FileOptions, JsonOutput, OneTip, given
from .output import heading, notice, show, table, turns, write_json
from .pictures import chart


@options()
class CalibrateOptions:
    """Options of `ik calibrate`: what was measured, which errors are looked for, and which files are written."""

    data: Path | None = option(
        "FILE",
        "Measurements, a .csv with a column for each joint, and x,y,z (of poses also qx,qy,qz,qw or roll,pitch,yaw), or socket, or "
        "plane, or distance; or an .npz with q and measured. --deg and --length-unit hold for joints as well.",
    )
    what: str | None = option("KIND", "pose, position, distance, socket or plane; default: what the columns say.")
    parameters: str = option(
        "GROUPS",
        "What may be wrong: any of joints,frames,tool,base; base for an instrument with a frame of its own.",
        default="joints,frames,tool",
    )
    place: list[str] | None = option(
        "X,Y,Z", "Known place of socket 0, 1, ... [m], one each; may be repeated.", needs=["--data"]
    )
    distance: list[str] | None = option(
        "A:B:M", "Known distance [m] of sockets A and B; may be repeated.", needs=["--data"]
    )
    noise: str | None = option(
        "M [RAD]",
        "Noise of a measurement [m], of poses also [rad; degrees with --deg]; default: estimated.",
        needs=["--data"],
    )
    prior: str | None = option(
        "M RAD",
        "How far links and joints may be off [m, rad; degrees with --deg]; default 0.01 m, 0.035 rad.",
        needs=["--data"],
    )
    suggest: int | None = option(
        "N",
        "Write N configurations to measure to -o, a .csv; with --data beside those measured.",
        without=["--html", "--plot"],
    )
    output: Path | None = option(
        "FILE", "Write the corrected robot (.urdf), or what --suggest finds (.csv).", "-o", "--output", writes=[]
    )
    html: Path | None = option("FILE", "Write all of it as one HTML page.", writes=[], needs=["--data"])
    plot: Path | None = option(
        "FILE", "Draw residuals and errors to a .png, .pdf or .svg file.", writes=PLOTS, needs=["--data"]
    )
    seed: int = option(
        "N", "Seed of the configurations that --suggest chooses from.", default=0, panel="Solver", needs=["--suggest"]
    )


@command
def calibrate(asked: CalibrateOptions, robot: OneTip, file: FileOptions, out: JsonOutput) -> None:
    """Find where an arm really goes: errors of its joints, links and tool from measurements of its tip, and a corrected URDF.

    Measurements are positions, poses or distances from an instrument, or touches of sockets or planes. Errors that they cannot
    determine are named. Exit code 1 when the result is not credible: errors are far larger than assumed, or large ones remain.

    Examples:
    ik calibrate hydrolek_7w --suggest 30 -o poses.csv
    ik calibrate hydrolek_7w --data measured.csv --deg -o corrected.urdf
    ik calibrate hydrolek_7w --data touches.csv --distance 0:1:0.512
    """
    if asked.data is None and asked.suggest is None:
        raise InvalidOption("give --data FILE with measurements, or --suggest N for configurations to measure")
    if asked.output is not None:
        what = ("the corrected robot", ".urdf") if asked.suggest is None else ("what --suggest finds", ".csv")
        as_output(asked.output, *what)
    if asked.html is not None:  # The page of `ik calibrate` has no 3-D scene, so it needs no extra package.
        as_output(asked.html, "the file of --html", ".html", ".htm")
    arm = robot.load(robot.tip)
    groups = [word.strip() for word in asked.parameters.split(",") if word.strip()]
    if asked.data is None:
        _suggest(asked, robot, arm, groups, None, out.as_json)
        return
    from ..study.calibrate import calibrate as fit

    what, Q, measured = _read(asked, arm, file.convention(robot.deg))
    known: dict[str, Any] = {
        "places": [vector(text, "--place", 3) for text in asked.place or ()] or None,
        "distances": dict(map(_pair, asked.distance or ())) or None,
        "noise": _length_and_angle(asked.noise, "--noise", robot.deg),
        "prior": _length_and_angle(asked.prior, "--prior", robot.deg),
    }
    found = fit(arm, Q, measured, what, groups, **known)
    if asked.suggest is not None:
        _suggest(asked, robot, arm, groups, found, out.as_json)
        return
    if asked.output is not None:
        made = found.write(asked.output)
        doubt = "" if found.credible else ", but not to be used before the doubts below are settled"
        notice(f"wrote {asked.output}: the corrected robot, to be loaded with --tip {made.tip}{doubt}")
    if asked.html is not None:
        found.save(asked.html)
        notice(f"wrote {asked.html}")
    chart(asked.plot, found)
    write_json({**found.to_dict(), "output": asked.output}, out.as_json)
    if not out.as_json:
        _show(found)
    if not found.credible:
        raise typer.Exit(1)


def _length_and_angle(text: str | None, name: str, deg: bool) -> list[float] | None:
    """Return the numbers of a text: a length [m], perhaps an angle [rad], typed in degrees if `deg`; None without a text."""
    if text is None:
        return None
    values = vector(text, name)
    return [*values[:1], *(in_radians(x, deg) for x in values[1:])]


def _pair(text: str) -> tuple[tuple[int, int], float]:
    """Return the indices of two sockets and their distance [m] from the text I:J:METRES."""
    read = [numbers(part) or [] for part in text.split(":")]
    if len(read) != 3 or any(len(one) != 1 for one in read) or any(one[0] % 1.0 for one in read[:2]):
        raise InvalidOption(f"--distance takes A:B:M, two sockets (from 0) and their distance [m], not '{text}'")
    return (int(read[0][0]), int(read[1][0])), read[2][0]


def _read(asked: CalibrateOptions, arm: Any, given: Any) -> tuple[str, Any, Any]:
    """Read the file of measurements: return their kind, joint values (N, n) [rad or m] and the measured values."""
    import numpy as np

    from ..robot.pose_arrays import read_named
    from ..robot.pose_files import LENGTHS, read_columns, read_poses

    path, scale = asked.data or Path(), LENGTHS[given.check().length_unit]
    unit = np.array([(np.pi / 180.0 if given.deg else 1.0) if turns(kind) else scale for kind in arm.joint_kinds])
    if path.suffix.lower() == ".npz" and path.is_file():
        Q, measured = read_named(path, ("q", "measured"))
        what = asked.what or ("pose" if measured.ndim == 3 else "position")
        if what in ("pose", "position", "distance"):
            pairs = what == "distance" and measured.ndim == 2
            lengths = measured[..., :3, 3] if measured.ndim == 3 else measured[:, -1:] if pairs else measured
            lengths *= scale
        return what, Q * (unit if Q.ndim == 2 and Q.shape[1] == arm.n else 1.0), measured
    if path.suffix.lower() != ".csv" or not path.is_file():
        raise InvalidTarget(f"--data takes an existing .csv or .npz file, not '{path}'")
    kinds = ("socket", "plane", "distance")  # Each of these kinds of measurement has a column of its name in the file.
    header, Q = read_columns(path, arm.joint_names)
    Q = Q * unit
    what = asked.what or next((kind for kind in kinds if kind in header), None)
    if what in kinds:
        columns = read_columns(path, ("end", what) if what == "distance" and "end" in header else (what,))[1]
        if what == "distance":
            columns[:, -1] *= scale
        return what, Q, columns if columns.shape[1] == 2 else columns[:, 0]
    poses = np.concatenate(
        [block.poses for block in read_poses(path, "measurements", given=given, besides=arm.joint_names)[1]]
    )
    if what == "position" and poses.ndim == 3:
        poses = poses[:, :3, 3]
    return what or ("pose" if poses.ndim == 3 else "position"), Q, poses


def _next(asked: CalibrateOptions, robot: OneTip) -> str:
    """Return a text on what to do next: which columns to add to the suggested configurations, and the command to run then."""
    from ..robot.formats.urdf import is_text

    what = asked.what or "position"
    columns = {"pose": "columns x,y,z,qx,qy,qz,qw", "position": "columns x,y,z"}.get(what, f"column {what}")
    words = ["ik", "calibrate", "ROBOT" if is_text(robot.robot) else robot.robot, "--data", str(asked.output)]
    used = {**given(robot), "what": asked.what, "parameters": asked.parameters}
    for name, value in used.items():
        flag = f"--{name.replace('_', '-')}"
        if value is True:
            words.append(flag)
        elif name != "robot" and value not in (None, False, CalibrateOptions.parameters):
            words += [f"{flag}={one}" for one in (value if isinstance(value, list) else [value])]
    return f"add the {columns} as measured, then: {shlex.join(words)}"


def _suggest(asked: CalibrateOptions, robot: OneTip, arm: Any, groups: list[str], found: Any, as_json: bool) -> None:
    """Choose configurations, and write or show them."""
    import numpy as np

    from ..study.suggest_poses import suggest_poses

    count, deg = asked.suggest or 0, robot.deg
    if found is not None:
        Q = found.suggest(count, seed=asked.seed)
    else:
        Q = suggest_poses(arm, count, what=asked.what or "position", parameters=groups, seed=asked.seed)
    tips = np.array([arm.fk(q).translation for q in Q])
    shown = np.where([turns(kind) for kind in arm.joint_kinds], np.degrees(Q), Q) if deg else Q
    if asked.output is not None:
        write_table(
            asked.output, [*arm.joint_names, "drawn_x", "drawn_y", "drawn_z"], np.hstack([shown, tips]).tolist()
        )
        notice(f"wrote {asked.output}: {_next(asked, robot)}")
    write_json(
        {"robot": arm.name, "joint_names": arm.joint_names, "q": Q, "positions": tips, "output": asked.output}, as_json
    )
    if as_json or asked.output is not None:
        return
    made = table(">#", *(">" + name.replace("_", "_\n") for name in arm.joint_names))
    for k, row in enumerate(shown.tolist()):
        made.add_row(
            str(k), *(f"{x:.{2 if deg and turns(kind) else 4}f}" for x, kind in zip(row, arm.joint_kinds, strict=True))
        )
    show(made)


def _show(found: Any) -> None:
    """Print the result of a calibration."""
    before, after = found.rms
    noise = length(found.noise[0])
    noise += f", {figure(math.degrees(found.noise[1]), 2)} deg" if found.what == "pose" else ""
    held_out = f"; held out {length(found.held_out)}" if found.held_out is not None else ""
    lines = {
        "as drawn": f"{length(before)} (root mean square of {len(found.after)} measurements)",
        "corrected": length(after) + held_out,
        "noise": f"{noise} of a measurement",
        "told": f"{found.rank} of {len(found.x)} unknowns; {found.rank_drawn} at the arm as drawn",
        "observability": f"O1 {figure(found.observability)}, condition {figure(found.condition)}",
    }
    show(lines)
    made = table("<error", ">found", ">95 %", "<")
    kinds = {one.name: one.turns for one in found.unknowns}
    for name, (x, half) in found.errors.items():
        scale, unit = (180.0 / math.pi, "deg") if kinds[name] else (1e3, "mm")
        made.add_row(name, f"{scale * x:+.3f}", f"+-{scale * half:.3f}", unit)
    show(made)
    if found.fixed:
        show(heading("fixed as drawn, because other errors move the tip in the same way"))
        show({one.fixed: ", ".join(one.shared) or "nothing measured depends on it" for one in found.fixed})
    if len(found.touched):
        show(heading("places touched [m], base frame"))
        show({str(k): "  ".join(f"{x:.5f}" for x in place) for k, place in enumerate(found.touched.tolist())})
    if "base" in found.parameters:
        place = "  ".join(f"{x:.5f}" for x in found.T_world_base[:3, 3])
        show({"base": f"{place} m, in the frame of the measurements (--json has the rotation)"})
    for note in found.notes:
        show(f"- {note}")
