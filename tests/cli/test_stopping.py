"""Ctrl-C and SIGTERM in every long command, early and late: what is finished is kept as FILE.partial, and the exit code says it."""

import contextlib
import importlib
import json
import os
import signal
import threading
import warnings

import numpy as np
import pytest
import robots
from folders import csv_rows

from ik_toolkit.cli import batch, bench, main, path, place, reach, tune, workspace
from ik_toolkit.cli.streams import stoppable
from ik_toolkit.papers.report import Report
from ik_toolkit.servo.stepper import Stepper

SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143}


@pytest.fixture(autouse=True)
def heard():
    """A test run in the background may ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def send(number):
    os.kill(os.getpid(), number)


def at_progress(module):
    """Send a signal from the bar of a command, when it is told the k-th time how far the command is."""

    def arrange(monkeypatch, number, k):
        count = iter(range(1, 10**9))

        @contextlib.contextmanager
        def bar(*_):
            yield lambda *_, **__: send(number) if next(count) == k else None

        monkeypatch.setattr(module, "progress", bar)

    return arrange


def in_the_report(monkeypatch, number, k):
    count, add = iter(range(1, 10**9)), Report.text
    monkeypatch.setattr(Report, "text", lambda *a: (add(*a), send(number) if next(count) == k else None))


def while_it_tracks(monkeypatch, number, k):
    count, take = iter(range(1, 10**9)), Stepper.take

    def then_stop(*given, **how):
        done = take(*given, **how)
        if next(count) == 20 * k:
            send(number)
        return done

    monkeypatch.setattr(Stepper, "take", then_stop)


def whole(tmp_path):
    robot = robots.load("planar_2r")
    Q = robot.random_q(np.random.default_rng(0), 60_000)
    np.savez(tmp_path / "in.npz", targets=robot.chain.forward(Q)[0][:, :3, 3])
    with (tmp_path / "in.csv").open("w") as stream:
        stream.write("x,y,z\n1.0,0.3,0\n" + "".join(f"{1.0 + 0.01 * k},{0.3 + 0.01 * k},0\n" for k in range(1, 30)))


def answers_of(out):
    """Number of answers in the log of a study of reach."""
    count = 0
    with out.open("rb") as stream:
        np.load(stream)
        while stream.tell() < out.stat().st_size:
            count += len(np.load(stream))
            np.load(stream), np.load(stream)
    return count


# Words of a command that writes OUT, when the signal comes, and how many rows are kept at most.
COMMANDS = {
    "bench": (["bench", "planar_2r", "-s", "planar-2r,lm", "-n", "400", "-o", "OUT.json"], at_progress(bench),
              lambda out: sum(row["targets"] for row in json.loads(out.read_text())["rows"]), 800),
    "bench to a table": (["bench", "planar_2r", "-s", "planar-2r", "-n", "400", "--csv", "OUT.csv"], at_progress(bench),
                         lambda out: sum(int(row["targets"]) for row in csv_rows(out)), 400),
    "workspace": (["workspace", "planar_2r", "-s", "planar-2r", "-n", "100000", "--csv", "OUT.csv"], at_progress(workspace),
                  lambda out: len(csv_rows(out)), 100_000),
    "solve, csv": (["solve", "planar_2r", "--targets", "in.npz", "-s", "planar-2r", "-o", "OUT.csv"], at_progress(batch),
                   lambda out: len(csv_rows(out)), 60_000),
    "solve, npz": (["solve", "planar_2r", "--targets", "in.npz", "-s", "planar-2r", "-o", "OUT.npz"], at_progress(batch),
                   lambda out: len(np.load(out)["q"]), 60_000),
    "track": (["track", "planar_2r", "--path", "circle", "--avoid-collisions", "-o", "OUT.csv"], while_it_tracks,
              lambda out: len(csv_rows(out)), 1001),
    "path": (["path", "planar_2r", "--poses", "in.csv", "-o", "OUT.npz"], at_progress(path),
             lambda out: len(np.load(out)["q"]), 30),
    "reach": (["reach", "planar_2r", "--resolution", "0.02", "-o", "OUT.npz"], at_progress(reach), answers_of, 45_000),
    "place": (["place", "planar_2r", "--poses", "in.csv", "-o", "OUT.csv"], at_progress(place),
              lambda out: len(csv_rows(out)), 5),
    "tune": (["tune", "planar_3r", "pid", "--generations", "1000", "--targets", "4", "--held-out", "1", "-o", "OUT.toml"],
             at_progress(tune), lambda out: out.read_text().count("solver"), 100),
    "reproduce": (["reproduce", "chinyai", "-o", "."], in_the_report,
                  lambda out: len(json.loads(out.with_name("report.json.partial").read_text())), 100),
}  # fmt: skip


def cases():
    """Every command at every moment by both signals; most of it is slow."""
    for k, name in enumerate(COMMANDS):
        for when in (1, 2, 4):
            for number in SIGNALS:
                chosen = number == [*SIGNALS][k % 2] and when == (4 if name != "tune" else 1)
                quick = (chosen and name != "reproduce") or (name == "bench" and number == signal.SIGINT)
                yield pytest.param(
                    name, number, when, marks=() if quick else pytest.mark.slow, id=f"{name}-{number.name}-{when}"
                )


@pytest.mark.parametrize(("name", "number", "when"), [*cases()])
def test_a_stopped_command_keeps_what_is_finished(name, number, when, tmp_path, monkeypatch, capsys):
    words, arrange, rows, most = COMMANDS[name]
    monkeypatch.chdir(tmp_path)
    whole(tmp_path)
    arrange(monkeypatch, number, when)
    out = next((word for word in words if word.startswith("OUT")), "report.md")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main(words) == SIGNALS[number]
    said = capsys.readouterr().err
    assert ("ik: terminated" if number == signal.SIGTERM else "ik: interrupted") in said and "bug" not in said
    kept = tmp_path / f"{out}.partial"
    assert not (tmp_path / out).exists()
    if kept.exists():
        assert 0 < rows(kept) <= most and "partial" in said
    else:
        assert when == 1 or name == "path", "nothing was kept"  # a path is soon found, and there is none before it
    left = [file.name for file in tmp_path.iterdir() if ".part" in file.name and not file.name.endswith(".partial")]
    assert not left


def test_ctrl_c_that_was_dropped_comes_again():
    """Finalizers, and functions called from C, cannot raise: what was raised there is dropped, and would be lost."""

    class Last:
        def __del__(self):
            send(signal.SIGINT)
            for _ in range(1000):
                pass

    came, later = [], threading.Event()
    with pytest.raises(KeyboardInterrupt), stoppable(came):
        last = Last()
        del last
        assert came == [signal.SIGINT]
        later.wait(5.0)
    assert came == [signal.SIGINT] * 2


def test_ctrl_c_in_an_import_is_not_taken_for_a_missing_library(tmp_path, monkeypatch):
    """As of trimesh, which `ik view` imports: it tries whether others are there, and catches everything."""
    (tmp_path / "tries_another.py").write_text(
        "import os, signal\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n    found = sum(range(9))\n"
        "except BaseException:\n    found = None\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    came, later = [], threading.Event()
    with pytest.raises(KeyboardInterrupt), stoppable(came):
        found = importlib.import_module("tries_another").found
        assert found is not None and not came
        later.wait(5.0)
    assert came == [signal.SIGINT]
