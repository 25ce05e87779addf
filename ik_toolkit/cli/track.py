"""`ik track`: follow a path with one of the tracking methods."""

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InvalidOption
from ..text import parameter
from . import solve_options as shared
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
    assignments,
    joint_vector,
    load_robot,
    narrowed,
    writes,
)
from .by_tip import choose_tips
from .obstacles import avoided
from .output import facts, notice, partial, progress, show, table, turns, unit, write_json
from .streams import uninterrupted
from .track_path import Asked, advice, asked_path, doubt_metres

if TYPE_CHECKING:
    from ..robot.robot import Robot
    from ..servo.path_reach import Survey
    from ..servo.result import TrackResult

PathOption = Annotated[
    str | None,
    typer.Option(
        "--path",
        metavar="SHAPE|FILE",
        help="circle, line, eight, or a .csv or .npz file; default: all joints swing a little.",
    ),
]
Method = Annotated[
    str,
    typer.Option(
        "-m", "--method", metavar="NAME", help="cv, av, ca, aa, aad, or a solver that can track, as lm and dls can."
    ),
]
Radius = Annotated[
    float | None,
    typer.Option(metavar="M", help="Radius of the circle, half width of the eight [m]; default: 0.1."),
]
Length = Annotated[float | None, typer.Option(metavar="M", help="Length of the line [m], along --axis; default: 0.2.")]
Axis = Annotated[
    str | None,
    typer.Option(
        metavar="X Y Z",
        help="Normal of circle and eight (default z), direction of the line (default x).",
    ),
]
Start = Annotated[
    str | None, typer.Option(metavar="X Y Z", help="Start of the path [m]; default: the tip at home or --q0.")
]
End = Annotated[str | None, typer.Option(metavar="X Y Z", help="End of the line [m]; default: --length along --axis.")]
Turns = Annotated[
    float | None,
    typer.Option("--turns", metavar="N", help="Turns of circle or eight (default 1); rounds of a line, 0: one way."),
]
Duration = Annotated[
    float | None,
    typer.Option(
        metavar="S", help="Duration of the path [s]; default: 10, or longer if joints are slow or samples few."
    ),
]
Rate = Annotated[float, typer.Option(metavar="HZ", help="Samples per second.")]
Law = Annotated[
    str | None, typer.Option(metavar="NAME", help="constant or minimum-jerk speed; default: minimum-jerk for lines.")
]
Free = Annotated[bool, typer.Option("--position-only", help="Leave the orientation free.")]
Gain = Annotated[float | None, typer.Option(metavar="K", help="Gain of cv [1/s]; default: best for the rate.")]
GainP = Annotated[
    float | None, typer.Option(metavar="K", help="Gain of ca on the error [1/s^2]; default: best for the rate.")
]
GainD = Annotated[
    float | None, typer.Option(metavar="K", help="Gain of ca on the error rate [1/s]; default: best for the rate.")
]
Params = Annotated[
    list[str] | None,
    typer.Option(
        "-p", "--param", metavar="NAME=VALUE", help="Other options: gamma, share, reading, null_damping, damping."
    ),
]
Q0 = Annotated[
    str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Start configuration; default: home, or solved for.")
]
Limits = Annotated[bool, typer.Option("--limits/--no-limits", help="Enforce joint position and speed limits.")]
Acceleration = Annotated[
    float | None, typer.Option(metavar="A", help="Acceleration limit of every joint [rad/s^2, m/s^2].")
]
PositionTolerance = Annotated[
    float,
    typer.Option("--position-tolerance", metavar="M", help="Position tolerance of a followed run [m]."),
]
OrientationTolerance = Annotated[
    float | None,
    typer.Option(
        "--orientation-tolerance", metavar="RAD", help="Orientation tolerance of a followed run; default: 0.1 degrees."
    ),
]
Relative = Annotated[
    list[str] | None,
    typer.Option(
        "--relative", metavar="TIP:OTHER", help="Keep the pose of TIP in the frame of the tip OTHER; may be repeated."
    ),
]
AvoidCollisions = Annotated[
    bool, typer.Option("--avoid-collisions", help="Slow down and slide along instead of colliding.")
]
Obstacles = Annotated[
    list[str] | None,
    typer.Option("--obstacle", metavar="KIND:...", help="Obstacle to avoid, as in ik solve; may be repeated."),
]
Settle = Annotated[
    float | None,
    typer.Option(
        metavar="S",
        help="Leave out the errors of the first S seconds; default: 0, or 0.5 with --acceleration (start at rest).",
    ),
]
OnLimit = Annotated[
    str,
    typer.Option(
        "--on-limit",
        metavar="NAME",
        help="slow: slow the reference down to stay on the path; leave: stay on time and leave the path as little as possible; "
        "clip: clip each joint on its own, as in the papers.",
    ),
]
MaxStretch = Annotated[
    float,
    typer.Option("--max-stretch", metavar="X", help="With slow: abandon a run after this many times its duration."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="FILE",
        help="Write the run to a .npz or .csv file, or to .json as a ROS JointTrajectory.",
        callback=writes(".npz", ".csv", ".json"),
    ),
]
Plot = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Draw the run to a .png, .pdf or .svg file.", callback=writes(*PLOTS)),
]


