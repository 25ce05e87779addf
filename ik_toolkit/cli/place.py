"""`ik place`: where a robot should stand so that it reaches the most of given poses."""

import math
from pathlib import Path
from typing import Any

import typer

from ..errors import InvalidOption
from ..text import length, vector
from .command import PLOTS, REQUIRED, command, flag, in_radians, option, options
from .options import CollisionOptions, FileOptions, JsonOutput, OneTip, ToleranceOptions
from .output import fixed, notice, progress, run_or_part, show, table, whole_or_partial, write_json, write_rows
from .pictures import chart


@options()
class PlaceOptions:
    """Options of `ik place`: the poses to reach, where the base may stand, and which files are written."""

    poses: list[str] = option(
        "[TIP:]FILE",
        "Poses or positions in a frame whose z is up: CSV, NPZ or JSON, as for ik solve --targets. Repeat as TIP:FILE for several "
        "tips, each with its own poses.",
        default=REQUIRED,
    )
    where: str | None = option("X Y X Y", "Lower and upper corner of the floor allowed [m]; default: around the poses.")
    yaw: str | None = option("A [B]", "Turn of the base about z, one or a range [rad]; default: any.")
    height: str = option("Z [Z2]", "Height of the base, one or a range [m].", default="0")
    ordered: bool = flag("--ordered", "The poses are a path: follow it from the best places.")
    count: int = option("N", "Number of places.", "-n", "--count", default=5)
    seed: int = option("N", "Seed of the search.", default=0)
    output: Path | None = option("FILE", "Write the places to .csv.", "-o", "--output", writes=[".csv"])
    plot: Path | None = option("FILE", "Draw the floor to a .png, .pdf or .svg file.", writes=PLOTS)


@command
def place(
    asked: PlaceOptions,
    robot: OneTip,
    tolerances: ToleranceOptions,
    around: CollisionOptions,
    file: FileOptions,
    out: JsonOutput,
) -> None:
    """Find where the robot should stand: base poses sorted by poses reached, then clearance, margin, manipulability.

    Obstacles are in the frame of the poses. Exit code 1 when no place reaches any pose.

    Examples:
    ik place hydrolek_7w --poses cuts.csv --plot floor.png
    ik place hydrolek_7w --poses cuts.csv --where -2 -2 2 2 --yaw 0 --ordered
    ik place brokk_hydrolek --poses left_tip:cuts.csv --poses right_tip:holds.csv
    """
    if robot.base_xyz is not None or robot.base_rpy is not None:
        raise InvalidOption("ik place chooses where the robot stands; omit --base-xyz and --base-rpy")
    arm, poses = _read(asked.poses, robot, file)
    from ..study.place import NUMBERS
    from ..study.place import place as search

    corners = None if asked.where is None else vector(asked.where, "--where", 4)
    where: Any = "floor" if corners is None else (corners[:2], corners[2:])
    turn = in_radians(1.0, robot.deg)
    yaw = None if asked.yaw is None else [turn * x for x in _one_or_two(asked.yaw, "--yaw")]
    height = _one_or_two(asked.height, "--height")
    more: Any = tolerances.read(robot.deg) | around.read(arm, robot.deg)
    more |= {"seed": asked.seed, "ordered": asked.ordered, "count": asked.count}
    with progress("counting", None) as step:
        more |= {"yaw": yaw, "height": height, "progress": step}
        found, stopped = run_or_part(lambda: search(arm, poses, where, **more))
    write_rows(
        whole_or_partial(asked.output, stopped), NUMBERS, [[getattr(one, key) for key in NUMBERS] for one in found]
    )
    chart(None if stopped else asked.plot, found)
    write_json(found.to_dict(), out.as_json)
    if not out.as_json:
        yaw_in = f">yaw ({'deg' if robot.deg else 'rad'})"
        made = table(">", ">x (m)", ">y (m)", ">z (m)", yaw_in, ">reached", ">clearance", ">margin")
        for k, one in enumerate(found):
            at = (fixed(x, 3) for x in (one.x, one.y, one.height, one.yaw / turn))
            clear = "-" if math.isnan(one.clearance) else length(one.clearance)
            made.add_row(str(k + 1), *at, one.counts, clear, fixed(one.margin, 3))
        show(made)
        show(
            "margin: mean over the poses reached of the distance to the nearest joint limit, 1 in the middle of all ranges"
        )
        if asked.ordered and len(found) and found[0].path is not None:
            show({"path from the first": found[0].path.message})
    if stopped:
        notice(f"partial: the best of {len(found.candidates):,} candidates")
        raise KeyboardInterrupt
    if not any(one.count for one in found):
        free = "; without the obstacles some may be" if around.obstacle else ""
        notice(
            f"no pose is reached from any of {len(found.candidates):,} places tried, of a reach of {length(arm.reach)}{free}"
        )
        raise typer.Exit(1)


def _read(given: list[str], robot: OneTip, file: FileOptions) -> tuple[Any, Any]:
    """Load the robot and its poses; for TIP:FILE, a Tree of these tips and a dict of poses by tip."""
    files = {
        text.partition(":")[0]: Path(text.partition(":")[2])
        for text in given
        if ":" in text and not Path(text).exists()
    }
    if not files and len(given) == 1:
        arm = robot.load(robot.tip)
        return arm, file.poses(Path(given[0]), arm, robot.deg)
    if len(files) < len(given):
        raise InvalidOption("--poses takes one FILE, or TIP:FILE once for each of several tips")
    if robot.tip is not None:
        raise InvalidOption("--poses TIP:FILE names the tips; omit --tip")
    arm = robot.load(list(files))
    return arm, {
        tip: file.poses(files[tip], one, robot.deg) for tip, one in zip(arm.tips, arm.arms, strict=True) if tip in files
    }


def _one_or_two(text: str, name: str) -> list[float]:
    """Return the ends of a range, which are equal if the text has a single number."""
    values = vector(text, name)
    if len(values) > 2:
        raise InvalidOption(f"{name} takes one number or two, not '{text}'")
    return [values[0], values[-1]]
