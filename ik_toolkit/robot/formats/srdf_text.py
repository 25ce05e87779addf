"""Parses SRDF text once, as a stream with size limits, with no entity expanded and nothing fetched."""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import ModelError
from .urdf import HasMacros, attribute_numbers, check_names, walk

MEMBERS = ("link", "joint", "chain", "group")  # A <group> may hold these elements.
FACTS = ("group", "end_effector", "group_state", "passive_joint", "disable_collisions")
FACTS += ("disable_default_collisions", "enable_collisions")
NEEDED = {  # Maps an element to the attributes that it must have.
    "chain": ("base_link", "tip_link"),
    "link": ("name",),
    "joint": ("name",),
    "group": ("name",),
    "end_effector": ("name", "parent_link"),
    "group_state": ("name",),
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

    `parent_link` is the link that carries it, `group` has its own parts, and `parent_group` is the group it is mounted
    on ('' if the SRDF does not say).
    """

    name: str
    parent_link: str
    group: str = ""
    parent_group: str = ""


@functools.lru_cache(maxsize=16)
def contents(text: str) -> dict[str, Any]:
    """Parse SRDF text into the fields of an `Srdf`. Raises ModelError if it is malformed or exceeds a size limit."""
    name = ""
    groups: dict[str, dict[str, list]] = {}
    ends: dict[str, EndEffector] = {}
    states: dict[str, dict[str, dict[str, tuple[float, ...]]]] = {}
    lost: dict[tuple[str, str], str] = {}  # reason for each (configuration, group) that is left out
    passive: list[str] = []
    disabled: dict[tuple[str, str], str] = {}
    quiet: list[str] = []
    enabled: list[tuple[str, str]] = []
    remarks: list[str] = []
    inside: list[str] = []  # name of the group being read, or of the configuration and its group

    def start(tag: str, given: dict[str, str], above: Sequence[str], line: int) -> None:
        nonlocal name
        if not above:
            if tag != "robot":
                raise ModelError(f"the root element is <{tag}>, not <robot>: this is not an SRDF")
            check_names(given, "SRDF", line)
            name = given.get("name", "")
            return
        if tag.startswith("xacro:"):
            raise HasMacros(f"line {line} of the SRDF has xacro macros; name the file .srdf.xacro to expand it")
        of_state = list(above[1:]) == ["group_state"] and tag == "joint"
        of_group = list(above[1:]) == ["group"] and tag in MEMBERS
        if not (of_state or of_group or (len(above) == 1 and tag in FACTS)):
            return
        check_names({key: text for key, text in given.items() if key != "value"}, "SRDF", line)
        missing = [key for key in NEEDED[tag] if not given.get(key)]
        if of_state or tag == "group_state":
            _state(tag, given, line, states, inside, lost)
        elif missing:
            raise ModelError(f"<{tag}> in line {line} of the SRDF has no {missing[0]}")
        elif of_group:
            member = (given["base_link"], given["tip_link"]) if tag == "chain" else given["name"]
            groups[inside[0]][tag].append(member)
        elif tag == "group":
            if given["name"] in groups:
                raise ModelError(f"group '{given['name']}' is defined twice in the SRDF, again in line {line}")
            inside[:] = [given["name"]]
            groups[given["name"]] = {kind: [] for kind in MEMBERS}
        elif tag == "end_effector":
            links = (given.get(key, "") for key in ("parent_link", "group", "parent_group"))
            ends[given["name"]] = EndEffector(given["name"], *links)
        elif tag == "passive_joint":
            passive.append(given["name"])
        elif tag == "disable_collisions":
            if given["link1"] != given["link2"]:
                disabled[given["link1"], given["link2"]] = given.get("reason", "")
        elif tag == "enable_collisions":
            enabled.append((given["link1"], given["link2"]))
        elif tag == "disable_default_collisions":
            quiet.append(given["link"])

    walk(text, "SRDF", start)
    made = _groups(groups, remarks)
    for (state, group), why in lost.items():
        whose = f" of group '{group}'" if group else ""
        remarks.append(f"configuration '{state}'{whose} is left out: {why}")
        states.get(state, {}).pop(group, None)
    states = {state: by_group for state, by_group in states.items() if by_group}
    return {
        "name": name,
        "groups": made,
        "end_effectors": ends,
        "states": states,
        "passive_joints": tuple(dict.fromkeys(passive)),
        "disabled": disabled,
        "quiet": tuple(quiet),
        "enabled": tuple(enabled),
        "remarks": tuple(remarks),
    }


def _state(
    tag: str,
    given: Mapping[str, str],
    line: int,
    states: dict[str, dict[str, dict[str, tuple[float, ...]]]],
    inside: list[str],
    lost: dict[tuple[str, str], str],
) -> None:
    """Read a <group_state> or a joint inside one; an error in it removes this configuration and no other."""
    if tag == "group_state":
        name, group = inside[:] = [given.get("name", ""), given.get("group", "")]
        if not name:
            lost[name, group] = f"<group_state> in line {line} of the SRDF has no name"
        states.setdefault(name, {}).setdefault(group, {})
        return
    state, joint, text = states[inside[0]][inside[1]], given.get("name", ""), given.get("value", "")
    values, why = tuple(attribute_numbers(text) or []), ""
    if not joint:
        why = f"<joint> in line {line} of the SRDF has no name"
    elif not values or not all(map(math.isfinite, values)):
        why = f"joint '{joint}' in line {line} of the SRDF: value \"{text[:60]}\" is not a finite number"
    elif state.setdefault(joint, values) != values:
        why = f"it gives joint '{joint}' two values, the second in line {line}"
    if why:
        lost.setdefault((inside[0], inside[1]), why)


def _groups(found: Mapping[str, Mapping[str, list]], remarks: list[str]) -> dict[str, Group]:
    """Make the groups from the members found, and remark on each subgroup that does not exist."""
    made = {name: Group(name, *(tuple(parts[kind]) for kind in MEMBERS)) for name, parts in found.items()}
    for group in made.values():
        unknown = [inner for inner in group.groups if inner not in made]
        if unknown:
            remarks.append(f"group '{group.name}' contains the group '{unknown[0]}', which does not exist")
    return made
