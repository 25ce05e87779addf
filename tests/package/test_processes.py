"""Processes and caches: pickling, fork and spawn, concurrent compilation, a killed process, read-only folders."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
import robots

import ik_toolkit as ik

# The smallest kernel there is: what is tested is its file.
FORWARD = """
import numpy as np, ik_toolkit as ik
print(ik.Robot.load("planar_2r").chain.forward(np.zeros((1, 2)))[0].tolist())
"""


def run(code, timeout=120, **environment):
    """Run Python code in a fresh process with its own numba cache; returns its output."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=timeout, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("method", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # forking a process that has threads
def test_the_same_bytes_from_other_processes(method):
    robot = robots.load("hydrolek_7w")
    _, T = robots.sample(robot, 6, seed=3)
    here = [ik.solve(robot, target).q.tobytes() for target in T]
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context(method)) as pool:
        assert [result.q.tobytes() for result in pool.map(ik.solve, [robot] * len(T), T)] == here


def test_two_processes_may_compile_the_same_cache_at_once(tmp_path):
    command = [sys.executable, "-c", FORWARD]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    both = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) for _ in range(2)
    ]
    outputs = [process.communicate(timeout=240) for process in both]
    assert [process.returncode for process in both] == [0, 0], outputs
    assert outputs[0][0] == outputs[1][0]
    assert run(FORWARD, NUMBA_CACHE_DIR=str(tmp_path)).encode() == outputs[0][0]


def test_a_killed_process_leaves_the_cache_usable(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", FORWARD], env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)})
    for _ in range(600):  # until it has begun to write
        if any(tmp_path.rglob("*.nb?")) or process.poll() is not None:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert run(FORWARD, NUMBA_CACHE_DIR=str(tmp_path)).startswith("[")


@pytest.mark.slow
def test_no_folder_for_the_cache_is_no_failure(tmp_path):
    """Neither the package folder, nor the home, nor the cache folder can be written: compile in memory."""
    code = (
        "import numba.core.caching as c\n"
        "for name in dir(c):\n"
        "    if name.endswith('Locator') or name.endswith('FsAgnostic'):\n"
        "        getattr(c, name).from_function = classmethod(lambda cls, f, p: None)\n" + FORWARD
    )
    assert run(code).startswith("[")


def test_read_only_cache_folder_falls_back(tmp_path):
    folder = tmp_path / "file-not-folder"
    folder.write_text("")  # even root cannot write below a file
    code = "import ik_toolkit as ik; r = ik.Robot.load('planar_2r'); print(r.fk([0.1, 0.2]).translation.tolist())"
    out = run(code, NUMBA_CACHE_DIR=str(folder / "cache"), HOME=str(folder), XDG_CACHE_HOME=str(folder))
    assert np.isfinite(eval(out)).all()
