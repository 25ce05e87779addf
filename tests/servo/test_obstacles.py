"""Obstacles: for any requested rates, nothing static is touched, and the arm comes to rest inside its limits."""

import numba
import numpy as np
import pytest
from robots import have_data, load

import ik_toolkit as ik
from ik_toolkit.robot.geometry import distance
from ik_toolkit.servo import collision_guard, viability
from ik_toolkit.servo.collision_guard import Guard
from ik_toolkit.servo.step import StepStatus

DATA = pytest.mark.skipif(not have_data(), reason="example-robot-data is not installed (extra 'robots')")
SLOW = (DATA, pytest.mark.slow)  # its meshes take time to test exactly
EVEN = np.full(150, 0.01)  # [s] lengths of steps
# A step of 10 us after one of 50 ms may hardly change the rates: the brake must have room for it.
WIDE = 10.0 ** np.random.default_rng(11).uniform(-5.0, np.log10(0.05), 400)
SHORT_THEN_LONG = 10.0 ** np.random.default_rng(0).uniform(-5.0, np.log10(0.05), 250)
CHANGING = np.random.default_rng(5).choice([0.001, 0.01, 0.05], 300)
# Robot, gamma, acceleration, lengths of steps, seed of the way, for how many steps it has a goal, whether rows are obeyed.
# Without the rows, the proof has to hold it back.
WAYS = [
    ("hydrolek_7w", 1.0, 10.0, EVEN, 1, 25, True), ("hydrolek_7w", 1.0, 10.0, EVEN, 2, 60, False),
    ("hydrolek_7w", 1.0, np.inf, EVEN, 3, 25, True), ("hydrolek_7w", 1.0, np.inf, EVEN, 4, 25, False),
    ("hydrolek_7w", 1.0, 2.0, EVEN, 3, 25, True), ("hydrolek_7w", 1.0, 2.0, EVEN, 4, 25, False),
    ("hydrolek_7w", 1.0, 2.0, WIDE, 1, 100, False), ("planar_2r", 0.5, 10.0, EVEN, 1, 25, True),
    ("planar_2r", 0.5, 10.0, EVEN, 2, 60, False), ("two_arms", 1.0, 10.0, EVEN, 1, 25, True),
    ("two_arms", 1.0, 10.0, EVEN, 2, 60, False), ("two_arms", 1.0, 10.0, WIDE, 1, 100, False),
    ("two_arms", 0.5, 2.0, SHORT_THEN_LONG, 0, 60, False), ("two_arms", 0.6, 10.0, SHORT_THEN_LONG, 0, 60, False),
    ("two_arms", 1.0, 10.0, CHANGING, 0, 40, False), ("two_arms", 0.6, np.inf, CHANGING, 0, 40, False),
    *[pytest.param(*way, marks=marks) for way, marks in (
        (("panda", 0.5, 10.0, EVEN, 1, 25, True), DATA), (("panda", 0.5, 10.0, EVEN, 2, 60, False), DATA),
        (("ur5", 0.5, 10.0, EVEN, 1, 25, True), SLOW), (("ur5", 0.5, 10.0, EVEN, 2, 60, False), SLOW),
    )],
]  # fmt: skip


def scene(name):
    """A robot, boxes where its tips can be, and a start that touches none of them."""
    robot = load(name)
    model, rng, size = ik.CollisionModel(robot), np.random.default_rng(8), 0.1 * robot.reach
    while len(model.obstacles) < 5:
        q = robot.random_q(rng)
        for arm, place in zip(robot.arms, robot.places, strict=True):
            model.add_box((size, 2.0 * size, size), arm.fk(q[place]).translation)
    start = next(q for q in (robot.random_q(rng) for _ in range(200)) if not model.collides(q))
    return robot, model, start


def limits_of(robot, acceleration):
    """Speed and acceleration limits; the position limits stay out of the way."""
    far = np.full(robot.n, 100.0)
    return np.array([-far, far, np.full(robot.n, 2.0), np.full(robot.n, acceleration)])


def step(q, rate, x, gamma, h, limits):
    """Where a wanted rate leads inside speed and acceleration limits."""
    w = np.clip(np.clip(x, rate - limits[3] * h, rate + limits[3] * h), -limits[2], limits[2])
    return q + h * ((1.0 - gamma) * rate + gamma * w), w


def inside_rows(x, A, b):
    """Rates near x that obey the rows, by projecting on one after the other."""
    for _ in range(20):
        for k in np.flatnonzero(A @ x > b):
            x = x - A[k] * max(A[k] @ x - b[k], 0.0) / (A[k] @ A[k])
    return x


