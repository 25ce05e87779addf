"""Distances between parts: against coal on the exact shapes, bounds on their rates, half-planes, and free motions."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from braking import brake
from robots import BALLS_MIMIC, ball, branches, filled, have_data, joint, load, tie

import ik_toolkit as ik
from ik_toolkit.kernel.clearance import BrakingPath, Separation, along, free_until
from ik_toolkit.robot.geometry.distance import APART, CORNERS, NEARBY, Clearance

ROBOTS = ["hydrolek_7w", "mimic", "two_arms", *(["panda", "ur5"] if have_data() else [])]


def model_of(name):
    """A robot with shapes, and things around it where it passes."""
    robot = ik.Robot.load(BALLS_MIMIC) if name == "mimic" else load(name)
    model, rng = ik.CollisionModel(robot), np.random.default_rng(4)
    q = robot.random_q(rng)
    for arm, place in zip(robot.arms, robot.places, strict=True):
        at = arm.fk(q[place]).translation
        model.add_box((0.2, 0.3, 0.1), ik.pose(1.3 * at, rpy=(0.3, 0.2, 0.1)))
        model.add_cylinder(0.1, 0.4, ik.pose(1.2 * at + np.array([0.1, 0.3, 0.1]), rpy=(0.5, 0.2, 0.1)))
        model.add_sphere(0.1, at - np.array([0.3, 0.2, 0.1]))
    return model


def exact(model, q):
    """Smallest distance of each pair of names at q by coal, on the shapes as they were read."""
    robot, shapes = model.robot, model.geometry
    found = shapes.createData()
    pin.computeDistances(robot.model, robot.model.createData(), shapes, found, robot.to_pinocchio(q))
    out = {}
    for pair, result in zip(shapes.collisionPairs, found.distanceResults, strict=True):
        name = (model._names[pair.first], model._names[pair.second])
        out[name] = min(out.get(name, np.inf), result.min_distance)
    return out


def test_a_distance_depends_on_no_earlier_one():
    model = ik.CollisionModel(load("hydrolek_7w"))
    Q = model.robot.random_q(np.random.default_rng(0), 20)
    first, again = [repr(model.distances(q)) for q in Q], [repr(model.distances(q)) for q in Q[::-1]]
    assert first == again[::-1]


@pytest.mark.parametrize("name", ROBOTS)
def test_distances_are_those_of_hulls(name):
    model, rng = model_of(name), np.random.default_rng(1)
    for q in [model.robot.random_q(rng) for _ in range(4)]:
        found = model.distances(q)
        assert [near.distance for near in found] == sorted(near.distance for near in found)
        least = {}
        for near in found:
            least[near.pair] = min(least.get(near.pair, np.inf), near.distance)
            if near.distance > 1e-3:
                first, second = near.points
                assert np.allclose(second - first, near.distance * near.normal, atol=1e-5)
        expected = exact(model, q)
        assert least.keys() == expected.keys()
        for pair, d in least.items():
            assert d <= expected[pair] + 1e-5 and (d > 0.0) >= (expected[pair] > 1e-5)
            if name not in ("panda", "ur5"):  # no meshes: nothing is rounded off
                assert d == pytest.approx(expected[pair], abs=1e-5) or d <= 0.0 >= expected[pair]
        close = model.distances(q, within=0.2)
        assert [near.pair for near in close] == [near.pair for near in found if near.distance < 0.2]


def trough(width=1.0):
    """A mesh shaped like a U along y, its floor at z = 0 and its walls at x = -width and width, 1 m high."""
    x = np.array([-width, -width, width, width, -width - 0.01, -width - 0.01, width + 0.01, width + 0.01])
    z = np.array([1.0, 0.0, 0.0, 1.0, 1.0, -0.01, -0.01, 1.0])
    points = [(a, y, b) for y in (-1.0, 1.0) for a, b in zip(x, z, strict=True)]
    faces = [f for k in (0, 1, 2, 4, 5, 6) for f in ((k, k + 1, k + 8), (k + 1, k + 9, k + 8))]
    lines = "".join("v {} {} {}\n".format(*p) for p in points)
    return lines + "".join("f {} {} {}\n".format(*(i + 1 for i in f)) for f in faces)


def test_what_stands_in_a_hollow_is_measured_exactly(tmp_path):
    """Inside the hull of a U-shaped mesh the mesh itself counts; from outside the hull does, which is never further away."""
    (tmp_path / "u.obj").write_text(trough())
    robot = load("planar_2r")
    q = robot.home
    z = ik.CollisionModel(robot).geometry.geometryObjects[-1].placement.translation[2]
    tip = robot.fk(q).translation
    model = ik.CollisionModel(robot).add_mesh(tmp_path / "u.obj", tip - np.array([0.0, 0.0, 0.5]), name="trough")
    assert not model.collides(q)
    pairs = {near.pair: near.distance for near in model.distances(q)}
    assert pairs["link_2", "trough"] == pytest.approx(exact(model, q)["link_2", "trough"], abs=1e-6) and z < 0.5
    over = ik.CollisionModel(robot).add_mesh(tmp_path / "u.obj", tip + np.array([0.0, 0.0, 1.5]), name="trough")
    assert {near.pair: near.distance for near in over.distances(q)}["link_2", "trough"] > 1.0


def test_a_flat_mesh_has_no_hull_and_does_no_harm(tmp_path):
    (tmp_path / "sheet.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3\nf 1 3 4\n")
    robot = load("planar_2r")
    model = ik.CollisionModel(robot).add_mesh(tmp_path / "sheet.obj", (1.0, 0.0, 0.7), name="sheet")
    near = next(near for near in model.distances(robot.home) if "sheet" in near.pair)
    assert near.distance == pytest.approx(exact(model, robot.home)[near.pair], abs=1e-6) and near.distance > 0.1


@pytest.mark.parametrize("shape", ["cylinder", "cone"])
def test_a_mesh_with_many_corners_around_a_face(tmp_path, shape):
    """coal refuses hulls with more than 255 neighbours of a point: a disc divided from one of its corners, a cone's tip."""
    turn, corners = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False), range(300)
    ring = np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), 0.0 * turn])
    ends = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]
    points = np.vstack([ring, ring + ends[1], ends]) if shape == "cylinder" else np.vstack([ring, ends])
    top, low = len(points) - 1, len(points) - 2
    sides = [(k, (k + 1) % 300) for k in corners]
    faces = [(b, a, low) for a, b in sides]
    if shape == "cylinder":
        faces += [(a + 300, b + 300, top) for a, b in sides] + [(a, b, a + 300) for a, b in sides]
        faces += [(b, b + 300, a + 300) for a, b in sides]
    else:
        faces += [(a, b, top) for a, b in sides]
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*p) for p in points]
    lines += ["f {} {} {}".format(*np.add(f, 1)) for f in faces]
    (tmp_path / "post.obj").write_text("\n".join(lines))
    robot = load("planar_2r")
    model = ik.CollisionModel(robot).add_mesh(tmp_path / "post.obj", (1.0, 0.9, 0.1), name="post")
    for q in (robot.home, [0.4, 0.3], [1.2, -0.5]):
        for near in (near for near in model.distances(q) if "post" in near.pair):
            assert near.distance == pytest.approx(exact(model, q)[near.pair], abs=1e-5)
    step = ik.Tracker(robot, q0=[0.4, 0.3], avoid_collisions=model).update(robot.fk([0.5, 0.3]).translation, 0.01)
    assert np.isfinite(step.q).all()
    pytest.importorskip("mujoco")  # it takes its meshes for convex
    hinge, geom = '<joint name="j{}" axis="0 0 1" range="-2 2"/>', '<geom type="mesh" mesh="post"/>'
    bodies = "".join(f'<body name="b{k}" pos="0.4 0 0">{hinge.format(k)}{geom}' for k in range(3))
    bodies += '<site name="tip" pos="0.4 0 0"/>' + "</body>" * 3
    asset = '<asset><mesh name="post" file="post.obj"/></asset>'
    (tmp_path / "arm.xml").write_text(f'<mujoco model="arm">{asset}<worldbody>{bodies}</worldbody></mujoco>')
    arm = ik.Robot.load(tmp_path / "arm.xml", tip="tip")
    near = ik.CollisionModel(arm).distance(arm.home)
    assert near.distance == pytest.approx(0.6, abs=1e-4)  # 0.8 m between the axes of two posts of radius 0.1


