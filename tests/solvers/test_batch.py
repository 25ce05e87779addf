"""Batches: the same bytes for any threads, chunks or workers; the check by Pinocchio; rejected input."""

import concurrent.futures
import multiprocessing
import pickle

import numpy as np
import pytest
from robots import load, sample
from second_fk import SecondFK, pose_errors

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget, UnknownSolver
from ik_toolkit.solvers.batch.parts import AHEAD
from ik_toolkit.solvers.batch.result import BatchInterrupted
from ik_toolkit.solvers.batch.solve_batch import PART, solve_parts


def poses(robot, count, seed=0):
    return robot.chain.forward(robot.random_q(np.random.default_rng(seed), count))[0]


ROWS = [("hydrolek_7w", "lm"), ("hydrolek_7w", "dls"), ("mimic_mix", "lm"), ("inspection_7dof", "inspection")]


@pytest.mark.parametrize(("name", "solver"), ROWS)
def test_rows_are_those_of_single_solves(name, solver):
    robot = load(name)
    T = sample(robot, 40)[1]
    T[7, :3, 3] += 100.0
    many = ik.solve_batch(robot, T, solver)
    for k, target in enumerate(T):
        one = ik.solve(robot, target, solver)
        assert many.status[k] == one.status
        alone = ik.solve_batch(robot, T[k : k + 1], solver)
        assert alone.table.tobytes() == many.table[k : k + 1].tobytes()
        if k == 7 or (name, solver) != ("hydrolek_7w", "lm"):  # these are solved eight side by side, see test_lanes
            assert many.q[k].tobytes() == one.q.tobytes() and many.iterations[k] == one.iterations
            assert many[k].message == ik.Solver(robot, solver)(target).message
    assert many.counts()["UNREACHABLE"] == 1 and not many.success[7]


def test_bytes_do_not_depend_on_threads_or_chunks():
    robot = load("inspection_7dof")
    T = poses(robot, 6000)
    q0 = np.tile(robot.home, (len(T), 1)) + np.linspace(-0.1, 0.1, len(T))[:, None]
    for starts in (None, robot.home, q0):
        table = ik.solve_batch(robot, T, "lm", q0=starts, threads=1).table.tobytes()
        assert ik.solve_batch(robot, T, "lm", q0=starts, threads=3).table.tobytes() == table
        chunks = (T[a : a + 777] for a in range(0, len(T), 777))
        assert ik.solve_batch(robot, chunks, "lm", q0=starts).table.tobytes() == table
        joined = np.concatenate([part.table for part in solve_parts(robot, T, "lm", q0=starts)])
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


def test_results_are_taken_by_number_or_slice():
    robot = load("hydrolek_7w")
    many = ik.solve_batch(robot, sample(robot, 5)[1])
    assert [one.q.tobytes() for one in many[1:4]] == [many[k].q.tobytes() for k in (1, 2, 3)]
    assert many[-1].q.tobytes() == many[np.int64(4)].q.tobytes() == list(many)[4].q.tobytes() and many[5:] == []
    for wrong in ("a", 1.5, None, [0, 1]):
        with pytest.raises(InvalidOption, match="by a number or a slice"):
            many[wrong]
    with pytest.raises(IndexError):
        many[5]


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
    assert ik.solve_batch(robot, T[:1], q0=q0[2400:2401]).success.all()  # clamped otherwise
    with pytest.raises(InvalidConfiguration, match="shape"):
        ik.solve_batch(robot, T, q0=q0[:5])
    with pytest.raises(InvalidConfiguration, match="q0 has 5 rows, fewer than there are targets"):
        ik.solve_batch(robot, iter([T[:4], T[4:8]]), q0=q0[:5])
    with pytest.raises(InvalidConfiguration, match="q0 has 9 rows, more than the 8 targets"):
        ik.solve_batch(robot, iter([T[:4], T[4:8]]), q0=q0[:9])
    assert ik.solve_batch(robot, iter([T[:4], T[4:8]]), q0=q0[:8]).success.all()
    with pytest.raises(InvalidTarget, match="not both"):
        ik.solve_batch(robot, iter([T, T[:, :3, 3]]))


@pytest.mark.parametrize(
    ("targets", "said"),
    [
        (np.zeros((3, 5)), "targets must be"),
        (np.zeros(3), "targets must be"),
        ("abc", "targets must be"),
        ([["a"] * 3], "targets must be"),
        (np.array([None] * 3), "targets must be"),
        (5, "targets must be"),
        (iter(["x"]), "targets must be"),
        ("poses.csv", "targets must be .*, not 'poses.csv'"),
        ([{1}], "not {1}"),
        ([np.eye(4), np.zeros(3)], "either poses or positions"),
        ({(1.0, 0.1, 0.2)}, "not {."),
        ({"position": {"x": 1, "y": 0, "z": 0}}, "a pose that is a dict has the fields of a ROS message"),
        (np.zeros((2, 7)), r"the numbers of a row go into ik.pose\(xyz=, quat_xyzw=\)"),
        (np.zeros((2, 6)), r"the numbers of a row go into ik.pose\(xyz=, rpy=\)"),
        (np.eye(4), "targets must be .* ik.solve takes one target, and targets one by one go into a list"),
        (iter([np.eye(4), np.eye(4)]), "targets one by one go into a list"),
    ],
)
def test_what_is_not_an_array_of_targets_is_refused_and_shown(targets, said):
    with pytest.raises(InvalidTarget, match=said):
        ik.solve_batch(load("hydrolek_7w"), targets)


