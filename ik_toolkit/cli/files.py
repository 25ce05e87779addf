"""`ik dh` and `ik check`: a URDF from a D-H table, and what is wrong with a URDF."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import CONTROLS, FrameNotFound, IKError, InvalidOption, ModelError
from ..files import write_whole
from .arguments import Json, PackageDir, UrdfOut, XacroArg, assignments, writes
from .output import notice, progress, show, table, write_json

TableArg = Annotated[str, typer.Argument(metavar="TABLE", help="D-H table, a .toml or .csv file.")]
SrdfOut = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="FILE.srdf",
        help="With --self-collision: write these pairs.",
        callback=writes(".srdf"),
    ),
]
Sampled = Annotated[
    bool,
    typer.Option(
        "--self-collision", help="Find the pairs of links that always or never touch and need no collision test."
    ),
]
Samples = Annotated[int | None, typer.Option(metavar="N", help="Configurations to sample; default 10000.")]
Seed = Annotated[int, typer.Option(metavar="N", help="Seed of the samples.")]
UrdfArg = Annotated[str, typer.Argument(metavar="URDF", help="Path of a URDF, xacro or MJCF file, or a robot's name.")]


def register(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command()(dh)
    app.command()(check)


def dh(table_file: TableArg, output: UrdfOut = None, as_json: Json = False) -> None:
    """Write the URDF of a D-H table (classic or modified), with primitive shapes."""
    from ..robot.formats.dh import read_dh_table, to_urdf

    made = read_dh_table(table_file)
    text = to_urdf(made)
    if output is not None:
        write_whole(output, text)
        notice(f"wrote {output}: {made.name}, {len(made.rows)} joints, {made.convention} D-H")
    if as_json:
        joints = [row.name for row in made.rows]
        write_json(
            {"name": made.name, "convention": made.convention, "joints": joints, "output": output, "urdf": text}, True
        )
    elif output is None:
        print(CONTROLS.sub(lambda found: f"&#{ord(found[0])};", text), end="")  # the same XML, for a terminal


def check(
    urdf: UrdfArg,
    sampled: Sampled = False,
    samples: Samples = None,
    seed: Seed = 0,
    output: SrdfOut = None,
    package_dir: PackageDir = None,
    xacro_arg: XacroArg = None,
    as_json: Json = False,
) -> None:
    """Validate a robot's URDF (or the one that its xacro or MJCF comes to), element by element.

    --self-collision also finds the pairs of links that need no collision test: adjacent, always touching, touching by
    construction, or never closer than 1 cm in random configurations of all joints. -o writes them as an SRDF, for --srdf
    or next to the URDF.

    Exit code 0 when it can be loaded (warnings may remain), 1 when it has errors.
    """
    if not sampled and (samples is not None or output is not None):
        raise InvalidOption("--samples and -o belong to --self-collision")
    from rich.text import Text

    from ..robot.formats.finding import error_finding, odd
    from ..robot.formats.urdf_check import check_urdf
    from ..robot.library import find
    from ..robot.load import urdf_of

    entry = find(urdf)
    options: dict[str, Any] = {"package_dirs": [*(package_dir or ()), *entry.package_dirs]}
    options["xacro_args"] = assignments(xacro_arg, "--xacro-arg", ":=") or None
    try:
        read = urdf_of(entry, **options)
        expanded = read.made
        text, findings = read.text, check_urdf(read.text, read.package_dirs, file=read.file)
        findings += [odd("MJCF", note, "see MJCF in the guide", 0) for note in read.notes]
    except ModelError as error:
        text, expanded = "", False
        findings = [error_finding("file", str(error), "give a URDF, xacro or MJCF file that can be read", 0)]
    errors = [finding for finding in findings if finding.severity == "error"]
    rows = [asdict(finding) for finding in findings]
    forms = {} if errors else _closed_forms(entry.tips, text)
    payload = {"urdf": urdf, "loadable": not errors, "errors": len(errors), "findings": rows, "closed_forms": forms}
    found = _self_collision(entry, options, samples, seed) if sampled and not errors else None
    if found is not None:
        pairs = [{"links": pair, "reason": reason} for pair, reason in found.reasons.items()]
        payload["self_collision"] = {**asdict(found), "reasons": pairs, "counts": found.counts()}
    write_json(payload, as_json)
    if not as_json:
        made = table("<severity", ">line", "element", "problem", "what to do")
        for finding in findings:
            colour, line = "red" if finding.severity == "error" else "yellow", str(finding.line or "")
            made.add_row(Text(finding.severity, colour), line, finding.element, finding.problem, finding.advice)
        if findings:
            show(made)
        if any(finding.line for finding in findings) and expanded:
            show("the lines are those of the URDF that ik convert writes")
        warnings = len(findings) - len(errors)
        counts = f"{len(errors)} error{'s' * (len(errors) != 1)}, {warnings} warning{'s' * (warnings != 1)}"
        show(f"{entry.name}: {counts if findings else 'no problems found'}")
        for tip, words in forms.items():
            show(f"closed form up to {tip}: {words}")
        if found is not None:
            counts = ", ".join(f"{count} {reason.lower()}" for reason, count in found.counts().items())
            show(f"pairs of links: {counts}, {len(found.tested)} to be tested ({found.samples} configurations)")
            show(
                f"something touches in {100 * found.before:.3g} % of them, of the pairs to be tested in {100 * found.after:.3g} %"
            )
    if found is not None and output is not None:
        write_whole(output, found.to_srdf())
        notice(f"wrote {output}: {len(found.reasons)} pairs of links that need no test")
    if errors:
        raise typer.Exit(1)


def _self_collision(entry: Any, options: dict[str, Any], samples: int | None, seed: int) -> Any:
    """Pairs of links that need no test, for any tip: all joints of the model move."""
    from ..robot.geometry.self_collision import SAMPLES, self_collision
    from ..robot.robot import Robot

    count = SAMPLES if samples is None else samples
    try:
        robot = Robot.load(entry.source, tip=(entry.tips or (None,))[0], srdf=False, **options)
    except FrameNotFound as several:
        if not several.tips:
            raise
        robot = Robot.load(entry.source, tip=several.tips[0], srdf=False, **options)
    with progress("sampling", count) as step:
        return self_collision(robot, count, seed, step)


def _closed_forms(tips: Sequence[str], text: str) -> dict[str, str]:
    """Description by tip of the closed form that fits there; text: a URDF that can be loaded."""
    from ..robot.base import carried
    from ..robot.formats.urdf_model import build_model
    from ..robot.robot import Robot
    from ..robot.tips import guess_tip
    from ..solvers.closed_form import describe_fit

    found, model = {}, build_model(text)
    for tip in tips or (guess_tip(model).tips if len(guess_tip(model).tips) == 1 else ()):
        held = carried(model, tip)
        try:
            robot = Robot(model, tip=tip, base=held[1] if held else None, urdf=text)
        except IKError:  # several ends and none named: no single arm to describe
            continue
        if describe_fit(robot):
            found[robot.tip] = describe_fit(robot)
    return found
