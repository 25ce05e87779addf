"""Declaration of the options of a command of `ik`: fields of frozen dataclasses, with type, default and help text."""

import contextlib
import functools
import importlib.metadata
import inspect
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args, get_type_hints

import typer
import typer.core

from ..errors import IKError, InvalidOption, MissingExtra
from ..files import as_output, require_place
from ..text import comma_hint, decimal, numbers
from .usage import UsageError, help_text, in_flags

TIP = ("--tip", "--ee")  # The option that names a tip has these two names.
MANY = "for many targets of one tip use ik solve --targets FILE, or ik path --poses FILE for one motion through them"
PLOTS = (".png", ".pdf", ".svg")
REQUIRED = MISSING  # An option or argument with this as its default must be given.
Record = TypeVar("Record")


# ------------------------------------------------------------------------------------------------------------- records
def option(
    metavar: str,
    meaning: str,
    *names: str,
    default: Any = None,
    panel: str | None = None,
    writes: Sequence[str] | None = None,
    complete: Callable[..., Any] | None = None,
    needs: Sequence[str] = (),
    without: Sequence[str] = (),
) -> Any:
    """Return a dataclass field for an option with a value, which is named after the field unless `names` are given.

    A metavar of several words or numbers, as X Y Z, makes it take several numbers: `--q 0.1 -0.2`, `--q 0.1,-0.2` and
    `--q "0.1 -0.2"` mean the same. panel: the group in the help, by default the class's. writes: suffixes of the file
    that the option names and `ik` writes; an empty list allows any. complete: lists what the shell offers. needs: options
    ("--retime", "--on-limit slow", an argument as "PAPER") without which it has no effect; one of them must be given, if
    the command has any of them. without: options that are refused beside it, because one of the two would have no effect.
    """
    check = None if writes is None else writable(*writes)
    made = typer.Option(
        *names, metavar=metavar, help=meaning, rich_help_panel=panel, callback=check, autocompletion=complete
    )
    return _field(default, made, needs, without)


def flag(
    name: str,
    meaning: str,
    default: bool = False,
    panel: str | None = None,
    hidden: bool = False,
    callback: Callable[..., Any] | None = None,
    needs: Sequence[str] = (),
    without: Sequence[str] = (),
) -> Any:
    """Return a dataclass field for an option without a value: --name, or --name/--no-name if it can be negated."""
    made = typer.Option(name, help=meaning, rich_help_panel=panel, hidden=hidden, callback=callback)
    return _field(default, made, needs, without)


def argument(metavar: str, meaning: str, default: Any = REQUIRED, complete: Callable[..., Any] | None = None) -> Any:
    """Return a dataclass field for a positional argument."""
    return _field(default, typer.Argument(metavar=metavar, help=meaning, autocompletion=complete))


def same(record: Any, name: str, default: Any = REQUIRED, without: Sequence[str] = ()) -> Any:
    """Return a dataclass field that repeats an option of another class, with the same default or another one.

    without: options that are refused beside it, as for `option`; they replace those of the other class.
    """
    (one,) = (one for one in fields(record) if one.name == name)
    metadata = {**one.metadata, "without": without} if without else one.metadata
    return field(default=one.default if default is REQUIRED else default, metadata=metadata)


def _field(default: Any, info: Any, needs: Sequence[str] = (), without: Sequence[str] = ()) -> Any:
    return field(default=default, metadata={"info": info, "needs": needs, "without": without})


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def options(panel: str | None = None) -> Callable[[type[Record]], type[Record]]:
    """Make a class a frozen dataclass of options, shown under `panel` in the help unless a field names another group.

    A subclass leaves out an inherited option by setting a field of that name to plain None.
    """

    def make(cls: Any) -> Any:
        # Records of options are not compared or printed. Making the methods for that would only slow down each start.
        made = dataclass(frozen=True, kw_only=True, eq=False, repr=False)(cls)
        for one in _declared(made):
            info = one.metadata["info"]
            info.rich_help_panel = info.rich_help_panel or panel or "Options"
        return made

    return make


def _declared(record: Any) -> list[Any]:
    """Return the fields of a class of options that are on the command line."""
    return [one for one in fields(record) if "info" in one.metadata]


