"""The first solve on a machine: answered at once without compilation, which goes on in the background."""

import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from numba import config

import ik_toolkit as ik
from ik_toolkit.cli import doctor, first_use, main
from ik_toolkit.compile import cache as kernels
from ik_toolkit.robot.library import shipped_robots

SOLVE = ["solve", "hydrolek_7w", "--xyz", "1.0", "0.1", "0.2", "--json"]
OUT_OF_LIMITS = ["solve", "hydrolek_7w", "--xyz", "-1.2", "0.0", "0.3", "--json"]  # in reach, but not within the limits


def run(arguments, cache, *, start=("-m", "ik_toolkit"), cwd=None, given=None, **more):
    """Run `ik` as a user does, with a cache folder of its own."""
    env = {key: value for key, value in os.environ.items() if key not in ("CI", first_use.WAIT, "NUMBA_DISABLE_JIT")}
    env |= {"NUMBA_CACHE_DIR": str(cache), **more}
    return subprocess.run(
        [sys.executable, *start, *arguments], env=env, capture_output=True, text=True, timeout=500, cwd=cwd, input=given
    )


def folder(cache):
    """Where kernels go when `cache` is the cache folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(config, "CACHE_DIR", str(cache))  # what NUMBA_CACHE_DIR sets
        return kernels.folder()


@contextlib.contextmanager
def compiling_elsewhere(cache):
    """Somebody compiles already, so a process in the background has nothing to do; waits for the end of the one begun here."""
    place = folder(cache)
    place.mkdir(parents=True, exist_ok=True)
    os.mkfifo(place / first_use.LOG)
    with (
        open(place / first_use.LOCK, "a") as lock,
        open(os.open(place / first_use.LOG, os.O_RDONLY | os.O_NONBLOCK), "rb") as log,
    ):
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
        os.set_blocking(log.fileno(), True)
        log.read()  # up to where nobody can write any more


def test_an_empty_cache_is_no_reason_to_wait(tmp_path):
    """The second run gets the same standard input, repeats no notice and runs nothing from the current folder."""
    text = shipped_robots()["hydrolek_7w"].path.read_text()
    (tmp_path / "typer.py").write_text("raise SystemExit('ran what lies in the current folder')")
    script = "import sys; sys.path.remove(''); from ik_toolkit.cli import main; sys.exit(main())"  # as the script `ik`
    words = ["solve", "-", *SOLVE[2:], "--rpy", "90", "0", "0", "--mask", "1", "1", "1", "0", "0", "0"]
    with compiling_elsewhere(tmp_path):
        done = run(words, tmp_path, start=("-c", script), cwd=tmp_path, given=text)
    answer = json.loads(done.stdout)
    assert done.returncode == 0 and answer["kernel"] == "interpreted" and answer["success"], done.stderr
    assert answer["robot"] == "hydrolek_7w" and "background" in done.stderr
    robot = ik.Robot.load("hydrolek_7w")
    assert np.linalg.norm(robot.fk(answer["q"]).translation - (1.0, 0.1, 0.2)) < 1e-6
    assert done.stderr.count("were degrees meant") == 1 and "current folder" not in done.stderr
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


def test_nothing_is_compiled_ahead_where_it_cannot_be_kept(monkeypatch, capsys):
    monkeypatch.setattr(kernels, "folder", lambda: None)
    monkeypatch.setattr("ik_toolkit.solvers.prepare.prepare", lambda **_: pytest.fail("compiled in vain"))
    assert main(["doctor", "--prepare"]) in (0, 1)
    assert "could not be kept" in capsys.readouterr().err


DYING = """
import os, sys
from pathlib import Path
from ik_toolkit.cli import first_use
with first_use.only_one(Path(sys.argv[1])):
    print("a last word", flush=True)
    {end}
"""


@pytest.mark.parametrize(
    ("end", "dead"), [("os.abort()", True), ("raise ValueError", True), ("raise KeyboardInterrupt", False)]
)
def test_a_compiler_that_died_in_the_background_is_reported(tmp_path, end, dead, monkeypatch, capsys):
    place = folder(tmp_path)
    place.mkdir(parents=True, exist_ok=True)
    with open(place / first_use.LOG, "wb") as log:
        subprocess.run(
            [sys.executable, "-c", DYING.format(end=end), place], stdout=log, stderr=subprocess.DEVNULL, check=False
        )
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("nothing is begun that dies again"))
    monkeypatch.setattr(first_use, "_run", lambda *_: 0)
    if not dead:
        assert not first_use.died(place)
        return
    assert first_use.again(SOLVE, tmp_path / "closed_form", []) == 0  # where another function would be kept
    said = capsys.readouterr().err
    assert "ended before it was done: a last word" in said and "ik doctor --prepare" in said
    (row,) = first_use_rows()
    assert row["state"] == "problem" and "a last word" in row["detail"]
    with open(place / first_use.LOCK, "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        (row,) = first_use_rows()
        assert row["state"] == "ok" and "at work" in row["detail"]
    first_use.forget(place)
    assert not first_use_rows()


def first_use_rows():
    return list(doctor._background())


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_second_run_ends_with_the_command(number, code):
    # A command that stops where it would compile, and whose second run sleeps until it is ended.
    script = f"""
import sys
from ik_toolkit import cli
from ik_toolkit.cli import first_use
from ik_toolkit.cli.options import RobotOptions
def needed(*_):
    raise first_use.CompileNeeded(None)
second = '''
import sys, time
from ik_toolkit.cli.streams import stoppable
try:
    with stoppable([]):
        print(1, flush=True)
        time.sleep(60)
except KeyboardInterrupt:
    print(2, flush=True)
    sys.exit({code})
'''
RobotOptions.load, run = needed, first_use._run
first_use._run = lambda command, *more: run([sys.executable, "-c", second], *more)
sys.exit(cli.main())
"""
    process = subprocess.Popen(
        [sys.executable, "-c", script, *SOLVE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "1\n"
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == code and out == "2\n" and not err
