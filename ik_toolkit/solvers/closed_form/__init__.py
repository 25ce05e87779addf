"""Closed forms: every branch at once, for the structures they are recognised to fit."""

from typing import Any


def fits(robot: Any, kind: int) -> str | None:
    """Name of the closed form that solves this robot for a kind of target (kernel.task.POSE or POSITION), or None.

    The chain's geometry decides; the answer is kept with the robot, so asking again costs a look-up.
    """
    known = robot.__dict__.get("_closed_form")
    if known is None or known[0] is not robot.chain:
        known = robot.__dict__["_closed_form"] = (robot.chain, _recognise(robot.chain))
    return known[1].get(kind)


def _recognise(chain: Any) -> dict[int, str]:
    from ...kernel.task import POSE, POSITION

    if chain.n == 2:
        from . import planar_2r

        return {} if planar_2r.recognise(chain)[1] else {POSITION: "planar-2r"}
    if chain.n in (6, 7):
        from . import inspection

        return {} if inspection.recognise(chain)[1] else {POSE: "inspection"}
    return {}
