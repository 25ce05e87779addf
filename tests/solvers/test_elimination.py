"""Every solution of six revolute joints: found, certified, never falsely certified, and what `solve` concludes from it."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
import robots
from serial_arms import anywhere, away

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, UnknownSolver
from ik_toolkit.kernel.elimination import binding
from ik_toolkit.kernel.elimination.binding import answers, arm_tip, make_arm, make_forms
from ik_toolkit.kernel.elimination.decomposition import splits_of
from ik_toolkit.kernel.elimination.terms import VERDICT

ARMS = ["hydrolek_7w", "continuous_mix", "locked", *(["ur5", "z1", "kinova"] if robots.have_data() else [])]


def arm_of(kind, seed, scale=1.0):
    """Numbers of a random arm of a kind: axes that are parallel, meet, or neither."""
    rng = np.random.default_rng(seed)
    axes, points = rng.normal(size=(6, 3)), np.cumsum(rng.normal(size=(6, 3)) * 0.3, axis=0)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    if kind == "parallel shoulder":
        axes[1:4] = axes[1]
    elif kind == "four parallel":
        axes[0:4] = axes[1]
    elif kind == "two wrists":
        points[:3], points[3:] = points[0], points[4]
    elif kind == "one point":
        points[:] = 0.0
    elif kind == "wrist":
        axes[2], points[3:] = axes[1], points[4]
    elif kind in ("right angles", "symmetric"):
        axes = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0]], float)
    # Axes 1 and 2 meet, there is a wrist, and no joint tells the two solutions of the shoulder apart.
    if kind == "symmetric":
        points = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 1], [1, 0, 1]], float)
    # the dimensions of a Fanuc CRX-10iA: joints 4 and 5 have two solutions for each value of joint 6
    if kind == "offset wrist":
        axes = np.array([[0, 0, 1], [0, 1, 0], [0, -1, 0], [-1, 0, 0], [0, -1, 0], [-1, 0, 0]], float)
        points = np.array([[0, 0, 0], [0, 0, 245], [0, 0, 785], [0, 0, 785], [540, 0, 785], [0, -150, 785]]) / 1000.0
    T = np.eye(4)
    T[:3, 3] = scale * (points[5] + 0.1)
    return make_arm(axes, scale * points, T)


def ask(arm, Q, forms=None):
    """Solutions (a list of arrays) and verdicts for the poses of the tip at Q (N, 6)."""
    forms = make_forms(arm) if forms is None else forms
    found = answers(forms, arm, np.array([arm_tip(arm, q) for q in Q]))
    count, verdict, _, roots, complex_roots = found[:, 0, :5].T
    assert (count == roots - complex_roots)[
        verdict == VERDICT.certain
    ].all()  # every root that is not complex has its solution
    return [one[1 : 1 + int(one[0, 0]), :6] for one in found], verdict


def lost(lists, Q, within):
    """Whether (N,) the configuration that a pose was made from is not listed."""
    return np.array([not (len(one) and away(one, q).min() < within) for one, q in zip(lists, Q, strict=True)])


def jacobian(robot, q):
    return robot.chain.forward(q, jacobian=True)[1][0]


def fold(robot, q, joint):
    """Configuration where the Jacobian is singular as one joint moves on from q, or None; by bisection of its determinant."""

    def value(x):
        return np.linalg.det(jacobian(robot, np.r_[q[:joint], x, q[joint + 1 :]]))

    grid = np.linspace(-np.pi, np.pi, 60)
    signs = np.sign([value(x) for x in grid])
    (changes,) = np.nonzero(signs[1:] != signs[:-1])
    if not len(changes):
        return None
    low, high = grid[changes[0]], grid[changes[0] + 1]
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.sign(value(middle)) == signs[changes[0]] else (low, middle)
    return np.r_[q[:joint], low, q[joint + 1 :]]


# ----------------------------------------------------------------------------------------------------- solutions and verdicts
@pytest.mark.parametrize("kind", ["general", "offset wrist", "parallel shoulder", "wrist"])
def test_the_first_decomposition_or_an_ordering_tried_once_lists_what_was_planted(kind, monkeypatch):
    """Not the best of all on twelve poses, so that it is quick uncompiled, as scripts/mutate.py needs it."""
    monkeypatch.setattr(binding, "CHOICE", binding.CHOICE._replace(poses=1))
    arm, Q = arm_of(kind, 2), np.random.default_rng(1).uniform(-np.pi, np.pi, (3, 6))
    splits = [*splits_of(arm)]
    lists, verdicts = ask(arm, Q, np.array(splits[:1]) if splits else make_forms(arm))
    assert not lost(lists, Q, 1e-6).any() and (verdicts == VERDICT.certain).all()


@pytest.mark.parametrize(("kind", "most_open"), [
    ("general", 0), ("parallel shoulder", 1), ("wrist", 2), ("right angles", 1), ("symmetric", 8), ("offset wrist", 1),
])  # fmt: skip
def test_planted_solutions_are_listed_and_certified(kind, most_open):
    Q = np.random.default_rng(1).uniform(-np.pi, np.pi, (100, 6))
    for seed in (2, 3):
        arm = arm_of(kind, seed)
        lists, verdicts = ask(arm, Q)
        missing = lost(lists, Q, 1e-5)
        assert missing.sum() <= 1 and not (missing & (verdicts == VERDICT.certain)).any()
        assert (verdicts != VERDICT.certain).sum() <= most_open
        for one, q in zip(lists, Q, strict=True):
            goal = arm_tip(arm, q)
            assert all(np.abs(arm_tip(arm, x) - goal).max() < 1e-9 for x in one)
            assert all(away(one[k + 1 :], one[k]).min(initial=1.0) > 1e-7 for k in range(len(one)))


@pytest.mark.parametrize("kind", ["general", "wrist", "right angles"])
def test_two_ways_to_read_the_loop_give_the_same_solutions(kind):
    arm, Q = arm_of(kind, 5), np.random.default_rng(6).uniform(-np.pi, np.pi, (60, 6))
    forms, both = make_forms(arm), 0
    assert len(forms) > 1 and (forms[0, :2] != forms[1, :2]).any()
    (first, a), (second, b) = ask(arm, Q, forms[:1]), ask(arm, Q, forms[1:2])
    for one, other, sure in zip(first, second, (a == VERDICT.certain) & (b == VERDICT.certain), strict=True):
        if sure:
            both += 1
            assert len(one) == len(other) and all(away(other, q).min() < 1e-6 for q in one)
    assert both > 50


@pytest.mark.parametrize(("kind", "scale"), [
    ("general", 1.0), ("parallel shoulder", 1.0), ("wrist", 1.0), ("right angles", 1.0), ("symmetric", 1.0), ("offset wrist", 1.0),
    ("general", 1e-3), ("wrist", 1e3),
])  # fmt: skip
def test_a_certificate_is_never_false_on_hard_targets(kind, scale):
    """Joints at half a turn, lattices of right angles, and wrists that are straight or almost so."""
    arm, rng = arm_of(kind, 7, scale), np.random.default_rng(8)
    forms = make_forms(arm)
    half = rng.uniform(-np.pi, np.pi, (60, 6))
    half[rng.random((60, 6)) < 0.4] = np.pi
    straight = rng.uniform(-np.pi, np.pi, (60, 6))
    straight[:, 4] = rng.choice([0.0, np.pi], 60) + np.repeat([0.0, 1e-9, 1e-7, 1e-5, 1e-3, 1e-2], 10)
    for Q in (half, rng.choice([0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi], (100, 6)), straight):
        lists, verdicts = ask(arm, Q, forms)
        assert not (lost(lists, Q, 1e-3) & (verdicts == VERDICT.certain)).any()


def test_a_continuum_is_never_certified():
    Q = np.random.default_rng(9).uniform(-np.pi, np.pi, (40, 6))
    assert (ask(arm_of("four parallel", 10), Q)[1] != VERDICT.certain).all()
    for kind in ("two wrists", "one point"):  # no way to read the loop is left
        assert (ask(arm_of(kind, 10), Q)[1] != VERDICT.certain).all()
    Q[:, 4] = 0.0  # a straight wrist: joints 4 and 6 turn about one axis
    assert (ask(arm_of("symmetric", 11), Q)[1] != VERDICT.certain).all()


@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix"])
def test_crossing_a_fold_changes_the_number_of_solutions_by_two(name):
    robot, rng, changes = robots.load(name), np.random.default_rng(13), []
    for q in filter(lambda q: q is not None, (fold(robot, rng.uniform(-np.pi, np.pi, 6), 2) for _ in range(12))):
        push, counts = np.linalg.svd(jacobian(robot, q))[0][:, -1] * 1e-4, []
        for sign in (1.0, -1.0):
            T = robot.fk(q).homogeneous
            T[:3, :3] = pin.exp3(sign * push[3:]) @ T[:3, :3]
            T[:3, 3] += sign * push[:3]
            found = ik.solve_all(robot, T, "elimination", limits=False)
            assert found.complete
            counts.append(len(found))
        changes.append(abs(counts[0] - counts[1]))
    assert {*changes} <= {0, 2} and changes.count(2) >= 9  # where the curve of poses turns back here, the number stays


# -------------------------------------------------------------------------------------------------------------- all solutions
@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix"])
def test_many_starts_find_no_other_solution(name):
    robot = robots.load(name)
    for q in robots.sample(robot, 4, seed=14)[0]:
        T = robot.fk(q).homogeneous
        listed = ik.solve_all(robot, T, limits=False)
        searched = ik.solve_all(robot, T, "lm", limits=False, starts=1000)
        assert listed.complete and listed.solver == "elimination" and not searched.complete
        assert all(away(listed.q, one).min() < 1e-4 for one in searched.q)


@pytest.mark.parametrize("name", ARMS)
def test_solutions_keep_the_limits_nearest_first_and_say_what_was_accounted_for(name):
    robot = robots.load(name)
    for q in robots.sample(robot, 10, seed=15)[0]:
        found = ik.solve_all(robot, robot.fk(q), "elimination", q0=q)
        assert away(found.q, q).min() < 1e-6 and (np.diff(found.distance) >= 0.0).all()
        assert np.abs(found.q[0] - q).max() < 1e-6 or found.distance[0] < 1e-6
        assert (found.q >= robot.lower).all() and (found.q <= robot.upper).all()
        said = found.certificate
        assert found.complete == (said.status == "CERTAIN")
        if found.complete:
            assert said.solutions == said.roots - said.complex >= len(found)
            assert "no other solution" in said.message
        assert pickle.loads(pickle.dumps(found)).certificate == said == found.keep(slice(0, 1)).certificate


def test_what_is_left_out_has_no_certificate():
    robot = robots.load("hydrolek_7w")
    T = robot.fk(robots.sample(robot, 1, seed=16)[0][0])
    assert ik.solve_all(robot, T.homogeneous[:3, 3]).certificate is None  # a position leaves infinitely many
    assert ik.solve_all(robot, T, mask=(1, 1, 1, 1, 1, 0)).certificate is None


def test_a_singular_pose_is_a_family_or_has_merged_solutions():
    robot, families, merged = robots.load("locked"), 0, 0
    for joint in range(6):  # a wrist or shoulder that is straight: two axes in one line
        for value in (0.0, 0.5 * np.pi, -0.5 * np.pi):
            q = robot.home + 0.1
            q[joint] = value
            if np.linalg.svd(jacobian(robot, q))[1][-1] < 1e-9:
                found = ik.solve_all(robot, robot.fk(q), "elimination", q0=q, limits=False, starts=200)
                assert len(found) > 0 and (found.certificate.status == "FAMILY") == bool(found.families)
                assert found.complete == (found.certificate.status == "CERTAIN")
                families += bool(found.families)
                merged += found.complete and away(found.q, q).min() < 1e-3
    assert families and merged


def test_a_batch_lists_what_single_targets_do():
    """Also where a list is not certain, at a singular pose, and where the target is out of reach."""
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(4)
    solver, T = ik.Solver(robot), [robot.fk(robot.random_q(rng)).homogeneous for _ in range(6)]
    T.insert(2, robot.fk(fold(robot, robot.home, 2)).homogeneous)
    T[4][0, 3] += 9.0
    for q0 in (None, robot.random_q(rng)):
        many = solver.all(np.array(T), q0)
        assert len(many) == 7 and set(many.complete) == {True, False}
        # joined before and after each list is made
        for name in ("q", "distance", "position_error", "orientation_error"):
            assert np.array_equal(getattr(many, name), np.concatenate([getattr(one, name) for one in many]))
        for k, pose in enumerate(T):
            one = solver.all(pose, q0)
            assert np.array_equal(many[k].q, one.q) and many[k].to_dict() == one.to_dict()
            near = robot.home if q0 is None else q0
            assert np.allclose(one.distance, np.linalg.norm(one.q - near, axis=1))
            assert (np.diff(one.distance) >= 0).all()
    assert [len(one) for one in solver.all(np.array(T), count=1)] == [min(len(solver.all(pose)), 1) for pose in T]
    T[3][0, 3] = np.nan
    with pytest.raises(ik.IKError):
        solver.all(np.array(T))


def test_rotations_with_few_digits_are_solved_too():
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(17)
    for q in robots.sample(robot, 5, seed=18)[0]:
        T = robot.fk(q).homogeneous
        T[:3, :3] += rng.uniform(-2e-7, 2e-7, (3, 3))
        found = ik.solve_all(robot, T, q0=q)
        assert found.complete and away(found.q, q).min() < 1e-4


def test_axes_through_one_point_are_refused_and_solved_by_the_search():
    """Such an arm has no size, and rounding would be all that its solutions depend on."""
    axes = ("0 0 1", "0 1 0", "1 0 0", "0 0 1", "0 1 0", "1 0 0")
    joints = (dict(kind="revolute", axis=axis, xyz="0 0 0", limits=(-3, 3)) for axis in axes)
    robot = ik.Robot.load(robots.urdf(*joints))
    with pytest.raises(UnknownSolver, match="one point"):
        ik.Solver(robot, "elimination")
    found = ik.solve_all(robot, robot.fk(robot.home + 0.3), starts=20)
    assert len(found) and not found.complete and found.certificate is None


@pytest.mark.parametrize(
    ("name", "words"), [("planar_3r", "3 joints"), ("mimic_mix", "mimic"), ("inspection_7dof", "7 joints")]
)
def test_what_it_is_not_for(name, words):
    robot = robots.load(name)
    with pytest.raises(UnknownSolver, match=words):
        ik.Solver(robot, "elimination")
    with pytest.raises(InvalidOption, match="positions"):
        ik.solve(robots.load("hydrolek_7w"), [0.8, 0.0, 0.3], "elimination")


# ------------------------------------------------------------------------------------------------------------------- decisions


def test_a_target_that_only_limits_forbid_is_proven_blocked():
    robot, rng, proven = robots.load("hydrolek_7w"), np.random.default_rng(19), 0
    hard, free = ik.Solver(robot, "lm", restarts=300), ik.Solver(robot, "lm", limits=False)
    for _ in range(10):
        T = anywhere(robot, rng)
        result = ik.solve(robot, T)
        least = result.blocked
        if least is None:
            continue
        proven += 1
        assert result.status == ik.Status.LIMIT_BLOCKED and result.solver == "elimination"
        assert robot.errors(least.q, T)[0] < 1e-8 and least.joint in robot.outside(least.q)
        every = ik.solve_all(robot, T, limits=False)
        assert every.complete and len(every) == least.solutions
        worst = [np.maximum(robot.lower - q, q - robot.upper).max() for q in every.q]
        assert min(worst) == pytest.approx(least.excess, abs=1e-6)
        assert all(word in result.message for word in (least.joint, "certified", str(least.solutions)))
        assert not hard(T).success and free(T).success
        assert (result.q >= robot.lower).all() and (result.q <= robot.upper).all()
        assert result.position_error == pytest.approx(robot.errors(result.q, T)[0])
        assert len(ik.solve_all(robot, T)) == 0 and ik.solve_all(robot, T).complete
    assert proven >= 8


def test_a_target_out_of_reach_is_proven_so():
    robot, rng, proven, turned = robots.load("hydrolek_7w"), np.random.default_rng(20), 0, 0
    search = ik.Solver(robot, "lm", limits=False, restarts=300)
    for _ in range(20):
        T = anywhere(robot, rng)
        T[:3, 3] = rng.uniform(-0.5, 0.5, 3) * robot.reach
        result = ik.solve(robot, T)
        if result.status == ik.Status.UNREACHABLE and result.solver == "elimination":
            proven += 1
            assert "no joint values reach this pose" in result.message and result.blocked is None
            alone = ik.solve(robot, T[:3, 3]).success
            assert ("the position alone can be reached" in result.message) == alone
            turned += alone
            assert not search(T).success and len(ik.solve_all(robot, T, limits=False)) == 0
    assert proven >= 3 and turned > 0


@pytest.mark.parametrize("name", ["hydrolek_7w", "continuous_mix"])
def test_nothing_is_proven_of_a_target_that_tolerances_still_reach(name):
    """A little beyond a fold no exact solution exists, but one within the tolerances does."""
    robot, rng, none = robots.load(name), np.random.default_rng(21), 0
    search = ik.Solver(robot, "lm", limits=False, restarts=1000)
    for _ in range(120):
        q = fold(robot, rng.uniform(-np.pi, np.pi, 6), int(rng.integers(1, 5)))
        if q is None:
            continue
        T = robot.fk(q).homogeneous
        T[:3, 3] += np.linalg.svd(jacobian(robot, q))[0][:3, -1] * rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-8, -6)
        exact = ik.solve_all(robot, T, "elimination", limits=False, tolerance=1e-11)
        if exact.complete and not len(exact) and search(T).success:
            none += 1
            result = ik.solve(robot, T)
            assert result.status != ik.Status.UNREACHABLE or result.solver != "elimination"
    assert none >= 1


def test_a_solution_that_three_attempts_miss_is_found():
    robot = robots.load("continuous_mix")
    _, T = robots.sample(robot, 600, seed=22)
    solver, few = ik.Solver(robot), ik.Solver(robot, restarts=2)
    missed = [t for t in T if not few(t).success]
    assert missed
    found = [solver(t) for t in missed]
    assert all(one.success and one.solver == "elimination" and "elimination" in one.message for one in found)
    assert all((one.q >= robot.lower).all() and (one.q <= robot.upper).all() for one in found)


@pytest.mark.parametrize("options", [
    dict(solver="lm"), dict(restarts=249), dict(max_evaluations=5000), dict(slack=(0, 0, 0, 0, 0, 1e-3)), dict(wrap=False),
    dict(joint_weights=(1, 1, 1, 1, 1, 0.5)),
])  # fmt: skip
def test_it_is_asked_only_where_nothing_else_is_asked_for(options):
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(23)
    for _ in range(3):
        result = ik.solve(robot, anywhere(robot, rng), **options)
        assert result.solver == "lm" and result.blocked is None


def test_a_bound_solver_that_decides_is_copied_and_pickled():
    robot, rng = robots.load("hydrolek_7w"), np.random.default_rng(24)
    T, solver = anywhere(robot, rng), ik.Solver(robot)
    result, again = solver(T), pickle.loads(pickle.dumps(solver))(T)
    assert result.status == again.status == ik.Status.LIMIT_BLOCKED and result.q.tobytes() == again.q.tobytes()
    copy = pickle.loads(pickle.dumps(result))
    assert copy.message == result.message and copy.blocked.joint == result.blocked.joint


def test_a_list_of_which_all_collide_is_still_all():
    robot = ik.Robot.load("ur5")
    T = robot.fk(robot.home + 0.3).homogeneous
    around = ik.CollisionModel(robot).add_sphere(0.15, T[:3, 3], name="ball")
    found = ik.solve_all(robot, T, avoid_collisions=around)
    assert len(found) == 0 and found.complete and "2 of them collide and are left out" in found.message
    assert "restarts" not in found.message  # nothing else could be found
