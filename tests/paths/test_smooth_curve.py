"""Poses are samples of a motion: how many of them describe it changes neither its time nor its smoothness much."""

import itertools
import re

import motions
import numpy as np
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.paths import timing
from ik_toolkit.paths.smooth_curve import corners, sagittas

pytest.importorskip("toppra")


def circle(u):
    return 0.08 * np.stack([np.cos(2 * np.pi * u) - 1.0, np.sin(2 * np.pi * u)], axis=1)


def wave(u):
    return np.stack([0.12 * u, 0.06 * np.sin(2 * np.pi * u)], axis=1)


def rounded(u, width=0.1, height=0.06, radius=0.02):
    """A rectangle with rounded corners, at shares u of its length."""
    points = []
    for x, y, first in ((1, 1, 0), (-1, 1, 90), (-1, -1, 180), (1, -1, 270)):
        angle = np.radians(np.linspace(first, first + 90, 200))
        centre = np.array([x * (width / 2 - radius), y * (height / 2 - radius)])
        points.append(centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    way = np.vstack([*points, points[0][:1]])
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1)))
    return np.stack([np.interp(u * length[-1], length, way[:, k]) for k in (0, 1)], axis=1) - way[0]


def poses(robot, shape, count):
    aside = shape(np.linspace(0.0, 1.0, count))
    return motions.moved(robot.fk(robot.home).homogeneous, np.column_stack([np.zeros(count), aside]))


def shaken(trajectory):
    """Total change of the joint accelerations: grows where a motion shakes."""
    return np.abs(np.diff(trajectory.at(np.linspace(0.0, trajectory.duration, 4000))[2], axis=0)).sum()


@pytest.mark.parametrize(("shape", "counts"), [(circle, (12, 20, 40)), (wave, (24, 40)), (rounded, (48,))])
def test_few_poses_take_as_long_as_many_and_shake_no_more(shape, counts):
    robot = motions.load("hydrolek_7w")
    many = ik.solve_path(robot, poses(robot, shape, 120), q0=robot.home).retime(acceleration=1.0)
    for count in counts:
        path = ik.solve_path(robot, poses(robot, shape, count), q0=robot.home)
        made = path.retime(acceleration=1.0)
        assert made.success and not made.stops and len(made.pieces) == 1
        assert made.duration < 1.1 * many.duration and shaken(made) < 1.5 * shaken(many)
        assert (made.deviation <= np.maximum(path.path_tolerance, sagittas(path.targets, path.kinds).max(axis=1))).all()
        told = ik.solve_path(robot, poses(robot, shape, count), q0=robot.home, path_tolerance=(2e-4, 0.01))
        kept = told.retime(acceleration=1.0)
        assert kept.success and kept.deviation[0] <= 2e-4 and kept.deviation[1] <= 0.01


def test_an_arc_leaves_its_chords_by_their_sagitta_and_a_corner_by_nothing():
    T = np.tile(np.eye(4), (13, 1, 1, 1))
    T[:, 0, :2, 3] = circle(np.linspace(0.0, 1.0, 13))
    exact = 0.08 * (1.0 - np.cos(np.pi / 12))
    found = sagittas(T, (0,))
    assert not corners(T, (0,)).any() and ((found[0] > exact) & (found[0] < 1.3 * exact)).all() and not found[1].any()
    T[:, 0, :2, 3] = np.vstack([np.linspace([0, 0], [1, 0], 7), np.linspace([1, 0.1], [1, 1], 6)])
    assert np.flatnonzero(corners(T, (0,))).tolist() == [6] and np.abs(sagittas(T, (0,))[0][5:7]).max() < 0.02


def test_a_corner_too_sharp_for_the_tolerance_is_a_stop_that_is_told():
    robot = motions.load("hydrolek_7w")
    T = poses(robot, lambda u: np.stack([np.minimum(0.2 * u, 0.1), np.maximum(0.2 * u - 0.1, 0.0)], axis=1), 5)
    path = ik.solve_path(robot, T, q0=robot.home)
    assert path.retime(acceleration=1.0).stops == ()
    made = path.retime(acceleration=1.0, path_tolerance=(2e-6, 1e-5))
    if made.stops:
        assert 2.0 in made.stops and "it stops at pose" in made.message
    ends = np.cumsum([piece.duration for piece in made.pieces])
    assert np.abs(made.at(ends)[1]).max() < 1e-6


