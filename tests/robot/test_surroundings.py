"""Tools with shapes, held shapes, obstacles that are moved and removed, and a margin: all judged by the distance."""

import pickle

import coal
import numpy as np
import pinocchio as pin
import pytest
from refusals import refuses
from robots import have_data, load

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidConfiguration, InvalidOption, InvalidTarget, NotSolved

ARM = "hydrolek_7w"
AWAY = (9.0, 9.0, 9.0)


def sampled(robot, count, seed=0):
    return robot.random_q(np.random.default_rng(seed), count)


def apart(robot, q, shape, T_base_shape, other, T_base_other):
    """Distance [m] of two shapes by coal, independently of the model."""
    result = coal.DistanceResult()
    places = (coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (T_base_shape, T_base_other))
    first, second = places
    return coal.distance(shape, first, other, second, coal.DistanceRequest(), result)


def at(robot, q, T=(0, 0, 0)):
    return robot.fk(q).homogeneous @ as_pose(T)


def as_pose(T):
    made = np.eye(4)
    made[:3, 3] = T
    return made


# -------------------------------------------------------------------------------------------------------------- tools
@pytest.mark.parametrize("base", [None, "link_1"])
def test_a_tool_has_a_shape(base):
    bare = ik.Robot.load(ARM, base=base)
    T, T_shape = ik.pose((0.0, 0.05, 0.4), rpy=(0.3, 0, 0)), ik.pose((0, 0, 0.2), rpy=(0, 0.2, 0))
    arm = bare.with_tool(T, shape=ik.Shape.box((0.05, 0.06, 0.4)), T_tip_shape=T_shape)
    model = ik.CollisionModel(arm)
    assert "tool at tool" in model.links
    ball = as_pose((0.8, 0.1, 0.3))
    model.add_sphere(0.1, ball, "ball")
    touching = 0
    for q in sampled(arm, 200, 1):
        box = bare.fk(q).homogeneous @ T_shape
        d = apart(arm, q, coal.Box(0.05, 0.06, 0.4), box, coal.Sphere(0.1), ball)
        assert (("tool at tool", "ball") in model.collisions(q)) == (d < 0.0)
        touching += d < 0.0
    assert touching > 0
    again = pickle.loads(pickle.dumps(arm))
    assert ik.CollisionModel(again).pairs == ik.CollisionModel(arm).pairs
    # without T_tip_shape at the tool's point
    at_point = ik.CollisionModel(bare.with_tool(T, shape=ik.Shape.sphere(0.02)))
    at_point.add_sphere(0.02, (bare.fk(bare.home) * pin.SE3(T)).translation, "there")
    assert ("tool at tool", "there") in at_point.collisions(bare.home)


def test_a_tool_meets_the_links_it_can_move_against():
    arm = load("planar_2r")
    long = arm.with_tool((0, 0, 0), shape=ik.Shape.box((4.0, 0.02, 0.02)))  # reaches back over both links
    model = ik.CollisionModel(long)
    assert ("link_2", "tool at tool") not in model.pairs  # it is mounted there
    assert any("tool at tool" in pair for pair in model.pairs)
    assert ik.CollisionModel(long, ignore=[("tool at tool", model.links[0])]).pairs != model.pairs
    two = long.with_tool((0, 0, 1), shape=ik.Shape.sphere(0.1))
    assert {"tool at tool", "tool at tool 2"} <= set(ik.CollisionModel(two).links)
    with pytest.raises(InvalidOption, match=r"ik\.Shape\.box"):
        arm.with_tool((0, 0, 0), shape="box")


def test_tools_of_a_tree():
    tree = ik.Tree.load("brokk_hydrolek")
    armed = tree.with_tool({"left_tip": (0, 0, 0.2)}, shape=ik.Shape.capsule(0.03, 0.2))
    assert [name for name in ik.CollisionModel(armed).links if name.startswith("tool")] == ["tool at left_tip"]
    with pytest.raises(FrameNotFound):
        tree.with_tool((0, 0, 0), shape={"left_tp": ik.Shape.sphere(0.1)})


