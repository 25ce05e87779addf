"""The interface for control loops: `Tracker.update` and its statuses."""

import numpy as np
import pinocchio as pin
import pytest
from references import Q0, panda_reference

import ik_toolkit as ik
from ik_toolkit.errors import FrameNotFound, InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.robot.robot import Robot
from ik_toolkit.servo.run import track
from ik_toolkit.servo.step import StepStatus
from ik_toolkit.servo.tracker import Tracker


@pytest.mark.parametrize("method", ["cv", "ca", "aad", pytest.param("dls", marks=pytest.mark.slow)])
def test_updates_equal_a_run(panda, method):
    ref = panda_reference(panda, True, 1.0)
    run = track(panda, ref, method, dt=0.01, q0=Q0, acceleration_limits=10.0, on_limit="leave")
    T, V, A = ref.at(run.t)
    tracker = Tracker(panda, method, q0=Q0, acceleration_limits=10.0, on_limit="leave")
    tracker.reset(Q0, T[0], V[0], A[0])
    for i in range(1, len(run.t)):
        step = tracker.update(T[i], 0.01, V[i], A[i])
        assert np.array_equal(step.q, run.q[i])
    assert step.position_error == run.position_error[-1]
    assert step.orientation_error == pytest.approx(run.orientation_error[-1])


def test_step_statuses(panda):
    tracker = Tracker(panda, "cv", q0=Q0, acceleration_limits=20.0)
    T = panda.fk(Q0).homogeneous
    assert tracker.update(T, 0.01).status is StepStatus.OK
    far = T.copy()
    far[:3, 3] += (0.1, 0.1, 0.0)
    tracker.update(far, 0.01)
    step = tracker.update(far, 0.01)
    assert step.status is StepStatus.LIMITED and "acceleration limit on panda_joint" in step.reason
    broken = T.copy()
    broken[0, 3] = np.nan
    speeds = []
    for _ in range(40):
        step = tracker.update(broken, 0.01)
        speeds.append(np.abs(step.rate).max())
        assert step.status is StepStatus.HELD and "target is not finite" in step.reason and np.isfinite(step.q).all()
    assert speeds[-1] == 0.0 and speeds[0] > 0.0
    for _ in range(200):
        step = tracker.update(far, 0.01)
    assert step.status is StepStatus.OK and step.reason == "" and step.position_error < 1e-6


def test_a_number_that_is_none_anywhere_in_a_pose_is_held_against(panda):
    tracker = Tracker(panda, "aad", q0=Q0)
    T = panda.fk(Q0).homogeneous
    tracker.update(T, 0.01)
    for place in np.ndindex(3, 4):
        broken = T.copy()
        broken[place] = np.nan
        assert tracker.update(broken, 0.01).status is StepStatus.HELD, place
        assert np.isfinite(tracker.update(T, 0.01).q).all()


def test_updates_without_twist_and_with_uneven_steps(panda):
    """A stream of bare targets: the twist comes from the last two, and the step length may vary."""
    ref = panda_reference(panda, True, 6.0)
    tracker = Tracker(panda, "cv", q0=Q0)
    rng = np.random.default_rng(0)
    t, worst = 0.0, 0.0
    while t < 5.0:
        dt = rng.uniform(0.005, 0.015)
        t += dt
        step = tracker.update(ref.target(t), dt)
        worst = max(worst, step.position_error if t > 1.0 else 0.0)
    assert 0.0 < worst < 1e-4  # a target moves up to 1.5 mm in a step


@pytest.mark.parametrize(
    "options",
    [{}, {"free_turn": "z"}, {"priority": "orientation"}, {"mask": (0, 0, 0, 1, 1, 1)}, {"frame": "target"}],
    ids=str,
)
def test_a_stream_that_begins_with_a_target_that_is_not_finite(panda, options):
    """A camera that has not seen its target yet: the arm holds, whatever the options say of positions and orientations."""
    for nothing, target in ((np.full((4, 4), np.nan), panda.fk(Q0)), (np.full(3, np.nan), panda.fk(Q0).translation)):
        if options and nothing.ndim == 1:
            target = panda.fk(Q0)  # these options are about orientation, and a position has none
        held = Tracker(panda, "cv", q0=Q0, **options)
        step = held.update(nothing, 0.01)
        assert step.status is StepStatus.HELD and np.array_equal(step.q, Q0)
        assert held.update(target, 0.01).status is StepStatus.OK


