"""Mathematics of two structures in closed form: all branches, reach, and the nearest reachable point.

Lengths are in metres, angles in radians. Sources: for the planar 2R Chinyai, eqs. (1)-(5), with the signs corrected and atan2
throughout; for the inspection arm Shanmugasundar and Sivaramakrishnan (2012), eqs. (7)-(13), completed. Their theta_1 = 2 atan2(py,
px) has no basis, and the lift (prismatic joint) is the arm's one free parameter.
"""

import math

import numpy as np

from ...compile.jit import cached, dual, inline, inner, shared
from ...kernel.kinematics import TAU
from .geometry import legal_turn

# The two solutions of the elbow count as one if the sine of the elbow angle is below 1e-7. The tip's error is then 1e-15 of the
# arm's length.
MERGED = 1e-7
ON_AXIS = (
    # A joint angle is free (does not matter) if the point that the joint turns is nearer to its axis than ON_AXIS times the link
    # lengths.
    1e-12
)
# a point farther out than the reach by less than EDGE times the link lengths still counts as in reach (rounding)
EDGE = 1e-13
# Indices in the array p of a planar arm's parameters, after the transform from the base to the arm's plane (12): both link lengths
# and the height of the plane [m]. From ANGLES on, each joint has a sign and an offset: theta = sign q + offset. NEARLY tells
# whether the axes are only nearly parallel.
L1, L2, HEIGHT, ANGLES, NEARLY = 12, 13, 14, 15, 19
FOLDED = 1e-9  # The links count as folded onto the base if the tip is nearer to it than this fraction of their lengths.


@shared
def wrap(x):
    """Return the angle x [rad] modulo 2 pi, in the range -pi..pi."""
    return x - TAU * math.floor(x / TAU + 0.5)


@shared
def elbow(r, l1, l2):
    """Return the elbow angle, 0 to pi, at which two links of lengths l1 and l2 span the distance r.

    It is accurate also where the arm is nearly stretched or folded.
    """
    a = max((l1 + l2 - r) * (l1 + l2 + r), 0.0)  # a = 2 l1 l2 (1 - cos elbow), as a product, which loses no digits
    # b = 2 l1 l2 (1 + cos elbow), as a product, which loses no digits
    b = max((r - abs(l1 - l2)) * (r + abs(l1 - l2)), 0.0)
    return 2.0 * math.atan2(math.sqrt(a), math.sqrt(b))


@shared
def planar_margin(x, y, l1, l2):
    """Return how far [m] the point x, y is inside (positive) or outside (negative) the ring that two links l1, l2 [m] reach."""
    r = math.hypot(x, y)
    return min(l1 + l2 - r, r - abs(l1 - l2))


@shared
def planar_branches(x, y, l1, l2, near, sols):
    """Fill sols (2, 2) with the angles theta_1, theta_2 that bring two links to (x, y); return the number of solutions, 1 or 2.

    A point out of reach is replaced by the nearest one in reach. l1, l2: link lengths [m]. theta_2 > 0 comes first. Where the
    links fold back onto the base, theta_1 is free and taken from `near`.
    """
    r = math.hypot(x, y)
    size = l1 + l2
    t2 = elbow(r, l1, l2)
    if abs(math.sin(t2)) < MERGED:
        sols[0, 1] = 0.0 if t2 < 1.0 else math.pi
        if r <= ON_AXIS * size and abs(l1 - l2) <= ON_AXIS * size:
            sols[0, 0] = near
        else:
            sols[0, 0] = wrap(math.atan2(y, x) - (0.0 if t2 < 1.0 or l1 >= l2 else math.pi))
        return 1
    inner = math.atan2(l2 * math.sin(t2), l1 + l2 * math.cos(t2))
    heading = math.atan2(y, x)
    sols[0, 0] = wrap(heading - inner)
    sols[0, 1] = t2
    sols[1, 0] = wrap(heading + inner)
    sols[1, 1] = -t2
    return 2


