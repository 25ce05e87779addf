"""The structure of the code: no import cycles, no overlong files or functions."""

import ast
import importlib

import pytest
from folders import ROOT
from sources import PACKAGE, imports, length, modules, parsed, statements


def circles(graph):
    """Sets of modules each of which imports all others of its set, directly or not."""
    reach = {name: set(graph[name]) for name in graph}
    for middle in graph:
        for name in graph:
            if middle in reach[name]:
                reach[name] |= reach[middle]
    return {
        frozenset(n for n in graph if n in reach[name] and name in reach[n]) for name in graph if name in reach[name]
    }


def test_no_module_imports_one_that_imports_it():
    known = modules()
    graph = {name: set(imports(name, path, known)) for name, path in known.items()}
    assert len(graph) > 100 and "ik_toolkit.compile.jit" in graph["ik_toolkit.kernel.search"]
    assert not circles(graph), [sorted(circle) for circle in circles(graph)]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("from . import b", {"p.b"}),
        ("def f():\n    from .b import x", {"p.b"}),
        ("class A:\n    def f(self):\n        if self:\n            import p.b", {"p.b"}),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .b import x", {"p.b"}),
        ("import typing\nif typing.TYPE_CHECKING:\n    import p.b\nelse:\n    from p import c", {"p.b", "p.c"}),
    ],
)
def test_imports_inside_functions_count_and_those_for_type_checkers(text, found, tmp_path):
    path = tmp_path / "a.py"
    path.write_text(text)
    assert set(imports("p.a", path, {"p", "p.a", "p.b", "p.c"})) == found


def test_a_circle_of_three_is_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}
    assert circles(graph) == {frozenset("abc")}


# A definition counts whole but for its docstring: signature, comments and blank lines too.
LINES_OF_A_FILE, LINES_OF_A_FUNCTION = 400, 80
SOURCES = sorted(path for folder in ("ik_toolkit", "tests", "scripts") for path in (ROOT / folder).rglob("*.py"))


def test_no_file_and_no_function_is_too_long_to_read():
    assert len(SOURCES) > 200
    long = []
    for path in SOURCES:
        name, lines = path.relative_to(ROOT), len(path.read_text(encoding="utf-8").splitlines())
        if lines > LINES_OF_A_FILE:
            long.append(f"{name}: {lines} lines")
        for node in statements(parsed(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and length(node) > LINES_OF_A_FUNCTION:
                long.append(f"{name}, {node.name}: {length(node)} lines")
    assert not long


def test_parts_of_kernels_make_no_arrays():
    """They borrow what they are given (see compile/jit.py): one that made an array left other kernels a damaged heap."""
    names = "empty zeros ones full array arange linspace empty_like zeros_like".split()
    makers = {f"np.{name}" for name in names}
    parts: dict[str, list] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in statements(parsed(path)):
            names = [ast.unparse(one) for one in getattr(node, "decorator_list", [])]
            methods = [one for one in getattr(node, "body", []) if isinstance(one, ast.FunctionDef)]
            for name in names:
                parts.setdefault(name, []).extend(methods if name == "compiled" else [node])
    counting = {function.name for function in parts["build"]}
    counting |= {
        f.name
        for f in parts["jit"]
        if any(ast.unparse(n.func) in makers for n in ast.walk(f) if isinstance(n, ast.Call))
    }
    assert "make_serial" in counting and len(parts["inner"]) > 100
    for function in [f for kind in ("inner", "inline", "spliced", "dual", "shared", "compiled") for f in parts[kind]]:
        if [ast.unparse(one) for one in function.decorator_list] in (["classmethod"], ["staticmethod"]):
            continue  # stay Python
        called = {ast.unparse(node.func) for node in ast.walk(function) if isinstance(node, ast.Call)}
        made = {name for name in called if name in counting | makers or name.endswith(".copy")}
        assert not made, f"{function.name} makes arrays by {', '.join(sorted(made))}: compile it by `build`"


def called_from_python(tree):
    """Calls in a module's functions and classes, but in decorated ones, which may be compiled themselves."""
    for node in ast.iter_child_nodes(tree):
        if not getattr(node, "decorator_list", None):
            if isinstance(node, ast.Call):
                yield node
            yield from called_from_python(node)


def meant(call, module):
    """What a call calls, where that is a global of the module or of one imported there."""
    function = call.func
    if isinstance(function, ast.Attribute):
        return getattr(getattr(module, getattr(function.value, "id", ""), None), function.attr, None)
    return getattr(module, getattr(function, "id", ""), None)


def test_kernels_called_from_python_are_kept_on_disk():
    """Others would be compiled in every process, for seconds, at their first call: in a control loop, say."""
    from numba.core.dispatcher import Dispatcher

    from ik_toolkit.compile.cache import DiskCache

    found = []
    for name, path in modules().items():
        # The methods are compiled into the loop, as rules of solvers are.
        if name.split(".")[1:2] in (["servo"], ["robot"], ["paths"]) and name != "ik_toolkit.servo.methods":
            module = importlib.import_module(name)
            calls = [(call.lineno, meant(call, module)) for call in called_from_python(parsed(path))]
            found += [(f"{name}:{line}", one) for line, one in calls if isinstance(one, Dispatcher)]
    assert len(found) > 10
    assert [f"{where} calls {one.__name__}" for where, one in found if not isinstance(one._cache, DiskCache)] == []
