"""`--obstacle KIND:NUMBERS`: obstacles around the robot."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from ..errors import InvalidOption
from ..text import numbers

FORMS = {
    "box": ("x,y,z,sx,sy,sz[,roll,pitch,yaw]", 3),
    "sphere": ("x,y,z,radius", 1),
    "cylinder": ("x,y,z,radius,length[,roll,pitch,yaw]", 2),
}


def avoided(arm: Any, line: SimpleNamespace) -> dict[str, Any]:
    """The option `avoid_collisions` as --avoid-collisions, --obstacle and --margin ask for it, or none."""
    if not (line.avoid_collisions or line.obstacle or line.margin is not None):
        return {}
    plain = not line.obstacle and line.margin is None
    return {"avoid_collisions": plain or _model(arm, line.obstacle or (), line.margin)}


def _model(arm: Any, texts: Sequence[str], margin: float | None) -> Any:
    """A model with the obstacles [m, rad] placed in the base frame, and a margin [m]."""
    from ..robot.geometry.collision import CollisionModel
    from ..robot.pose import pose

    model = CollisionModel(arm, margin=margin or 0.0)
    for text in texts:
        kind, _, rest = text.partition(":")
        if kind not in FORMS:
            raise InvalidOption(f"--obstacle takes {_forms()}; not '{text}'")
        form, sizes = FORMS[kind]
        values = numbers(rest) or []
        turned = len(values) == 6 + sizes and kind != "sphere"
        if len(values) != 3 + sizes and not turned:
            raise InvalidOption(f"--obstacle {kind}: takes {form}; got {len(values)} numbers in '{text}'")
        place = pose(values[:3], rpy=values[-3:] if turned else None)
        size = values[3 : 3 + sizes]
        if kind == "box":
            model.add_box(size, place)
        elif kind == "sphere":
            model.add_sphere(size[0], place)
        else:
            model.add_cylinder(size[0], size[1], place)
    return model


def _forms() -> str:
    return " or ".join(f"{kind}:{form}" for kind, (form, _) in FORMS.items())
