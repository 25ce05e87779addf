"""Batches: rows as if each were alone, whatever the threads, chunks or workers; chains; what is refused, and how."""

import concurrent.futures
import multiprocessing

import numpy as np
import pytest
from robots import have_data, load, sample

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget, UnknownSolver
from ik_toolkit.solvers import batch as module
from ik_toolkit.solvers.batch import solve_parts
from ik_toolkit.solvers.batch_result import BatchInterrupted


def poses(robot, count, seed=0):
    low, span = robot._sampling
    Q = (low + span * np.random.default_rng(seed).random((count, robot.n))).clip(robot.lower, robot.upper)
    return robot.chain.forward(Q)[0]


@pytest.mark.parametrize(("name", "solver"), [("hydrolek_7w", "lm"), ("hydrolek_7w", "dls"), ("mimic_mix", "lm")])
def test_rows_are_those_of_single_solves(name, solver):
    robot = load(name)
    T = sample(robot, 40)[1]
    T[7, :3, 3] += 100.0
    many = ik.solve_batch(robot, T, solver)
    for k, target in enumerate(T):
        one = ik.solve(robot, target, solver)
        assert many.status[k] == one.status
        alone = ik.solve_batch(robot, T[k : k + 1], solver)
        assert alone._table.tobytes() == many._table[k : k + 1].tobytes()
        if k == 7 or (name, solver) != ("hydrolek_7w", "lm"):  # these are solved eight side by side, see test_lanes
            assert many.q[k].tobytes() == one.q.tobytes() and many.iterations[k] == one.iterations
            assert many[k].message == ik.Solver(robot, solver)(target).message
    assert many.counts()["UNREACHABLE"] == 1 and not many.success[7]


def test_bytes_do_not_depend_on_threads_or_chunks():
    robot = load("inspection_7dof")
    T = poses(robot, 6000)
    q0 = np.tile(robot.home, (len(T), 1)) + np.linspace(-0.1, 0.1, len(T))[:, None]
    for starts in (None, robot.home, q0):
        table = ik.solve_batch(robot, T, "lm", q0=starts, threads=1)._table.tobytes()
        assert ik.solve_batch(robot, T, "lm", q0=starts, threads=3)._table.tobytes() == table
        chunks = (T[a : a + 777] for a in range(0, len(T), 777))
        assert ik.solve_batch(robot, chunks, "lm", q0=starts)._table.tobytes() == table
        joined = np.concatenate([part._table for part in solve_parts(robot, T, "lm", q0=starts)])
        assert joined.tobytes() == table


def test_each_row_starts_at_its_own_q0():
    robot = load("hydrolek_7w")
    Q, T = sample(robot, 50, seed=3)
    many = ik.solve_batch(robot, T, "lm", q0=Q)
    assert (many.iterations == 0).all() and np.array_equal(many.q, Q)
    assert (ik.solve_batch(robot, T, "lm", q0=Q[0]).iterations[1:] > 0).all()


@pytest.mark.parametrize(("name", "solver"), [("planar_2r", "planar-2r"), ("hydrolek_7w", "lm")])
def test_auto_is_what_solve_takes(name, solver):
    robot = load(name)
    xyz = sample(robot, 20)[1][:, :3, 3]
    many = ik.solve_batch(robot, xyz)
    assert many.solver == ik.solve(robot, xyz[0]).solver == solver
    assert many.orientation_error is None and many.success.all()


def test_other_solvers_and_options_reach_the_rows():
    robot = load("hydrolek_7w")
    T = sample(robot, 8)[1]
    for solver, options in (
        ("dls", {"max_iterations": 5}),
        ("pinv", {"objective": "mid-range"}),
        ("lm", {"closest": True}),
    ):
        many = ik.solve_batch(robot, T, solver, q0=robot.home, **options)
        for k, target in enumerate(T):
            assert many.q[k].tobytes() == ik.solve(robot, target, solver, q0=robot.home, **options).q.tobytes()


def test_nearly_rigid_rotations_are_projected_as_in_solve():
    robot = load("hydrolek_7w")
    T = sample(robot, 5)[1]
    T[3, :3, :3] *= 1.0 + 1e-4
    given = T.copy()
    many = ik.solve_batch(robot, T, "lm")
    assert many.q[3].tobytes() == ik.solve(robot, T[3], "lm").q.tobytes()
    assert np.array_equal(T, given)


