"""`ik solvers`: list of the solvers, and the parameters of one."""

import inspect
import re
from typing import Any

from ..errors import InvalidOption
from .command import argument, command, options
from .completion import solvers_like
from .options import TableOutput, solver_named
from .output import heading, show, table, write_json, write_rows

TOLD = ("name", "summary", "handles", "citation")


@options()
class SolversOptions(TableOutput):
    """Options of `ik solvers`: one solver to describe, or none to list all."""

    name: str | None = argument("[NAME]", "Show this solver's parameters.", default=None, complete=solvers_like)


@command
def solvers(asked: SolversOptions) -> None:
    """List the solvers, or show one: parameters, defaults, options, source.

    Examples:
    ik solvers
    ik solvers lm
    """
    from ..solvers.registry import find_row, list_rows

    if asked.name is not None:
        if asked.csv_file is not None:
            raise InvalidOption("--csv writes the list of solvers; leave out the name")
        _one(find_row(solver_named(asked.name)), asked.as_json)
        return
    rows = [{key: getattr(row, key) for key in TOLD} for row in list_rows()]
    write_json({"solvers": rows}, asked.as_json)
    write_rows(asked.csv_file, rows[0], (row.values() for row in rows))
    if not asked.as_json:
        show(table("<name", "how", "handles", "source", rows=[row.values() for row in rows]))


def _one(row: Any, as_json: bool) -> None:
    from ..solvers.options import Options

    cls = row.load()
    defaults = getattr(cls, "_field_defaults", {})
    parameters = [{"name": key, "default": defaults.get(key)} for key in getattr(cls, "_fields", ())]
    options = {key: field.default for key, field in Options.__dataclass_fields__.items()}
    length = row.length()
    options |= {"max_iterations": length.iterations, "restarts": length.attempts - 1}
    text = inspect.getdoc(cls) or ""
    told = {"description": text, "parameters": parameters, "options": options}
    write_json({key: getattr(row, key) for key in TOLD} | told, as_json)
    if as_json:
        return
    from rich.text import Text

    show(heading(row.name), {"how": row.summary, "handles": row.handles, "source": row.citation})
    show("", Text(re.sub(r"(?<!\n)\n(?: {8} *|(?=\S))", " ", text)), "")
    if parameters:
        rows = [(one["name"], _shown(one["default"])) for one in parameters]
        show(heading("Parameters (-p NAME=VALUE)"), table("<parameter", ">default", rows=rows))
    rows = [(key, _shown(default)) for key, default in options.items()]
    show(heading("Options of every solver, with this solver's defaults"), table("<option", ">default", rows=rows))


def _shown(value: Any) -> str:
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
