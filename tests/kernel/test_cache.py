"""The disk cache of compiled kernels: an edit of any source file is detected."""

import importlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from numba import config, float64, njit
from numba.core.caching import Cache
from numba.core.dispatcher import Dispatcher

import ik_toolkit
from ik_toolkit.compile import cache, jit
from ik_toolkit.compile.jit import INLINE, OWN_WAY
from ik_toolkit.compile.pipeline import PartLibrary
from ik_toolkit.kernel.chain import forward_kinematics
from ik_toolkit.kernel.null_space import refine
from ik_toolkit.kernel.simd_search import lanes
from ik_toolkit.servo.loop import servo

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


# The smallest kernel with forward kinematics in it: how far the tip is from the first joint of the stretched arm.
REACH = """
import numpy as np, ik_toolkit as ik
from ik_toolkit.kernel.chain import joint_levers
chain, distances = ik.Robot.load("planar_2r").chain, np.empty((1, 2))
joint_levers(chain.rows, chain.ends, np.zeros((1, 2)), chain.unit, distances)
print(distances[0, 0])
"""


FULL_DISK = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n"


def test_an_edit_of_another_kernel_file_is_seen_and_a_full_disk_at_the_first_use_is_said(copy):
    """The real thing: a process that may write no file computes all the same, and says once what it cannot keep."""
    first = run(copy, REACH)
    assert float(first.stdout) == 2.0, first.stderr
    edit(
        copy / "ik_toolkit" / "kernel" / "kinematics.py",
        "    return Pose(M3(x, y, z), p)\n",
        "    return Pose(M3(x, y, z), p + V3(1.0, 0.0, 0.0))\n",
    )
    done = run(copy, FULL_DISK + REACH)
    assert done.returncode == 0 and float(done.stdout) != 2.0, done.stderr
    assert done.stderr.count("cannot be kept") == 1 and "Traceback" not in done.stderr


@pytest.mark.parametrize("function", [forward_kinematics, refine, lanes()], ids=["forward", "refine", "lanes"])
def test_what_is_used_of_numba_is_there(function):
    """The stamp rests on two private names of numba. When they move, edits would be missed in silence: fail here."""
    assert "_index_key" in vars(Cache), "numba's Cache has no _index_key any more"
    assert isinstance(function, Dispatcher) and isinstance(function._cache, Cache)
    assert function._cache.stamp in function._cache._index_key((), function.targetctx.codegen())


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_parts_are_neither_optimised_nor_made_machine_code_on_their_own():
    """`parts.PartLibrary` overrides what numba calls to do so. When those names move, compiling takes longer in silence."""
    assert OWN_WAY, "numba has moved what ik_toolkit.compile.pipeline uses"
    part = njit(**INLINE)(lambda x: x + 1.0)
    part.compile((float64,))
    (result,) = part.overloads.values()
    assert isinstance(result.library, PartLibrary)
    assert not result.library._codegen._engine.is_symbol_defined(result.fndesc.llvm_func_name)
    assert njit(lambda x: part(x))(1.0) == 2.0


COMPILED = """
from collections import Counter
from typing import NamedTuple
import numpy as np
from numba.core import event, types
from numba.core.postproc import PostProcessor
from numba.core.registry import cpu_target
from numba.core.typing.context import Context
from llvmlite.binding import ffi
from ik_toolkit.compile.jit import cached, compiled, inline, inner

@compiled
class Pair(NamedTuple):
    a: float
    b: float

    def total(self):
        return self.a + self.b

@inline
def times(p, number):
    return Pair(number * p.a, number * p.b)

@inner
def called(p):
    return times(p, 3).total()

@inline
def all_of_it(x):
    p = Pair(x, 1.0)
    return p.total() + times(p, 2).total() + times(p, 5).a + called(p)

@cached
def kernel(x):
    return all_of_it(x)

@cached
def wrong(x):
    return Pair(x, 1.0).total().nothing

class Copies(event.Listener):
    seen = Counter()

    def on_start(self, what):
        self.seen[what.data["dispatcher"].py_func, what.data["args"]] += 1

    def on_end(self, what):
        pass

asked, find = Counter(), Context.find_matching_getattr_template
def count(self, kind, name):
    asked[kind, name] += isinstance(kind, types.BaseNamedTuple)
    return find(self, kind, name)

Context.find_matching_getattr_template = count
before = PostProcessor.run, ffi.lib._lock._cblist[:], sorted(vars(cpu_target.typing_context))
with event.install_listener("numba:compile", Copies()):
    assert kernel(1.0) == 2.0 + 4.0 + 5.0 + 6.0
for function in (Pair.total, times.py_func):
    print(sum(n for (found, _), n in Copies.seen.items() if found is function))
print(max(n for (_, name), n in asked.items()))
try:
    wrong(1.0)
except Exception as error:
    print("nothing" in str(error))
print(before == (PostProcessor.run, ffi.lib._lock._cblist[:], sorted(vars(cpu_target.typing_context))))
"""


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_kernel_has_one_copy_of_each_part_and_numba_is_left_as_it_was(tmp_path):
    """Inlined and called parts share what they call, whatever numbers it is given; also after a kernel that does not compile."""
    (tmp_path / "script.py").write_text(COMPILED)
    ran = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.stdout.split() == ["1", "1", "1", "True", "True"], ran.stderr


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("release", ["0.61.2", "0.65.1", "0.70.0dev0+1", "1.0.0"])
def test_with_a_numba_that_was_not_tried_parts_compile_as_it_likes(monkeypatch, release):
    """What another release calls its own interfaces tells nothing: those of 0.63 look the same, and LLVM ends the process."""
    path = PACKAGE / "compile" / "jit.py"
    found = importlib.util.spec_from_file_location("ik_toolkit.compile.jit_again", path)
    jit = importlib.util.module_from_spec(found)
    with monkeypatch.context() as other:
        other.setattr(numba, "__version__", release)
        other.setitem(sys.modules, "ik_toolkit.compile.pipeline", None)  # is not even imported
        found.loader.exec_module(jit)
    assert not jit.OWN_WAY and "pipeline_class" not in jit.INLINE
    part = jit.inline(lambda x: x + 1.0)
    assert njit(lambda x: part(x))(1.0) == 2.0


