"""What reading a description of any format gives: URDF text, and what a URDF cannot hold."""

from pathlib import Path
from typing import NamedTuple

from ..constraints import Constraint
from .srdf import Srdf


class Urdf(NamedTuple):
    """A robot description as URDF text.

    `notes` are sentences on what was left out. `srdf` has configurations and pairs of links that may touch, `constraints` the loops
    and relations between joints that the description itself gives, as MJCF does. `made` tells that the text was made from another
    format, so that its line numbers are not those of the file. ROS packages are searched in `package_dirs`.
    """

    text: str
    notes: tuple[str, ...] = ()
    srdf: Srdf = Srdf()
    constraints: tuple[Constraint, ...] = ()
    made: bool = True
    package_dirs: tuple[Path, ...] = ()