@pytest.mark.parametrize("method", ["cv", "dls"])
def test_an_orientation_that_does_not_count_has_no_error(panda, method):
    """Published methods and solvers alike: for a position, or a mask without rotations, there is no orientation error."""
    T = panda.fk(Q0).homogeneous
    only = {"mask": (1, 1, 1, 0, 0, 0)}
    for target, options in ((T[:3, 3], {}), (T[:3, 3], only), (T, only)):
        step = Tracker(panda, method, q0=Q0, **options).update(target, 0.01)
        assert step.orientation_error is None and step.position_error < 1e-9
    assert Tracker(panda, method, q0=Q0).update(T, 0.01).orientation_error is not None
    run = track(panda, ik.line(T[:3, 3], T[:3, 3] + 0.01, duration=0.2), method, q0=Q0, on_limit="leave")
    assert run.orientation_error is None and "deg" not in run.message


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, 2.5, 2.9, np.pi - 1e-9])
def test_the_twist_between_two_targets_is_that_of_the_turn_between_them(panda, angle):
    """However large the turn: the step is the one for that twist given, axes of the base."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    first = panda.fk(Q0)
    turned = pin.SE3(pin.exp3(angle * axis) @ first.rotation, first.translation + np.array([1e-3, 0.0, -2e-3]))
    left_out, given = Tracker(panda, "cv", q0=Q0), Tracker(panda, "cv", q0=Q0)
    for tracker in (left_out, given):
        tracker.update(first, 0.01, np.zeros(6))
    step = left_out.update(turned, 0.01)
    wanted = given.update(turned, 0.01, np.concatenate([[0.1, 0.0, -0.2], 100.0 * angle * axis]))
    assert np.allclose(step.q, wanted.q, rtol=0.0, atol=1e-9) and np.allclose(
        step.rate, wanted.rate, rtol=0.0, atol=1e-7
    )


def test_a_twist_of_a_tip_without_its_angular_part_does_not_turn(panda):
    """Three numbers are a velocity: they are not repeated as an angular one."""
    tip, steps = panda.tip, []
    for twist in (np.r_[0.1, 0.2, 0.3, np.zeros(3)], np.array([0.1, 0.2, 0.3])):
        tracker = Tracker(panda, q0=Q0)
        tracker.update(panda.fk(Q0), 0.01, twist={tip: twist})
        steps.append(tracker.update(panda.fk(Q0), 0.01, twist={tip: twist}))
    assert np.array_equal(steps[0].q, steps[1].q)


def test_limits_that_are_refused_change_nothing(panda):
    tracker = Tracker(panda, q0=Q0)
    for limits, words in (
        ({"lower": 2.0, "upper": 1.0}, "above"),
        ({"speed": -0.1}, "speed must be numbers of at least 0"),
        ({"speed": 1.0, "acceleration": -1.0}, "acceleration must be numbers of at least 0"),
        ({"upper": 1.0, "speed": {"panda_joint1": [1.0, 2.0]}}, "panda_joint1 must be a number"),
        ({"lower": float("nan")}, "lower must be numbers, not"),
        ({"lower": 9.0}, "above"),
        ({"upper": {"elbow": 1.0}}, "elbow"),
        ({"acceleration": "high"}, "acceleration must be a number or 7 numbers"),
    ):
        with pytest.raises(InvalidOption, match=words):
            tracker.change_limits(**limits)
    assert tracker.update(panda.fk(Q0), 0.01).status.name == "OK"


def test_mistakes_in_the_loop_are_typed(panda):
    tracker, there = Tracker(panda, q0=Q0), panda.fk(Q0)
    with pytest.raises(InvalidTarget, match="not shape"):
        tracker.update(np.zeros(4), 0.01)
    with pytest.raises(FrameNotFound, match="'tip' is not one of the tips"):
        tracker.update({"tip": np.eye(4)}, 0.01)
    for target in ("home", None, [[1, 2], [3]], object()):
        with pytest.raises(InvalidTarget, match=r"4x4 pose or a position|fields of a ROS message"):
            tracker.update(target, 0.01)
    tracker.update(there, 0.01)
    for target in (there.homogeneous.T.copy(), np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([2.0, 0.5, 1.0, 1.0])):
        with pytest.raises(InvalidTarget, match=r"last row|rotation"):
            tracker.update(target, 0.01)
    with pytest.raises(InvalidTarget, match="one kind"):
        tracker.update(np.zeros(3), 0.01)
    # without numbers the kind does not matter
    for nothing in (np.full(3, np.nan), [np.nan] * 3, np.full((4, 4), np.nan)):
        assert tracker.update(nothing, 0.01).status.name == "HELD"
    for given, words in (
        ({"twist": np.zeros(2)}, "twist"),
        ({"acceleration": "fast"}, "acceleration must have 6 values"),
        ({"twist": {panda.tip: np.zeros(4)}}, rf"twist of {panda.tip} must have 6 values, or 3, not shape \(4,\)"),
    ):
        with pytest.raises(InvalidTarget, match=words):
            tracker.update(there, 0.01, **given)
    for dt in (0.0, -1.0, np.nan, np.inf, None, "slow", [0.01]):
        with pytest.raises(InvalidOption, match="dt"):
            tracker.update(there, dt)
    for given in ("low", None):
        with pytest.raises(InvalidOption, match="cost must return"):
            Tracker(panda, q0=Q0, cost=lambda q, given=given: given).update(there, 0.01)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (dict(method="cw"), "Did you mean 'cv'"),
        (dict(method="newton"), "'newton' is a solver that cannot track; methods that can: cv, "),
        (dict(on_limit="slow"), r"no on_limit 'slow'; 'slow' is for ik\.track\."),
        (dict(avoid_limts=True), "Did you mean 'avoid_limits'"),
        (dict(method="aa", damping=float("nan")), "damping"),
    ],
)
def test_mistakes_at_construction_are_typed(panda, options, words):
    with pytest.raises(InvalidOption, match=words):
        Tracker(panda, **options)


@pytest.mark.parametrize("method", ["cv", "av", "ca", "aa", "aad"])
def test_steps_of_uneven_length_calm_an_error(panda, method):
    """Gains that are best for each step by itself let ca swing by a centimetre for ever."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        q0 = panda.home + rng.uniform(-0.1, 0.1, 7)
        T = panda.fk(q0).homogeneous
        tracker = Tracker(panda, method, q0=q0, rate0=np.zeros(7))
        tracker.update(T, 0.01)
        T[:3, 3] += rng.normal(scale=1e-3, size=3)
        errors = [tracker.update(T, rng.uniform(0.005, 0.015)).position_error for _ in range(400)]
        assert max(errors[100:]) < 1e-6


