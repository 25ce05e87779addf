"""Processes and caches: pickling, fork and spawn, concurrent compilation, a killed process, read-only folders."""

import multiprocessing
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor

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

    def process(before="", **more):
        made = subprocess.Popen(
            [sys.executable, "-c", before + CALLS], env={**environment, **more}, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
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


def test_no_folder_for_the_cache_is_no_failure(start, tmp_path):
    """One that cannot be written, or neither that nor the package folder nor the home: then it compiles in memory."""
    (tmp_path / "file").write_text("")  # even root cannot write below a file
    below = str(tmp_path / "file" / "cache")
    nowhere = (
        "import numba.core.caching as c\n"
        "for name in dir(c):\n"
        "    if name.endswith('Locator') or name.endswith('FsAgnostic'):\n"
        "        getattr(c, name).from_function = classmethod(lambda cls, f, p: None)\n"
    )
    for before in (nowhere, ""):
        process = start(before, NUMBA_CACHE_DIR=below, HOME=below, XDG_CACHE_HOME=below)
        assert process.communicate("go\n", timeout=120)[0] == SUMS
        assert not before or not any(tmp_path.rglob("*.nb?"))
