"""Parts of a tracker on hand-made numbers: what a step says, targets in parts, a motion through points."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidTarget
from ik_toolkit.kernel.counted_error import KIND
from ik_toolkit.motion.reference import exp
from ik_toolkit.servo import viability
from ik_toolkit.servo.step import StatusContext, Step, StepStatus, make_outcome
from ik_toolkit.servo.target_jump import Route, timed
from ik_toolkit.servo.target_stream import ARRIVAL, Stream
from ik_toolkit.servo.workspace import new_samples, samples_from

UNITS = np.array([1.0, 2.0])
LEFT, RIGHT = "left_tip", "right_tip"


def step(
    errors=((0.0,) * 6, (0.0,) * 6), code=(0, 0), lost=0.0, down=False, q=(0.0, 0.0), rate=(0.0, 0.0), before=(0.0, 0.0)
):
    """A step of two joints, the second a slide of 2 m a unit, with these errors of two tips."""
    robot = SimpleNamespace(joint_names=("turn", "slide"), chain=SimpleNamespace(unit=UNITS), reach=1.0)
    left, still = np.concatenate(errors), new_samples(2, 2)
    still.T[:] = np.eye(4)
    out = (
        StatusContext(robot, lambda h: 1.0 / h, (True, True), np.ones((2, 2)), 0.5, np.ones(2)),
        np.array(code, np.uint8), np.array(before),
        np.array([left, left]), still.block, 0.01, 0.01, lost, down, True, 0.0, False, None, None,
    )  # fmt: skip
    return Step(np.array(q), np.array(rate), make_outcome(out))


def test_a_step_reports_the_tip_that_is_farthest_off():
    one = step(((0.0, 0.0, 3e-3, 0.0, 0.2, 0.0), (4e-3, 0.0, 0.0, 0.0, 0.0, 0.1)))
    assert one.position_error == pytest.approx(4e-3) and one.orientation_error == pytest.approx(0.2)


def test_what_a_step_that_rests_says():
    turned = ((0.0, 0.0, 0.0, 0.0, 0.1, 0.0), (0.0,) * 6)
    singular, held, both = (
        step(turned, *how)
        for how in (((0, 0), 1.0), ((viability.BIT.position, 0),), ((viability.BIT.position, 0), 1.0))
    )
    assert [s.status for s in (singular, held, both)] == [StepStatus.AT_LIMIT] * 3
    assert "the arm reaches from here" in singular.reason and "the arm reaches from here" in both.reason
    assert "the limits allow" in held.reason and "position limit on turn" in held.reason
    slowly = step(turned, lost=1.0, rate=(5e-4, 0.0))
    assert slowly.status is StepStatus.AT_LIMIT, "it hardly moves"
    assert step(turned, (viability.BIT.row, 0)).status is StepStatus.BLOCKED
    moving = step(turned, lost=1.0, rate=(0.01, 0.0))  # above what counts as rest
    assert moving.status is StepStatus.LIMITED and "hardly get nearer" in moving.reason
    assert step(turned, down=True, rate=(0.01, 0.0)).status is StepStatus.LIMITED
    assert step(lost=1.0, down=True, rate=(0.01, 0.0)).status is StepStatus.OK, "it is at its target"


def test_a_jump_is_told_in_the_joints_own_unit():
    jumped = step(q=(0.0, 3.2), before=(0.0, 1.0))
    assert jumped.status is StepStatus.JUMPED and jumped.reason == "joint slide moved 1.2 in one step"


def arms():
    """A stream of two tips."""
    return Stream(SimpleNamespace(tips=("left", "right"), by_tip=True, check_tips=lambda given: None))


def test_a_long_step_in_parts_turns_about_base_axes_and_keeps_the_twists_course():
    stream, turn = arms(), np.array([0.3, -0.5, 0.4])
    ends = stream.samples
    begin = exp(np.array([[1.0, 0.2, -0.4]]))[0]
    for f in range(2):
        ends.T[0, f, :3, :3], ends.T[1, f, :3, :3] = begin, exp(turn[None])[0] @ begin
        ends.T[0, f, :3, 3], ends.T[1, f, :3, 3] = (0.5, 0.0, 0.0), (0.7, 0.0, -0.1)
    ends.V[1], ends.A[1] = 2.0, 4.0
    parts = stream.divided(4)
    for k, part in enumerate(parts):
        for slot, share in enumerate((0.25 * k, 0.25 * (k + 1))):
            np.testing.assert_allclose(part.T[slot, 1, :3, :3], exp(share * turn[None])[0] @ begin, atol=1e-14)
            np.testing.assert_allclose(part.T[slot, 1, :3, 3], (0.5 + 0.2 * share, 0.0, -0.1 * share), atol=1e-15)
            np.testing.assert_allclose(part.V[slot], 2.0 * share, atol=1e-15)
            np.testing.assert_allclose(part.A[slot], 4.0 * share, atol=1e-15)


def test_errors_are_those_from_the_last_of_the_targets(planar):
    stepper, twists = ik.Tracker(planar).stepper, np.zeros((3, 6))
    stepper.prepare((KIND.pose,))
    T = np.array([[planar.fk(q).homogeneous] for q in ([0.3, 0.2], [0.5, 0.4], [0.7, 0.6])])
    all_three, first, last = (
        stepper.error_at(np.zeros(2), samples_from(T[some], twists[some], twists[some]), 0.01).copy()
        for some in (slice(None), slice(1), slice(2, None))
    )
    assert np.array_equal(all_three, last) and np.abs(all_three - first).max() > 0.1


def test_twists_by_tip_are_in_the_order_of_the_tips():
    stream = arms()
    found = stream._motion({"right": np.arange(6.0), "left": (7.0, 8.0, 9.0)}, "twist")
    assert found.tolist() == [7.0, 8.0, 9.0, 0.0, 0.0, 0.0, *range(6)]
    assert stream._motion({"right": np.arange(6.0)}, "twist").tolist() == [0.0] * 6 + list(range(6))


def test_the_longest_of_the_last_times_between_targets_is_kept_for_a_while():
    stream = arms()
    stream.pace = 0.05
    for dt in (0.01, 0.03, *[0.02] * 8):
        assert stream.pace == 0.05
        stream._keep_pace(dt)
    assert stream.pace == 0.03
    stream.forget()
    assert stream.pace == 0.0
    stream, at = Stream(ik.Robot.load("planar_2r")), np.array([1.0, 0.5, 0.0])
    for dt in (0.02, 0.01, 0.02, *[0.01] * (ARRIVAL.recent - 1)):  # The second 0.02 s begin the count anew.
        stream.take(1, at, None, None, dt)
        stream.take(0, at, None, None, 0.015)  # This is no time between targets.
        assert stream.pace == 0.02
    stream.take(1, at, None, None, 0.01)
    assert stream.pace == 0.01


def test_targets_are_taken_as_they_come_in_every_form():
    """Arrays as they are, everything else after a check: the pose of one tip, and the position of the other."""
    rng = np.random.default_rng(2)
    poses = [pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(6)]
    places = rng.normal(size=(6, 3))
    forms = (
        lambda T, x: {LEFT: T.homogeneous, RIGHT: x},
        lambda T, x: {RIGHT: x.tolist(), LEFT: T},
        lambda T, x: [T.homogeneous, x],
        lambda T, x: (T, x),
        lambda T, x: {RIGHT: x, LEFT: T.homogeneous},
        lambda T, x: [T.homogeneous.astype(np.float32).astype(np.longdouble), x],
    )
    stream = Stream(ik.Tree.load("brokk_hydrolek", tips=[LEFT, RIGHT]))
    for k, (form, T, x) in enumerate(zip(forms, poses, places, strict=True)):
        assert stream.take(1, form(T, x), None, None, 0.01)
        stream.step_on()
        np.testing.assert_allclose(stream.samples.T[1, 0], T.homogeneous, atol=1e-6)
        np.testing.assert_allclose(stream.samples.T[1, 1, :3, 3], x, atol=1e-12)
        assert np.array_equal(stream.samples.T[1, 1, :3, :3], np.eye(3))
        before = poses[k - 1].translation if k else T.translation
        np.testing.assert_allclose(stream.samples.T[0, 0, :3, 3], before, atol=1e-6)
    T, x = poses[0].homogeneous, places[0]
    for place in places[:2]:  # Without a step in between, the last target stays.
        assert stream.take(1, [T, place], None, None, 0.01)
        np.testing.assert_allclose(stream.samples.T[0, 0, :3, 3], poses[5].translation, atol=1e-6)
    for wrong in ({LEFT: x, RIGHT: x}, [x, T], [T, T], {LEFT: T}, [T, x, x], {LEFT: T, RIGHT: x, "middle": x}):
        with pytest.raises(IKError):
            stream.take(1, wrong, None, None, 0.01)
    assert not stream.take(1, [T, np.full(3, np.nan)], None, None, 0.01)
    alone = Stream(ik.Robot.load("planar_2r"))
    for x in places:
        assert alone.take(1, x, None, None, 0.01) and alone.samples.T[1, 0, :3, 3].tolist() == x.tolist()
    with pytest.raises(InvalidTarget, match="targets of one kind"):
        alone.take(1, T, None, None, 0.01)


@pytest.mark.parametrize("seed", range(4))
def test_a_motion_through_points_at_its_hardest_and_fastest(seed):
    """What the ends and the middle of its pieces say is what fine differences of the cubics find."""
    rng = np.random.default_rng(seed)
    t, q, rate = np.array([0.0, 0.5, 0.8, 1.8]), rng.normal(size=(4, 2)), rng.normal(size=(4, 2))
    most, quickest = 0.0, np.abs(rate).max()
    for k in range(3):
        h, f = t[k + 1] - t[k], np.linspace(0.0, 1.0, 2001)[:, None]
        x = (
            (1 + 2 * f) * (1 - f) ** 2 * q[k] + f * (1 - f) ** 2 * h * rate[k]
            + f * f * (3 - 2 * f) * q[k + 1] + f * f * (f - 1) * h * rate[k + 1]
        )  # fmt: skip
        most = max(most, np.abs(np.diff(x, 2, axis=0)).max() * (2000 / h) ** 2)
        quickest = max(quickest, np.abs(x[1001] - x[999]).max() * 1000 / h)
    route = Route(t, q, rate)
    assert route.hardest(np.ones(2)) == pytest.approx(most, rel=5e-3)
    assert route.fastest(np.ones(2)) == pytest.approx(quickest, rel=1e-4)


def test_a_motion_through_points_begins_as_the_joints_move():
    points = np.linspace([0.0, 0.0], [1.0, 0.5], 25)
    limits = np.array([[-9.0, -9.0], [9.0, 9.0], [1.0, 1.0], [4.0, 4.0]])
    rest, on = (timed(points, np.array(rate), limits, 1.0) for rate in ((0.0, 0.0), (0.6, 0.3)))
    np.testing.assert_allclose(on.rate[0], [0.6, 0.3], rtol=1e-12)
    assert not rest.rate[0].any() and not on.rate[-1].any() and on.t[-1] < rest.t[-1]