@pytest.mark.slow  # compiles a closed form: 10 s
def test_the_first_solve_says_that_it_compiles(copy):
    code = "import sys; from ik_toolkit.cli import main; sys.exit(main(['solve', 'planar_2r', '--xyz', '1', '1', '0']))"
    for path in copy.rglob("ik-planar_2r.*.nbc"):
        path.unlink()
    assert run(copy, code).stderr.count("compiling") == 1
    assert run(copy, code).stderr == ""


def test_doctor_finds_damaged_files_and_mends_them(copy):
    doctor = "import sys; from ik_toolkit.cli import main; sys.exit(main(['doctor', '--json']))"

    def state():
        done = run(copy, doctor)
        (row,) = (row for row in json.loads(done.stdout)["checks"] if row["what"] == "compile cache")
        return row["state"], row["detail"]

    path = copy / "ik_toolkit" / "kernel" / "__pycache__" / f"ik-one.{cache.stamp_of(*cache.STAMPED)[:12]}.two.nbc"
    path.parent.mkdir(exist_ok=True)
    cache.write_body(path, bytes(2000))
    data = path.read_bytes()
    path.write_bytes(data[:1000] + bytes([data[1000] ^ 4]) + data[1001:])
    torn = path.with_name("ik-something.part")
    torn.write_bytes(data[:100])
    assert state()[0] == "mended" and not path.exists() and not torn.exists()
    full = run(copy, FULL_DISK + doctor)
    assert full.returncode == 1 and "too large" in full.stdout


RULE = """
import logging, numpy as np
from typing import NamedTuple
import ik_toolkit as ik
from ik_toolkit.compile.cache import make_cache

class Mine(NamedTuple):
    gain: float = 0.5

def function():
    pass

print(make_cache(function, (Mine,)).why)
"""


def test_a_rule_of_a_script_is_not_kept_and_says_so(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(RULE)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=300)
    assert "Mine is defined in a script or a session" in done.stdout, done.stderr


def test_files_a_rule_is_compiled_from_are_watched(tmp_path, monkeypatch):
    (tmp_path / "rule_helpers.py").write_text("from numba import njit\n@njit\ndef half(x):\n    return 0.5 * x\n")
    (tmp_path / "rule_of_mine.py").write_text(
        "import rule_helpers\nclass Mine: pass\ndef step(x):\n    return rule_helpers.half(x)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("rule_of_mine")
    watched = {path.name for thing in (module.Mine, module.step) for path in cache._sources(thing)}
    assert watched == {"rule_of_mine.py", "rule_helpers.py"}


def test_files_that_are_reached_through_an_overload_are_watched():
    """Without them an edit of a singular direction or of the quadratic program ran the machine code of before."""
    watched = {path.name for path in cache._sources(getattr(servo(), "py_func", servo()))}
    assert watched >= {"loop.py", "command.py", "singular_directions.py", "singular_step.py", "hierarchical_qp.py"}


# Three calls of one rule, each of which takes up to a millisecond: the times of a newcomer's comparison of solvers.
COMPARED = """
import time, ik_toolkit as ik
robot = ik.Robot.load("hydrolek_7w")
target = robot.fk(robot.home + 0.1)
for call in (ik.Solver(robot, "ccd"), ik.Solver(robot, "ccd", check=True), ik.Solver(robot, "ccd")):
    began = time.perf_counter()
    result = call(target)
    print(time.perf_counter() - began, result.elapsed, result.compile_time, result.to_dict()["compile_time"])
"""


@pytest.mark.slow
@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_the_time_of_a_solve_is_apart_from_that_of_compiling_and_loading(tmp_path):
    for process in ("compiles", "loads"):
        done = run(PACKAGE.parent, COMPARED, NUMBA_CACHE_DIR=str(tmp_path))
        first, second, third = ([float(x) for x in row.split()] for row in done.stdout.splitlines())
        wall, elapsed, waited, told = first
        assert waited == told and 0.0 <= wall - elapsed - waited < 0.05
        assert waited > (0.5 if process == "compiles" else 0.002)
        assert elapsed < 0.05 and max(second[1], third[1]) < 0.05  # 10 times the 5 ms of a slow machine
        assert second[2] == third[2] == 0.0
        said = done.stderr.splitlines()
        assert len(said) == (process == "compiles"), said
        assert all(line == f"ik_toolkit is compiling CCD ({FIRST_USE}) ..." for line in said)


def test_waiting_threads_count_once(monkeypatch):
    """Two threads waited together from 1 to 4 s, another alone from 6 to 7 s; this one did not wait at all."""
    rows = [(0, 0.0, 0.5), (1, 1.0, 3.0), (2, 1.5, 4.0), (1, 2.0, 2.5), (3, 6.0, 7.0)]
    monkeypatch.setattr(jit, "waits", rows)
    for since, waited in ((0.9, 4.0), (2.0, 3.0), (5.0, 1.0), (6.5, 0.5), (8.0, 0.0)):
        assert jit.compile_time(since, everywhere=True) == waited
    assert jit.compile_time(0.0) == 0.0
    monkeypatch.setattr(jit.threading, "get_ident", lambda: 1)
    assert jit.compile_time(0.0) == 2.0


FIRST_USE = "first use on this machine, up to half a minute"