def register(app: typer.Typer) -> None:
    """Add the command of this module."""
    app.command()(track)


def track(
    robot: RobotArg,
    path: PathOption = None,
    method: Method = "cv",
    radius: Radius = None,
    length: Length = None,
    axis: Axis = None,
    start: Start = None,
    end: End = None,
    turns_: Turns = None,
    duration: Duration = None,
    rate: Rate = 100.0,
    law: Law = None,
    position_only: Free = False,
    kappa: Gain = None,
    kp: GainP = None,
    kd: GainD = None,
    param: Params = None,
    q0: Q0 = None,
    limits: Limits = True,
    acceleration: Acceleration = None,
    on_limit: OnLimit = "slow",
    max_stretch: MaxStretch = 10.0,
    mask: shared.Mask = None,
    slack: shared.Slack = None,
    free_turn: shared.FreeTurn = None,
    frame: shared.Frame = None,
    relative: Relative = None,
    avoid_collisions: AvoidCollisions = False,
    obstacle: Obstacles = None,
    margin: shared.Margin = None,
    position_tolerance: PositionTolerance = 1e-3,
    orientation_tolerance: OrientationTolerance = None,
    settle: Settle = None,
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
) -> None:
    """Follow a path with the tip and report errors, joint speeds and limits.

    Several tips of one robot (those of --tip, or the robot's own) each follow a path of their own and are tracked together.

    By default it is the path of the tip while all joints swing a little from --q0 or home, and back, which every robot can
    follow. A path that is given is used as it is; if the robot cannot follow it, the command says how far it gets and which
    changes work. Gains that are unstable at the given rate are reported, with better ones. Ctrl-C keeps the part of the run that
    is done as FILE.partial.

    Exit code 0 when every sample was within tolerance (COMPLETED, SLOWED), 1 when one was not (LEFT, LOST) or the run
    diverged.
    """
    line = SimpleNamespace(**locals())  # the command line, for what reads parts of it
    if not (rate > 0.0 and rate < float("inf")):
        raise InvalidOption(f"--rate must be positive, not {rate}")
    counts = shared.read_counting(line)
    tips = choose_tips(robot, tip, None, relative, False, group)
    arm = load_robot(robot, tips, base, lock, package_dir, deg, xacro_arg, base_xyz, base_rpy, srdf, group)
    arm = narrowed(arm, limit, deg, limits)
    first = None if q0 is None else joint_vector(arm, q0, "--q0", deg)
    asked, result = _follow(arm, line, first, counts)
    _write(result, arm, line)
    stopped, tried = None, []
    try:
        if result.reach is not None:
            tried = _changes(arm, line, asked, first, result.reach, counts)
    except KeyboardInterrupt as stop:  # the run itself is finished
        stopped = stop
    more = {"path_chosen": asked.words} if asked.words else {"works": tried} if result.reach is not None else {}
    tips_of = {"tips": [*arm.tips]} if arm.by_tip else {"tip": arm.tip}
    write_json({**result.to_dict(), "path": asked.shown, **more, "base": arm.base, **tips_of}, as_json)
    if result.reach is not None and (tried or not result.reach.whole):
        works = f"; works with {' or '.join(tried)}" if tried else ""
        notice(f"{result.reach.message or 'every pose can be reached, but not at this speed'}{works}")
    if not as_json:
        _show(result, arm, asked, deg)
    if not result.success:
        notice(f"{result.status.name}: {result.message}")
    if stopped is not None:
        raise stopped
    if not result.success:
        raise typer.Exit(1)


def _follow(arm: Any, line: SimpleNamespace, first: Any, counts: dict[str, Any]) -> "tuple[Asked, TrackResult]":
    """What was asked for, and the run; of an interrupted one the part that is done is kept beside the file asked for."""
    from ..servo.run import TrackInterrupted

    try:
        with progress("tracking", None):
            asked = asked_path(arm, line, first, counts)
            doubt_metres(arm, asked.reference)
            return asked, _run(arm, line, asked, counts)
    except TrackInterrupted as stop:
        if line.output is not None:
            with uninterrupted():
                part, kept = stop.result, partial(line.output)
                part.save(line.output.with_name(f"{line.output.stem}.part{line.output.suffix}")).replace(kept)
                notice(f"partial: {part.message.partition('; ')[0].rstrip('.')}, in {kept}")
        raise


def _write(result: "TrackResult", arm: Any, line: SimpleNamespace) -> None:
    """Write the files asked for."""
    if line.output is not None:
        with uninterrupted():
            notice(f"wrote {result.save(line.output)}")
    if line.plot is not None:
        from ..show.plot import plot as draw

        draw(result, arm, file=line.plot)
        notice(f"wrote {line.plot}")


