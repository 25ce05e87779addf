"""Paths of arms of six joints: what all solutions of every pose make certain."""

from itertools import pairwise

import numpy as np
import pytest
import robots
from scipy.interpolate import CubicSpline

import ik_toolkit as ik
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.motion.reference import interpolate_poses
from ik_toolkit.paths.exact_branches import every_solution
from ik_toolkit.paths.path_problem import STEP, TOLERANCE, Problem
from ik_toolkit.paths.path_search import Search
from ik_toolkit.paths.result import PathStatus


def motion(robot, rng, count):
    """Joint values (count, n) along a random curve between three configurations."""
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    points = [rng.uniform(low, high)]
    for _ in range(2):
        points.append(np.clip(points[-1] + rng.uniform(-1.2, 1.2, robot.n), low, high))
    a, middle, c = points
    s = np.linspace(0.0, 1.0, count)[:, None]
    return (1 - s) ** 2 * a + 2 * s * (1 - s) * middle + s * s * c


@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix", *(["ur5"] if robots.have_data() else [])])
def test_a_motion_of_the_arm_itself_is_followed_in_one_piece(name):
    robot, rng = robots.load(name), np.random.default_rng(5)
    for k in range(7 if name == "ur5" else 2):
        Q = motion(robot, rng, 60)
        # These pass singular poses, beside which poses in between are out of reach.
        if name == "ur5" and k not in (2, 6):
            continue
        made = ik.solve_path(robot, np.array([robot.fk(q).homogeneous for q in Q]))
        assert made.status == PathStatus.FOLLOWED and made.lower_bound == 0


@pytest.mark.skipif(not robots.have_data(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("seed", [6, 135])
def test_a_motion_through_singular_poses_is_followed(seed):
    """Poses interpolated beside a singular pose are out of reach, and the nearest solution beyond it may be on another branch."""
    robot, rng = robots.load("ur5"), np.random.default_rng([1, seed])
    points, s = robot.random_q(rng, 4), np.linspace(0.0, 1.0, 2001)[:, None]

    def curve(s):
        return np.hstack([(1 - s) ** 3, 3 * s * (1 - s) ** 2, 3 * s * s * (1 - s), s**3]) @ points

    way = np.append(0.0, np.cumsum(np.abs(np.diff(curve(s), axis=0)).max(axis=1))) / np.radians(2.0)
    at = np.interp(np.linspace(0.0, way[-1], int(np.ceil(way[-1])) + 1), way, s[:, 0])[:, None]
    made = ik.solve_path(robot, np.array([robot.fk(q).homogeneous for q in curve(at)]), seed=seed)
    assert made.status == PathStatus.FOLLOWED


def fewest(layers):
    """Fewest reconfigurations through layers of solutions (K, n) whose joints move by at most 7 degrees; None if one is empty."""
    counts = np.zeros(len(layers[0]), dtype=int)
    for before, layer in pairwise(layers):
        if not len(layer):
            return None
        gap = layer[:, None] - before
        gap -= 2 * np.pi * np.rint(gap / (2 * np.pi))  # the joints with more than a full turn have no limits
        near = (np.abs(gap) <= np.radians(7.0)).all(axis=2)
        counts = np.array([min([counts.min() + 1, *counts[row]]) for row in near])
    return int(counts.min())


def test_what_is_called_the_fewest_is():
    robot, rng, proven = robots.load("continuous_mix"), np.random.default_rng(3), 0
    solver = ik.Solver(robot)
    while proven < 2:
        a = robot.random_q(rng)
        ends = [robot.fk(q).homogeneous for q in (a, a + rng.uniform(-1.5, 1.5, 6))]
        T, fine = (
            interpolate_poses(np.array(ends)[:, None], np.linspace(0, 1, n), (KIND.pose,))[:, 0] for n in (60, 591)
        )
        if not ik.solve_batch(robot, T).success.all():
            continue
        made = ik.solve_path(robot, T)
        if made.status != PathStatus.RECONFIGURES or made.lower_bound is None:
            continue
        least = fewest([solver.all(x).q for x in fine])
        assert made.lower_bound == len(made.reconfigurations) and "provably the fewest" in made.message
        proven += 1
        assert least is None or made.lower_bound <= least


def test_a_track_that_ends_early_has_no_reason():
    """A continuation that gives up must not be taken for the end of a branch."""
    robot, rng = robots.load("continuous_mix"), np.random.default_rng(7)
    T = np.array([robot.fk(q).homogeneous for q in motion(robot, rng, 60)])
    problem = Problem(ik.Solver(robot), T, (KIND.pose,), STEP, TOLERANCE)
    search = Search(problem, None, None, None, 1, 0, lambda *_: None)
    search.run()
    tracks = search.tracks

    def beside(poses):
        """Solutions that go on where tracks end, a full turn away."""
        rows = [tracks.Q[t, k] + 2 * np.pi for k, span in enumerate(tracks.span) for t in span]
        return np.repeat(np.array(rows)[None] * robot.chain.unit, len(poses), axis=0), np.ones(len(poses), bool)

    def sound():
        return tracks.end_with_reason(lambda poses: every_solution(problem.single, poses))

    whole = int(np.argmax(np.diff(tracks.span, axis=1)))
    assert (tracks.span != [0, 59]).any() and sound()  # limits and folds end some
    assert not tracks.end_with_reason(beside)
    tracks.span[whole, 1] -= 5
    assert not sound()


def test_poses_that_are_reached_alone_are_reached_on_a_path():
    """Poses of an arm of five joints, of which none leads to the next, in turn with poses that it does not reach."""
    robot = robots.load("so101")
    T = robots.sample(robot, 60)[1]
    T[1::2, :3, :3] = T[::2, :3, :3]
    alone = ik.solve_batch(robot, T)
    lost = [pose.index for pose in ik.solve_path(robot, T).unreachable]
    assert lost == np.flatnonzero(~alone.success).tolist()


@pytest.mark.parametrize("seed", [8, 9])
def test_a_motion_of_a_redundant_arm_is_followed_in_one_piece(seed):
    """Six joints and positions: where the first solutions do not lead along the whole path, others are searched for."""
    robot, s = robots.few_joints(6, seed), np.linspace(0.0, 1.0, 5)
    knots = robot.random_q(np.random.default_rng(seed), 5)
    Q = np.clip(CubicSpline(s, knots, bc_type="clamped")(np.linspace(0.0, 1.0, 100)), robot.lower, robot.upper)
    positions = [robot.fk(q).translation for q in Q]
    made = ik.solve_path(robot, positions, q0=Q[0], path_tolerance=(0.05, 0.3))
    assert made.status == PathStatus.FOLLOWED
