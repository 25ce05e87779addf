"""What the certified lists of the elimination are used for: batches, the nearest of all solutions, all turns."""

import numpy as np
import pytest
import robots
from serial_arms import anywhere, drawn

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption


def mixed(robot, count, seed):
    """Poses (2 count, 4, 4): one half reached within the limits, the other mostly not."""
    rng = np.random.default_rng(seed)
    return np.concatenate([robots.sample(robot, count, seed=seed)[1], [anywhere(robot, rng) for _ in range(count)]])


@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix"])
def test_a_batch_proves_what_a_single_call_proves(name):
    robot = robots.load(name)
    T = mixed(robot, 80, seed=25)
    T[110:, :3, 3] *= np.linspace(0.2, 1.2, 50)[:, None]
    batch, hard = ik.solve_batch(robot, T), ik.solve_batch(robot, T, restarts=200)
    single = [ik.Solver(robot)(t) for t in T]
    assert (batch.status == [one.status for one in single]).all()
    assert (batch.proven == [one.proven for one in single]).all()
    assert batch.success[:80].all() and (batch.proven ^ batch.success).mean() > 0.98 and batch.proven.sum() >= 30
    assert not (batch.proven & (hard.success | batch.success)).any()
    k = int(np.flatnonzero(batch.proven & (batch.status == ik.Status.LIMIT_BLOCKED))[0])
    assert batch[k].blocked.joint == single[k].blocked.joint and batch[k].message == single[k].message
    searched = ik.solve_batch(robot, T, "lm")
    assert not searched.proven[searched.status != ik.Status.UNREACHABLE].any()


def test_a_batch_with_proofs_is_the_same_for_any_parts():
    robot = robots.load("hydrolek_7w")
    T = mixed(robot, 300, seed=26)
    q0 = np.random.default_rng(27).uniform(robot.lower, robot.upper, (600, 6))
    for starts in (None, q0):
        whole = ik.solve_batch(robot, T, q0=starts, threads=1)
        halves = ik.solve_batch(robot, T, q0=starts, threads=3)
        alone = [
            ik.solve_batch(robot, T[k : k + 1], q0=None if starts is None else q0[k : k + 1]) for k in range(290, 310)
        ]
        assert whole.table.tobytes() == halves.table.tobytes()
        assert whole.table[290:310].tobytes() == b"".join(one.table.tobytes() for one in alone)


@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix"])
def test_the_nearest_of_all_solutions_is_found_and_proven(name):
    robot, rng, proven = robots.load(name), np.random.default_rng(28), 0
    Q, T = robots.sample(robot, 25, seed=29)
    near = rng.uniform(np.maximum(robot.lower, -6.0), np.minimum(robot.upper, 6.0), (25, 6))
    batch = ik.solve_batch(robot, T, q0=near, closest=True)
    for k, (q, t) in enumerate(zip(near, T, strict=True)):
        found = ik.solve(robot, t, closest=q)
        every = ik.solve_all(robot, t, q0=q, all_turns=True)
        least = min(np.linalg.norm(every.q - q, axis=1).min(), np.linalg.norm(Q[k] - q))
        assert found.success and batch.success[k]
        for got, sure in ((found.q, found.proven), (batch.q[k], batch.proven[k])):
            if sure:
                proven += 1
                assert np.linalg.norm(got - q) < least + 1e-5
        assert not found.proven or "nearest of all" in found.message
    assert proven > 40
    assert not ik.solve(robot, T[0], "lm", closest=near[0]).proven


def test_all_turns_are_listed_within_limits():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(np.r_[robot.home[:5], 2.5]).homogeneous
    assert robot.upper[5] > 2 * np.pi - 2.5
    one, every = ik.solve_all(robot, T), ik.solve_all(robot, T, all_turns=True)
    assert one.complete and every.complete and (np.diff(every.distance) >= 0.0).all()
    wanted = {
        tuple(np.round(np.r_[q[:5], q[5] + 2 * np.pi * k], 6))
        for q in one.q for k in (-1, 0, 1) if abs(q[5] + 2 * np.pi * k) <= robot.upper[5]
    }  # fmt: skip
    assert len(wanted) > len(one) and {tuple(np.round(q, 6)) for q in every.q} == wanted
    assert max(robot.errors(q, T)[0] for q in every.q) < 1e-9
    few = ik.solve_all(robot, T, all_turns=True, count=1)
    assert len(few) == 1 and not few.complete and few.distance[0] == every.distance[0]
    assert "the 1 nearest are listed (count)" in few.message and "(count)" not in every.message
    with pytest.raises(InvalidOption, match="full turns inside the limits"):
        ik.solve_all(robot, T, all_turns=True, limits=False)
    with pytest.raises(InvalidOption, match="all_turns is True or False, not 'no'"):
        ik.solve_all(robot, T, all_turns="no")


@pytest.mark.parametrize(("end", "all_turns"), [(0.0, False), (2.0 * np.pi, True)])
def test_a_solution_on_a_limit_where_two_merge_is_listed(end, all_turns):
    """The straight elbow is a limit: rounding puts the two solutions that merge there on either side of it."""
    joints = [
        ("revolute", xyz, (0, 0, 0), axis, -2.9, end if k == 2 else 2.9)
        for k, (xyz, axis) in enumerate(
            [((0, 0, 0.1), (0, 0, 1)), ((0, 0.1, 0), (0, 1, 0)), ((0.4, 0, 0), (0, 1, 0)), ((0.4, 0, 0), (0, 1, 0)),
             ((0, 0.1, 0), (0, 0, 1)), ((0, 0, 0.1), (0, 1, 0))]
        )
    ]  # fmt: skip
    robot = drawn(joints, (0, 0.1, 0))
    rng, complete = np.random.default_rng(30), 0
    for _ in range(60):
        q = robot.random_q(rng)
        q[2] = end
        found = ik.solve_all(robot, robot.fk(q), all_turns=all_turns)
        if found.complete:
            complete += 1
            assert len(found) and np.abs(found.q - q).max(axis=1).min() < 1e-3
    assert complete > 20


