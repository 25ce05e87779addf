"""How far along a path one continuous motion goes, from its start."""

import numpy as np

from ..kernel.checks import CONVERGED
from ..kernel.counted_error import FREE
from ..kernel.records import ANSWER, AT
from ..robot.rotation import angles_between
from .finish import ProvenMotion
from .freedom import freedom
from .interpolate import interpolate_poses
from .path_search import Search
from .result import pieces

PARTS = 400  # of the path's length, in which it is followed: 0.25 % each
HALVINGS = 5  # of the last part, which is not followed whole
STARTS = 16  # most configurations at the first pose from which it is tried


def lengths(poses: np.ndarray, kinds: tuple) -> np.ndarray:
    """Length of the way (N,) to each pose (N, F, 4, 4), of all tips: in metres, or in radians where nothing moves, from 0 to 1."""
    moves = np.linalg.norm(np.diff(poses[..., :3, 3], axis=0), axis=2)
    moves[:, [kind == FREE for kind in kinds]] = 0.0
    if not moves.any():
        pairs = poses[:-1, :, :3, :3].reshape(-1, 3, 3), poses[1:, :, :3, :3].reshape(-1, 3, 3)
        moves = angles_between(*pairs).reshape(moves.shape)
    way = np.append(0.0, np.cumsum(moves.sum(axis=1)))
    return way / way[-1] if way[-1] > 0.0 else np.linspace(0.0, 1.0, len(way))


def fraction(search: Search, motion: ProvenMotion) -> float:
    """Share of the path's length that one motion follows from the start, to some 0.1 %: without a jump, contact or gap.

    The motion found is followed on from where it first ends; so is every configuration at the first pose, where the start is not
    given. What is found is a lower bound: another posture of a redundant arm may go further.
    """
    p = search.problem
    way, at = lengths(p.poses, p.kinds), p.at
    contacts = [one.place for one in motion.continuity.contacts]
    runs = pieces(motion.curve, motion.at, [*motion.found.breaks, *(int(place) for place in contacts)])
    first = runs[0] if runs and runs[0].start == 0 else None
    if first is not None and first.stop == len(motion.curve):
        return 1.0
    reached = 0.0 if first is None else float(np.interp(motion.at[first.stop - 1], at, way))
    if freedom(p.single, p.kinds).lacks:
        return reached  # between the poses there is nothing to reach

    def follow(q: np.ndarray, begin: float) -> float:
        """The share of the way that is followed from q (n,) [rad or m], which is at the share `begin`."""

        def step(s: float) -> np.ndarray | None:
            T = interpolate_poses(p.poses, np.array([np.interp(s, way, np.arange(len(way)))]), p.kinds)
            row = p.single.solve(T if p.robot.by_tip else T[:, 0], p.kinds, q[None], True)
            new = row[ANSWER : ANSWER + p.robot.n].copy()
            near = (np.abs(new - q) <= p.most * p.unit).all()
            free = search.collides is None or not search.collides(new)
            return new if row[AT.status] == CONVERGED and near and free else None

        done, part = begin, 1.0 / PARTS
        for _ in range(HALVINGS):
            while done < 1.0 and (new := step(min(done + part, 1.0))) is not None:
                q, done = new, min(done + part, 1.0)
            part *= 0.5
        return done

    found = [reached]
    if first is not None:
        found.append(follow(motion.curve[first.stop - 1], reached))
    if not search.fixed[0]:
        found += [follow(q * p.unit, 0.0) for q in search.tracks.at(0)[:STARTS]]
    return max(found)
