"""Options for the target of one or several tips, and for which components of it count."""

from collections.abc import Callable, Sequence
from typing import Any

from ..errors import InvalidOption, InvalidTarget
from ..text import comma_hint, numbers, vector
from .command import MANY, in_radians, option, options
from .options import joint_vector

FORMS = (
    "TIP:X,Y,Z, TIP:X,Y,Z,ROLL,PITCH,YAW, TIP:X,Y,Z,QX,QY,QZ,QW, or TIP: and 12 or 16 numbers of a matrix row by row"
)
# The options that describe a single target. The last two may also be given beside --target, for the directions of its targets.
POSED = ("--xyz", "--rpy", "--quat-xyzw", "--quat-wxyz", "--direction", "--tip-axis")
MATRIX = (12, 16)  # A pose may be given as a matrix (3, 4) or (4, 4), which has this many numbers.
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@options("Target")
class TargetOptions:
    """Options for where the tip, or each tip, must go."""

    xyz: str | None = option("X Y Z", "Target tip position in the base frame [m].")
    rpy: str | None = option("R P Y", "Target roll, pitch, yaw [rad] (Rz Ry Rx).")
    quat_xyzw: str | None = option("X Y Z W", "Target orientation as a quaternion, real part last.")
    quat_wxyz: str | None = option("W X Y Z", "Target orientation as a quaternion, real part first.")
    matrix: str | None = option(
        "M11 M12 ...", "Target pose as the 12 or 16 numbers of its matrix, row by row; replaces --xyz.", without=POSED
    )
    from_q: str | None = option(
        "Q1 Q2 ...",
        "Target where the tip, or every tip, stands at these joint values; replaces --xyz.",
        without=[*POSED, "--matrix", "--target", "--targets"],
    )
    targets: list[str] | None = option(
        "TIP:X,Y,Z[,...]",
        "Target of one of several tips solved together; repeat for each; replaces --xyz. A position, or a pose when "
        "roll, pitch, yaw or a quaternion x y z w follow, or 12 or 16 numbers of a matrix. A tip without a target is free.",
        "--target",
        without=[*POSED[:4], "--matrix"],
    )
    relative: list[str] | None = option(
        "TIP:OTHER",
        "Read the target of TIP in the moving frame of the tip OTHER; may be repeated.",
        needs=["--target", "--targets"],
    )
    direction: list[str] | None = option(
        "[TIP:]X Y Z", "Point --tip-axis in this direction; rotation about it is free."
    )
    tip_axis: list[str] | None = option(
        "[TIP:]X Y Z", "Axis of the tip for --direction; default z.", needs=["--direction"]
    )

    @property
    def posed(self) -> bool:
        """Whether a single target is described by an option: --xyz, --matrix or one for the orientation."""
        given = (self.xyz, self.matrix, self.rpy, self.quat_xyzw, self.quat_wxyz)
        return any(one is not None for one in given)

    def read(self, deg: bool) -> Any:
        """Return one target, or with --target a dict by tip; deg: if angles are degrees. Raises InvalidOption, InvalidTarget."""
        return self._several(self.targets, deg) if self.targets else self._single(deg)

    def _directions(self) -> tuple[Any, Any]:
        """Return the directions and tip axes (3,) of --direction and --tip-axis, for all tips or by tip, or None."""
        return _vectors(self.direction, "--direction", 3), _vectors(self.tip_axis, "--tip-axis", 3)

    def _single(self, deg: bool) -> Any:
        """Return a single target: a position (3,) if the orientation is free, a pose (4, 4), or an AxisTarget."""
        from ..robot.pose import pose

        if self.matrix is not None:
            x = vector(self.matrix, "--matrix")
            if len(x) not in MATRIX:
                raise InvalidTarget(f"--matrix takes 12 or 16 numbers, row by row; got {len(x)}")
            return _pose_of(x)
        rpy = None if self.rpy is None else vector(self.rpy, "--rpy", 3)
        xyzw = None if self.quat_xyzw is None else vector(self.quat_xyzw, "--quat-xyzw", 4)
        wxyz = None if self.quat_wxyz is None else vector(self.quat_wxyz, "--quat-wxyz", 4)
        angles = rpy and [in_radians(x, deg) for x in rpy]
        ways, axes = self._directions()
        for name, one in (("--direction", ways), ("--tip-axis", axes)):
            if isinstance(one, dict):
                raise InvalidOption(f"{name} TIP:... goes with --target; for --xyz leave out the tip")
        at = vector(self.xyz or "", "--xyz", 3)
        return pose(at, rpy=angles, quat_xyzw=xyzw, quat_wxyz=wxyz, axis=axes, direction=ways)

    def _several(self, texts: Sequence[str], deg: bool) -> dict[str, Any]:
        """Return targets by tip from --target, --direction and --tip-axis."""
        from ..robot.pose import pose

        ways, axes = self._directions()
        made: dict[str, Any] = {}
        for text in texts:
            tip, _, rest = text.rpartition(":")
            x = numbers(rest) or []
            if not tip or len(x) not in (3, 6, 7, *MATRIX):
                hint = comma_hint(rest, f"--target {tip}:", (3, 6, 7, *MATRIX))
                raise InvalidTarget(f"--target takes {FORMS}, not '{text}'{hint}")
            x = vector(rest, f"--target {tip}:")
            if tip in made:
                raise InvalidTarget(f"--target gives '{tip}' twice; {MANY}")
            rpy = [in_radians(a, deg) for a in x[3:]] if len(x) == 6 else None
            way, axis = (one.get(tip) if isinstance(one, dict) else one for one in (ways, axes))
            if len(x) not in MATRIX:
                quat = x[3:] if len(x) == 7 else None
                made[tip] = pose(x[:3], rpy=rpy, quat_xyzw=quat, axis=axis if way else None, direction=way)
            elif way:
                raise InvalidTarget(
                    f"--target {tip} is a whole pose, and --direction would turn it; give its x,y,z alone"
                )
            else:
                made[tip] = _pose_of(x)
        for name, one, others in (("--direction", ways, made), ("--tip-axis", axes, ways)):
            for tip in one if isinstance(one, dict) else ():
                if tip not in made or (isinstance(others, dict) and tip not in others):
                    needed = "--target" if tip not in made else "--direction"
                    raise InvalidOption(f"{name} {tip}:... needs a {needed} of {tip}")
        return made

    def reached(self, arm: Any, deg: bool) -> Any:
        """Return the pose (4, 4) [m] of the tip at the joint values of --from-q (degrees if `deg`), for several tips a dict."""
        at = arm.fk(joint_vector(arm, self.from_q, "--from-q", deg))
        return {tip: T.homogeneous for tip, T in at.items()} if isinstance(at, dict) else at.homogeneous


