"""A joint's limits are what its description says, whatever the robot's size; calls may narrow them, and never widen them."""

import copy
import pickle

import numpy as np
import pytest
from robots import ball, filled, urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, JointNotFound, ModelError, ReadOnlyAttribute

STROKES = (1e-4, 0.5, 30.0, 1e3)
OFFSETS = (0.0, 2e-17, 1e-12, 1e-6, 1e-3, 10.0)


def gantry(stroke, offset, turning=True):
    """Three crossed slides whose origins are `offset` apart, and perhaps a wrist."""
    slide = dict(kind="prismatic", xyz=f"{offset} 0 0", limits=(-stroke, stroke))
    joints = [dict(slide, axis=axis) for axis in ("1 0 0", "0 1 0", "0 0 1")]
    return urdf(*joints, *[dict(kind="revolute", axis="0 0 1", limits=(-2.0, 1.5))] * turning)


@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("stroke", STROKES)
def test_no_stroke_is_lost_for_the_size_of_the_origins(stroke, offset, turning):
    text = gantry(stroke, offset, turning)
    robot = ik.Robot.load(text)
    assert (robot.upper[:3] == stroke).all() and (robot.lower[:3] == -stroke).all()
    rng = np.random.default_rng(1)
    for q in robot.random_q(rng, 3):
        q[:3] *= 0.99
        found = ik.solve(robot, robot.fk(q).translation, tolerance=min(1e-6, 1e-3 * stroke))
        assert found.success and not robot.outside(found.q)
    beyond = ik.solve(robot, robot.fk(robot.home).translation + np.array([3.0 * stroke, 0.0, 0.0]))
    assert not beyond.success


@pytest.mark.parametrize("offset", OFFSETS)
def test_one_slide_keeps_its_stroke(offset):
    robot = ik.Robot.load(urdf(dict(kind="prismatic", axis="1 0 0", xyz=f"0 {offset} 0", limits=(-0.5, 0.5))))
    assert robot.upper[0] == 0.5 and ik.solve(robot, (0.3, offset, 0.0)).success
    beyond = ik.solve(robot, (3.0, offset, 0.0))
    assert beyond.status.name == "UNREACHABLE" and abs(beyond.q[0]) <= 0.5


@pytest.mark.parametrize("size", [1e-4, 1.0, 100.0])
def test_strokes_of_all_lengths_on_arms_of_all_sizes(size):
    """Judged by FK from the text of the URDF, which knows no kernel."""
    for stroke in STROKES:
        text = urdf(
            dict(kind="prismatic", axis="1 0 0", limits=(-stroke, stroke)),
            *[dict(kind="revolute", axis=a, xyz=f"{0.1 * size} 0 {0.3 * size}") for a in ("0 1 0", "0 0 1", "0 1 0")],
        )
        robot = ik.Robot.load(text)
        # Links of that length without mass look like millimetres, and that is all there is to say.
        assert robot.upper[0] == stroke and all("millimetres" in note for note in robot.notes)
        Q = robot.random_q(np.random.default_rng(0), 40)
        found = ik.solve_batch(robot, np.array([robot.fk(q).homogeneous for q in Q]))
        assert found.success.mean() > 0.9
        assert not any(robot.outside(q) for q in found.q)


@pytest.mark.parametrize("left", [2e-17, 1e-12, 1e-9, 1e-8])
def test_a_wrist_whose_offsets_are_rounding_is_taken_and_solved(left):
    """Pinocchio computes far from the wrist, so its own rounding there is larger than these offsets times 1e-9."""
    axes = ("0 0 1", "1 0 0", "0 1 0", "0 0 1")
    places = ("0.4 0.3 0.2", f"{left} 0 0", f"0 {left} 0", f"0 0 {left}")
    joints = [
        dict(kind="revolute", axis=axis, xyz=xyz, rpy=f"0.3 0.2 {0.1 * i}")
        for i, (axis, xyz) in enumerate(zip(axes, places, strict=True), 1)
    ]
    robot = ik.Robot.load(urdf(*joints), base="l1", tip="l4")
    for q in robot.random_q(np.random.default_rng(0), 10):
        assert ik.solve(robot, robot.fk(q)).success


