"""How a command declares its options: records of fields, each with its type, its default and its help."""

from pathlib import Path
from types import SimpleNamespace

import pytest
import typer

from ik_toolkit.cli.command import TIP, add_commands, argument, command, flag, option, options, same, writable
from ik_toolkit.errors import InvalidOption


@options("Robot")
class Arm:
    robot: str = argument("ROBOT", "Which one.")
    tip: list[str] | None = option("FRAME", "Which end.", *TIP)
    limit: str | None = option("X Y", "How far.")


@options()
class OneTip(Arm):
    tip: str | None = option("FRAME", "The end.", *TIP)
    limit: None = None


@options()
class Own:
    count: int = option("N", "How many.", default=3, panel="Solver")
    limits: bool = flag("--limits/--no-limits", "Enforce limits.", default=True)
    file: Path | None = option("FILE", "Where to.", "-o", "--output", writes=[".csv"])
    extra: str | None = same(Arm, "limit", default="1 2")


def made(*functions):
    """Commands of functions, by name, as a module that has them declares them."""
    app = typer.Typer()
    module = SimpleNamespace(__name__=__name__, **{one.__name__: one for one in functions})
    app.callback()(lambda: None)
    add_commands(app, module)
    return typer.main.get_command(app).commands


def test_a_command_gets_the_records_of_its_command_line(tmp_path):
    got = []

    @command
    def move(own: Own, arm: Arm) -> None:
        """Move it.

        Examples:
        ik move arm
        """
        got.extend([own, arm])

    one = made(move)["move"]
    one(["arm", "--limit", "-1", "2", "--count", "5", "-o", str(tmp_path / "x.csv")], standalone_mode=False)
    own, arm = got
    assert (own.count, own.limits, own.file) == (5, True, tmp_path / "x.csv") and own.extra == "1 2"
    assert (arm.robot, arm.limit) == ("arm", "-1 2")
    assert one.help == "Move it." and one.epilog == "ik move arm"
    assert [p.name for p in one.params] == ["count", "limits", "file", "extra", "robot", "tip", "limit"]
    assert [p.rich_help_panel for p in one.params[:2]] == ["Solver", "Options"]


def test_a_record_takes_over_options_of_another_or_leaves_them_out():
    @command
    def look(arm: OneTip) -> None:
        """Look."""

    found = {p.name: p for p in made(look)["look"].params}
    assert list(found) == ["robot", "tip"] and not found["tip"].multiple
    assert found["tip"].rich_help_panel == "Options" and found["robot"].rich_help_panel == "Robot"


def test_an_option_declared_twice_is_refused():
    with pytest.raises(ValueError, match="duplicate parameter name"):

        @command
        def twice(one: Arm, other: OneTip) -> None:
            """Twice."""


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    output = SimpleNamespace(opts=["-o", "--output"])
    assert writable()(output, None) is None and writable(".csv")(output, tmp_path / "x.CSV") == tmp_path / "x.CSV"
    with pytest.raises(InvalidOption, match=r"the file of -o/--output is written as \.csv, not 'x\.txt'"):
        writable(".csv")(output, tmp_path / "x.txt")
