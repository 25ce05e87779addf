"""Builds a Pinocchio model from URDF text, with followers tied to their leaders.

Pinocchio's parser gets a rewritten text that has only joints, links and inertias, with every number checked. It therefore
prints no warning, and nothing that it does not know (extensions, encodings, processing instructions, quaternions, limits
without an effort) can make it refuse a file or misread it.
"""

import html
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pinocchio as pin

from .mimic import MOVING, Followers, followers
from .urdf import ENDLESS, Item, finite_at, limits_of_joint, parse, plain_origin

INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def build_model(text: str) -> pin.Model:
    """Build a Pinocchio model of a URDF text that was checked before. Raises what Pinocchio raises.

    A mimic joint whose leader does not exist stays fixed. If the leader is itself a mimic joint, both follow the same joint.
    """
    items, found = parse(text), followers(text)
    # Pinocchio traverses the tree depth first by name, so joints temporarily get names that sort in the required order.
    lent = {name: f"{place:04d} {name}" for place, name in enumerate(found.order)}
    model = pin.buildModelFromXML(motion_text(items, found, lent), True)
    own = {name: joint for joint, name in lent.items()}
    if own:
        for j, name in enumerate(model.names):
            model.names[j] = own.get(name, name)
        for frame in model.frames:
            if frame.type in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT):
                frame.name = own.get(frame.name, frame.name)
    for item in items:
        if item.tag == "joint" and item.attributes["type"] == "planar":
            _turn_plane(model, item)
    return model


def motion_text(items: Sequence[Item], found: Followers, lent: Mapping[str, str]) -> str:
    """Write links and joints, without shapes, as a URDF that the parser of Pinocchio reads without a warning.

    `lent` maps the name of a joint to the temporary one that it gets in the text.
    """
    both = {*found.tied, *(tie.leader for tie in found.tied.values())}
    rows = [f'<robot name="{_quoted(items[0].name or "robot")}">']
    for item in items:
        if item.tag == "link":
            rows.append(f'<link name="{_quoted(item.name)}">{_inertial(item)}</link>')
        elif item.tag == "joint":
            rows += _joint(item, found, lent, item.name in both)
    return "".join([*rows, "</robot>"])


def _joint(joint: Item, found: Followers, lent: Mapping[str, str], both: bool) -> Iterable[str]:
    """Yield the pieces of a joint's text; `both` tells whether the joint leads or follows another one.

    A continuous joint that leads or follows becomes a revolute joint without limits. Stored as cosine and sine it would lose whole
    turns, and a follower with ratio 0.5 would be off by half a turn. Pinocchio also does not let a continuous joint
    lead or follow one of another type.
    """
    name, kind = joint.name, joint.attributes["type"]
    shown = "revolute" if both and kind == "continuous" else kind
    yield f'<joint name="{_quoted(lent.get(name, name))}" type="{shown}">'
    for role in ("parent", "child"):
        yield f'<{role} link="{_quoted((joint.first(role) or {})["link"])}"/>'
    yield _origin(joint.first("origin"))
    if kind in MOVING:
        yield f'<axis xyz="{_text(axis_of(joint))}"/>'
        limit = joint.first("limit")
        low, high = limits_of_joint(joint)
        effort, velocity = (_most(limit, key) for key in ("effort", "velocity"))
        if shown != "continuous" or limit is not None:
            yield f'<limit lower="{low!r}" upper="{high!r}" effort="{effort!r}" velocity="{velocity!r}"/>'
        losses = _numbers(joint.first("dynamics") or {}, ("damping", "friction"))
        if losses:
            yield f"<dynamics {_pairs(losses)}/>"
        if name in found.tied:
            tie = found.tied[name]
            leader = _quoted(lent.get(tie.leader, tie.leader))
            yield f'<mimic joint="{leader}" multiplier="{tie.ratio!r}" offset="{tie.offset!r}"/>'
    yield "</joint>"


def axis_of(joint: Item) -> list[float]:
    """Return the three numbers of the <axis> of a joint: the x axis if it has none, as in URDF.

    An axis so long that its square overflows is shortened.
    """
    axis = finite_at(joint.first("axis"), "xyz", 3, "1 0 0")
    length = math.hypot(*axis)
    return [x / length for x in axis] if length > 1e100 else axis


def _turn_plane(model: pin.Model, joint: Item) -> None:
    """Rotate the plane of a planar joint: in URDF it is perpendicular to the axis, in Pinocchio it is always the x-y plane.

    The frame of the joint is rotated by the shortest rotation of z onto the axis, and everything that the joint carries is
    rotated back.
    """
    axis = np.array(axis_of(joint))
    R = pin.SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis), np.zeros(3))
    back = R.inverse()
    j = model.getJointId(joint.name)
    model.jointPlacements[j] = model.jointPlacements[j] * R
    model.inertias[j] = back.act(model.inertias[j])
    for child in range(1, model.njoints):
        if model.parents[child] == j:
            model.jointPlacements[child] = back * model.jointPlacements[child]
    for frame in model.frames:
        if frame.parentJoint == j:
            frame.placement = back * frame.placement


def _most(limit: Mapping[str, str] | None, key: str) -> float:
    """Return an effort or velocity limit, or ENDLESS if it is missing, no number, negative, infinite, or a velocity of 0."""
    (value,) = finite_at(limit, key) or [math.nan]
    return value if (0.0 if key == "velocity" else -1e-300) < value < ENDLESS else ENDLESS


def _inertial(link: Item) -> str:
    """Return the <inertial> of a link, or an empty text if urdfdom could not read it."""
    inside = {part.tag: part.attributes for part in reversed(link.inside) if part.above == ("inertial",)}
    mass = _numbers(inside.get("mass", {}), ("value",))
    inertia = _numbers(inside.get("inertia", {}), INERTIA)
    place = _origin(inside.get("origin"))
    if not mass or len(inertia) < len(INERTIA) or "nan" in place:
        return ""
    return f"<inertial>{place}<mass {_pairs(mass)}/><inertia {_pairs(inertia)}/></inertial>"


def _origin(given: Mapping[str, str] | None) -> str:
    """Return the text of an <origin>; 'nan' replaces what is not three finite numbers."""
    if given is None:
        return ""
    origin = plain_origin(given)
    xyz, rpy = (_text(finite_at(origin, key, 3, "0 0 0")) or "nan" for key in ("xyz", "rpy"))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


def _numbers(attributes: Mapping[str, str], keys: Iterable[str]) -> dict[str, float]:
    """Return those of the attributes that are one finite number."""
    return {key: found[0] for key in keys if (found := finite_at(attributes, key))}


def _pairs(values: Mapping[str, float]) -> str:
    return " ".join(f'{key}="{value!r}"' for key, value in values.items())


def _text(values: Iterable[float]) -> str:
    return " ".join(map(repr, values))


def _quoted(name: str) -> str:
    return html.escape(name)
