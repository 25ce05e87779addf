"""What of a target an arm can meet, when it cannot meet all of it: for the sentence of a failure."""

from typing import Any

import numpy as np

from ..kernel.counted_error import POSE, POSITION
from ..kernel.records import ANSWER
from .task import Counts, all_errors, counted_rows, what_counts

ATTEMPTS = 20  # starts of a search that looks for a part of the target
FAINT = 1e-3  # weight of the orientation in such a search, so that the position comes first
NEAR = 1e-4  # [reaches] from the position, at which such a search ends where it can be reached


def impossible(result: Any) -> list[str]:
    """What of its target each tip never has, however the joints stand: sentences."""
    of = result._of
    if not of.T.size:  # a row of a batch keeps no target
        return []
    found, o = [], of.plan.options
    given = zip(result.robot.arms, of.kinds, of.T.reshape(-1, 4, 4), what_counts(result.robot, o), strict=True)
    for arm, kind, T, counts in given:
        if kind not in (POSE, POSITION) or o.relative_to or counts != Counts(None, None, None, counts.frame):
            continue
        target = T[:3, 3] if kind == POSITION else T
        at = f"{arm.tip}: " if len(of.kinds) > 1 else ""
        found += [at + text for text in arm.mobility.never(target, (o.position_tolerance, o.orientation_tolerance))]
    return found


def too_few_joints(result: Any) -> str:
    """What says that the target fixes more directions than an arm can move in; or ''."""
    of, texts = result._of, []
    rows = counted_rows(result.robot, of.kinds, of.plan.options).reshape(-1, 2, 3).sum(axis=2)
    for arm, (lengths, angles) in zip(result.robot.arms, rows.tolist(), strict=True):
        # What never changes is met or named by `impossible`: it takes no joint.
        still = {0: 3, 1: 2, 3: 0}.get(arm.mobility.turns, 0)
        fixed = max(0, lengths - len(arm.mobility.normals)) + max(0, angles - still)
        able = arm.mobility.directions
        if fixed > able:
            name = "the arm" if len(rows) == 1 else arm.tip
            joints = f"{arm.n} joint{'s' * (arm.n != 1)}"
            moves = "" if able == arm.n else f", which move the tip in {able} directions"
            texts.append(f"{name} has {joints}{moves}, and the target fixes {fixed}")
    return "; ".join(texts)


def position_alone(result: Any, turned: bool) -> str:
    """Whether the position of a single pose can be reached without its orientation, and how near that comes; or ''.

    turned: how far the orientation is off is said elsewhere.
    """
    of = result._of
    if of.kinds != (POSE,) or not of.T.size or of.plan.options.in_part:
        return ""
    plan = of.plan.search(
        mask=(1.0, 1.0, 1.0, FAINT, FAINT, FAINT), restarts=ATTEMPTS - 1, max_evaluations=None, timeout=None, follow=0.0,
        closest=False, objective=None, history=False, avoid_collisions=False,
    )  # fmt: skip
    q = of.row[ANSWER : ANSWER + result.robot.n]
    row = plan.solve(of.T, of.kinds, q[None], True)
    ((raw, _, _),) = all_errors(result.robot, row[ANSWER : ANSWER + len(q)], of.T, of.kinds, plan.options)
    if np.linalg.norm(raw[:3]) > NEAR * result.robot.reach:
        return ""
    if turned:
        return "the position alone can be reached"
    nearest = np.degrees(np.linalg.norm(raw[3:]))
    return f"the position alone can be reached; the nearest orientation found there is {nearest:.3g} deg off"