@pytest.mark.parametrize("name", ROBOTS)
def test_no_pair_comes_closer_than_its_levers_say(name):
    model, rng = model_of(name), np.random.default_rng(2)
    robot, space = model.robot, Clearance(model)
    tight = []
    for size in (0.03, 0.3, 1.0):
        for q in [robot.random_q(rng) for _ in range(4)]:
            end = np.clip(q + rng.uniform(-size, size, robot.n), robot.lower, robot.upper)
            space.place(q)
            before = space.distances()
            space.move()
            levers, most = space.levers(np.abs(end - q))
            assert np.allclose(levers @ np.abs(end - q)[space.coordinates], most)
            for f in (0.3, 0.7, 1.0):
                space.place(q + f * (end - q))
                apart = (before > 0.0) & (before < 2.0)
                lost = (before - space.distances())[apart]
                assert (lost <= (levers @ (f * np.abs(end - q))[space.coordinates])[apart] + 1e-5).all()
                tight.append((lost / np.maximum(most[apart], 1e-9)).max())
    assert max(tight) > 0.2  # a bound that is never approached would prove nothing


@pytest.mark.parametrize("name", ROBOTS)
def test_rows_are_how_distances_change(name):
    model, rng = model_of(name), np.random.default_rng(3)
    robot, space = model.robot, Clearance(model)
    n, checked = robot.n, 0
    for q in [robot.random_q(rng) for _ in range(6)]:
        space.place(q)
        d = space.distances()
        ks = np.flatnonzero((d > 0.05) & (d < 1.0) & ~space.exact)
        space.move()
        A, b, order = np.zeros((len(ks), n)), np.zeros(len(ks)), np.zeros(len(ks), dtype=int)
        step = 1e-5 * rng.normal(size=n)
        count = space.rows(
            ks, space.points(ks), d[ks], np.zeros(n), np.full(n, np.inf), 1.0, 0.01, 0.1, 1e-9, A, b, order
        )
        assert np.allclose(b[:count], d[ks][order[:count]])
        space.place(q + step)
        there = np.array([space.distance(k) for k in ks[order[:count]].tolist()])
        space.place(q - step)
        here = np.array([space.distance(k) for k in ks[order[:count]].tolist()])
        closer = 0.5 * (here - there) / 1e-5
        # where the nearest point jumps from corner to corner, it may be off
        off = np.abs(A[:count] @ step / 1e-5 - closer)
        assert np.median(off) < 0.02 and np.mean(off < 0.1) > 0.8
        checked += count
    assert checked > 20


