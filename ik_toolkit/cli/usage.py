"""The text of `--help`: options in groups, names that are never broken, examples last."""

import re
import shutil
import textwrap
from typing import Any

import typer.core

from ..text import in_shell

# The base class of click's usage errors. It is found through typer, because some versions of typer contain their own copy of click.
UsageError: type[Exception] = typer.BadParameter.mro()[2]
# Arguments of the library whose options of `ik` have other names.
PYTHON_NAMES = {
    "acceleration_limits": "acceleration", "relative_to": "relative", "count": "suggest", "package_dirs": "package_dir",
    "xacro_args": "xacro_arg", "base_limits": "rail",
}  # fmt: skip
# A regular expression for a library argument that is the subject of an error message, to replace it by the name of the option.
SUBJECT = re.compile(r"^(no )?([a-z]\w*)()(?=: | \[| \(| must | is | has | of '| ')")
# A regular expression for arguments with a value in an error message, such as limits=False, tip= or base='world'. Nothing in
# quotes matches, because that is what a user has typed.
WITH_VALUE = re.compile(r"(?<![\w'.])()([a-z]\w*)=(True|False)?(?=[\s,.;)']|$)")
WIDEST = 100  # The help is at most this wide [characters], because longer lines are hard to read.
COLUMN = 30  # In the help the explanations of options begin at this column.
LAST = ("Robot", "Output", "Other")  # These groups of options come last in the help.


def help_text(command: Any, ctx: Any) -> str:
    """Return the help of a command or of the whole program."""
    width = min(shutil.get_terminal_size().columns, WIDEST)
    arguments = [p for p in command.get_params(ctx) if p.param_type_name == "argument"]
    options = [p for p in command.get_params(ctx) if p.param_type_name == "option" and not p.hidden]
    commands = [command.get_command(ctx, name) for name in getattr(command, "commands", ())]
    usage = " ".join(
        ["Usage:", ctx.command_path, *(["COMMAND"] if commands else map(placeholder, arguments)), "[OPTIONS]"]
    )
    paragraphs = (" ".join(one.split()) for one in (command.help or "").split("\n\n"))
    parts = [usage, *(textwrap.fill(one, width, break_on_hyphens=False) for one in paragraphs)]
    groups: dict[str, list[tuple[str, str]]] = {}
    if commands:
        groups["Commands"] = [(one.name, one.get_short_help_str(10 * WIDEST)) for one in commands if not one.hidden]
    for one in arguments:
        groups.setdefault("Arguments", []).append((placeholder(one), one.help or ""))
    for one in options:
        group = getattr(one, "rich_help_panel", None) or "Other"
        groups.setdefault(group, []).append((_names(one), _explained(one)))
    order = sorted(groups, key=lambda name: LAST.index(name) if name in LAST else -1)
    for name in order:
        column = min(COLUMN, max(len(left) for left, _ in groups[name]) + 4)
        parts.append("\n".join([f"{name}:", *(_row(*row, column, width) for row in groups[name])]))
    if command.epilog:
        parts.append("Examples:\n" + textwrap.indent(command.epilog.strip(), "  "))
    return in_shell("\n\n".join(parts) + "\n")


def placeholder(argument: Any) -> str:
    """Return a click argument as the help shows it: ROBOT, [ROBOT] if it is optional, [ROBOT ...] if there may be several."""
    name = (argument.metavar or argument.name).strip("[].").upper()
    several = name + (" ..." if argument.nargs == -1 else "")
    return several if argument.required else f"[{several}]"


def _names(option: Any) -> str:
    """Return the names of an option, the short one first, followed by the placeholder of its value."""
    names = sorted(option.opts, key=lambda name: name.startswith("--"))
    if option.is_flag:
        return " / ".join([", ".join(names), *option.secondary_opts])
    return f"{', '.join(names)} {option.metavar or option.name.upper()}"


def _explained(option: Any) -> str:
    """Return the help text of an option, with its default if the text does not mention it."""
    said, default = option.help or "", option.default
    if default in (None, (), [], "") or callable(default) or "default" in said.lower():
        return said
    if option.is_flag:
        if not option.secondary_opts:
            return said
        default = (option.opts if default else option.secondary_opts)[0]
    return f"{said} [default: {default}]"


def _row(left: str, right: str, column: int, width: int) -> str:
    """Return name and explanation side by side, or below each other if the name is long."""
    lines = textwrap.wrap(right, max(width - column, 20), break_on_hyphens=False) or [""]
    first = f"  {left}".ljust(column) + lines.pop(0) if len(left) + 4 <= column else f"  {left}"
    return "\n".join([first.rstrip(), *(" " * column + line for line in lines)])


def in_flags(text: str, command: Any) -> str:
    """Replace names of library arguments in an error message by option names: acceleration_limits by --acceleration.

    Many names are ordinary words, too; only the subject of a sentence, or a name before "=", is taken for an option.
    """
    options = {one.name.rstrip("_"): one for one in command.params if one.param_type_name == "option"}
    # Options whose parameter has another name, such as `targets` for --target, are left out.
    options = {name: one for name, one in options.items() if f"--{name.replace('_', '-')}" in one.opts}
    options |= {name: options[own] for name, own in PYTHON_NAMES.items() if own in options}

    def flag(found: re.Match[str]) -> str:
        no, name, value = found.groups()
        if name not in options or (no and "_" not in name):
            return found[0]
        option = options[name]
        names = option.secondary_opts if value == "False" else option.opts
        space = " " if found.string[found.end() :].startswith("'") and "=" in found[0] else ""
        return (no or "") + next((one for one in names if one.startswith("--")), found[0]) + space

    return WITH_VALUE.sub(flag, SUBJECT.sub(flag, text))


class Group(typer.core.TyperGroup):
    """The click group of the program `ik`, which formats its help like that of the commands."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help text of the program."""
        formatter.write(help_text(self, ctx))