def _run(
    arm: Any, line: SimpleNamespace, asked: Asked, counts: dict[str, Any], *, quiet: bool = False
) -> "TrackResult":
    """Follow the path; warnings are shown as notices, unless quiet."""
    from ..motion.reference import MAX_STEPS
    from ..servo.result import ORIENTATION_TOLERANCE
    from ..servo.run import track as follow

    references = asked.reference.values() if isinstance(asked.reference, Mapping) else [asked.reference]
    seconds = max(one.duration for one in references)
    if (steps := line.rate * seconds) > MAX_STEPS:
        raise InvalidOption(f"--rate {line.rate:g} over {seconds:g} s is {steps:.3g} steps; at most {MAX_STEPS:g}")
    options = {name: getattr(line, name) for name in ("kappa", "kp", "kd") if getattr(line, name) is not None}
    params = {name: parameter(name, text) for name, text in assignments(line.param, "-p").items()}
    options |= params | avoided(arm, line)
    angle = ORIENTATION_TOLERANCE if line.orientation_tolerance is None else line.orientation_tolerance
    own = {
        "robot": arm,
        "reference": asked.reference,
        "method": line.method,
        "dt": 1.0 / line.rate,
        "q0": asked.q0,
        "limits": line.limits,
        "acceleration_limits": line.acceleration,
        "position_tolerance": line.position_tolerance,
        "orientation_tolerance": angle,
        "settle": line.settle,
        "on_limit": line.on_limit,
        "max_stretch": line.max_stretch,
        **counts,
    }
    if twice := params.keys() & (own.keys() | vars(line).keys()):
        raise InvalidOption(
            f"-p cannot set {', '.join(sorted(twice))}: the command has options for that, see its --help"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: None if quiet else notice(f"warning: {message}")
        return follow(**own, **options)


def _changes(
    arm: Any, line: SimpleNamespace, asked: Asked, q: Any, found: "Survey", counts: dict[str, Any]
) -> list[str]:
    """Other options with which the robot follows the path, each tried with the rest of the command as it is."""

    def follows(path: Any, q0: Any) -> bool:
        return _run(arm, line, Asked(path, q0, ""), counts, quiet=True).success

    with progress("trying changes", None):
        return advice(arm, line, asked, q, found, follows, limits=line.limits, **counts)


def _show(result: "TrackResult", arm: "Robot", asked: Asked, deg: bool) -> None:
    figures = result.figures
    angle, of_angle = unit("revolute", deg), math.degrees(1.0) if deg else 1.0
    gains = ", ".join(f"{name} = {value:.5g}" for name, value in result.options.items())
    check = result.gain_check
    steps = len(result.t) - 1
    tried = f", {result.searched:.3g} s of trying other runs" if result.searched > result.elapsed else ""
    show(
        facts(
            {
                "robot": f"{result.robot} ({arm.base} -> {' and '.join(arm.tips)})",
                "path": f"{asked.words} (chosen)" if asked.words else asked.shown,
                "method": f"{result.method}{', ' + gains if gains else ''}; {steps} steps of {result.dt:.5g} s",
                "stability": None if check is None else f"{check.verdict} at rest, spectral radius {check.radius:.4g}",
                "status": f"{result.status.name}: {result.message}",
                "time": f"{result.elapsed:.3g} s of stepping{tried}",
            }
        )
    )
    errors = table("<error", ">max", ">RMS", ">final", ">max,\n2nd half", ">between\nsamples")
    for name, measure, factor in (("position", "m", 1.0), ("orientation", angle, of_angle)):
        if name in figures:
            row = figures[name]
            keys = ("max", "rms", "final", "settled_max", "between_max")
            errors.add_row(f"{name} [{measure}]", *(f"{factor * row[key]:.3g}" if key in row else "-" for key in keys))
    same = all(turns(kind) for kind in arm.joint_kinds)
    peaks = (
        f">{name}\n[{angle if same else 'unit'}/{per}]"
        for name, per in (("speed", "s"), ("accel.", "s2"), ("jerk", "s3"))
    )
    joints = table("<joint", *peaks, ">of\nlimit", ">at\nlimit")
    for i, (name, kind) in enumerate(zip(result.joint_names, arm.joint_kinds, strict=True)):
        limit = float(arm.velocity_limits[i])
        speed, factor = figures["peak_speed"][i], of_angle if turns(kind) else 1.0
        joints.add_row(
            name if same else f"{name} [{unit(kind, deg)}]",
            *(f"{factor * figures[key][i]:.3g}" for key in ("peak_speed", "peak_acceleration", "peak_jerk")),
            f"{100 * speed / limit:.0f} %" if 0.0 < limit < float("inf") else "-",
            f"{figures['time_at_limits_by_joint'][name]:.3g} s",
        )
    show(errors, joints)
    if figures["jumps"]:
        move = figures["largest_move"]
        kind = arm.joint_kinds[result.joint_names.index(move["joint"])]
        by = f"{(of_angle if turns(kind) else 1.0) * move['value']:.3g} {unit(kind, deg)}"
        notice(f"{figures['jumps']} step(s) moved a joint far: {move['joint']} by {by} at t = {move['time']:.4g} s")
