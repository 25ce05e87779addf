"""Checks a URDF before Pinocchio reads it, and finds what `ik check` reports, element by element.

Pinocchio's parser accepts zero axes, reversed limits and negative sizes, rejects an invalid tree without naming the
element, and crashes the process on a very long chain. So every file first goes through our own streaming parse, which
has size limits, rejects a DOCTYPE, expands no entity and fetches nothing.
"""

import difflib
import functools
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from ...errors import ModelError
from ...text import first_few, in_shell
from ..geometry.meshes import find_mesh, mesh_folders, mesh_packages
from .finding import Finding, did_you_mean, error_finding, notes, odd
from .mimic import followers
from .urdf import ITEMS, SIZES, InnerElement, Item, is_text, parse, safe_read
from .urdf_values import check_all_zero, check_joint, link_values, unversioned

HINTS = 10  # At most this many similar names are searched for in a file, because each is compared with all others.


def check_urdf(
    source: str | Path, package_dirs: Iterable[str | Path] = (), *, file: Path | None = None
) -> list[Finding]:
    """Return everything wrong with a URDF (path or text): errors, which prevent loading, then warnings.

    `file` is the file that a text comes from. Meshes are searched for only in the file's folder, its ROS package and
    package_dirs; network addresses are never opened.
    """
    try:
        text = safe_read(source)
    except ModelError as error:
        return [error_finding("file", str(error), "give a plain URDF file", 0)]
    items = parse(text)
    file = file if is_text(source) else Path(source)
    names = [part.attributes.get("filename", "") for item in items for part in item.inside if part.tag == "mesh"]
    packages, folders = mesh_packages(names, file, package_dirs), mesh_folders(file, package_dirs)
    found = [*findings(text), *(finding for item in items for finding in _meshes(item, folders, packages))]
    errors = [finding for finding in found if finding.severity == "error"]
    if not errors:
        from .urdf_model import build_model

        try:
            build_model(text)
        except Exception as error:
            said = str(error).strip().splitlines()[-1]
            errors.append(error_finding("robot", f"Pinocchio rejects it: {said}", "this is Pinocchio's own message", 0))
    return [*errors, *(finding for finding in found if finding.severity == "warning")]


def require_loadable(text: str, lines: bool = True) -> tuple[str, ...]:
    """Check a URDF text before it is loaded; return the warnings that loading logs, a sentence each.

    Raises ModelError, which names the first error, if there is one (`check_urdf` lists all). `lines` tells whether line numbers of
    the text are those of the file, and so may be named.
    """
    found = findings(text)
    errors = [finding for finding in found if finding.severity == "error"]
    if errors:
        more = in_shell(f" (and {len(errors) - 1} more; `ik check` lists them)") if len(errors) > 1 else ""
        raise ModelError(f"the URDF cannot be used: {errors[0]}{more}; {errors[0].advice}")
    return notes(found, lines)


@functools.lru_cache(maxsize=4)
def findings(text: str) -> tuple[Finding, ...]:
    """Return the errors and warnings about a URDF text that can be parsed, without those about its mesh files."""
    return tuple(_findings(text))


def _findings(text: str) -> Iterator[Finding]:
    items = parse(text)
    links = [item for item in items if item.tag == "link"]
    joints = [item for item in items if item.tag == "joint"]
    if not links:
        yield error_finding("robot", "it has no link", "a robot has at least a base link", items[0].line)
    for group in (links, joints):
        seen: dict[str, Item] = {}
        for item in group:
            if not item.name:
                yield error_finding(item, "it has no name", "give it a unique name", item.line)
            elif item.name in seen:
                lines = f"lines {seen[item.name].line} and {item.line}"
                yield error_finding(item, f"the name is used twice ({lines})", "rename one of them", item.line)
            seen.setdefault(item.name, item)
    for joint in joints:
        if joint.name == "universe":
            yield error_finding(joint, "Pinocchio reserves this name for the world", "rename it", joint.line)
        yield from check_joint(joint)
    if links:
        yield from _tree(links, joints)
    yield from check_all_zero(joints)
    yield from unversioned(items)
    yield from misspelled(items)
    for link in links:
        yield from link_values(link)
    for item in items:
        if item.tag.startswith("xacro:"):
            told = f"<{item.tag}> calls a macro that the file does not define; it is ignored"
            yield odd("robot", told, "expand the original file with xacro, or remove it", item.line, at_load=True)
    yield from _loose(text, joints)


