"""The commands that make the published tables."""

import importlib
import json
import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from folders import SCRIPTS

import ik_toolkit as ik

BENCHMARKS = SCRIPTS / "benchmarks"


@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("hydrolek_7w")


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
        monkeypatch.setenv(name, "1")  # the scripts set these; put back afterwards
    return importlib.import_module


def test_serial_urdf_is_the_same_arm(scripts):
    """What the peers are given has the kinematics and limits of the robot, continuous joints apart."""
    common = scripts("common")
    brokk = ik.Robot.load("brokk_hydrolek", tip="left_tip")
    rng = np.random.default_rng(0)
    for robot in (ik.Robot.load("hydrolek_7w"), brokk):
        arm = ik.Robot.load(common.serial_urdf(robot), base=robot.base, tip=robot.tip)
        assert arm.joint_names == robot.joint_names
        assert arm.model.njoints == arm.n + 1
        bounded = np.isfinite(robot.lower)
        assert (arm.lower[bounded] == robot.lower[bounded]).all() and (arm.upper[bounded] == robot.upper[bounded]).all()
        assert arm.lower[~bounded] == pytest.approx(-2 * math.pi)
        for _ in range(5):
            q = arm.random_q(rng)
            assert arm.fk(q).homogeneous == pytest.approx(robot.fk(q).homogeneous, abs=1e-12)


def test_checker_is_not_fooled(scripts, arm):
    """An answer counts by Pinocchio, inside limits; the right one of several, and full turns, are accepted."""
    solve = scripts("solve")
    rng = np.random.default_rng(0)
    Q = np.array([arm.random_q(rng) for _ in range(6)])
    T = arm.chain.forward(Q)[0]
    answers = np.full((6, 2, arm.n), np.nan)
    answers[:, 0] = Q
    answers[1, 0, 0] += 1e-4  # off
    answers[2, 0] = np.nan  # none
    answers[3] = Q[0], Q[3]  # the second one is right
    answers[4, 0, 5] += 2 * math.pi  # the same pose, a turn away
    outside = arm.upper + 0.1
    answers[5, 0], T[5] = outside, arm.chain.forward(outside[None])[0][0]
    assert solve.right(arm, answers, T, (1e-6, 1e-6)).tolist() == [True, False, False, True, True, False]


def test_axes_given_to_analytic_peers(scripts, arm, tmp_path):
    """Product of exponentials of H and P is the tip, so that a peer told of axes solves the same arm."""
    solve = scripts("solve")
    s = solve.describe(arm, tmp_path)
    q = arm.random_q(np.random.default_rng(1))
    R, p = np.eye(3), np.array(s["P"][0])
    for h, offset, angle in zip(s["H"], s["P"][1:], q, strict=True):
        R = R @ solve.pin.exp3(np.array(h) * angle)
        p = p + R @ offset
    reached = arm.fk(q)
    assert p == pytest.approx(reached.translation, abs=1e-12)
    assert R @ np.array(s["R_tip"]) == pytest.approx(reached.rotation, abs=1e-12)


def test_quaternion_and_turns_of_the_worker(scripts):
    worker, pin = scripts("worker"), scripts("solve").pin
    rng = np.random.default_rng(0)
    for _ in range(20):
        T = np.eye(4)
        T[:3, :3] = pin.exp3(rng.normal(size=3) * 2)
        x, y, z, w = worker.quaternion_xyzw(T)
        assert pin.Quaternion(w, x, y, z).toRotationMatrix() == pytest.approx(T[:3, :3], abs=1e-12)
    lower, upper = np.array([-1.0, -1.0, -4.0]), np.array([1.0, 1.0, 4.0])
    assert worker.wrapped(np.array([6.3, 0.5, -9.0]), lower, upper) == pytest.approx(
        [6.3 - 2 * math.pi, 0.5, -9.0 + 2 * math.pi]
    )
    grazing = np.array([1.0 + 5e-9, -1.0 - 5e-9, 0.0])  # rounding past a limit is no reason to turn round
    assert (worker.wrapped(grazing, lower, upper) == grazing).all()


def test_rounds_are_settled_by_their_median(scripts):
    solve = scripts("solve")
    rounds = [
        {
            "robot": "x",
            "refused": {},
            "rows": {"ik": {"solved": n, "targets": 10, "wall": {"p99": t}, "processor": {"p99": -t}}},
        }
        for n, t in ((10, 5.0), (9, 100.0), (10, 7.0))
    ]
    run = solve.settled(rounds)
    assert run["rows"]["ik"]["wall"] == {"p99": 7.0} and run["rows"]["ik"]["processor"] == {"p99": -7.0}
    assert (
        run["rows"]["ik"]["solved"] == 29 and run["rows"]["ik"]["targets"] == 30 and "faster" not in run["rows"]["ik"]
    )