def test_lists_of_poses_and_no_targets_at_all():
    robot = load("hydrolek_7w")
    assert ik.solve_batch(robot, [robot.fk(robot.home)] * 3).success.all()
    for nothing in ([], np.empty((0, 4, 4)), np.empty((0, 3)), iter([])):
        none = ik.solve_batch(robot, nothing)
        assert len(none) == 0 and none.q.shape == (0, robot.n) and none.counts() == {}


def test_mistakes_are_named_with_their_row():
    robot = load("hydrolek_7w")
    T = poses(robot, 3000)
    broken = T.copy()
    broken[2500, 0, 3] = np.nan
    with pytest.raises(InvalidTarget, match="target 2500"):
        ik.solve_batch(robot, broken)
    broken = T.copy()
    broken[2100, :3, :3] *= 2.0
    with pytest.raises(InvalidTarget, match="target 2100"):
        ik.solve_batch(robot, broken)
    q0 = np.tile(robot.home, (len(T), 1))
    q0[2400, 1] = np.inf
    with pytest.raises(InvalidConfiguration, match="target 2400"):
        ik.solve_batch(robot, T, q0=q0)
    q0[2400] = robot.upper + 1.0
    with pytest.raises(InvalidConfiguration, match=f"target 2400 .*{robot.joint_names[0]}"):
        ik.solve_batch(robot, T, q0=q0, q0_outside="refuse")
    assert ik.solve_batch(robot, T[:1], q0=q0[2400:2401]).success.all()  # clamped otherwise
    with pytest.raises(InvalidConfiguration, match="shape"):
        ik.solve_batch(robot, T, q0=q0[:5])
    with pytest.raises(InvalidConfiguration, match="fewer"):
        ik.solve_batch(robot, iter([T[:4], T[4:8]]), q0=q0[:5])
    with pytest.raises(InvalidTarget, match="not both"):
        ik.solve_batch(robot, iter([T, T[:, :3, 3]]))


@pytest.mark.parametrize(
    "targets", [np.zeros((3, 5)), np.zeros(3), np.eye(4), "abc", [["a"] * 3], np.array([None] * 3), 5, iter(["x"])]
)
def test_what_is_not_an_array_of_targets_is_refused(targets):
    with pytest.raises(InvalidTarget, match="targets are"):
        ik.solve_batch(load("hydrolek_7w"), targets)


def test_options_that_do_not_fit_are_refused():
    robot = load("hydrolek_7w")
    xyz = np.zeros((2, 3))
    for options, words in (
        ({"threads": 0}, "threads"),
        ({"threads": 1.5}, "threads"),
        ({"check": 2}, "fraction"),
        ({"history": True}, "history"),
        ({"tolerence": 1}, "tolerance"),
        ({"chain": True, "executor": concurrent.futures.ThreadPoolExecutor()}, "chain"),
    ):
        with pytest.raises(InvalidOption, match=words):
            ik.solve_batch(robot, xyz, **options)
    with pytest.raises(UnknownSolver):
        ik.solve_batch(robot, xyz, "lmm")
    with pytest.raises(InvalidOption, match="does not solve poses"):
        ik.solve_batch(load("planar_2r"), np.eye(4)[None], "planar-2r")
    with pytest.raises(InvalidOption, match="one tip"):
        ik.solve_batch(ik.Robot.load("brokk_hydrolek", tip=["left_tip", "right_tip"]), xyz)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 1.0])
def test_a_fraction_is_checked_by_pinocchio(monkeypatch, fraction):
    """An answer Pinocchio does not confirm is no success: here it says so of every row it is asked about."""
    robot = load("hydrolek_7w")
    T = poses(robot, 5000, seed=1)
    monkeypatch.setattr(ik.Robot, "errors", lambda *_: (1.0, 1.0))
    many = ik.solve_batch(robot, T, "lm", check=fraction, threads=2)
    failed = np.flatnonzero(many.status == ik.Status.CHECK_FAILED)
    assert np.array_equal(failed, np.arange(0, 5000, round(1 / fraction)) if fraction else [])