def between(q, rate, q1, gamma, h, count=4):
    """Joint values on the way, as the methods assume it."""
    begin = q1 - q if gamma == 1.0 else h * rate
    return [q + begin * f + (q1 - q - begin) * f * f for f in np.arange(1, count + 1) / count]


def drive(robot, model, want, steps, h=0.01, gamma=1.0, acceleration=10.0, q=None, obey=True):
    """Run a guard over rates want(k, q); returns states (N + 1, n), smallest distance and how many steps were not allowed."""
    limits = limits_of(robot, acceleration)
    guard = Guard(robot, model, limits, gamma)
    guard.late = np.max(h)
    q, rate = (robot.home if q is None else q).copy(), np.zeros(robot.n)
    assert guard.restart(q) is None
    Q, refused = [q], 0
    for k in range(steps):
        dt = h if np.isscalar(h) else h[k]
        count = guard.rows(q, rate, dt)
        x = want(k, q)
        x = inside_rows(x, guard.A[:count], guard.b[:count]) if obey else x
        q1, rate1 = step(q, rate, x, gamma, dt, limits)
        if not guard.allows(q, rate, q1, rate1, dt):
            refused += 1
            q1, rate1 = guard.brake(q, rate, dt)
        for x in between(q, rate, q1, gamma, dt):
            assert not model.collides(x)
        assert (np.abs(rate1 - rate) <= acceleration * dt * (1 + 1e-9) + 1e-12).all()
        q, rate = q1, rate1
        Q.append(q)
    return np.array(Q), refused


def wanderer(robot, seed, hold=25):
    """Rates towards one random configuration after the other."""
    rng, goal = np.random.default_rng(seed), []

    def want(k, q):
        if k % hold == 0:
            goal[:] = [robot.random_q(rng)]
        return np.clip(5.0 * (goal[0] - q), -2.0, 2.0)

    return want


@pytest.mark.parametrize(("name", "gamma", "acceleration", "h", "seed", "hold", "obey"), WAYS)
def test_no_contact_on_random_ways(name, gamma, acceleration, h, seed, hold, obey):
    robot, model, q = scene(name)
    Q, refused = drive(robot, model, wanderer(robot, seed, hold), len(h), h, gamma, acceleration, q, obey)
    if obey:
        assert np.abs(np.diff(Q, axis=0)).sum() > 3.0  # it does move
    else:
        assert refused or name in ("ur5", "hydrolek_7w")


def ball_in_the_way(gap):
    """planar_2r stretched out along x, and a ball beside its second link, gap [m] away."""
    robot = load("planar_2r")
    q = np.array([0.0, 0.5])
    model = ik.CollisionModel(robot)
    end = robot.fk(q).translation
    low = 0.0
    high = 1.0
    for _ in range(60):  # bisection on where the ball stands
        y = 0.5 * (low + high)
        one = ik.CollisionModel(robot).add_sphere(0.1, end + np.array([-0.2, 0.1 + y, 0.0]), "ball")
        d = min(near.distance for near in one.distances(q) if "ball" in near.pair)
        low, high = (y, high) if d < gap else (low, y)
    return robot, model.add_sphere(0.1, end + np.array([-0.2, 0.1 + high, 0.0]), "ball"), q


@pytest.mark.parametrize("gap", [1e-3, 1e-4])
def test_a_start_a_hair_off_is_no_contact_and_no_prison(gap):
    robot, model, q = ball_in_the_way(gap)
    Q, refused = drive(robot, model, lambda k, q: np.array([1.0, 0.0]), 50, q=q)
    assert model.distances(Q[-1])[0].distance > 0.5 * min(gap, 5e-3)
    Q, refused = drive(robot, model, lambda k, q: np.array([-1.0, 0.0]), 50, q=q)
    assert refused == 0 and Q[-1, 0] < -0.3  # away from it, at full speed


def test_it_slides_along_and_keeps_its_distance():
    robot, model, q = ball_in_the_way(0.2)
    Q, refused = drive(robot, model, lambda k, q: np.array([1.0, 0.0]), 150, q=q)
    d = [min(near.distance for near in model.distances(x) if "ball" in near.pair) for x in Q]
    assert refused == 0 and min(d) > 0.0045 and d[-1] < 0.02


