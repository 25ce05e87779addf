"""URDF text -> Pinocchio model, mimic joints followed."""

import xml.etree.ElementTree as ET

import pinocchio as pin

from .read import parse

ENDLESS = "1e16"  # written as a limit: Robot takes it as none (NO_LIMIT)


def build_model(text: str) -> pin.Model:
    """Pinocchio's model of a URDF that `safe_read` has passed. Raises what Pinocchio raises.

    A continuous joint that leads or follows another is given to Pinocchio as a revolute joint without limits. As cosine and
    sine it would forget its turns, and a follower by half a turn per turn would be half a turn off; nor does Pinocchio let a
    continuous joint lead, or follow, one of another type.
    """
    joints = {item.name: item for item in parse(text) if item.tag == "joint"}
    tied = set()
    for name, item in joints.items():
        mimic = item.first("mimic")
        if mimic is not None:
            tied |= {name, mimic.get("joint", "")}
    endless = {name for name in tied & joints.keys() if joints[name].attributes.get("type") == "continuous"}
    if endless:
        root = ET.fromstring(text)  # noqa: S314 - the parse above has refused every DOCTYPE and entity
        for joint in root.findall("joint"):
            if joint.get("name") in endless:
                joint.set("type", "revolute")
                limit = joint.find("limit")
                if limit is None:
                    limit = ET.SubElement(joint, "limit", effort=ENDLESS, velocity=ENDLESS)
                limit.set("lower", f"-{ENDLESS}")
                limit.set("upper", ENDLESS)
        text = ET.tostring(root, "unicode")
    return pin.buildModelFromXML(text, True)