@options("What counts")
class CountOptions:
    """Options for which components of a target count, for all tips or by tip."""

    mask: list[str] | None = option(
        "[TIP:]X Y Z RX RY RZ",
        "Six error weights; 0 frees a coordinate. For all tips, or as TIP:... for one; may be repeated.",
    )
    slack: list[str] | None = option(
        "[TIP:]X Y Z RX RY RZ",
        "Six half widths within which the error is zero [m, rad; degrees with --deg]; inf frees a coordinate.",
    )
    free_turn: list[str] | None = option(
        "[TIP:]X Y Z", "Axis of the tip about which it may rotate freely: x, y, z or a vector."
    )
    frame: list[str] | None = option(
        "[TIP:]base|tip|target", "Axes of --mask and --slack.", needs=["--mask", "--slack", "--free-turn"]
    )
    priority: str | None = option(
        "LEVEL,...",
        "What comes first: position, orientation, or TIP and TIP:position in order, + between equals; the rest comes last.",
    )

    def read(self, deg: bool, relative: Sequence[str] | None) -> dict[str, Any]:
        """Return the given options as keyword arguments of a solver; relative: texts of --relative. Raises InvalidOption."""
        turn = in_radians(1.0, deg)
        slack = _vectors(self.slack, "--slack", 6, (1.0, 1.0, 1.0, turn, turn, turn))
        axis = _for_tips(self.free_turn, "--free-turn", _axis)
        options = {"mask": _vectors(self.mask, "--mask", 6), "slack": slack, "free_turn": axis}
        options |= {"frame": _for_tips(self.frame, "--frame", str), "relative_to": relations(relative)}
        options["priority"] = priorities(self.priority)
        return {name: value for name, value in options.items() if value is not None}


