"""`ik path`: one joint motion through the poses of a file, timed if asked for."""

import math
from pathlib import Path
from typing import Any

import typer

from ..errors import InvalidOption
from ..files import as_output
from ..text import angle, comma_hint, duration, figure, length, vector
from .command import PLOTS, REQUIRED, above_zero, command, flag, option, options, same
from .options import CollisionOptions, FileOptions, RobotOptions, SceneOutput, ToleranceOptions, given, joint_vector
from .output import keep_partial, notice, progress, show, table, write_json
from .pictures import chart, show_scene
from .solve import SolverOptions
from .streams import uninterrupted
from .target import CountOptions, TargetOptions

# Between two poses the tip may turn away from the straight motion by this angle [rad] if --path-tolerance-mm is given.
TURN = math.radians(1.0)
LISTED = 5  # Number of unreached poses that are listed on the terminal; the output file lists all.


@options()
class PathOptions:
    """Options of `ik path` for the poses, the path through them and its times."""

    poses: Path = option(
        "FILE",
        "Poses in order, in the base frame: CSV with the header x,y,z or x,y,z,qx,qy,qz,qw or x,y,z,roll,pitch,yaw; NPZ or "
        "JSON with targets (N, 4, 4) or (N, 3), or xyz and quat_xyzw. Several tips: as for ik solve --targets.",
        default=REQUIRED,
    )
    q0: str | None = option(
        "Q1 Q2 ...", "Start of the path, or a configuration to start near.", panel="Start and preferences"
    )
    q_end: str | None = option("Q1 Q2 ...", "End of the path, or a configuration to end near.")
    max_step_deg: float = option("DEG", "Largest step of a revolute joint.", default=7.0)
    max_step_mm: float = option("MM", "Largest step of a prismatic joint.", default=20.0)
    reconfigurations: str = option("fewest|none|N", "Allowed changes of branch.", default="fewest")
    retime: bool = flag(
        "--retime", "Time the path optimally within --velocity and --acceleration; -o writes the trajectory."
    )
    velocity: str | None = option(
        "V [V2 ...]",
        "With --retime: speed limits [rad/s, m/s], one, or one per joint; default: the robot's.",
        needs=["--retime"],
    )
    acceleration: str | None = option(
        "A [A2 ...]", "With --retime: acceleration limits [rad/s^2, m/s^2], one, or one per joint.", needs=["--retime"]
    )
    tip_speed: float | None = option(
        "M/S",
        "With --retime: speed of the tip along the path, kept where the limits allow and exceeded nowhere.",
        needs=["--retime"],
    )
    path_tolerance_mm: float | None = option(
        "MM",
        "How far the tip may leave the chords between poses; default 1, and with --retime 1.25 times the chords' sagitta.",
    )
    rate: float = option("HZ", "With --retime: samples per second.", default=100.0, needs=["--retime"])
    output: Path | None = option(
        "FILE",
        "Write the path to .csv, .npz or .json; with --retime the trajectory to .csv, or to .json as a ROS JointTrajectory.",
        "-o",
        "--output",
        writes=[".csv", ".npz", ".json"],
    )
    plot: Path | None = option("FILE", "Draw the joints to a .png, .pdf or .svg file.", writes=PLOTS)

    def check(self) -> None:
        """Raise InvalidOption for options that do not fit together, and for steps or tolerances that are not above 0.

        --retime needs --acceleration, and a file format that can hold times.
        """
        if self.retime and self.acceleration is None:
            raise InvalidOption("--retime needs --acceleration: a URDF defines no acceleration limits")
        if self.retime and self.output is not None:
            as_output(self.output, "a trajectory", ".csv", ".json")
        above_zero(self.max_step_deg, "--max-step-deg")
        above_zero(self.max_step_mm, "--max-step-mm")
        above_zero(self.path_tolerance_mm or 1.0, "--path-tolerance-mm")

    def read(self, arm: Any, deg: bool) -> dict[str, Any]:
        """Return the arguments of `solve_path` that these options give; deg: whether --q0 and --q-end are in degrees."""
        words, off = self.reconfigurations, self.path_tolerance_mm
        return {
            "q0": joint_vector(arm, self.q0, "--q0", deg),
            "q_end": joint_vector(arm, self.q_end, "--q-end", deg),
            "reconfigurations": int(words) if words.isascii() and words.isdecimal() else words,
            "max_step": (math.radians(self.max_step_deg), 1e-3 * self.max_step_mm),
            "path_tolerance": None if off is None else (1e-3 * off, TURN),
        }


@options()
class PathCounts(CountOptions):
    """Options for which components of the poses count, and which tips are relative to another."""

    relative: list[str] | None = same(TargetOptions, "relative")


@options()
class Seed:
    """The option --seed."""

    seed: int = same(SolverOptions, "seed")


