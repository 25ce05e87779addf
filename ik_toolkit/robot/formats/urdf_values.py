"""Checks the numbers of a URDF: some make it unusable, others probably mean something else than they say."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from .finding import Finding, did_you_mean, error_finding, odd
from .mimic import MOVING
from .urdf import ENDLESS, NUMBERS, SHAPES, SIZES, InnerElement, Item, attribute_numbers, finite_at, plain_origin

TYPES = (*MOVING, "fixed", "floating", "planar")
UNIT = 0.01  # The length of a quaternion or an axis may differ from 1 by this much before it is reported.
DEGREES = (30.0, 360.0)  # A limit in this range with at most one decimal is taken for degrees rather than radians.
IN_DEGREES = "radians are meant: write 3.14159 for 180 degrees"
UNUSED = "without it the joint counts as having no such limit; other readers of URDF refuse the file"


def check_joint(joint: Item) -> Iterator[Finding]:
    """Yield errors and warnings about the type and the numbers of a joint."""
    kind = joint.attributes.get("type")
    if kind not in TYPES:
        near = did_you_mean(kind or "", TYPES)
        said = "it has no type" if kind is None else f"its type '{kind}' is unknown"
        yield error_finding(joint, said, f"use one of: {', '.join(TYPES)}.{near}", joint.line)
        return
    for part in joint.own("origin")[:1]:
        yield from _numbers(joint, part, error_finding)
        yield from _origin(joint, part, error_finding)
    if kind in ("floating", "planar"):
        told = f"a {kind} joint is held still, and poses are given in the link it carries"
        yield odd(joint, told, "give base_limits= to let it move, or make it fixed", joint.line)
        if joint.own("mimic"):
            told = f"its <mimic> is ignored, because a {kind} joint mimics no other"
            yield odd(joint, told, "remove it, or make the joint revolute or prismatic", joint.line, at_load=True)
    if kind in (*MOVING, "planar"):
        yield from _axis(joint, kind)
    if kind in MOVING:
        for part in joint.own("mimic")[:1]:
            yield from _numbers(joint, part, error_finding)
            offset = attribute_numbers(part.attributes.get("offset", "0")) or []
            if kind != "prismatic" and any(map(_degrees, offset)):
                told = f'its <mimic offset="{offset[0]:g}"> looks like degrees'
                yield odd(joint, told, IN_DEGREES, part.line, at_load=True)
        yield from _limit(joint, kind)
    elif kind == "planar":
        yield from _free_limits(joint, kind)


def link_values(link: Item) -> Iterator[Finding]:
    """Yield warnings about wrong numbers in a link's shapes and inertia; the robot can be loaded and moved in spite of them."""
    drawn = [part for part in link.inside if part.tag in SHAPES and not part.above]
    for part, shape in zip(drawn, link.shapes, strict=True):
        if part.tag == "collision" and "geometry" not in shape:
            told = "its <collision> has no shape"
            yield odd(link, told, "write it in <geometry>, or remove it", part.line, at_load=True)
    for part in link.inside:
        missing = [
            key for key in SIZES.get(part.tag, ()) if part.above[1:] == ("geometry",) and key not in part.attributes
        ]
        if missing:
            told = f"<{part.tag}> has no {' and no '.join(missing)}, so there is no shape"
            yield odd(link, told, "write it, or remove the shape", part.line, at_load=True)
        if part.tag in NUMBERS and part.above[:1] in (("visual",), ("collision",), ("inertial",)):
            yield from _numbers(link, part, odd)
            if part.tag == "origin":
                yield from _origin(link, part, odd)
        for key in SIZES.get(part.tag, ()):
            values = attribute_numbers(part.attributes.get(key, ""))
            if values and min(values) <= 0.0:
                told = f"<{part.tag}> has the {key} {part.attributes[key]}"
                yield odd(link, told, "sizes are positive", part.line)
        scale = attribute_numbers(part.attributes.get("scale", "")) if part.tag == "mesh" else None
        if scale and min(map(abs, scale)) == 0.0:
            told = f"its mesh has the scale {part.attributes['scale']}"
            yield odd(link, told, "a zero scale leaves nothing to draw", part.line)


def check_all_zero(joints: Sequence[Item]) -> Iterator[Finding]:
    """Yield a warning if all joint limits of a robot are 0 to 0, which exporters write as placeholders."""
    limited = [joint for joint in joints if joint.attributes.get("type") in ("revolute", "prismatic")]
    ends = [
        attribute_numbers(limit.get(end, "0"))
        for j in limited
        if (limit := j.first("limit"))
        for end in ("lower", "upper")
    ]
    if limited and len(ends) == 2 * len(limited) and all(end == [0.0] for end in ends):
        told = f"all limits ({len(limited)}) are 0 to 0, so these joints cannot move"
        yield odd("robot", told, "write the limits of the real robot", limited[0].line, at_load=True)


