"""The share of a path's length that one continuous motion can follow from its start."""

import numpy as np

from ..kernel.checks import CODE
from ..kernel.counted_error import KIND
from ..kernel.records import AT, SIZE
from ..motion.reference import interpolate_poses
from ..robot.rotation import angles_between
from .finish import ProvenMotion
from .freedom import freedom
from .path_problem import STEP
from .path_search import Search
from .result import pieces

PARTS = 400  # The path is followed in steps of 1/400 of its length (0.25 %).
HALVINGS = 5  # number of step lengths tried, each half the previous one: the end is found to 1/16 of a step
STARTS = 16  # largest number of configurations at the first pose from which the path is followed


def lengths(poses: np.ndarray, kinds: tuple) -> np.ndarray:
    """Return the share (N,) of the path's length up to each of the poses (N, F, 4, 4), from 0 to 1.

    The length is the sum of the tips' travel, without tips whose kind in `kinds` is KIND.free. If no position changes, it is
    the sum of the rotation angles of all tips.
    """
    moves = np.linalg.norm(np.diff(poses[..., :3, 3], axis=0), axis=2)
    moves[:, [kind == KIND.free for kind in kinds]] = 0.0
    if not moves.any():
        pairs = poses[:-1, :, :3, :3].reshape(-1, 3, 3), poses[1:, :, :3, :3].reshape(-1, 3, 3)
        moves = angles_between(*pairs).reshape(moves.shape)
    way = np.append(0.0, np.cumsum(moves.sum(axis=1)))
    return way / way[-1] if way[-1] > 0.0 else np.linspace(0.0, 1.0, len(way))


def fraction(search: Search, motion: ProvenMotion) -> float:
    """Return the share (0 to 1, to better than 0.1 %) of the path's length that one motion follows from the start.

    A motion ends at its first jump, contact or pose out of reach. From there the given motion is continued step by step.
    If no start q0 is fixed, motions from other configurations at the first pose are tried as well. The result is a lower
    bound: another posture of a redundant arm may go further.
    """
    p = search.problem
    way, at = lengths(p.poses, p.kinds), p.at
    touched = min((one.place for one in motion.continuity.contacts), default=np.inf)
    runs = pieces(motion.curve, motion.at, motion.found.breaks)
    rows = int((motion.at[runs[0]] < touched).sum()) if runs and runs[0].start == 0 else 0
    if rows == len(motion.curve):
        return 1.0
    reached = float(np.interp(motion.at[rows - 1], at, way)) if rows else 0.0
    # The search does not bound the steps of an arm with too few joints, so the default largest step is used for it here.
    most = (
        np.minimum(p.most, np.where(p.robot.slides, STEP[1], STEP[0]) / p.unit)
        if freedom(p.single, p.kinds).lacks
        else p.most
    )

    def follow(q: np.ndarray, begin: float) -> float:
        """Return the share of the path's length reached from q (n,) [rad or m], a solution at the share `begin`."""

        def step(s: float) -> np.ndarray | None:
            T = interpolate_poses(p.poses, np.array([np.interp(s, way, np.arange(len(way)))]), p.kinds)
            row = p.follower.solve(T.reshape(-1, *p.robot.pose_shape), p.kinds, q[None], True)
            new = row[SIZE.answer : SIZE.answer + p.robot.n].copy()
            near = (np.abs(new - q) <= most * p.unit).all()
            free = search.collides is None or not search.collides(new)
            return new if row[AT.status] == CODE.converged and near and free else None

        done, part = begin, 1.0 / PARTS
        for _ in range(HALVINGS):
            while done < 1.0 and (new := step(min(done + part, 1.0))) is not None:
                q, done = new, min(done + part, 1.0)
            part *= 0.5
        return done

    found = [reached]
    if rows:
        found.append(follow(motion.curve[rows - 1], reached))
    if not search.fixed[0]:
        found += [follow(q * p.unit, 0.0) for q in search.tracks.at(0)[:STARTS]]
    return max(found)
