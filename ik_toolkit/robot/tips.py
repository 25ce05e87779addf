"""Guesses a robot's tip frame when none is given, from the names that arm descriptions commonly use."""

import logging
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import pinocchio as pin

from ..errors import FrameNotFound, InvalidOption, ModelError, near_match
from .base import ROAMS

LOG = logging.getLogger("ik_toolkit")

# A convention is a set of words that together mark the name of a tip frame; the strongest convention comes first.
# The tool centre point precedes the end frames of ROS, MoveIt and manufacturers, and these precede the hand.
CONVENTIONS: tuple[tuple[str, ...], ...] = (
    ("tcp",), ("tool0",), ("tool",), ("end", "effector"), ("eef",), ("ee",),
    ("endeffector",), ("gripper",), ("hand",), ("arm", "tool"), ("flange",),
)  # fmt: skip
# A frame whose name has a word of OTHERS (a finger, leg or other part on which no tool is mounted) is a tip only if no other frame
# remains, and one with a word of SCENE (a sensor or object) only after that.
SCENE = frozenset(
    "lidar sonar radar gps gnss sensor sensors microphone speaker antenna livox velodyne hokuyo realsense zed kinect "
    "ft force torque imu camera optical depth rgb accelerometer range laser target goal marker object box "
    "collision visual inertia inertial com".split()
)
OTHERS = SCENE | frozenset(
    "finger fingers fingertip thumb jaw index middle ring little pinky nail inner outer mover moving motor rotor skin head neck "
    "foot feet sole ankle leg toe wheel caster mount contact cover shape dummy".split()
)
# The types of Pinocchio frame that may be a base or a tip: those of links (LINKS), and those of joints.
LINKS = (pin.FrameType.BODY, pin.FrameType.OP_FRAME, pin.FrameType.SENSOR)
FRAMES = (*LINKS, pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
SHOWN = 3  # A message lists at most this many candidates for the tip.


class Guess(NamedTuple):
    """The name of the likely tip of a robot, or of several equally likely ones, and why they are likely."""

    tips: tuple[str, ...]
    why: str


def words(name: str) -> list[str]:
    """Split a name at punctuation and capitals: 'l_gripperTool0' -> ['l', 'gripper', 'tool0']."""
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])\d*|[A-Z]?[a-z]+\d*|\d+", name)]


def follows_convention(convention: Sequence[str], said: set[str]) -> bool:
    """Return whether a frame's name follows a naming convention for tips: it has all its words, and none such as 'finger'.

    said: the words of the name. A name with the words "arm" and "tool" follows only the convention of these two words, which is a
    weaker sign of a tip than "hand".
    """
    on_arm = "arm" in said and "tool" in said
    return set(convention) <= said and not other(said) and on_arm == ("arm" in convention)


def other(said: Iterable[str], names: frozenset[str] = OTHERS) -> bool:
    """Return whether a frame's name, split into words `said`, contains one of `names`, such as 'finger' or 'camera'.

    By default `names` are words for parts on which no tool is mounted. Digits at the end do not count: 'camera2' is 'camera'.
    """
    return any(word.rstrip("0123456789") in names for word in said)


def path_ends(model: pin.Model) -> tuple[str, ...]:
    """Return the names of the links that a joint moves and to which no other link is attached: the candidates for a tip."""
    frames = model.frames
    parents = {
        f.parentFrame for f in frames if f.type in (pin.FrameType.BODY, pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    }
    return tuple(
        f.name for i, f in enumerate(frames) if f.type == pin.FrameType.BODY and i not in parents and f.parentJoint > 0
    )


def guess_tip(model: pin.Model) -> Guess:
    """Guess the tip of a model by the usual names of tip frames; without one, take the ends of paths with the most joints.

    Joints with several degrees of freedom do not count, because what only such a joint moves is a free object of a scene or the
    robot's base. Where names do not help, path ends moved by at most half as many joints as another (a lidar, a head) are left out.
    """
    moved = [f for f in model.frames if f.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME) and f.parentJoint > 0]
    joints = {f.name: sum(model.joints[j].nv < 2 for j in model.supports[f.parentJoint] if j) for f in moved}
    moved = [f for f in moved if joints[f.name]] or moved
    named = [(f, words(f.name)) for f in moved]
    for convention in CONVENTIONS:
        found = [f for f, said in named if follows_convention(convention, set(said))]
        if found:
            return Guess(_branches(model, found), "guessed by its name")
    outer = set(path_ends(model))
    ends = [f for f in moved if f.name in outer]
    most = max((joints[f.name] for f in ends), default=0)
    far = [f for f in ends if 2 * joints[f.name] > most]
    plain = next(
        (kept for names in (OTHERS, SCENE) if (kept := [f for f in far if not other(words(f.name), names)])),
        [_carrier(model, f) for f in ends],
    )
    most = max((joints[f.name] for f in plain), default=0)
    # Frames moved by the same joint differ only by a fixed offset, so only the first of them is a candidate.
    longest = {f.parentJoint: f.name for f in reversed(plain) if joints[f.name] == most}
    return Guess(tuple(longest.values())[::-1], "the end of the longest path")


