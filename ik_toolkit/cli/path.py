"""`ik path`: one joint motion through the poses of a file, timed if asked for."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InvalidOption, InvalidTarget
from ..text import numbers
from . import solve_options as asked
from . import tip_texts
from .arguments import (
    PLOTS,
    Base,
    BaseRpy,
    BaseXyz,
    Deg,
    Group,
    Json,
    Limit,
    Lock,
    PackageDir,
    RobotArg,
    SrdfFile,
    Tips,
    XacroArg,
    joint_vector,
    load_robot,
    narrowed,
    writes,
)
from .obstacles import avoided
from .output import facts, notice, partial, progress, show, table, write_json
from .pictures import Html, Live, present
from .streams import uninterrupted

if TYPE_CHECKING:
    from ..motion.trajectory import Trajectory
    from ..paths.result import PathResult

Poses = Annotated[
    Path,
    typer.Option(
        "--poses",
        metavar="FILE",
        help="Poses in order, in the base frame: CSV with the header x,y,z or x,y,z,qx,qy,qz,qw or x,y,z,roll,pitch,yaw; NPZ or "
        "JSON with targets (N, 4, 4) or (N, 3), or xyz and quat_xyzw. Several tips: as for ik solve --targets.",
    ),
]
First = Annotated[
    str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Start of the path, or a configuration to start near.")
]
Last = Annotated[
    str | None, typer.Option("--q-end", metavar="Q1 Q2 ...", help="End of the path, or a configuration to end near.")
]
StepDeg = Annotated[float, typer.Option("--max-step-deg", metavar="DEG", help="Largest step of a revolute joint.")]
StepMm = Annotated[float, typer.Option("--max-step-mm", metavar="MM", help="Largest step of a prismatic joint.")]
Reconfigurations = Annotated[
    str,
    typer.Option("--reconfigurations", metavar="fewest|none|N", help="Allowed changes of branch."),
]
Retime = Annotated[
    bool,
    typer.Option(
        "--retime", help="Time the path optimally within --velocity and --acceleration; -o writes the trajectory."
    ),
]
Velocity = Annotated[
    str | None,
    typer.Option(
        metavar="V [V2 ...]",
        help="With --retime: speed limits [rad/s, m/s], one, or one per joint; default: the robot's.",
    ),
]
Acceleration = Annotated[
    str | None,
    typer.Option(
        metavar="A [A2 ...]", help="With --retime: acceleration limits [rad/s^2, m/s^2], one, or one per joint."
    ),
]
Rate = Annotated[float, typer.Option(metavar="HZ", help="With --retime: samples per second.")]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="FILE",
        help="Write the path to .csv, .npz or .json; with --retime the trajectory to .csv, or to .json as a ROS JointTrajectory.",
        callback=writes(".csv", ".npz", ".json"),
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Draw the joints to a .png, .pdf or .svg file.", callback=writes(*PLOTS)),
]
LISTED = 5  # unreached poses listed on the terminal; the file lists all


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(path)


def path(
    robot: RobotArg,
    poses: Poses,
    q0: First = None,
    q_end: Last = None,
    max_step_deg: StepDeg = 7.0,
    max_step_mm: StepMm = 20.0,
    reconfigurations: Reconfigurations = "fewest",
    mask: asked.Mask = None,
    slack: asked.Slack = None,
    free_turn: asked.FreeTurn = None,
    frame: asked.Frame = None,
    relative: asked.Relative = None,
    avoid_collisions: asked.AvoidCollisions = False,
    obstacle: asked.Obstacles = None,
    margin: asked.Margin = None,
    tolerance: asked.Tolerance = None,
    position_tolerance: asked.PositionTolerance = None,
    orientation_tolerance: asked.OrientationTolerance = None,
    seed: asked.Seed = 0,
    retime: Retime = False,
    velocity: Velocity = None,
    acceleration: Acceleration = None,
    rate: Rate = 100.0,
    tip: Tips = None,
    base: Base = None,
    base_xyz: BaseXyz = None,
    base_rpy: BaseRpy = None,
    lock: Lock = None,
    limit: Limit = None,
    package_dir: PackageDir = None,
    xacro_arg: XacroArg = None,
    srdf: SrdfFile = None,
    group: Group = None,
    deg: Deg = False,
    as_json: Json = False,
    output: Out = None,
    plot: Plot = None,
    html: Html = None,
    live: Live = False,
) -> None:
    """Find one joint motion through poses, with the fewest changes of branch, verified between the poses.

    --mask, --slack, --free-turn and --frame select what counts, also by tip. --retime times the motion optimally, with stops where
    the branch changes. Ctrl-C keeps the best path so far as FILE.partial.

    Exit code 0 when every pose is followed (FOLLOWED, RECONFIGURES), otherwise 1: the status says why, and a message on stderr
    says what to try.
    """
    line = SimpleNamespace(**locals())
    _refuse_contradictions(line)
    from ..paths.solve_path import PathInterrupted, solve_path
    from ..robot.pose_files import read_poses

    tips = tip_texts.choose_tips(robot, tip, None, None, False, group)
    arm = load_robot(robot, tips, base, lock, package_dir, deg, xacro_arg, base_xyz, base_rpy, srdf, group)
    arm = narrowed(arm, limit, deg)
    _, blocks = read_poses(poses, "poses", deg=deg, tips=arm.tips if arm.by_tip else ())
    targets = _joined([block.poses for block in blocks], poses.name)
    options = _options(line, arm)
    result = made = None
    try:
        with progress("searching", 100) as bar:
            result = solve_path(arm, targets, progress=lambda share, words: bar(100.0 * share, words), **options)
        if retime and result.success:
            made = result.retime(
                _numbers(velocity, "--velocity"), _numbers(acceleration, "--acceleration"), rate=rate, seed=seed
            )
    except KeyboardInterrupt as stop:
        found = stop.result if isinstance(stop, PathInterrupted) else result
        if output is not None and found is not None:
            _keep(found, output, "the path, without times," if retime else "the best path so far")
        raise
    with uninterrupted():
        _write(result, made, line)
    _draw(result, made, line)
    write_json(_payload(result, made), as_json)
    if not as_json:
        _show(result, made)
    if not result.success:
        notice(f"{result.status.name}: {result.message}")
    elif made is not None and not made.success:
        notice(made.message)
    if not result.success or (made is not None and not made.success):
        raise typer.Exit(1)


def _refuse_contradictions(line: SimpleNamespace) -> None:
    """Raise InvalidOption for options that do not go together."""
    if not line.retime and (line.velocity is not None or line.acceleration is not None):
        raise InvalidOption("--velocity and --acceleration belong to --retime")
    if line.retime and line.acceleration is None:
        raise InvalidOption("--retime needs --acceleration: a URDF defines no acceleration limits")
    if line.retime and line.output is not None and line.output.suffix.lower() == ".npz":
        raise InvalidOption(f"a trajectory is written as .csv or .json, not '{line.output}'")
    for name, value in (("--max-step-deg", line.max_step_deg), ("--max-step-mm", line.max_step_mm)):
        if not 0.0 < value < math.inf:
            raise InvalidOption(f"{name} must be positive, not {value:g}")


def _joined(parts: list[Any], name: str) -> Any:
    """Poses of the blocks of a file as one array, or a dict of these by tip. Raises InvalidTarget where there are none."""
    import numpy as np

    if not parts:
        raise InvalidTarget(f"'{name}' has no pose")
    if isinstance(parts[0], dict):
        return {tip: np.concatenate([part[tip] for part in parts]) for tip in parts[0]}
    return np.concatenate(parts)


def _options(line: SimpleNamespace, arm: Any) -> dict[str, Any]:
    """Options of `solve_path`, only those given."""
    options = asked.read_counting(line)
    for name in ("tolerance", "position_tolerance", "orientation_tolerance"):
        if getattr(line, name) is not None:
            options[name] = getattr(line, name)
    for name, text in (("q0", line.q0), ("q_end", line.q_end)):
        if text is not None:
            options[name] = joint_vector(arm, text, f"--{name.replace('_', '-')}", line.deg)
    options |= avoided(arm, line)
    words = line.reconfigurations
    options["reconfigurations"] = int(words) if words.isdecimal() else words
    return options | {"max_step": (math.radians(line.max_step_deg), 1e-3 * line.max_step_mm), "seed": line.seed}


def _numbers(text: str | None, option: str) -> Any:
    """One number, or one per joint."""
    if text is None:
        return None
    found = numbers(text)
    if found is None:
        raise InvalidOption(f"{option} takes numbers, not '{text}'")
    return found[0] if len(found) == 1 else found


def _keep(found: "PathResult", output: Path, what: str) -> None:
    """Keep the path of an interrupted command beside the file asked for."""
    with uninterrupted():
        kept = partial(output)
        found.save(output.with_name(f"{output.stem}.part{output.suffix}")).replace(kept)
        notice(f"partial: {what}, {found.status.name}, is in {kept}")


def _write(result: "PathResult", made: "Trajectory | None", line: SimpleNamespace) -> None:
    """Write the file asked for."""
    if line.output is not None:
        if made is not None:
            save = made.to_json if line.output.suffix.lower() == ".json" else made.to_csv
            notice(f"wrote {save(line.output)}")
        elif not line.retime:
            notice(f"wrote {result.save(line.output)}")
        else:
            notice(f"nothing written to {line.output}: the path is not followed, so there is no trajectory")


def _draw(result: "PathResult", made: "Trajectory | None", line: SimpleNamespace) -> None:
    """Make the pictures asked for."""
    what = result if made is None else made
    if line.plot is not None:
        from ..show.plot import plot

        plot(what, file=line.plot)
        notice(f"wrote {line.plot}")
    if line.html is not None or line.live:
        from ..show.scene import view

        scene = view(result.robot, what)
        if line.html is not None:
            present(scene, line.html)
        if line.live:
            present(scene, None)


def _payload(result: "PathResult", made: "Trajectory | None") -> dict[str, Any]:
    payload = result.to_dict()
    if made is not None:
        payload["trajectory"] = {
            "success": made.success, "message": made.message, "duration": made.duration, "samples": len(made.t),
            "deviation": dict(zip(("m", "rad"), made.deviation, strict=True)), "clearance": made.clearance,
        }  # fmt: skip
    return payload


def _show(result: "PathResult", made: "Trajectory | None") -> None:
    turn, slide = result.length
    step, glide = result.largest_step
    off, tilt = result.deviation
    slides = "prismatic" in result.robot.joint_kinds
    clearance = result.clearance
    bound = result.lower_bound
    changes = "none" if not result.reconfigurations else str(len(result.reconfigurations))
    if result.reconfigurations and bound is not None:
        changes += f" (at least {bound} are necessary)" if bound else ""
    show(
        facts(
            {
                "status": f"{result.status.name}: {result.message}",
                "poses": f"{len(result.q)}, {len(result.curve) - len(result.q)} more inserted between them",
                "reconfigurations": changes,
                "length": f"{turn:.4g} rad" + (f" and {slide:.4g} m" if slides else ""),
                "largest step": f"{math.degrees(step):.3g} deg" + (f" and {1e3 * glide:.3g} mm" if slides else ""),
                "between poses": f"off by {1e3 * off:.3g} mm and {math.degrees(tilt):.3g} deg at most (a bound)",
                "clearance": None if clearance is None else f"at least {1e3 * clearance:.3g} mm",
                "time": f"{result.elapsed:.3g} s",
                "trajectory": None if made is None else f"{made.duration:.4g} s, {len(made.t)} samples",
            }
        )
    )
    if result.reconfigurations:
        changes = table(">between poses", "<joint moving most", ">by")
        for one in result.reconfigurations:
            i = max(range(len(one.move)), key=lambda k: abs(one.move[k]))
            turning = result.robot.joint_kinds[i] != "prismatic"
            by = f"{math.degrees(one.move[i]):.4g} deg" if turning else f"{1e3 * one.move[i]:.4g} mm"
            changes.add_row(f"{one.index} and {one.index + 1}", result.robot.joint_names[i], by)
        show(changes)
    for missing in result.unreachable[:LISTED]:
        notice(f"pose {missing.index}: {missing.reason}{' (proven)' if missing.proven else ''}")
    if len(result.unreachable) > LISTED:
        notice(f"... and {len(result.unreachable) - LISTED} further poses")