def test_solvers_that_do_not_fit_are_refused():
    with pytest.raises(UnknownSolver):
        ik.solve_batch(load("hydrolek_7w"), np.zeros((2, 3)), "lmm")
    with pytest.raises(InvalidOption, match="does not solve poses"):
        ik.solve_batch(load("planar_2r"), np.eye(4)[None], "planar-2r")


@pytest.mark.parametrize(
    ("share", "rows"),
    [(0.0, 0), (5e-324, 1), (0.01, 30), (1 / 3, 1000), (np.float32(0.5), 1500), (0.6, 1800), (0.97, 2910), (1.0, 3000)],
)
def test_the_share_asked_for_is_checked(monkeypatch, share, rows):
    """To a row, and the same rows whatever the chunks; 0.6 once checked a half."""
    robot = load("hydrolek_7w")
    T = poses(robot, 3000, seed=1)
    real, asked, row = ik.Robot._errors, [], {target.tobytes(): k for k, target in enumerate(T)}

    def errors(self, q, target):
        asked.append(row[target.tobytes()])
        return real(self, q, target)

    monkeypatch.setattr(ik.Robot, "_errors", errors)
    assert ik.solve_batch(robot, T, "lm", check=share).success.all()
    first = sorted(asked)
    assert len(set(first)) == len(first) == rows
    asked.clear()
    ik.solve_batch(robot, (T[a : a + 271] for a in range(0, len(T), 271)), "lm", check=share)
    assert sorted(asked) == first


def disagreeing(name="hydrolek_7w", row=1300, count=6000):
    """A robot whose Pinocchio does not confirm the answer to one target, and targets (N, 4, 4)."""
    robot = ik.Robot.load(name)
    T = poses(robot, count, seed=1)
    real = robot._errors
    robot._errors = lambda q, target: (0.5, 0.0) if np.array_equal(target, T[row]) else real(q, target)
    return robot, T


@pytest.mark.parametrize("how", ["threads", "one thread", "executor", "iterator"])
def test_an_answer_that_is_not_confirmed_ends_the_batch(how, monkeypatch):
    row, count = 1300, 6000
    robot, T = disagreeing(row=row, count=count)
    options = {"threads": {"threads": 3}, "one thread": {"threads": 1}}.get(how, {})
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        if how == "executor":  # a worker has a robot of its own
            wrong, real = robot._errors, ik.Robot._errors
            monkeypatch.setattr(ik.Robot, "_errors", lambda self, q, T: max(wrong(q, T), real(self, q, T)))
            robot, options = load("hydrolek_7w"), {"executor": pool}
        targets = iter(np.split(T, 6)) if how == "iterator" else T
        with pytest.raises(ik.BatchCheckFailed, match=f"for target {row}, so no result of this batch") as caught:
            ik.solve_batch(robot, targets, "lm", check=1.0, **options)
    many = caught.value.result
    assert isinstance(caught.value, ik.IKError) and caught.value.target == row
    assert len(many) == len(T) or how == "iterator"  # of an iterator what was read up to there
    assert set(many.counts()) == {"CHECK_FAILED"} and not many.success.any()
    assert np.isfinite(many.q[: row + 1]).all() and np.isnan(many.q[row + 1 :]).all()
    assert "report" in many[0].message and "report" in many[len(many) - 1].message
    assert (many.iterations[row + 1 :] == 0).all() and np.isnan(many.position_error[row + 1 :]).all()


def test_the_rows_that_are_left_are_the_same_for_any_number_of_threads():
    robot, T = disagreeing()
    tables = []
    for threads in (1, 2, 5):
        with pytest.raises(ik.BatchCheckFailed) as caught:
            ik.solve_batch(robot, T, "lm", check=1.0, threads=threads)
        tables.append(caught.value.result.table.tobytes())
    assert tables[0] == tables[1] == tables[2]
    del robot._errors
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value) and again.target == 1300


def test_parts_end_where_an_answer_is_not_confirmed():
    robot, T = disagreeing(row=4500)
    given = []
    with pytest.raises(
        ik.BatchCheckFailed, match="The 4096 results already returned cannot be trusted either"
    ) as caught:
        for part in solve_parts(robot, iter([T]), "lm", check=1.0):
            given.append(part)
    assert [len(part) for part in given] == [2048, 2048] and all(part.success.all() for part in given)
    assert caught.value.before == 4096 and len(caught.value.result) == len(T) - 4096
    assert set(caught.value.result.counts()) == {"CHECK_FAILED"}


