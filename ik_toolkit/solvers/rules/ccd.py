"""Cyclic coordinate descent: one joint after the other, tip first, each moved to where the error is least."""

import math
from typing import Any, NamedTuple

import numpy as np

from ...kernel.jit import jit
from ...kernel.kinematics import angle_ratio
from ...kernel.loop import measure, rule
from ...kernel.slots import E_VECTORS, O_KIND, O_LIMITS, O_TOL_P, O_TOL_R
from ...kernel.task import MASK_BASE, MASK_TIP, POSITION


@jit
def coordinate_column(rows, Z, k, px, py, pz, column):
    """Fill `column` (6,) with the Jacobian of coordinate k at the tip point; mimic joints add to their leader."""
    for r in range(6):
        column[r] = 0.0
    for i in range(rows.shape[0]):
        if int(rows[i, 8]) != k:
            continue
        ratio = rows[i, 4] + rows[i, 6]
        zx, zy, zz = ratio * Z[i, 0], ratio * Z[i, 1], ratio * Z[i, 2]
        if rows[i, 9] > 0.0:
            rx, ry, rz = px - Z[i, 3], py - Z[i, 4], pz - Z[i, 5]
            column[0] += zy * rz - zz * ry
            column[1] += zz * rx - zx * rz
            column[2] += zx * ry - zy * rx
            column[3] += zx
            column[4] += zy
            column[5] += zz
        else:
            column[0] += zx
            column[1] += zy
            column[2] += zz


class CCD(NamedTuple):
    """Cyclic coordinate descent. Position: each joint turns the tip as near the target as it can, exactly.

    A pose has no such closed step: there each joint takes the least-squares step on the six errors, kept when the error
    falls. Source: Wang and Chen, IEEE Trans. Robotics and Automation 7 (1991); Olsen and Petersen (2011) for positions.
    """

    def pack(self, robot: Any) -> np.ndarray:
        """No parameters."""
        return np.zeros(0)


@rule(CCD, sweep=True)
def _ccd(cls, p, s, e):
    n = s.q.shape[0]
    kind = int(s.opt[O_KIND])
    tol_p = s.opt[O_TOL_P] / s.ends[E_VECTORS + 7 * n]
    tp, tr = tol_p * tol_p, s.opt[O_TOL_R] * s.opt[O_TOL_R]
    for i in range(n):
        s.x[8 + i] = s.q[i]
    px, py, pz = s.goal[9] - e.e0, s.goal[10] - e.e1, s.goal[11] - e.e2
    if kind == MASK_BASE or kind == MASK_TIP:  # a mask weights the error, so take the tip from the chain itself
        px, py, pz, e = measure(s.rows, s.ends, s.tip, s.goal, s.mask, kind, s.q, s.Z, s.ang, s.sn, s.cs, s.V, s.y)
    count = 0
    column = s.x[8 + 2 * n : 14 + 2 * n]
    for k in range(n):
        i = n - 1 - k
        if e.pp < tp and e.rr < tr:
            break
        if not s.w[i] > 0.0:
            continue
        coordinate_column(s.rows, s.Z, i, px, py, pz, column)
        old = s.q[i]
        if kind == POSITION and s.rows[0, 0] > 0.0 and s.rows[i, 9] > 0.0:
            zx, zy, zz = s.Z[i, 0], s.Z[i, 1], s.Z[i, 2]
            gx, gy, gz = s.goal[9] - s.Z[i, 3], s.goal[10] - s.Z[i, 4], s.goal[11] - s.Z[i, 5]
            rx, ry, rz = px - s.Z[i, 3], py - s.Z[i, 4], pz - s.Z[i, 5]
            across = column[0] * gx + column[1] * gy + column[2] * gz
            along = rx * gx + ry * gy + rz * gz - (rx * zx + ry * zy + rz * zz) * (gx * zx + gy * zy + gz * zz)
            move = math.atan2(across, along) if abs(across) + abs(along) > 1e-14 else 0.0
        else:
            ratio = angle_ratio(e.rr)
            top = column[0] * e.e0 + column[1] * e.e1 + column[2] * e.e2
            top += ratio * (column[3] * e.e3 + column[4] * e.e4 + column[5] * e.e5)
            size = 0.0
            for r in range(6 if kind != POSITION else 3):
                size += column[r] * column[r]
            move = top / size if size > 1e-14 else 0.0
        new = old + move
        if s.opt[O_LIMITS] > 0.0:
            new = min(max(new, s.lower[i]), s.upper[i])
        if new == old:
            continue
        s.q[i] = new
        qx, qy, qz, f = measure(s.rows, s.ends, s.tip, s.goal, s.mask, kind, s.q, s.Z, s.ang, s.sn, s.cs, s.V, s.y)
        count += 1
        if f.ee < e.ee:
            px, py, pz, e = qx, qy, qz, f
        else:
            s.q[i] = old  # Z of the joints below i is unchanged, so no evaluation is needed to go back
    for i in range(n):
        s.dq[i] = s.q[i] - s.x[8 + i]
        s.q[i] = s.x[8 + i]
    return count
