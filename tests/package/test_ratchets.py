"""Measures of the form of the code, each with a ceiling that may only fall: lower it when the code has become better."""

import ast
import collections
import functools
import re

import pytest
from sources import PACKAGE, imports, modules, parsed, statements

CEILINGS = {
    "files outside folders that grow": 248,
    "public names defined in two files or more": 9,
    "file names used twice": 4,
    "functions of more than 9 parameters": 19,
    "constants of the most laden file of kernel and servo": 5,
    "constants of modules": 940,
    "uses of by_tip": 18,
    "imports for types alone": 3,
    "files under 120 lines that one other imports": 2,
}
SHORT = 120  # lines: a file that only one other imports belongs into it below this length
MANY = 9  # parameters
FREE = {
    "cli",
    "papers",
    "testing.py",
}  # commands and papers are read one by one: no name or length of theirs is another's
GROWS = (
    "solvers.rules",
    "solvers.closed_form",
    "robot.formats",
    "cli",
)  # a solver, a format or a command is a file here


def files():
    """Every file of the package with its path from there."""
    return {path.relative_to(PACKAGE): path for path in sorted(PACKAGE.rglob("*.py"))}


def grows(name):
    """Whether a module is in a folder of GROWS."""
    return name.partition(".")[2].startswith(tuple(f"{folder}." for folder in GROWS))


def constants(path):
    """Names in capitals that a module binds."""
    for node in parsed(path).body:
        for target in getattr(node, "targets", [getattr(node, "target", None)]):
            for one in getattr(target, "elts", [target]):
                if isinstance(one, ast.Name) and one.id.isupper():
                    yield one.id


def definitions(path):
    """Public functions and classes of a module, but for methods."""
    for node in parsed(path).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node.name


def named_by_text():
    """Modules that a registry, a table of commands or a lazy name loads."""
    words = {word for path in files().values() for word in re.findall(r'"([^"\s]+)"', path.read_text(encoding="utf-8"))}
    ends = {word.partition(":")[0].rpartition(".")[2] for word in words}
    return {name for name in modules() if name.rpartition(".")[2] in ends}


@functools.cache
def measures():
    """Every measure with what it counts, so that a failure says where."""
    names, stems, by_tip, laden, wide, types = (collections.defaultdict(list) for _ in range(6))
    every = []
    for place, path in files().items():
        room = place.parts[0]
        text = path.read_text(encoding="utf-8")
        found = [f"{place}: {name}" for name in constants(path)]
        every += found
        if room in ("kernel", "servo"):
            laden[len(found)].append(str(place))
        by_tip["by_tip"] += [str(place)] * text.count("by_tip")
        types["types"] += [str(place)] * text.count("if TYPE_CHECKING")
        if room in FREE:
            continue
        for name in definitions(path):
            names[name].append(str(place))
        if place.name != "__init__.py":
            stems[place.name].append(str(place))
        for node in statements(parsed(path)):
            if isinstance(node, ast.FunctionDef) and (node.name == "__init__" or not node.name.startswith("_")):
                count = len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs)
                if count > MANY:
                    wide[count].append(f"{place}: {node.name}")
    known = modules()
    importers = collections.defaultdict(set)
    for name, path in known.items():
        for other in imports(name, path, known):
            importers[other].add(name)
    exempt = named_by_text()
    short = [
        name
        for name, path in known.items()
        if len(importers[name]) == 1 and name not in exempt and not grows(name) and path.name != "__init__.py"
        if len(path.read_text(encoding="utf-8").splitlines()) < SHORT
    ]
    most = max(laden)
    assert len(known) > 100 and len(every) > 100
    return {
        "files outside folders that grow": [name for name in known if not grows(name)],
        "public names defined in two files or more": [f"{k}: {v}" for k, v in names.items() if len({*v}) > 1],
        "file names used twice": [f"{k}: {v}" for k, v in stems.items() if len(v) > 1],
        "functions of more than 9 parameters": [f"{k} {x}" for k, v in wide.items() for x in v],
        "constants of the most laden file of kernel and servo": [f"{laden[most]}"] * most,
        "constants of modules": every,
        "uses of by_tip": by_tip["by_tip"],
        "imports for types alone": types["types"],
        "files under 120 lines that one other imports": short,
    }


@pytest.mark.parametrize("measure", CEILINGS)
def test_form_gets_no_worse_and_a_ceiling_is_where_the_code_is(measure):
    """So that what has become better stays so."""
    found = measures()[measure]
    assert len(found) == CEILINGS[measure], "\n".join(sorted(found)[-60:])