# ------------------------------------------------------------------------------------------------------------ in the hand
def test_what_is_held_moves_with_the_tip():
    arm = load(ARM).with_tool((0, 0, 0.1))
    T = as_pose((0.1, 0.0, 0.15))
    model = ik.CollisionModel(arm).attach(ik.Shape.sphere(0.1), T, name="load", touch=("link_3",))
    one = ik.CollisionModel(arm).attach(ik.Shape.sphere(0.1), T, name="load", touch="link_3")
    assert one.pairs == model.pairs
    model.add_box((0.4, 0.4, 0.4), (0.8, 0.2, -0.2), "crate")
    assert model.attached == ("load",) and model.obstacles == ("crate",)
    assert (
        ("link_3", "load") not in model.pairs and ("link_2", "load") in model.pairs and ("load", "crate") in model.pairs
    )
    touching = 0
    for q in sampled(arm, 200, 2):
        d = apart(arm, q, coal.Sphere(0.1), at(arm, q) @ T, coal.Box(0.4, 0.4, 0.4), as_pose((0.8, 0.2, -0.2)))
        assert (("load", "crate") in model.collisions(q)) == (d < 0.0)
        touching += d < 0.0
    assert touching > 0
    again = pickle.loads(pickle.dumps(model))
    assert again.pairs == model.pairs and again.attached == ("load",) and "attached: load" in repr(again)


def test_an_obstacle_is_taken_and_put_down():
    arm = load(ARM)
    q, there = sampled(arm, 2, 3)
    place = at(arm, q) @ ik.pose((0.02, 0, 0.3), rpy=(0.1, 0.2, 0.3))
    model = ik.CollisionModel(arm).add_box((0.1, 0.1, 0.1), place, "part").add_sphere(0.1, AWAY, "ball")
    model.attach("part", q=q)
    assert model.attached == ("part",) and model.obstacles == ("ball",)
    ball = at(arm, there) @ np.linalg.inv(at(arm, q)) @ place
    assert ("part", "ball") in model.move("ball", ball).collisions(there)
    model.detach("part", there)
    assert model.obstacles == ("part", "ball") and not model.attached
    assert np.allclose(model.placed()[0][2], ball) and ("part", "ball") not in model.pairs  # neither moves now
    model.attach(ik.Shape.cylinder(0.05, 0.1)).detach("cylinder_1")
    assert model.obstacles == ("part", "ball")


def test_two_hands():
    tree = ik.Tree.load("brokk_hydrolek")
    model = ik.CollisionModel(tree)
    for tip in tree.tips:
        model.attach(ik.Shape.sphere(0.1), tip=tip, name=tip)
    assert ("left_tip", "right_tip") in model.pairs
    near = {tip: T.translation for tip, T in tree.fk(tree.home).items()}
    gap = np.linalg.norm(near["left_tip"] - near["right_tip"]) - 0.2
    (found,) = [one for one in model.distances(tree.home) if one.pair == ("left_tip", "right_tip")]
    assert found.distance == pytest.approx(gap, abs=1e-9)
    with pytest.raises(InvalidOption, match="choose with tip= the tip that holds it: left_tip, right_tip"):
        model.attach(ik.Shape.sphere(0.1))


