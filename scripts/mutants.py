"""Changes of our source, planting one in a process, and recording which statements run: the kernel, or rooms outside it."""

import ast
import atexit
import copy
import difflib
import functools
import gc
import os
import shutil
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NamedTuple

from mutate_rooms import more_changes

PACKAGE = Path(__file__).resolve().parent.parent / "ik_toolkit"
ROOMS_OF_KERNELS = ("kernel", "servo", "paths")  # a file there is compiled if it takes a decorator from compile/jit.py
of_kernel = True  # whether what runs uncompiled is changed; else plain Python (see `in_package`)
REACHED = "__reached__"
# decorators of functions that numba calls
NUMBAS = "overload", "intrinsic", "lower_builtin", "lower_getattr", "infer", "register_model"
LOWERING = {"parts_of", "_made", "_place", "_index", "_element"}  # functions of array_view.py called only by those
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
    ast.RShift: ast.LShift, ast.LShift: ast.RShift, ast.BitXor: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
    ast.Pow: ast.Mult,
}  # fmt: skip
COMPARISONS = {
    ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,),
}  # fmt: skip
COMPILED = (
    "cached",
    "cached_small",
    "inner",
    "inline",
    "shared",
    "build",
    "compiled",
    "dual",
    "jit",
    "spliced",
    "overload",
    "rule",
)  # decorators, outside the kernel
CALLS = {"min": "max", "max": "min", "sin": "cos", "cos": "sin", "ceil": "floor", "floor": "ceil"}


def in_package() -> None:
    """Change the rooms' plain Python, with the changes that matter there as well."""
    global of_kernel
    of_kernel = False


@functools.cache
def text_of(file: str) -> list[str]:
    """Lines of a file."""
    return (PACKAGE / file).read_text(encoding="utf-8").splitlines()


def key(name: str) -> str:
    """Stable name of a mutant, unaffected by edits of other lines: file and change, with the text of its line."""
    place, what = name.split(" ", 1)
    file, line, _ = place.split(":")
    return f"{file}: {text_of(file)[int(line) - 1].strip()} [{what}]"


class Mutant(NamedTuple):
    """One change: the index of the node in its file, and of the change at that node."""

    file: str
    node: int
    change: int
    line: int
    what: str
    statement: int  # first line of its statement, 0: the value of a module constant
    constant: str  # name of that constant

    @property
    def name(self) -> str:
        """Name in the results."""
        return f"{self.file}:{self.line}:{self.node}.{self.change} {self.what}"