def test_an_arm_far_from_its_base_frame_is_taken():
    """As far as a satellite from the centre of the earth: rounding there is far above 1e-9 of the arm's reach."""
    first = dict(kind="revolute", axis="0 1 0", xyz="-39123456.7 12345678.9 8765432.1", rpy="0.3 0.2 0.1")
    others = [dict(kind="revolute", axis=axis, xyz="0.1 0 0.3", rpy="0.3 0.2 0.1") for axis in ("0 0 1", "0 1 0")]
    assert ik.Robot.load(urdf(first, *others)).reach < 1.0


def test_only_what_means_none_is_no_limit(caplog):
    def slide(low, high, kind="prismatic"):
        return ik.Robot.load(
            urdf(dict(kind=kind, axis="1 0 0", limits=(low, high)), dict(kind="revolute", xyz="1 0 0"))
        )

    for sign in ("-1e16", "1e16"), ("-1e308", "1e308"), ("-1.7976931348623157e308", "1.7976931348623157e308"):
        robot = slide(*sign)
        assert np.isinf([robot.lower[0], robot.upper[0]]).all() and robot.notes == ()
        assert slide(*sign, "revolute").joint_kinds[0] == "continuous"
    caplog.clear()
    for kind in ("prismatic", "revolute"):
        robot = slide(-3e9, 0.5, kind)
        assert robot.lower[0] == -1e6 and robot.upper[0] == 0.5  # narrower than the file's, never wider
        assert "3e+09" in robot.notes[0] and "'j0'" in robot.notes[0] and robot.notes[0] in caplog.text
        assert robot.joint_kinds[0] == kind
        assert robot.with_tool(np.eye(4)).notes == robot.notes
    with pytest.raises(ModelError, match="'j0' moves from 1e\\+07 to 2e\\+07 m"):
        slide(1e7, 2e7)
    assert slide(-999999.0, 999999.0).upper[0] == 999999.0


# ------------------------------------------------------------------------------------------------------- narrower limits
@pytest.fixture(scope="module")
def arm():
    return ik.Robot.load("hydrolek_7w")


def middle_half(robot):
    """Limits of the middle half of each joint's range, by joint."""
    low, high = np.maximum(robot.lower, -3.0), np.minimum(robot.upper, 3.0)
    span = high - low
    return dict(zip(robot.joint_names, zip(low + 0.25 * span, high - 0.25 * span, strict=True), strict=True))


@pytest.mark.parametrize(("name", "solver"), [
    ("hydrolek_7w", "auto"), ("planar_2r", "auto"), ("planar_2r", "dls"), ("inspection_7dof", "auto"), ("inspection_7dof", "lm")
])  # fmt: skip
def test_answers_lie_inside_narrower_limits_and_those_that_exist_are_found(name, solver):
    robot = ik.Robot.load(name)
    limits = middle_half(robot)
    low, high = np.transpose(list(limits.values()))
    Q = np.random.default_rng(0).uniform(low, high, (40, robot.n))
    T = np.array([robot.fk(q).homogeneous for q in Q])
    T = T[:, :3, 3] if name == "planar_2r" else T
    each = [ik.solve(robot, one, solver, limits=limits) for one in T]
    many = ik.solve_batch(robot, T, solver, limits=(low, high))
    bound = ik.Solver(robot, solver, limits=limits)
    listed = ik.solve_all(robot, T[0], limits=limits)
    for q in [*(one.q for one in each), *many.q, *(bound(one).q for one in T), *listed.q]:
        assert (q >= low).all() and (q <= high).all()
    if solver != "dls":
        assert all(one.success for one in each) and many.success.all() and len(listed)
    wide = ik.solve_batch(robot, T, solver).q
    assert ((wide < low) | (wide > high)).any() or name == "hydrolek_7w"  # which has one solution of a pose


def test_a_target_that_narrower_limits_forbid_is_said_to_be_blocked(arm):
    q = np.where(np.isfinite(arm.lower), 0.9 * arm.lower + 0.1 * arm.upper, 0.0)
    joint = arm.joint_names[0]
    found = ik.solve(arm, arm.fk(q), limits={joint: (q[0] + 0.5, None)})
    assert not found.success and joint in found.message and found.robot.lower[0] == q[0] + 0.5
    listed = ik.solve_all(arm, arm.fk(q), limits={joint: (q[0] + 0.5, None)})
    assert not len(listed) and ik.solve_all(arm, arm.fk(q))


