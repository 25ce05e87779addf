"""Targets given relative to another tip: where such a target is, and how it moves with the other tip."""

from ..compile.jit import inner
from .algebra import at3, pose_from, product, put3, put_axes, rotation_at, transposed
from .counted_error import add_pairs, plus_cross
from .kinematics import column
from .problem import add_column, counted_goal
from .records import WHAT

# A target fixed to another tip is described by an array (LINK,); TURN, POINT and FRAME are the indices of its parts.
TURN = 0  # rotation (9) from the other tip's axes to the target's
POINT = 9  # the target's point (3) in the other tip's axes
FRAME = 12  # pose (12) of the other tip's first joint, in the frame of the first joint of the tip that has the target
LINK = 24  # length of the array that describes a target fixed to another tip: 9 + 3 + 12


@inner
def link_to(T, ends, other, link):
    """Write to link (LINK,) the description of a target T (4, 4) [m] that is given in another tip's frame.

    `ends` is the `Ends` of the tip that has this target, `other` the `Ends` of the tip in whose frame it is given.
    """
    tool = rotation_at(other.flat, 12)
    target = pose_from(T)
    put_axes(link, TURN, product(tool, product(target.axes, transposed(rotation_at(ends.flat, 12)))))
    put3(link, POINT, tool.times(target.point * (1.0 / ends.scale())))
    base = transposed(rotation_at(ends.flat, 0))
    put_axes(link, FRAME, product(base, rotation_at(other.flat, 0)))
    put3(link, FRAME + 9, base.times(at3(other.flat, 9) - at3(ends.flat, 9)))


@inner
def carry(pose, link, goal):
    """Write to goal (GOAL,) where a target that is fixed to another tip is now, from its description `link` (see `link_to`).

    pose (12,): axes of the last joint in the other tip's chain (9), then the position of that tip (3).
    """
    frame, axes = rotation_at(link, FRAME), rotation_at(pose, 0)
    put_axes(goal, 0, product(frame, product(axes, rotation_at(link, TURN))))
    put3(goal, 9, frame.times(at3(pose, 9) + axes.times(at3(link, POINT))) + at3(link, FRAME + 9))
    put3(goal, 12, at3(goal, 9))


@inner
def fill_goal(rows, task, kept, joints, pose, link, J, first):
    """Complete the transposed Jacobian J (n, m) of a tip whose target moves with another tip: subtract the target's motion.

    Args:
        rows: (L, 10) geometry of the other tip's chain.
        task: Numbers of the `Task` of the tip that has the target.
        kept: (IN.size,) as `counted_error.shape` has filled it for this tip.
        joints: Axes and points of the joints of the other chain.
        pose: (12,) pose of the other tip, see `carry`.
        link: (LINK,) where the target is on the other tip.
        J: (n, m) transposed Jacobian.
        first: First of the six columns of the tip that has the target.
    """
    point = at3(pose, 9) + rotation_at(pose, 0).times(at3(link, POINT))
    frame, kind = rotation_at(link, FRAME), int(task[WHAT.kind])
    for i in range(rows.shape[0]):
        u, v = column(rows, joints, i, point)
        u, v = frame.times(u), frame.times(v)
        u, v = counted_goal(kind, kept, u, v)
        add_column(J, int(rows[i, 8]), first, -(rows[i, 4] + rows[i, 6]), u, v)


@inner
def add_goal_curvature(own_rows, own_joints, rows, joints, pose, link, bend, H):
    """Add to the Hessian H (n, n) the second derivatives of a tip's errors that come from the motion of its target.

    The target moves with another tip; `counted_error.add_curvature` has the part of the tip's own joints. A pair of joints of the
    other chain acts as a pair of the tip's own does when tip and target change places. A pair of one joint from each chain acts on
    the rotation alone, as if the other chain, taken backwards, came before the tip's own.

    Args:
        own_rows: (L, 10) geometry of the chain of the tip that has the target.
        own_joints: Axes and points of the joints of this chain.
        rows: Geometry of the other chain.
        joints: Axes and points of the joints of the other chain.
        pose: (12,) pose of the other tip, see `carry`.
        link: (LINK,) where the target is on the other tip.
        bend: What `add_curvature` returned for the tip.
        H: (n, n) matrix to add to.
    """
    point = at3(pose, 9) + rotation_at(pose, 0).times(at3(link, POINT))
    frame = rotation_at(link, FRAME)
    back, turn = transposed(frame), plus_cross(bend.least, bend.turn)
    add_pairs(rows, joints, point, -back.times(bend.linear), product(back, product(transposed(turn), frame)), H)
    for r in range(rows.shape[0]):
        _, v = column(rows, joints, r, point)
        v = -turn.times(frame.times(v)) * (rows[r, 4] + rows[r, 6])
        i = int(rows[r, 8])
        for t in range(own_rows.shape[0]):
            _, y = column(own_rows, own_joints, t, point)
            j, h = int(own_rows[t, 8]), v.dot(y) * (own_rows[t, 4] + own_rows[t, 6])
            H[i, j] += h
            H[j, i] += h