def _numbers(item: Item, part: InnerElement, found: Callable[..., Finding]) -> Iterator[Finding]:
    """Yield findings, made by `found` (wrong or odd), for attributes that are not the right count of finite numbers."""
    advice = "correct it" if found is error_finding else "this part is ignored; correct it"
    for key, count in NUMBERS[part.tag].items():
        if key not in part.attributes:
            continue
        text = part.attributes[key]
        values = attribute_numbers(text)
        shown = f'<{part.tag} {key}="{text[:60]}">'
        if values is None or len(values) != count:
            told = f"{shown} is not {'a number' if count == 1 else f'{count} numbers'}"
            yield found(item, told, advice, part.line)
        elif not all(map(math.isfinite, values)):
            yield found(item, f"{shown} is not finite", "write a finite number", part.line)


def _origin(item: Item, part: InnerElement, found: Callable[..., Finding]) -> Iterator[Finding]:
    """Yield findings about the rotation of an <origin>; text that is not a number has been reported before."""
    given = part.attributes
    if not given:
        told = "its <origin> is empty: no offset and no rotation"
        yield odd(item, told, "write xyz= and rpy=, or remove it", part.line, at_load=item.tag == "joint")
    rpy = attribute_numbers(given.get("rpy", "")) or []
    if any(map(_degrees, rpy)):
        told = f'its <origin rpy="{given["rpy"]}"> looks like degrees'
        yield odd(item, told, IN_DEGREES, part.line, at_load=item.tag == "joint")
    quaternion = finite_at(given, "quat_xyzw", 4)
    if not quaternion:
        return
    if "rpy" in given:
        yield found(item, "its <origin> has both rpy and quat_xyzw", "keep one of them", part.line)
    elif "quat_xyzw" in plain_origin(given):
        told = f'its <origin quat_xyzw="{given["quat_xyzw"][:60]}"> is zero: no rotation'
        yield found(item, told, "write a unit quaternion", part.line)
    elif abs(math.hypot(*quaternion) - 1.0) > UNIT:
        told = f"its <origin> has a quaternion of length {math.hypot(*quaternion):.4g}, which is scaled to 1"
        yield odd(item, told, "write a unit quaternion", part.line, at_load=True)


def unversioned(items: Sequence[Item]) -> Iterator[Finding]:
    """Yield a warning for quaternions in a file that does not declare a URDF version with quaternions."""
    version = attribute_numbers(items[0].attributes.get("version", "1.0").partition(" ")[0]) or [1.0]
    used = [
        (item, part)
        for item in items
        for part in (item.own("origin")[:1] if item.tag == "joint" else item.inside)
        if part.tag == "origin" and "quat_xyzw" in part.attributes
    ]
    if used and version[0] < 1.1:
        item, part = used[0]
        told = f'quat_xyzw is used as the rotation, but other readers ignore it without <robot version="1.2"> ({len(used)} of them)'
        yield odd(item, told, 'write <robot version="1.2">', part.line, at_load=True)


def _axis(joint: Item, kind: str) -> Iterator[Finding]:
    parts = joint.own("axis")[:1]
    line = parts[0].line if parts else joint.line
    if parts:
        yield from _numbers(joint, parts[0], error_finding)
    if kind == "planar" and not parts:
        told = "it has no <axis>, so by URDF's default (1 0 0) its plane is that of y and z"
        yield odd(joint, told, 'write <axis xyz="0 0 1"/> for the plane of x and y', line, at_load=True)
    if parts and "xyz" not in parts[0].attributes:
        yield odd(joint, "its <axis> has no xyz: read as 1 0 0", 'write <axis xyz="0 0 1"/>', line, at_load=True)
    axis = finite_at(parts[0].attributes, "xyz", 3, "1 0 0") if parts else []
    if not axis:
        return
    length = math.hypot(*axis)
    if not length > 1e-6:
        yield error_finding(
            joint, "its axis is zero, so it has no direction to move in", "write a unit axis such as 0 0 1", line
        )
    elif abs(length - 1.0) > UNIT:
        yield odd(joint, f"its axis has the length {length:.4g}; only its direction counts", "write a unit axis", line)