def test_one_small_run_against_a_process_of_its_own(tmp_path):
    """End to end with our own solvers as the peers: processes, blocks, checks, tables."""
    output = tmp_path / "solve.json"
    command = [
        sys.executable, str(BENCHMARKS / "solve.py"), "--venvs", str(tmp_path), "--robots", "hydrolek_7w", "--peers", "ik",
        "ik_q0", "--against", "ik_q0", "--targets", "20", "--blocks", "1", "--rounds", "1", "--starts", "near",
        "--tolerances", "strict", "-o", str(output),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True)
    written = json.loads(output.read_text(encoding="utf-8"))
    (run,) = written["runs"]
    assert run["refused"] == {} and set(run["rows"]) == {"ik", "ik_q0"}
    assert run["rows"]["ik"]["solved"] == run["rows"]["ik"]["targets"] == 20
    assert run["rows"]["ik_q0"]["faster"]["wall"]["median"] == 1.0
    assert "| `ik` |" in written["tables"]
    assert str(tmp_path) not in json.dumps(written)


def test_an_interrupt_keeps_the_blocks_that_are_finished(run, tmp_path, monkeypatch):
    from ik_toolkit.study import benchmark as module

    real, done = module.run_block, []

    def impatient(*job):
        if len(done) == 15:
            raise KeyboardInterrupt
        done.append(job)
        return real(*job)

    monkeypatch.setattr(module, "run_block", impatient)
    words = "bench planar_2r planar_3r --solvers lm,dls -n 100 -o".split()
    code, _, err = run(*words, tmp_path / "out.json")
    assert code == 130 and "interrupted" in err
    rows = json.loads((tmp_path / "out.json.partial").read_text())["rows"]
    done = [(row["robot"], row["solver"], row["targets"]) for row in rows]
    assert done == [("planar_2r", "lm", 40), ("planar_2r", "dls", 30)]
    assert all(row["once"]["targets"] == row["targets"] for row in rows)


def test_a_run_over_streams_goes_on_where_its_file_leaves_off(scripts, monkeypatch):
    servo = scripts("servo")
    monkeypatch.setattr(servo, "load", lambda robot: robot)
    monkeypatch.setattr(servo, "make", lambda scenario, robot, seed: SimpleNamespace(name=scenario, targets=[0]))
    monkeypatch.setattr(servo, "mark_of", lambda stream: f"as {stream.name} is now")
    monkeypatch.setattr(
        servo, "run", lambda s, robot, asked, folder, keep, before: (robot, s.name, [*asked], before.get("rows"))
    )
    kept = [
        {"robot": "arm", "mark": "as first is now", "rows": {"ik": 1}, "refused": {"pink": "why"}},
        {"robot": "arm", "mark": "as second was", "rows": {"ik": 2}},
        {"robot": "other", "mark": "as second is now", "rows": {"ik": 3}},
        {"robot": "arm", "mark": "as third is now", "rows": {"ik": 4, "pink": 5, "dls": 6}},
    ]
    given = SimpleNamespace(robots=["arm"], scenarios=["first", "second", "third"], seed=0, keep=None, resume=True)
    processes = dict.fromkeys(("ik", "pink", "dls"))
    ran = list(servo.streams(given, kept, processes, None))
    assert ran == [("arm", "first", ["dls"], {"ik": 1}), ("arm", "second", ["ik", "pink", "dls"], None)]
    given.resume = False
    ran = list(servo.streams(given, kept, processes, None))
    assert [(name, asked, rows) for _, name, asked, rows in ran] == [
        ("first", [*processes], {"ik": 1}),
        ("second", [*processes], None),
        ("third", [*processes], kept[3]["rows"]),
    ]


def test_data_are_compact_and_lose_no_figure(scripts):
    """A row a line: what the commands wrote comes back to the last digit, and is written the same again."""
    common = scripts("common")
    files = sorted((SCRIPTS.parent / "docs" / "data").glob("benchmark_*.json"))
    assert files
    for path in files:
        data = common.read(path)
        assert path.read_text(encoding="utf-8") == common.compact(data) + "\n", path.name
        for row in data.get("rows", []):
            assert len(json.dumps(row)) <= common.ROW or "\n" in common.compact(row)
    odd = {"a": [0.1 + 0.2, None, "x\n|"], "b": [{"k": [1e-300] * 200}] * 3, "c": {}}
    assert json.loads(common.compact(odd)) == odd and len(common.compact(odd).splitlines()) > 3


def test_benchmark_pages_are_made_from_the_data(scripts):
    """No figure is typed: the answers and every page below them are what page.py makes of docs/data."""
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'plots')")
    page, common = scripts("page"), scripts("common")
    docs = SCRIPTS.parent / "docs"
    found = {}
    for one in page.PAGES:
        path = docs / "data" / f"benchmark_{one.data}.json"
        if path.exists():
            found[one.data] = common.read(path)
            text = (docs / "benchmarks" / f"{one.name}.md").read_text(encoding="utf-8")
            assert text == page.detail(one, found[one.data]), one.name
    text = (docs / "benchmarks.md").read_text(encoding="utf-8")
    for answer in page.answers(found):
        assert f"## {answer.question}\n\n{answer.words}" in text and answer.table in text
        assert (docs / "benchmarks" / f"{answer.page}.md").exists()