def _near(name: str, options: Iterable[str], before: int) -> str:
    """Return '. Did you mean ...?' or ''; before: number of earlier searches, of which at most HINTS are made."""
    found = did_you_mean(name, options) if before < HINTS else ""
    return f".{found}" if found else ""


def _tree(items: list[Item], joints: list[Item]) -> Iterator[Finding]:
    lines = {item.name: item.line for item in reversed(items)}
    links = set(lines)
    parent_of: dict[str, str] = {}
    names, broken = sorted(links), 0
    for joint in joints:
        ends = {}
        for role in ("parent", "child"):
            link = ends[role] = (joint.first(role) or {}).get("link", "")
            if link not in links:
                said = f"it has no {role} link" if not link else f"its {role} link '{link}' does not exist"
                yield error_finding(joint, said, f"name an existing link{_near(link, names, broken)}", joint.line)
                broken += 1
        if ends["child"] in parent_of and ends["child"] in links:
            told = f"joint '{joint.name}' is a second parent joint"
            yield error_finding(f"link '{ends['child']}'", told, "a link has exactly one parent joint", joint.line)
            broken += 1
        parent_of.setdefault(ends["child"], ends["parent"])
    if broken:
        return  # With broken joints, errors about roots and cycles would only be consequences.
    done = links - parent_of.keys()
    if len(done) > 1:
        told = f"it has {len(done)} root links: {_some(done)}"
        yield error_finding("robot", told, "connect them by joints to one root", min(lines[link] for link in done))
    for link in names:
        walk: dict[str, None] = {}
        while link not in done and link not in walk:
            walk[link] = None
            link = parent_of[link]
        if link in walk:
            loop = list(walk)[list(walk).index(link) :]
            told = f"it is its own ancestor: {_some(loop)} form a loop"
            yield error_finding(f"link '{link}'", told, "a URDF is a tree: remove one joint", lines[link])
        done.update(walk)


def _some(names: Iterable[str]) -> str:
    return first_few([f"'{name}'" for name in sorted(names)])


def _loose(text: str, joints: list[Item]) -> Iterator[Finding]:
    """Yield warnings about mimic joints that stay fixed because they cannot follow their leaders."""
    names = {joint.name: joint.line for joint in reversed(joints)}
    for count, (joint, why) in enumerate(followers(text).loose.items()):
        leader = re.search("'(.*)'", why)
        hint = _near(leader[1], names, count) if leader and leader[1] not in names else ""
        yield odd(f"joint '{joint}'", f"it {why}: it stays fixed", f"name a joint that moves{hint}", names[joint])


def _meshes(item: Item, folders: list[Path], packages: dict[str, Path]) -> Iterator[Finding]:
    for part in item.inside:
        if part.tag != "mesh":
            continue
        name = part.attributes.get("filename", "")
        try:
            find_mesh(name, folders, packages)
        except ModelError as error:
            advice = "needed only for display and collision checking; see package_dirs"
            yield odd(item, f"mesh '{name[:200]}' {error}", advice, part.line)


