"""Pages made from the code at every build: command line, solvers, robots, statuses, API; and the notebooks, copied.

Everything goes to docs/generated/ and docs/notebooks/, which are not committed.
"""

import re
import shutil
import sys
from pathlib import Path

ROOMS = {  # how the public names are grouped in the API page, by the module they live in
    "Robots and targets": ("robot.",),
    "Solving": ("solvers.solve", "solvers.prepare", "solvers.batch", "solvers.result", "solvers.status"),
    "Solvers and their parameters": ("solvers.protocol", "solvers.rules.", "solvers.closed_form."),
    "Tracking": ("tracking.",),
    "Paths": ("paths.",),
    "Studies": ("study.", "papers."),
    "Pictures": ("show.",),
    "Errors": ("errors",),
}
LIVE = {"hydrolek_7w": [], "brokk_hydrolek": ["left_tip", "right_tip"]}  # robots with a live page, and their tips


def write_all(source: Path) -> None:
    """Write every generated page below the docs folder `source`."""
    folder = source / "generated"
    folder.mkdir(exist_ok=True)
    for name, page in (
        ("cli.md", cli_page()),
        ("solvers.md", solvers_page()),
        ("robots.md", robots_page()),
        ("statuses.md", statuses_page()),
        ("options.md", options_page()),
        ("api.rst", api_page()),
    ):
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != page:
            path.write_text(page, encoding="utf-8")
    write_scenes(source)
    copies = source / "notebooks"
    copies.mkdir(exist_ok=True)
    for old in copies.glob("*.ipynb"):
        old.unlink()
    for notebook in sorted((source.parent / "notebooks").glob("*.ipynb")):
        shutil.copy(notebook, copies)


def write_scenes(source: Path) -> None:
    """Write the scenes of shipped robots as pages that can be turned, and live pages, below the built site's scenes/ and live/."""
    import ik_toolkit as ik

    sys.path.insert(0, str(source.parent / "scripts"))
    from make_pictures import SCENES, SHIPPED

    folder = source / "generated" / "extra" / "scenes"
    folder.mkdir(parents=True, exist_ok=True)
    for name in SHIPPED:
        SCENES[name]().save(folder / f"{name}.html")
    pages = source / "generated" / "extra" / "live"
    pages.mkdir(exist_ok=True)
    for name, tips in LIVE.items():
        robot = ik.Tree.load(name, tips=tips) if tips else ik.Robot.load(name)
        ik.view(robot).page(pages / f"{name}.html")


# ------------------------------------------------------------------------------------------------ pages
def table(head: list[str], rows: list[list[str]]) -> str:
    """Markdown table; bars and line breaks in cells are made harmless."""

    def line(cells: list[str]) -> str:
        return "| " + " | ".join(" ".join(str(c).split()).replace("|", "\\|") for c in cells) + " |"

    return "\n".join([line(head), "|" + " --- |" * len(head), *map(line, rows)]) + "\n"


def cli_page() -> str:
    """Every command with its arguments and options."""
    import typer

    from ik_toolkit.cli import application
    from ik_toolkit.cli.usage import placeholder

    root = typer.main.get_command(application())
    parts = [
        "# The command `ik`\n",
        _plain(root.help or ""),
        "Made from the commands themselves; `ik COMMAND --help` says the same.\n",
    ]
    for name, command in root.commands.items():
        if command.hidden:
            continue
        arguments = [p for p in command.params if not p.opts[0].startswith("-")]
        usage = "".join(f"{placeholder(p)} " for p in arguments)
        parts.append(f"## ik {name}\n\n```text\nik {name} {usage}[OPTIONS]\n```\n\n{_plain(command.help or '')}")
        rows = []
        for p in command.params:
            flag = getattr(p, "is_flag", False)
            shown = placeholder(p) if p in arguments else ""
            if p not in arguments:
                shown = ", ".join([*p.opts, *p.secondary_opts]) + ("" if flag else f" {_metavar(p)}")
            default = "" if flag or p.default in (None, [], ()) or callable(p.default) else f" Default: {p.default}."
            rows.append([f"`{shown}`", _escape_md((p.help or "") + default)])
        if rows:
            parts.append(table(["option", "meaning"], rows))
        parts.append(f"```text\n{command.epilog.strip()}\n```")
    return "\n\n".join(parts)


def _metavar(parameter) -> str:
    """Word that stands for a parameter's value."""
    return parameter.metavar or parameter.name.upper()


def _plain(text: str) -> str:
    """Help text as paragraphs of Markdown."""
    paragraphs = re.split(r"\n\s*\n", text.replace("\b", "").replace("\f", "").strip())
    return "\n\n".join(_escape_md(" ".join(p.split())) for p in paragraphs) + "\n"


def _escape_md(text: str) -> str:
    return re.sub(r"([*_<>\[\]])", r"\\\1", text)