def test_what_is_not_looked_at_does_not_end_a_batch():
    robot, T = disagreeing()
    assert ik.solve_batch(robot, T, "lm", check=0.0).success.all()
    assert ik.solve_batch(robot, T[1:], "lm", check=0.001).success.all()  # rows 0, 1000, 2000, ...


# ------------------------------------------------------------------------------------------------ what a row promises
@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix", "slides_mix", "mimic_mix", "locked"])
@pytest.mark.parametrize("kind", ["pose", "position"])
def test_a_row_keeps_what_a_single_solve_promises(name, kind):
    """Inside limits and tolerances, the same statuses, as many solved; another of several solutions is allowed."""
    robot = load(name)
    rng = np.random.default_rng(11)
    Q, T = sample(robot, 150, seed=11)
    Q[::3] = np.where(rng.random((50, robot.n)) < 0.5, np.fmin(robot.upper, 3.0), np.fmax(robot.lower, -3.0))
    T = robot.chain.forward(Q)[0]
    T[::10, :3, 3] *= 40.0
    q0 = np.clip(Q + rng.normal(0.0, 0.5, Q.shape), robot.lower, robot.upper)
    targets = T if kind == "pose" else T[:, :3, 3].copy()
    judge = None if robot.urdf is None else SecondFK(robot.urdf, robot.base, robot.tip, rest=robot.locked_joints)
    single = ik.Solver(robot, "lm", tolerance=1e-7)
    for starts in (None, q0):
        many = ik.solve_batch(robot, targets, "lm", q0=starts, tolerance=1e-7)
        alone = [single(x, None if starts is None else starts[k]) for k, x in enumerate(targets)]
        statuses = np.array([int(one.status) for one in alone])
        assert np.array_equal(many.status, statuses)
        for q in (many.q, np.array([one.q for one in alone])):
            assert ((robot.lower <= q) & (q <= robot.upper)).all()
            position, angle = pose_errors(judge.fk(q, robot.joint_names), targets)
            solved = many.success
            assert position[solved].max() <= 1e-7 + 1e-12 and angle[solved].max() <= 1e-7 + 1e-12
        assert many.success.sum() >= 130
        for k in range(0, 150, 10):
            assert many[k].status == alone[k].status and many[k].message.split(";")[0] == alone[k].message.split(";")[0]


def test_progress_counts_up_to_all():
    robot = load("planar_3r")
    seen = []
    ik.solve_batch(robot, poses(robot, 5000)[:, :3, 3], progress=seen.append)
    assert seen == sorted(seen) and seen[-1] == 5000 and len(seen) > 1


def test_an_interrupt_keeps_what_is_finished():
    robot = load("planar_3r")
    T = poses(robot, 20000)[:, :3, 3]
    whole = ik.solve_batch(robot, T, "lm")

    def stop(done):
        if done >= 5000:
            raise KeyboardInterrupt

    with pytest.raises(BatchInterrupted) as caught:
        ik.solve_batch(robot, T, "lm", progress=stop)
    kept = caught.value.result
    assert isinstance(caught.value, KeyboardInterrupt) and 5000 <= len(kept) < 20000
    assert str(caught.value) == f"interrupted after {len(kept)} targets"
    assert np.array_equal(kept.table, whole.table[: len(kept)], equal_nan=True)


def test_an_iterator_is_not_read_far_ahead():
    robot = load("planar_3r")
    chunk = poses(robot, PART)[:, :3, 3]
    read = []
    parts = solve_parts(robot, (read.append(k) or chunk for k in range(100)), "lm", threads=1)
    next(parts)
    assert len(read) <= AHEAD + 1
    parts.close()
    assert len(read) <= AHEAD + 1


# ------------------------------------------------------------------------------------------------------------- executors
class Counting(concurrent.futures.ThreadPoolExecutor):
    """A pool that counts what it is given."""

    count = 0

    def submit(self, *given, **named):
        self.count += 1
        return super().submit(*given, **named)


def test_an_executor_gives_the_same_bytes_and_the_same_errors():
    robot = load("mimic_mix")
    T = poses(robot, 9000)
    with Counting(1) as pool:
        far = ik.solve_batch(robot, T, "lm", executor=pool, seed=3)
        assert pool.count == 3
        assert far.table.tobytes() == ik.solve_batch(robot, T, "lm", seed=3).table.tobytes()
        T[8000, 0, 3] = np.inf
        with pytest.raises(InvalidTarget, match="target 8000"):
            ik.solve_batch(robot, T, "lm", executor=pool)


def test_processes_give_the_same_bytes():
    robot = load("hydrolek_7w")
    T = poses(robot, 200)
    with concurrent.futures.ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        far = ik.solve_batch(robot, T, ik.DLS(damping=0.05), executor=pool, max_iterations=50)
    near = ik.solve_batch(robot, T, ik.DLS(damping=0.05), max_iterations=50)
    assert far.table.tobytes() == near.table.tobytes()