# ------------------------------------------------------------------------------------------------------------ mutants
def changes(node: ast.AST) -> Iterator[tuple[str, Any]]:
    """Name of each change of a node, and the function that makes it (in place)."""
    if isinstance(node, (ast.BinOp, ast.AugAssign)) and type(node.op) in OPERATORS:
        other = OPERATORS[type(node.op)]
        yield f"{type(node.op).__name__} -> {other.__name__}", lambda n: setattr(n, "op", other())
    elif isinstance(node, ast.Compare):
        for other in COMPARISONS.get(type(node.ops[0]), ()):
            yield f"{type(node.ops[0]).__name__} -> {other.__name__}", lambda n, o=other: n.ops.__setitem__(0, o())
    elif isinstance(node, ast.BoolOp):
        other = ast.Or if isinstance(node.op, ast.And) else ast.And
        yield f"{type(node.op).__name__} -> {other.__name__}", lambda n: setattr(n, "op", other())
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        if not (isinstance(node, ast.While) and isinstance(node.test, ast.Constant)):
            yield "condition negated", lambda n: setattr(n, "test", ast.UnaryOp(ast.Not(), n.test))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "minus dropped", lambda n: setattr(n, "op", ast.UAdd())
    elif isinstance(node, ast.Constant) and type(node.value) is int and not of_kernel and abs(node.value) > 9:
        yield f"{node.value} -> {2 * node.value}", lambda n: setattr(n, "value", 2 * n.value)
        yield f"{node.value} -> {node.value // 2}", lambda n: setattr(n, "value", n.value // 2)
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        more = node.value + 1 if isinstance(node.value, int) else 2.0 * node.value if node.value else 1.0
        yield f"{node.value} -> {more}", lambda n: setattr(n, "value", more)
    elif isinstance(node, ast.Constant) and type(node.value) is bool:
        yield f"{node.value} -> {not node.value}", lambda n: setattr(n, "value", not n.value)
    elif isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in CALLS:
            key = "attr" if isinstance(node.func, ast.Attribute) else "id"
            yield f"{name} -> {CALLS[name]}", lambda n: setattr(n.func, key, CALLS[name])


def all_changes(node: ast.AST) -> list[tuple[str, Any]]:
    """The kernel's changes and, outside it, those of plain Python."""
    return [*changes(node), *(() if of_kernel else more_changes(node))]


def is_compiled(top: ast.AST) -> bool:
    """Whether numba has a version of its own of a function or class, or of one inside it; what a test runs is that one."""
    marks = [ast.unparse(mark) for mark in getattr(top, "decorator_list", ())]
    if of_kernel:  # where everything runs uncompiled
        return any(word in mark for mark in marks for word in NUMBAS)
    inside = [node for node in ast.walk(top) if node is not top]
    if isinstance(top, ast.FunctionDef) and any(isinstance(node, ast.FunctionDef) for node in inside):
        marks += [ast.unparse(call.func) for call in inside if isinstance(call, ast.Call)]
    return any(mark.split("(")[0].split(".")[-1] in COMPILED for mark in marks)


def functions_of(tree: ast.Module) -> Iterator[ast.AST]:
    """Nodes inside functions that run uncompiled, and values of constants of the module."""
    literals = (ast.Constant, ast.BinOp, ast.Tuple, *(() if of_kernel else (ast.List, ast.Set, ast.Dict)))
    for top in tree.body:
        if is_compiled(top):
            continue
        if isinstance(top, ast.ClassDef):
            bodies = [f for f in top.body if isinstance(f, ast.FunctionDef)]
        elif isinstance(top, ast.FunctionDef):
            bodies = [top]
        elif isinstance(top, ast.Assign) and isinstance(top.value, literals):
            yield from ast.walk(top.value)
            continue
        else:
            continue
        for body in bodies:
            if body.name in LOWERING:
                continue
            for statement in body.body:
                yield from walk(statement)


def walk(statement: ast.AST) -> Iterator[ast.AST]:
    """Nodes of a statement; outside the kernel without what checks no input (assertions, zip's strict) and numbers inside texts."""
    if of_kernel:
        yield from ast.walk(statement)
    elif not (isinstance(statement, (ast.Assert, ast.JoinedStr)) or getattr(statement, "arg", "") == "strict"):
        yield statement
        for child in ast.iter_child_nodes(statement):
            yield from walk(child)


def mutants(file: str) -> list[Mutant]:
    """All changes of a file."""
    tree = source(file)
    begins, constants = {}, {}
    for top in tree.body:
        for inside in ast.walk(top):  # an inner statement comes later
            if isinstance(inside, ast.stmt):
                begins.update({id(node): inside.lineno for node in ast.walk(inside)})
        if isinstance(top, ast.Assign):
            name = " ".join(n.id for target in top.targets for n in ast.walk(target) if isinstance(n, ast.Name))
            constants.update({id(node): name for node in ast.walk(top)})
    return [
        Mutant(file, i, k, getattr(node, "lineno", 0), what, 0 if id(node) in constants else begins[id(node)],
               constants.get(id(node), ""))
        for i, node in enumerate(functions_of(tree))
        for k, (what, _) in enumerate(all_changes(node))
    ]  # fmt: skip


def source(file: str) -> ast.Module:
    """Syntax tree of a file as first read: the file may be edited while mutants are tried."""
    return ast.parse("\n".join(text_of(file)) + "\n")


def planted(mutant: Mutant) -> ast.Module:
    """Syntax tree of the file with the change made."""
    tree = source(mutant.file)
    node = list(functions_of(tree))[mutant.node]
    all_changes(copy.copy(node))[mutant.change][1](node)
    return ast.fix_missing_locations(tree)


def diff(mutant: Mutant) -> str:
    """The change as lines taken away and lines put in their place."""
    old, new = (ast.unparse(tree).splitlines() for tree in (source(mutant.file), planted(mutant)))
    return "\n".join(list(difflib.unified_diff(old, new, n=0, lineterm=""))[3:])


@functools.cache
def uses(names: str) -> set[tuple[str, int]]:
    """Statements in functions that use a constant."""
    found = set()
    for file in files():
        for function in ast.walk(source(file)):
            for inside in ast.walk(function) if isinstance(function, ast.FunctionDef) else ():
                if isinstance(inside, ast.stmt) and any(
                    getattr(n, "id", getattr(n, "attr", "")) in names.split() for n in ast.walk(inside)
                ):
                    found.add((file, inside.lineno))
    return found


@functools.cache
def files() -> list[str]:
    """Names of all files, by their path below the package; of the kernel only those that are compiled."""
    rooms = (
        [path for room in ROOMS_OF_KERNELS for path in (PACKAGE / room).rglob("*.py")]
        if of_kernel
        else PACKAGE.rglob("*.py")
    )
    names = (path.relative_to(PACKAGE).as_posix() for path in rooms)
    return sorted(name for name in names if not of_kernel or "compile.jit import" in "\n".join(text_of(name)))


# ------------------------------------------------------------------------------------------------------------ planting
def codes(tree: ast.Module, file: str) -> dict[tuple[str, int], CodeType]:
    """Code of every function of a tree that runs uncompiled, nested ones included, by name and line."""
    found: dict[tuple[str, int], CodeType] = {}
    compiled = {top.name for top in tree.body if isinstance(top, (ast.FunctionDef, ast.ClassDef)) and is_compiled(top)}

    def visit(code: CodeType) -> None:
        for inner in code.co_consts:
            if isinstance(inner, CodeType) and inner.co_qualname.split(".")[0] not in compiled:
                found[inner.co_qualname, inner.co_firstlineno] = inner
                visit(inner)

    visit(compile(tree, str(PACKAGE / file), "exec"))
    return found


def living() -> dict[str, list[FunctionType]]:
    """All loaded functions, by file."""
    found = defaultdict(list)
    for thing in gc.get_objects():
        if type(thing) is FunctionType and thing.__code__.co_filename.startswith(f"{PACKAGE}{os.sep}"):
            found[Path(thing.__code__.co_filename).relative_to(PACKAGE).as_posix()].append(thing)
    return found


def exchange(functions: list[FunctionType], new: dict[tuple[str, int], CodeType]) -> None:
    """Give functions their changed code."""
    for function in functions:
        code = new.get((function.__code__.co_qualname, function.__code__.co_firstlineno))
        if code is not None and code.co_freevars == function.__code__.co_freevars:
            function.__code__ = code


def plant(mutant: Mutant, functions: dict[str, list[FunctionType]]) -> None:
    """Make the change in this process."""
    tree = planted(mutant)
    if mutant.file in scripts():
        plant_script(mutant.file, ast.unparse(tree))
        return
    if mutant.statement:
        exchange(functions[mutant.file], codes(tree, mutant.file))
        return
    module = sys.modules[
        ".".join((PACKAGE / mutant.file).relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
    ]
    (assignment,) = (
        top for top in tree.body if isinstance(top, ast.Assign) and top.lineno <= mutant.line <= (top.end_lineno or 0)
    )
    changed = dict(module.__dict__)
    exec(compile(ast.Module([assignment], []), "constant", "exec"), changed)  # noqa: S102  our own source, changed
    for name in mutant.constant.split():
        for other in list(sys.modules.values()):  # every module that has imported it
            if getattr(other, "__name__", "").startswith("ik_toolkit.") and vars(other).get(name) is getattr(
                module, name
            ):
                vars(other)[name] = changed[name]


@functools.cache
def scripts() -> set[str]:
    """Files that run in processes of their own, and what these load from beside them."""
    beside = ("robot/packages.py", "robot/formats/sandbox.py")
    beside += tuple(f"robot/formats/xacro_{name}.py" for name in ("values", "files", "library"))
    return set() if of_kernel else {*beside, *(f for f in files() if f.endswith("_worker.py"))}


def plant_script(file: str, text: str) -> None:
    """Let processes that this one starts run a changed copy of a script."""
    folder = Path(tempfile.mkdtemp(prefix="mutant_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    place = folder / PACKAGE.name
    shutil.copytree(PACKAGE, place, ignore=shutil.ignore_patterns("__pycache__"))
    (place / file).write_text(text)
    os.environ["PYTHONPATH"] = str(folder)  # A script imports the package it lies in.
    for module in list(sys.modules.values()):
        worker = vars(module).get("WORKER") if getattr(module, "__name__", "").startswith("ik_toolkit.") else None
        if isinstance(worker, Path):
            module.WORKER = place / worker.relative_to(PACKAGE)  # type: ignore[attr-defined]


# ------------------------------------------------------------------------------------------------------------ reach
class Marked(ast.NodeTransformer):
    """Puts a mark in front of every statement of a function."""

    def __init__(self) -> None:
        self.deep = 0

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """Mark the statements of a function."""
        self.deep += 1
        self.generic_visit(node)
        self.deep -= 1
        return node

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Mark every list of statements inside functions."""
        super().generic_visit(node)
        for field in ("body", "orelse", "finalbody") if self.deep else ():
            statements = getattr(node, field, None)
            if isinstance(statements, list):
                setattr(node, field, [new for old in statements for new in (self.mark(old), old)])
        return node

    @staticmethod
    def mark(statement: ast.stmt) -> ast.stmt:
        """REACHED[line] = 1."""
        return ast.copy_location(ast.parse(f"{REACHED}[{statement.lineno}] = 1").body[0], statement)


def marked(files: Iterable[str]) -> dict[str, dict[tuple[str, int], CodeType]]:
    """Code of the kernel that records which statements run, by file."""
    return {file: codes(ast.fix_missing_locations(Marked().visit(source(file))), file) for file in files}


def mark_all(functions: dict[str, list[FunctionType]], new: dict[str, dict]) -> dict[str, bytearray]:
    """Make the kernel in this process record which statements run; returns arrays by line."""
    reached = {}
    for file, mine in functions.items():
        reached[file] = bytearray(len(text_of(file)) + 1)
        exchange(mine, new[file])
        for function in mine:
            function.__globals__[REACHED] = reached[file]
    return reached
