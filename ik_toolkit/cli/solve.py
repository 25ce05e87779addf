"""`ik solve`: joint values that bring the tip to a target."""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import typer

from ..errors import InvalidOption
from ..files import as_output
from ..text import angle, duration, length, vector
from . import first_use
from .command import PLOTS, above_zero, command, flag, in_radians, option, options, same
from .completion import solvers_like
from .options import (
    CollisionOptions,
    FileOptions,
    ObjectOutput,
    RobotOptions,
    SceneOutput,
    TableOutput,
    ToleranceOptions,
    given,
    joint_vector,
    kind_of,
    parameters,
    solver_named,
)
from .output import fixed, notice, number, show, table, unit, write_json, write_rows
from .pictures import draw
from .target import POSED, CountOptions, TargetOptions, at_home, in_base, relations, request

ABREAST = 4  # This many solutions, a column each, fit side by side into a terminal with 80 columns.
ACROSS = 6  # The values of this many joints fit side by side into a terminal with 80 columns.


@options("Solver")
class SolverOptions:
    """Options for the solver: its parameters, attempts, iterations and time."""

    solver: str = option(
        "NAME",
        "Solver; see ik solvers. auto chooses one for the robot and target.",
        "-s",
        "--solver",
        default="auto",
        complete=solvers_like,
    )
    param: list[str] | None = option("NAME=VALUE", "Set a parameter of the solver; may be repeated.", "-p", "--param")
    preset: str | None = option("NAME", "Published or tuned parameters, by name, or a file of ik tune.")
    max_iterations: int | None = option("N", "Maximum iterations per attempt; default: the solver's own.")
    restarts: int | None = option("N", "Additional attempts from other starts; default: the solver's own.")
    timeout: float | None = option("S", "Time for the solve [s]; unlike every other option not deterministic.")
    seed: int = option("N", "Seed of the random restarts.", default=0)
    length_scale: float | None = option(
        "M",
        "Position error [m] that weighs as much as one radian where the target is missed; default: the robot's reach.",
    )
    limits: bool = flag("--limits/--no-limits", "Enforce joint limits.", default=True)

    def choose(self, robot: Any) -> Any:
        """Return the solver's name, or the solver configured by preset and parameters. Raises UnknownSolver, InvalidOption."""
        from ..solvers.presets import from_preset, read_preset
        from ..solvers.registry import GENERAL, find_row, make_rule
        from ..solvers.solve import closed_form_with

        if self.solver == "auto" and not self.param and not self.preset:
            return self.solver
        asked = solver_named(self.solver)
        if asked == "auto" and self.preset and self.preset.endswith(".toml"):
            asked = str(read_preset(asked, self.preset)["solver"])
        values = parameters(self.param)
        row = find_row(closed_form_with(robot, values) or GENERAL if asked == "auto" else asked)
        if self.preset is None:
            return make_rule(row, values) if values else asked
        return from_preset(row, self.preset, values)

    def read(self) -> dict[str, Any]:
        """Return the options that are given as keyword arguments of `ik.solve`, without solver, parameters and preset."""
        return {name: value for name, value in given(self).items() if name not in ("solver", "param", "preset")}

    def tuned(self, rule: Any) -> dict[str, Any]:
        """Return the tolerance and iteration limit of the preset as keyword arguments of `ik.solve`; {} without --preset."""
        from ..solvers.presets import load_preset
        from ..solvers.registry import find_row

        return {} if self.preset is None else load_preset(find_row(rule).name, self.preset, rule._fields)[1]


@options("Start and preferences")
class WishOptions:
    """Options for the start, and for preferences among the solutions."""

    q0: str | None = option("Q1 Q2 ...", "Start configuration; default: chosen by the solver, or home.")
    clamp_q0: bool = flag(
        "--clamp-q0/--refuse-q0",
        "Clamp a start outside the limits, or reject it.",
        default=True,
        needs=["--q0", "--closest"],
    )
    joint_weights: str | None = option("W1 W2 ...", "How freely each joint moves; 0 holds it.")
    closest: str | None = option("Q1 Q2 ...", "Return the solution nearest this configuration.")
    follow: float | None = option(
        "RAD",
        "Single attempt that moves no joint further than this from --q0 [rad; degrees with --deg] (prismatic joints: times reach).",
    )
    objective: str | None = option(
        "NAME", "Secondary objective for redundant robots: mid-range, reference (near q0) or manipulability."
    )
    every: bool = flag(
        "--all",
        "List every distinct solution within limits, nearest to q0 (or home) first.",
        without=["--plot", "--explain"],
    )
    explain: bool = flag(
        "--explain",
        "Show how the answer comes about: D-H table, closed form with the numbers put in, branches, iterations.",
        panel="Output",
    )

    def read(self, arm: Any, deg: bool, many: bool) -> dict[str, Any]:
        """Return the options as keyword arguments of `ik.solve`, or if `many` of `ik.solve_batch`. Raises InvalidOption.

        deg: whether angles were typed in degrees.
        """
        read: dict[str, Any] = {} if self.objective is None else {"objective": self.objective}
        if self.follow is not None:
            # --follow 0 is refused here, because the library takes 0 for no bound on the move.
            read["follow"] = in_radians(above_zero(self.follow, "--follow"), deg)
        read |= {"q0_outside": "clamp" if self.clamp_q0 else "refuse", "q0": joint_vector(arm, self.q0, "--q0", deg)}
        if self.joint_weights is not None:
            read["joint_weights"] = tuple(vector(self.joint_weights, "--joint-weights", arm.n))
        if self.closest is not None:
            nearest = joint_vector(arm, self.closest, "--closest", deg)
            read |= {"q0": nearest, "closest": True} if many else {"closest": nearest}
        return read


