"""Published data of Burrell et al. (2016): its tables, and its misprints with the corrections that are used here."""

import math
from typing import Any

import numpy as np

from ...robot.robot import Robot
from ...solvers.batch.result import BatchResult
from ...solvers.batch.solve_batch import solve_batch

# A matrix that turns vectors in the axes of the robot's base_link into vectors in the axes of the paper.
TO_PAPER = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Tolerance [m] and iteration limit are our choice; the paper gives neither.
PAPER_OPTIONS: dict[str, Any] = {"tolerance": 1e-3, "max_iterations": 1000}
# Tables I and III as printed. A row is a joint: offset of theta, d, a, alpha, lower and upper limit, in mm and degrees. Table III,
# for the planar arm, has lengths without a unit.
TABLE_1 = (
    (0, 0, 70.0, 90, -27.07, 40.60),
    (0, 0, 523.4, 0, -10.32, 65.64),
    (0, 0, 165.0, -90, -42.01, 21.43),
    (0, -212.0, 44.45, 90, -63.94, 114.97),
    (-90, 0, 184.0, -90, -81.52, -4.16),
    (-90, 284.8, 0, 0, -260.0, 260.0),
)
TABLE_3 = ((0, 0, 2, 0, -60, 60),) * 3
# Table II: the time of a solve [ms] by each method, for the tolerances 5, 2, 1 and 0.1 mm.
TABLE_2 = {
    "J+": (0.823, 1.115, 1.368, 1.727),
    "J^T": (0.951, 1.327, 1.602, 2.391),
    "DLS": (1.091, 1.524, 1.780, 2.538),
    "IK-PID": (16.258, 16.231, 16.147, math.nan),
    "state space": (0.604, 0.763, 0.875, 1.310),
}
TOLERANCES = (5e-3, 2e-3, 1e-3, 1e-4)  # Position tolerances [m] of the columns of Table II.
# Two input matrices B for the planar arm. The paper prints none, so they were found by a search over whole numbers.
PLANAR_B = [[2, -2], [-1, 0], [1, -2]], [[0, -2], [-1, -1], [-2, -1]]
# Misprints and gaps of the paper. Each line has the place in the paper, the problem, and the correction that is used here.
MISPRINTS = """
eq. (2), element (2,4) | +sin(alpha) d: it would flip d_4 and d_6, which the printed B does not fit | minus
eq. (2), Table I | a_{i-1} in the formula, a in the table | classic rows; the same here, as row 6 has a = alpha = 0
section 3.1 | T_i 'from the 1st to the i-th joint'; yaw, pitch, roll 'about x, y, z' | T_i: link i-1 to i; yaw z, pitch y, roll x
section 6.4 | names eq. (10) and J+, works (11)-(12), the transpose; alpha is 0/0, not 0 | J^T e = 0
section 4 | '+dtheta and +dtheta' | plus and minus
Algorithm I, line 15 | 'if theta > minimum limit' | < minimum
Algorithm I, lines 8-14 | the minus trial starts from the saturated plus trial | theta - delta, evaluated as a vector
Algorithm I | no exits; first change of |e| undefined | exits of the text; 0; tip first; not moving wins ties
eq. (13) | the sum of norms never falls, so K_i leaves a floor | K_i as small as printed
eqs. (14)-(15) | x(0), delay and windup unsaid | x(0) = 0, literal delay, state untouched by saturation
sections 6.1, 6.2 | start, goals, tolerance, iteration limit, tuned matrices unpublished | ours, stated
section 6.3 | 'approximately 65 %' | Table II: 73, 68, 64, 76 %
Table II, IK-PID | time falls as the tolerance tightens: no early exit was timed | our exits
section 1 | six joints 'hence redundant' | redundant for positions only
conclusion | 'improved robustness against singularities' | one planar goal; see section 6.4
"""


def attempt(robot: Robot, goals: np.ndarray, rule: Any, q0: np.ndarray | None, **options: Any) -> BatchResult:
    """Solve goals (N, 3) [m] by a solver (`rule`) from q0 (n,) [rad] (None: its own start).

    The options are PAPER_OPTIONS unless others are given.
    """
    return solve_batch(robot, goals, rule, q0=q0, check=0.0, **PAPER_OPTIONS | options)