@pytest.mark.parametrize("count", [12, 24])
def test_the_tip_keeps_its_speed_where_limits_allow(count):
    robot, asked = motions.load("hydrolek_7w"), 0.05
    path = ik.solve_path(robot, poses(robot, circle, count), q0=robot.home)
    made = path.retime(acceleration=1.0, tip_speed=asked)
    t = np.linspace(0.0, made.duration, 2000)
    points = np.array([robot.fk(q).translation for q in made.at(t)[0]])
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / np.diff(t)
    assert speed.max() < 1.01 * asked and f"the tip keeps {asked:g} m/s except from pose 0 to" in made.message
    # from rest and to rest
    assert [(a == 0.0, b == count - 1) for a, b in made.slower] == [(True, False), (False, True)]
    place = np.interp(0.5 * (t[1:] + t[:-1]), made.t, made.place)
    for a, b in made.slower:
        place[(place >= a) & (place <= b)] = np.nan
    assert (speed[np.isfinite(place)] > 0.98 * asked).all() and np.isfinite(place).mean() > 0.9
    fast = path.retime(acceleration=1.0, tip_speed=10.0)
    free = path.retime(acceleration=1.0, tip_speed=1e3)  # on the same grid of the time law
    assert abs(fast.duration / free.duration - 1.0) < 1e-3 and len(fast.slower) == 1
    assert "the limits allow the tip" in fast.message and "at most, not 10 m/s" in fast.message


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("acceleration", [0.05, 1.0])
def test_a_sharp_corner_slows_the_tip_down_only_near_it(seed, acceleration):
    """Two straight joint motions with a corner between them: elsewhere either a limit or the tip speed is reached."""
    robot, asked, rng = motions.load("hydrolek_7w"), 0.05, np.random.default_rng(seed)
    a, b, c = robot.lower + (robot.upper - robot.lower) * (0.3 + 0.4 * rng.random((3, robot.n)))
    Q = np.concatenate([np.linspace(a, b, 60), np.linspace(b, c, 60)[1:]])
    made = ik.solve_path(robot, [robot.fk(q) for q in Q], q0=a).retime(acceleration=acceleration, tip_speed=asked)
    t = np.linspace(0.0, made.duration, 4000)
    q, _, ddq = made.at(t)
    speed = np.linalg.norm(np.diff([robot.fk(one).translation for one in q], axis=0), axis=1) / np.diff(t)
    used = np.abs(ddq).max(axis=1)[1:] / acceleration
    assert speed.max() < 1.002 * asked and used.max() < 1.0 + 1e-6
    near = np.abs(np.interp(t[1:], made.t, made.place) - 59.0) < 5.0
    assert (np.maximum(speed / asked, used)[~near] < 0.97).mean() < 0.005


@pytest.mark.parametrize("at", [0, 5, 24])
def test_a_pose_that_repeats_is_no_stop(at):
    robot = motions.load("hydrolek_7w")
    T = poses(robot, circle, 25)
    plain, repeated = (
        ik.solve_path(robot, one, q0=robot.home).retime(acceleration=1.0, tip_speed=0.05)
        for one in (T, np.insert(T, at, T[at], axis=0))
    )
    assert repeated.stops == () and abs(repeated.duration / plain.duration - 1.0) < 1e-6
    assert repeated.place[-1] == 25.0 and "all 26 poses" in repeated.message
    # No sample lies between the two equal poses.
    np.testing.assert_allclose(repeated.place[1:-1], plain.place[1:-1] + (plain.place[1:-1] > at), atol=1e-5)


def test_a_place_beyond_ten_thousand_poses_is_told_exactly():
    robot = motions.load("planar_2r")
    q = np.repeat(motions.wave(robot, 20), [1] * 10 + [12_331] + [1] * 9, axis=0)  # the robot stands still at one pose
    made = motions.as_result(robot, q).retime(1.0, 1.0, tip_speed=0.05)
    assert made.slower[-1][1] == 12_349.0
    assert re.search(r" (1234\d(\.\d)?) to 12349$", made.message), made.message