def test_a_thin_sheet_is_not_jumped_over(tmp_path):
    """Steps of 50 ms at 2 rad/s move the tip by 0.2 m: any number of samples would miss 0.1 mm."""
    robot = load("planar_2r")
    q = np.array([0.0, 0.3])
    at = robot.fk(q).translation
    model = ik.CollisionModel(robot).add_box((6.0, 1e-4, 1.0), at + np.array([0.0, 0.4, 0.0]), "sheet")
    for seed in range(10):
        x = np.random.default_rng(seed).uniform(0.5, 2.0, 2)
        Q, refused = drive(robot, model, lambda k, q, x=x: x, 30, h=0.05, acceleration=20.0, q=q, obey=False)
        assert refused and robot.fk(Q[-1]).translation[1] < at[1] + 0.6


def test_a_refused_step_ends_at_rest_and_names_the_pair():
    robot, model, q = ball_in_the_way(0.3)
    limits = limits_of(robot, 5.0)
    guard = Guard(robot, model, limits, 1.0)
    assert guard.restart(q) is None
    rate, refused = np.zeros(2), 0
    for _ in range(200):
        q1, rate1 = step(q, rate, np.array([1.0, 0.0]), 1.0, 0.01, limits)
        if guard.allows(q, rate, q1, rate1, 0.01):
            assert guard.blocked is None
        else:
            refused += 1
            assert guard.blocked == ("link_2", "ball")
            q1, rate1 = guard.brake(q, rate, 0.01)
            assert (np.abs(rate1) <= np.maximum(np.abs(rate) - 0.05, 0.0) + 1e-12).all()
        q, rate = q1, rate1
    assert refused > 10 and np.abs(rate).max() < 0.1 and not model.collides(q)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_joint_near_its_limit_brakes_before_it_though_another_brakes_for_longer(way):
    robot, model, _ = ball_in_the_way(0.3)
    limits = limits_of(robot, 10.0)
    limits[:2, 0], limits[3, 1] = np.sort((0.1 * way, -5.0 * way)), 0.5
    guard, q, rate = Guard(robot, model, limits, 1.0), np.zeros(2), np.array([way, 1.0])
    guard.restart(q)
    while rate.any():
        q, rate = guard.brake(q, rate, 0.01)
    assert 0.0 < way * q[0] <= 0.1 < q[1]


@pytest.mark.parametrize("gamma", [0.5, 0.6, 1.0])
def test_a_step_in_which_a_joint_reverses_counts_there_and_back(gamma):
    robot, model, q = ball_in_the_way(0.5)
    rates, h = np.array([[1.0, 0.2], [-1.0, 0.3]]), 0.01
    q1 = q + h * ((1.0 - gamma) * rates[0] + gamma * rates[1])
    way = np.array([q, *between(q, rates[0], q1, gamma, h, 1000)])
    path = Guard(robot, model, limits_of(robot, 10.0), gamma)._follow(np.array([q, q1]), rates, h)
    np.testing.assert_allclose(path.length[1], np.abs(np.diff(way, axis=0)).sum(axis=0), rtol=1e-4)


def test_what_is_added_later_counts():
    robot, model, q = ball_in_the_way(0.5)
    guard = Guard(robot, model, limits_of(robot, 10.0), 1.0)
    assert guard.restart(q) is None
    one = np.zeros(2)
    assert guard.rows(q, one, 0.01) == 0 and guard.allows(q, one, q, one, 0.01)
    model.add_sphere(0.2, robot.fk(q).translation + np.array([0.0, 0.1, 0.0]), "late")
    assert guard.rows(q, one, 0.01) > 0 and ("link_2", "late") in guard.pairs
    aside = q + np.array([2.0, 0.0])
    assert guard.restart(aside) is None and guard.rows(aside, one, 0.01) == 0 and guard.pairs == []
    model.add_sphere(0.2, robot.fk(q), "knot")  # around the tip: it touches, and nothing is allowed but to hold
    assert guard.restart(q) == ("link_2", "knot")
    assert not guard.allows(q, one, q + 0.001, np.full(2, 0.1), 0.01)
    held, still = guard.brake(q, one, 0.01)
    assert np.array_equal(held, q) and not still.any()


# ----------------------------------------------------------------------------------------------------------- in a tracker
def dragged(robot, model, q, targets, dt=0.02, **options):
    """Steps of a tracker along targets; every move between two of them is free and keeps the limits."""
    tracker = ik.Tracker(robot, q0=q, acceleration_limits=10.0, avoid_collisions=model, **options)
    steps, before, rate = [], q, np.zeros(robot.n)
    for target in targets:
        steps.append(one := tracker.update(target, dt))
        for x in between(before, rate, one.q, tracker.engine.gamma, dt):
            assert not model.collides(x) and not robot.outside(x)
        assert (np.abs(one.rate - rate) <= 10.0 * dt * (1 + 1e-9) + 1e-12).all()
        assert (np.abs(one.rate) <= robot.velocity_limits * (1 + 1e-9)).all()
        before, rate = one.q, one.rate
    return steps


