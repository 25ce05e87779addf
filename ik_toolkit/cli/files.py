"""`ik dh`, `ik check` and `ik convert`: a URDF from a D-H table, what is wrong with a URDF, and any description as one URDF."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from ..errors import CONTROLS, IKError, ModelError
from ..files import write_whole
from ..text import how_many, in_shell
from .command import argument, command, flag, option, options, same
from .completion import robots_like
from .options import JsonOutput, RobotOptions, assignments
from .output import notice, progress, show, table, write_json


@options("Robot")
class FileOptions(JsonOutput):
    """Options for reading a robot description: folders of packages, xacro arguments."""

    package_dir: list[str] | None = same(RobotOptions, "package_dir")
    xacro_arg: list[str] | None = same(RobotOptions, "xacro_arg")

    def read(self, *more: Any) -> dict[str, Any]:
        """Return the keyword arguments for loading a description; more: folders to search after those of --package-dir."""
        arguments = assignments(self.xacro_arg, "--xacro-arg", ":=") or None
        return {"package_dirs": [*(self.package_dir or ()), *more], "xacro_args": arguments}


@options()
class DhOptions(JsonOutput):
    """Options of `ik dh`: the D-H table, and the file for its URDF."""

    table: str = argument(
        "TABLE", "D-H table, a .toml or .csv file; a .csv begins with lines such as '# convention = classic'."
    )
    output: Path | None = option(
        "FILE", "Write the URDF to a .urdf instead of stdout.", "-o", "--output", writes=[".urdf", ".xml"]
    )


@options()
class ConvertOptions(FileOptions):
    """Options of `ik convert`: the robot, and the file for its URDF."""

    robot: str = same(RobotOptions, "robot")
    output: Path | None = same(DhOptions, "output")


@options()
class CheckOptions(FileOptions):
    """Options of `ik check`: the description to check, and whether to look for pairs of links that cannot collide."""

    urdf: str = argument("URDF", "Path of a URDF, xacro or MJCF file, or a robot's name.", complete=robots_like)
    sampled: bool = flag(
        "--self-collision", "Find the pairs of links that always or never touch and need no collision test."
    )
    samples: int | None = option("N", "Configurations to sample; default 10000.", needs=["--self-collision"])
    seed: int = option("N", "Seed of the samples.", default=0, panel="Solver", needs=["--self-collision"])
    output: Path | None = option(
        "FILE.srdf",
        "With --self-collision: write these pairs.",
        "-o",
        "--output",
        writes=[".srdf"],
        needs=["--self-collision"],
    )


@command
def dh(asked: DhOptions) -> None:
    """Write the URDF of a D-H table (classic or modified), with primitive shapes.

    Examples:
    ik dh arm.toml -o arm.urdf
    """
    from ..robot.formats.dh import read_dh_table, to_urdf

    made = read_dh_table(asked.table)
    text = to_urdf(made)
    if asked.output is not None:
        write_whole(asked.output, text)
        notice(f"wrote {asked.output}: {made.name}, {how_many(len(made.rows), 'joint')}, {made.convention} D-H")
    joints = [row.name for row in made.rows]
    _print(asked, text, {"name": made.name, "convention": made.convention, "joints": joints, "output": asked.output})


def _print(asked: Any, text: str, payload: dict[str, Any]) -> None:
    """Print a JSON object that contains the URDF if asked for, or else the URDF itself if no output file is given."""
    if asked.as_json:
        write_json({**payload, "urdf": text}, True)
    elif asked.output is None:
        # Control characters from the file are escaped, because they could change the terminal.
        print(CONTROLS.sub(lambda found: f"&#{ord(found[0])};", text), end="")


@command
def check(asked: CheckOptions) -> None:
    """Validate a robot's URDF (or the URDF made from its xacro or MJCF), element by element.

    --self-collision also finds the pairs of links that need no collision test: adjacent, always touching, touching by
    construction, or never closer than 1 cm in random configurations of all joints. -o writes them as an SRDF, for --srdf
    or next to the URDF.

    The robot is also loaded for each of its known or guessed tips. Exit code 0 when it can be (warnings may remain), 1 when it
    has errors.

    Examples:
    ik check hydrolek_7w
    ik check arm.urdf --package-dir meshes
    """
    from rich.text import Text

    from ..robot.library import find
    from ..solvers.closed_form import describe_fit

    entry = find(asked.urdf)
    options = asked.read(*entry.package_dirs)
    findings, robots, expanded = every_finding(asked.urdf, entry, options)
    forms = {robot.tip: words for robot in robots if (words := describe_fit(robot))}
    errors = [finding for finding in findings if finding.severity == "error"]
    payload = {"urdf": asked.urdf, "loadable": not errors, "errors": len(errors)}
    payload |= {"findings": [asdict(finding) for finding in findings], "closed_forms": forms}
    sampled = asked.sampled and not errors
    found = _self_collision(entry, robots[0].tip, options, asked.samples, asked.seed) if sampled else None
    if found is not None:
        pairs = [{"links": pair, "reason": reason} for pair, reason in found.reasons.items()]
        payload["self_collision"] = {**asdict(found), "reasons": pairs, "counts": found.counts()}
    write_json(payload, asked.as_json)
    if not asked.as_json:
        made = table("<severity", ">line", "element", "problem", "what to do")
        for finding in findings:
            colour, line = "red" if finding.severity == "error" else "yellow", str(finding.line or "")
            made.add_row(Text(finding.severity, colour), line, finding.element, finding.problem, finding.advice)
        if findings:
            show(made)
        if any(finding.line for finding in findings) and expanded:
            show(in_shell("the lines are those of the URDF that ik convert writes"))
        warnings = len(findings) - len(errors)
        counts = f"{how_many(len(errors), 'error')}, {how_many(warnings, 'warning')}"
        show(f"{entry.name}: {counts if findings else 'no problems found'}")
        for tip, words in forms.items():
            show(f"closed form up to {tip}: {words}")
        if found is not None:
            counts = ", ".join(f"{count} {reason.lower()}" for reason, count in found.counts().items())
            before, after = (f"{100 * share:.3g} %" for share in (found.before, found.after))
            show(f"pairs of links: {counts}, {len(found.tested)} to be tested ({found.samples} configurations)")
            show(f"something touches in {before} of them, of the pairs to be tested in {after}")
    if found is not None and asked.output is not None:
        write_whole(asked.output, found.to_srdf())
        notice(f"wrote {asked.output}: {how_many(len(found.reasons), 'pair')} of links that need no test")
    if errors:
        raise typer.Exit(1)


def _self_collision(entry: Any, tip: str, options: dict[str, Any], samples: int | None, seed: int) -> Any:
    """Find the pairs of links that need no collision test; they hold for any tip, because all joints of the model move."""
    from ..robot.geometry.self_collision import SAMPLES, self_collision
    from ..robot.robot import Robot

    count = SAMPLES if samples is None else samples
    with _silent():
        robot = Robot.load(entry.source, tip=tip, srdf=False, **options)
    with progress("sampling", count) as step:
        return self_collision(robot, count, seed, step)


def every_finding(source: str, entry: Any, options: dict[str, Any]) -> tuple[list[Any], list[Any], bool]:
    """Return the findings of `ik check`, errors first, a Robot for each tip, and whether the URDF was made from another format.

    If it was, line numbers in the findings are those of the URDF that was made.
    """
    from ..robot.formats.finding import error_finding, notes, odd
    from ..robot.formats.urdf_check import check_urdf
    from ..robot.formats.urdf_model import build_model
    from ..robot.load import urdf_of
    from ..robot.robot import Robot
    from ..robot.tips import guess_tip

    try:
        read = urdf_of(entry, **options)
    except ModelError as error:
        return [error_finding("file", str(error), "give a URDF, xacro or MJCF file that can be read", 0)], [], False
    findings = check_urdf(read.text, read.package_dirs, file=entry.path)
    known = {*notes(findings, not read.made), *read.notes}
    findings += [odd("MJCF", note, "see MJCF in the guide", 0) for note in read.notes]
    if findings and findings[0].severity == "error":
        return findings, [], read.made
    robots, said = [], {}
    for tip in entry.tips or guess_tip(build_model(read.text)).tips or (None,):
        try:
            with _silent():
                robots.append(Robot.load(source, tip=tip, **options))
        except IKError as error:
            element = f"tip '{tip}'" if tip else "robot"
            said[str(error)] = error_finding(element, str(error), "loading refuses this tip as it is", 0)
        else:
            srdf = robots[-1].srdf
            noted = [(f"tip '{tip}'", note) for note in robots[-1].notes if note not in known]
            noted += [(f"SRDF '{srdf.path.name}'" if srdf.path else "SRDF", remark) for remark in srdf.remarks]
            for element, note in noted:
                said.setdefault(note, odd(element, note, "make sure that this is meant", 0, at_load=True))
    return sorted([*findings, *said.values()], key=lambda one: one.severity != "error"), robots, read.made


@contextmanager
def _silent() -> Iterator[None]:
    """Keep the package's log quiet while a robot is loaded whose notes are shown as findings."""
    log, nothing = logging.getLogger("ik_toolkit"), logging.Filter("no such logger")
    log.addFilter(nothing)
    try:
        yield
    finally:
        log.removeFilter(nothing)


@command
def convert(asked: ConvertOptions) -> None:
    """Write a robot as one plain URDF: xacro expanded, package:// names of meshes resolved.

    Meshes below the folder of the new file are named relative to it, all others by their absolute path.

    Examples:
    ik convert arm.urdf.xacro -o arm.urdf
    """
    from ..robot.formats.convert import convert as make

    made = make(asked.robot, None if asked.output is None else asked.output.parent, **asked.read())
    if asked.output is not None:
        write_whole(asked.output, made.text)
        notice(f"wrote {asked.output}: {made.name}, {how_many(len(made.meshes), 'mesh file')}")
    for note in made.notes():
        notice(note)
    _print(asked, made.text, {"name": made.name, "output": asked.output, "meshes": made.meshes, "lost": made.lost})
