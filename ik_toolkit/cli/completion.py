"""What the shell offers for an incomplete word: names of robots, links, tips and solvers."""

import contextlib

import typer

from ..errors import IKError


def robots_like(incomplete: str) -> list[tuple[str, str]]:
    """Return the robot names that begin with an incomplete word, each with a description, for completion in the shell.

    If there are none, the shell completes file names.
    """
    from ..robot.library import data_files, list_robots

    known = {entry.name: entry.description for entry in list_robots()}
    # The other robots of example-robot-data, whose tips are guessed, are offered only if no listed robot matches.
    for names in (known, dict.fromkeys(data_files(), "example-robot-data")):
        if found := [row for row in names.items() if row[0].startswith(incomplete)]:
            return found
    return []


def links_like(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the links that begin with an incomplete word, of the robot on the command line, for completion in the shell."""
    from ..robot.formats.urdf import parse, safe_read
    from ..robot.library import find

    with contextlib.suppress(IKError):
        items = parse(safe_read(find(ctx.params.get("robot") or "").source))
        return [item.name for item in items if item.tag == "link" and item.name.startswith(incomplete)]
    return []


def tips_like(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return tips that begin with an incomplete word, for completion in the shell.

    They are the known tips of the robot on the command line or, if none fits, its links.
    """
    from ..robot.library import find

    with contextlib.suppress(IKError):
        if found := [tip for tip in find(ctx.params.get("robot") or "").tips if tip.startswith(incomplete)]:
            return found
    return links_like(ctx, incomplete)


def solvers_like(incomplete: str) -> list[tuple[str, str]]:
    """Return completions of a comma-separated list of solvers, whose last name is incomplete, for the shell.

    Each is a whole list with a description of its last solver.
    """
    from ..solvers.registry import list_rows

    before, comma, word = incomplete.rpartition(",")
    rows = [("auto", "the one that fits robot and target"), *((row.name, row.summary) for row in list_rows())]
    return [(before + comma + name, what) for name, what in rows if name.startswith(word)]