def test_at_rest_before_what_no_joint_can_do():
    """A planar arm and a target above its plane: nothing moves, no limit holds, and that is not OK."""
    robot = Robot.load("planar_3r")
    q0 = np.array([0.3, 0.9, 0.5])
    T = robot.fk(q0).homogeneous
    tracker = Tracker(robot, q0=q0)
    tracker.update(T, 0.01)
    T[2, 3] += 0.03
    steps = [tracker.update(T, 0.01) for _ in range(100)]
    assert steps[-1].position_error == pytest.approx(0.03) and np.abs(steps[-1].rate).max() < 1e-12
    assert steps[-1].status is StepStatus.AT_LIMIT and steps[-1].reason == "about as close as the arm reaches from here"
    T[2, 3] -= 0.03
    T[0, 3] -= 0.01
    steps = [tracker.update(T, 0.01) for _ in range(100)]
    assert steps[-1].status is StepStatus.OK and steps[-1].position_error < 1e-6


def test_a_step_in_another_unit_is_refused_before_anything_changes(panda):
    """It was taken in 20 million parts."""
    tracker, target = Tracker(panda), panda.fk(panda.home).homogeneous
    tracker.update(target, 0.01)
    q = tracker.q.copy()
    with pytest.raises(
        InvalidOption, match=r"1e\+06: 20,000,000 parts of at most 0.05 s, 5 times the first one. Was another unit"
    ):
        tracker.update(target, 1e6)
    np.testing.assert_array_equal(tracker.q, q)
    assert tracker.update(target, 60.0).status is StepStatus.OK  # a minute's pause is none
    given = Tracker(panda, dt_max=1e-4)
    with pytest.raises(InvalidOption, match=r"600,000 parts of at most 0.0001 s, which is dt_max. Was another unit"):
        given.update(target, 60.0)


def test_fast_rates_at_the_start_are_no_angles(caplog):
    """99 rad/s was doubted as 15.8 turns."""
    robot = Robot.load("planar_2r")
    Tracker(robot, rate0=[99.0, -99.0])
    assert not caplog.records
    with pytest.raises(InvalidConfiguration, match="rate0 must be finite"):
        Tracker(robot, rate0=[np.nan, 0.0])
    with pytest.raises(InvalidConfiguration, match="rate0 must have 2 values"):
        Tracker(robot, rate0=[1.0])