def _limit(joint: Item, kind: str) -> Iterator[Finding]:
    parts, led = joint.own("limit")[:1], joint.first("mimic") is not None
    loose = led and kind != "continuous" and not (parts and parts[0].attributes.keys() & {"lower", "upper"})
    if loose:
        told = "its <limit> has no lower and no upper" if parts else "it has no <limit>"
        advice = "write them; other readers of URDF take 0 to 0, or refuse the file"
        yield odd(joint, f"{told}: it moves as far as its leader does", advice, parts[0].line if parts else joint.line)
    if not parts:
        advice = {
            "revolute": "add lower and upper [rad], or make it continuous",
            "prismatic": "add lower and upper [m]",
        }
        if kind in advice and not led:
            yield error_finding(joint, "it has no <limit>", advice[kind], joint.line)
        return
    limit, line = parts[0].attributes, parts[0].line
    for key in ("effort", "velocity"):
        yield from _power(joint, limit, key, line)
    if kind == "continuous":
        yield from _free_limits(joint, kind)
    if kind == "continuous" or loose:
        return
    ends = [attribute_numbers(limit.get(end, "0")) or [] for end in ("lower", "upper")]
    for end, values in zip(("lower", "upper"), ends, strict=True):
        if len(values) != 1 or math.isnan(values[0]):
            told = f'<limit {end}="{limit[end][:60]}"> is not a number'
            yield error_finding(joint, told, "write a number, or inf for no limit", line)
    if all(len(values) == 1 for values in ends):
        yield from _ends(joint, kind, limit, ends[0][0], ends[1][0], line)


def _ends(joint: Item, kind: str, limit: Mapping[str, str], low: float, high: float, line: int) -> Iterator[Finding]:
    missing = [end for end in ("lower", "upper") if end not in limit]
    if missing:
        told = f"its <limit> has no {' and no '.join(missing)}: read as 0"
        yield odd(joint, told, "write both limits", line, at_load=True)
    if low >= ENDLESS or high <= -ENDLESS:
        yield error_finding(
            joint, f"its limits {low:g} to {high:g} leave it no position to take", "-inf to inf is no limit", line
        )
    elif low > high:
        told = f"its lower limit {low:g} is above its upper limit {high:g}: no tip can use it"
        yield odd(joint, told, reversed_advice(low, high, kind == "revolute"), line)
    soft = [finite_at(joint.first("safety_controller"), f"soft_{end}_limit") for end in ("lower", "upper")]
    if all(soft) and (soft[0][0] > low or soft[1][0] < high):
        told = (
            f"its soft limits {soft[0][0]:g} to {soft[1][0]:g} are narrower than {low:g} to {high:g}, and are not used"
        )
        yield odd(joint, told, "limits= (--limit) keeps a solve inside them", line, at_load=True)
    if low == high:
        leader = (joint.first("mimic") or {}).get("joint")
        holds = f", and holds joint '{leader}', which it mimics" if leader else ""
        told = f"its limits are both {low:g}: it cannot move{holds}"
        yield odd(joint, told, "widen them, or make it fixed", line, at_load=bool(leader))
    if kind == "revolute" and (_degrees(low) or _degrees(high)):
        told = f"its limits {low:g} to {high:g} look like degrees"
        yield odd(joint, told, IN_DEGREES, line, at_load=True)


def reversed_advice(low: float, high: float, turns: bool) -> str:
    """Return advice, the end of a sentence, on a lower limit above the upper one, which may mean either of two ranges."""
    swapped = f"swap them if {high:g} to {low:g} is meant"
    if not turns:
        return swapped + f", or change their signs and the axis if {-low:g} to {-high:g} is meant" * bool(low != -high)
    return f"{swapped}, or write {low:g} to {high + 2.0 * math.pi:.4g} if the range across half a turn is meant"


def _free_limits(joint: Item, kind: str) -> Iterator[Finding]:
    """Yield a warning for position limits of a joint whose type has none."""
    for part in joint.own("limit")[:1]:
        said = [
            end for end in ("lower", "upper") if (attribute_numbers(part.attributes.get(end, "0")) or [1.0]) != [0.0]
        ]
        if said:
            advice = "make it revolute if they are meant" if kind == "continuous" else "give them as base_limits="
            told = f"{' and '.join(said)} of a {kind} joint are ignored"
            yield odd(joint, told, advice, part.line, at_load=True)


def _power(joint: Item, limit: Mapping[str, str], key: str, line: int) -> Iterator[Finding]:
    """Yield warnings about an effort or velocity limit that does not limit anything."""
    if key not in limit:
        yield odd(joint, f"its <limit> has no {key}", UNUSED, line)
        return
    values = attribute_numbers(limit[key]) or []
    if len(values) != 1 or math.isnan(values[0]):
        yield odd(joint, f'<limit {key}="{limit[key][:60]}"> is not a number', UNUSED, line, at_load=key == "velocity")
    elif values[0] < 0.0:
        yield odd(
            joint, f"its {key} limit is negative ({limit[key]}), read as no limit", "write a positive number", line
        )
    elif values[0] == 0.0 and key == "velocity":
        told = "its velocity limit is 0, read as no limit: a joint that cannot move would be fixed"
        yield odd(joint, told, "write the speed of the real joint [rad/s or m/s]", line)


def _degrees(angle: float) -> bool:
    """Return whether an angle looks like degrees; 31.4 does not, which is 10 pi."""
    if not DEGREES[0] <= abs(angle) <= DEGREES[1]:
        return False
    return angle.is_integer() or (round(angle, 1) == angle and abs(math.sin(angle)) > 0.05)
