"""Parses SRDF text once, as a stream with size limits, with no entity expanded and nothing fetched."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import ModelError
from .urdf import HasMacros, InnerElement, Item, attribute_numbers, check_names, walk

MEMBERS = ("link", "joint", "chain", "group")  # The elements that a <group> of an SRDF may contain.
# For each element of an SRDF, the attributes without which it is an error. A <group_state> without a name is only left out.
NEEDED = {
    "chain": ("base_link", "tip_link"),
    "link": ("name",),
    "joint": ("name",),
    "group": ("name",),
    "end_effector": ("name", "parent_link"),
    "group_state": (),
    "passive_joint": ("name",),
    "disable_collisions": ("link1", "link2"),
    "enable_collisions": ("link1", "link2"),
    "disable_default_collisions": ("link",),
}


@dataclass(frozen=True)
class Group:
    """A group of robot parts: link names, joint names, chains as (base link, tip link), and names of subgroups."""

    name: str
    links: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    chains: tuple[tuple[str, str], ...] = ()
    groups: tuple[str, ...] = ()


@dataclass(frozen=True)
class EndEffector:
    """An end effector of a robot.

    `parent_link` is the link that carries it, `group` the name of the group of its own parts, and `parent_group` that of the arm
    on which it is mounted ('' if the SRDF does not say).
    """

    name: str
    parent_link: str
    group: str = ""
    parent_group: str = ""


@functools.lru_cache(maxsize=16)
def contents(text: str) -> dict[str, Any]:
    """Parse SRDF text into the fields of an `Srdf`. Raises ModelError if it is malformed or exceeds a size limit."""
    robot, *items = _items(text)
    groups: dict[str, Group] = {}
    ends: dict[str, EndEffector] = {}
    states: dict[str, dict[str, dict[str, tuple[float, ...]]]] = {}
    lost: dict[tuple[str, str], str] = {}  # By (configuration, group): why this configuration is left out.
    joints: dict[str, list[str]] = {"passive_joint": [], "virtual_joint": []}
    disabled: dict[tuple[str, str], str] = {}
    quiet: list[str] = []
    enabled: list[tuple[str, str]] = []
    for item in items:
        given = item.attributes
        _require(item)
        match item.tag:
            case "group":
                if item.name in groups:
                    raise ModelError(f"group '{item.name}' is defined twice in the SRDF, again in line {item.line}")
                groups[item.name] = _group(item)
            case "group_state":
                group = given.get("group", "")
                why = _read_state(item, states.setdefault(item.name, {}).setdefault(group, {}))
                if why:
                    lost.setdefault((item.name, group), why)
            case "end_effector":
                links = (given.get(key, "") for key in ("parent_link", "group", "parent_group"))
                ends[item.name] = EndEffector(item.name, *links)
            case "passive_joint" | "virtual_joint":
                joints[item.tag].append(item.name)
            case "disable_collisions" if given["link1"] != given["link2"]:
                disabled[given["link1"], given["link2"]] = given.get("reason", "")
            case "enable_collisions":
                enabled.append((given["link1"], given["link2"]))
            case "disable_default_collisions":
                quiet.append(given["link"])
    remarks = [
        f"group '{group.name}' contains the group '{unknown[0]}', which does not exist"
        for group in groups.values()
        if (unknown := [inner for inner in group.groups if inner not in groups])
    ]
    for (state, group), why in lost.items():
        whose = f" of group '{group}'" if group else ""
        remarks.append(f"configuration '{state}'{whose} is left out: {why}")
        states[state].pop(group)
    return {
        "name": robot.name,
        "groups": groups,
        "end_effectors": ends,
        "states": {state: by_group for state, by_group in states.items() if by_group},
        "passive_joints": tuple(dict.fromkeys(joints["passive_joint"])),
        "virtual_joints": tuple(joints["virtual_joint"]),
        "disabled": disabled,
        "quiet": tuple(quiet),
        "enabled": tuple(enabled),
        "remarks": tuple(remarks),
    }


def _items(text: str) -> list[Item]:
    """Return the robot and the elements directly below it, each with its own child elements, which have no children."""
    items: list[Item] = []

    def start(tag: str, given: dict[str, str], above: Sequence[str], line: int) -> None:
        if not above and tag != "robot":
            raise ModelError(f"the root element is <{tag}>, not <robot>: this is not an SRDF")
        if tag.startswith("xacro:"):
            raise HasMacros(f"line {line} of the SRDF has xacro macros; name the file .srdf.xacro to expand it")
        if tag in NEEDED or not above:
            check_names({key: text for key, text in given.items() if key != "value"}, "SRDF", line)
        if len(above) < 2:
            items.append(Item(tag, given, line))
        elif len(above) == 2:
            items[-1].inside.append(InnerElement(tag, given, line))

    walk(text, "SRDF", start)
    return items


def _require(element: Item | InnerElement) -> None:
    """Raise ModelError if an element lacks an attribute without which it means nothing."""
    missing = [key for key in NEEDED.get(element.tag, ()) if not element.attributes.get(key)]
    if missing:
        raise ModelError(f"<{element.tag}> in line {element.line} of the SRDF has no {missing[0]}")


def _group(item: Item) -> Group:
    members: dict[str, list[Any]] = {kind: [] for kind in MEMBERS}
    for part in item.inside:
        if part.tag in MEMBERS:
            _require(part)
            members[part.tag].append(tuple(part.attributes[key] for key in NEEDED[part.tag]))
    links, joints, groups = ([name for (name,) in members[kind]] for kind in ("link", "joint", "group"))
    return Group(item.name, tuple(links), tuple(joints), tuple(members["chain"]), tuple(groups))


def _read_state(item: Item, state: dict[str, tuple[float, ...]]) -> str:
    """Add the joint values of a <group_state> to `state`; return why this configuration cannot be used, or ''."""
    if not item.name:
        return f"<group_state> in line {item.line} of the SRDF has no name"
    for part in item.own("joint"):
        joint, text = part.attributes.get("name", ""), part.attributes.get("value", "")
        values = tuple(attribute_numbers(text) or [])
        if not joint:
            return f"<joint> in line {part.line} of the SRDF has no name"
        if not values or not all(map(math.isfinite, values)):
            return f"joint '{joint}' in line {part.line} of the SRDF: value \"{text[:60]}\" is not a finite number"
        if state.setdefault(joint, values) != values:
            return f"it gives joint '{joint}' two values, the second in line {part.line}"
    return ""
