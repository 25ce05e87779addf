"""Views do not own their data, which must live as long as they are used."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from numba import config

from ik_toolkit.compile import array_view

CODE = """
import numpy as np
from numba import njit
from ik_toolkit.compile.jit import OPTIONS, inner
from ik_toolkit.compile.array_view import keep, view

@inner
def fill(b):
    total = 0.0
    for i in range(b.shape[0]):
        b[i] = 0.5 * i
    for i in range(b.shape[0]):
        total += b[i]
    return total

@njit(**OPTIONS)
def use(n):
    block = np.empty(n)
    total = fill(view(block))
    keep(block)
    return total

n = 4_000_000  # so large that its memory goes back to the system at once
assert use(n) == 0.25 * n * (n - 1)
"""


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="uncompiled, a view is the array itself")
def test_what_is_kept_lives_while_a_view_of_it_is_used():
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, (done.returncode, done.stderr[-500:])


def names(call):
    return [a.id for a in call.args if isinstance(a, ast.Name)]


def test_every_array_made_for_a_view_is_kept():
    """An array that a kernel makes and views is kept after the last use of its views."""
    seen = 0
    rooms = Path(inspect.getfile(array_view)).parents[1]
    for path in sorted(path for room in ("kernel", "servo", "paths") for path in (rooms / room).glob("*.py")):
        for function in ast.walk(ast.parse(path.read_text())):
            if not isinstance(function, ast.FunctionDef):
                continue
            nodes = list(ast.walk(function))
            own = [node for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
            targets = [target for node in nodes if isinstance(node, ast.Assign) for target in node.targets]
            made = {target.id for target in targets if isinstance(target, ast.Name)}
            for made_view in (call for call in own if call.func.id == "view"):
                for name in made.intersection(names(made_view)):
                    kept = [call.lineno for call in own if call.func.id == "keep" and name in names(call)]
                    assert kept and max(kept) > made_view.lineno, f"{path.name}: keep({name}) is missing"
                    seen += 1
    assert seen >= 4
