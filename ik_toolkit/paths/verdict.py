"""One sentence on how a path search ended, with advice."""

import numpy as np

from .result import PathResult, PathStatus


def sentence(path: PathResult, needed: int, allowed: float) -> str:
    """One sentence. needed: reconfigurations of the best path found through all poses; allowed: largest number allowed."""
    N = len(path.q)
    if path.status == PathStatus.INCOMPLETE:
        reached = np.flatnonzero(np.isfinite(path.q[:, 0]))
        last = int(reached[-1]) if len(reached) else -1
        most = f"{allowed:g} reconfiguration{'s' * (allowed != 1)}" if allowed else "no reconfiguration"
        ends = f"with {most} the path found ends at pose {last} of {N}"
        if path.unreachable:
            first, more = path.unreachable[0], len(path.unreachable) - 1
            others = f" and {more} more" if more else ""
            cut = f"; {ends}, and all of them take {needed}" if needed > allowed else ""
            return (
                f"{len(reached)} of {_poses(N)} reached; not pose {first.index}{others}: {first.reason}{cut}; move the poses, "
                "relax the targets (free_turn, slack, mask), or widen the limits"
            )
        return (
            f"{ends}: pose {last + 1} cannot be passed, and the whole path needs {needed}; allow them "
            "(reconfigurations='fewest'), or relax the targets (free_turn, slack, mask)"
        )
    turn, slide = path.length
    length = f"{turn:.3g} rad" + (f" and {slide:.3g} m" if slide else "")
    if path.status == PathStatus.COLLISION:
        touching = path.continuity.contacts[:1]
        where = f" ({' and '.join(touching[0].pair)} touch at pose {touching[0].place:.4g})" if touching else ""
        return f"{_poses(N)} followed, but only in collision{where}; move the poses or the obstacle"
    places = len(path.continuity.unproven)
    close = f"; at {places} place{'s' * (places != 1)} shapes are too close to rule out contact" if places else ""
    if path.status == PathStatus.FOLLOWED:
        return f"{_poses(N)} followed in one motion of {length}{close}"
    breaks = ", ".join(str(one.index) for one in path.reconfigurations[:5])
    few = "provably the fewest" if path.lower_bound == needed else "the fewest found"
    several = f"{needed} reconfiguration{'s' * (needed != 1)}"
    return f"{_poses(N)} followed with {several} ({few}), after pose {breaks}{close}"


def _poses(count: int) -> str:
    return f"{count} pose{'s' * (count != 1)}"
