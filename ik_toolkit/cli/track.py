"""`ik track`: follow a path with one of the tracking methods."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InvalidOption, near_match
from ..text import parameter, vector
from .arguments import (
    PLOTS,
    Base,
    Deg,
    Json,
    Lock,
    PackageDir,
    RobotArg,
    Tip,
    assignments,
    joint_vector,
    load_robot,
    writes,
)
from .output import facts, notice, show, table, turns, write_json

if TYPE_CHECKING:
    from ..robot.robot import Robot
    from ..tracking.reference import Reference
    from ..tracking.result import TrackResult

SHAPES = ("circle", "line", "eight")
PathOption = Annotated[
    str, typer.Option("--path", metavar="SHAPE|FILE", help="circle, line, eight, or a .csv or .npz file.")
]
Method = Annotated[
    str, typer.Option("-m", "--method", metavar="NAME", help="cv av ca aa aad, or a solver (see ik solvers).")
]
Radius = Annotated[float, typer.Option(metavar="M", help="Radius of the circle, half width of the eight [m].")]
Length = Annotated[float, typer.Option(metavar="M", help="Length of the line [m], along --axis.")]
Axis = Annotated[
    str | None,
    typer.Option(metavar="X Y Z", help="Normal of the circle (default z) or direction of the line (default x)."),
]
Start = Annotated[
    str | None, typer.Option(metavar="X Y Z", help="Where the path starts [m]; default: the tip at home or --q0.")
]
End = Annotated[
    str | None, typer.Option(metavar="X Y Z", help="Where the line ends [m]; default: --length along --axis.")
]
Turns = Annotated[
    float,
    typer.Option("--turns", metavar="N", help="Turns of circle or eight (default 1); rounds of a line, 0: one way."),
]
Duration = Annotated[float, typer.Option(metavar="S", help="How long the path takes [s].")]
Rate = Annotated[float, typer.Option(metavar="HZ", help="Samples per second.")]
Law = Annotated[
    str | None, typer.Option(metavar="NAME", help="constant or minimum-jerk speed; default: minimum-jerk for lines.")
]
Free = Annotated[bool, typer.Option("--position-only", help="Leave the orientation free.")]
Gain = Annotated[float | None, typer.Option(help="Gain of cv [1/s]; default: the best for the rate.")]
GainP = Annotated[float | None, typer.Option(help="Gain of ca on the error [1/s^2]; default: the best for the rate.")]
GainD = Annotated[
    float | None, typer.Option(help="Gain of ca on the error's rate [1/s]; default: the best for the rate.")
]
Params = Annotated[
    list[str] | None,
    typer.Option("-p", "--param", metavar="NAME=VALUE", help="Other options: gamma, reading, null_damping, damping."),
]
Q0 = Annotated[
    str | None, typer.Option("--q0", metavar="Q1 Q2 ...", help="Where the joints start; default: home, or solved.")
]
Limits = Annotated[
    bool, typer.Option("--limits/--no-limits", help="Keep joint positions and speeds inside their limits.")
]
Acceleration = Annotated[
    float | None, typer.Option(metavar="A", help="Acceleration limit of every joint [rad/s^2, m/s^2].")
]
PositionTolerance = Annotated[
    float,
    typer.Option("--tolerance-position", metavar="M", help="Largest position error of a run that counts as followed."),
]
OrientationTolerance = Annotated[
    float | None,
    typer.Option("--tolerance-orientation", metavar="RAD", help="The same of the orientation; default: 0.1 degrees."),
]
Settle = Annotated[
    float | None,
    typer.Option(metavar="S", help="Time before errors count; default: 0, with --acceleration (a start at rest) 0.5."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "-o", "--output", metavar="FILE", help="Write the run to a .npz or .csv file.", callback=writes(".npz", ".csv")
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
    path: PathOption = "circle",
    method: Method = "cv",
    radius: Radius = 0.1,
    length: Length = 0.2,
    axis: Axis = None,
    start: Start = None,
    end: End = None,
    turns_: Turns = 0.0,
    duration: Duration = 10.0,
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
    tolerance_position: PositionTolerance = 1e-3,
    tolerance_orientation: OrientationTolerance = None,
    settle: Settle = None,
    tip: Tip = None,
    base: Base = None,
    lock: Lock = None,
    package_dir: PackageDir = None,
    deg: Deg = False,
    as_json: Json = False,
    output: Out = None,
    plot: Plot = None,
) -> None:
    """Follow a path with the tip and report errors, joint speeds and limits.

    Gains that are unstable at the rate are said before the run, with better ones. Exit code 0 when every sample was inside the
    tolerances (COMPLETED, SLOWED), 1 when one was not (LEFT, LOST) or the run diverged.
    """
    if not (rate > 0.0 and rate < float("inf")):
        raise InvalidOption(f"--rate must be positive, not {rate}")
    arm = load_robot(robot, tip, base, lock, package_dir, deg)
    options = {name: value for name, value in (("kappa", kappa), ("kp", kp), ("kd", kd)) if value is not None}
    options |= {name: parameter(name, text) for name, text in assignments(param, "-p").items()}
    first = None if q0 is None else joint_vector(arm, q0, "--q0", deg)

    from ..tracking.track import track as follow
    from ..tracking.verdict import ORIENTATION_TOLERANCE

    reference = _reference(arm, path, first, start, end, axis, radius, length, turns_, duration, law, position_only)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: notice(f"warning: {message}")
        begin = arm.home if first is None and start is None and path in SHAPES else first
        result = follow(
            arm,
            reference,
            method,
            dt=1.0 / rate,
            q0=begin,
            limits=limits,
            acceleration_limits=acceleration,
            position_tolerance=tolerance_position,
            orientation_tolerance=ORIENTATION_TOLERANCE if tolerance_orientation is None else tolerance_orientation,
            settle=settle,
            **options,
        )
    if output is not None:
        notice(f"wrote {result.save(output)}")
    if plot is not None:
        from ..show.tracking import plot_track

        notice(f"wrote {plot_track(result, arm, plot)}")
    write_json({**result.to_dict(), "path": repr(reference), "base": arm.base, "tip": arm.tip}, as_json)
    if not as_json:
        _show(result, arm, reference)
    if not result.success:
        notice(f"{result.status.name}: {result.message}")
        raise typer.Exit(1)


def _reference(
    arm: "Robot",
    path: str,
    q: Any,
    start: str | None,
    end: str | None,
    axis: str | None,
    radius: float,
    length: float,
    turns_: float,
    duration: float,
    law: str | None,
    position_only: bool,
) -> "Reference":
    """Reference of the path options; it starts at the tip unless --start says otherwise, and keeps the tip's orientation."""
    import numpy as np

    from ..tracking import shapes
    from ..tracking.waypoints import reference_from_file

    if path not in SHAPES:
        if Path(path).suffix.lower() not in (".csv", ".npz"):
            raise InvalidOption(f"no path '{path}'.{near_match(path, SHAPES)} Or give a .csv or .npz file.")
        return reference_from_file(path)
    T = arm.fk(arm.home if q is None else q).homogeneous
    if start is not None:
        T[:3, 3] = vector(start, "--start", 3)
    at: Any = T[:3, 3].copy() if position_only else T
    direction = None if axis is None else np.array(vector(axis, "--axis", 3))
    if path == "circle":
        normal = (0.0, 0.0, 1.0) if direction is None else direction.tolist()
        return shapes.circle(at, radius, normal=normal, turns=turns_ or 1.0, duration=duration, law=law or "constant")
    if path == "eight":
        cycles = [(turns_ or 1.0) * k for k in (1.0, 2.0, 1.0)]
        amplitudes = (radius, 0.5 * radius, 0.0)
        return shapes.lissajous(at, amplitudes, cycles=cycles, duration=duration, law=law or "constant")
    if end is not None:
        last = np.array(vector(end, "--end", 3))
    else:
        direction = np.array([1.0, 0.0, 0.0]) if direction is None else direction
        size = float(np.linalg.norm(direction))
        if not size > 0.0:
            raise InvalidOption("--axis must not be zero")
        last = T[:3, 3] + length * direction / size
    T1 = T.copy()
    T1[:3, 3] = last
    return shapes.line(
        at, last if position_only else T1, duration=duration, law=law or "minimum-jerk", rounds=int(turns_)
    )


