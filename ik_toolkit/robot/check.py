"""Checks a URDF must pass before Pinocchio sees it, and the findings of `ik check`, element by element.

Pinocchio's parser accepts zero axes, reversed limits and negative sizes, rejects an invalid tree without naming the
element, and crashes the process on a very long chain. So every file first goes through our own streaming parse: capped,
with no DOCTYPE, no entity expanded and nothing fetched.
"""

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import ModelError, near_match
from .meshes import find_mesh, mesh_folders, mesh_packages
from .mimic import MOVING, followers
from .read import NUMBERS, Item, is_text, numbers, parse, safe_read, wrong_scale

TYPES = (*MOVING, "fixed", "floating", "planar")
HINTS = 10  # near matches searched for in one file: each compares a name with every other


@dataclass(frozen=True)
class Finding:
    """One finding: severity ('error': the robot cannot be loaded; 'warning'), element ("joint 'j3'"), problem, advice."""

    severity: str
    element: str
    problem: str
    advice: str

    def __str__(self) -> str:
        """Return element and problem in one sentence."""
        return f"{self.element}: {self.problem}"


def check_urdf(
    source: str | Path, package_dirs: Iterable[str | Path] = (), *, file: Path | None = None
) -> list[Finding]:
    """Everything wrong with a URDF (path or text): errors, which prevent loading, then warnings.

    file: the file a text came from. Meshes are searched for only in the file's folder, its ROS package and package_dirs;
    network addresses are never opened.
    """
    try:
        text = safe_read(source)
    except ModelError as error:
        return [Finding("error", "file", str(error), "give a plain URDF file")]
    items = parse(text)
    file = file if is_text(source) else Path(source)
    names = [attributes.get("filename", "") for item in items for tag, attributes in item.inside if tag == "mesh"]
    packages, folders = mesh_packages(names, file, package_dirs), mesh_folders(file, package_dirs)
    warnings = [finding for item in items for finding in (*_remarks(item), *_meshes(item, folders, packages))]
    warnings += _loose(text, items)
    found = list(_errors(items))
    errors = [finding for finding in found if finding.severity == "error"]
    warnings += [finding for finding in found if finding.severity == "warning"]
    if not errors:
        from .build import build_model

        try:
            build_model(text)
        except Exception as error:
            said = str(error).strip().splitlines()[-1]
            errors.append(_error("robot", f"Pinocchio rejects it: {said}", "this is Pinocchio's own message"))
    return [*errors, *warnings]


def require_loadable(text: str) -> None:
    """Raise ModelError naming the first invalid element of a URDF's kinematics (`check_urdf` lists all)."""
    findings = [finding for finding in _errors(parse(text)) if finding.severity == "error"]
    if findings:
        more = f" (and {len(findings) - 1} more; `ik check` lists them)" if len(findings) > 1 else ""
        raise ModelError(f"the URDF cannot be used: {findings[0]}{more}; {findings[0].advice}")


def _errors(items: list[Item]) -> Iterator[Finding]:
    links = [item for item in items if item.tag == "link"]
    joints = [item for item in items if item.tag == "joint"]
    if not links:
        yield _error("robot", "it has no link", "a robot has at least a base link")
        return
    for group in (links, joints):
        seen: dict[str, Item] = {}
        for item in group:
            if not item.name:
                yield _error(str(item), "it has no name", "give it a unique name")
            elif item.name in seen:
                lines = f"lines {seen[item.name].line} and {item.line}"
                yield _error(str(item), f"the name is used twice ({lines})", "rename one of them")
            seen.setdefault(item.name, item)
    if any(joint.name == "universe" for joint in joints):
        yield _error("joint 'universe'", "Pinocchio reserves this name for the world", "rename it")
    for item in items:
        yield from _numbers(item)
    for joint in joints:
        yield from _joint(joint)
    yield from _tree({link.name for link in links}, joints)


def _error(element: str, problem: str, advice: str) -> Finding:
    return Finding("error", element, problem, advice)


def _near(name: str, options: Iterable[str], before: int) -> str:
    """Return '. Did you mean ...?' or '', without the list of all names; before: number of hints searched for so far."""
    found = near_match(name, options).partition(" Available")[0] if before < HINTS else ""
    return f".{found}" if found.startswith(" Did") else ""


def _numbers(item: Item) -> Iterator[Finding]:
    for tag, attributes in item.inside:
        for key, count in NUMBERS.get(tag, {}).items():
            if key not in attributes:
                continue
            values = numbers(attributes[key])
            shown = f'<{tag} {key}="{attributes[key][:60]}">'
            if tag == "mesh" and wrong_scale(attributes):
                yield Finding("warning", str(item), f"{shown} is not 3 numbers", "the shape is ignored; correct it")
            elif values is None or len(values) != count:
                yield _error(
                    str(item), f"{shown} is not {'a number' if count == 1 else f'{count} numbers'}", "correct it"
                )
            elif not all(map(math.isfinite, values)):
                yield _error(str(item), f"{shown} is not finite", "write a finite number")