def solvers_page() -> str:
    """Table of the registry."""
    from ik_toolkit.solvers.registry import ROWS

    return table(
        ["name", "how", "handles", "source"],
        [[f"`{row.name}`", _escape_md(row.summary), _escape_md(row.handles), row.citation] for row in ROWS],
    )


def robots_page() -> str:
    """Table of the shipped robots."""
    from ik_toolkit.robot.library import list_robots

    rows = [row for row in list_robots() if row.paper]
    return table(
        ["name", "tips", "what", "from", "table"],
        [[f"`{r.name}`", ", ".join(f"`{t}`" for t in _tips(r)), r.description, r.paper, r.table] for r in rows],
    )


def _tips(row) -> list[str]:
    tips = getattr(row, "tips", None) or getattr(row, "tip", "")
    return [tips] if isinstance(tips, str) else list(tips)


MEANINGS = {
    "CONVERGED": "both errors are inside their tolerances, confirmed by Pinocchio",
    "STALLED": "no further progress: a local minimum of the error, or nothing better after all starts",
    "ITERATION_LIMIT": "the iterations, or the evaluations allowed, ran out while the error was still falling",
    "LIMIT_BLOCKED": "joint limits stand in the way; the message names the joints",
    "UNREACHABLE": "proven out of reach, by a bound from the link lengths or by a closed form; the message says by how much",
    "SINGULAR": "no joint motion reduces the error to first order",
    "NOT_FINITE": "the solver diverged, usually because the gains are too high",
    "CHECK_FAILED": "the kernel reported success and Pinocchio did not confirm it: a bug",
    "COLLISION": "the target was met, but every answer found touches something (only with avoid_collisions)",
    "TOO_FAR": "the answer, if there is one, is further from q0 than follow allows a joint to move",
}


def statuses_page() -> str:
    """Table of the statuses: what each means, and the advice of its message."""
    from ik_toolkit.solvers.status import ADVICE, Status

    return table(
        ["status", "meaning", "advice in the message"],
        [[f"`{s.name}`", MEANINGS[s.name], ADVICE.get(s, "")] for s in Status],
    )


def options_page() -> str:
    """Table of the options every solver takes, with defaults."""
    from dataclasses import fields

    from ik_toolkit.solvers.options import Options

    return table(["option", "default"], [[f"`{f.name}`", f"`{f.default!r}`"] for f in fields(Options)])


def api_page() -> str:
    """Every public name with its docstring, grouped by room."""
    import inspect

    import ik_toolkit as ik

    parts = ["API", "===", "", "Every public name of ``ik_toolkit``, from its docstring. Names load on first use.", ""]
    names = dict(ik._NAMES)
    for title, beginnings in ROOMS.items():
        members = [name for name, module in names.items() if module.startswith(beginnings)]
        if not members:
            continue
        parts += [title, "-" * len(title), ""]
        for name in members:
            names.pop(name)
            value = getattr(ik, name)
            kind = "autoclass" if inspect.isclass(value) else "autofunction"
            parts += [f".. {kind}:: ik_toolkit.{name}", *_members(value), ""]
    if names:
        raise RuntimeError(f"public names without a place in the API page: {', '.join(names)}")
    return "\n".join(parts) + "\n"


def _members(value) -> list[str]:
    """Options of autoclass: methods of classes, but not the fields of rules and the numbers of an enum."""
    import enum
    import inspect

    if not inspect.isclass(value):
        return []
    if issubclass(value, enum.Enum):
        return ["   :members:", "   :undoc-members:", "   :no-inherited-members:"]
    inherited = ["   :inherited-members:"] if value.__name__ == "Robot" else []
    return ["   :members:", *inherited]


# ------------------------------------------------------------------------------------------------ autodoc
def escape_docstring(app, what, name, obj, options, lines: list[str]) -> None:
    """Docstrings are plain text: code in backticks becomes literal, everything else loses its special meaning."""
    out = []
    for line in lines:
        stripped = line.strip()
        indented = line.startswith("    ") and stripped
        pieces = re.split(r"(`[^`]+`)", line)
        text = "".join(
            f"``{piece[1:-1]}``"
            if piece.startswith("`") and piece.endswith("`") and len(piece) > 2
            else re.sub(r"([\\*|_`])", r"\\\1", piece)
            for piece in pieces
        )
        out.append(f"| {text.strip()}" if indented else text)
    lines[:] = out


def skip_member(app, what, name, obj, skip, options) -> bool | None:
    """Leave out the fields and tuple methods of named tuples, and what the toolkit asks of every solver (see the guide)."""
    from ik_toolkit.solvers.protocol import ClosedForm, Rule

    asked = {*vars(Rule), *vars(ClosedForm)} - {"preset"}
    if name in {"count", "index", "designed", "resolve", *asked} or type(obj).__name__ == "_tuplegetter":
        return True
    return None
