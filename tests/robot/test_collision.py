"""Collisions: tested pairs against Pinocchio's own calls, excluded pairs, and collision-free solutions."""

import pickle
import threading

import numpy as np
import pinocchio as pin
import pytest
from robots import ball, filled, have_data, load, sample, urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, ModelError
from ik_toolkit.robot.library import DATA_ROBOTS, example_robot_data

BOTH = ["brokk both", *(["baxter both", "pr2 both"] if have_data() else [])]
ARMS = ["inspection_7dof", "brokk", *(["panda", "ur5", "baxter", "z1"] if have_data() else [])]
ELBOW_ARM = "planar_2r"


def arm(name):
    if name in BOTH:
        return ik.Tree.load("brokk_hydrolek" if name == "brokk both" else name.split()[0])
    return ik.Robot.load("brokk_hydrolek", tip="left_tip") if name == "brokk" else load(name)


def elbow(robot, q, joint=2):
    """Pose of a joint at q in the base frame."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.to_pinocchio(q))
    return data.oMi[joint].translation.copy()


def independent(robot, pairs):
    """Function q -> touching pairs of link names by pin.computeCollisions on shapes read here, with fresh data each time."""
    folders = [str(folder) for folder in robot.package_dirs]
    shapes = pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.COLLISION, package_dirs=folders)
    names = [robot.model.frames[o.parentFrame].name for o in shapes.geometryObjects]
    wanted = {frozenset(pair) for pair in pairs}
    for a in range(len(names)):
        for b in range(a):
            if frozenset((names[a], names[b])) in wanted:
                shapes.addCollisionPair(pin.CollisionPair(b, a))

    def touching(q):
        found = shapes.createData()
        pin.computeCollisions(robot.model, robot.model.createData(), shapes, found, robot.to_pinocchio(q), False)
        hits = zip(shapes.collisionPairs, found.collisionResults, strict=True)
        return {frozenset((names[p.first], names[p.second])) for p, hit in hits if hit.isCollision()}

    return touching


@pytest.mark.parametrize("name", [*ARMS, *BOTH])
def test_verdicts_are_those_of_pinocchio(name):
    robot = arm(name)
    model = ik.CollisionModel(robot)
    touching, by_pinocchio = 0, independent(robot, model.pairs)
    rng = np.random.default_rng(2)
    for q in [robot.random_q(rng) for _ in range(40)]:
        expected = by_pinocchio(q)
        assert model.collides(q) == bool(expected)  # first: what the last q has left behind must not count
        assert {frozenset(pair) for pair in model.collisions(q)} == expected
        touching += bool(expected)
    assert name in ("inspection_7dof", "brokk", "baxter both") or 0 < touching < 40


def test_arms_meet_each_other_and_obstacles():
    tree = arm("brokk both")
    model = ik.CollisionModel(tree)
    rng = np.random.default_rng(3)
    meeting = []
    while len(meeting) < 3:
        q = tree.random_q(rng)
        for pair in model.collisions(q):
            if sorted(name.split("_")[0] for name in pair) == ["left", "right"]:
                meeting.append((q, pair))
    for q, pair in meeting:
        assert pair in model.collisions(q) and pair in model.pairs
        assert independent(tree, [pair])(q) == {frozenset(pair)}
    q = tree.home
    assert not model.collides(q)
    for tip, T in tree.fk(q).items():  # obstacles stand in the base frame, and either arm may meet them
        ball = ik.CollisionModel(tree).add_sphere(0.15, T.translation, f"ball at {tip}")
        side = tip.split("_")[0]
        assert ball.collisions(q) and all(
            name.startswith((side, "ball")) for pair in ball.collisions(q) for name in pair
        )
        assert pickle.loads(pickle.dumps(ball)).collisions(q) == ball.collisions(q)
    with pytest.raises(InvalidOption, match="a Robot or a Tree, not a list"):
        ik.CollisionModel(list(tree.arms))


def test_joined_links_and_links_that_never_move_are_not_tested():
    robot = load("hydrolek_7w")
    model = ik.CollisionModel(robot)
    parent = {robot.model.frames[o.parentFrame].name: o.parentJoint for o in model.geometry.geometryObjects}
    order = sorted(set(parent.values()))
    for first, second in model.pairs:
        assert abs(order.index(parent[first]) - order.index(parent[second])) >= 2
    assert len(model.pairs) == sum(range(len(order) - 1))
    two = arm("brokk")  # the other arm rests: its links move against this one, not against its own mount
    pairs = {frozenset(pair) for pair in ik.CollisionModel(two).pairs}
    right = [pair for pair in pairs if all(name.startswith("right") for name in pair)]
    assert not right and any("left" in a and "right" in b for a, b in map(sorted, pairs))


TOUCHING = urdf(*[{"kind": "revolute", "axis": "0 1 0", "limits": (-1.0, 1.0), "xyz": "0 0 0.3"}] * 4, name="touching")


def balls(*radii, text=TOUCHING):
    return ik.Robot.load(filled(text, {f"l{k}": ball(radius) for k, radius in enumerate(radii)}))


def test_pairs_that_touch_at_rest_are_listed_not_tested():
    model = ik.CollisionModel(balls(0.05, 0.05, 0.4, 0.05, 0.3))
    assert model.excluded == (("l2", "l4"),) and ("l0", "l2") not in model.excluded
    assert ("l2", "l4") not in model.pairs and ("l0", "l3") in model.pairs
    assert "1 excluded" in repr(model)


def test_every_excluded_pair_is_gone():
    """All of them touch at home and at zero: none is left (removing from the list that is walked skips every second)."""
    model = ik.CollisionModel(balls(*[2.0] * 5))
    assert len(model.excluded) == 6 and model.pairs == ()
    two = filled(TOUCHING, {"l0": ball(2.0) * 3})
    model = ik.CollisionModel(balls(0, 0.01, 0.3, 0.3, 0.3, text=two))
    assert {pair for pair in model.excluded if "l0" in pair} == {("l0", f"l{k}") for k in (2, 3, 4)}
    assert not set(model.pairs) & set(model.excluded) and not model.collisions(model.robot.home)


WIDE = [DATA_ROBOTS[name][0] for name in ("centauro", "tiago")]  # others are in test_wide.py


@pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("file", WIDE)
def test_what_touches_by_construction_is_not_tested(file):
    path = example_robot_data("panda")[0].parents[2] / file
    tip = {"centauro": "arm1_8", "tiago": "hand_index_flex_3_link"}[path.stem]
    model = ik.CollisionModel(ik.Robot.load(path, tip=tip, package_dirs=[path.parents[4]], srdf=False))
    assert model.excluded and not set(model.pairs) & set(model.excluded)
    assert model.collisions(model.robot.home) == []


def test_links_that_may_touch():
    robot = load("hydrolek_7w")
    pair = ik.CollisionModel(robot).pairs[0]
    assert pair not in ik.CollisionModel(robot, ignore=[pair[::-1]]).pairs
    with pytest.raises(InvalidOption, match="link_3"):
        ik.CollisionModel(robot, ignore=[("link_2", "lnk_3")])
    for bad in ([("link_2",)], [()], 3, [3], None):
        with pytest.raises(InvalidOption, match="pairs of links"):
            ik.CollisionModel(robot, ignore=bad)
    with pytest.raises(InvalidOption, match=r"geometry must be a pin\.GeometryModel, not str"):
        ik.CollisionModel(robot, geometry="shapes")


def test_robots_without_shapes_or_meshes_say_so():
    with pytest.raises(ModelError, match="no collision shapes"):
        ik.CollisionModel(load("slides_mix"))
    with pytest.raises(ModelError, match="no collision shapes"):
        ik.solve(load("slides_mix"), load("slides_mix").fk(load("slides_mix").home), avoid_collisions=True)
    mesh = '<collision><geometry><mesh filename="package://nowhere/part.stl"/></geometry></collision>'
    with pytest.raises(ModelError, match=r"part\.stl.*package_dirs"):
        ik.CollisionModel(ik.Robot.load(filled(TOUCHING, {"l1": mesh})))
    made = ik.Robot(pin.buildModelFromXML(TOUCHING), tip="l4")
    shapes = pin.buildGeomFromUrdfString(made.model, balls(0.05, 0.05, 0.05, 0.05).urdf, pin.COLLISION)
    assert ik.CollisionModel(made, geometry=shapes).pairs == (("l0", "l2"), ("l0", "l3"), ("l1", "l3"))


# ------------------------------------------------------------------------------------------------------------- obstacles
@pytest.mark.parametrize("base", [None, "link_1"])
def test_shapes_stand_in_the_base_frame(base, tmp_path):
    robot = ik.Robot.load("hydrolek_7w", base=base)
    q = robot.home
    link = next(o for o in ik.CollisionModel(robot).geometry.geometryObjects if o.name == "link_5_0")
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.to_pinocchio(q))
    pin.updateFramePlacements(robot.model, data)
    base = data.oMf[robot.model.getFrameId(robot.base)]
    at = base.actInv(data.oMi[link.parentJoint].act(link.placement.translation))
    away = at + np.array([0.0, 0.0, 5.0])
    mesh = tmp_path / "corner.stl"
    mesh.write_text(
        "solid corner\nfacet normal 0 0 1\nouter loop\nvertex -1 -1 0\nvertex 1 -1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
    )
    for add in (
        lambda model, x: model.add_sphere(0.01, x),
        lambda model, x: model.add_box((0.01, 0.02, 0.03), x),
        lambda model, x: model.add_cylinder(0.01, 0.02, ik.pose(x, rpy=(0.3, 0.2, 0.1))),
        lambda model, x: model.add_mesh(mesh, x, 0.3),
    ):
        assert add(ik.CollisionModel(robot), at).collides(q)
        assert not add(ik.CollisionModel(robot), away).collides(q)


def test_a_sphere_touches_where_distance_says():
    robot = load(ELBOW_ARM)  # links are cylinders along x: the distance of a point from them is plane geometry
    q = np.array([0.0, 0.0])
    radius = ik.CollisionModel(robot).geometry.geometryObjects[-1].geometry.radius
    for gap, touches in ((1e-4, False), (-1e-4, True)):
        model = ik.CollisionModel(robot).add_sphere(0.1, (1.5, 0.1 + radius + gap, elbow(robot, q)[2]), "ball")
        assert model.collides(q) == touches
        assert model.collisions(q) == ([("link_2", "ball")] if touches else [])


def test_obstacles_get_names():
    model = ik.CollisionModel(load(ELBOW_ARM))
    assert model.add_sphere(0.1, (5, 0, 0)).add_sphere(0.1, (6, 0, 0)).obstacles == ("sphere_1", "sphere_2")


def test_models_travel_and_serve_several_threads():
    robot = load("inspection_7dof")
    model = ik.CollisionModel(robot).add_box((0.2, 0.2, 0.2), robot.fk(robot.home).translation, "crate")
    Q = sample(robot, 50)[0]
    there = [model.collisions(q) for q in Q]
    again = pickle.loads(pickle.dumps(model))
    assert again.pairs == model.pairs and [again.collisions(q) for q in Q] == there
    found = {}
    threads = [
        threading.Thread(target=lambda k=k: found.update({k: [model.collisions(q) for q in Q]})) for k in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(found[k] == there for k in range(3))


# --------------------------------------------------------------------------------------------------------------- solving
@pytest.mark.parametrize(("name", "solver"), [(ELBOW_ARM, "auto"), (ELBOW_ARM, "planar-2r"), ("hydrolek_7w", "auto")])
def test_a_sphere_on_the_elbow_forces_another_solution(name, solver):
    robot = load(name)
    q = np.array([0.4, 1.2]) if name == ELBOW_ARM else robot.home
    target = robot.fk(q).translation
    free = ik.solve(robot, target, solver, q0=q)
    model = ik.CollisionModel(robot).add_sphere(0.15, elbow(robot, free.q, 2 if name == ELBOW_ARM else 3), "ball")
    assert model.collides(free.q) and free.collision is None
    result = ik.solve(robot, target, solver, q0=q, avoid_collisions=model)
    assert result.success and not model.collides(result.q) and result.collision is None
    assert result.restarts > free.restarts
    assert robot.errors(result.q, target)[0] <= 1e-6 and not robot.outside(result.q)
    assert np.array_equal(result.q, ik.solve(robot, target, solver, q0=q, avoid_collisions=model).q)


def test_a_free_first_answer_is_kept():
    robot = load("hydrolek_7w")
    for T in sample(robot, 10)[1]:
        plain = ik.solve(robot, T, "lm")
        careful = ik.solve(robot, T, "lm", avoid_collisions=True)
        assert careful.q.tobytes() == plain.q.tobytes() and careful.restarts == plain.restarts


def test_only_colliding_answers_are_no_success_and_name_the_pair():
    robot = load("hydrolek_7w")
    T = robot.fk(robot.home)
    model = ik.CollisionModel(robot).add_sphere(0.2, T.translation, "ball")
    result = ik.solve(robot, T, avoid_collisions=model)
    assert result.status == ik.Status.COLLISION and not result.success
    assert result.collision is not None and "ball" in result.collision and "ball" in result.message
    assert result.to_dict()["collision"] == result.collision and result.restarts >= 256
    assert model.collisions(result.q) and robot.errors(result.q, T.homogeneous)[0] <= 1e-6
    none = ik.solve(robot, T, avoid_collisions=model, restarts=0)
    assert none.status == ik.Status.COLLISION and none.restarts == 0 and "1 start " in none.message
    many = ik.solve_batch(robot, [T, T], avoid_collisions=model)
    assert many.counts() == {"COLLISION": 2} and many[1].collision == result.collision


def test_closest_and_objectives_go_with_collisions():
    robot = load(ELBOW_ARM)
    q = np.array([0.4, 1.2])
    model = ik.CollisionModel(robot).add_sphere(0.15, elbow(robot, q), "ball")
    result = ik.solve(robot, robot.fk(q).translation, closest=q, avoid_collisions=model)
    assert result.success and result.q[1] == pytest.approx(-1.2, abs=1e-5)
    three = load("planar_3r")
    xyz = three.fk([0.5, 0.5, 0.5]).translation
    around = 0
    for k in range(6):
        plain = ik.solve(three, xyz, q0=three.home, objective="mid-range", seed=k)
        wall = ik.CollisionModel(three).add_sphere(0.3, elbow(three, plain.q, 3), "ball")
        found = ik.solve(three, xyz, q0=three.home, objective="mid-range", seed=k, avoid_collisions=wall)
        assert not found.success or not wall.collides(found.q)
        around += found.success
    assert around >= 3  # a refusal every time would prove nothing


@pytest.mark.parametrize("solver", ["auto", "lm"])
def test_all_solutions_are_those_that_touch_nothing(solver):
    robot = load(ELBOW_ARM)
    q = np.array([0.4, 1.2])
    xyz = robot.fk(q).translation
    model = ik.CollisionModel(robot).add_sphere(0.15, elbow(robot, q), "ball")
    assert len(ik.solve_all(robot, xyz, solver)) == 2
    free = ik.solve_all(robot, xyz, solver, avoid_collisions=model)
    assert len(free) == 1 and free.q[0, 1] == pytest.approx(-1.2, abs=1e-5) and "1 of them collide" in free.message
    model.add_sphere(0.15, elbow(robot, free.q[0]), "other")
    none = ik.solve_all(robot, xyz, solver, avoid_collisions=model)
    assert len(none) == 0 and "touch" in none.message


def test_what_may_be_asked_for():
    robot = load("hydrolek_7w")
    other = ik.CollisionModel(load("inspection_7dof"))
    T = robot.fk(robot.home)
    with pytest.raises(InvalidOption, match="inspection_7dof"):
        ik.solve(robot, T, avoid_collisions=other)
    both = ik.Tree.load("brokk_hydrolek", tips=["left_tip", "right_tip"])
    # an arm's own shapes say nothing of the other arm's
    with pytest.raises(InvalidOption, match="another Robot object"):
        ik.Solver(both, "lm", avoid_collisions=ik.CollisionModel(both.arms[0]))
    assert ik.solve(robot.with_tool(np.eye(4)), T, avoid_collisions=True).success  # a copy gets a model of its own


@pytest.mark.parametrize("value", [np.zeros(3), np.array([]), [True], "yes", -1.0, np.nan, np.inf, 10**400])
def test_one_sentence_refuses_what_no_call_can_avoid(value):
    robot = load("hydrolek_7w")
    T = robot.fk(robot.home).homogeneous
    line = ik.line(T, T, duration=0.1)
    calls = (
        lambda **given: ik.solve(robot, T, **given),
        lambda **given: ik.solve_all(robot, T, **given),
        lambda **given: ik.solve_batch(robot, [T], **given),
        lambda **given: ik.solve_path(robot, [T, T], **given),
        lambda **given: ik.Tracker(robot, **given),
        lambda **given: ik.track(robot, line, **given),
    )
    for call in calls:
        with pytest.raises(InvalidOption, match=r"avoid_collisions must be True, a margin of at least 0 .m. or a Coll"):
            call(avoid_collisions=value)


def test_a_margin_of_zero_avoids_contacts_and_none_avoids_nothing():
    robot = load("hydrolek_7w")
    T = robot.fk(robot.home).homogeneous
    for margin in (0.0, 0, True, np.True_):
        assert ik.solve(robot, T, avoid_collisions=margin).clearance > 0.0
        assert ik.solve_path(robot, [T, T], avoid_collisions=margin).success
    for none in (None, False, np.False_):
        assert ik.solve(robot, T, avoid_collisions=none).clearance is None
        assert ik.solve_path(robot, [T, T], avoid_collisions=none).success