def priorities(text: str | None) -> list[Any] | None:
    """Return the argument `priority` of a solver for the text of --priority: levels, most important first.

    A level is a list of GROUP or (TIP, GROUP), such as "position" or ("left_tip", "orientation"); None if text is None.
    """

    def one(word: str) -> Any:
        tip, _, group = word.strip().rpartition(":")
        return (tip, group) if tip else group

    return None if text is None else [[one(word) for word in level.split("+")] for level in text.split(",")]


def _for_tips(texts: Sequence[str] | None, name: str, read: Callable[[str], Any]) -> Any:
    """Return the value of an option for all tips, or a dict by tip if given as TIP:VALUE; None if it is not given.

    Raises InvalidOption when it is given twice for a tip, or both for all tips and for one.
    """
    found: dict[str, Any] = {}
    for text in texts or ():
        tip, _, value = text.rpartition(":")
        if tip in found:
            raise InvalidOption(f"{name} is given twice{f' for {tip}' if tip else ''}")
        found[tip] = read(value)
    if "" in found and len(found) > 1:
        raise InvalidOption(f"{name} is given once for all tips, or as TIP:... for each of them")
    return found.get("", found) if found else None


def _vectors(texts: Sequence[str] | None, name: str, size: int, factors: Sequence[float] | None = None) -> Any:
    """Return the value of an option of `size` numbers as a tuple, or a dict of tuples by tip; factors: multiply the numbers."""
    each = factors or (1.0,) * size
    return _for_tips(
        texts, name, lambda text: tuple(x * factor for x, factor in zip(vector(text, name, size), each, strict=True))
    )


def _axis(text: str) -> tuple[float, ...]:
    """Return a tip axis (3,) from x, y, z or three numbers."""
    return AXES.get(text.strip().lower()) or tuple(vector(text, f"--free-turn ({', '.join(AXES)}, or a vector)", 3))


def relations(texts: Sequence[str] | None) -> dict[str, str] | None:
    """Return texts TIP:OTHER of --relative as {TIP: OTHER}: the target of TIP is in the frame of OTHER. Raises InvalidOption."""
    found: dict[str, str] = {}
    for text in texts or ():
        tip, _, other = text.rpartition(":")
        if not (tip and other):
            raise InvalidOption(f"--relative takes TIP:OTHER (the target of TIP is a pose in OTHER), not '{text}'")
        if tip in found:
            raise InvalidOption(f"--relative is given twice for {tip}")
        found[tip] = other
    return found or None


def _pose_of(x: Sequence[float]) -> Any:
    """Return the pose (4, 4) from 12 or 16 numbers of its matrix, row by row. Raises InvalidTarget."""
    import numpy as np

    from ..robot.pose import LAST, corrected

    return corrected(np.reshape([*x, *(LAST if len(x) == MATRIX[0] else ())], (4, 4)))


def in_base(target: Any, poses: Any, relative: dict[str, str] | None) -> Any:
    """Return a target as a pose (4, 4) or position (3,) in the base frame; for several tips a dict of these by tip.

    poses: where the tips are (pin.SE3 by tip), for targets relative to another tip; relative: {TIP: OTHER} of these.
    """
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


def at_home(arm: Any, target: Any, options: dict[str, Any]) -> Any:
    """Return the target that the robot reaches at home, as a position or pose like the given target."""
    T = arm.fk(arm.home)
    if not arm.by_tip:
        return T.translation if getattr(target, "ndim", 2) == 1 else T
    relative = options.get("relative_to") or {}  # If this names an unknown tip, the solver refuses it later.
    return {tip: T[relative[tip]].actInv(T[tip]) if relative.get(tip) in T else T[tip] for tip in T}


def request(arm: Any, target: Any, options: dict[str, Any]) -> dict[str, Any]:
    """Return what the user asked for, as part of the JSON output: base, tip and target.

    For several tips it is the base, the targets by tip and, if given, the option `relative_to`.
    """
    plain = {tip: getattr(one, "T_base_tip", one) for tip, one in arm.each_tip(target).items()}
    if not arm.by_tip:
        return {"base": arm.base, "target": plain[arm.tip], "tip": arm.tip}
    relative = options.get("relative_to")
    return {"base": arm.base, "target": plain, **({"relative_to": relative} if relative else {})}
