"""Names in a URDF that no reader knows: misspelled elements and attributes of what moves and where, which are dropped in silence.

Extensions (of Gazebo, Drake, ROS, exporters) are no mistakes. An unknown element is reported only if its name is near one that
URDF defines, or if it has an attribute that only such an element has.
"""

import difflib
import functools
from collections.abc import Iterable, Iterator, Mapping

from .finding import Finding, odd
from .urdf import ITEMS, InnerElement, Item

ADVICE = "correct the name; as it is, every reader of URDF ignores it"
ROOT = ("link", "joint", "material")
ELEMENTS: Mapping[str, tuple[str, ...]] = {  # item or element -> elements that it may hold
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller"),
    "link": ("inertial", "visual", "collision"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry", "material"),
    "geometry": ("box", "sphere", "cylinder", "capsule", "mesh"),
}
ATTRIBUTES: Mapping[str, tuple[str, ...]] = {
    "link": ("name",),
    "joint": ("name", "type"),
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "velocity", "effort"),
    "mimic": ("joint", "multiplier", "offset"),
    "parent": ("link",),
    "child": ("link",),
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "mesh": ("filename", "scale"),
}
CLOSED = ("origin", "axis", "mimic", "parent", "child")  # elements to which no program adds attributes of its own
KINEMATIC = ("xyz", "rpy", "quat_xyzw", "quat_wxyz", "lower", "upper", "multiplier", "rotation", "translation")
SINGLE = ("origin", "parent", "child", "axis", "limit", "mimic")
MOST = 500  # different unknown names of a file that are compared: each takes up to 0.1 ms
NEAR = 0.82  # likeness from which a name counts as misspelled: "gear_velocity" of some files is no "velocity"


def misspelled(items: Iterable[Item]) -> Iterator[Finding]:
    """Warnings for unknown elements and attributes of links and joints, and for a joint's elements that are given twice."""
    seen: set[str] = set()
    for item in items:
        if item.tag in ("link", "joint"):
            yield from _attributes(item, InnerElement(item.tag, item.attributes, item.line), seen)
            for part in item.inside:
                yield from _part(item, part, seen)
            if item.tag == "joint":
                yield from _twice(item)
        elif item.tag not in (*ITEMS, "robot") and (near := _near(item.tag, ROOT, seen)):
            yield _unknown("robot", f"<{item.tag}>", f"<{near}>", item.line)


def _part(item: Item, part: InnerElement, seen: set[str]) -> Iterator[Finding]:
    inside = part.above[-1] if part.above else item.tag
    if inside == "inertial" or (len(part.above) > 1 and part.above[-1] != "geometry"):
        return
    known = ELEMENTS.get(inside)
    if known is None:
        return
    if part.tag in known:
        yield from _attributes(item, part, seen)
        return
    if part.tag in ("link", "joint") and not part.above:
        told = f"the <{part.tag}> inside it is ignored"
        yield odd(item, told, "write it directly below <robot>", part.line, at_load=True)
        return
    near = _near(part.tag, known, seen)
    if near:
        yield _unknown(item, f"<{part.tag}>", f"<{near}>", part.line)
    elif ":" not in part.tag and (
        inside == "geometry" or (item.tag == "joint" and any(key in KINEMATIC for key in part.attributes))
    ):
        yield _unknown(item, f"<{part.tag}>", "", part.line)


def _attributes(item: Item, part: InnerElement, seen: set[str]) -> Iterator[Finding]:
    known = ATTRIBUTES.get(part.tag, ())
    for key in part.attributes if known else ():
        if key in known or key.startswith("xmlns"):
            continue
        near = _near(key, known, seen)
        # An attribute of a namespace is an extension unless it has one of our names.
        if near or (":" not in key and part.tag in CLOSED):
            yield _unknown(item, f"{key}= of <{part.tag}>", f"{near}=" if near else "", part.line)


def _twice(joint: Item) -> Iterator[Finding]:
    for tag in SINGLE:
        several = joint.own(tag)
        if len(several) > 1:
            lines = " and ".join(str(part.line) for part in several[:2])
            told = f"it has {len(several)} <{tag}> (lines {lines}): the first counts"
            yield odd(joint, told, "remove the others", several[1].line, at_load=True)


def _unknown(element: object, name: str, near: str, line: int) -> Finding:
    told = f"{name} is not known and is ignored" + (f"; {near} is meant?" if near else "")
    return odd(element, told, ADVICE, line, at_load=True)


def _near(name: str, known: tuple[str, ...], seen: set[str]) -> str:
    """The known name that another one is like, or ''. seen: names of this file looked up so far."""
    if len(seen) >= MOST and name not in seen:
        return ""
    seen.add(name)
    return _like(name[:100], known)


@functools.lru_cache(maxsize=2 * 1024)
def _like(name: str, known: tuple[str, ...]) -> str:
    said = name.rpartition(":")[2].lower().replace("-", "_")
    begins = [one for one in known if said.startswith(one) and len(said) <= len(one) + 5]
    return next(iter(begins or difflib.get_close_matches(said, known, 1, NEAR)), "")