@options("Many targets")
class ManyOptions:
    """Options for many targets instead of one."""

    file: Path | None = option(
        "FILE",
        "Many targets from a file (- is stdin), solved on all cores and written to -o; replaces --xyz. CSV with the header "
        "x,y,z or x,y,z,qx,qy,qz,qw or x,y,z,roll,pitch,yaw; NPZ with targets, or xyz and quat_xyzw (quat_wxyz). Several tips: "
        "CSV columns TIP.x, TIP.y, ..., or NPZ with an array TIP (N, 4, 4) or (N, 3) for each, or targets (N, tips, 4, 4).",
        "--targets",
        without=[*POSED, "--matrix", "--target", "--all", "--explain", "--plot", "--html", "--view"],
    )
    threads: int | None = option("N", "With --targets: threads; default: all cores.", needs=["--targets"])
    cluster: str | None = option(
        "ADDRESS", "With --targets: use the Dask scheduler at this address.", needs=["--targets"]
    )


@options("Output")
class SolveOutput(ObjectOutput):
    """Options of `ik solve` for what is printed, written to files and drawn."""

    csv_file: Path | None = same(TableOutput, "csv_file")
    plot: Path | None = option(
        "FILE", "Draw the error per iteration to a .png, .pdf or .svg file.", "--plot", writes=PLOTS
    )
    output: Path | None = option(
        "FILE", "Write the JSON object to a .json; with --targets the solutions.", "-o", "--output", writes=[]
    )
    html: Path | None = same(SceneOutput, "html")
    live: bool = same(SceneOutput, "live")

    @property
    def drawn(self) -> bool:
        """Whether --plot, --html or --view is given."""
        return self.plot is not None or self.html is not None or self.live


@command
def solve(
    target: TargetOptions,
    method: SolverOptions,
    wish: WishOptions,
    tolerances: ToleranceOptions,
    counts: CountOptions,
    collisions: CollisionOptions,
    many: ManyOptions,
    file: FileOptions,
    robot: RobotOptions,
    out: SolveOutput,
) -> None:
    """Find joint values that bring the tip to a position, or to a pose when --rpy, a quaternion or --matrix is given.

    Several tips of one robot are solved together, shared joints included, with a --target for each. They are those of
    --tip, or the robot's own; one without a target is free. Masks, directions and frames may be given by tip.

    --targets solves many targets at once and writes them to the file named by -o: CSV, NPZ or Parquet.

    --explain adds the D-H table, the closed form with the numbers put in and every branch, or the iterations.

    --plot draws the error per iteration; --view and --html show the robot in 3-D, with the solve as an animation.

    Exit code 0 when solved, otherwise 1: the status says how it ended, and a message on stderr says what to try.

    Examples:
    ik solve hydrolek_7w --xyz 1.0 0.1 0.2
    ik solve hydrolek_7w --xyz 1.0 0.2 0.1 --rpy -1.6 0 -1.2 --json
    ik solve hydrolek_7w --xyz 1.0 0.1 0.2 -s dls -p damping=0.05 --tolerance 1e-4
    ik solve planar_2r --xyz 1 1 0 --all --deg
    ik solve hydrolek_7w --xyz 1.0 0.1 0.2 --direction 0 0 -1
    ik solve hydrolek_7w --xyz 1.0 0.1 0.2 --obstacle sphere:1,0.5,0.5,0.1
    ik solve brokk_hydrolek --target left_tip:1.2,.4,1 --target right_tip:1,-.4,1
    ik solve hydrolek_7w --targets poses.csv -o solutions.csv
    """
    from ..solvers.options import changed

    _refuse_contradictions(target, wish, many, out)
    deg = robot.deg
    aim = target.read(deg) if many.file is None and target.from_q is None else None
    tips = robot.choose_tips(aim if target.targets else None, relations(target.relative), target.posed)
    arm = robot.load(tips)
    rule = method.choose(arm)
    aim = aim if target.from_q is None else target.reached(arm, deg)
    options = (
        changed(method.tuned(rule), tolerances.read(deg)) | method.read() | wish.read(arm, deg, many.file is not None)
    )
    options |= counts.read(deg, target.relative) | collisions.read(arm, deg)
    start = options.pop("q0")
    if many.file is not None:
        from .batch import solve_file

        how = {"threads": many.threads, "cluster": many.cluster, "given": file.convention(deg), "as_json": out.as_json}
        solve_file(arm, many.file, out.output, rule, start, options, **how)
    elif wish.every:
        _solve_all(arm, aim, rule, start, options, out, deg)
    else:
        _solve_one(arm, aim, rule, start, options, out, deg, wish.explain)