@command
def path(
    asked: PathOptions,
    file: FileOptions,
    counts: PathCounts,
    collisions: CollisionOptions,
    tolerances: ToleranceOptions,
    random: Seed,
    robot: RobotOptions,
    out: SceneOutput,
) -> None:
    """Find one joint motion through poses, with the fewest changes of branch, verified between the poses.

    --mask, --slack, --free-turn and --frame select what counts, also by tip. --retime times the motion optimally, with stops where
    the branch changes. Ctrl-C keeps the best path so far as FILE.partial.

    Exit code 0 when every pose is followed (FOLLOWED, RECONFIGURES), otherwise 1: the status says why, and a message on stderr
    says what to try.

    Examples:
    ik path hydrolek_7w --poses cut.csv --free-turn z -o path.csv --plot path.png
    ik path hydrolek_7w --poses cut.csv --retime --acceleration 1 -o motion.json
    """
    asked.check()
    from ..paths.solve_path import PathInterrupted, solve_path

    arm = robot.load(robot.choose_tips())
    targets = file.poses(asked.poses, arm, robot.deg, "poses")
    options = counts.read(robot.deg, counts.relative) | tolerances.read(robot.deg) | asked.read(arm, robot.deg)
    options |= collisions.read(arm, robot.deg) | given(random)
    bounds = [_numbers(getattr(asked, name), f"--{name}", arm.n) for name in ("velocity", "acceleration")]
    result = made = None
    try:
        with progress("searching", 100) as bar:
            result = solve_path(arm, targets, progress=lambda share, words: bar(100.0 * share, words), **options)
        if asked.retime and result.success:
            made = result.retime(*bounds, rate=asked.rate, seed=random.seed, tip_speed=asked.tip_speed)
    except KeyboardInterrupt as stop:
        found = stop.result if isinstance(stop, PathInterrupted) else result
        if asked.output is not None and found is not None:
            what = "the path, without times," if asked.retime else "the best path so far"
            keep_partial(found, asked.output, f"{what}, {found.status.name}, is")
        raise
    with uninterrupted():
        _write(result, made, asked)
    what = result if made is None else made
    chart(asked.plot, what)
    show_scene(result.robot, what, out.html, out.live)
    write_json(_payload(result, made), out.as_json)
    if not out.as_json:
        _show(result, made)
    if not result.success:
        notice(f"{result.status.name}: {result.message}")
    elif made is not None and (not made.success or made.stops or asked.tip_speed is not None):
        notice(made.message)
    if not result.success or (made is not None and not made.success):
        raise typer.Exit(1)


def _numbers(text: str | None, option: str, joints: int) -> Any:
    """Return the number in a text, or an array with one per joint."""
    if text is None:
        return None
    found = vector(text, option)
    if len(found) not in (1, joints):
        hint = comma_hint(text, option, (1, joints))
        raise InvalidOption(f"{option} takes one number, or {joints}, one per joint; got {len(found)}{hint}")
    return found[0] if len(found) == 1 else found


def _write(result: Any, made: Any, asked: PathOptions) -> None:
    """Write the path or trajectory to the requested file."""
    if asked.output is not None:
        if made is not None:
            save = made.to_json if asked.output.suffix.lower() == ".json" else made.to_csv
            notice(f"wrote {save(asked.output)}")
        elif not asked.retime:
            notice(f"wrote {result.save(asked.output)}")
        else:
            notice(f"nothing written to {asked.output}: the path is not followed, so there is no trajectory")


def _payload(result: Any, made: Any) -> dict[str, Any]:
    payload = result.to_dict()
    if made is not None:
        payload["trajectory"] = {
            "success": made.success, "message": made.message, "duration": made.duration, "samples": len(made.t),
            "deviation": dict(zip(("m", "rad"), made.deviation, strict=True)), "clearance": made.clearance,
        }  # fmt: skip
    return payload


def _show(result: Any, made: Any) -> None:
    turn, slide = result.length
    step, glide = result.largest_step
    off, tilt = result.deviation
    slides = "prismatic" in result.robot.joint_kinds
    clearance, kept = result.clearance, None if made is None else made.clearance
    safe = "" if kept is None else f", clearance at least {length(kept)}"
    leaves = "" if made is None else f", off by {length(made.deviation[0])} and {angle(made.deviation[1])} at most"
    bound = result.lower_bound
    changes = "none" if not result.reconfigurations else str(len(result.reconfigurations))
    if result.reconfigurations and bound is not None:
        changes += f" (at least {bound} are necessary)" if bound else ""
    show({
        "status": f"{result.status.name}: {result.message}",
        "poses": f"{len(result.q)}, {len(result.curve) - len(result.q)} more inserted between them",
        "reconfigurations": changes,
        "length": f"{figure(turn, 4)} rad" + (f" and {length(slide, 4)}" if slides else ""),
        "largest step": angle(step) + (f" and {length(glide)}" if slides else ""),
        "between poses": f"off by {length(off)} and {angle(tilt)} at most (a bound)",
        "clearance": None if clearance is None else f"at least {length(clearance)} on the path",
        "trajectory": None if made is None else f"lasts {duration(made.duration)}, {len(made.t)} samples{leaves}{safe}",
        "computed in": duration(result.elapsed),
    })  # fmt: skip
    if result.reconfigurations:
        changes = table(">between poses", "<joint moving most", ">by")
        for one in result.reconfigurations:
            i = max(range(len(one.move)), key=lambda k: abs(one.move[k]))
            turning = result.robot.joint_kinds[i] != "prismatic"
            by = angle(one.move[i], digits=4) if turning else length(one.move[i], 4)
            changes.add_row(f"{one.index} and {one.index + 1}", result.robot.joint_names[i], by)
        show(changes)
    for missing in result.unreachable[:LISTED]:
        notice(f"pose {missing.index}: {missing.reason}{' (proven)' if missing.proven else ''}")
    if len(result.unreachable) > LISTED:
        notice(f"... and {len(result.unreachable) - LISTED} further poses")