def test_progress_counts_up_to_all():
    robot = load("planar_3r")
    seen = []
    ik.solve_batch(robot, poses(robot, 5000)[:, :3, 3], progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 5000 and len(seen) > 1


@pytest.mark.parametrize("chain", [False, True])
def test_an_interrupt_keeps_what_is_finished(chain):
    robot = load("planar_3r")
    T = poses(robot, 20000)[:, :3, 3]
    whole = ik.solve_batch(robot, T, "lm", chain=chain)

    def stop(done):
        if done >= 5000:
            raise KeyboardInterrupt

    with pytest.raises(BatchInterrupted) as caught:
        ik.solve_batch(robot, T, "lm", chain=chain, progress=stop)
    kept = caught.value.result
    assert isinstance(caught.value, KeyboardInterrupt) and 5000 <= len(kept) < 20000
    assert np.array_equal(kept._table, whole._table[: len(kept)], equal_nan=True)


def test_an_iterator_is_not_read_far_ahead():
    robot = load("planar_3r")
    chunk = poses(robot, module.PART)[:, :3, 3]
    read = []
    parts = solve_parts(robot, (read.append(k) or chunk for k in range(100)), "lm", threads=1)
    next(parts)
    assert len(read) <= module.AHEAD + 1
    parts.close()
    assert len(read) <= module.AHEAD + 1


# ---------------------------------------------------------------------------------------------------------------- chains
def test_a_chain_follows_a_path_without_flips():
    robot = load("hydrolek_7w")
    Q = robot.home + np.linspace(0.0, 0.4, 60)[:, None]
    Q = Q[(robot.lower <= Q).all(axis=1) & (robot.upper >= Q).all(axis=1)]
    T = np.array([robot.fk(q).homogeneous for q in Q])
    path = ik.solve_batch(robot, T, chain=True, q0=Q[0])
    assert path.success.all() and len(path.flips) == 0 and path.moves[0] == 0.0
    steps = np.abs(np.diff(path.q, axis=0) / robot.chain.unit).max(axis=1)
    assert np.allclose(path.moves[1:], steps) and steps.max() < 0.1
    for k in range(1, len(T)):
        assert path.q[k].tobytes() == ik.solve(robot, T[k], "lm", q0=path.q[k - 1]).q.tobytes()


def test_a_chain_reports_flips_and_steps_over_what_it_cannot_solve():
    robot = load("planar_2r")
    up = robot.fk([0.3, 1.0]).translation
    across = robot.fk([2.0, 1.0]).translation
    path = ik.solve_batch(robot, np.array([up, up, [9.0, 0.0, 0.0], up, across]), "lm", chain=True, q0=[0.3, 1.0])
    assert path.status.tolist() == [0, 0, ik.Status.UNREACHABLE, 0, 0]
    assert np.isnan(path.moves[2]) and path.moves[3] == 0.0 and path.flips.tolist() == [4]
    assert ik.solve_batch(robot, up[None]).flips is None


@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
def test_a_chain_that_has_to_jump_takes_the_nearest_of_several():
    """The arm runs into a limit on this path; the next descent would end 5 rad away."""
    robot = load("panda")
    end = sample(robot, 2)[0][1]
    T = [robot.fk(q) for q in robot.home + np.linspace(0, 1, 1000)[:, None] * (end - robot.home)]
    path = ik.solve_batch(robot, T, "lm", chain=True, q0=robot.home)
    assert path.success.all() and len(path.flips) == 0
    alone = ik.Solver(robot, "lm")
    jumps = [np.abs(alone(T[k], path.q[k - 1]).q - path.q[k - 1]).max() for k in range(1, len(T))]
    assert max(jumps) > 3.0


# ------------------------------------------------------------------------------------------------------------- executors
class Recording(concurrent.futures.Executor):
    """Runs at once, and counts."""

    def __init__(self):
        self.count = 0

    def submit(self, function, /, *arguments, **keywords):
        self.count += 1
        future = concurrent.futures.Future()
        try:
            future.set_result(function(*arguments, **keywords))
        except Exception as error:
            future.set_exception(error)
        return future


def test_an_executor_gives_the_same_bytes_and_the_same_errors():
    robot = load("mimic_mix")
    T = poses(robot, 9000)
    executor = Recording()
    far = ik.solve_batch(robot, T, "lm", executor=executor, seed=3)
    assert executor.count == 3
    assert far._table.tobytes() == ik.solve_batch(robot, T, "lm", seed=3)._table.tobytes()
    T[8000, 0, 3] = np.inf
    with pytest.raises(InvalidTarget, match="target 8000"):
        ik.solve_batch(robot, T, "lm", executor=executor)


def test_processes_give_the_same_bytes():
    robot = load("hydrolek_7w")
    T = poses(robot, 200)
    with concurrent.futures.ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        far = ik.solve_batch(robot, T, ik.DLS(damping=0.05), executor=pool, max_iterations=50)
    near = ik.solve_batch(robot, T, ik.DLS(damping=0.05), max_iterations=50)
    assert far._table.tobytes() == near._table.tobytes()
