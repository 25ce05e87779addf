"""Pages made from the code at every build: command line, solvers, robots, statuses, API; and the notebooks, copied.

Everything goes to docs/generated/ and docs/notebooks/, which are not committed.
"""

import re
import shutil
import sys
from pathlib import Path

ROOMS = {  # how the public names are grouped in the API page, by the module they live in
    "Robots and targets": ("robot.",),
    "Solving": ("solvers.solve", "solvers.prepare", "solvers.batch.", "solvers.result", "solvers.status"),
    "Solvers and their parameters": ("solvers.protocol", "solvers.rules.", "solvers.closed_form."),
    "Tracking": ("servo.", "motion.reference", "motion.shapes", "motion.waypoints", "motion.teleop"),
    "Paths": ("paths.", "motion.trajectory"),
    "Studies": ("study.", "papers."),
    "Pictures": ("show.",),
    "Errors": ("errors",),
}
TABLE_INSTEAD = {
    "Robot",
    "Tree",
    "Result",
    "PathResult",
    "Trajectory",
    "TrackResult",
}  # docstrings that list attributes
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
        *api_pages().items(),
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
        "Generated from the commands; `ik COMMAND --help` shows the same text.\n",
    ]
    for name, command in root.commands.items():
        if command.hidden:
            continue
        arguments = [p for p in command.params if not p.opts[0].startswith("-")]
        usage = "".join(f"{placeholder(p)} " for p in arguments)
        parts.append(f"## ik {name}\n\n```text\nik {name} {usage}[OPTIONS]\n```\n\n{_plain(command.help or '')}")
        rows = []
        for p in sorted(command.params, key=lambda one: one not in arguments):
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
    from ik_toolkit.solvers.rows import ROWS

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


def statuses_page() -> str:
    """Table of the statuses: what each means, and the advice of its message."""
    from ik_toolkit.solvers.message import ADVICE
    from ik_toolkit.solvers.status import Status

    lines = " ".join((Status.__doc__ or "").split()).split(" - ")[1:]
    meanings = dict(line.split(": ", 1) for line in lines)
    return table(
        ["status", "meaning", "advice in the message"],
        [[f"`{s.name}`", meanings[s.name].removesuffix("."), ADVICE.get(s, "")] for s in Status],
    )


def options_page() -> str:
    """Table of the options every solver takes, with defaults."""
    from dataclasses import fields

    from ik_toolkit.solvers.options import Options

    return table(["option", "default"], [[f"`{f.name}`", f"`{f.default!r}`"] for f in fields(Options)])


def api_pages() -> dict[str, str]:
    """Every public name with its docstring: a page a room, and one that leads to them. File name -> text."""
    import inspect

    import ik_toolkit as ik

    names = dict(ik._NAMES)
    index = ["API", "===", "", "Every public name of ``ik_toolkit``. Names load on first use.", ""]
    pages, toc = {}, ["", ".. toctree::", "   :hidden:", ""]
    for title, beginnings in ROOMS.items():
        members = [name for name, module in names.items() if module.startswith(beginnings)]
        if not members:
            continue
        page = "api_" + title.lower().replace(" ", "_")
        links = ", ".join(f":py:obj:`~ik_toolkit.{name}`" for name in members)
        index += [f":doc:`{title} <{page}>`", f"   {links}", ""]
        toc.append(f"   {page}")
        parts = [title, "=" * len(title), ""]
        for name in members:
            names.pop(name)
            value = getattr(ik, name)
            kind = "autoclass" if inspect.isclass(value) else "autofunction"
            parts += [f".. {kind}:: ik_toolkit.{name}", *_members(value), ""]
        pages[f"{page}.rst"] = "\n".join(parts) + "\n"
    if names:
        raise RuntimeError(f"public names without a place in the API pages: {', '.join(names)}")
    return {"api.rst": "\n".join([*index, *toc]) + "\n", **pages}


def attributes_of(value) -> list[tuple[str, str, str, str]]:
    """Rows (name, shape and unit, default, meaning) of a class: from attributes.toml, and from its properties."""
    import dataclasses
    import inspect
    import tomllib

    known = tomllib.loads((Path(__file__).parent / "attributes.toml").read_text(encoding="utf-8")).get(
        value.__name__, {}
    )
    fields = getattr(value, "_fields", ())
    defaults = getattr(value, "_field_defaults", {})
    if dataclasses.is_dataclass(value):
        fields = [field.name for field in dataclasses.fields(value)]
    missing = [name for name in fields if name not in known]
    if (known or fields) and missing and not issubclass(value, BaseException):
        raise RuntimeError(f"attributes.toml says nothing of {value.__name__}: {', '.join(missing)}")
    bases = [base for base in value.__mro__ if base.__module__.startswith("ik_toolkit")]
    source = "".join(inspect.getsource(base) for base in bases)
    wrong = [
        name for name in known if not re.search(rf"\bself\.{name}\b|^    {name}\b[:, ]|def {name}\(", source, re.M)
    ]
    if wrong:
        raise RuntimeError(f"attributes.toml lists what {value.__name__} has not: {', '.join(wrong)}")
    rows = [(name, shape, _default(defaults.get(name)), text) for name, (shape, text) in known.items()]
    for name, member in properties_of(value).items():
        if name not in known:
            first = (member.__doc__ or "").strip().split("\n\n")[0]
            shapes = re.findall(r"\([^()]*,[^()]*\)|\[[^\[\]]*\]", first)
            shape = " ".join(one for one in shapes if re.fullmatch(r"\(?[\w+ ,]{1,12}\)?|\[.*\]", one))
            rows.append((name, shape, "", _without(" ".join(first.split()), shape)))
    return rows