def test_paths_and_trackers_stay_inside_narrower_limits(arm):
    joint = arm.joint_names[1]
    a, b = arm.home.copy(), arm.home.copy()
    b[1] += 0.4
    limits = {joint: (None, arm.home[1] + 0.2)}
    T = np.array([arm.fk(q).homogeneous for q in np.linspace(a, b, 9)])
    path = ik.solve_path(arm, T, limits=limits)
    assert np.nanmax(path.curve[:, 1]) <= arm.home[1] + 0.2 and path.robot.upper[1] == arm.home[1] + 0.2
    tracker = ik.Tracker(arm, limits=limits)
    for _ in range(60):
        step = tracker.update(T[-1], 0.02)
        assert step.q[1] <= arm.home[1] + 0.2
    line = ik.line(T[0], T[-1], duration=1.0)
    run = ik.track(arm, line, limits=limits, q0=a, on_limit="leave")
    assert run.q[:, 1].max() <= arm.home[1] + 0.2
    with pytest.raises(InvalidConfiguration, match=joint):
        ik.track(arm, line, limits=limits, q0=b)


def test_the_start_is_treated_as_with_the_robots_own_limits(arm):
    limits = {arm.joint_names[1]: (arm.home[1] - 0.1, arm.home[1] + 0.1)}
    q0 = arm.home.copy()
    q0[1] += 0.3
    assert "clamped" in ik.solve(arm, arm.fk(arm.home), q0=q0, limits=limits).notice
    with pytest.raises(InvalidConfiguration, match=arm.joint_names[1]):
        ik.solve(arm, arm.fk(arm.home), q0=q0, limits=limits, q0_outside="refuse")


def test_trees_and_their_collisions_take_narrower_limits():
    tree = ik.Tree.load("brokk_hydrolek")
    joint = tree.joint_names[0]
    limits = {joint: (tree.home[0] - 0.1, tree.home[0] + 0.1)}
    q = tree.home.copy()
    q[0] += 0.05
    found = ik.solve(tree, tree.fk(q), limits=limits)
    assert found.success and abs(found.q[0] - tree.home[0]) <= 0.1
    made = tree.narrowed(limits)
    assert all(one.upper[one.joint_names.index(joint)] == made.upper[0] for one in made.arms)
    same = pickle.loads(pickle.dumps(made))
    assert (same.upper == made.upper).all() and (copy.deepcopy(made).upper == made.upper).all()


def test_a_model_of_collisions_serves_the_variants_of_its_robot():
    box = '<collision><geometry><box size="0.1 0.1 0.3"/></geometry></collision>'
    text = urdf(*[dict(kind="revolute", axis=axis, xyz="0 0 0.4") for axis in ("0 0 1", "0 1 0", "0 1 0", "1 0 0")])
    robot = ik.Robot.load(filled(text, {"l0": box, "l4": box}))
    model = ik.CollisionModel(robot).add_sphere(0.1, [0.0, 0.5, 0.5])
    limits = {"j0": (-0.5, 0.5)}
    q = np.array([0.2, 0.3, 0.4, 0.1])
    found = ik.solve(robot, robot.fk(q).translation, avoid_collisions=model, limits=limits)
    assert found.success and not model.collides(found.q) and abs(found.q[0]) <= 0.5
    assert ik.solve(robot, robot.fk(q).translation, avoid_collisions=True, limits=limits).success
    with pytest.raises(InvalidOption, match="another Robot"):
        ik.solve(ik.Robot.load(text), robot.fk(q), avoid_collisions=model)