def _refuse_contradictions(target: TargetOptions, wish: WishOptions, many: ManyOptions, out: SolveOutput) -> None:
    """Raise InvalidOption for options that do not go together, or a target that is missing."""
    if many.file is not None:
        if wish.closest is not None and wish.q0 is not None:
            raise InvalidOption("give --closest or --q0, not both: the search starts there")
    else:
        if out.output is not None:
            as_output(out.output, "a solve without --targets", ".json")
        if not target.targets and target.xyz is None and target.matrix is None and target.from_q is None:
            raise InvalidOption(
                "Missing option '--xyz' (or '--matrix', '--from-q', '--targets FILE' for many, '--target' for several tips)"
            )
    if out.csv_file is not None and not wish.every:
        raise InvalidOption("--csv writes the solutions of --all; -o writes a single one, and those of --targets")
    if wish.every and wish.closest is not None:
        raise InvalidOption("--all lists the solutions nearest to --q0 first; give that instead of --closest")


def _solve_one(
    arm: Any, target: Any, rule: Any, start: Any, options: dict[str, Any], out: SolveOutput, deg: bool, explain: bool
) -> None:
    """Solve one target, print and draw the result; exit with code 1 if it is not solved."""
    from ..solvers.solve import solve as solve_one

    first = {key: value for key, value in options.items() if key != "closest"}
    with nullcontext() if out.drawn else first_use.instead_of_compiling():
        # A first solve, of the pose at home, compiles or loads the code, so that the displayed time is that of solving only.
        solve_one(arm, at_home(arm, target, options), rule, q0=arm.home if options.get("follow") else None, **first)
    if first_use.budget():
        options |= {"max_evaluations": first_use.budget(), "timeout": None}
    result = solve_one(arm, target, rule, q0=start, **options)
    if first_use.budget() and not result.success and result.status.name != "UNREACHABLE":
        raise typer.Exit(first_use.NOT_ANSWERED)
    explained = result.explain() if explain else None
    told = {"kernel": first_use.kernel(), **result.to_dict(), **request(arm, target, options)}
    told |= {} if explained is None else {"explanation": explained.to_dict()}
    write_json(told, out.as_json, out.output)
    if not out.as_json:
        _show(result, target, options, deg)
        if explained is not None:
            show(str(explained))
    if result.notice:
        notice(result.notice)
    if not result.success:
        notice(f"not solved, {result.status.name}: {result.message}")
    if out.drawn:
        result = solve_one(arm, target, rule, q0=start, history=True, **options)
        _draw(arm, result, result.q, target, options, out)
    if not result.success:
        raise typer.Exit(1)


def _draw(arm: Any, what: Any, q: Any, target: Any, options: dict[str, Any], out: SolveOutput) -> None:
    """Draw the requested pictures; targets that are relative to another tip are drawn for the robot at q."""
    if out.drawn:
        target, around = in_base(target, arm.fk(q), options.get("relative_to")), options.get("avoid_collisions")
        draw(arm, what, target, around, out.plot, out.html, out.live)


