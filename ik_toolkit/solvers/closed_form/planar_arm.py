"""The compiled planar two-link arm: finds its branches inside the limits."""

import math

import numpy as np

from ...compile.jit import cached, inline, inner
from .geometry import legal_turn
from .reach import planar_branches

# Slots of the parameters, after the transform base -> arm plane (12): the lengths and the height.
# From ANGLES on, each angle has sign and offset: theta = sign q + offset.
# NEARLY tells whether the axes are only nearly parallel.
L1, L2, HEIGHT, ANGLES, NEARLY = 12, 13, 14, 15, 19
FOLDED = 1e-9  # The links count as folded onto the base if the tip is nearer to it than this fraction of their lengths.


@inline
def to_plane(p, T):
    """Return the position of T (4, 4) in the arm's plane, x and y [m], and its distance [m] from the plane."""
    x = p[0] * T[0, 3] + p[1] * T[1, 3] + p[2] * T[2, 3] + p[9]
    y = p[3] * T[0, 3] + p[4] * T[1, 3] + p[5] * T[2, 3] + p[10]
    z = p[6] * T[0, 3] + p[7] * T[1, 3] + p[8] * T[2, 3] + p[11]
    return x, y, z - p[HEIGHT]


@inner
def joint_values(p, angles, box, q):
    """Fill q (2,) with the legal turns of theta_1, theta_2 nearest box[2]; return the worst limit broken and the distance."""
    worst, distance = 0.0, 0.0
    for i in range(2):
        x = p[ANGLES + 2 * i] * (angles[i] - p[ANGLES + 2 * i + 1])
        q[i], broken = legal_turn(x, box[0, i], box[1, i], box[2, i])
        worst = max(worst, broken)
        distance += box[3, i] * (q[i] - box[2, i]) ** 2
    return worst, distance


@cached
def list_planar(p, T, box, out, broken, marks):
    """Fill out (2, 2) with the branches of T (4, 4), broken (2,) with the limit each breaks, marks (2, 3) with their signs.

    Returns the number of branches, and whether the links fold back onto the base, which leaves the first angle free.
    """
    x, y, off = to_plane(p, T)
    size = p[L1] + p[L2]
    sols = np.empty((2, 2))
    count = planar_branches(x, y, p[L1], p[L2], p[ANGLES] * box[2, 0] + p[ANGLES + 1], sols)
    for k in range(count):
        broken[k] = joint_values(p, sols[k], box, out[k])[0]
        marks[k, 0] = marks[k, 2] = 0
        marks[k, 1] = 0 if count == 1 else (1 if sols[k, 1] > 0.0 else -1)
    return count, max(math.hypot(x, y), abs(p[L1] - p[L2])) <= FOLDED * size
