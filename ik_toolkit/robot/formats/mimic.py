"""Mimic joints of a URDF: the leader and limits of each follower, and an order of the joints in which leaders come first.

Pinocchio can tie a follower only to a leader it has already met. It traverses the tree branch by branch, in the order
of the joint names, so whether a file can be read would depend on how its author named the joints. Where no order puts
every leader first (a follower that carries its leader), the roles are swapped: the same linear relation is solved for
the other joint.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from .urdf import Item, finite_at, limits_of_joint, parse

MOVING = ("revolute", "continuous", "prismatic")


class Tie(NamedTuple):
    """How a mimic joint follows its leader: its value is `ratio` times the value of joint `leader`, plus `offset` [rad or m]."""

    leader: str
    ratio: float
    offset: float


class Followers(NamedTuple):
    """The mimic joints of a robot, and the order in which Pinocchio can read them.

    `tied` maps each mimic joint to its leader, ratio and offset. `loose` maps each mimic joint that cannot follow its leader, and
    so stays fixed, to the reason. `order` lists the names of all joints, and is empty if Pinocchio's own order has every leader
    before its mimic joints. Where the roles of two joints had to be exchanged, `rest` maps the new leader to its value [rad or m]
    for which the leader in the file is at 0.
    """

    tied: dict[str, Tie]
    loose: dict[str, str]
    order: list[str]
    rest: dict[str, float]


@functools.lru_cache(maxsize=4)
def followers(text: str | None) -> Followers:
    """Return the mimic joints of a URDF text, and an order of all joints in which Pinocchio can read them: leaders first.

    Without a text (None) there are no joints.
    """
    items = parse(text) if text else []
    tied, loose = ties(items)
    if not tied:
        return Followers(tied, loose, [], {})
    own = leaders_first(items, {})[0]
    given = tied
    order, late = leaders_first(items, given)
    for turned in ({given[name].leader for name in late}, {tie.leader for tie in given.values()}):
        # If in every order some mimic joints precede their leader, the leader and one of them exchange roles. This is tried first
        # for the leaders concerned, then for all.
        if late:
            tied = first_leads(given, turned, own)
            order, late = leaders_first(items, tied)
    tied = {name: tie for name, tie in tied.items() if name not in late}
    rest = {tie.leader: given[tie.leader].offset for tie in tied.values() if tie.leader in given}
    return Followers(tied, loose | late, order if order != own else [], rest)


def mimic_limits(text: str | None) -> dict[str, tuple[str, float, float, float, float]]:
    """Return for each mimic joint of a URDF text (leader, multiplier, offset, lower, upper) [rad or m].

    Its value is q = multiplier q_leader + offset. The limits are those of the mimic joint itself, which Pinocchio drops; +-1e16
    means none.
    """
    tied = followers(text).tied
    found = {}
    for item in parse(text) if text and tied else ():
        if item.tag == "joint" and item.name in tied:
            leader, ratio, offset = tied[item.name]
            found[item.name] = leader, ratio, offset, *limits_of_joint(item)
    return found


def mimic_speeds(text: str | None) -> dict[str, tuple[float, float]]:
    """Return for each mimic joint of a URDF text with a velocity limit of its own (multiplier, limit [rad/s or m/s]).

    A limit of 0 counts as none, because no author means a mimic joint that may not move.
    """
    tied = followers(text).tied
    found = {}
    for item in parse(text) if text and tied else ():
        limit = item.first("limit") if item.tag == "joint" and item.name in tied else None
        speed = finite_at(limit, "velocity")
        if speed and speed[0] > 0.0 and tied[item.name].ratio != 0.0:
            found[item.name] = (tied[item.name].ratio, speed[0])
    return found


def ties(items: Sequence[Item]) -> tuple[dict[str, Tie], dict[str, str]]:
    """Find the leader of each mimic joint; return a Tie for each, and the reasons, by name, of those that cannot follow theirs.

    A joint that mimics a mimic joint follows the leader of both.
    """
    joints = {item.name: item for item in items if item.tag == "joint"}
    moving = {name: item for name, item in joints.items() if item.attributes.get("type") in MOVING}
    given = {name: mimic for name, item in moving.items() if (mimic := item.first("mimic")) is not None}
    tied: dict[str, Tie] = {}
    loose: dict[str, str] = {}
    for name in given:
        # `walk` lists a mimic joint, its leader, the leader of that, and so on, up to a joint that is done or mimics no other.
        walk = [name]
        while walk[-1] in given and walk[-1] not in tied and walk[-1] not in loose:
            leader = given[walk[-1]].get("joint", "")
            if leader in walk:
                # In `walk` the joints from `leader` on mimic each other in a circle; those before it are not part of the circle.
                loop = walk[walk.index(leader) :]
                del walk[walk.index(leader) + 1 :]
                loose |= {name: f"mimics itself through '{given[name].get('joint', '')}'" for name in loop}
                break
            walk.append(leader)
        end = walk.pop()
        if end in loose:
            why = f"mimics joint '{end}', which {loose[end]}"
        elif end in tied or end in joints:
            kind = joints[end].attributes.get("type")
            why = "" if end in moving else f"mimics joint '{end}', which is {kind}"
        else:
            why = f"mimics joint '{end}', which does not exist"
        for follower in reversed(walk):
            if follower in loose:
                continue
            if why:
                loose[follower] = why
                continue
            mimic = given[follower]
            (ratio,), (offset,) = (
                finite_at(mimic, key) or [default] for key, default in (("multiplier", 1.0), ("offset", 0.0))
            )
            above = tied.get(mimic.get("joint", ""), Tie(mimic.get("joint", ""), 1.0, 0.0))
            tied[follower] = Tie(above.leader, ratio * above.ratio, ratio * above.offset + offset)
    return tied, loose


def first_leads(tied: Mapping[str, Tie], leaders: set[str], order: Sequence[str]) -> dict[str, Tie]:
    """Return the mimic relations after each of `leaders` has exchanged roles with the first joint in `order` that follows it.

    The motion is the same: q_leader = (q_follower - offset) / ratio. A mimic joint with ratio 0 cannot become a leader.
    """
    found = dict(tied)
    for leader in leaders:
        group = {name: tie for name, tie in tied.items() if tie.leader == leader}
        first = next(name for name in order if name == leader or (name in group and group[name].ratio != 0.0))
        if first == leader:
            continue
        _, ratio, offset = group.pop(first)
        del found[first]
        found[leader] = Tie(first, 1.0 / ratio, -offset / ratio)
        for name, tie in group.items():
            found[name] = Tie(first, tie.ratio / ratio, tie.offset - tie.ratio * offset / ratio)
    return found


def leaders_first(items: Sequence[Item], tied: Mapping[str, Tie]) -> tuple[list[str], dict[str, str]]:
    """Return the names of all joints, depth-first, with leaders before their mimic joints, and the reasons where that fails.

    The branches of a link are in the order of the joint names, as in Pinocchio, unless a leader requires another order.
    """
    joints = {item.name: item for item in items if item.tag == "joint"}
    ends = {
        name: tuple((item.first(role) or {}).get("link", "") for role in ("parent", "child"))
        for name, item in joints.items()
    }
    above = {child: name for name, (_, child) in ends.items()}
    branches: dict[str, list[str]] = {}
    for name in sorted(joints):
        branches.setdefault(ends[name][0], []).append(name)
    # For the first joint of a branch, the branches of the same link that must be read before it.
    before: dict[str, set[str]] = {}
    loose: dict[str, str] = {}

    def path(joint: str) -> list[str]:
        walk: dict[str, None] = {}
        # Links may be joined in a circle, which is reported elsewhere, so the loop ends at a joint that it has met before.
        while joint and joint not in walk:
            walk[joint] = None
            joint = above.get(ends[joint][0], "")
        return [*walk][::-1]

    for follower, tie in tied.items():
        down, up = path(follower), path(tie.leader)
        if tie.leader in down:
            continue
        fork = next((pair for pair in zip(down, up, strict=False) if pair[0] != pair[1]), None)
        if fork is None:
            loose[follower] = f"mimics joint '{tie.leader}', which it carries"
        elif fork[1] not in before.get(fork[0], ()) and _reaches(before, fork[1], fork[0]):
            loose[follower] = f"mimics joint '{tie.leader}' in a branch that follows its own"
        else:
            before.setdefault(fork[0], set()).add(fork[1])
    order: list[str] = []
    seen: set[str] = set()
    roots = [link for link in branches if link not in above]
    waiting = [name for link in reversed(roots) for name in reversed(branches[link])]
    while waiting:
        name = waiting[-1]
        earlier = sorted(before.get(name, set()) - seen)
        if name in seen:
            waiting.pop()
        elif earlier:
            waiting += reversed(earlier)
        else:
            seen.add(name)
            order.append(waiting.pop())
            waiting += reversed(branches.get(ends[name][1], []))
    return order, loose


def _reaches(before: Mapping[str, set[str]], start: str, end: str) -> bool:
    """Return whether `end` must already come before `start`."""
    waiting, seen = [start], set()
    while waiting:
        branch = waiting.pop()
        if branch == end:
            return True
        if branch not in seen:
            seen.add(branch)
            waiting += before.get(branch, ())
    return False
