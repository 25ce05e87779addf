"""Where a robot should stand: as good as planted and random bases, true counts, obstacles, ranges, paths, helpful errors."""

import json
from dataclasses import replace

import numpy as np
import pytest
import robots
import second_fk
from folders import csv_rows

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidOption, InvalidTarget
from ik_toolkit.study import place_search
from ik_toolkit.study.place import PlaceInterrupted


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Search less than a person would want, so that tests are fast."""
    less = dict(samples=60_000, spread=300, last=280, keep=4, around=8, rounds=2, voted=100)
    monkeypatch.setattr(place_search, "SEARCH", place_search.SEARCH._replace(**less))


def moved(x, y, yaw, height=0.0):
    return place_search.base_poses(np.array([[x, y, yaw, height]]))[0]


def sheet(robot, G=None, count=20):
    """Poses of a cut that the arm reaches from the base pose G."""
    middle, T = 0.5 * (robot.lower + robot.upper), np.tile(np.eye(4), (count, 1, 1))
    T[:] = robot.fk(middle).homogeneous
    T[:, 2, 3] += np.linspace(-0.15, 0.15, count)
    T[:, 1, 3] += 0.1 * np.sin(np.linspace(0.0, 6.0, count))
    return (moved(1.5, -2.0, 2.1) if G is None else G) @ T


@pytest.fixture(scope="module")
def hydrolek():
    return robots.load("hydrolek_7w")


def test_places_reach_what_they_say_and_no_random_base_reaches_more(hydrolek):
    W = sheet(hydrolek)
    found = ik.place(hydrolek, W, count=3)
    best = found[0]
    assert str(best) == repr(best) and "\n" not in str(best) and best.counts in str(best)
    assert len(found) == 3 and [one.count for one in found] == sorted((one.count for one in found), reverse=True)
    assert best.count >= 18
    fk = second_fk.SecondFK(hydrolek.urdf, hydrolek.base, hydrolek.tip)
    for one in found:
        T = one.T_world_base @ fk.fk(one.q[one.reached], hydrolek.joint_names)
        assert np.abs(T - W[one.reached]).max() < 3e-6 and np.isnan(one.q[~one.reached]).all()
        assert np.allclose(one.T_world_base, moved(one.x, one.y, one.yaw, one.height))
        assert 0.0 <= one.margin <= 1.0 and one.manipulability > 0.0 and np.isnan(one.clearance)
    rng = np.random.default_rng(0)
    low, high = W[:, :2, 3].min(axis=0) - hydrolek.reach, W[:, :2, 3].max(axis=0) + hydrolek.reach
    bases = np.column_stack([rng.uniform(low, high, (200, 2)), rng.uniform(-np.pi, np.pi, 200), np.zeros(200)])
    T = place_search.in_base(bases, W).reshape(-1, 4, 4)
    counts = ik.solve_batch(hydrolek, T, restarts=3).success.reshape(200, 20).sum(axis=1)
    assert best.count >= counts.max()
    assert "of 20" in repr(found)
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["placements"][0]["count"] == best.count


def test_the_votes_of_the_inverse_map_find_the_region(hydrolek, monkeypatch):
    """Without bases spread over the floor the votes alone lead to the poses."""
    monkeypatch.setattr(place_search.Candidates, "spread", lambda *_: np.empty((0, 4)))
    assert ik.place(hydrolek, sheet(hydrolek, count=60), count=1)[0].count >= 55


def test_a_wide_region_takes_no_more_memory_than_the_poses_need(hydrolek, monkeypatch):
    """Votes are counted only where a base reaches a pose, and the candidates are those of the whole region."""
    W = sheet(hydrolek)
    monkeypatch.setattr(place_search, "memory_allowed", lambda: 1e8)
    study = place_search.Candidates(
        hydrolek, {"tool": W}, (np.array([-500, -500, -3.2, 0]), np.array([500, 500, 3.2, 0])), None, {"seed": 0}, None
    )
    bases = study.votes()
    assert len(bases) > 50
    assert np.linalg.norm(bases[:, :2] - W[:, :2, 3].mean(axis=0), axis=1).max() < 1.5 * hydrolek.reach


def test_positions_regions_yaw_and_height_are_kept(hydrolek):
    W = sheet(hydrolek, moved(0.0, 0.0, 0.0, 0.4))
    at = W[:, :3, 3]
    found = ik.place(hydrolek, at, ((-1.0, -0.5), (0.5, 0.6)), yaw=(-0.4, 0.3), height=(0.3, 0.5))
    assert found[0].count == 20
    for one in found:
        assert -1.0 <= one.x <= 0.5 and -0.5 <= one.y <= 0.6 and -0.4 <= one.yaw <= 0.3 and 0.3 <= one.height <= 0.5
    found = ik.place(hydrolek, W, ((-0.3, -0.3), (0.3, 0.3)), yaw=0.0, height=0.4, count=1)
    assert " 1 place to stand" in str(found)
    fixed = found[0]
    assert fixed.yaw == 0.0 and fixed.height == 0.4 and fixed.count >= 18


def test_obstacles_of_the_scene_count(hydrolek):
    W = sheet(hydrolek, np.eye(4), 15)
    where, asked = ((-0.1, 0.1), (0.1, 0.3)), {"yaw": 0.3, "count": 1}
    scene = ik.CollisionModel(hydrolek).add_box((0.15, 0.6, 0.4), W[7, :3, 3] - (0.25, 0.0, 0.0), name="wall")
    before = [T.copy() for _, _, T in scene.placed()]
    among = ik.place(hydrolek, W, where, avoid_collisions=scene, **asked)
    free, beside = ik.place(hydrolek, W, where, **asked)[0], among[0]
    local = (among.obstacles - before[0][:3, 3]) @ before[0][:3, :3]
    assert np.allclose(np.abs(local), 0.5 * np.array([0.15, 0.6, 0.4])) and ik.plot(among).axes
    assert 0 < beside.count < free.count and beside.clearance > 0.0
    assert abs(len(W) * among.shares.max() - beside.count) < 1.5  # as many as the few attempts of the search reach
    judge = ik.CollisionModel(hydrolek).add_box((0.15, 0.6, 0.4), np.linalg.inv(beside.T_world_base) @ before[0])
    assert not any(judge.collides(q) for q in beside.q[beside.reached])
    # the caller's is untouched
    assert all((T == old).all() for (_, _, T), old in zip(scene.placed(), before, strict=True))


def test_ordered_poses_are_followed(hydrolek):
    W = sheet(hydrolek, count=10)
    found = ik.place(hydrolek, W, ordered=True, count=2)
    path = found[0].path
    assert path is not None and len(path.q) >= found[0].count == 10
    assert path.success
    assert replace(found[0], path=None).rank < found[0].rank  # a place from which no path was searched comes later


def test_narrowed_limits_hold_beside_obstacles(hydrolek):
    """Also where the robot has narrowed limits of its own, and starts outside the limits are refused."""
    W, name = sheet(hydrolek, np.eye(4), 6), hydrolek.joint_names[0]
    scene = ik.CollisionModel(hydrolek).add_box((0.15, 0.6, 0.4), W[3, :3, 3] - (0.35, 0.0, 0.0))
    for robot, limits in ((hydrolek, (-0.2, 0.3)), (hydrolek.narrowed({name: (-0.3, 0.3)}), (-0.2, 0.2))):
        asked = dict(yaw=(-0.5, 0.5), count=1, limits={name: limits}, q0_outside="refuse", avoid_collisions=scene)
        best = ik.place(robot, W, ((-0.2, -0.2), (0.2, 0.2)), **asked)[0]
        q = best.q[best.reached, 0]
        assert best.count > 0 and limits[0] <= q.min() and q.max() <= limits[1]


def test_ctrl_c_keeps_the_best_so_far(hydrolek, monkeypatch):
    def stop(done):
        if done > 500:
            raise KeyboardInterrupt

    with pytest.raises(PlaceInterrupted) as interrupt:
        ik.place(hydrolek, sheet(hydrolek), progress=stop)
    assert interrupt.value.result[0].count > 0
    monkeypatch.setattr("ik_toolkit.paths.solve_path.solve_path", lambda *_, **__: stop(np.inf))
    with pytest.raises(PlaceInterrupted) as interrupt:
        ik.place(hydrolek, sheet(hydrolek, count=10), ordered=True, count=1)
    assert interrupt.value.result[0].count == 10 and interrupt.value.result[0].path is None


def test_mistakes_are_named(hydrolek):
    W = sheet(hydrolek)
    for error, words, poses, arguments in (
        (InvalidTarget, "poses", np.zeros((0, 3)), {}),
        (InvalidTarget, "finite|NaN", np.full((2, 3), np.nan), {}),
        (InvalidOption, "floor", W, {"where": "roof"}),
        (InvalidOption, "lower first", W, {"where": ((1, 1), (0, 0))}),
        (InvalidOption, "yaw", W, {"yaw": np.nan}),
        (InvalidOption, "were degrees meant", W, {"yaw": 90}),
        (InvalidOption, "height", W, {"height": (2, 1)}),
        (InvalidOption, "count", W, {"count": 0}),
        (InvalidOption, "restarts", W, {"restarts": 5}),
        (InvalidOption, "omit closest", W, {"closest": True}),
        (InvalidOption, "omit follow", W, {"follow": True}),
        (InvalidOption, "position is not kept", W, {"priority": "orientation"}),
        (InvalidTarget, "were millimetres meant", W * np.array([[1.0] * 3 + [1e6]] * 3 + [[1.0] * 4]), {}),
        (InvalidOption, "tolerance", W, {"tolerence": 5}),
    ):
        with pytest.raises(error, match=words):
            ik.place(hydrolek, poses, **arguments)
    with pytest.raises(InvalidOption, match="on_base"):
        ik.place(ik.Robot.load("hydrolek_7w", on_base=np.eye(4)), W)


def test_a_rail_is_placed_as_the_base_of_the_arm_on_it():
    """Poses three metres long are not reached from one place, but are along a rail."""
    arm, rail = ik.Robot.load("ur5"), ik.Robot.load("ur5", on_base="rail", base_limits=(0.0, 3.0))
    W = np.tile(arm.fk([0.3, -1.2, 1.4, -1.8, -1.5, 0.2]).homogeneous, (30, 1, 1))
    W[:, 0, 3] += np.linspace(0.0, 3.0, 30)
    fixed, moving = (ik.place(one, W, count=1)[0] for one in (arm, rail))
    assert fixed.count < 30 and moving.count == 30
    seen = np.linalg.inv(moving.T_world_base) @ W
    assert ik.solve_batch(rail, seen).success.all()


def test_each_arm_of_a_tree_reaches_its_own_poses_from_one_base(run, refused, tmp_path, monkeypatch):
    """The place of a machine with two arms, one with poses and one with positions, judged tip by tip; and the command."""
    brokk, G = ik.Tree.load("brokk_hydrolek"), moved(1.5, -2.0, 2.1)
    T = {tip: G @ pose.homogeneous for tip, pose in brokk.fk(brokk.home).items()}
    W = {
        "right_tip": T["right_tip"][None, :3, 3] + np.linspace(0.0, 0.1, 4)[:, None],
        "left_tip": np.tile(T["left_tip"], (6, 1, 1)),
    }
    W["left_tip"][:, 2, 3] += np.linspace(-0.1, 0.1, 6)
    where, yaw = ((1.3, -2.2), (1.7, -1.8)), (1.8, 2.4)
    found = ik.place(brokk, W, where, yaw=yaw, count=2)
    best = found[0]
    assert best.count == 10 and best.counts == "left_tip 6 of 6, right_tip 4 of 4" and best.q.shape == (10, 13)
    assert best.counts in repr(found) and found.to_dict()["tips"] == best.tips.tolist() and ik.plot(found).axes
    for tip in brokk.tips:
        fk = second_fk.SecondFK(brokk.urdf, brokk.base, tip)
        at = best.T_world_base @ fk.fk(best.q[best.tips == tip], brokk.joint_names)
        assert np.abs((at if W[tip].ndim == 3 else at[:, :3, 3]) - W[tip]).max() < 3e-6
    wall = ik.CollisionModel(brokk).add_box(
        (0.1, 2.0, 2.0), G @ [[1, 0, 0, -1.0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    )
    beside = ik.place(brokk, W, where, yaw=yaw, count=1, avoid_collisions=wall)[0]
    assert beside.count > 0 and beside.clearance > 0.0
    for error, words, poses, more in (
        (InvalidTarget, "dict by tip: left_tip, right_tip", W["left_tip"], {}),
        (FrameNotFound, "mean 'left_tip'", {"left_tp": W["left_tip"]}, {}),
        (InvalidTarget, "of right_tip must be finite", W | {"right_tip": np.full((1, 3), np.nan)}, {}),
        (InvalidTarget, "at least one of left_tip", {}, {}),
        (InvalidOption, "followed by one tip", W, {"ordered": True}),
    ):
        with pytest.raises(error, match=words):
            ik.place(brokk, poses, **more)
    monkeypatch.chdir(tmp_path)
    for tip in brokk.tips:
        np.savez(f"{tip}.npz", targets=W[tip])
    given = ["--poses", "left_tip:left_tip.npz", "--poses", "right_tip:right_tip.npz"]
    code, out, _ = run("place", "brokk_hydrolek", *given, "--where", 1.3, -2.2, 1.7, -1.8, "-n", 1)
    assert code == 0 and best.counts in " ".join(out.split())
    for wrong in ([*given[:2], "--poses", "right_tip.npz"], [*given, "--tip", "left_tip"], given[:2] * 2):
        refused("place", "brokk_hydrolek", *wrong)


def test_the_command(run, refused, hydrolek, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("cuts.npz", targets=sheet(hydrolek))
    asked = ["place", "hydrolek_7w", "--poses", "cuts.npz"]
    code, out, _ = run(*asked, "-n", 2, "-o", "places.csv", "--plot", "floor.png")
    assert code == 0 and "of 20" in out and (tmp_path / "floor.png").stat().st_size > 10_000
    rows = csv_rows("places.csv")
    assert len(rows) == 2 and float(rows[0]["count"]) >= 18
    assert run(*asked, "--where", 50, 50, 51, 51)[0] == 1
    refused(*asked, "--yaw", "1 2 3")