def facing(space, q, within=1.0):
    """Pairs that are near at q, their distances, and what faces what."""
    space.place(q)
    d = space.distances()
    ks = np.flatnonzero((d > 0.0) & (d < within))
    d = np.array([space.distance(k) for k in ks.tolist()])
    space.near(q, within)  # places the middles of the shapes
    space.move()
    return ks, d, space.facing(ks, d)


@pytest.mark.parametrize("name", [name for name in ROBOTS if name != "mimic"])  # of balls one point is the nearest
def test_points_that_were_nearest_are_kept_while_they_nearly_are(name):
    model, rng = model_of(name), np.random.default_rng(5)
    robot, space = model.robot, Clearance(model)
    kept = 0
    for start in [robot.random_q(rng) for _ in range(3)]:
        space.forget()
        for turn in range(12):
            ks, d, (pairs, points, gaps) = facing(space, start + 0.03 * rng.normal(size=robot.n))
            now = len(ks)
            assert np.array_equal(pairs[:now], ks) and np.array_equal(gaps[:now], d)
            assert np.allclose(points[:now], space.points(ks))
            assert turn > 0 or len(pairs) == now  # after `forget` there is nothing to keep
            least = dict(zip(ks.tolist(), d, strict=True))
            for k, ends, gap in zip(pairs[now:].tolist(), points[now:], gaps[now:], strict=True):
                assert gap < least[k] + NEARBY
                # Points of both hulls: no nearer than the nearest, but for how well coal knows that.
                assert gap > least[k] - 1e-4 and not space._on_surface[k]
                assert abs(np.linalg.norm(ends[1] - ends[0]) - gap) < 1e-12
                assert np.linalg.norm(ends - points[ks.tolist().index(k)], axis=1).max() > 0.99 * APART
            assert np.bincount(pairs).max(initial=0) <= CORNERS
            kept += len(pairs) - now
    assert kept > 0


@pytest.mark.parametrize("gamma", [1.0, 0.5])
@pytest.mark.parametrize("name", ROBOTS)
def test_a_way_that_is_called_free_is_free(name, gamma):
    """Looked at from its start, a step and its brake touch nothing as far as is said, and that is not always nowhere."""
    model, rng = model_of(name), np.random.default_rng(5)
    robot, space = model.robot, Clearance(model)
    n, h, far, met = robot.n, 0.02, 0, 0
    limits = np.array([robot.lower, robot.upper, np.full(n, 3.0), np.full(n, 10.0)])
    for q in [robot.random_q(rng) for _ in range(20)]:
        rate = rng.uniform(-3.0, 3.0, n)
        inside = (q + 0.2 * rate > robot.lower) & (q + 0.2 * rate < robot.upper)
        rate = np.where(inside, rate, 0.0)
        Q, R, L = (np.empty((40, n)) for _ in range(3))
        Q[0], R[0] = q, rate
        count = brake(0, gamma, h, h, limits, Q, R, L)
        assert count > 0 and not R[count].any()
        path = tuple(x[: count + 1] for x in (Q, R, L))
        space.place(q)
        space.move()
        d = space.distances()
        ks = np.flatnonzero((d > 1e-3) & (d < 0.3))
        if not len(ks):
            continue
        until = space.free_until(ks, d[ks], space.levers(L[count])[0], *path, gamma, h, 0.0)
        x, length = np.empty(n), np.empty(n)
        for u in np.linspace(0.0, count, 30):
            along(*path, gamma, h, u, x, length)
            space.place(x)
            for k, end in zip(ks.tolist(), until, strict=True):
                touches = space.distance(k) <= -1e-6
                assert not (touches and u < end)
                met += touches
        far += (until == count).sum()
    assert far > 5 and (met > 0 or name == "mimic")