def _show(result: "TrackResult", arm: "Robot", reference: "Reference") -> None:
    figures = result.figures
    gains = ", ".join(f"{name} = {value:.5g}" for name, value in result.options.items())
    check = result.gain_check
    steps = len(result.t) - 1
    show(
        facts(
            {
                "robot": f"{result.robot} ({arm.base} -> {arm.tip})",
                "path": repr(reference),
                "method": f"{result.method}{', ' + gains if gains else ''}; {steps} steps of {result.dt:.5g} s",
                "stability": None if check is None else f"{check.verdict} at rest, spectral radius {check.radius:.4g}",
                "status": f"{result.status.name}: {result.message}",
                "time": f"{result.elapsed * 1e3:.3g} ms of stepping",
            }
        )
    )
    errors = table("<error", ">max", ">RMS", ">final", ">second half, max", ">between samples")
    for name, unit in (("position", "m"), ("orientation", "rad")):
        if name in figures:
            row = figures[name]
            keys = ("max", "rms", "final", "settled_max", "between_max")
            errors.add_row(f"{name} [{unit}]", *(f"{row[key]:.3g}" if key in row else "-" for key in keys))
    joints = table("<joint", ">peak speed", ">of limit", ">peak acceleration", ">peak jerk", ">held back")
    for i, (name, kind) in enumerate(zip(result.joint_names, arm.joint_kinds, strict=True)):
        unit = "rad" if turns(kind) else "m"
        limit = float(arm.velocity_limits[i])
        speed = figures["peak_speed"][i]
        joints.add_row(
            name,
            f"{speed:.3g} {unit}/s",
            f"{100 * speed / limit:.0f} %" if 0.0 < limit < float("inf") else "-",
            f"{figures['peak_acceleration'][i]:.3g} {unit}/s2",
            f"{figures['peak_jerk'][i]:.3g} {unit}/s3",
            f"{figures['time_at_limits_by_joint'][name]:.3g} s",
        )
    show(errors, joints)
    if figures["jumps"]:
        move = figures["largest_move"]
        notice(
            f"{figures['jumps']} step(s) moved a joint far: {move['joint']} by {move['value']:.3g} at t = {move['time']:.4g} s"
        )