def command(function: Callable[..., None]) -> Callable[..., None]:
    """Decorate a function as a command of `ik`. Its parameters are annotated with classes of options.

    The help shows the options in the order of the classes and their fields, then the examples of the function's
    docstring.
    """
    records = get_type_hints(function)
    records.pop("return", None)

    @functools.wraps(function)
    def run(**values: Any) -> None:
        function(
            **{name: cls(**{one.name: values[one.name] for one in _declared(cls)}) for name, cls in records.items()}
        )

    parameters, rules = [], {}
    for record in records.values():
        types = get_type_hints(record)
        for one in _declared(record):
            rules[one.name] = one.metadata
            kind, info = inspect.Parameter.KEYWORD_ONLY, one.metadata["info"]
            default = inspect.Parameter.empty if one.default is MISSING else one.default
            if number := {*get_args(types[one.name]), types[one.name]} & {int, float}:
                info.parser, info.callback = str, numeric(number.pop())
            annotation = Annotated[types[one.name], info]
            parameters.append(inspect.Parameter(one.name, kind, default=default, annotation=annotation))
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.rules = rules  # type: ignore[attr-defined]
    return run


def add_commands(app: typer.Typer, module: Any) -> None:
    """Add the commands of a module to the command line program."""
    for one in vars(module).values():
        if hasattr(one, "rules") and one.__module__ == module.__name__:
            # Python started with -OO removes docstrings, so there may be none.
            said, _, examples = (inspect.getdoc(one) or "").partition("\n\nExamples:\n")
            app.command(cls=Command, help=said, epilog=inspect.cleandoc(examples))(one)


# --------------------------------------------------------------------------------------------------------------- files
def writable(*suffixes: str) -> Callable[[typer.CallbackParam, Path | None], Path | None]:
    """Return a callback for an option that names an output file; it checks the path before the work starts.

    It raises an error for a wrong suffix, a missing folder, or a package that is needed to draw the file and not installed.
    """

    def check(param: typer.CallbackParam, file: Path | None) -> Path | None:
        if file is None:
            return None
        if suffixes:
            as_output(file, f"the file of {'/'.join(param.opts)}", *suffixes)
        for kind, package, extra in ((".png", "matplotlib", "plots"), (".html", "trimesh", "view")):
            if kind in suffixes:
                require_extra(package, extra)
        require_place(file)
        return file

    return check


def require_extra(package: str, extra: str) -> None:
    """Raise MissingExtra, before any work is done, if a package is not installed; extra: name of the extra that installs it."""
    try:
        # The metadata of a package are looked for and not its module, which a package of data does not have.
        importlib.metadata.distribution(package)
    except importlib.metadata.PackageNotFoundError:
        raise MissingExtra(package, extra) from None


def can_show(_: typer.CallbackParam, live: bool) -> bool:
    """Return the value of an option that shows a scene once the work is done. Raises MissingExtra if it cannot be drawn."""
    if live:
        require_extra("trimesh", "view")
    return live


def numeric(kind: type) -> Callable[[typer.CallbackParam, Any], Any]:
    """Return a callback that reads an option's text as a float or int (kind); it raises InvalidOption for nan and for text."""

    def read(param: typer.CallbackParam, given: Any) -> Any:
        if given is None:
            return None
        with contextlib.suppress(ValueError):
            if (value := decimal(str(given), kind)) == value:
                return value
        name = "/".join(param.opts)
        what, hint = ("a whole number", "") if kind is int else ("a number", comma_hint(str(given), name, (1,)))
        raise InvalidOption(f"{name} takes {what}, not '{given}'{hint}")

    return read


def _same_file(one: str | Path, other: str | Path) -> bool:
    """Return whether two paths are the same file, existing or not; links, and case on systems that ignore it, are considered."""
    if os.path.exists(one) and os.path.exists(other):
        return os.path.samefile(one, other)
    return os.path.realpath(one) == os.path.realpath(other)


def above_zero(value: float, name: str) -> float:
    """Return the value of an option unchanged. Raises InvalidOption unless the value is positive and finite."""
    if not 0.0 < value < math.inf:
        raise InvalidOption(f"{name} must be positive and finite, not {value:g}")
    return value


def in_radians(angle: float, deg: bool) -> float:
    """Return a typed angle in radians; deg: whether it was typed in degrees, as --deg says."""
    return math.radians(angle) if deg else angle


