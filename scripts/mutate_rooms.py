"""Mutation testing outside the kernel: the rooms, their tests, and the changes that matter in plain Python."""

import ast
import functools
import gc
import hashlib
import random
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
COMPILED = tuple(str(ROOT / "ik_toolkit" / room) for room in ("compile", "kernel"))
ROOMS = ("robot", "paths", "servo", "solvers")
WIDER = {
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip


def judges(room: str) -> tuple[str, ...]:
    """Folders of the tests of a room."""
    more = {
        "solvers": ("tests/contract/", "tests/study/test_tune.py"),
        "robot": ("tests/cli/test_targets.py", "tests/cli/test_csv.py", "tests/cli/test_several_tips.py"),
    }
    return (f"tests/{room}/", *more.get(room, ()))


def shuffle(every: list[Any], seed: int, names: dict[str, str] | None) -> None:
    """Shuffle mutants; with their stable names so that every line of code comes up once before any comes up again.

    With names, mutants keep their order when other lines are edited, so that a sample can be tried again with new tests.
    """
    if names is None:
        random.Random(seed).shuffle(every)  # noqa: S311
    else:
        every.sort(key=lambda mutant: hashlib.sha256(f"{seed} {names[mutant.name]}".encode()).digest())
        rounds: dict[tuple, int] = defaultdict(int)
        place = {}
        for mutant in every:
            rounds[mutant.file, mutant.line] += 1
            place[mutant] = rounds[mutant.file, mutant.line]
        every.sort(key=place.__getitem__)


def caches() -> list[Any]:
    """Caches of functions, except those of the kernel: emptied before a test, so that it reaches what it needs itself."""
    found = []
    for thing in gc.get_objects():
        if isinstance(thing, functools._lru_cache_wrapper):
            home = getattr(sys.modules.get(str(thing.__module__)), "__file__", None) or ""
            if home.startswith(str(ROOT)) and not home.startswith((*COMPILED, str(ROOT / ".venv"))):
                found.append(thing)
    return found


# ------------------------------------------------------------------------------------------------------------ changes
def more_changes(node: ast.AST) -> Iterator[tuple[str, Any]]:
    """Changes that matter in plain Python: a statement, an element or a keyword dropped, None returned, other names."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in WIDER:
        other = WIDER[type(node.ops[0])]
        yield f"{type(node.ops[0]).__name__} -> {other.__name__}", lambda n: n.ops.__setitem__(0, other())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield (
            "not dropped",
            lambda n: (setattr(n, "op", ast.Not()), setattr(n, "operand", ast.UnaryOp(ast.Not(), n.operand))),
        )
    elif isinstance(node, ast.Constant) and type(node.value) is int and abs(node.value) <= 9:
        yield f"{node.value} -> {node.value - 1}", lambda n: setattr(n, "value", n.value - 1)
    elif isinstance(node, ast.Constant) and type(node.value) is float and node.value:
        yield f"{node.value} -> {0.5 * node.value}", lambda n: setattr(n, "value", 0.5 * n.value)
    elif isinstance(node, (ast.List, ast.Set)) and isinstance(getattr(node, "ctx", None), (ast.Load, type(None))):
        for k, element in enumerate(node.elts):
            yield f"without {ast.unparse(element):.40}", lambda n, k=k: setattr(n, "elts", n.elts[:k] + n.elts[k + 1 :])
    elif isinstance(node, ast.Dict):
        for k, element in enumerate(node.keys):
            yield f"without {ast.unparse(element) if element else '**':.40}", lambda n, k=k: (
                setattr(n, "keys", n.keys[:k] + n.keys[k + 1 :]), setattr(n, "values", n.values[:k] + n.values[k + 1 :]),
            )  # fmt: skip
    elif isinstance(node, ast.Call):
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        if name in ("any", "all") and isinstance(node.func, ast.Name):
            yield f"{name} swapped", lambda n: setattr(n.func, "id", "all" if n.func.id == "any" else "any")
        for k, word in ((k, word) for k, word in enumerate(node.keywords) if word.arg != "strict"):
            yield (
                f"without {ast.unparse(word):.40}",
                lambda n, k=k: setattr(n, "keywords", n.keywords[:k] + n.keywords[k + 1 :]),
            )
    elif isinstance(node, ast.Return) and node.value is not None and ast.unparse(node.value) != "None":
        yield "returns None", lambda n: setattr(n, "value", ast.Constant(None))
    elif isinstance(node, ast.Expr) and not isinstance(node.value, (ast.Constant, ast.Yield, ast.YieldFrom)):
        yield "dropped", lambda n: setattr(n, "value", ast.Constant(None))
    elif isinstance(node, (ast.AugAssign, ast.Assign)) and not isinstance(
        place := target_of(node), (ast.Name, ast.Tuple)
    ):
        yield f"{ast.unparse(place):.40} not assigned", nothing
    elif isinstance(node, ast.AugAssign):
        yield "dropped", nothing
    elif isinstance(node, (ast.Raise, ast.Continue, ast.Break)):
        yield f"{type(node).__name__.lower()} dropped", nothing


def target_of(node: ast.Assign | ast.AugAssign) -> ast.expr:
    """What is assigned to (the first target)."""
    return node.targets[0] if isinstance(node, ast.Assign) else node.target


def nothing(statement: ast.stmt) -> None:
    """Turn a statement into `pass`, at its place."""
    statement.__class__ = ast.Pass  # type: ignore[assignment]
