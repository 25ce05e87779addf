"""What a caller of the tracking room can get wrong is refused in words that say what would be right."""

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import InvalidConfiguration, InvalidOption, InvalidTarget
from ik_toolkit.servo.methods import Method


@pytest.fixture(scope="module")
def flat():
    return robots.load("planar_2r")


@pytest.fixture(scope="module")
def tree():
    return robots.load("two_arms")


def line(robot):
    start = robot.fk(robot.home).translation
    return ik.line(start, start - np.array([0.1, 0.0, 0.0]), duration=0.2)


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
        (dict(cost=3.0), "cost is a function of q, not float"),
        (dict(on_limit="clip", slack=(0.01,) * 3 + (0.0,) * 3), "slack is kept by the constrained step"),
    ],
)
def test_options_of_a_tracker(flat, options, said):
    with pytest.raises(InvalidOption, match=said):
        ik.Tracker(flat, **options).update(flat.fk(flat.home).translation, 0.01)


def test_methods(flat):
    with pytest.raises(InvalidOption, match=r"no tracking method 'aac'\. Did you mean 'a"):
        ik.Tracker(flat, "aac")
    with pytest.raises(InvalidOption, match=r"reading must be 1, 2 or 3 .*, not 4"):
        Method("aa", reading=4)
    for reading in (1, 2, 3):
        assert Method("aa", reading=reading).reading == reading


def test_a_start_in_contact(flat):
    model = ik.CollisionModel(flat).add_sphere(0.2, flat.fk(flat.home).translation, name="ball")
    with pytest.raises(InvalidConfiguration, match=r"at q0 '.*' touches 'ball'; start where nothing touches"):
        ik.Tracker(flat, avoid_collisions=model)


def test_what_is_followed(flat, tree):
    with pytest.raises(InvalidTarget, match=r"track follows a Reference .*, not tuple"):
        ik.track(flat, (0.1, 0.2, 0.0))
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


@pytest.mark.parametrize("what", ["last row", "stretched", "mirrored", "not finite", "right"])
def test_poses_of_a_reference(what):
    """Wrong from t = 0.1 s on, which is said; as far off as rounding, they are poses."""
    robot = robots.load("hydrolek_7w")
    right = robot.fk(robot.home).homogeneous

    def function(t):
        T = np.repeat(right[None], len(t), axis=0)
        late = t > 0.095
        if what == "last row":
            T[late, 3, 3] = 1.0 + 1e-6
        elif what == "stretched":
            T[late, :3, 0] *= 1.01
        elif what == "mirrored":
            T[late, :3, 0] *= -1.0
        elif what == "not finite":
            T[late, 0, 3] = np.nan
        else:
            T[:, :3, 0] *= 1.0 + 1e-9
        return T, np.zeros((len(t), 6)), np.zeros((len(t), 6))

    reference = ik.Reference(function, 0.2, name="mine")
    if what == "right":
        assert ik.track(robot, reference).success
        return
    said = "is not finite" if what == "not finite" else "is no pose"
    with pytest.raises(InvalidTarget, match=rf"reference 'mine' {said}.* at t = 0.1 s"):
        ik.track(robot, reference)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([0.0, 1.0], r"times must be 3 numbers, one per pose, not an array of shape \(2,\)"),
        ([0.0, np.nan, 1.0], r"times has a value that is not finite \(number 2\)"),
        ([0.0, 2.0, 1.0], "times must increase: number 3 is 1 after 2"),
        ([0.0, 1.0, 1.0], "times must increase: number 3 is 1 after 1"),
    ],
)
def test_times_of_waypoints(times, said):
    with pytest.raises(InvalidTarget, match=said):
        ik.waypoints([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.1, 0.0]], times=times)


def test_files_of_references(tmp_path):
    from ik_toolkit.motion.waypoints import reference_from_file

    with pytest.raises(InvalidTarget, match="a reference file is named by a path, not list"):
        reference_from_file([1])
    file = tmp_path / "one.npz"
    np.savez(file, t=[0.0], xyz=[[0.1, 0.2, 0.3]])
    with pytest.raises(InvalidTarget, match=r"'one.npz' has 1 row\(s\); a path needs at least 2"):
        reference_from_file(file)
    np.savez(file, t=[0.0, 1e-101, 1.0], xyz=np.zeros((3, 3)))
    with pytest.raises(InvalidTarget, match=r"one.npz: times less than .* s apart make no curve"):
        reference_from_file(file)
    np.savez(file, t=[0.0, 0.5, 1.0], xyz=np.zeros((3, 3)))
    assert reference_from_file(file).duration == 1.0


def test_slack_in_a_clipped_run(flat):
    slack = (0.01,) * 3 + (0.0,) * 3
    with pytest.raises(InvalidOption, match="slack is kept by the constrained step, so on_limit cannot be 'clip'"):
        ik.track(flat, line(flat), on_limit="clip", slack=slack)
    assert ik.track(flat, line(flat), on_limit="leave", slack=slack).success


def test_dt_and_stretch(flat):
    with pytest.raises(InvalidOption, match=r"dt = 0.5 s is longer than the reference \(0.2 s\)"):
        ik.track(flat, line(flat), dt=0.5)
    with pytest.raises(InvalidOption, match=r"max_stretch must be at least 1, not 0.9"):
        ik.track(flat, line(flat), max_stretch=0.9)
    with pytest.raises(InvalidConfiguration, match=r"q0 is outside the limits of joint_2; move it inside or use"):
        ik.track(flat, line(flat), q0=[0.0, flat.upper[1] + 0.1])
