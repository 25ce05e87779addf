"""`--help`: full names, no parser placeholders, nothing wider than the terminal, working examples."""

import re
import shlex

import pytest
import typer

from ik_toolkit.cli import application, main

ROOT = typer.main.get_command(application())
NAMES = [name for name, command in ROOT.commands.items() if not command.hidden]


@pytest.mark.parametrize("width", [60, 80, 140])
@pytest.mark.parametrize("name", ["", *NAMES])
def test_help_is_whole(name, width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    assert main([*([name] if name else []), "--help"]) == 0
    said = capsys.readouterr().out
    assert "…" not in said and "<bool>" not in said and "[[" not in said and "{" not in said
    options = said.partition("Examples:")[0]
    assert max(map(len, options.splitlines())) <= width
    assert name or all(command in options.split() for command in NAMES)
    params = ROOT.commands[name].params if name else []
    names = [part for one in params for part in one.opts + one.secondary_opts]
    assert len(set(names)) == len(names)
    for one in params:
        if not getattr(one, "hidden", False):
            assert all(part in options.split() or f"{part}," in options.split() for part in one.opts if part[:1] == "-")


@pytest.mark.parametrize("name", NAMES)
def test_help_ends_with_examples_that_are_commands(name, capsys):
    assert main([name, "--help"]) == 0
    examples = capsys.readouterr().out.partition("Examples:\n")[2].splitlines()
    assert examples and shlex.split(examples[0])[:2] == ["ik", name]
    for line in examples:
        _, command, *arguments = shlex.split(line)
        assert len(line) <= 80  # with their indent, they fit a terminal that wide
        ROOT.commands[command].make_context(command, arguments)


def test_options_of_solve_stand_in_groups(capsys):
    assert main(["solve", "--help"]) == 0
    said = capsys.readouterr().out
    groups = re.findall(r"^(\w[\w ]*):$", said, re.MULTILINE)
    assert groups[:2] == ["Arguments", "Target"] and groups[-3:] == ["Output", "Other", "Examples"]
    assert {"Solver", "Tolerances", "Collisions", "Robot"} <= set(groups) and "Options" not in groups