def test_mistakes_are_named():
    arm = load(ARM)
    model = ik.CollisionModel(arm).add_sphere(0.1, AWAY, "ball").attach(ik.Shape.sphere(0.01), name="held")
    ball, away = ik.Shape.sphere(0.1), (5, 0, 0)
    refuses(
        InvalidOption,
        (lambda: model.move("bal", AWAY), r"no obstacle or attached shape named 'bal'\. Did you mean 'ball'"),
        (lambda: model.remove("nothing"), "no obstacle or attached shape named 'nothing'"),
        (lambda: model.remove("link_1"), "no obstacle"),
        (lambda: model.detach("ball"), "'ball' is an obstacle, not attached"),
        (lambda: model.attach("held", q=arm.home), "'held' is already attached"),
        (lambda: model.attach("ball"), "give the q at which the robot grasps it, or T_tip_shape"),
        (lambda: model.attach(3), r"ik\.Shape"),
        (lambda: model.attach(ball, touch=["lnk_6"]), r"names 'lnk_6', .*not a known part\. Did you mean 'link_6'"),
        (lambda: model.add_sphere(0.1, away, "ball"), "there is already a link or obstacle named 'ball'"),
        (lambda: model.add_sphere(0.1, away, "link_2"), "there is already a link or obstacle named 'link_2'"),
        (lambda: model.distances(arm.home, np.zeros(2)), "within must be a distance"),
        (lambda: model.add_sphere(-1.0, away), "positive"),
        (lambda: model.add_box((1, 2), away), "positive"),
        (lambda: model.add_cylinder(1.0, np.nan, away), "positive"),
        (lambda: model.add_box("abc", away), "positive"),
        (lambda: ik.Shape.box((1, -1, 1)), "positive"),
        (lambda: ik.Shape("spere", (1,)), "Did you mean 'sphere'"),
        (lambda: ik.Shape("box", (1,)), "size of a box must be 3 positive numbers"),
        (lambda: ik.Shape("mesh", 3), "sizes of a mesh must be a tuple"),
        (lambda: ik.CollisionModel(arm, margin=-0.1), "at least 0"),
        (lambda: ik.CollisionModel(arm, margin="x"), "margin"),
        *((lambda bad=bad: model.attach(ball, away, touch=bad), "touch") for bad in (3, None, [[]])),
    )
    for bad in (3, [], np.zeros(2), {}):
        refuses(
            InvalidOption,
            (lambda bad=bad: model.add_sphere(0.1, away, name=bad), "name must be text"),
            (lambda bad=bad: model.move(bad, away), "name"),
            (lambda bad=bad: model.remove(bad), "name"),
            (lambda bad=bad: ik.Shape.mesh(bad), "path of a file"),
        )
    refuses(
        InvalidConfiguration,
        (lambda: model.attach("ball", q=[1.0]), "q must have"),
        (lambda: model.add_mesh("nowhere.stl", away), "no mesh file"),
    )
    place = (0, 0)
    refuses(
        InvalidTarget, (lambda: model.move("ball", place), "4x4"), (lambda: model.add_sphere(1.0, place), "4x4 pose")
    )
    refuses(FrameNotFound, (lambda: model.attach(ball, tip="tol"), "tol"))
    assert model.obstacles == ("ball",) and model.attached == ("held",)


# ------------------------------------------------------------------------------------------------------------- obstacles
def test_obstacles_move_and_go():
    arm = load(ARM)
    q, tip = arm.home, arm.fk(arm.home).translation
    model = ik.CollisionModel(arm).add_sphere(0.1, AWAY, "a").add_box((0.3, 0.3, 0.3), AWAY, "b")
    assert not model.collides(q) and model.distance(q).distance > 0.0
    model.move("b", tip)
    assert model.collides(q) and {pair[1] for pair in model.collisions(q)} == {"b"}
    assert model.distance(q).pair[1] == "b" and model.distance(q).distance <= 0.0
    assert ik.solve(arm, arm.fk(q), avoid_collisions=model, restarts=0).status == ik.Status.COLLISION
    assert model.remove("a").obstacles == ("b",) and model.collides(q)
    assert not model.move("b", AWAY).collides(q)
    assert not model.move("b", tip).remove("b").collides(q) and model.obstacles == ()
    assert model.pairs == ik.CollisionModel(arm).pairs
    assert model.add_sphere(0.2, tip, "a").collides(q)  # the name is free again


def test_a_tracker_sees_what_moves():
    arm = load(ARM)
    q, tip = arm.home, arm.fk(arm.home).translation
    model = ik.CollisionModel(arm).add_sphere(0.05, AWAY, "ball")
    tracker = ik.Tracker(arm, q0=q, avoid_collisions=model)
    target = arm.fk(q).homogeneous
    assert tracker.update(target, 0.01).status.name != "BLOCKED"
    model.move("ball", tip + np.array([0.0, 0.0, 0.12]))
    step = tracker.update(target, 0.01)
    assert any("ball" in pair for pair in tracker.stepper.guard.pairs) and step is not None


# ---------------------------------------------------------------------------------------------------------------- margin
@pytest.mark.parametrize("name", [ARM, "inspection_7dof", *(["panda"] if have_data() else [])])
def test_contact_is_being_nearer_than_the_margin(name):
    arm = load(name)
    plain = ik.CollisionModel(arm).add_box((0.2, 0.2, 0.2), (0.5, 0.2, 0.5), "box")
    model = ik.CollisionModel(arm, margin=0.03).add_box((0.2, 0.2, 0.2), (0.5, 0.2, 0.5), "box")
    assert model.pairs == plain.pairs and not ik.CollisionModel(arm, margin=0.03).collides(arm.home)
    between = 0
    for q in sampled(arm, 150, 4):
        near = model.distance(q)
        within = {one.pair for one in model.distances(q, 0.03) if "box" in one.pair}
        assert {pair for pair in model.collisions(q) if "box" in pair} == within
        assert model.collides(q) == bool(model.collisions(q))
        assert not plain.collides(q) or model.collides(q)
        assert near.distance == pytest.approx(model.distances(q)[0].distance, abs=1e-5)  # coal's tolerance is 1e-6
        between += model.collides(q) and not plain.collides(q)
    assert between > 0
    assert pickle.loads(pickle.dumps(model)).margin == 0.03


