"""The options that several commands share: the robot, what counts of a target, collisions, tolerances, output."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import FrameNotFound, InvalidConfiguration, InvalidOption
from ..text import comma_hint, numbers, parameter, vector, with_points
from .command import TIP, argument, can_show, flag, in_radians, option, options
from .completion import links_like, robots_like, tips_like
from .output import notice, turns

OBSTACLES = {  # For each kind of obstacle, the numbers that describe it, and how many of these are sizes.
    "box": ("x,y,z,sx,sy,sz[,roll,pitch,yaw]", 3),
    "sphere": ("x,y,z,radius", 1),
    "cylinder": ("x,y,z,radius,length[,roll,pitch,yaw]", 2),
}


# -------------------------------------------------------------------------------------------------------------- output
@options("Output")
class JsonOutput:
    """The option --json of a command."""

    as_json: bool = flag("--json", "Print one JSON object, always in metres and radians.")


@options("Output")
class TableOutput(JsonOutput):
    """The options --json and --csv of a command whose result is a table."""

    csv_file: Path | None = option(
        "FILE", "Write the table to a .csv, in metres and radians.", "--csv", writes=[".csv"]
    )


@options("Output")
class ObjectOutput(JsonOutput):
    """The options --json and -o of a command whose result is one JSON object."""

    output: Path | None = option("FILE", "Also write the JSON object to a .json.", "-o", "--output", writes=[".json"])


@options("Output")
class SceneOutput(JsonOutput):
    """The options --json, --html and --view of a command whose result can be shown in 3-D."""

    html: Path | None = option(
        "FILE", "Write the scene as one HTML file that needs no network.", "--html", writes=[".html", ".htm"]
    )
    live: bool = flag("--view", "Show the robot in 3-D in the browser, until Ctrl-C.", callback=can_show)


# --------------------------------------------------------------------------------------------------------------- robot
@options("Robot")
class RobotOptions:
    """Options for the robot: which one, its tips, its base, and how its description is read."""

    robot: str = argument(
        "ROBOT",
        "Robot name (see ik robots), or path of a URDF, xacro or MJCF file; - reads one from stdin.",
        complete=robots_like,
    )
    tip: list[str] | None = option(
        "FRAME", "Tip: a frame, link or joint; repeat to solve for several tips together.", *TIP, complete=tips_like
    )
    base: str | None = option("FRAME", "Base frame of targets and poses; default: the root link.", complete=links_like)
    base_xyz: str | None = option(
        "X Y Z", "Where the robot's root stands in the world [m]; targets and poses are then given in the world."
    )
    base_rpy: str | None = option("R P Y", "How it stands there: roll, pitch, yaw [rad].")
    rail: str | None = option(
        "LOWER UPPER",
        "Put the robot on a rail along x, with these limits [m]: joint base_x.",
        without=["--base-xyz", "--base-rpy"],
    )
    lock: list[str] | None = option("JOINT=VALUE", "Hold a joint at a value; may be repeated.")
    limit: list[str] | None = option(
        "JOINT:LOWER:UPPER",
        "Narrow the limits of a joint [rad, m; degrees with --deg]; an end left empty stays; may be repeated.",
        needs=["--limits"],
    )
    package_dir: list[str] | None = option("DIR", "Folder to search for package:// names.")
    xacro_arg: list[str] | None = option("NAME:=VALUE", "Value of a xacro file's argument; may be repeated.")
    srdf: str | None = option("FILE", "SRDF of the robot; default: the one next to its file (see ik info).")
    group: str | None = option("NAME", "Group of the SRDF, which sets base and tips.", without=["--tip"])
    deg: bool = flag("--deg", "Angles in degrees; lengths stay in metres.", panel="Output")

    @property
    def tips(self) -> str | list[str] | None:
        """The tips of --tip as `load` takes them: one name, a list of several, or None."""
        return self.tip[0] if self.tip and len(self.tip) == 1 else self.tip or None

    def load(self, tips: str | list[str] | None) -> Any:
        """Load the robot that the options describe: a Tree for a list of tips or a group of several, otherwise a Robot."""
        robot = self._read(tips)
        if self.lock:
            values = {}
            for joint, text in assignments(self.lock, "--lock").items():
                value = numbers(text)
                if value is None or len(value) != 1:
                    hint = comma_hint(text, f"--lock {joint}", (1,)).replace(f"{joint} ", f"{joint}=")
                    raise InvalidOption(f"--lock {joint} takes one number, not '{text}'{hint}")
                values[joint] = self._value(robot, joint, value[0])
            robot = robot.locked(values)
        ranges = {}
        for text in self.limit or ():
            joint, *ends = text.rsplit(":", 2)
            read: list[Any] = [numbers(end) or [] if end.strip() else [None] for end in ends]
            if len(ends) != 2 or any(len(value) != 1 for value in read):
                hint = "; write decimals with a point" if any(map(with_points, ends)) else ""
                raise InvalidOption(f"--limit takes JOINT:LOWER:UPPER, two numbers or one of them, not '{text}'{hint}")
            if joint in ranges:
                raise InvalidOption(f"--limit names joint '{joint}' twice")
            ranges[joint] = [x if x is None else self._value(robot, joint, x) for x, *_ in read]
        return robot.narrowed(ranges) if ranges else robot

    def _value(self, robot: Any, joint: str, x: float) -> float:
        """Convert a typed joint value (degrees with --deg) to rad or m."""
        return in_radians(x, self.deg and turns(kind_of(robot, joint)))

    def _read(self, tip: str | list[str] | None) -> Any:
        """Load the Robot or the Tree, with the limits of its description."""
        from ..robot.library import find
        from ..robot.robot import Robot
        from ..robot.tree import Tree

        source, more = self.robot, {"base": self.base, "package_dirs": self.package_dir or (), "srdf": self.srdf}
        more["xacro_args"] = assignments(self.xacro_arg, "--xacro-arg", ":=") or None
        if self.base_xyz is not None or self.base_rpy is not None:
            from ..robot.pose import pose

            angles = vector(self.base_rpy or "0 0 0", "--base-rpy", 3)
            place = vector(self.base_xyz or "0 0 0", "--base-xyz", 3)
            if not all(map(math.isfinite, (*place, *angles))):
                raise InvalidOption("--base-xyz and --base-rpy take finite numbers")
            more["on_base"] = pose(place, rpy=[in_radians(x, self.deg) for x in angles])
        if self.rail is not None:
            more |= {"on_base": "rail", "base_limits": vector(self.rail, "--rail", 2)}
        tips = find(source).tips
        if self.group is None and tip is None and len(tips) > 1:
            raise FrameNotFound(f"robot '{source}' has {len(tips)} tips; choose one with --tip: {', '.join(tips)}")
        if self.group is not None:
            whole = Tree.load(source, group=self.group, **more)
            return whole if isinstance(tip, list) or len(whole.tips) > 1 else whole.arms[0]
        if isinstance(tip, list):
            return Tree.load(source, tips=tip, **more)
        try:
            return Robot.load(source, tip=tip, **more)
        except FrameNotFound as several:
            if not several.tips:
                raise
            ends = FrameNotFound(str(several).partition(", or solve")[0] + "; ik info --list-tips shows all")
            ends.tips = several.tips
            raise ends from None

    def choose_tips(
        self, given: Any = None, relative: dict[str, str] | None = None, one: bool = False
    ) -> str | list[str] | None:
        """Return the tip or tips with which the robot is loaded: one name, or None for the default tip, or a list for a Tree.

        They are those of --tip, or else all known tips of the robot, or, if the targets name any other, those of the targets. With
        --group `load` takes the tips of the group. The answer then only says whether a single tip makes a Robot (None) or a Tree
        ([]).

        given: targets by tip, None without --target. relative: {TIP: OTHER} of --relative. one: whether a target without a tip is
        given. Raises InvalidOption.
        """
        if self.group is not None:
            return None if given is None else []
        from ..robot.library import find

        known, named = find(self.robot).tips, list(self.tip or ())
        for k, tip in enumerate(named):
            if tip in named[:k]:
                raise InvalidOption(f"--tip gives '{tip}' twice")
        if one and len(named) > 1:
            raise InvalidOption(f"--xyz is for one tip; give {', '.join(named)} a --target TIP:X,Y,Z each")
        if one and not named and len(known) > 1:
            raise InvalidOption(
                f"robot '{self.robot}' has {len(known)} tips; choose one with --tip: {', '.join(known)}; or leave out --xyz "
                "and give a --target TIP:X,Y,Z for each (a tip without one is free)"
            )
        if given is None:
            return named[0] if len(named) == 1 else named or (list(known) if len(known) > 1 else None)
        if named:
            return named
        others = relative or {}
        asked = list(dict.fromkeys([*given, *others, *others.values()]))
        if len(known) > 1 and all(tip in known for tip in asked):
            return list(known)
        return [*(tip for tip in known if tip in asked), *(tip for tip in asked if tip not in known)]


@options()
class WholeRobot(RobotOptions):
    """Options that choose the robot, for commands that take its joint limits as they are (no --limit)."""

    limit: None = None


@options("Robot")
class OneTip(WholeRobot):
    """Options for the robot of a command that takes one tip."""

    tip: str | None = option(
        "FRAME", "Tip: a frame, link or joint; default: guessed from its name and reported.", *TIP, complete=tips_like
    )


def kind_of(robot: Any, joint: str) -> str:
    """Return the kind of a joint, 'prismatic' or 'revolute'; it may be off the path to the tip, or mimic another joint."""
    model = robot.model
    # A prismatic joint has a linear velocity: the first three rows of its motion subspace S in Pinocchio are not all 0.
    slides = model.existJointName(joint) and model.joints[model.getJointId(joint)].createData().S[:3].any()
    return "prismatic" if slides else "revolute"


def joint_vector(robot: Any, text: str | None, name: str, deg: bool) -> Any:
    """Read joint values (n,) [rad or m] from an option's text: numbers, or the name of a configuration; None if text is None.

    name: the option, for error messages. deg: whether the text has degrees for revolute joints.
    """
    if text is None:
        return None
    word = text.strip()
    if word in robot.named or (
        word[:1].isalpha() and len(word.replace(",", " ").split()) == 1 and numbers(word) is None
    ):
        return robot.named[word]
    values = vector(text, name)
    if len(values) != robot.n:
        raise InvalidConfiguration(
            f"{name} takes {robot.n} values, one per joint ({', '.join(robot.joint_names)}); got {len(values)}"
            f"{comma_hint(text, name, (robot.n,))}"
        )
    pairs = zip(values, robot.joint_kinds, strict=True)
    return robot.check_q([in_radians(x, deg and turns(kind)) for x, kind in pairs], name)


def solver_named(text: str) -> Any:
    """Return the solver class for a text FILE.py:CLASS, any other text (a solver's name) unchanged. Raises InvalidOption."""
    from ..solvers.registry import is_solver_file, solver_from_file

    return solver_from_file(text) if is_solver_file(text) else text


def assignments(pairs: Sequence[str] | None, name: str, mark: str = "=") -> dict[str, str]:
    """Return the texts NAME=VALUE of an option as a dict; `mark` is what stands between them, = or :=.

    Raises InvalidOption for a text without name, mark or value.
    """
    split = {}
    for pair in pairs or ():
        key, equals, value = pair.partition(mark)
        # The value of a xacro argument (NAME:=VALUE), such as a prefix, may be empty.
        if not (key and equals and (value or mark == ":=")):
            raise InvalidOption(f"{name} takes NAME{mark}VALUE, not '{pair}'")
        split[key.strip()] = value.strip()
    return split


def parameters(pairs: Sequence[str] | None) -> dict[str, Any]:
    """Return the parameters that -p NAME=VALUE sets, by name; values are numbers, truth values, lists or words."""
    return {name: parameter(name, text) for name, text in assignments(pairs, "-p").items()}


# ------------------------------------------------------------------------------------------------ tolerances, obstacles
def given(record: Any) -> dict[str, Any]:
    """Return those fields of an options object that are not None, by name."""
    return {name: value for name, value in vars(record).items() if value is not None}


@options("Tolerances")
class ToleranceOptions:
    """Options for the tolerances within which a target counts as reached."""

    tolerance: float | None = option(
        "TOL", "Position [m] and orientation [rad, also with --deg] tolerance; default 1e-6."
    )
    position_tolerance: float | None = option("M", "Position tolerance [m].")
    orientation_tolerance: float | None = option("RAD", "Orientation tolerance [rad; degrees with --deg].")

    def read(self, deg: bool) -> dict[str, Any]:
        """Return the tolerances that were given, by name [m, rad]; deg: whether --orientation-tolerance is in degrees."""
        read = given(self)
        if "orientation_tolerance" in read:
            read["orientation_tolerance"] = in_radians(read["orientation_tolerance"], deg)
        return read


@options("Files of poses")
class FileOptions:
    """Options for units and angles of the poses in a file."""

    length_unit: str | None = option(
        "UNIT", "Unit of positions in the file: m (default), cm, mm or in.", needs=["--targets", "--poses", "--data"]
    )
    euler: str | None = option(
        "AXES",
        "Axes about which three angles in the file turn one after another, such as zyx or zyz; they move with the body (SciPy's "
        "ZYX). For fixed axes give the reverse order. Columns roll,pitch,yaw or rx,ry,rz are about x, y and z; a,b,c are in "
        "order. Default: URDF's roll, pitch, yaw.",
        needs=["--targets", "--poses", "--data"],
    )

    def convention(self, deg: bool) -> Any:
        """Return how a file of poses is read: its length unit, its Euler angles, and whether angles are in degrees (deg)."""
        from ..robot.pose_files import Convention

        given = Convention(self.length_unit or "m", deg, self.euler).check()
        if axes := given.euler:
            notice(
                f"angles turn about {', '.join(axes)} one after another, axes that move with the body (SciPy's '{axes.upper()}'); "
                f"for fixed axes give the reverse order, --euler {axes[::-1]} (columns a,b,c are then c,b,a)"
            )
        return given

    def poses(self, path: Path, arm: Any, deg: bool, what: str = "targets") -> Any:
        """Read a file: poses (N, 4, 4) or positions (N, 3) [m], for several tips a dict by tip. what: their name in errors."""
        import numpy as np

        from ..robot.pose_files import read_poses

        how = {"given": self.convention(deg), "tips": arm.named_tips, "base": arm.arms[0].base}
        parts = [block.poses for block in read_poses(path, what, **how)[1]]
        if isinstance(parts[0], dict):
            return {tip: np.concatenate([part[tip] for part in parts]) for tip in parts[0]}
        return np.concatenate(parts)


@options("Collisions")
class CollisionOptions:
    """Options for collisions to avoid."""

    avoid_collisions: bool = flag("--avoid-collisions", "Accept only solutions without self-collision.")
    obstacle: list[str] | None = option(
        "KIND:...",
        "Obstacle to avoid, in the frame of the targets; may be repeated. box:x,y,z,sx,sy,sz sphere:x,y,z,r "
        "cylinder:x,y,z,r,length; boxes and cylinders also with ,roll,pitch,yaw [rad; degrees with --deg]. Implies "
        "--avoid-collisions.",
    )
    margin: float | None = option("M", "Distance [m] below which parts count as touching. Implies --avoid-collisions.")

    def read(self, arm: Any, deg: bool) -> dict[str, Any]:
        """Return the keyword argument `avoid_collisions` for a solver as a dict, which is empty if none was asked for.

        Its value is True or, if obstacles were given, a CollisionModel with them. deg: whether their angles are in degrees.
        """
        if not self.obstacle and self.margin is None:
            return {"avoid_collisions": True} if self.avoid_collisions else {}
        from ..robot.geometry.collision import CollisionModel
        from ..robot.pose import pose

        model = CollisionModel(arm, margin=self.margin or 0.0)
        for text in self.obstacle or ():
            kind, _, rest = text.partition(":")
            if kind not in OBSTACLES:
                forms = " or ".join(f"{kind}:{form}" for kind, (form, _) in OBSTACLES.items())
                raise InvalidOption(f"--obstacle takes {forms}; not '{text}'")
            form, sizes = OBSTACLES[kind]
            values = numbers(rest) or []
            if not all(map(math.isfinite, values)):
                raise InvalidOption(f"--obstacle takes finite numbers; not '{text}'")
            turned = len(values) == 6 + sizes and kind != "sphere"
            if len(values) != 3 + sizes and not turned:
                raise InvalidOption(f"--obstacle {kind}: takes {form}; got {len(values)} numbers in '{text}'")
            angles = [in_radians(x, deg) for x in values[-3:]] if turned else None
            place, size = pose(values[:3], rpy=angles), values[3 : 3 + sizes]
            getattr(model, f"add_{kind}")(*([size] if kind == "box" else size), place)
        return {"avoid_collisions": model}
