"""Objectives and collisions with several tips: checked by independent sums, Jacobians and Pinocchio calls."""

import numpy as np
import pinocchio as pin
import pytest
from robots import have_data

import ik_toolkit as ik

NAMES = ["brokk_hydrolek", *(["tiago_dual", "pr2"] if have_data() else [])]


@pytest.fixture(scope="module", params=NAMES)
def tree(request):
    return ik.Tree.load(request.param)


def targets(tree, rng, kinds):
    """One reachable target a tip: poses, positions, or the first a pose and the second a position."""
    poses = [T.homogeneous for T in tree.fk(tree.random_q(rng)).values()]
    free = {"poses": (), "positions": (0, 1), "both": (1,)}[kinds]
    return [T[:3, 3].copy() if f in free else T for f, T in enumerate(poses)]


def rows_that_count(goal):
    return np.concatenate([6 * f + np.arange(3 if T.ndim == 1 else 6) for f, T in enumerate(goal)])


def cost(tree, objective, q, goal, q0):
    """What the objective lowers, from its definition."""
    if objective == "manipulability":
        J = tree.jacobian(q)[rows_that_count(goal)]
        return -0.5 * np.linalg.slogdet(J @ J.T)[1]
    bounded, middle, span = ranges(tree)
    if objective == "reference":
        return 0.5 * np.sum(((q - q0) / tree.chain.unit) ** 2)
    return 0.5 * np.sum((np.where(bounded, q - middle, 0.0) / span) ** 2)


def ranges(tree):
    """Which joints have limits, the middle of each range, and its width: a turn where there are none."""
    bounded = np.isfinite(tree.upper - tree.lower)
    lower, upper = np.where(bounded, tree.lower, -np.pi), np.where(bounded, tree.upper, np.pi)
    return bounded, 0.5 * (lower + upper), upper - lower


@pytest.mark.parametrize("objective", ["mid-range", "reference", "manipulability"])
@pytest.mark.parametrize("kinds", ["poses", "positions", "both"])
def test_objectives_get_better_and_the_tips_stay(tree, objective, kinds):
    rng = np.random.default_rng(51)
    better = 0
    for _ in range(4):
        goal = targets(tree, rng, kinds)
        plain = ik.solve(tree, goal, q0=tree.home)
        found = ik.solve(tree, goal, q0=tree.home, objective=objective)
        assert plain.success and found.success and not tree.outside(found.q)
        for position, angle in tree.errors(found.q, goal):
            assert position <= 1e-6 and (angle or 0.0) <= 1e-6
        before, after = (cost(tree, objective, x.q, goal, tree.home) for x in (plain, found))
        assert after <= before + 1e-9
        better += after < before - 1e-4
    assert better >= 3


def test_an_objective_ends_where_no_self_motion_is_better(tree):
    """At the end the gradient of the mid-range distance has no null-space component, except for joints at limits."""
    bounded, middle, span = ranges(tree)

    def left(q, goal):
        """That part: in joint ranges, as the distances are measured."""
        gradient, J = np.where(bounded, (q - middle) / span, 0.0), tree.jacobian(q)[rows_that_count(goal)] * span
        return np.linalg.norm(gradient - np.linalg.pinv(J) @ (J @ gradient))

    rng, seen = np.random.default_rng(52), 0
    for _ in range(8):
        goal = targets(tree, rng, "both")
        plain, found = ik.solve(tree, goal), ik.solve(tree, goal, objective="mid-range")
        if found.limited_joints:
            continue
        assert left(found.q, goal) < 1e-3 * max(left(plain.q, goal), 0.1)
        seen += 1
    assert seen >= 2


@pytest.mark.parametrize("option", [{"objective": "mid-range"}, {"avoid_collisions": True}])
def test_held_joints_stay(tree, option):
    rng = np.random.default_rng(53)
    held = [0, tree.n - 1]
    weights = np.ones(tree.n)
    weights[held] = 0.0
    solved = 0
    for _ in range(4):
        q = tree.random_q(rng)
        q0 = tree.random_q(rng)
        q0[held] = q[held]
        goal = [T.homogeneous for T in tree.fk(q).values()]
        found = ik.solve(tree, goal, q0=q0, joint_weights=weights, restarts=100, **option)
        assert (found.q[held] == q0[held]).all()
        solved += found.success
    assert solved >= (3 if "objective" in option else 1)


