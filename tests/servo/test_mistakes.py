"""What a caller of the tracking room can get wrong is refused in words that say what would be right."""

import numpy as np
import pytest
import robots
from references import line_of

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.servo.methods import Method

SLACK = (0.01,) * 3 + (0.0,) * 3


def line(robot):
    return line_of(robot, robot.home, (-0.1, 0.0, 0.0), 0.2, "constant", free=True)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (dict(elbow=1), "elbow is a dict from joint names to 1 or -1, not 1"),
        (dict(elbow={"joint_3": 1}), r"elbow: no joint 'joint_3'\. Did you mean 'joint_\d'"),
        (dict(elbow={"joint_2": 2}), "elbow of joint_2 must be 1 or -1, not 2"),
        (dict(elbow={"joint_2": [1, 1]}), "elbow of joint_2 must be 1 or -1"),
        (dict(avoid_limits=-1.0), "must not be negative"),
        (dict(manipulability=-1.0), "must not be negative"),
        (dict(posture=([0.0, 0.0], -1.0)), "the rate of posture must not be negative"),
        (dict(posture=np.zeros(3)), "posture"),
        (dict(cost=3.0), "cost is a function of q, not float"),
        (dict(on_limit="clip", slack=SLACK), "slack is kept by the constrained step, so on_limit cannot be 'clip'"),
    ],
)
def test_options_of_a_tracker(planar, options, said):
    with pytest.raises((InvalidOption, InvalidConfiguration), match=said):
        ik.Tracker(planar, **options).update(planar.fk(planar.home).translation, 0.01)


def test_methods(planar):
    with pytest.raises(InvalidOption, match=r"no tracking method 'aac'\. Did you mean 'a"):
        ik.Tracker(planar, "aac")
    with pytest.raises(InvalidOption, match=r"reading must be 1, 2 or 3 .*, not 4"):
        Method("aa", reading=4)
    for reading in (1, 2, 3):
        assert Method("aa", reading=reading).reading == reading


def test_what_is_followed(planar, tree):
    with pytest.raises(InvalidTarget, match=r"track follows a Reference .*, not tuple"):
        ik.track(planar, (0.1, 0.2, 0.0))
    start = tree.fk(tree.home)
    each = {tip: ik.line(start[tip], start[tip], duration=1.0) for tip in tree.tips}
    first, second = tree.tips
    wanted = f"track follows a dict of References, one for each of {first}, {second}"
    with pytest.raises(InvalidTarget, match=f"{wanted}, not Reference"):
        ik.track(tree, each[first])
    only = f"{first}: Reference"
    for given, said in (({first: each[first]}, only), (each | {second: start[second]}, f"{only}, {second}: SE3")):
        with pytest.raises(InvalidTarget, match=f"{wanted}, not {{{said}}}$"):
            ik.track(tree, given)
    longer = ik.line(start[second], start[second], duration=2.0)
    with pytest.raises(InvalidTarget, match=r"must last equally long, not \[1.0, 2.0\] s"):
        ik.track(tree, {first: each[first], second: longer})


@pytest.mark.parametrize(
    ("part", "place", "factor", "said"),
    [
        (0, (3, 3), 1.0 + 1e-6, "is no pose"),
        (0, np.s_[:3, 0], 1.01, "is no pose"),  # stretched
        (0, np.s_[:3, 0], -1.0, "is no pose"),  # mirrored
        (0, np.s_[:], 0.0, "is no pose"),
        (0, (0, 3), np.nan, "is not finite"),
        (1, 0, np.inf, "is not finite"),
        (2, 0, np.nan, "is not finite"),
        (0, (0, 3), 1e200, r"is not finite, or beyond 1e\+100,"),  # its square would not be
        (1, 0, 1e200, r"is not finite, or beyond 1e\+100,"),
        (0, np.s_[:3, 0], 1.0 + 1e-9, ""),  # As far off as rounding, they are poses.
    ],
)
def test_numbers_of_a_reference(part, place, factor, said):
    """Wrong from t = 0.1 s on, which is said."""
    robot = robots.load("hydrolek_7w")

    def function(t):
        values = (
            np.tile(robot.fk(robot.home).homogeneous, (len(t), 1, 1)),
            np.full((len(t), 6), 1e-9),
            np.zeros((len(t), 6)),
        )
        for k in np.flatnonzero(t > 0.095):
            values[part][k][place] *= factor
        return values

    reference = ik.Reference(function, 0.2, name="mine")
    if not said:
        assert ik.track(robot, reference).success
        return
    with pytest.raises(InvalidTarget, match=rf"reference 'mine' {said}.* at t = 0.1 s"):
        ik.track(robot, reference)


def test_dt_and_stretch(planar):
    with pytest.raises(InvalidOption, match=r"dt = 0.5 s is longer than the reference \(0.2 s\)"):
        ik.track(planar, line(planar), dt=0.5)
    with pytest.raises(InvalidOption, match="slack is kept by the constrained step"):
        ik.track(planar, line(planar), on_limit="clip", slack=SLACK)
    assert ik.track(planar, line(planar), on_limit="leave", slack=SLACK).success
    with pytest.raises(InvalidConfiguration, match=r"q0 is outside the limits of joint_2; move it inside or use"):
        ik.track(planar, line(planar), q0=[0.0, planar.upper[1] + 0.1])