@inline
def to_plane(p, T):
    """Return x and y [m] of the position of T (4, 4) in the arm's plane, and its distance [m] from the plane.

    p: the parameters of a planar arm (see ANGLES in this file).
    """
    x = p[0] * T[0, 3] + p[1] * T[1, 3] + p[2] * T[2, 3] + p[9]
    y = p[3] * T[0, 3] + p[4] * T[1, 3] + p[5] * T[2, 3] + p[10]
    z = p[6] * T[0, 3] + p[7] * T[1, 3] + p[8] * T[2, 3] + p[11]
    return x, y, z - p[HEIGHT]


@inner
def joint_values(p, angles, box, q):
    """Fill q (2,) with the joint values [rad] for theta_1 and theta_2 (`angles`), each shifted by 2 pi k into its limits.

    Of several shifts, the one nearest the reference is taken. p: the parameters of a planar arm; box (4, 2): lower limits, upper
    limits, reference, weights. Returns the largest excess over a limit [rad] and the weighted squared distance from the reference.
    """
    worst, distance = 0.0, 0.0
    for i in range(2):
        x = p[ANGLES + 2 * i] * (angles[i] - p[ANGLES + 2 * i + 1])
        q[i], broken = legal_turn(x, box[0, i], box[1, i], box[2, i])
        worst = max(worst, broken)
        distance += box[3, i] * (q[i] - box[2, i]) ** 2
    return worst, distance


