"""Processes and caches: pickling, fork and spawn, concurrent compilation, a killed process, read-only folders."""

import multiprocessing
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
import robots

import ik_toolkit as ik

COUNT = 8
# The smallest kernels there are, and a script that calls them when it gets a line: what is tested is their files.
KERNELS = "from ik_toolkit.compile.jit import cached\n" + "".join(
    f"@cached\ndef plus_{k}(x):\n    return x + {k}.0\n" for k in range(COUNT)
)
CALLS = f"""
import logging, sys, small_kernels
logging.getLogger("ik_toolkit.compile").setLevel("ERROR")  # On a busy machine it says that compiling takes its time.
print("ready", flush=True)
sys.stdin.readline()
print([getattr(small_kernels, f"plus_{{k}}")(1.0) for k in range({COUNT})])
"""
SUMS = f"{[1.0 + k for k in range(COUNT)]}\n"


def run(code, timeout=120, **environment):
    """Run Python code in a fresh process with its own numba cache; returns its output."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=timeout, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # forking a process that has threads
def test_the_same_bytes_from_forked_processes():
    robot = robots.load("hydrolek_7w")
    _, T = robots.sample(robot, 6, seed=3)
    here = [ik.solve(robot, target).q.tobytes() for target in T]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("fork")) as pool:
        assert [result.q.tobytes() for result in pool.map(ik.solve, [robot] * len(T), T)] == here


@pytest.fixture
def start(tmp_path):
    """Start a process that compiles the small kernels, or finds them on disk, once it gets a line."""
    (tmp_path / "small_kernels.py").write_text(KERNELS)
    path = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": path}

    def process():
        made = subprocess.Popen(
            [sys.executable, "-c", CALLS],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment, text=True,
        )  # fmt: skip
        assert made.stdout.readline() == "ready\n"
        return made

    return process


def test_two_processes_may_compile_the_same_cache_at_once(start, tmp_path):
    both = [start(), start()]
    for process in both:
        process.stdin.write("go\n")
        process.stdin.flush()
    assert [process.communicate(timeout=240)[0] for process in both] == [SUMS, SUMS]
    files = set(tmp_path.rglob("*.nbc"))
    assert len(files) == COUNT
    assert start().communicate("go\n", timeout=120)[0] == SUMS
    assert set(tmp_path.rglob("*.nbc")) == files and not any(tmp_path.rglob("*.part"))


def test_a_killed_process_leaves_the_cache_usable(start, tmp_path):
    process = start()
    process.stdin.write("go\n")
    process.stdin.flush()
    for _ in range(6000):  # until it has begun to write
        if any(tmp_path.rglob("*.nbc")) or process.poll() is not None:
            break
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert len([*tmp_path.rglob("*.nbc")]) < COUNT
    assert start().communicate("go\n", timeout=120)[0] == SUMS
    assert len([*tmp_path.rglob("*.nbc")]) == COUNT


@pytest.mark.slow
def test_no_folder_for_the_cache_is_no_failure():
    """Neither the package folder, nor the home, nor the cache folder can be written: compile in memory."""
    code = (
        "import numba.core.caching as c\n"
        "for name in dir(c):\n"
        "    if name.endswith('Locator') or name.endswith('FsAgnostic'):\n"
        "        getattr(c, name).from_function = classmethod(lambda cls, f, p: None)\n"
        "import numpy as np, ik_toolkit as ik\n"
        "print(ik.Robot.load('planar_2r').chain.forward(np.zeros((1, 2)))[0].tolist())"
    )
    assert run(code).startswith("[")


def test_read_only_cache_folder_falls_back(tmp_path):
    folder = tmp_path / "file-not-folder"
    folder.write_text("")  # even root cannot write below a file
    code = "import ik_toolkit as ik; r = ik.Robot.load('planar_2r'); print(r.fk([0.1, 0.2]).translation.tolist())"
    out = run(code, NUMBA_CACHE_DIR=str(folder / "cache"), HOME=str(folder), XDG_CACHE_HOME=str(folder))
    assert np.isfinite(eval(out)).all()
