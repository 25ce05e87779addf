"""Reproductions of the papers behind the toolkit, which compare published numbers with computed ones.

PAPERS lists them by name. It is plain data, so that listing the papers imports none of their modules.
"""

from typing import NamedTuple


class Paper(NamedTuple):
    """A scientific paper whose published numbers the command `ik reproduce` computes again, as a report."""

    target: str  # The function that makes the report, as "module:function".
    summary: str  # One line on what the paper is about, for the list of papers.
    needs: tuple[str, str] | None = None  # A package that the report needs, and the extra that installs it.


PAPERS: dict[str, Paper] = {
    "burrell": Paper(
        "ik_toolkit.papers.burrell_2016.paper:reproduce",
        "Burrell et al. 2016: IK-PID and state-space solver of the HydroLek-7W, tuned further, and on other robots",
    ),
    "shanmugasundar": Paper(
        "ik_toolkit.papers.shanmugasundar_2012.paper:reproduce",
        "Shanmugasundar and Sivaramakrishnan 2012: closed-form inverse of a 7-joint inspection robot",
        ("scipy", "paths"),
    ),
    "patko": Paper(
        "ik_toolkit.papers.patko_2019.paper:reproduce",
        "Patko and Zelei 2019: tracking at velocity and acceleration level, four methods",
        ("example-robot-data", "robots"),
    ),
    "chinyai": Paper(
        "ik_toolkit.papers.chinyai.paper:reproduce",
        "Chinyai: Newton-Raphson against the closed form on a planar two-link arm",
    ),
}
