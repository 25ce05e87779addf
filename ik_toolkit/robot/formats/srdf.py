"""Reads an SRDF, which has what a URDF leaves out: allowed collisions, groups, end effectors, configurations, passive joints.

It is parsed like a URDF: once, as a stream with size limits, with no entity expanded and nothing fetched. A name that
the robot does not have is not an error, because one SRDF often serves several URDFs; `Srdf.remarks` lists such names.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ...errors import FrameNotFound, InvalidOption, ModelError, near_match
from ...files import from_home
from ...text import first_few
from ..probe import find_path
from ..tips import frame_id
from .finding import did_you_mean
from .srdf_text import EndEffector, Group, contents
from .urdf import is_text, source_text
from .xacro import expanded

LOG = logging.getLogger("ik_toolkit")
BESIDE = ("", "../srdf")  # Folders in which the SRDF of a robot is searched for, relative to that of its URDF.
MOST = 64  # At most this many SRDF files are read in each folder, to bound the time.
SHOWN = 3  # A remark lists at most this many names.
# A configuration: the values [rad or m] of each joint by name. Most joints have one value.
State = Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Srdf:
    """The contents of an SRDF.

    `name` is that of the robot, `path` the file or None for text. `states` maps the name of a configuration to its groups ('' if
    none is given), and each group to joint values [rad or m]. `virtual_joints` names the joints that tie the robot to the world,
    which the URDF lacks. `disabled` maps pairs of links that may touch to a reason; a link in `quiet` may touch all links except
    those with which it forms a pair in `enabled`. `remarks` are sentences on contents that cannot be used. `group` is the group
    chosen by the user, whose configurations take precedence.
    """

    name: str = ""
    path: Path | None = None
    groups: Mapping[str, Group] = field(default_factory=dict)
    end_effectors: Mapping[str, EndEffector] = field(default_factory=dict)
    states: Mapping[str, Mapping[str, State]] = field(default_factory=dict)
    passive_joints: tuple[str, ...] = ()
    virtual_joints: tuple[str, ...] = ()
    disabled: Mapping[tuple[str, str], str] = field(default_factory=dict)
    quiet: tuple[str, ...] = ()
    enabled: tuple[tuple[str, str], ...] = ()
    remarks: tuple[str, ...] = ()
    group: str = ""

    def state(self, name: str, joints: Sequence[str], tips: Sequence[str], model: pin.Model) -> dict[str, float]:
        """Return the values [rad or m] that a configuration gives to those joints that are in the q of a robot with these tips.

        Several groups may define a configuration of this name. If the user chose a group, only that group's values count. Otherwise
        groups are considered in this order: those that end in the robot's tips, those that set more joints of q, those first in the
        file. A group that sets a joint of an earlier one is left out, so that values of contradicting groups are not mixed.
        """
        given = {
            group: {joint: x[0] for joint, x in values.items() if len(x) == 1}
            for group, values in self.states[name].items()
        }
        if self.group in given:
            given = {self.group: given[self.group]}
        order = sorted(given, key=lambda group: (not self._fits(group, tips, model), -len({*joints} & {*given[group]})))
        found: dict[str, float] = {}
        for group in order:
            if not found.keys() & given[group].keys():
                found |= given[group]
        return {joint: x for joint, x in found.items() if joint in joints}

    def _fits(self, group: str, tips: Sequence[str], model: pin.Model) -> bool:
        """Return whether a group ends in exactly these tips."""
        try:
            return {*self.ends(group, model)[1]} == {*tips}
        except InvalidOption:
            return False

    def may_touch(self, links: Sequence[str]) -> dict[tuple[str, str], str]:
        """Return the pairs of links among `links` that need no collision test, each with the reason that the SRDF gives."""
        known, out = set(links), dict[tuple[str, str], str]()
        on = {frozenset(pair) for pair in self.enabled}
        for link in known.intersection(self.quiet):
            out |= {(link, other): "Default" for other in links if other != link}
        out |= {pair: reason for pair, reason in self.disabled.items() if known.issuperset(pair)}
        return {pair: reason for pair, reason in out.items() if frozenset(pair) not in on}

    def ends(self, group: str, model: pin.Model) -> tuple[str | None, tuple[str, ...]]:
        """Return the base frame (None: the root) and the tips of a group on a model.

        Raises InvalidOption if there is no such group or the group has no tip.
        """
        found = self._members(group)
        chains = [chain for chain in found.chains if all(model.existFrame(link) for link in chain)]
        bases, tips = ([*dict.fromkeys(chain[k] for chain in chains)] for k in (0, 1))
        # The tip of a chain where another chain of the group begins is no end of the group.
        if chains:
            inner = [tip for tip in tips if tip in bases]
            bases, tips = [b for b in bases if b not in tips] or bases, [t for t in tips if t not in inner] or tips
        else:
            bases, tips = _ends_of_joints(found, model)
            mounted = [e for e in self.end_effectors.values() if group in (e.parent_group, e.group)]
            carried = [e.parent_link for e in mounted if model.existFrame(e.parent_link)]
            if len(tips) == 1 and len(carried) == 1:
                above = _line(model, frame_id(model, carried[0], model.name))
                tips = carried if frame_id(model, tips[0], model.name) in above else tips
        if not tips:
            links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
            lost = [link for chain in found.chains for link in chain if not model.existFrame(link)] or [
                *(link for link in found.links if not model.existFrame(link)),
                *(joint for joint in found.joints if not model.existFrame(joint)),
            ]
            told = f": the robot has no '{lost[0]}'.{did_you_mean(lost[0], [*links, *model.names])}" if lost else ""
            raise InvalidOption(f"group '{group}' of the SRDF has no chain or moving joint of this robot{told}")
        return (bases[0] if len(bases) == 1 else None), tuple(tips)

    def _members(self, name: str) -> Group:
        """Return a group merged with all its subgroups. Raises InvalidOption if it does not exist."""
        if name not in self.groups:
            if not self.groups:
                raise InvalidOption(
                    f"there is no group '{name}': the robot has no SRDF with groups; name its file (srdf=)"
                )
            raise InvalidOption(f"the SRDF has no group '{name}'.{near_match(name, self.groups)}")
        waiting, seen, found = [name], set[str](), Group(name)
        while waiting:
            group = self.groups.get(waiting.pop(0))
            if group is None or group.name in seen:
                continue
            seen.add(group.name)
            waiting += group.groups
            found = replace(
                found,
                links=found.links + group.links,
                joints=found.joints + group.joints,
                chains=found.chains + group.chains,
            )
        return found

    def against(self, model: pin.Model) -> tuple[str, ...]:
        """Return all remarks on this SRDF: those made when it was read, and those on what does not fit the model.

        The latter are on names that the model lacks, and on joints to which a configuration gives several values or a value outside
        the limits.
        """
        out, links = list(self.remarks), {frame.name for frame in model.frames}
        strange = {link for pair in self.disabled for link in pair if link not in links}
        if strange:
            out.append(f"pairs that may touch: {_are(strange, 'link')} not in the robot")
        groups = self.groups.values()
        for what, kind, names in (
            ("ends of chains", "link", {link for group in groups for chain in group.chains for link in chain}),
            ("end effectors", "link", {e.parent_link for e in self.end_effectors.values()}),
            ("groups", "link", {link for group in groups for link in group.links}),
            ("groups", "joint", {joint for group in groups for joint in group.joints}),
            ("passive joints", "joint", {*self.passive_joints}),
        ):
            lost = names - links - {*self.virtual_joints}
            if lost:
                out.append(f"{what}: {_are(lost, kind)} not in the robot{_meant(lost, links)}")
        for state, groups in self.states.items():
            given = [item for values in groups.values() for item in values.items()]
            known = {*model.names, *links, *self.virtual_joints}
            missing = {joint for joint, _ in given if joint not in known}
            other = {joint for joint, x in given if joint not in missing and len(x) != 1}
            if missing:
                near = _meant(missing, model.names)
                out.append(f"configuration '{state}': {_are(missing, 'joint')} not in the robot{near}")
            if other:
                out.append(f"configuration '{state}': {_are(other, 'joint', ' with several values')} ignored")
            beyond = {joint for joint, x in given if len(x) == 1 and _outside(model, joint, x[0])}
            if beyond:
                out.append(f"configuration '{state}': {_are(beyond, 'joint')} outside the limits")
        return tuple(out)


def read_srdf(source: "str | Path | Srdf") -> Srdf:
    """Read an SRDF from a file or from text.

    Raises ModelError, one sentence with the line, if it is malformed or exceeds a size limit.
    """
    if isinstance(source, Srdf):
        return source
    if not isinstance(source, str | Path):
        raise InvalidOption(f"srdf= takes a file, SRDF text or False, not {source!r:.60}")
    given: str | Path = expanded(source)
    path = None if is_text(given) else from_home(given).absolute()
    return Srdf(path=path, **contents(source_text(given, "SRDF")))


def srdf_of(given: Any, model: pin.Model, path: Path | None, own: Srdf, group: str | None = None) -> Srdf:
    """Return the Srdf that belongs to a model read from `path`.

    It is read from `given`, a file or text; if that is None, from the SRDF file beside `path`, if there is one; if it is False, it
    is empty. `own` has configurations and pairs of links from the description itself (MJCF), which the SRDF overrides. `group` is
    the name of the group chosen by the user.
    """
    if not isinstance(group, str | None):
        raise InvalidOption(f"group takes the name of one group of the SRDF, not {group!r:.60}")
    found = _srdf_of(given, model, path)
    states, pairs = {**own.states, **found.states}, {**own.disabled, **found.disabled}
    return replace(found, states=states, disabled=pairs, group=group or "")


def _srdf_of(given: Any, model: pin.Model, path: Path | None) -> Srdf:
    """Return the Srdf that is given or found next to the file, without the description's configurations.

    Unusable parts of a given SRDF are logged; a malformed SRDF next to the file is logged and ignored.
    """
    if given is None or given is True:
        beside = srdf_beside(path, model.name) if path is not None else None
        if beside is None:
            return Srdf()
        try:
            found = read_srdf(beside)
            for remark in found.remarks:
                LOG.warning("'%s' next to the robot: %s", beside.name, remark)
            return found
        except ModelError as error:
            LOG.warning("'%s' next to the robot is not used: %s", beside.name, error)
            return Srdf(remarks=(f"'{beside.name}' is not used: {error}",))
    if given is False:
        return Srdf()
    found = read_srdf(given)
    for remark in found.against(model):
        LOG.warning("SRDF: %s", remark)
    return found


def group_chain(srdf: Srdf, group: str, model: pin.Model, tip: str | None) -> tuple[str | None, str]:
    """Return the base (None: the root) and tip of a group for a Robot; `tip` is the tip chosen by the user, or None.

    Raises FrameNotFound if the group has several tips and none is chosen, InvalidOption as `Srdf.ends` does.
    """
    base, (end, *more) = srdf.ends(group, model)
    if tip is None and more:
        raise FrameNotFound(
            f"group '{group}' has {1 + len(more)} tips; choose one with tip=, or solve for several with "
            f"ik.Tree.load(source, group='{group}'): {', '.join([end, *more])}"
        )
    return base, tip or end


def passive_joints(
    srdf: Srdf, model: pin.Model, base: int, tip: int, locked: Mapping[str, float]
) -> dict[str, tuple[float, bool]]:
    """Return by name the joints to hold, each with its value [rad or m] and whether it is to be listed as locked.

    These are the joints in `locked` and the passive joints of the SRDF; a passive joint is listed only if it lies between the
    frames base and tip (ids). If all joints between these frames are passive, none of them is held.
    """
    given = {joint: (value, True) for joint, value in locked.items()}
    passive = [name for name in srdf.passive_joints if model.existJointName(name) and name not in locked]
    joints = [j for name in passive if model.joints[j := model.getJointId(name)].nv == 1]
    if not joints:
        return given
    path = find_path(model, base, tip, {model.getJointId(name) for name in locked if model.existJointName(name)})
    if not set(path.leaders) - set(joints):
        return given
    for j in joints:
        joint, value = model.joints[j], 0.0
        low, high = (limit[joint.idx_q] for limit in (model.lowerPositionLimit, model.upperPositionLimit))
        if joint.nq == 1 and low <= high:
            value = float(np.clip(0.0, low, high))
        given[model.names[j]] = value, j in path.leaders
    return given


def srdf_beside(file: Path, name: str) -> Path | None:
    """Find the SRDF that belongs to a robot's URDF file, in the same folder or in ../srdf; return None if there is none.

    Its file name equals or begins that of the URDF ('ur5.srdf' for 'ur5_robot.urdf'; the longest wins), or it is the
    only one whose robot has this name. Symbolic links that lead out of these folders are not followed.
    """
    home = file.expanduser().resolve().parent
    found: list[Path] = []
    for inner in BESIDE:
        folder = (home / inner).resolve()
        files = sorted(folder.glob("*.srdf"))[:MOST] if folder.is_dir() else []
        found += [path for path in files if path.resolve().parent == folder and path.is_file()]
    stem = file.name.removesuffix(".xacro").removesuffix(".urdf")
    begins = [path for path in found if stem == path.stem or stem.startswith((f"{path.stem}_", f"{path.stem}."))]
    begins += [path for path in found if stem.startswith(f"{path.stem}-")]
    if begins:
        return max(begins, key=lambda path: len(path.stem))
    same = [path for path in found if name and _name(path).lower() == name.lower()]
    return same[0] if len(same) == 1 else None


def _name(path: Path) -> str:
    """Return the name of the robot in an SRDF file, or '' if the file cannot be read."""
    try:
        return read_srdf(path).name
    except ModelError:
        return ""


def _ends_of_joints(group: Group, model: pin.Model) -> tuple[list[str], list[str]]:
    """Return the first links and the last links of a group that lists joints, or the links that they move."""
    frames = model.frames
    bodies = {frame.parentFrame: i for i, frame in enumerate(frames) if frame.type == pin.FrameType.BODY}
    ids = {frame.name: i for i, frame in enumerate(frames) if i in bodies}
    links = {frame.name: frame.parentFrame for frame in frames if frame.type == pin.FrameType.BODY}
    joints = [ids[joint] for joint in group.joints if joint in ids]
    joints += [links[link] for link in group.links if link in links]
    joints = [j for j in dict.fromkeys(joints) if j in bodies]
    if not any(frames[j].name in model.names for j in joints):
        return [], []
    lines = {j: _line(model, frames[j].parentFrame) for j in joints}
    last = [j for j in joints if not any(j in line for line in lines.values())]
    first = [j for j in joints if not lines[j] & set(joints)]
    return [*dict.fromkeys(frames[frames[j].parentFrame].name for j in first)], [frames[bodies[j]].name for j in last]


def _line(model: pin.Model, frame: int) -> set[int]:
    """Return the indices of a frame and all its ancestors."""
    seen = set[int]()
    while frame not in seen:
        seen.add(frame)
        frame = model.frames[frame].parentFrame
    return seen


def _outside(model: pin.Model, name: str, value: float) -> bool:
    """Return whether a joint of one coordinate is outside its limits by more than values in files are rounded."""
    if not model.existJointName(name) or (joint := model.joints[model.getJointId(name)]).nq != 1:
        return False
    low, high = (limit[joint.idx_q] for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    return not low - 1e-3 <= value <= high + 1e-3


def _are(names: Iterable[str], what: str, with_what: str = "") -> str:
    """Return the beginning of a sentence: "link 'a' is", or "links 'a', 'b' are"."""
    some = [f"'{name}'" for name in sorted(names)]
    return f"{what}{'s' * (len(some) > 1)} {first_few(some, SHOWN)}{with_what} {'are' if some[1:] else 'is'}"


def _meant(names: set[str], known: Iterable[str]) -> str:
    """Return '. Did you mean ...?' if there is a single unknown name and a known name is similar, otherwise ''."""
    near = did_you_mean(min(names), known) if len(names) == 1 else ""
    return f".{near}" if near else ""