@cached
def list_planar(p, T, box, out, broken, marks):
    """Fill out (2, 2) with the joint values [rad] of the branches for the position of T (4, 4); return the number of branches.

    Also returns whether the links fold back onto the base, which leaves the first angle free. broken (2,) receives the excess over
    limits [rad], marks (2, 3) the signs of the elbow. p: the parameters of a planar arm; box (4, 2): limits, reference, weights.
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


@shared
def shoulder_in_tool(P, d):
    """Return x, y, z [m] of the shoulder, at height d [m] on axis 1, in the axes of the wrist.

    P (12,): the wrist pose seen from the shoulder at d = 0, rotation by rows, then point.
    """
    h = d - P[11]
    x = P[6] * h - P[0] * P[9] - P[3] * P[10]
    y = P[7] * h - P[1] * P[9] - P[4] * P[10]
    z = P[8] * h - P[2] * P[9] - P[5] * P[10]
    return x, y, z


@shared
def inspection_margin(P, d, a4, a6):
    """Return how far [m] a wrist pose P is inside (positive) or outside (negative) the reach at lift d, with its orientation kept.

    P, d: as for `shoulder_in_tool`; a4, a6: link lengths [m].
    """
    x, y, z = shoulder_in_tool(P, d)
    r = math.hypot(x, y)
    return min(a4 - math.hypot(r - a6, z), math.hypot(r + a6, z) - a4)


@shared
def inspection_nearest(P, d, a4, a6):
    """Move the point of a wrist pose P to the nearest one in reach, the orientation kept; return how far [m] it was moved.

    In the wrist's axes the shoulder can be anywhere in a torus about the z axis (circle of radius a6, tube of radius a4), except
    where the tube overlaps itself around the axis. The shoulder is projected onto the tube's surface. P, d: as for
    `shoulder_in_tool`.
    """
    x, y, z = shoulder_in_tool(P, d)
    r = math.hypot(x, y)
    far = math.hypot(r - a6, z)
    near = math.hypot(r + a6, z)
    if far > a4:
        gap, centre, h = far - a4, a6, far
    elif near < a4:
        gap, centre, h = a4 - near, -a6, near
    else:
        return 0.0
    u, v = centre + a4 * (r - centre) / h, a4 * z / h
    if r > 0.0:
        dx, dy = x * (u / r - 1.0), y * (u / r - 1.0)
    else:
        dx, dy = u, 0.0
    dz = v - z
    for i in range(3):  # the tool moves by minus the shoulder's (dx, dy, dz) in tool axes
        P[9 + i] -= P[3 * i] * dx + P[3 * i + 1] * dy + P[3 * i + 2] * dz
    return gap


@shared
def forearm(P, d, a4, a6, near):
    """Return the geometry of elbow and wrist that all eight solutions (branches) of a wrist pose P have in common.

    That is: whether the shoulder is on axis 6, whether the elbow is straight, theta_6 of the first elbow branch, the angles
    `inner` and `heading` (from which `wrist` computes theta_7), and the sine and cosine of theta_5. P must be in reach from d (see
    `inspection_nearest`); a theta_6 or theta_7 that is free is taken from `near` (6,). a4, a6: link lengths [m].
    """
    x, y, z = shoulder_in_tool(P, d)
    r = math.hypot(x, y)
    size = a4 + a6
    # a4 cos(theta_5) is clamped to what the elbow spans, or poses near cos(theta_5) = 0 would lose half their digits.
    reach = math.sqrt(max((a4 - z) * (a4 + z), 0.0))
    on_six = abs(r - a6) <= ON_AXIS * size and reach <= 1e-6 * a4
    reach = 0.0 if on_six else min(max(reach, abs(r - a6)), r + a6)
    bend = near[4] if on_six else elbow(r, a6, reach)
    straight = not on_six and abs(math.sin(bend)) < MERGED
    if straight:
        bend = 0.0 if bend < 1.0 else math.pi
    heading = -near[5] if r <= ON_AXIS * size else math.atan2(-y, -x)
    inner = 0.0
    if not on_six and r > ON_AXIS * size:
        inner = math.atan2(0.0 if straight else -reach * math.sin(bend), a6 + reach * math.cos(bend))
    n5 = 1.0 / math.hypot(z, reach)
    return on_six, straight, bend, inner, heading, z * n5, reach * n5


@shared
def wrist(on_six, bend, inner, heading, s5, c5, k6, k5):
    """Return cos(theta_5), theta_5, theta_6, theta_7 for one of two solutions of the elbow (k6, 0 or 1) and of the wrist (k5).

    The other arguments are what `forearm` returns for the wrist pose.
    """
    e6 = 1.0 - 2.0 * k6
    t6, t7 = bend if on_six else e6 * bend, e6 * inner - heading
    yaw = math.atan2(s5, c5)
    if k5 == 1:  # The other solution of the wrist turns theta_5 into pi - theta_5 and theta_6 into theta_6 + pi.
        return -c5, math.pi - yaw, (t6 - math.pi if t6 > 0.0 else t6 + math.pi), t7
    return c5, yaw, t6, t7


@shared
def shoulder(P, c5, s5, phi, given, t1):
    """Return the sine of the angle between axes 1 and 4, and theta_1, theta_3, theta_4 of the first solution of the shoulder.

    P: as for `shoulder_in_tool`; c5, s5: cosine and sine of theta_5; phi = theta_6 + theta_7. theta_1 is t1 if `given`, or if
    that sine is 0 and theta_1 therefore free. The second solution is theta_1 + pi, -theta_3, theta_4 + pi.
    """
    cp, sp = math.cos(phi), math.sin(phi)
    m02 = -(P[0] * sp + P[1] * cp)
    m12 = -(P[3] * sp + P[4] * cp)
    m22 = -(P[6] * sp + P[7] * cp)
    u0 = P[0] * cp - P[1] * sp
    u1 = P[3] * cp - P[4] * sp
    m00, m01 = c5 * u0 - s5 * P[2], s5 * u0 + c5 * P[2]
    m10, m11 = c5 * u1 - s5 * P[5], s5 * u1 + c5 * P[5]
    tilt = math.hypot(m02, m12)
    if tilt <= ON_AXIS or given:
        c1, s1 = math.cos(t1), math.sin(t1)
    else:
        c1, s1, t1 = m02 / tilt, m12 / tilt, math.atan2(m12, m02)
    t3 = math.atan2(c1 * m02 + s1 * m12, -m22)
    return tilt, t1, t3, math.atan2(s1 * m00 - c1 * m10, s1 * m01 - c1 * m11)


@shared
def fill_shoulder_branch(row, k3, t1, t3, t4, t5, t6, t7):
    """Fill row (6,) with theta_1, theta_3 to theta_7 of shoulder solution k3 (0 or 1), given those of solution 0, in -pi..pi."""
    row[0] = wrap(t1 + k3 * math.pi)
    row[1] = t3 * (1.0 - 2.0 * k3)
    row[2] = wrap(t4 + k3 * math.pi)
    row[3] = wrap(t5)
    row[4] = wrap(t6)
    row[5] = wrap(t7)


@shared
def inspection_branches(P, d, a4, a6, near, sols):
    """Fill sols (8, 6) with theta_1, theta_3 to theta_7 of all solutions (branches) of a wrist pose P; return their number.

    There are eight if none merge: two each of wrist, elbow and shoulder. P must be in reach from d (see `inspection_nearest`). A
    free angle is taken from `near` (6,): theta_1 if axes 1 and 4 align, theta_6 if the shoulder lies on axis 6, theta_7 if on axis
    7.
    """
    on_six, straight, bend, inner, heading, s5, c5 = forearm(P, d, a4, a6, near)
    count = 0
    for k6 in range(1 if on_six or straight else 2):
        for k5 in range(1 if on_six else 2):
            c, t5, t6, t7 = wrist(on_six, bend, inner, heading, s5, c5, k6, k5)
            tilt, t1, t3, t4 = shoulder(P, c, s5, t6 + t7, False, near[0])
            for k3 in range(1 if tilt <= ON_AXIS else 2):
                fill_shoulder_branch(sols[count], k3, t1, t3, t4, t5, t6, t7)
                count += 1
    return count


@shared
def inspection_branch(P, d, a4, a6, near, k, row):
    """Fill row (6,) with theta_1, theta_3 to theta_7 of solution (branch) k, 0 to 7, of a wrist pose at lift d [m].

    For one k the angles vary smoothly with d. Bits 0, 1 and 2 of k choose shoulder, wrist and elbow. Other arguments as for
    `inspection_branches`.
    """
    on_six, straight, bend, inner, heading, s5, c5 = forearm(P, d, a4, a6, near)
    c, t5, t6, t7 = wrist(on_six, bend, inner, heading, s5, c5, k // 4, k // 2 % 2)
    tilt, t1, t3, t4 = shoulder(P, c, s5, t6 + t7, False, near[0])
    fill_shoulder_branch(row, k % 2, t1, t3, t4, t5, t6, t7)


@shared
def level_arm(P, d, free, a4, a6, k, near, row):
    """Fill row (6,) with the angles of a configuration whose axes 1 and 4 are parallel, at theta_1 = near[0].

    Only a wrist pose P whose z axis is perpendicular to axis 1 has such configurations. If `free`, the lift (value of the
    prismatic joint) follows from theta_6, otherwise it is d. Bits 0, 1 and 2 of k (0 to 7) choose the sign of cos(theta_3), the
    elbow and the wrist. Returns the lift, and how far [m] the arm then is from P. a4, a6: link lengths [m].
    """
    up = 1.0 - 2.0 * (k % 2)  # sign of cos(theta_3)
    phi = math.atan2(up * P[6], up * P[7])
    cp, sp = math.cos(phi), math.sin(phi)
    x, y, z = shoulder_in_tool(P, P[11] if free else d)
    reach = math.sqrt(max((a4 - z) * (a4 + z), 0.0)) * (1.0 - 2.0 * (k // 4))
    c6 = -(x * cp - y * sp + reach) / a6
    s6 = -(x * sp + y * cp) / a6
    if free:
        wanted = math.sqrt(max(1.0 - c6 * c6, 0.0)) * (1.0 - 2.0 * (k // 2 % 2))
        d = P[11] + (s6 - wanted) * a6 * up
        s6 = wanted
    miss = abs(math.hypot(s6, c6) - 1.0) * a6 + abs(P[8]) * (a4 + a6) + max(abs(z) - a4, 0.0)
    n5 = 1.0 / math.hypot(z, reach)
    t6 = math.atan2(s6, c6)
    tilt, t1, t3, t4 = shoulder(P, reach * n5, z * n5, phi, True, near[0])
    fill_shoulder_branch(row, 0, t1, t3, t4, math.atan2(z, reach), t6, phi - t6)
    return d, miss


@cached
def many_branches(P, lifts, a4, a6, near, sols):
    """Return the total number of solutions of wrist poses P (N, 12) at lifts (N,) [m]; only benchmarks use it, for timing."""
    count = 0
    for k in range(P.shape[0]):
        count += inspection_branches(P[k], lifts[k], a4, a6, near, sols)
    return count


@shared
def depressed_roots(p, q):
    """Return the number (1 or 3) of real roots of u^3 + p u + q and the roots, ascending; a single one is returned three times."""
    if p < 0.0 and 4.0 * p * p * p + 27.0 * q * q < 0.0:
        m = 2.0 * math.sqrt(-p / 3.0)
        a = math.acos(min(max(3.0 * q / (p * m), -1.0), 1.0)) / 3.0
        return 3, m * math.cos(a - 2.0 * TAU / 3.0), m * math.cos(a - TAU / 3.0), m * math.cos(a)
    h = math.sqrt(max(q * q / 4.0 + p * p * p / 27.0, 0.0))
    w = math.copysign((0.5 * abs(q) + h) ** (1.0 / 3.0), -q)
    root = w - p / (3.0 * w) if w != 0.0 else 0.0
    return 1, root, root, root


@shared
def reach_edge(P, a4, a6, outside, inside):
    """Return the lift [m] at which a wrist pose P just comes into reach, between the lifts `outside` and `inside`, by bisection.

    P is out of reach from the first and in reach from the second; a4, a6: link lengths [m].
    """
    for _ in range(60):
        middle = 0.5 * (outside + inside)
        if inspection_margin(P, middle, a4, a6) >= 0.0:
            inside = middle
        else:
            outside = middle
    return inside


@shared
def keep_interval(out, count, a, b, low, high):
    """Write the part of [a, b] within [low, high] to row `count` of `out`, unless it is empty; return the new number of rows."""
    a, b = max(a, low), min(b, high)
    if a <= b:
        out[count, 0] = a
        out[count, 1] = b
        count += 1
    return count


@dual
def lift_intervals(P, a4, a6, low, high, out):
    """Fill out (2, 2) with the intervals of the lift [m], between low and high, that reach a wrist pose P; return their number.

    P is in reach where a monic quartic in u = lift - P_z is not positive. Its turning points, the roots of a cubic, divide the
    lifts into ranges. Each range has at most one end of an interval, which bisection on the reach margin finds to rounding. a4,
    a6: link lengths [m].
    """
    wx, wy, wz, az = P[9], P[10], P[11], P[8]
    p = wx * wx + wy * wy - a4 * a4 - a6 * a6 + 2.0 * a6 * a6 * az * az
    q = -2.0 * a6 * a6 * az * (P[2] * wx + P[5] * wy)
    n, first, between, last = depressed_roots(p, q)
    first, between, last = first + wz, between + wz, last + wz
    far = 1.001 * (a4 + a6)
    slack = -EDGE * (a4 + a6)
    has_first = inspection_margin(P, first, a4, a6) >= slack
    if n == 1 or inspection_margin(P, between, a4, a6) >= 0.0:
        if not has_first:
            return 0
        a = reach_edge(P, a4, a6, wz - far, first)
        return keep_interval(out, 0, a, reach_edge(P, a4, a6, wz + far, last), low, high)
    count = 0
    if has_first:
        a = reach_edge(P, a4, a6, wz - far, first)
        count = keep_interval(out, count, a, reach_edge(P, a4, a6, between, first), low, high)
    if inspection_margin(P, last, a4, a6) >= slack:
        a = reach_edge(P, a4, a6, between, last)
        count = keep_interval(out, count, a, reach_edge(P, a4, a6, wz + far, last), low, high)
    return count
