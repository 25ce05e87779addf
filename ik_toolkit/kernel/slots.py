"""Where things stand in the flat arrays that go into the compiled loops and come out of them."""

from .jit import inline

# `opt`; the joint weights (n) and then the rule's parameters follow at OPT_HEAD.
O_TOL_P, O_TOL_R, O_GIVEN, O_ITERATIONS, O_DESCENTS = 0, 1, 2, 3, 4
O_C, O_RHO, O_C_FREE, O_RHO_FREE, O_KIND, O_W = 5, 6, 7, 8, 9, 10  # O_W: six weights, or the tip axis for AXIS
O_EVALUATIONS, O_LIMITS, O_SEED, O_CLOSEST, O_STALL, O_HOLD = 16, 17, 18, 19, 20, 21
O_FOLLOW, O_FOLLOW_SLIDE = 22, 23  # largest move of a revolute joint [rad] and of a slide [m] from the start; 0: any
OPT_HEAD = 24
# A row of `out`; q (n) follows at OUT_HEAD.
# R_EXCESS: metres beyond reach, or for TOO_FAR the joint that is held; R_ATTEMPT: the attempt that found q, 0 the first.
R_STATUS, R_ITERATIONS, R_RESTARTS, R_POSITION, R_ROTATION, R_EVALUATIONS, R_HISTORY, R_EXCESS, R_ATTEMPT = range(9)
OUT_HEAD = 9
# `ends`: base (12), tip (12), then seven vectors of n (lower, upper, turns, unit, low, span, home), then the tail.
E_VECTORS = 24
TAIL = 7  # scale, reach of tip, hole of tip, reach of last joint, hole of last joint, lift low, lift high


@inline
def vectors(ends, n):
    """Views of the vectors of `ends` (lower, upper, turns, unit, low, span, home), then its tail."""
    v = E_VECTORS
    return (
        ends[v : v + n],
        ends[v + n : v + 2 * n],
        ends[v + 2 * n : v + 3 * n],
        ends[v + 3 * n : v + 4 * n],
        ends[v + 4 * n : v + 5 * n],
        ends[v + 5 * n : v + 6 * n],
        ends[v + 6 * n : v + 7 * n],
        ends[v + 7 * n :],
    )
