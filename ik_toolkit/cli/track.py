"""`ik track`: follow a path with one of the tracking methods."""

import functools
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import typer

from ..errors import InvalidOption
from ..text import angle, duration, equations, figure, length
from .command import above_zero, command, flag, option, options
from .gains import along_the_path, judged
from .options import CollisionOptions, RobotOptions, SceneOutput, ToleranceOptions, joint_vector, parameters
from .output import keep_partial, notice, progress, show, table, turns, unit, write_json
from .pictures import chart, show_scene
from .streams import uninterrupted
from .target import CountOptions
from .track_path import Asked, TrackOptions, advice, asked_path


@options()
class TrackCounts(CountOptions):
    """Options for which components of the path's poses count."""

    relative: list[str] | None = option(
        "TIP:OTHER", "Keep the pose of TIP in the frame of the tip OTHER; may be repeated.", panel="Target"
    )


@options("Collisions")
class TrackCollisions(CollisionOptions):
    """Options for collisions to avoid along the path."""

    avoid_collisions: bool = flag("--avoid-collisions", "Slow down and slide along instead of colliding.")
    obstacle: list[str] | None = option("KIND:...", "Obstacle to avoid, as in ik solve; may be repeated.")


@options("Tolerances")
class TrackTolerances(ToleranceOptions):
    """Options for the tolerances within which a run counts as followed."""

    tolerance: None = None  # `ik track` has no --tolerance, which sets both tolerances at once in other commands.
    position_tolerance: float = option("M", "Position tolerance of a followed run [m].", default=1e-3)
    orientation_tolerance: float | None = option(
        "RAD", "Orientation tolerance of a followed run [rad; degrees with --deg]; default: 0.1 degrees."
    )


@command
def track(
    asked: TrackOptions,
    counts: TrackCounts,
    collisions: TrackCollisions,
    tolerances: TrackTolerances,
    robot: RobotOptions,
    out: SceneOutput,
) -> None:
    """Follow a path with the tip and report errors, joint speeds and limits.

    Several tips of one robot (those of --tip, or the robot's own) each follow a path of their own and are tracked together.

    By default it is the path of the tip while all joints swing a little from --q0 or home, and back, which every robot can
    follow. A path that is given is used as it is; if the robot cannot follow it, the command says how far it gets and which
    changes work. Gains that are unstable at the given rate are reported, with better ones. Ctrl-C keeps the part of the run that
    is done as FILE.partial.

    Exit code 0 when every sample was within tolerance (COMPLETED, SLOWED), 1 when one was not (LEFT, LOST) or the run
    diverged.

    Examples:
    ik track hydrolek_7w --path circle
    ik track hydrolek_7w --path eight --radius 0.08 --position-only --plot run.png
    ik track hydrolek_7w --path line --length 0.2 --on-limit leave
    ik track hydrolek_7w --path circle --html run.html
    """
    above_zero(asked.rate, "--rate")
    what = counts.read(robot.deg, counts.relative)
    arm = robot.load(robot.choose_tips())
    q = joint_vector(arm, asked.q0, "--q0", robot.deg)
    own = {name for record in (asked, counts, collisions, tolerances, robot, out) for name in vars(record)}
    around = collisions.read(arm, robot.deg)

    def run(path: Asked, quiet: bool = False, **more: Any) -> Any:
        return _run(arm, asked, path, own, tolerances.read(robot.deg) | what | around | more, quiet)

    path, result = _follow(arm, asked, q, what, tolerances.position_tolerance, run)
    if asked.output is not None:
        with uninterrupted():
            notice(f"wrote {result.save(asked.output)}")
    chart(asked.plot, result, arm)
    shown = around.get("avoid_collisions")
    show_scene(arm, result, out.html, out.live, obstacles=None if isinstance(shown, bool | None) else shown)
    stopped, tried = None, []
    try:
        if result.reach is not None:
            with progress("trying changes", None):
                tried = advice(arm, asked, path, q, result.reach, run, robot.deg, limits=asked.limits, **what)
    except KeyboardInterrupt as stop:  # The run itself is complete, so its results are printed after Ctrl-C too.
        stopped = stop
    more = {"path_chosen": path.words} if path.words else {"works": tried} if result.reach is not None else {}
    tips = {"tips": [*arm.tips]} if arm.named_tips else {"tip": arm.tip}
    write_json({**result.to_dict(), "path": path.shown, **more, "base": arm.base, **tips}, out.as_json)
    if result.reach is not None and (tried or not result.reach.whole):
        works = f"; works with {' or '.join(tried)}" if tried else ""
        notice(f"{result.reach.message or 'every pose can be reached, but not at this speed'}{works}")
    check = along_the_path(arm, result.gain_check, path.reference, result.options)
    if not out.as_json:
        _show(result, arm, path, robot.deg, check)
    if check is not None and check.along is not None and not check.stable:
        notice(f"warning: {check.message}")
    if not result.success:
        notice(f"{result.status.name}: {result.message}")
    if stopped is not None:
        raise stopped
    if not result.success:
        raise typer.Exit(1)


