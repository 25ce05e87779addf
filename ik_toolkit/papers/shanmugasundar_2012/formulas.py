"""Numbers and formulas of Shanmugasundar and Sivaramakrishnan (2012), in millimetres and degrees as published."""

import math
from typing import Any

import numpy as np

# The input pose as printed in Table 2 and Fig 8: columns n, o, a, and p in mm.
PRINTED_POSE = {
    "n_x": "0.78", "n_y": "-0.06", "n_z": "0.62", "o_x": "-0.63", "o_y": "-0.10", "o_z": "0.77",
    "a_x": "0.02", "a_y": "-0.99", "a_z": "-0.12", "p_x": "461.54", "p_y": "87.12", "p_z": "935.16",
}  # fmt: skip
D1, D2, A4, A6, A7 = 530.0, 220.0, 290.0, 180.0, 45.0  # The D-H lengths d_i and a_i [mm] of Table 2.
# Table 2: the D-H parameters alpha [deg], a [mm] and d [mm] of each joint.
TABLE_2 = ((0, 0, 530), (90, 0, 220), (90, 0, 0), (0, 290, 0), (-90, 0, 0), (0, 180, 0), (0, 45, 0))
# Joint values [deg; mm for joint 2] at which the pose of Table 2 was probably computed, because the paper prints none.
ORIGIN = (20.0, 220.0, 20.0, 0.0, 20.0, 0.0, 20.0)
ANGLES = ("theta_1", "theta_3", "theta_4", "theta_5", "theta_6", "theta_7")
MANUAL = (21.37, 18.906, 1.048, 20.673, 2.465, 20.755)  # Joint angles [deg] that the paper found by hand (Table 3).
SOFTWARE = (21.4, 18.9, 1.1, 20.6, 2.5, 20.6)  # Joint angles [deg] of the paper's program (Table 4 and Fig 8).
# Intermediate results of the calculation by hand in section 4.2 of the paper: angles [deg], and sines.
THETA_45, S3, THETA_67, S6, S4 = 21.721, 0.324, 23.22, 0.043, 0.018
PI_22_7 = 22.0 / 7.0


def pose_matrix(printed: dict[str, str]) -> np.ndarray:
    """Return the printed pose as a matrix (4, 4), with lengths in mm."""
    T = np.eye(4)
    for c, column in enumerate("noap"):
        T[:3, c] = [float(printed[f"{column}_{axis}"]) for axis in "xyz"]
    return T


def printed_fk(q: np.ndarray, lift: float) -> np.ndarray:
    """Return the paper's matrix (4, 4) of section 3.1 at theta_1, theta_3 to theta_7 [rad] and a lift (prismatic joint) [mm].

    n_y, o_y and p_y are printed only in part, n_z and o_z only inside the equations; they follow the printed pattern.
    """
    c1, c3, c4, c6 = (math.cos(q[i]) for i in (0, 1, 2, 4))
    s1, s3, s4, s6 = (math.sin(q[i]) for i in (0, 1, 2, 4))
    c45, s45 = math.cos(q[2] + q[3]), math.sin(q[2] + q[3])
    c67, s67 = math.cos(q[4] + q[5]), math.sin(q[4] + q[5])
    along, up = c67 * A7 + c6 * A6, s67 * A7 + s6 * A6
    x = (c1 * c3 * c45 + s1 * s45) * along - c1 * s3 * up + (c1 * c3 * c4 + s1 * s4) * A4
    y = (s1 * c3 * c45 - c1 * s45) * along - s1 * s3 * up + (s1 * c3 * c4 - c1 * s4) * A4
    z = s3 * c45 * along + s3 * c4 * A4 + c3 * up + lift + D1
    return np.array(
        [
            [c1 * (c3 * c45 * c67 - s3 * s67) + s1 * s45 * c67, c1 * (-c3 * c45 * s67 - s3 * c67) - s1 * s45 * s67,
             -c1 * c3 * s45 + s1 * c45, x],
            [s1 * (c3 * c45 * c67 - s3 * s67) - c1 * s45 * c67, s1 * (-c3 * c45 * s67 - s3 * c67) + c1 * s45 * s67,
             -s1 * c3 * s45 - c1 * c45, y],
            [s3 * c45 * c67 + c3 * s67, -s3 * c45 * s67 + c3 * c67, -s3 * s45, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )  # fmt: skip


def fig4(
    T: np.ndarray,
    lift: float,
    theta_1: float | None = None,
    height: float | None = None,
    signs: tuple[int, int, int, int, int] = (1, 1, 1, 1, 1),
    complement: bool = False,
) -> np.ndarray:
    """Return joint angles (6,) [rad] by Fig 4 and eqs. (9), (13), (14) for T (4, 4) [mm], NaN where a root is imaginary.

    S4 and C4 stand for the misprinted S2 and C2. theta_67 is used but never given; its arc cosine from n reproduces the printed
    23.22 deg.

    Args:
        T: Pose of the tip (4, 4) [mm].
        lift: Value of the prismatic joint d2 [mm].
        theta_1: First angle [rad]. Default: the printed 2 atan2(py, px).
        height: Value used for d1 + d2 [mm]. Default: the sum itself.
        signs: Signs of theta_45, theta_3, theta_6, theta_4, theta_67.
        complement: A negative sign of an arc sine gives pi - theta, which has the same sine, instead of the printed -theta.
    """
    n, a, p = T[:3, 0], T[:3, 2], T[:3, 3]
    t1 = 2.0 * math.atan2(p[1], p[0]) if theta_1 is None else theta_1
    s1, c1 = math.sin(t1), math.cos(t1)
    top = D1 + lift if height is None else height

    def arc(function: Any, x: float, sign: int) -> float:
        if not abs(x) <= 1.0 + 1e-12:
            return math.nan
        t = function(max(-1.0, min(1.0, x)))
        return math.pi - t if complement and sign < 0 and function is math.asin else sign * t

    t45 = arc(math.acos, s1 * a[0] - c1 * a[1], signs[0])
    s45 = math.sin(t45) or math.nan
    t3 = arc(math.asin, -a[2] / s45, signs[1])
    s3, c3 = math.sin(t3), math.cos(t3)
    t67 = arc(math.acos, (s1 * n[0] - c1 * n[1]) / s45, signs[4])
    s67, c67 = math.sin(t67), math.cos(t67)
    t6 = arc(math.asin, (-s3 * c1 * p[0] - s3 * s1 * p[1] + c3 * p[2] - c3 * top - s67 * A7) / A6, signs[2])
    t4 = arc(math.asin, (s1 * p[0] - c1 * p[1] - s45 * c67 * A7 - s45 * math.cos(t6) * A6) / A4, signs[3])
    return np.array([t1, t3, t4, t45 - t4, t6, t67 - t6])


def pose_error(T: np.ndarray, goal: np.ndarray) -> tuple[float, float]:
    """Return the distance [in the unit of the poses] and the rotation angle [rad] between two poses (4, 4)."""
    R = T[:3, :3].T @ goal[:3, :3]
    sine = 0.5 * math.hypot(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    return float(np.linalg.norm(T[:3, 3] - goal[:3, 3])), math.atan2(sine, 0.5 * (float(np.trace(R)) - 1.0))