# ---------------------------------------------------------------------------------------------------------- collisions
def touching(tree, model, shapes=()):
    """Function q -> whether a tested pair touches, by Pinocchio on shapes read here, with fresh data each time."""
    folders = [str(folder) for folder in tree.package_dirs]
    geometry = pin.buildGeomFromUrdfString(tree.model, tree.urdf, pin.COLLISION, package_dirs=folders)
    for shape in shapes:
        geometry.addGeometryObject(shape)
    names = [
        o.name if o.name in model.obstacles else tree.model.frames[o.parentFrame].name for o in geometry.geometryObjects
    ]
    wanted = {frozenset(pair) for pair in model.pairs}
    for a in range(len(names)):
        for b in range(a):
            if frozenset((names[a], names[b])) in wanted:
                geometry.addCollisionPair(pin.CollisionPair(b, a))

    def judge(q):
        found = geometry.createData()
        return pin.computeCollisions(tree.model, tree.model.createData(), geometry, found, tree.to_pinocchio(q), True)

    return judge


def test_answers_touch_nothing(tree):
    model = ik.CollisionModel(tree)
    judge = touching(tree, model)
    solver = ik.Solver(tree, avoid_collisions=model)
    plain, rng, led = ik.Solver(tree), np.random.default_rng(54), 0
    for _ in range(4):
        while True:  # a target that can be reached without touching, and whose first answer touches
            q = tree.random_q(rng)
            goal = [T.homogeneous for T in tree.fk(q).values()]
            if not model.collides(q) and model.collides(plain(goal).q):
                break
        found = solver(goal)
        assert found.status in (ik.Status.CONVERGED, ik.Status.COLLISION)
        assert judge(found.q) == (not found.success) and (found.collision is None) == found.success
        if found.success:
            assert max(position for position, _ in tree.errors(found.q, goal)) <= 1e-6
        else:
            assert found.collision in model.collisions(found.q)
        led += found.success
    assert led >= 3
    assert ik.solve(tree, goal, q0=q, avoid_collisions=model).success  # it is free there


def test_arms_that_cross_are_led_apart():
    """Targets whose obvious answers cross: with collisions avoided the arms find ways that do not touch, or say COLLISION."""
    tree = ik.Tree.load("brokk_hydrolek")
    model = ik.CollisionModel(tree)
    judge = touching(tree, model)
    rng = np.random.default_rng(55)
    crossed = led = 0
    while crossed < 8:
        q = tree.random_q(rng)
        pairs = [sorted(name.split("_")[0] for name in pair) for pair in model.collisions(q)]
        if ["left", "right"] not in pairs:
            continue
        crossed += 1
        points = {tip: T.translation for tip, T in tree.fk(q).items()}
        assert not ik.solve(tree, points, q0=q).iterations and judge(q)  # the crossed answer is one
        found = ik.solve(tree, points, q0=q, avoid_collisions=model)
        assert judge(found.q) == (not found.success)
        led += found.success
    assert led >= 5


def test_obstacles_stop_either_arm():
    tree = ik.Tree.load("brokk_hydrolek")
    goal = {tip: T.translation for tip, T in tree.fk(tree.home).items()}
    free = ik.solve(tree, goal, q0=tree.home)
    for side in (0, 1):
        arm, place = tree.arms[side], tree.places[side]
        data = tree.model.createData()
        pin.forwardKinematics(tree.model, data, tree.to_pinocchio(free.q))
        elbow = data.oMi[tree.model.getJointId(arm.joint_names[3])].translation.copy()
        model = ik.CollisionModel(tree).add_sphere(0.12, elbow, "ball")
        assert any("ball" in pair for pair in model.collisions(free.q)) and len(place) == arm.n
        ball = next(o for o in model.geometry.geometryObjects if o.name == "ball")
        found = ik.solve(tree, goal, q0=tree.home, avoid_collisions=model)
        assert found.success and not touching(tree, model, [ball])(found.q)


@pytest.mark.parametrize("options", [{}, {"closest": True}])
def test_a_budget_holds_for_all_attempts_that_avoid_collisions(options):
    """Every evaluation counts, those of the attempts after a colliding answer too."""
    tree = ik.Tree.load("brokk_hydrolek")
    model = ik.CollisionModel(tree)
    rng = np.random.default_rng(56)
    met = 0
    while met < 3:
        q = tree.random_q(rng)
        if not model.collides(q):
            continue
        met += 1
        goal = {tip: T.translation for tip, T in tree.fk(q).items()}
        needed = ik.solve(tree, goal, q0=q, avoid_collisions=model, **options).fk_evaluations
        for budget in (2, 5, needed - 1, needed, needed + 20):
            found = ik.solve(tree, goal, q0=q, avoid_collisions=model, max_evaluations=budget, **options)
            assert found.fk_evaluations <= budget
            assert model.collides(found.q) == (not found.success)


def test_following_without_limits_stays_near_the_start(tree):
    goal = targets(tree, np.random.default_rng(0), "poses")
    result = ik.solve(tree, goal, q0=tree.home, limits=False, follow=0.2, max_evaluations=60)
    near = 0.2 * np.array([tree.reach if kind == "prismatic" else 1.0 for kind in tree.joint_kinds])
    assert (np.abs(result.q - tree.home) <= near + 1e-12).all()