def _carrier(model: pin.Model, frame: pin.Frame) -> pin.Frame:
    """Return the frame to which a sensor is fixed, or the frame itself if it is no sensor or has a joint of its own."""
    above = model.frames[model.frames[frame.parentFrame].parentFrame]
    if above.parentJoint != frame.parentJoint or not other(words(frame.name), SCENE):
        return frame
    return _carrier(model, above)


def tip_candidates(model: pin.Model) -> tuple[str, ...]:
    """Return the names of frames that may be the tip of a model: the likely ones first, then the other ends of its paths.

    A frame that only a floating or planar joint moves is not a candidate, because without limits such a joint is held still.
    """
    ends = dict.fromkeys((*guess_tip(model).tips, *path_ends(model)))
    on = {frame.name: model.joints[frame.parentJoint].shortname() for frame in model.frames}
    return tuple(name for name in ends if on[name] not in ROAMS) or tuple(ends)


def only_tip(model: pin.Model, robot: str) -> str:
    """Return the name of the tip of a model if none is given, and log a warning if it is a guess; `robot` is a name for messages.

    Raises ModelError if nothing moves, FrameNotFound if several tips are equally likely.
    """
    tips, why = guess_tip(model)
    if len(tips) == 1:
        if path_ends(model) != tips:
            LOG.warning("robot '%s': using tip '%s' (%s); choose another with tip=", robot, tips[0], why)
        return tips[0]
    if not tips:
        raise ModelError(f"robot '{robot}' has no movable joint: nothing to solve")
    named = ", ".join(tips[:SHOWN]) + (f" or {len(tips) - SHOWN} more" if len(tips) > SHOWN else "")
    several = FrameNotFound(
        f"robot '{robot}' has several likely tips: {named}; choose one with tip=, or solve for several with "
        "ik.Tree.load(source, tips=[...])"
    )
    several.tips = tip_candidates(model)
    raise several


def _branches(model: pin.Model, frames: Sequence[pin.Frame]) -> tuple[str, ...]:
    """Return one frame for each branch: of frames that carry each other, the last frame of the joint nearest the base."""
    lines = [list(model.supports[f.parentJoint]) for f in frames]
    joints = {f.parentJoint for f in frames}
    first = [f for f, line in zip(frames, lines, strict=True) if not joints & set(line[:-1])]
    return tuple({f.parentJoint: f.name for f in first}.values())


def frame_id(model: pin.Model, name: Any, robot: str) -> int:
    """Return the index of the frame of a link, or of a joint, which moves with its link; `robot` is a name for messages.

    Raises InvalidOption if `name` is no text, FrameNotFound if there is no such link or joint.
    """
    if not isinstance(name, str):
        several = "; for several tips use ik.Tree.load(source, tips=[...])" * isinstance(name, list | tuple)
        raise InvalidOption(f"tip and base must each be the name of one frame, not {name!r}{several}")
    found = [(f.type not in LINKS, i) for i, f in enumerate(model.frames) if f.name == name and f.type in FRAMES]
    if not found:
        bodies = [f.name for f in model.frames if f.type in LINKS]
        raise FrameNotFound(f"robot '{robot}' has no frame '{name}'.{near_match(name, bodies)}")
    return min(found)[1]


def one_word(tip: str | None, ee_link: str | None) -> str | None:
    """Return the tip's name, given as `tip` or `ee_link`. Raises InvalidOption if both are given and differ."""
    if tip is not None and ee_link is not None and tip != ee_link:
        raise InvalidOption(
            f"tip and ee_link are two names for one frame, not {tip!r} and {ee_link!r}; give one of them"
        )
    return ee_link if tip is None else tip


def root_link(model: pin.Model) -> str:
    """Return the name of the root link, the first body frame of the tree."""
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint == 0:
            return frame.name
    return "universe"