def box_beside(robot):
    """A box where the tip comes when the first joint turns, and targets from home into its middle, and a while there."""
    T, aside, home = robot.fk(robot.home), robot.home.copy(), robot.home
    up, down = robot.upper[0] - home[0], home[0] - robot.lower[0]
    aside[0] += min(0.8 * up, 0.8) if up > down else -min(0.8 * down, 0.8)
    goal, size = robot.fk(aside).translation, 0.2 * robot.reach
    model = ik.CollisionModel(robot).add_box((size, size, size), goal, "box")
    assert not model.collides(robot.home)
    targets = [T.translation + min((k + 1) / 60, 1.0) * (goal - T.translation) for k in range(120)]
    return T, model, targets


@pytest.mark.parametrize(("name", "method"), [("hydrolek_7w", "aad"), *([("panda", "cv")] if have_data() else [])])
def test_a_target_in_a_box_is_not_reached(name, method):
    robot = load(name)
    q = robot.home
    T, model, targets = box_beside(robot)
    steps = dragged(robot, model, q, targets, method=method)
    assert steps[-1].position_error > 0.01 and "box would touch" in steps[-1].reason
    left = model.distances(steps[-1].q, 0.1)
    assert min(near.distance for near in left if "box" in near.pair) < 0.03  # it went as near as is kept
    away = dragged(robot, model, steps[-1].q, [T.translation] * 80, method=method)
    assert away[-1].position_error < 1e-3


def test_what_stands_before_a_wall_is_blocked_by_it():
    """Stretched out in a plane there is no way around: the arm stays, says why, and leaves without delay."""
    robot = load("planar_2r")
    q = np.array([0.0, 0.5])
    p = robot.fk(q).translation
    model = ik.CollisionModel(robot).add_box((6.0, 0.1, 1.0), p + np.array([0.0, 0.4, 0.0]), "wall")
    there = [p + np.array([-0.1, min(0.02 * k, 1.0), 0.0]) for k in range(150)]
    steps = dragged(robot, model, q, there)
    assert all("link_2 and wall would touch" in one.reason for one in steps[-20:])
    assert any(one.status is StepStatus.BLOCKED for one in steps)
    tracker = ik.Tracker(robot, q0=steps[-1].q, acceleration_limits=10.0, avoid_collisions=model)
    tracker.update(there[-1], 0.02)
    one = [tracker.update(p - np.array([0.1, 0.0, 0.0]), 0.02) for _ in range(3)][-1]
    assert np.abs(one.rate).max() > 0.1


def test_arms_of_a_tree_stay_off_each_other():
    """Both hands to one place: the arms come near each other and stop there."""
    tree = load("two_arms")
    at = {tip: T.translation for tip, T in tree.fk(tree.home).items()}
    middle = 0.5 * sum(at.values())
    model = ik.CollisionModel(tree)
    targets = [
        {tip: p + min(k / 40, 1.0) * (2.2 * middle - 1.2 * p - p) * 0.5 for tip, p in at.items()} for k in range(70)
    ]
    steps = dragged(tree, model, tree.home, targets)
    assert np.abs(steps[-1].q - tree.home).max() > 0.05


def test_what_is_far_changes_nothing():
    robot = load("hydrolek_7w")
    reference = ik.circle(robot.fk(robot.home), 0.05, duration=1.0)
    plain = ik.track(robot, reference, dt=0.02)
    careful = ik.track(robot, reference, dt=0.02, avoid_collisions=ik.CollisionModel(robot).add_sphere(0.1, (9, 9, 9)))
    assert np.array_equal(plain.q, careful.q) and plain.status is careful.status


@DATA
def test_near_its_own_links_the_arm_slows_down_and_does_not_stop_and_go():
    robot = ik.Robot.load("ur5")
    tracker = ik.Tracker(robot, "ca", avoid_collisions=ik.CollisionModel(robot, margin=0.05))
    steps = [tracker.update(robot.fk([2.78, -5.3, -1.2, 0.78, 5.87, -3.48]), 0.02) for _ in range(90)]
    assert sum(one.between is not None for one in steps) > 20
    assert min(np.abs(one.rate / robot.velocity_limits).max() for one in steps) > 0.1
    assert not any(one.status is StepStatus.BLOCKED or "acceleration" in one.reason for one in steps)