def test_a_tolerance_below_rounding_is_refused():
    """No answer would keep it, so every target would be "proven" unreachable."""
    robot = robots.load("hydrolek_7w")
    for name in ("tolerance", "position_tolerance", "orientation_tolerance"):
        with pytest.raises(InvalidOption, match="tolerance must be finite and at least 1e-14, not 0"):
            ik.solve(robot, robot.fk(robot.home), **{name: 0})
    found = [ik.solve_batch(robot, robots.sample(robot, 60, seed=33)[1], tolerance=t) for t in (1e-14, 1e-13)]
    assert not any(batch.proven.any() for batch in found)


def test_an_answer_that_pinocchio_does_not_confirm_proves_nothing():
    """An arm of a hundred kilometres is computed to a hundredth of a micrometre, so most answers are not confirmed."""
    joints = [
        ("revolute", (4e4, 0, 3e4), (turn, 0, 0), (0, 0, 1), -2.9, 2.9) for turn in (0, 1.5, 0.4, -1.3, 1.5, -1.2)
    ]
    robot = drawn(joints, (0, 1e4, 0))
    results = [ik.solve(robot, robot.fk(q), tolerance=1e-11) for q in robot.random_q(np.random.default_rng(34), 40)]
    failed = [result for result in results if result.status == ik.Status.CHECK_FAILED]
    assert failed and not any(result.proven for result in results if not result.success)
    assert all("Pinocchio does not confirm it" in result.message for result in failed)


def test_without_limits_the_nearest_is_not_said_to_be_within_them():
    robot = robots.load("hydrolek_7w")
    far = robot.fk(robot.upper + 0.3)
    result = ik.solve(robot, far, closest=True, limits=False)
    assert result.proven and "the nearest of all solutions (certified" in result.message


def test_loose_tolerances_prove_nothing():
    robot = robots.load("hydrolek_7w")
    T = mixed(robot, 40, seed=31)
    tight, loose = (ik.solve_batch(robot, T, tolerance=x) for x in (1e-6, 2e-3))
    assert tight.proven.sum() > 10
    assert not (loose.proven & (loose.status != ik.Status.UNREACHABLE)).any()


@pytest.mark.parametrize("name", ["planar_2r", "locked", "inspection_7dof"])
def test_an_exact_closed_form_proves_its_noes_but_for_a_free_lift(name):
    robot, rng = robots.load(name), np.random.default_rng(31)
    low, high = np.where(robot.slides, robot.lower, -np.pi), np.where(robot.slides, robot.upper, np.pi)
    T = robot.chain.forward(rng.uniform(low, high, (80, robot.n)))[0]
    T[60:, 0, 3] += 9.0
    targets = T[:, :3, 3] if name == "planar_2r" else T
    batch, hard = ik.solve_batch(robot, targets), ik.solve_batch(robot, targets, "lm", restarts=400)
    blocked = batch.status == ik.Status.LIMIT_BLOCKED
    assert blocked.sum() > 5 and batch.proven[60:].all() and (batch.status[60:] == ik.Status.UNREACHABLE).all()
    assert (batch.proven[blocked] == (name != "inspection_7dof")).all() and not (batch.proven & hard.success).any()
    k = int(np.flatnonzero(blocked)[0])
    assert ik.solve(robot, targets[k]).proven == batch.proven[k]


@pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")
def test_what_a_search_says_after_a_closed_form_without_an_answer_is_no_proof():
    pytest.importorskip("eaik")
    robot, rng, blocked = robots.load("ur5"), np.random.default_rng(32), 0
    solver = ik.Solver(robot, "eaik", limits={"shoulder_lift_joint": (-0.3, 0.3)})
    for _ in range(12):
        found = solver(robot.fk(robot.random_q(rng)))
        if found.status == ik.Status.LIMIT_BLOCKED:
            blocked += 1
            assert not found.proven and found.solver == "lm" and "every branch" not in found.message
    assert blocked


def test_a_pose_that_only_another_weighing_of_the_errors_meets_is_not_proven_unreachable():
    """A micrometre beyond a fold the nearest pose misses the position tolerance, one with a larger turn meets both."""
    robot, T = ik.Robot.load("ur3"), np.eye(4)
    T[:3] = [
        [0.08206185840966945, 0.48549610287221073, -0.8703788746805882, 0.03928560117183227],
        [-0.9886384025926044, 0.15001057682046973, -0.009536024388243072, -0.02069709310723789],
        [0.12593633436579996, 0.8612725241977045, 0.4922902383235115, 0.26871627044341695],
    ]
    assert not ik.solve(robot, T).proven
    q0 = [
        4.533595416152678, -3.297650369726543, 2.5729325800096166, -0.5241857200729447, -3.687207504761397, -1.053630017,
    ]  # fmt: skip
    found = ik.solve(robot, T, "lm", q0=q0, restarts=1)  # its last descent ends at the pose that meets both
    assert found.success and max(robot.errors(found.q, T)) < 1e-6
