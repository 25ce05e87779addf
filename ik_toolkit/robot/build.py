"""URDF text -> Pinocchio model that follows mimic joints."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import pinocchio as pin

from .mimic import MOVING, Followers, followers
from .read import parse, wrong_scale

ENDLESS = "1e16"  # a limit that Robot reads as "no limit" (NO_LIMIT)


def build_model(text: str) -> pin.Model:
    """Pinocchio's model of a URDF that `safe_read` has accepted. Raises what Pinocchio raises.

    Things that Pinocchio cannot read but that do not affect the motion are repaired in its copy of the text: a missing name, shapes
    with an invalid mesh scale, capsules (which its parser complains about), followers of joints that do not exist or are followers
    themselves, and the order of the joints (see mimic.py).
    """
    items = parse(text)
    found = followers(text)
    shapes = any(
        tag == "capsule" or (tag == "mesh" and wrong_scale(attributes))
        for item in items
        for tag, attributes in item.inside
    )
    if not (found.tied or found.loose or shapes or not items[0].name):
        return pin.buildModelFromXML(text, True)
    # Pinocchio traverses the tree depth first by name, so joints temporarily get names that sort in the required order.
    lent = {name: f"{place:04d} {name}" for place, name in enumerate(found.order)}
    model = pin.buildModelFromXML(_mended(text, found, lent, shapes), True)
    own = {name: joint for joint, name in lent.items()}
    for j, name in enumerate(model.names):
        model.names[j] = own.get(name, name)
    for frame in model.frames:
        if frame.type in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT):
            frame.name = own.get(frame.name, frame.name)
    return model


def _mended(text: str, found: Followers, lent: Mapping[str, str], shapes: bool) -> str:
    """URDF text as Pinocchio can read it; lent: joint name -> temporary name; shapes: whether to leave out shapes.

    A continuous joint that leads or follows another becomes a revolute joint without limits. Stored as cosine and sine it would
    lose whole turns, and a follower with ratio 0.5 would be off by half a turn; nor does Pinocchio let a continuous joint lead or
    follow one of another type.
    """
    root = ET.fromstring(text)  # noqa: S314 - the parse before has rejected every DOCTYPE and entity
    root.set("name", root.get("name") or "robot")
    tied = found.tied
    both = {*tied, *(tie.leader for tie in tied.values())}
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        if name in tied and joint.get("type") in MOVING:
            tie = tied[name]
            ET.SubElement(
                joint,
                "mimic",
                joint=lent.get(tie.leader, tie.leader),
                multiplier=repr(tie.ratio),
                offset=repr(tie.offset),
            )
        if name in both and joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = joint.find("limit")
            if limit is None:
                limit = ET.SubElement(joint, "limit", effort=ENDLESS, velocity=ENDLESS)
            limit.set("lower", f"-{ENDLESS}")
            limit.set("upper", ENDLESS)
        joint.set("name", lent.get(name, name))
    if shapes:
        for link in root.findall("link"):
            for shape in (*link.findall("visual"), *link.findall("collision")):
                link.remove(shape)
    return ET.tostring(root, "unicode")