@pytest.mark.parametrize("on_limit", ["slow", "leave", "clip"])
def test_a_run_stops_before_what_is_in_its_way(on_limit):
    robot = load("hydrolek_7w")
    T, model, targets = box_beside(robot)
    line = ik.line(T.translation, targets[-1], duration=2.0)
    result = ik.track(robot, line, dt=0.02, on_limit=on_limit, max_stretch=2, avoid_collisions=model)
    assert not result.success and (result.limited & viability.BIT.row).any()
    limits, contacts = ((result.limited & bits > 0).any(axis=1).sum() for bits in (7, viability.BIT.row))
    assert result.between == result.to_dict()["between"] and "box" in result.between
    pair = "between '{}' and '{}'".format(*result.between)
    assert f"A contact ahead {pair} held the robot back in {contacts} of {len(result.limited)} steps" in result.message
    assert ("A joint limit was active" in result.message) == (limits > 0)
    assert result.figures["time_at_limits"] == pytest.approx(0.02 * limits)
    assert not any(model.collides(q) for q in result.q)


def test_measured_into_a_contact_it_holds():
    robot, model, q = ball_in_the_way(0.3)
    tracker = ik.Tracker(robot, q0=q, avoid_collisions=model)
    there = next(x for a in np.linspace(0.2, 1.5, 30) if model.collides(x := q + np.array([a, 0.0])))
    assert tracker.update(robot.fk(q).translation, 0.01, q=there).status is StepStatus.FOLLOWING_ERROR
    one = tracker.update(robot.fk(q).translation, 0.01, q=there)
    assert one.status is StepStatus.JUMPED and np.array_equal(one.q, there) and not one.rate.any()
    two = tracker.update(robot.fk(q).translation, 0.01, q=there)
    assert two.status is StepStatus.BLOCKED and "ball" in two.reason and np.array_equal(two.q, there)


def test_no_target_and_limits_that_change():
    """A tracker that holds, or whose limits are changed, still touches nothing."""
    robot, model, q = ball_in_the_way(0.1)
    tracker = ik.Tracker(robot, q0=q, acceleration_limits=5.0, avoid_collisions=model)
    p = robot.fk(q).translation
    for k in range(120):
        if k == 40:
            tracker.change_limits(speed={"joint_1": 0.0})
        if k == 80:
            tracker.change_limits(speed=2.0, upper={"joint_1": q[0] - 0.05})
        one = tracker.update(p * np.nan if k % 30 > 24 else p + np.array([-0.2, 0.01 * k, 0.0]), 0.01)
        assert not model.collides(one.q)
        assert (one.status is StepStatus.HELD) == (k % 30 > 24)
    assert one.q[0] <= q[0] + 0.2


@pytest.mark.parametrize("method", ["cv", "aad"])
def test_nothing_is_left_to_compile_in_a_control_loop(method, monkeypatch):
    """Every kernel a guard calls was called before with arguments of these types: a new type would be compiled for seconds."""
    known, new, bound = set(), set(), []

    def noted(kernel):
        def call(*arguments):
            key = kernel.__name__, *(numba.typeof(one) for one in arguments)
            (new if bound and key not in known else known).add(key)
            return kernel(*arguments)

        return call

    for module, names in ((collision_guard, ("along",)), (distance, ("levers", "rows", "free_until"))):
        for name in names:
            monkeypatch.setattr(module, name, noted(getattr(module, name)))
    robot, model, q = scene("hydrolek_7w")
    rate, limits = np.zeros(robot.n), limits_of(robot, np.inf if method == "aad" else 10.0)
    guard = Guard(robot, model, limits, 0.5 if method == "aad" else 1.0)
    bound.append(True)
    guard.restart(q)
    rng, refused = np.random.default_rng(3), 0
    for k in range(300):
        h = (0.01, 0.02)[k % 2]
        guard.late = 0.02
        guard.rows(q, rate, h)
        wanted = np.clip(rate + rng.normal(size=robot.n) * (0.2 if k % 40 else 2.0), -1.0, 1.0)
        q1 = q + h * ((1.0 - guard.gamma) * rate + guard.gamma * wanted)
        if guard.allows(q, rate, q1, wanted, h):
            q, rate = q1, wanted
        else:
            refused += 1
            before = q
            q, rate = guard.instead(q, rate, q1, wanted, h)
            if guard.gamma == 1.0:
                np.testing.assert_allclose(rate, (q - before) / h, atol=1e-12)
    assert refused and {key[0] for key in known} == {"along", "levers", "rows", "free_until"}
    assert not new
