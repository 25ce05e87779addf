"""`ik reach`: what a robot reaches, cell by cell, and how sure every no is."""

from pathlib import Path
from typing import Any

import typer

from ..errors import InvalidOption
from ..text import decimal, figure, length
from .command import PLOTS, command, option, options
from .options import CollisionOptions, FileOptions, JsonOutput, OneTip, ToleranceOptions, given
from .output import notice, partial, progress, run_or_part, show, write_json
from .pictures import chart, show_scene


@options()
class ReachOptions:
    """Options of `ik reach`: the region, the orientations asked for, and which files are written."""

    region: str | None = option("X Y Z X Y Z", "Lower and upper corner [m]; default: the box around the reach.")
    resolution: float | None = option("M", "Width of a cell [m]; default: a fortieth of the longest side.")
    orientations: str = option("any|N", "Any orientation, or N tool axes about which the tip may turn.", default="any")
    poses: Path | None = option(
        "FILE",
        "Loose poses instead of a region: CSV, NPZ or JSON, as for ik solve --targets.",
        without=["--region", "--resolution", "--orientations"],
    )
    audit: str = option("N|full", "Unproven noes that are tried again with 1,000 attempts.", default="2000")
    priority: str | None = option("position", "Position first: the orientation may be as near as it gets.")
    seed: int = option("N", "Seed of the search.", default=0)
    threads: int | None = option("N", "Threads; default: one a core.")
    cluster: str | None = option("ADDRESS", "Solve on the workers of a Dask scheduler.")
    output: Path | None = option(
        "FILE",
        "Write the map to an .npz file; a stopped run goes on from FILE.partial.",
        "-o",
        "--output",
        writes=[".npz"],
    )
    plot: Path | None = option("FILE", "Draw planes through the map to a .png, .pdf or .svg file.", writes=PLOTS)
    html: Path | None = option("FILE", "Write robot and cells as one 3-D HTML page.", writes=[".html", ".htm"])


@command
def reach(
    asked: ReachOptions,
    robot: OneTip,
    tolerances: ToleranceOptions,
    around: CollisionOptions,
    file: FileOptions,
    out: JsonOutput,
) -> None:
    """Map what the tip reaches inside the limits: a cell is reached (with a configuration), proven out of reach, or undecided.

    A sample of the undecided cells is tried again, and the share of them that can be reached is stated. Ctrl-C keeps what is
    finished in FILE.partial; the same command continues from there, also after the process was killed.

    Examples:
    ik reach hydrolek_7w --resolution 0.1 -o map.npz --plot map.png
    ik reach hydrolek_7w --region 0 -1 0 1 1 1 --orientations 6 -o axes.npz
    """
    arm = robot.load(robot.tip)
    from ..study.reachability import MapNotSaved, reachability
    from ..study.reachability_grid import grid_of
    from ..study.reachability_map import ANSWERS
    from .batch import cluster_of  # Imported here, so that `ik --help` does not load the solvers.

    region = _region(asked, file, arm, robot.deg)
    turns = _word_or_count(asked.orientations, "any", "--orientations", "tool axes")
    audit = _word_or_count(asked.audit, "full", "--audit", "noes")
    grid = grid_of(arm, region, asked.resolution, turns)
    size = f" x {grid.turns} orientations" if grid.rotations is not None else ""
    cells = "poses" if grid.poses is not None else f"cells of {length(float(grid.size.max()))}"
    notice(f"{grid.cells:,} {cells}{size}: {grid.answers:,} answers, at most {grid.memory(arm.n) / 1e6:,.0f} MB")
    unchanged = {
        name: value for name, value in given(asked).items() if name in ("resolution", "priority", "seed", "threads")
    }
    more: dict[str, Any] = {**tolerances.read(robot.deg), **around.read(arm, robot.deg), **unchanged}
    more |= {"orientations": turns, "audit": audit}
    stopped, lost = False, None
    with cluster_of(asked.cluster) as executor, progress("answers", grid.answers) as step:
        try:
            more |= {"executor": executor, "file": asked.output, "progress": step}
            found, stopped = run_or_part(lambda: reachability(arm, region, **more))
        except MapNotSaved as failure:
            found, lost = failure.result, failure.args[0].partition(";")[0]
    counts = found.counts()
    if stopped:
        kept = f"; they are in {partial(asked.output)}" if asked.output is not None else ""
        notice(f"partial: {found.states.size - counts['untried']:,} of {found.states.size:,} answers{kept}")
    elif lost is None:
        _draw(found, arm, asked)
    write_json(found.to_dict(), out.as_json)
    if not out.as_json:
        total = max(found.states.size, 1)
        words = {ANSWERS[key]: f"{count:,} ({figure(100 * count / total)} %)" for key, count in counts.items() if count}
        show(words | {"audit": str(found.audit)})
    if stopped:
        raise KeyboardInterrupt
    if lost is not None and asked.output is not None:
        notice(
            f"ik: {lost}. {partial(asked.output)} has what fitted; with more space the same command goes on from there"
        )
        raise typer.Exit(2)


def _region(asked: ReachOptions, file: FileOptions, arm: Any, deg: bool) -> Any:
    """Return the requested region, or single poses."""
    if asked.poses is not None:
        poses = file.poses(asked.poses, arm, deg)
        if poses.ndim != 3:
            raise InvalidOption(
                f"'{asked.poses}' has positions; loose poses need orientations, and a region has positions"
            )
        return poses
    if asked.region is None:
        return None
    import numpy as np

    from ..text import vector

    return np.array(vector(asked.region, "--region", 6)).reshape(2, 3)


def _word_or_count(text: str, word: str, name: str, what: str) -> Any:
    """Return the text if it is the word, or the whole number in it. Raises InvalidOption."""
    try:
        return text if text == word else decimal(text, int)
    except ValueError:
        raise InvalidOption(f"{name} is '{word}' or a number of {what}, not '{text}'") from None


def _draw(found: Any, arm: Any, asked: ReachOptions) -> None:
    """Print which file was written, and draw the requested pictures."""
    if asked.output is not None:
        notice(f"wrote {asked.output} ({asked.output.stat().st_size / 1e6:.1f} MB)")
    chart(asked.plot, found)
    show_scene(arm, found, asked.html, title=f"{arm.name}: what {arm.tip} reaches")