def _joint(joint: Item) -> Iterator[Finding]:
    kind = joint.attributes.get("type")
    if kind not in TYPES:
        said = "it has no type" if kind is None else f"its type '{kind}' is unknown"
        yield _error(str(joint), said, f"use one of: {', '.join(TYPES)}")
        return
    if kind not in MOVING:
        return
    axis = numbers((joint.first("axis") or {}).get("xyz", "1 0 0"))
    if axis is not None and len(axis) == 3 and not 1e-6 < math.hypot(*axis) < math.inf:
        yield _error(
            str(joint), "its axis is zero, so it has no direction to move in", "write a unit axis such as 0 0 1"
        )
    limit = joint.first("limit")
    if limit is None:
        if kind != "continuous":
            yield _error(
                str(joint), "it has no <limit>", "add lower, upper, effort and velocity, or make it continuous"
            )
        return
    for key in ("effort", "velocity"):
        if key not in limit:
            yield _error(str(joint), f"its <limit> has no {key}", f"add {key} (Pinocchio rejects the file without it)")
        elif (numbers(limit[key]) or [0.0])[0] < 0.0:
            yield _error(str(joint), f"its {key} limit is negative ({limit[key]})", "write a positive number")


def _tree(links: set[str], joints: list[Item]) -> Iterator[Finding]:
    parent_of: dict[str, str] = {}
    names, broken = sorted(links), 0
    for joint in joints:
        ends = {}
        for role in ("parent", "child"):
            link = ends[role] = (joint.first(role) or {}).get("link", "")
            if link not in links:
                said = f"it has no {role} link" if not link else f"its {role} link '{link}' does not exist"
                yield _error(str(joint), said, f"name an existing link{_near(link, names, broken)}")
                broken += 1
        if ends["child"] in parent_of and ends["child"] in links:
            yield _error(
                f"link '{ends['child']}'",
                f"joint '{joint.name}' is a second parent joint",
                "a link has exactly one parent joint",
            )
            broken += 1
        parent_of.setdefault(ends["child"], ends["parent"])
    if broken:
        return  # wrong roots and cycles would only repeat the above
    done = links - parent_of.keys()
    if len(done) > 1:
        yield _error("robot", f"it has {len(done)} root links: {_some(done)}", "connect them by joints to one root")
    for link in names:
        walk: dict[str, None] = {}
        while link not in done and link not in walk:
            walk[link] = None
            link = parent_of[link]
        if link in walk:
            loop = list(walk)[list(walk).index(link) :]
            yield _error(
                f"link '{link}'",
                f"it is its own ancestor: {_some(loop)} form a loop",
                "a URDF is a tree: remove one joint",
            )
        done.update(walk)


def _some(names: Iterable[str]) -> str:
    listed = sorted(names)
    return ", ".join(f"'{name}'" for name in listed[:5]) + (f" and {len(listed) - 5} more" if len(listed) > 5 else "")


def _loose(text: str, items: list[Item]) -> Iterator[Finding]:
    """Warnings about mimic joints that stay fixed because they cannot follow their leaders."""
    names = [item.name for item in items if item.tag == "joint"]
    for count, (joint, why) in enumerate(followers(text).loose.items()):
        leader = re.search("'(.*)'", why)
        hint = _near(leader[1], names, count) if leader and leader[1] not in names else ""
        yield Finding("warning", f"joint '{joint}'", f"it {why}: it stays fixed", f"name a joint that moves{hint}")


def _remarks(item: Item) -> Iterator[Finding]:
    if item.tag == "joint":
        kind, limit = item.attributes.get("type"), item.first("limit")
        if kind in ("floating", "planar"):
            told = f"a {kind} joint is held still, and poses are given in the link it carries"
            yield Finding("warning", str(item), told, "give base_limits= to let it move, or make it fixed")
        normal = numbers((item.first("axis") or {}).get("xyz", "1 0 0"))  # along x where none is given, says URDF
        if kind == "planar" and normal and any(normal[:2]):
            told = "Pinocchio moves a planar joint along its x and y, whatever its axis"
            yield Finding(
                "warning", str(item), told, "turn its <origin> so that the normal is its z, with the axis 0 0 1"
            )
        if kind in ("revolute", "prismatic") and limit is not None:
            missing = [end for end in ("lower", "upper") if end not in limit]
            lower, upper = (numbers(limit.get(end, "0")) for end in ("lower", "upper"))
            if missing:
                yield Finding(
                    "warning",
                    str(item),
                    f"its <limit> has no {' and no '.join(missing)}: read as 0",
                    "write both limits",
                )
            if lower and upper and lower[0] > upper[0]:
                yield Finding(
                    "warning",
                    str(item),
                    f"its lower limit {lower[0]:g} is above its upper limit {upper[0]:g}: no tip can use it",
                    "swap them",
                )
            if lower and lower == upper:
                yield Finding(
                    "warning",
                    str(item),
                    f"its limits are both {lower[0]:g}: it cannot move",
                    "widen them, or make it fixed",
                )
        return
    for tag, attributes in item.inside:
        for key in ("radius", "length", "size"):
            values = (
                numbers(attributes[key])
                if tag in ("box", "cylinder", "capsule", "sphere") and key in attributes
                else None
            )
            if values and min(values) <= 0.0:
                yield Finding("warning", str(item), f"<{tag}> has the {key} {attributes[key]}", "sizes are positive")
        scale = numbers(attributes.get("scale", "")) if tag == "mesh" else None
        if scale and min(map(abs, scale)) == 0.0:
            yield Finding(
                "warning",
                str(item),
                f"its mesh has the scale {attributes['scale']}",
                "a zero scale leaves nothing to draw",
            )


def _meshes(item: Item, folders: list[Path], packages: dict[str, Path]) -> Iterator[Finding]:
    for tag, attributes in item.inside:
        if tag != "mesh":
            continue
        name = attributes.get("filename", "")
        try:
            find_mesh(name, folders, packages)
        except ModelError as error:
            advice = "needed only for display and collision checking; see package_dirs"
            yield Finding("warning", str(item), f"mesh '{name[:200]}' {error}", advice)
