"""Poses far apart: others are inserted between them, so that a path is searched along the way and not only at its corners."""

from typing import Any

import numpy as np

from ..kernel.task import FREE, POSITION
from ..robot.pose import angles_between
from .finish import Motion
from .interpolate import interpolate
from .proof import Continuity

FAR = (0.015, np.radians(3.0))  # [fraction of the reach], [rad] between poses: joints then mostly stay within max_step
MOST = 1000  # most inserted poses, a second's work; a path that needs more gets wider spacing
WIDER = 1.5  # factor on the spacing until they are few enough


def inserted(robot: Any, T: np.ndarray, kinds: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Poses T (N, F, 4, 4) with others inserted (M, F, 4, 4), and the place of each (3.5: halfway from 3 to 4)."""
    gaps = np.zeros(len(T) - 1)
    for f, (arm, kind) in enumerate(zip(robot.arms, kinds, strict=True)):
        if kind == FREE:
            continue
        away = np.linalg.norm(np.diff(T[:, f, :3, 3], axis=0), axis=1) / (FAR[0] * arm.chain.reach)
        gaps = np.maximum(gaps, away)
        if kind != POSITION:
            gaps = np.maximum(gaps, angles_between(T[1:, f, :3, :3], T[:-1, f, :3, :3]) / FAR[1])
    pieces = np.maximum(np.ceil(gaps), 1.0)
    while pieces.sum() - len(gaps) > MOST:
        gaps /= WIDER
        pieces = np.maximum(np.ceil(gaps), 1.0)
    if (pieces == 1.0).all():
        return T, np.arange(float(len(T)))
    inner = [k + np.arange(count) / count for k, count in enumerate(pieces.tolist())]
    at = np.append(np.concatenate(inner), len(T) - 1.0)
    return interpolate(T, at, kinds), at


def gaps(at: np.ndarray, breaks: list[int]) -> list[int]:
    """Requested poses after which a path breaks; breaks: the same among all poses, whose places are `at` (M,)."""
    return sorted({int(at[k]) for k in breaks})


def collapsed(motion: Motion, at: np.ndarray) -> Motion:
    """Turn a motion through poses at places `at` (M,) into one through the requested poses; inserted ones become knots.

    If it breaks between two requested poses, it stops at the first and continues at the second.
    """
    asked = np.flatnonzero(at == np.round(at))
    if len(asked) == len(at):
        return motion
    q = motion.q[asked]
    whole = np.asarray(np.isfinite(q).all(axis=1))
    missing = np.floor(at[~np.isfinite(motion.q).all(axis=1)]).astype(int)
    broken = {*gaps(at, motion.found.breaks), *(k for k in missing.tolist() if whole[k : k + 2].sum() == 2)}
    places = np.interp(motion.at, np.arange(len(at)), at)
    inside = np.isin(np.floor(places), list(broken)) & (places != np.round(places))
    inside |= ~np.isfinite(motion.curve).all(axis=1) & (places != np.round(places))
    kept = np.flatnonzero(~inside)
    next_to = np.diff(kept) == 1
    found, proof = motion.found, motion.continuity

    def where(places: Any) -> list[float]:
        moved = np.interp(places, np.arange(len(at)), at)
        return [x for x in moved.tolist() if int(x) not in broken or x == int(x)]

    proof = Continuity(
        np.where(next_to, proof.deviation[kept[:-1]], np.nan),
        np.where(next_to, proof.turn[kept[:-1]], np.nan),
        proof.clearance,
        tuple(one._replace(place=x) for one in proof.contacts for x in where([one.place])),
        tuple(where(proof.unproven)),
        None if proof.lacking is None else np.where(next_to, proof.lacking[:, kept[:-1]], 0.0),
    )
    found = found._replace(q=found.q[asked], tracks=found.tracks[asked], breaks=sorted(broken))
    return Motion(found, q, motion.curve[kept], places[kept], proof, where(motion.leaps))
