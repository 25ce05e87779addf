"""The path of `ik track`: given by options, or one that every robot can follow; and advice if the robot cannot follow it."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import InvalidOption, near_match, whole
from ..text import vector
from .command import PLOTS, flag, option, options
from .output import number

SHAPES = ("circle", "line", "eight")
# Default radius [m] of a circle or eight, length [m] of a line, and duration [s] of a path.
RADIUS, LENGTH, DURATION = 0.1, 0.2, 10.0
PLACE = {  # For each kind of path, the options for its place and size; a path from a file has none.
    "circle": ("radius", "axis", "start"),
    "eight": ("radius", "axis", "start"),
    "line": ("length", "axis", "start", "end"),
    "file": (),
}
TIMES = ("duration", "law", "turns")
DRAWN = ("radius", "length", "axis", "start", "end", *TIMES)
# Any of these options asks for a circle if no kind of path is given. The duration alone does not.
PLACED = (*DRAWN[:5], "law", "turns")
AXES = ("1 0 0", "0 1 0", "0 0 1", "-1 0 0", "0 -1 0", "0 0 -1")


@options()
class PathOptions:
    """Options for a path to follow, and the tracking method with its gains."""

    path: str | None = option(
        "SHAPE|FILE", "circle, line, eight, or a .csv or .npz file; default: all joints swing a little."
    )
    method: str = option(
        "NAME", "cv, av, ca, aa, aad, or a solver that can track, as lm and dls can.", "-m", "--method", default="cv"
    )
    radius: float | None = option("M", "Radius of the circle, half width of the eight [m]; default: 0.1.")
    length: float | None = option("M", "Length of the line [m], along --axis; default: 0.2.")
    axis: str | None = option("X Y Z", "Normal of circle and eight (default z), direction of the line (default x).")
    start: str | None = option("X Y Z", "Start of the path [m]; default: the tip at home or --q0.")
    end: str | None = option("X Y Z", "End of the line [m]; default: --length along --axis.")
    turns: float | None = option("N", "Turns of circle or eight (default 1); rounds of a line, 0: one way.")
    duration: float | None = option(
        "S", "Duration of the path [s]; default: 10, or longer if joints are slow or samples few."
    )
    rate: float = option("HZ", "Samples per second.", default=100.0)
    law: str | None = option("NAME", "constant or minimum-jerk speed; default: minimum-jerk for lines.")
    position_only: bool = flag("--position-only", "Leave the orientation free.")
    kappa: float | None = option("K", "Gain of cv [1/s]; default: best for the rate.")
    kp: float | None = option("K", "Gain of ca on the error [1/s^2]; default: best for the rate.")
    kd: float | None = option("K", "Gain of ca on the error rate [1/s]; default: best for the rate.")
    param: list[str] | None = option(
        "NAME=VALUE", "Other options: gamma, share, reading, null_damping, damping.", "-p", "--param", panel="Solver"
    )
    q0: str | None = option(
        "Q1 Q2 ...", "Start configuration; default: home, or solved for.", panel="Start and preferences"
    )

    @property
    def shape(self) -> str | None:
        """The kind of path or the file that was asked for; 'circle' if only options of its shape were given, else None."""
        return self.path or ("circle" if any(getattr(self, name) is not None for name in PLACED) else None)

    @property
    def size(self) -> float:
        """Length of the line, or radius of the circle or eight [m], as given or by default."""
        given, usual = (self.length, LENGTH) if self.shape == "line" else (self.radius, RADIUS)
        return usual if given is None else given

    @property
    def gains(self) -> dict[str, float]:
        """The gains kappa, kp and kd that are given, by name."""
        return {name: gain for name, gain in vars(self).items() if name in ("kappa", "kp", "kd") and gain is not None}

    def rest(self) -> dict[str, Any]:
        """Return keyword arguments for the functions that make a circle, line or eight: duration [s], speed law, turns."""
        duration = DURATION if self.duration is None else self.duration
        return {"duration": duration, "law": self.law, "turns": self.turns or 0.0}

    def read_axis(self) -> Any:
        """Return the axis (3,) of --axis, or None. Raises InvalidOption."""
        axis = None if self.axis is None else vector(self.axis, "--axis", 3)
        if axis is not None and not any(axis):
            raise InvalidOption("--axis must not be zero")
        return axis

    def check(self) -> None:
        """Raise InvalidOption for options that the kind of path does not have, such as --radius for a line."""
        if self.shape is None:
            return
        kind = self.shape if self.shape in SHAPES else "file"
        fit = PLACE[kind] + (TIMES if kind != "file" else ())
        what = "a path from a file" if kind == "file" else f"--path {kind}"
        if self.end is not None and kind == "line":
            fit, what = tuple(name for name in fit if name not in ("length", "axis")), f"{what} with --end"
        odd = [f"--{name}" for name in DRAWN if getattr(self, name) is not None and name not in fit]
        if odd:
            takes = f"; it takes {', '.join(f'--{name}' for name in fit)}" if fit else ", which says all of it"
            raise InvalidOption(f"{', '.join(odd)} cannot be used with {what}{takes}")
        if self.turns == 0.0 and kind != "line":
            raise InvalidOption(f"--turns must not be 0 with --path {kind}; only a line has none, which is one way")


@options()
class TrackOptions(PathOptions):
    """Options of `ik track`: the path, how it is followed, and which files are written."""

    limits: bool = flag(
        "--limits/--no-limits", "Enforce joint position and speed limits.", default=True, panel="Solver"
    )
    acceleration: float | None = option("A", "Acceleration limit of every joint [rad/s^2, m/s^2].")
    on_limit: str = option(
        "NAME",
        "slow: slow the reference down to stay on the path; leave: stay on time and leave the path as little as possible; "
        "clip: clip each joint on its own, as in the papers.",
        default="slow",
        needs=["--limits"],
    )
    max_stretch: float = option(
        "X", "With slow: abandon a run after this many times its duration.", default=10.0, needs=["--on-limit slow"]
    )
    settle: float | None = option(
        "S", "Leave out the errors of the first S seconds; default: 0, or 0.5 with --acceleration (start at rest)."
    )
    output: Path | None = option(
        "FILE",
        "Write the run to a .npz or .csv file, or to .json as a ROS JointTrajectory.",
        "-o",
        "--output",
        writes=[".npz", ".csv", ".json"],
    )
    plot: Path | None = option("FILE", "Draw the run to a .png, .pdf or .svg file.", writes=PLOTS)


class Asked(NamedTuple):
    """A path that `ik track` follows.

    `reference` is the path as a function of time, `q0` (n,) [rad or m] the initial joint values (None: solved for), and `words` a
    sentence on how the path was chosen, or ''.
    """

    reference: Any
    q0: Any
    words: str

    @property
    def shown(self) -> str:
        """Text that describes the path for the output: its name and duration, for several tips one after another."""
        if isinstance(self.reference, Mapping):
            return "; ".join(f"{tip}: {_line(one)}" for tip, one in self.reference.items())
        return _line(self.reference)


def _line(reference: Any) -> str:
    """Return a line of text that describes a reference."""
    return f"{reference.name} in {reference.duration:g} s{', orientation free' if reference.position_only else ''}"


def asked_path(arm: Any, asked: PathOptions, q: Any, counts: dict[str, Any], tolerance: float) -> Asked:
    """Return the path that the options ask for, or one that every robot can follow if they ask for none. Raises InvalidOption.

    q: joint values (n,) of --q0, or None. counts: options by name that say which part of a target's error counts, and which targets
    are relative to another tip (relative_to). tolerance [m]: position tolerance of the run.
    """
    from ..motion.waypoints import reference_from_file
    from ..servo.path_reach import freed

    asked.check()
    if asked.shape is None and not counts.get("relative_to"):
        from ..servo.default_path import joint_motion

        motion = joint_motion(
            arm, q, position_only=asked.position_only, duration=asked.duration, dt=1.0 / asked.rate,
            position_tolerance=tolerance,
        )  # fmt: skip
        seconds = next(iter(motion.values())).duration if isinstance(motion, Mapping) else motion.duration
        start = "home" if q is None else "--q0"
        words = f"all joints swing a little from {start}, and back, in {seconds:g} s"
        return Asked(motion, arm.home if q is None else q, words)
    if asked.path is not None and asked.path not in SHAPES:
        if Path(asked.path).suffix.lower() not in (".csv", ".npz"):
            raise InvalidOption(f"no path '{asked.path}'.{near_match(asked.path, SHAPES)} Or give a .csv or .npz file.")
        reference = reference_from_file(asked.path)
        return Asked(freed(reference) if asked.position_only and not reference.position_only else reference, q, "")
    return Asked(_drawn(arm, asked, q, counts), arm.home if q is None and asked.start is None else q, "")


def _drawn(arm: Any, asked: PathOptions, q: Any, counts: dict[str, Any]) -> Any:
    """Return the path given by options: from the tip at --q0 or home, or from --start, with the tip's orientation."""
    from ..servo.default_path import paths

    if asked.start is not None or (asked.shape == "line" and asked.end is not None):
        if arm.by_tip:
            raise InvalidOption("--start and --end are for one tip; choose it with --tip")
        return _from_to(arm.fk(arm.home if q is None else q).homogeneous, asked)
    start, drawn = arm.home if q is None else q, (asked.shape or "circle", asked.size, asked.read_axis())
    return paths(arm, start, *drawn, asked.position_only, counts.get("relative_to") or {}, **asked.rest())