def test_the_variant_is_made_once_and_can_be_varied_further(arm):
    limits = {arm.joint_names[1]: (arm.home[1] - 0.1, arm.home[1] + 0.1)}
    made = arm.narrowed(limits)
    assert arm.narrowed(dict(limits)) is made and arm.narrowed((made.lower, made.upper)) is made
    assert ik.solve(arm, arm.fk(arm.home), limits=limits).robot is made and ik.Solver(arm, limits=limits).robot is made
    assert arm.narrowed({}) is arm and arm.narrowed((None, None)) is arm
    assert (made.home >= made.lower).all() and (made.home <= made.upper).all()
    narrower = made.narrowed({arm.joint_names[0]: (-0.1, 0.1)})
    assert narrower.upper[1] == made.upper[1] and narrower.upper[0] == 0.1
    locked = made.locked({arm.joint_names[0]: 0.0})
    assert locked.upper[0] == made.upper[1] and made.with_tool(np.eye(4)).upper[1] == made.upper[1]
    same = pickle.loads(pickle.dumps(made))
    assert (same.upper == made.upper).all() and np.allclose(same.fk(made.home), arm.fk(made.home))


def test_a_continuous_joint_becomes_one_with_limits():
    robot = ik.Robot.load(urdf(dict(kind="continuous"), dict(kind="continuous", axis="0 1 0", xyz="0.3 0 0"),
                               dict(kind="fixed", xyz="0.3 0 0")))  # fmt: skip
    made = robot.narrowed({"j0": (-1.0, 1.0)})
    assert made.joint_kinds == ("revolute", "continuous") and robot.joint_kinds == ("continuous", "continuous")
    found = ik.solve_batch(robot, np.array([made.fk(q).translation for q in made.random_q(np.random.default_rng(0), 50)]),
                           limits={"j0": (-1.0, 1.0)})  # fmt: skip
    assert found.success.all() and np.abs(found.q[:, 0]).max() <= 1.0


WRONG = [
    ({"j9": (0.0, 1.0)}, JointNotFound, "j9"),
    ({"j0": (0.5, -0.5)}, InvalidOption, "'j0' are reversed: lower 0.5 is above upper -0.5"),
    ({"j0": (-0.5, 9.0)}, InvalidOption, "'j0' can only be narrowed: -0.5 to 9 rad .* own -2 to 2 rad"),
    ({"j1": (-np.inf, 0.1)}, InvalidOption, "'j1' can only be narrowed: -inf to 0.1 m .* own -0.3 to 0.3 m"),
    ({"j0": (np.nan, 0.5)}, InvalidOption, "'j0' must be numbers"),
    ({"j0": 0.5}, InvalidOption, "'j0' must be \\(lower, upper\\)"),
    ({"j0": (0.5,)}, InvalidOption, "'j0' must be \\(lower, upper\\)"),
    ({"j0": ("low", 0.5)}, InvalidOption, "'j0' must be .* numbers or None"),
    ({"j0": ([0.0, 0.1], 0.5)}, InvalidOption, "'j0' must be .* numbers or None"),
    (([0.0], [0.1]), InvalidOption, "lower limits must be 2 numbers, one per joint \\(j0, j1\\)"),
    ([0.0, 0.1, 0.2], InvalidOption, "limits must be True, False, a dict"),
    ("no", InvalidOption, "limits must be True, False, a dict .* not 'no'"),
    (None, InvalidOption, "limits must be True, False, a dict"),
    (1, InvalidOption, "limits must be True, False, a dict"),
]


@pytest.mark.parametrize(("limits", "error", "says"), WRONG)
def test_what_is_no_narrower_range_is_refused_by_every_call(limits, error, says):
    slide = dict(kind="prismatic", axis="1 0 0", xyz="0.2 0 0", limits=(-0.3, 0.3))
    robot = ik.Robot.load(urdf(dict(kind="revolute", limits=(-2.0, 2.0)), slide))
    T = robot.fk([0.1, 0.1])
    line = ik.line(T.translation, T.translation + np.array([0.0, 0.01, 0.0]), duration=0.1)
    calls = [
        lambda: ik.solve(robot, T, limits=limits),
        lambda: ik.Solver(robot, limits=limits),
        lambda: ik.solve_batch(robot, [T.homogeneous], limits=limits),
        lambda: ik.solve_all(robot, T, limits=limits),
        lambda: ik.solve_path(robot, [T.homogeneous], limits=limits),
        lambda: ik.Tracker(robot, limits=limits),
        lambda: ik.track(robot, line, limits=limits),
    ]
    for call in calls:
        with pytest.raises(error, match=says):
            call()


