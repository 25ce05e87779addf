"""Ctrl-C (the real signal) in long commands: exit code 130 without delay, and finished work is in the output file."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import robots

import ik_toolkit as ik

pytestmark = pytest.mark.slow
COUNT = 1_000_000
SOON = 1.0  # s, what is aimed at; the note has what was measured


def interrupted(record_property, words, began):
    """Run `ik` until `began()` is true and a little longer, send SIGINT; returns its stderr."""
    with subprocess.Popen(
        [sys.executable, "-m", "ik_toolkit", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # a test run may ignore it
    ) as process:
        for _ in range(1200):
            if began() or process.poll() is not None:
                break
            time.sleep(0.1)
        time.sleep(1.0)
        early = process.poll() is not None
        sent = time.monotonic()
        process.send_signal(signal.SIGINT)
        try:
            _, err = process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            raise
    assert not early, f"it ended before it could be interrupted: {err}"
    record_property("note", f"`ik {words[0]}` ended {time.monotonic() - sent:.2f} s after Ctrl-C (aim: {SOON:g} s)")
    assert process.returncode == 130, err
    return err


def some(path):
    """Whether something of a file has been written: under its name or beside it."""
    return lambda: any(other.stat().st_size > 0 for other in path.parent.glob(f"{path.name}*"))


def partial(path):
    """What an interrupted command leaves; the name asked for stays free."""
    assert not path.exists()
    return path.with_name(f"{path.name}.partial")


@pytest.mark.parametrize(("suffix", "solver"), [(".csv", "lm"), (".npz", "dls")])  # lm would be done too soon
def test_batch(tmp_path, record_property, suffix, solver):
    robot = robots.load("hydrolek_7w")
    T = robots.sample(robot, 1000)[1]
    np.savez(tmp_path / "in.npz", targets=np.tile(T, (4 * COUNT // 1000, 1, 1)))
    out = tmp_path / f"out{suffix}"
    began = some(out) if suffix == ".csv" else lambda time_=time.monotonic(): time.monotonic() > time_ + 3
    words = ["solve", "hydrolek_7w", "--targets", str(tmp_path / "in.npz"), "-s", solver, "-o", str(out)]
    err = interrupted(record_property, words, began)
    out = partial(out)
    kept = len(np.load(out)["q"]) if suffix == ".npz" else out.read_text().count("\n") - 1
    assert 0 < kept < 4 * COUNT and f"the first {kept} solutions are in {out}" in err


def test_workspace(tmp_path, record_property):
    out = tmp_path / "out.csv"
    words = ["workspace", "hydrolek_7w", "-n", str(5 * COUNT), "--csv", str(out)]
    interrupted(record_property, words, some(out))
    lines = partial(out).read_text().splitlines()
    assert 1 < len(lines) < 5 * COUNT and {line.count(",") for line in lines} == {lines[0].count(",")}


def test_bench(tmp_path, record_property):
    ik.solve(ik.Robot.load("planar_3r"), (1.0, 1.0, 0.0), "dls")  # compiled, so that the command is soon at work
    out = tmp_path / "out.json"
    began = time.monotonic()
    words = ["bench", *["planar_3r"] * 200, "--solvers", "dls", "-n", "50000", "-o", str(out)]  # long on any machine
    interrupted(record_property, words, lambda: time.monotonic() > began + 8)
    rows = json.loads(partial(out).read_text())["rows"]
    assert 0 < sum(row["targets"] for row in rows) < 200 * 50000


def test_tune(tmp_path, record_property):
    out = tmp_path / "out.toml"
    words = ["tune", "hydrolek_7w", "pid", "--generations", "100000", "-o", str(out)]
    interrupted(record_property, words, some(out.with_suffix(".npz")))
    assert "kp" in partial(out).read_text()