def test_links_that_are_near_at_home_keep_half_of_it():
    arm = load(ARM)
    own = {one.pair: one.distance for one in ik.CollisionModel(arm).distances(arm.home)}
    margin = 1.01 * sorted(own.values())[2]
    model = ik.CollisionModel(arm, margin=margin)
    shapes = model.geometry.geometryObjects
    names = [
        tuple(arm.model.frames[shapes[k].parentFrame].name for k in (p.first, p.second))
        for p in model.geometry.collisionPairs
    ]
    kept = dict(zip(names, model.margins, strict=True))
    for pair, distance in own.items():
        assert kept[pair] == pytest.approx(0.5 * distance if distance < margin else margin)
    assert not model.collides(arm.home)


def test_answers_and_paths_keep_the_margin():
    arm = load(ARM)
    Q = sampled(arm, 12, 5)
    world = ik.CollisionModel(arm, margin=0.05).add_sphere(0.15, (0.9, 0.0, 0.3), "ball")
    free = ik.CollisionModel(arm).add_sphere(0.15, (0.9, 0.0, 0.3), "ball")
    solved = 0
    for q in Q:
        result = ik.solve(arm, arm.fk(q), avoid_collisions=world, restarts=32)
        if result.success:
            solved += 1
            ball = [one for one in free.distances(result.q) if "ball" in one.pair]
            assert ball[0].distance >= 0.05 and not world.collides(result.q)
            assert result.clearance == pytest.approx(world.distance(result.q).distance, abs=1e-5)
            assert result.to_dict()["clearance"] == pytest.approx(result.clearance, abs=1e-5)
    assert solved > 3
    batch = ik.solve_batch(arm, [arm.fk(q) for q in Q], avoid_collisions=world, restarts=32)
    assert all(not world.collides(q) for q in batch.q[batch.success])
    assert ik.solve(arm, arm.fk(Q[0])).clearance is None
    by_number = ik.solve(arm, arm.fk(arm.home), q0=arm.home, avoid_collisions=0.01)
    assert by_number.success and not ik.CollisionModel(arm, margin=0.01).collides(by_number.q)


def test_a_path_that_only_comes_near():
    """A straight motion past a ball at 2 cm: free without a margin, not with one of 5 cm."""
    arm = load("planar_2r")
    T = [arm.fk([x, 0.8]) for x in np.linspace(0.0, 0.6, 7)]
    out = T[3].translation / np.linalg.norm(T[3].translation)
    world = ik.CollisionModel(arm).add_sphere(0.1, 3.0 * out, "ball")
    far = 3.0
    for _ in range(200):  # as far in as the distance allows, which cannot be too far
        far -= world.move("ball", far * out).distance([0.3, 0.8]).distance - 0.02
    ball = far * out
    assert world.distance([0.3, 0.8]).distance == pytest.approx(0.02, abs=1e-3)
    paths = []
    for margin in (0.0, 0.05):
        model = ik.CollisionModel(arm, margin=margin).add_sphere(0.1, ball, "ball")
        paths.append(ik.solve_path(arm, [t.translation for t in T], avoid_collisions=model))
    assert paths[0].continuity.clearance < 0.03 and not paths[0].continuity.contacts
    assert paths[1].continuity.contacts or not paths[1].success


def test_what_was_found_before_an_obstacle_moved_says_so():
    """A path is not put in time through an obstacle that came later, and a row of a batch does not blame its solver."""
    arm = load(ARM)
    model = ik.CollisionModel(arm).add_sphere(0.2, (0.0, 0.0, 3.0), "ball")
    poses = np.array([arm.fk(arm.home + 0.02 * k).homogeneous for k in range(6)])
    path = ik.solve_path(arm, poses, avoid_collisions=model)
    assert path.success
    model.move("ball", poses[3])
    with pytest.raises(NotSolved, match=r"moved since .* and ball touch at pose"):
        path.retime(acceleration=1.0)
    row = ik.solve_batch(arm, poses[3:4], avoid_collisions=model)
    assert "ball touch" in row[0].message
    model.remove("ball")
    assert "in collision; what touched here has moved since" in row[0].message
