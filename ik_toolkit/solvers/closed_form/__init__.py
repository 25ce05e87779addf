"""Closed-form solvers: each lists all solutions (branches) of a target, for robots whose structure it recognises."""

from typing import Any


def fits(robot: Any, kind: int) -> str | None:
    """Return the name of the closed form that solves this robot for a kind of target (KIND.pose or KIND.position), or None."""
    found = fit(robot, kind)
    return found[0] if found else None


def fit(robot: Any, kind: int) -> tuple[str, float] | None:
    """Return the name of the closed form that fits a robot, and by how much the robot's axes deviate from what it assumes; or None.

    kind: the kind of target (KIND.pose or KIND.position). The deviation is an angle [rad] or a length / reach. The result
    is stored with the robot for later calls.
    """
    if "closed forms" not in robot.memo:
        # Closed forms are for one tip only.
        robot.memo["closed forms"] = _recognise(robot.chain) if len(robot.tips) == 1 else {}
    return robot.memo["closed forms"].get(kind)


def describe_fit(robot: Any) -> str:
    """Return one sentence on the closed form that fits a robot and how well it fits, or ''."""
    from ...kernel.counted_error import KIND
    from .geometry import FIT

    for kind in (KIND.pose, KIND.position):
        found = fit(robot, kind)
        if found is not None:
            name, off = found
            if off <= FIT:
                return f"'{name}' fits exactly"
            return (
                f"'{name}' fits approximately: the axes deviate from its structure by {off:.2g} (rad, or of the reach); "
                "results are refined on the actual chain and prove nothing"
            )
    return ""


def _recognise(chain: Any) -> dict[int, tuple[str, float]]:
    from ...kernel.counted_error import KIND
    from ..rows import ROWS

    found: dict[int, tuple[str, float]] = {}
    for row in ROWS:
        if chain.n in row.joints:
            fit = row.load().recognise(chain)
            for kind, solved in ((KIND.pose, row.pose), (KIND.position, row.position)):
                if solved and not fit.reason:
                    found.setdefault(kind, (row.name, fit.off))
    return found
