"""The first solve on a machine: answered at once without compilation, which goes on in the background."""

import fcntl
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.cli import first_use, main

SOLVE = ["solve", "hydrolek_7w", "--xyz", "1.0", "0.1", "0.2", "--json"]
OUT_OF_LIMITS = ["solve", "hydrolek_7w", "--xyz", "-1.2", "0.0", "0.3", "--json"]  # in reach, but not within the limits


def run(arguments, cache, **more):
    """Run `ik` as a user does, with a cache folder of its own."""
    env = {key: value for key, value in os.environ.items() if key not in ("CI", first_use.WAIT, "NUMBA_DISABLE_JIT")}
    env |= {"NUMBA_CACHE_DIR": str(cache), **more}
    return subprocess.run(
        [sys.executable, "-m", "ik_toolkit", *arguments], env=env, capture_output=True, text=True, timeout=500
    )


def folder(cache):
    """Where kernels go when `cache` is the cache folder."""
    code = "from ik_toolkit.kernel.cache import folder; print(folder())"
    env = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    return Path(
        subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True).stdout.strip()
    )


def test_an_empty_cache_is_no_reason_to_wait(tmp_path):
    place = folder(tmp_path)
    place.mkdir(parents=True, exist_ok=True)
    with open(place / first_use.LOCK, "a") as lock:  # somebody compiles already, so this run starts nobody
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = run(SOLVE, tmp_path)
        answer = json.loads(done.stdout)
        assert done.returncode == 0 and answer["kernel"] == "interpreted" and answer["success"]
        assert "background" in done.stderr
        robot = ik.Robot.load("hydrolek_7w")
        assert np.linalg.norm(robot.fk(answer["q"]).translation - (1.0, 0.1, 0.2)) < 1e-6
        time.sleep(3.0)  # the process in the background finds the lock taken and ends
    assert not list(tmp_path.rglob("*.nbc"))


def test_on_a_build_machine_and_in_process_it_compiles(capsys):
    assert main(SOLVE) == 0
    assert json.loads(capsys.readouterr().out)["kernel"] == "compiled"
    warm = subprocess.run(
        [sys.executable, "-m", "ik_toolkit", *SOLVE], env={**os.environ, "CI": "1"}, capture_output=True
    )
    assert json.loads(warm.stdout)["kernel"] == "compiled"


@pytest.mark.slow
def test_what_the_uncompiled_kernel_cannot_solve_is_solved_compiled_and_then_everything_is(tmp_path):
    unsolved = run(OUT_OF_LIMITS, tmp_path)
    assert unsolved.returncode == 1 and json.loads(unsolved.stdout)["kernel"] == "compiled"
    assert run(["doctor", "--prepare"], tmp_path).returncode == 0
    kept = set(tmp_path.rglob("*.nbc"))
    after = run(SOLVE, tmp_path)
    assert json.loads(after.stdout)["kernel"] == "compiled" and "background" not in after.stderr
    assert set(tmp_path.rglob("*.nbc")) == kept
