"""Limits of joints as the compiled loop takes them."""

from typing import Any

import numpy as np

from ..errors import InvalidOption, floats
from ..robot.robot import Robot
from ..robot.tree import Tree
from .inputs import switch


def limit_rows(robot: Robot | Tree, limits: bool, acceleration_limits: Any) -> np.ndarray:
    """Rows lower, upper, speed, acceleration (4, n) in kernel units; infinite where there is none."""
    n, unit = robot.n, robot.chain.unit
    rows = np.full((4, n), np.inf)
    rows[0] = -np.inf
    if switch(limits, "limits"):
        speed = np.asarray(robot.velocity_limits, dtype=float)
        rows[0], rows[1] = robot.lower / unit, robot.upper / unit
        rows[2] = np.where(speed > 0.0, speed, np.inf) / unit
    if acceleration_limits is not None:
        if not limits:
            raise InvalidOption("acceleration_limits need limits=True")
        what = f"acceleration_limits must be a number or {n} numbers"
        a = floats(acceleration_limits, what, InvalidOption)
        if a.shape not in ((), (n,)):
            raise InvalidOption(f"{what}, not {acceleration_limits!r:.60}")
        if not (a > 0.0).all():
            raise InvalidOption(f"acceleration_limits must be positive, not {acceleration_limits!r}")
        rows[3] = a / unit
    return rows