def test_planes_hold_against_every_turn():
    """No ball comes closer along any direction than the bound allows, even on long moves, where first order would be wrong."""
    robot = ik.Robot.load(BALLS_MIMIC)
    space, rng, close = Clearance(ik.CollisionModel(robot)), np.random.default_rng(6), 0
    moved = space.by_a | space.by_b
    for _ in range(1000):
        k = rng.integers(len(space.a), size=1)
        q = robot.random_q(rng)
        end = np.clip(q + rng.choice([0.05, 0.2, 0.5]) * rng.normal(size=robot.n), robot.lower, robot.upper)
        # A joint that moves both turns the direction, too: such ones stand still.
        end = np.where(np.isin(np.arange(robot.n), space.coordinates[~moved[k[0]]]), q, end)
        Q = np.array([q, end])
        R, L = np.zeros_like(Q), np.abs(Q - q)
        space.place(end)
        space.move()
        there = space._at.copy()
        space.place(q)
        space.move()
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        gone = there - space._at
        closer = normal @ (gone[space.a[k[0]]] - gone[space.b[k[0]]])
        if closer <= 0.0:
            continue
        until = np.empty(1)
        for margin in (0.999, 1.5):
            distance = np.array([margin * closer])
            pairs = Separation(k, normal[None], distance)
            free_until(space._parts, pairs, space.levers(L[1])[0], BrakingPath(Q, R, L, 1.0, 0.1), 0.0, until)
            assert until[0] < 1.0 or margin > 1.0
        close += closer > 0.02 and until[0] == 1.0
    assert close > 10  # nor is it far from what happens


def test_a_convex_hull_is_one():
    """A mesh that is not convex, as a link of the robot: the distance is that of its hull."""
    robot = load("planar_2r")
    surface = coal.BVHModelOBBRSS()
    turn = np.linspace(0.0, 1.6 * np.pi, 40)  # a hook: along its edges there is more than one furthest point
    around = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    points, faces = np.vstack([r * around + np.array([0, 0, z]) for r, z in ((0.3, 0), (0.25, 0), (0.3, 0.1))]), []
    for k in range(39):
        for one, two in ((0, 1), (1, 2), (2, 0)):
            a, b = 40 * one + k, 40 * two + k
            faces += [(a, a + 1, b), (a + 1, b + 1, b)]
    faces = np.array(faces)
    surface.beginModel(len(faces), len(points))
    surface.addVertices(points)
    surface.addTriangles(faces)
    surface.endModel()
    geometry = pin.GeometryModel()
    last, frame = robot.model.njoints - 1, robot.model.getFrameId("link_2")
    geometry.addGeometryObject(pin.GeometryObject("star", last, frame, pin.SE3.Identity(), surface))
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.to_pinocchio(robot.home))
    tips = points[[0, 39]]
    out = tips[1] - tips[0]
    away = np.array([out[1], -out[0], 0.0]) / np.linalg.norm(out)
    away *= np.sign(away @ (tips[0] + tips[1]))
    for f in (0.1, 0.5, 0.9):  # in front of the mouth, which only the hull closes
        one = ik.CollisionModel(robot, geometry=geometry)
        at = data.oMi[last].act(tips[0] + f * out + 0.1 * away)
        base = pin.updateFramePlacement(robot.model, data, robot.model.getFrameId(robot.base))
        one.add_sphere(0.01, base.actInv(at), "ball")
        (near,) = one.distances(robot.home)
        assert near.distance == pytest.approx(0.09, abs=1e-6)


def test_obstacles_move_with_a_base_that_follows_a_joint_of_the_arm():
    text = branches(
        joint("j_b", "revolute", "root", "b", xyz="0 1 0.5", mimic=tie("j_c")),
        joint("j_c", "revolute", "root", "c", xyz="1 0 0"),
        joint("j_d", "revolute", "c", "d", xyz="1 0 0"),
        root="root",
    )
    robot = ik.Robot.load(filled(text, dict.fromkeys(("root", "b", "c", "d"), ball(0.05))), base="b", tip="d")
    model = ik.CollisionModel(robot).add_sphere(0.01, (0, 0, 0), "ball")
    for q in robot.random_q(np.random.default_rng(0), 5):
        model.move("ball", robot.fk(q))
        assert ("d", "ball") in model.collisions(q) and model.distance(q).distance < -0.05
    model.move("ball", (0, 0, 0))
    assert ("b", "ball") not in model.pairs and ("root", "ball") in model.pairs