# ----------------------------------------------------------------------------------------------- attributes do not change
def held(arm):
    """Objects that people hold, and what each says to use instead of an assignment."""
    T = arm.fk(arm.home)
    tree = ik.Tree.load("brokk_hydrolek")
    shapes = urdf(dict(kind="revolute"), dict(kind="revolute", axis="0 1 0", xyz="0 0 1"))
    shapes = ik.Robot.load(filled(shapes, {"l0": ball(0.1)}))
    return {
        "robot": (arm, "narrow limits with limits="),
        "tree": (tree, "narrow limits with limits="),
        "variant": (arm.narrowed({arm.joint_names[1]: (arm.home[1], None)}), "narrow limits with limits="),
        "pickled": (pickle.loads(pickle.dumps(arm)), "narrow limits with limits="),
        "solver": (ik.Solver(arm), "make a Solver"),
        "tracker": (ik.Tracker(arm), "use change_limits"),
        "model": (ik.CollisionModel(shapes), "make a new CollisionModel"),
        "result": (ik.solve(arm, T), "make a new one"),
        "batch": (ik.solve_batch(arm, [T.homogeneous]), "make a new one"),
        "solutions": (ik.solve_all(arm, T), "make a new one"),
    }


def test_public_attributes_cannot_be_assigned(arm):
    for name, (thing, instead) in held(arm).items():
        with pytest.raises(ReadOnlyAttribute, match=instead):
            thing.lower = 0.0
        public = [key for key in {**vars(type(thing)), **getattr(thing, "__dict__", {})} if key[0] != "_"]
        data = [
            key for key in public if key not in ("name", "_LOOSE", "_INSTEAD") and not callable(getattr(thing, key))
        ]
        assert data, name
        for key in data:
            with pytest.raises(AttributeError) as refused:
                setattr(thing, key, None)
            assert isinstance(refused.value, ik.IKError) and key in str(refused.value)
            if key in getattr(thing, "__dict__", {}):
                with pytest.raises(ReadOnlyAttribute, match=f"{key} of a .* cannot be deleted"):
                    delattr(thing, key)


def test_arrays_of_a_robot_cannot_be_written(arm):
    for thing in (arm, ik.Tree.load("brokk_hydrolek"), arm.narrowed(middle_half(arm))):
        for name in ("lower", "upper", "home", "rest", "velocity_limits"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(thing, name)[0] = 0.0
        assert isinstance(thing.joint_names, tuple) and isinstance(thing.joint_kinds, tuple)
    model = ik.CollisionModel(ik.Robot.load("planar_2r"), margin=0.01).add_sphere(0.1, (1.2, 0.9, 0.0))
    with pytest.raises(ValueError, match="read-only"):
        model.margins[:] = 0.0


@pytest.mark.parametrize("place", [0, 3])
def test_a_stroke_of_a_thousand_kilometres_does_not_make_an_arm_unsolvable(place):
    """Some files write 999999 m for "far"; the limit stands, and the arm is solved as precisely as with a short one."""
    joints = [dict(kind="revolute", axis=axis, limits=(-2.8, 2.8)) for axis in ("0 0 1", "0 1 0") * 4][:7]
    joints[place] = dict(kind="prismatic", axis="1 0 0", limits=(-999999.0, 999999.0))
    robot = ik.Robot.load(urdf(*joints, dict(kind="fixed")))
    assert (robot.lower[place], robot.upper[place]) == (-999999.0, 999999.0)
    rng = np.random.default_rng(4)
    near = np.minimum(robot.upper, 3.0)
    results = [ik.solve(robot, robot.fk(rng.uniform(-near, near))) for _ in range(15)]
    assert sum(result.success for result in results) >= 14  # none of them with lengths in units of the stroke
    assert not any(robot.outside(result.q) for result in results)


@pytest.mark.parametrize("text", ["1 2", "1,5", "fast", ""])
def test_a_speed_that_is_no_number_is_none_and_said(text):
    source = urdf(dict(kind="revolute"), dict(kind="revolute")).replace('velocity="2"', f'velocity="{text}"', 1)
    robot = ik.Robot.load(source)
    assert robot.velocity_limits.tolist() == [np.inf, 2.0]
    assert any(f'velocity="{text}"> is not a number' in note for note in robot.notes)
