"""The disk cache of the compiled kernels: an edit of any file they are made of is seen."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import Cache
from numba.core.dispatcher import Dispatcher

import ik_toolkit
from ik_toolkit.kernel.chain import forward
from ik_toolkit.kernel.lanes import lanes
from ik_toolkit.kernel.refine import refine

PACKAGE = Path(ik_toolkit.__file__).parent
ROBOTS = next(folder for folder in (PACKAGE / "urdf", PACKAGE.parent / "urdf") if folder.is_dir())


@pytest.fixture
def copy(tmp_path):
    """Folder with a copy of the package that may be edited, and with what has been compiled of it."""
    shutil.copytree(PACKAGE, tmp_path / "ik_toolkit")
    if ROBOTS.parent != PACKAGE:
        shutil.copytree(ROBOTS, tmp_path / "urdf")
    return tmp_path


def run(folder, code, **environment):
    """Run `code` in a process that imports the package from `folder`."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA")}
    clean |= {"PYTHONPATH": str(folder), **environment}
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=clean, capture_output=True, text=True, timeout=300
    )


def edit(path, old, new):
    text = path.read_text()
    assert text.count(old) == 1, f"{path.name} no longer holds {old!r} once"
    path.write_text(text.replace(old, new))


REACH = """
import numpy as np, ik_toolkit as ik
print(ik.Robot.load("planar_2r").chain.forward(np.zeros((1, 2)))[0][0, 0, 3])
"""


def test_forward_kinematics_sees_an_edit_of_another_kernel_file(copy):
    first = run(copy, REACH)
    assert float(first.stdout) == 2.0, first.stderr
    edit(
        copy / "ik_toolkit" / "kernel" / "kinematics.py",
        "    return x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz\n",
        "    return x0, x1, x2, y0, y1, y2, z0, z1, z2, px + 1.0, py, pz\n",
    )
    assert float(run(copy, REACH).stdout) != 2.0


REFINED = """
import ik_toolkit as ik
print(ik.solve(ik.Robot.load("planar_2r"), (1.2, 0.5, 0.0), "planar-2r", objective="mid-range").status.name)
"""


@pytest.mark.slow  # compiles a closed form: 10 s
def test_refine_sees_an_edit_of_another_kernel_file(copy):
    first = run(copy, REFINED)
    assert first.stdout.strip() == "CONVERGED", first.stderr
    path = copy / "ik_toolkit" / "kernel" / "linalg.py"  # the closed form does not call `damped`, refine does
    path.write_text(path.read_text().replace("def damped(J, w, dq, e, ", "def damped(J, w, dq, e, edited, "))
    again = run(copy, REFINED)
    assert again.returncode != 0 and "edited" in again.stderr


@pytest.mark.parametrize("function", [forward, refine, lanes()], ids=["forward", "refine", "lanes"])
def test_what_is_used_of_numba_is_there(function):
    """The stamp rests on two private names of numba. When they move, edits would be missed in silence: fail here."""
    assert "_index_key" in vars(Cache), "numba's Cache has no _index_key any more"
    assert isinstance(function, Dispatcher) and isinstance(function._cache, Cache)
    assert function._cache.stamp in function._cache._index_key((), function.targetctx.codegen())