def _follow(
    arm: Any, asked: TrackOptions, q: Any, counts: dict[str, Any], tolerance: float, run: Callable[[Asked], Any]
) -> tuple[Asked, Any]:
    """Return the path to follow and its tracking run; of an interrupted run, the finished part is saved next to the output file."""
    from ..servo.run import TrackInterrupted

    try:
        with progress("tracking", None):
            path = asked_path(arm, asked, q, counts, tolerance)
            return path, run(path)
    except TrackInterrupted as stop:
        if asked.output is not None:
            keep_partial(stop.result, asked.output, f"{stop.result.message.partition('; ')[0].rstrip('.')},")
        raise


def _run(arm: Any, asked: TrackOptions, path: Asked, own: set[str], more: dict[str, Any], quiet: bool) -> Any:
    """Follow the path; warnings are shown as notices, unless quiet. own: names that -p must not set; more: other options."""
    from ..motion.reference import MAX_STEPS
    from ..servo.result import ORIENTATION_TOLERANCE
    from ..servo.run import track as follow

    references = path.reference.values() if isinstance(path.reference, Mapping) else [path.reference]
    seconds = max(one.duration for one in references)
    if (steps := asked.rate * seconds) > MAX_STEPS:
        raise InvalidOption(f"--rate {asked.rate:g} over {seconds:g} s is {steps:.3g} steps; at most {MAX_STEPS:g}")
    fixed = {name: getattr(asked, name) for name in ("method", "limits", "settle", "on_limit", "max_stretch")} | more
    fixed |= {"reference": path.reference, "q0": path.q0}
    fixed |= {"dt": 1.0 / asked.rate, "acceleration_limits": asked.acceleration}
    fixed.setdefault("orientation_tolerance", ORIENTATION_TOLERANCE)
    params = parameters(asked.param)
    if twice := params.keys() & (fixed.keys() | own):
        raise InvalidOption(
            f"-p cannot set {', '.join(sorted(twice))}: the command has options for that, see its --help"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *_: None if quiet else notice(f"warning: {message}")
        return follow(arm, **fixed, **asked.gains, **params)


def _show(result: Any, arm: Any, path: Asked, deg: bool, check: Any) -> None:
    figures = result.figures
    of_angle = math.degrees(1.0) if deg else 1.0
    gains = equations(result.options)
    steps = len(result.t) - 1
    tried = f", {duration(result.searched)} of trying other runs" if result.searched > result.elapsed else ""
    show({
        "robot": f"{result.robot} ({arm.base} -> {' and '.join(arm.tips)})",
        "path": f"{path.words} (chosen)" if path.words else path.shown,
        "method": f"{result.method}{', ' + gains if gains else ''}; {steps} steps of {duration(result.dt, 5)}",
        "stability": None if check is None else judged(check),
        "status": f"{result.status.name}: {result.message}",
        "computed in": f"{duration(result.elapsed)} of stepping{tried}",
    })  # fmt: skip
    errors = table("<error", ">max", ">RMS", ">final", ">max,\n2nd half", ">between\nsamples")
    for name, words in (("position", length), ("orientation", functools.partial(angle, deg=deg))):
        if name in figures:
            row = figures[name]
            keys = ("max", "rms", "final", "settled_max", "between_max")
            errors.add_row(name, *(words(row[key]) if key in row else "-" for key in keys))
    same = all(turns(kind) for kind in arm.joint_kinds)
    peaks = (
        f">{name}\n[{unit('revolute', deg) if same else 'unit'}/{per}]"
        for name, per in (("speed", "s"), ("accel.", "s2"), ("jerk", "s3"))
    )
    joints = table("<joint", *peaks, ">of\nlimit", ">at\nlimit")
    for i, (name, kind) in enumerate(zip(result.joint_names, arm.joint_kinds, strict=True)):
        limit = float(arm.velocity_limits[i])
        speed, factor = figures["peak_speed"][i], of_angle if turns(kind) else 1.0
        joints.add_row(
            name if same else f"{name} [{unit(kind, deg)}]",
            *(figure(factor * figures[key][i]) for key in ("peak_speed", "peak_acceleration", "peak_jerk")),
            f"{100 * speed / limit:.0f} %" if 0.0 < limit < float("inf") else "-",
            duration(figures["time_at_limits_by_joint"][name]),
        )
    show(errors, joints)
    if figures["jumps"]:
        move = figures["largest_move"]
        kind = arm.joint_kinds[result.joint_names.index(move["joint"])]
        by = angle(move["value"], deg) if turns(kind) else length(move["value"])
        notice(f"{figures['jumps']} step(s) moved a joint far: {move['joint']} by {by} at t = {move['time']:.4g} s")