ADVICE = "correct the name; as it is, every reader of URDF ignores it"
ROOT = ("link", "joint", "material")
ELEMENTS: Mapping[str, tuple[str, ...]] = {  # For each element, the elements that it may contain.
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "calibration", "safety_controller"),
    "link": ("inertial", "visual", "collision"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry", "material"),
    "geometry": (*SIZES, "mesh"),
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
    **{tag: tuple(sizes) for tag, sizes in SIZES.items()},
    "mesh": ("filename", "scale"),
}
# No software adds attributes of its own to these elements of URDF, so an unknown attribute of one is probably misspelled.
CLOSED = ("origin", "axis", "mimic", "parent", "child")
KINEMATIC = ("xyz", "rpy", "quat_xyzw", "quat_wxyz", "lower", "upper", "multiplier", "rotation", "translation")
SINGLE = ("origin", "parent", "child", "axis", "limit", "mimic")
MOST = 500  # At most this many unknown names in a file are compared with known ones, to bound the time.
# A name at least this similar (0 to 1) to a known one counts as misspelled; "gear_velocity" is less similar to "velocity".
NEAR = 0.82


def misspelled(items: Iterable[Item]) -> Iterator[Finding]:
    """Yield warnings for unknown elements and attributes of links and joints, and for elements that a joint has twice."""
    seen: set[str] = set()
    for item in items:
        if item.tag in ("link", "joint"):
            yield from _attributes(item, InnerElement(item.tag, item.attributes, item.line), seen)
            for part in item.inside:
                yield from _part(item, part, seen)
            if item.tag == "joint":
                yield from _twice(item)
        elif item.tag not in (*ITEMS, "robot") and (near := _known_like(item.tag, ROOT, seen)):
            yield _unknown("robot", f"<{item.tag}>", f"<{near}>", item.line)
        elif item.tag not in ITEMS and item.inside:
            told = f"its joints (line {item.inside[0].line}) are ignored, because they are inside <{item.tag}>"
            yield odd(item, told, "write links and joints directly below <robot>", item.line, at_load=True)


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
    near = _known_like(part.tag, known, seen)
    if near:
        yield _unknown(item, f"<{part.tag}>", f"<{near}>", part.line)
    elif ":" not in part.tag and (
        inside == "geometry"
        or (item.tag == "joint" and (part.tag == "pose" or any(key in KINEMATIC for key in part.attributes)))
    ):
        yield _unknown(item, f"<{part.tag}>", "", part.line)


def _attributes(item: Item, part: InnerElement, seen: set[str]) -> Iterator[Finding]:
    known = ATTRIBUTES.get(part.tag, ())
    for key in part.attributes if known else ():
        if key in known or key.startswith("xmlns"):
            continue
        near = _known_like(key, known, seen)
        # An attribute with a namespace is an extension, unless it resembles a known name.
        if near or (":" not in key and part.tag in CLOSED):
            yield _unknown(item, f"{key}= of <{part.tag}>", f"{near}=" if near else "", part.line)


def _twice(joint: Item) -> Iterator[Finding]:
    for tag in SINGLE:
        several = joint.own(tag)
        if len(several) > 1:
            lines = " and ".join(str(part.line) for part in several[:2])
            told = f"it has {len(several)} <{tag}> (lines {lines}): only the first is read"
            yield odd(joint, told, "remove the others", several[1].line, at_load=True)


def _unknown(element: object, name: str, near: str, line: int) -> Finding:
    told = f"{name} is not known and is ignored" + (f"; did you mean {near}?" if near else "")
    return odd(element, told, ADVICE, line, at_load=True)


def _known_like(name: str, known: tuple[str, ...], seen: set[str]) -> str:
    """Return the known name that is similar to a misspelled one, or ''; seen: results for earlier names of this file."""
    if len(seen) >= MOST and name not in seen:
        return ""
    seen.add(name)
    return _like(name[:100], known)


@functools.lru_cache(maxsize=2 * 1024)
def _like(name: str, known: tuple[str, ...]) -> str:
    said = name.rpartition(":")[2].lower().replace("-", "_")
    begins = [one for one in known if said.startswith(one) and len(said) <= len(one) + 5]
    return next(iter(begins or difflib.get_close_matches(said, known, 1, NEAR)), "")