def _solve_all(
    arm: Any, target: Any, rule: Any, start: Any, options: dict[str, Any], out: SolveOutput, deg: bool
) -> None:
    """Print and draw all solutions; exit with code 1 if there are none."""
    from ..solvers.solve import solve_all

    found = solve_all(arm, target, rule, start, **options)
    write_json({**found.to_dict(), **request(arm, target, options)}, out.as_json, out.output)
    rows = ([*q.tolist(), float(distance)] for q, distance in zip(found, found.distance, strict=True))
    write_rows(out.csv_file, [*arm.joint_names, "distance"], rows)
    if not out.as_json:
        show(*_solutions(found, deg))
        complete = "these are all" if found.complete else "there may be more"
        told = {f"family {k}": family.message for k, family in enumerate(found.families, 1)}
        distance = "from --q0 or home: the root of the summed squares of the joints' moves [rad; slides in robot sizes]"
        lines = {"solutions": f"{len(found)}, {complete}; solver {found.solver}", "distance": distance}
        show({**lines, "found": found.message, **told})
    if not len(found):
        notice(f"no solution: {found.message}")
        raise typer.Exit(1)
    _draw(arm, list(found), found[0], target, options, out)


def _solutions(found: Any, deg: bool) -> list[Any]:
    """Return tables of solutions, one per row if the joints fit as columns, otherwise one per column, a few per table."""
    arm, made = found.robot, []
    kinds = arm.joint_kinds
    in_rows = arm.n <= ACROSS
    if in_rows and len(found):
        made.append(table(">#", *(">" + name.replace("_", "_\n") for name in arm.joint_names), ">distance"))
        made[0].add_row("", *(unit(kind, deg) for kind in kinds), "", style="dim")
        for k, (q, distance) in enumerate(zip(found, found.distance, strict=True), 1):
            values = (number(float(x), kind, deg) for x, kind in zip(q, kinds, strict=True))
            made[0].add_row(str(k), *values, fixed(distance, 3))
    for first in range(0, 0 if in_rows else len(found), ABREAST):
        rows = range(first, min(first + ABREAST, len(found)))
        made.append(table("<joint", "<unit", *(f">{k + 1}" for k in rows)))
        for i, (name, kind) in enumerate(zip(arm.joint_names, kinds, strict=True)):
            made[-1].add_row(name, unit(kind, deg), *(number(float(found.q[k, i]), kind, deg) for k in rows))
        made[-1].add_row("distance", "", *(fixed(found.distance[k], 3) for k in rows), style="dim")
    return made


def _show(result: Any, target: Any, options: dict[str, Any], deg: bool) -> None:
    from ..robot.configuration import follower_limits, followers_at_limits, joint_values
    from ..solvers.message import unweighted

    robot = result.robot
    # The errors are shown in m and rad without the weights of --mask, so that they agree with the message.
    left = dict(zip(robot.tips, unweighted(result)[0], strict=True))
    where = dict.fromkeys(result.limited_joints, "at limit") | dict.fromkeys(robot.outside(result.q), "outside")
    joints = table("<joint", ">value", "<unit", ">lower", ">upper", "")
    for i, (name, kind) in enumerate(zip(robot.joint_names, robot.joint_kinds, strict=True)):
        value, lower, upper = (number(float(x[i]), kind, deg) for x in (result.q, robot.lower, robot.upper))
        joints.add_row(name, value, unit(kind, deg), lower, upper, where.get(name, ""))
    at = joint_values(robot, result.q)
    held = {name for names in followers_at_limits(robot, result.q).values() for name in names}
    for name, ends in follower_limits(robot).items():
        kind = kind_of(robot, name)
        value, *shown = (number(x, kind, deg) for x in (at[name], *ends))
        follows = f"follows {robot.mimic_joints[name].leader}" + ", at limit" * (name in held)
        joints.add_row(name, value, unit(kind, deg), *shown, follows, style="dim")
    show(joints)
    if robot.by_tip:
        relative = options.get("relative_to") or {}
        tips = table("<tip", "<target in", ">position\nerror", ">orientation\nerror")
        for tip, (position, turned) in left.items():
            asked = (relative.get(tip, robot.base), length(position), _angle(turned, deg))
            tips.add_row(tip, *(asked if tip in target else ("no target", "free", "free")))
        show(tips)
    counts = f"{result.iterations}, restarts {result.restarts}, FK evaluations {result.fk_evaluations}"
    position, turned = left[robot.tips[0]]
    errors = {"position error": length(position), "orientation error": _angle(turned)}
    if result.success and len(result.level_errors) > 1:
        errors["in short"] = result.message
    status = {"status": f"{result.status.name}, solver {result.solver}"} | ({} if robot.by_tip else errors)
    show(status | {"iterations": counts, "computed in": duration(result.elapsed)})


def _angle(value: float | None, deg: bool | None = None) -> str:
    """Write an angle [rad] as text, in degrees or radians, or in both if deg is None."""
    if value is None:
        return "free"
    words = angle(value, deg is not False)
    return f"{angle(value, deg=False)} ({words})" if deg is None and words.endswith("deg") else words
