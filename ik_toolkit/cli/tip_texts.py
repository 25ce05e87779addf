"""Options read tip by tip: targets of several tips, a value for each tip, and which tips are meant."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from ..errors import InvalidOption, InvalidTarget
from ..text import numbers, vector
from .arguments import MANY

FORMS = (
    "TIP:X,Y,Z, TIP:X,Y,Z,ROLL,PITCH,YAW, TIP:X,Y,Z,QX,QY,QZ,QW, or TIP: and 12 or 16 numbers of a matrix row by row"
)
MATRIX = (12, 16)  # numbers of a pose's matrix (3, 4) or (4, 4)

Z = (0.0, 0.0, 1.0)  # axis of the tip that --direction turns, unless --tip-axis names another


def values(texts: Sequence[str] | None, option: str, read: Callable[[str], Any]) -> Any:
    """Value of an option for all tips, or a dict by tip where it is given as TIP:VALUE; None where it is not given.

    Raises InvalidOption when it is given twice for a tip, or both for all tips and for one.
    """
    found: dict[str, Any] = {}
    for text in texts or ():
        tip, _, value = text.rpartition(":")
        if tip in found:
            raise InvalidOption(f"{option} is given twice{f' for {tip}' if tip else ''}")
        found[tip] = read(value)
    if "" in found and len(found) > 1:
        raise InvalidOption(f"{option} is given once for all tips, or as TIP:... for each of them")
    return found.get("", found) if found else None


def vectors(texts: Sequence[str] | None, option: str, size: int) -> Any:
    """The same for an option that takes this many numbers, as tuples."""
    return values(texts, option, lambda text: tuple(vector(text, option, size)))


def relations(texts: Sequence[str] | None) -> dict[str, str] | None:
    """Tips by the tip whose target is given relative to them, of TIP:OTHER. Raises InvalidOption."""
    found: dict[str, str] = {}
    for text in texts or ():
        tip, _, other = text.rpartition(":")
        if not (tip and other):
            raise InvalidOption(f"--relative takes TIP:OTHER (the target of TIP is a pose in OTHER), not '{text}'")
        if tip in found:
            raise InvalidOption(f"--relative is given twice for {tip}")
        found[tip] = other
    return found or None


def directions(direction: Sequence[str] | None, tip_axis: Sequence[str] | None) -> tuple[Any, Any]:
    """Directions and tip axes (3,) of --direction and --tip-axis, each as `values` gives it. Raises InvalidOption."""
    ways, axes = vectors(direction, "--direction", 3), vectors(tip_axis, "--tip-axis", 3)
    if axes is not None and ways is None:
        raise InvalidOption("--tip-axis says which axis --direction turns; give --direction too")
    return ways, axes


def targets(
    texts: Sequence[str], deg: bool, direction: Sequence[str] | None = None, tip_axis: Sequence[str] | None = None
) -> dict[str, Any]:
    """Targets by tip of --target (see FORMS), --direction and --tip-axis; angles in degrees when `deg`."""
    from ..robot.pose import pose

    ways, axes = directions(direction, tip_axis)
    made: dict[str, Any] = {}
    for text in texts:
        tip, _, rest = text.rpartition(":")
        x = numbers(rest) or []
        if not tip or len(x) not in (3, 6, 7, *MATRIX):
            raise InvalidTarget(f"--target takes {FORMS}, not '{text}'")
        if tip in made:
            raise InvalidTarget(f"--target gives '{tip}' twice; {MANY}")
        rpy = [math.radians(a) if deg else a for a in x[3:]] if len(x) == 6 else None
        towards, axis = (one.get(tip) if isinstance(one, dict) else one for one in (ways, axes))
        if len(x) in MATRIX:
            if towards:
                raise InvalidTarget(
                    f"--target {tip} is a whole pose, and --direction would turn it; give its x,y,z alone"
                )
            made[tip] = matrix(x)
            continue
        made[tip] = pose(x[:3], rpy=rpy, quat_xyzw=x[3:] if len(x) == 7 else None, axis=axis or Z, direction=towards)
    for option, given, others in (("--direction", ways, made), ("--tip-axis", axes, ways)):
        for tip in given if isinstance(given, dict) else ():
            if tip not in made or (isinstance(others, dict) and tip not in others):
                raise InvalidOption(
                    f"{option} {tip}:... needs a {'--target' if tip not in made else '--direction'} of {tip}"
                )
    return made


def matrix(x: Sequence[float]) -> Any:
    """Pose (4, 4) of the numbers of its matrix (see MATRIX), row by row. Raises InvalidTarget."""
    import numpy as np

    from ..robot.pose import LAST, check_target

    return check_target(np.reshape([*x, *(LAST if len(x) == MATRIX[0] else ())], (4, 4)))[0]


def choose_tips(
    source: str,
    tips: Sequence[str] | None,
    given: dict[str, Any] | None,
    relative: Sequence[str] | None,
    one: bool,
    group: str | None = None,
) -> str | list[str] | None:
    """Tip of a Robot, or the tips of a Tree: those of --tip, else the robot's own, else those with a target.

    given: targets by tip, None where there is no --target; one: whether one target without a tip is given; group: --group, whose
    tips `load_robot` takes: of a Robot where None is returned and there is one. Raises InvalidOption.
    """
    if group is not None:
        return None if given is None else []
    from ..robot.library import find

    known, named = find(source).tips, list(tips or ())
    for k, tip in enumerate(named):
        if tip in named[:k]:
            raise InvalidOption(f"--tip gives '{tip}' twice")
    if one and len(named) > 1:
        raise InvalidOption(f"--xyz is for one tip; give {', '.join(named)} a --target TIP:X,Y,Z each")
    if one and not named and len(known) > 1:
        raise InvalidOption(
            f"robot '{source}' has {len(known)} tips; choose one with --tip: {', '.join(known)}; or leave out --xyz and give a "
            "--target TIP:X,Y,Z for each (a tip without one is free)"
        )
    if given is None:
        return named[0] if len(named) == 1 else named or (list(known) if len(known) > 1 else None)
    if named:
        return named
    others = relations(relative) or {}
    asked = list(dict.fromkeys([*given, *others, *others.values()]))
    if len(known) > 1 and all(tip in known for tip in asked):
        return list(known)
    return [*(tip for tip in known if tip in asked), *(tip for tip in asked if tip not in known)]


def in_base(target: Any, poses: Any, relative: dict[str, str] | None) -> Any:
    """Targets as poses or positions in the base frame, where the tips stand at `poses` (dict by tip of pin.SE3)."""
    import numpy as np

    plain = getattr(target, "T_base_tip", target)
    if not isinstance(plain, dict):
        return plain
    made = {tip: np.asarray(getattr(one, "T_base_tip", one)) for tip, one in plain.items()}
    for tip, other in (relative or {}).items():
        if tip in made:
            T = poses[other]
            made[tip] = T.act(made[tip]) if made[tip].ndim == 1 else T.homogeneous @ made[tip]
    return made