def _from_to(T: Any, asked: PathOptions) -> Any:
    """Return the path from --start, or to --end, of a tip whose pose is T."""
    from ..motion import shapes
    from ..servo.default_path import draw

    if asked.start is not None:
        T[:3, 3] = vector(asked.start, "--start", 3)
    at: Any = T[:3, 3].copy() if asked.position_only else T
    if asked.shape != "line" or asked.end is None:
        return draw(asked.shape or "circle", at, asked.size, asked.read_axis(), **asked.rest())
    end = T.copy()
    end[:3, 3] = vector(asked.end, "--end", 3)
    rounds = whole(asked.turns or 0.0, "rounds of a line", 0)
    timed = {"duration": asked.rest()["duration"], "law": asked.law or "minimum-jerk", "rounds": rounds}
    return shapes.line(at, end[:3, 3] if asked.position_only else end, **timed)


def advice(
    arm: Any, asked: TrackOptions, path: Asked, q: Any, found: Any, run: Callable[..., Any], deg: bool, **options: Any
) -> list[str]:
    """Return advice for a path that the robot cannot follow: options of `ik track` to change, each of which was tried and works.

    run(Asked, quiet): a function that tracks a path with the other options of the command.
    """
    from ..servo.path_reach import other_start, trace

    def follows(reference: Any, q0: Any) -> bool:
        return run(Asked(reference, q0, ""), True).success

    def drawn(more: dict[str, Any]) -> Any:
        return _drawn(arm, replace(asked, **more), q, options)

    if found.whole:
        share, seconds = found.pace[0], asked.duration or DURATION
        slower = float(f"{1.1 * share * seconds:.2g}")
        fits = share > 1.0 and asked.shape in SHAPES and follows(drawn({"duration": slower}), path.q0)
        return [f"--duration {slower:g}"] if fits else []
    one: dict[str, str] = {}  # For each option, the first change that works: for a size the largest, or an axis.
    for words, more in _ways(asked, found):
        name = words.split()[0]
        if name in one:
            continue
        other = drawn(more)
        if trace(arm, other, path.q0, **options) is not None and follows(other, path.q0):
            one[name] = words
    if "priority" not in options and run(path, True, priority="position").success:
        one["--priority"] = "--priority position"
    elsewhere = other_start(arm, path.reference, **options)
    if elsewhere is not None and follows(path.reference, elsewhere):
        shown = (number(float(x), kind, deg) for x, kind in zip(elsewhere, arm.joint_kinds, strict=True))
        one["--q0"] = f"--q0 {' '.join(shown)}"
    return [*one.values()]


def _ways(asked: TrackOptions, found: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield other options to try: as text, and as changed values of the options."""
    from ..servo.path_reach import smaller

    if asked.shape not in SHAPES:
        return
    if not asked.position_only:
        yield "--position-only", {"position_only": True}
    name = "length" if asked.shape == "line" else "radius"
    size = asked.size
    if asked.end is None:
        for factor in smaller(found):
            shorter = float(f"{factor * size:.3g}")
            yield f"--{name} {shorter:g}", {name: shorter}
        for axis in AXES:
            yield f"--axis {axis}", {"axis": axis}