# ------------------------------------------------------------------------------------------------------------- parsing
class Command(typer.core.TyperCommand):
    """The click class of each command of `ik`, with checks that click does not make.

    It refuses several tips where one is taken, an output file that is also an input, and one file for two outputs.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words of the command line. Raises InvalidOption for a second target or tip, UsageError for unknown options."""
        several = {
            name for one in self.params if set(" ,") & set(one.metavar or "") for name in one.opts if name[:2] == "--"
        }
        args = _joined(args, several)
        # If the shell asks for a completion, the last option may still lack its value, which the parser would refuse.
        if ctx.resilient_parsing:
            return super().parse_args(ctx, args[:-1] if args and args[-1].startswith("-") else args)
        tips = sum(word.partition("=")[0] in TIP for word in args)
        # If --tip is given several times, click would silently use the last one.
        if tips > 1 and any(one.name == "tip" and not one.multiple for one in self.params):
            names = " or ".join(TIP)
            raise InvalidOption(f"{ctx.command_path} takes one tip and {names} names {tips}; choose one of them")
        for one in self.params:
            if one.name in ("xyz", "matrix") and sum(word.partition("=")[0] in one.opts for word in args) > 1:
                raise InvalidOption(f"{one.opts[0]} is given twice; {MANY}")
        try:
            # click's parser empties the list that it is given, so it gets a copy.
            return super().parse_args(ctx, [*args])
        except UsageError as error:
            error.ctx = ctx  # type: ignore[attr-defined]  # needed for the hint on --help; errors of missing values lack it
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help text of this command."""
        formatter.write(help_text(self, ctx))

    def invoke(self, ctx: Any) -> Any:
        """Run the command. Raises InvalidOption for an option without effect, and errors of the library with its options named."""
        self._check_together(ctx)
        written = [
            ctx.params[one.name] for one in self.params if one.callback and isinstance(ctx.params[one.name], Path)
        ]
        for k, output in enumerate(written):
            if any(_same_file(output, other) for other in written[:k]):
                raise InvalidOption(f"two results cannot be written to one file, '{output}'")
        for value in ctx.params.values():
            for word in value if isinstance(value, list | tuple) else [value]:
                if not isinstance(word, str | Path) or any(word is output for output in written):
                    continue
                # An argument may have the form SOLVER=FILE, and then FILE is read.
                read = str(word).rpartition("=")[2] if not os.path.isfile(word) else word
                for output in written:
                    if os.path.isfile(read) and _same_file(output, read):
                        what = f"'{output}' would overwrite '{read}', which is an input"
                        raise InvalidOption(f"{what}; choose another name")
        try:
            return super().invoke(ctx)
        except IKError as error:
            error.args = (in_flags(str(error), self), *error.args[1:])
            raise

    def _check_together(self, ctx: Any) -> None:
        """Raise InvalidOption for an option that was given without any of those that it needs, or beside one that it excludes."""
        values = {
            name.upper() if one.param_type_name == "argument" else name: ctx.params[one.name]
            for one in self.params
            for name in one.opts
        }

        def met(need: str) -> bool:
            name, _, value = need.partition(" ")
            return values[name] == value if value else bool(values[name])

        typed = [one for one in self.params if ctx.get_parameter_source(one.name).name == "COMMANDLINE"]
        given = {name for one in typed for name in one.opts}
        for one in typed:
            rules, names = self.callback.rules[one.name], "/".join([*one.opts, *one.secondary_opts])  # type: ignore[union-attr]
            needs = [need for need in rules["needs"] if need.partition(" ")[0] in values]
            if needs and not any(map(met, needs)):
                raise InvalidOption(f"{names} has no effect without {' or '.join(needs)}")
            if excluded := [name for name in rules["without"] if name in given]:
                raise InvalidOption(f"{names} cannot be combined with {' or '.join(excluded)}")


def _joined(words: Sequence[str], several: set[str]) -> list[str]:
    """Join the numbers that follow one of these options into one argument (the parser takes one, and reads -1 as an option)."""
    joined: list[str] = []
    collecting = False
    for position, word in enumerate(words):
        if word == "--":
            return [*joined, *words[position:]]
        # The first word after an option with several numbers belongs to it: a number, or TIP:NUMBER.
        if collecting and joined[-1].endswith("="):
            joined[-1] += word
            continue
        if collecting and _like_a_number(word):
            joined[-1] += f" {word}"
            continue
        after = words[position + 1] if position + 1 < len(words) else ""
        collecting = word in several and (after[:1] not in ("", "-") or _like_a_number(after))
        joined.append(f"{word}=" if collecting else word)
    return joined


def _like_a_number(word: str) -> bool:
    """Return whether a word is a number, or so like one (1_0) that it belongs to the numbers before it."""
    return numbers(word) is not None or re.fullmatch(r"[-+]?\d[\d_.,eE+-]*", word) is not None