def _without(text: str, shape: str) -> str:
    """Sentence without the shapes and units that have a column of their own, and without its full stop."""
    for one in re.findall(r"\([^()]*\)|\[[^\[\]]*\]", shape):
        text = text.replace(f" {one}", "", 1)
    text = text.rstrip(".")
    return text if text.startswith("Pinocchio") or not text[1:2].islower() else text[:1].lower() + text[1:]


def _default(value) -> str:
    return "" if value is None or len(repr(value)) > 20 else repr(value)


def properties_of(value) -> dict:
    """Public properties of a class and of what it inherits from this package."""
    import functools

    kinds = (property, functools.cached_property)
    found: dict = {}
    for base in value.__mro__:
        if base.__module__.startswith("ik_toolkit"):
            for name, member in vars(base).items():
                if isinstance(member, kinds) and not name.startswith("_"):
                    found.setdefault(name, member)
    return found


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
def escape(text: str) -> str:
    """Plain text for reStructuredText: code in backticks becomes literal, everything else loses its special meaning."""
    pieces = re.split(r"(`[^`]+`)", text)
    return "".join(
        f"``{piece[1:-1]}``"
        if piece.startswith("`") and piece.endswith("`") and len(piece) > 2
        else re.sub(r"([\\*|_`])", r"\\\1", piece)
        for piece in pieces
    )


SECTIONS = ("Args", "Returns", "Yields", "Raises", "Attributes")


def escape_docstring(app, what, name, obj, options, lines: list[str]) -> None:
    """Make reStructuredText of a docstring, which is plain text with sections such as `Args:` (Google's style).

    A class whose attributes are in attributes.toml gets a table of them; it replaces what the docstring says of attributes.
    """
    rows = attributes_of(obj) if what == "class" else []
    out: list[str] = []
    section = ""
    for line in lines:
        if line.rstrip(":") in SECTIONS and line.endswith(":"):
            section = line[:-1]
            if not (section == "Attributes" and rows):
                out += ["", f"**{section}**", ""]
        elif section and line.strip() and not line.startswith("    "):
            section = ""
            out += ["", escape(line)]
        elif section == "Attributes" and rows:
            continue
        elif section:
            if not line.strip():
                continue
            name, colon, rest = line[4:].partition(": ")
            entry = section != "Returns" and colon and not line.startswith("     ")
            out.append(
                f"- ``{name}``: {escape(rest)}" if entry else "  " * (section != "Returns") + escape(line.strip())
            )
        else:
            indented = line.startswith("    ") and line.strip()
            out.append(f"| {escape(line).strip()}" if indented else escape(line))
    if rows:
        if obj.__name__ in TABLE_INSTEAD:
            out = out[: next((k for k, line in enumerate(out) if not line.strip()), len(out))]
        out += ["", *list_table(rows), ""]
    lines[:] = out


def list_table(rows: list[tuple[str, str, str, str]]) -> list[str]:
    """Lines of a table of attributes: name, shape and unit, default, meaning; a column that is empty everywhere is left out."""
    head = ("name", "shape, unit", "default", "meaning")
    columns = [k for k in range(4) if any(row[k] for row in rows)]
    lines = [".. list-table::", "   :header-rows: 1", "   :class: attributes", ""]
    for row in (head, *((f"`{n}`", shape, f"`{d}`" if d else "", text) for n, shape, d, text in rows)):
        for i, k in enumerate(columns):
            lines.append(f"   {'* -' if not i else '  -'} {escape(row[k])}".rstrip())
    return lines


def skip_member(app, what, name, obj, skip, options) -> bool | None:
    """Leave out what stands in the table of attributes, and what the toolkit asks of every solver (see the guide)."""
    import functools

    from ik_toolkit.solvers.protocol import ClosedForm, Rule

    asked = {*vars(Rule), *vars(ClosedForm)} - {"preset"}
    if name in {"count", "index", "designed", "resolve", *asked} or type(obj).__name__ == "_tuplegetter":
        return True
    if isinstance(obj, property | functools.cached_property):
        return True
    return None