def test_a_tolerance_is_kept_that_is_less_than_the_path_keeps_itself():
    robot = motions.load("hydrolek_7w")
    path = ik.solve_path(robot, poses(robot, circle, 12), q0=robot.home)
    assert path.deviation[0] > 2e-5
    made = path.retime(acceleration=1.0, path_tolerance=(2e-5, 1e-3))
    assert made.deviation[0] <= 2e-5 and not made.stops and "chords" not in made.message
    with pytest.raises(InvalidOption, match="path_tolerance must be above position_tolerance, 1e-06 m"):
        path.retime(acceleration=1.0, path_tolerance=(1e-6, 1e-3))


def test_one_place_without_a_smooth_curve_costs_few_stops(monkeypatch):
    robot, smooth = motions.load("hydrolek_7w"), timing.smooth_curve
    path = ik.solve_path(robot, poses(robot, circle, 33), q0=robot.home)
    bad = 2 * len(path.curve) // 3
    monkeypatch.setattr(timing, "smooth_curve", lambda *a: None if a[3].start <= bad < a[3].stop - 1 else smooth(*a))
    made = path.retime(acceleration=1.0)
    assert 2 <= len(made.stops) <= 2 * np.log2(len(path.curve)) and "stops at pose" in made.message


@pytest.mark.parametrize("seed", [103, 106])
def test_the_tip_keeps_its_speed_between_the_grid_points(seed):
    """Held to the speed at the points of its grid alone, the time law would exceed it by a quarter between them."""
    robot, rng = motions.load("planar_2r"), np.random.default_rng(seed)
    low, high = np.clip(robot.lower, -3.0, 3.0), np.clip(robot.upper, -3.0, 3.0)
    corners_at = low + (high - low) * (0.3 + 0.4 * rng.random((int(rng.integers(2, 5)), 2)))
    count = int(rng.integers(2, 25))
    Q = np.concatenate([np.linspace(a, b, count) for a, b in itertools.pairwise(corners_at)])
    path = ik.solve_path(robot, robot.chain.forward(Q)[0], q0=Q[0])
    asked = rng.uniform(0.01, 0.5)
    made = path.retime(velocity=1.0, acceleration=rng.uniform(1.0, 50.0), tip_speed=asked)
    t = np.linspace(0.0, made.duration, 20_000)
    xyz = robot.chain.forward(made.at(t)[0])[0][:, :3, 3]
    assert np.linalg.norm(np.diff(xyz, axis=0), axis=1).max() / (t[1] - t[0]) < 1.005 * asked


def test_the_tip_is_as_fast_as_asked_as_soon_as_the_acceleration_allows():
    robot = motions.load("hydrolek_7w")
    path = ik.solve_path(robot, poses(robot, circle, 25), q0=robot.home)
    for acceleration in (0.2, 20.0):
        made = path.retime(acceleration=acceleration, tip_speed=0.01)
        t = np.linspace(0.0, made.duration, 20001)
        assert np.abs(made.at(t)[2]).max() > 0.95 * acceleration
        (_, begun), (ends, _) = made.slower
        assert max(begun, 24.0 - ends) < 0.02 / acceleration


def test_the_tip_keeps_its_speed_where_the_robot_stops_at_every_pose(monkeypatch):
    monkeypatch.setattr("ik_toolkit.paths.timing.smooth_curve", lambda *_: None)
    robot, asked = motions.load("inspection_7dof"), 0.2
    Q = np.linspace(robot.home, np.clip(robot.home + 0.4, robot.lower, robot.upper), 4)
    path = ik.solve_path(robot, [robot.fk(q) for q in Q], q0=Q[0])
    made = path.retime(velocity=1.0, acceleration=5.0, tip_speed=asked)
    assert len(made.stops) >= 2
    t = np.linspace(0.0, made.duration, 4000)
    speed = np.linalg.norm(np.diff([robot.fk(q).translation for q in made.at(t)[0]], axis=0), axis=1) / np.diff(t)
    assert 0.98 * asked < speed.max() < 1.002 * asked
