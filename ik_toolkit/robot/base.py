"""Turns moving bases and joints with several degrees of freedom into ordinary joints of one coordinate each.

A floating base becomes three prismatic and three revolute joints, Rz(yaw) Ry(pitch) Rx(roll), so limits, solvers,
batches, paths and tracking need not know about it. For a model with a free-flyer or ball joint, `GivenModel` converts
configurations to the model's form and back.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InvalidOption, ModelError, floats, near_match
from .formats.urdf import ENDLESS
from .pose import check_target
from .rotation import matrix_quat, matrix_rpy, quat_matrix, rpy_matrix

# The pitch of a floating base is at most 85 degrees either way, because at 90 degrees yaw and roll share one axis.
PITCH = math.radians(85.0)
# A ball joint is replaced by yaw, pitch and roll. Limiting the pitch to +- this angle [rad] still allows every rotation.
BALL_PITCH = math.pi / 2
AXES = {
    "x": pin.JointModelPX, "y": pin.JointModelPY, "z": pin.JointModelPZ,
    "yaw": pin.JointModelRZ, "pitch": pin.JointModelRY, "roll": pin.JointModelRX,
}  # fmt: skip
SLIDES, TURNS = ("x", "y", "z"), ("yaw", "pitch", "roll")
BASES = {"rail": ("x",), "planar": ("x", "y", "yaw"), "floating": (*SLIDES, *TURNS)}
# For each Pinocchio joint type with several degrees of freedom, the joints with one degree of freedom that replace it.
PARTS = {
    "JointModelFreeFlyer": BASES["floating"],
    "JointModelPlanar": BASES["planar"],
    "JointModelTranslation": SLIDES,
    "JointModelSpherical": TURNS,
    "JointModelSphericalZYX": TURNS,
}
ROAMS = ("JointModelFreeFlyer", "JointModelPlanar")
ROOT = "base"  # The names of base coordinates begin with this: base_x, ..., base_roll.


class UnfoldedJoint(NamedTuple):
    """A joint with several degrees of freedom: its Pinocchio type, its index in q of its model, and the joints that replace it."""

    kind: str
    idx_q: int
    names: tuple[str, ...]


class GivenModel(NamedTuple):
    """The Pinocchio model that the user gave, if it has joints with several degrees of freedom (`blocks`).

    The robot computes with another model, in which these joints are replaced; the methods convert configurations.
    """

    model: pin.Model
    blocks: tuple[UnfoldedJoint, ...]

    def form(self, model: pin.Model, full: np.ndarray) -> np.ndarray:
        """Return the configuration (nq,) of the user's model for one of `model`, whose joints have one degree of freedom each."""
        q = pin.neutral(self.model)
        for own, other, size in self._same(model):
            q[own : own + size] = full[other : other + size]
        for block in self.blocks:
            x = np.array([full[model.joints[model.getJointId(name)].idx_q] for name in block.names])
            q[block.idx_q : block.idx_q + _size(block)] = _packed(block.kind, x)
        return q

    def back(self, model: pin.Model, q: np.ndarray) -> np.ndarray:
        """Return the configuration (nq,) of `model`, whose joints have one degree of freedom each, for one of the user's model."""
        full = pin.neutral(model)
        for own, other, size in self._same(model):
            full[other : other + size] = q[own : own + size]
        for block in self.blocks:
            values = _unpacked(block.kind, q[block.idx_q : block.idx_q + _size(block)])
            for name, x in zip(block.names, values, strict=True):
                full[model.joints[model.getJointId(name)].idx_q] = x
        return full

    def _same(self, model: pin.Model) -> list[tuple[int, int, int]]:
        """Return, for the joints that both models have, their indices in q of the given model and of `model`, and their sizes."""
        pairs = [
            (self.model.joints[j], model.joints[model.getJointId(name)])
            for j, name in enumerate(self.model.names)
            if j and self.model.joints[j].nq in (1, 2) and model.existJointName(name)
        ]
        return [(own.idx_q, other.idx_q, own.nq) for own, other in pairs]


def joint_value(joint: Any, full: np.ndarray) -> float:
    """Return the value [rad or m] of a joint with one degree of freedom in the Pinocchio configuration `full` (nq,)."""
    x = full[joint.idx_q : joint.idx_q + joint.nq]
    return float(x[0]) if joint.nq == 1 else math.atan2(x[1], x[0])


def put_joint(joint: Any, full: np.ndarray, value: float) -> None:
    """Write the value [rad or m] of a joint with one degree of freedom into the Pinocchio configuration `full` (nq,)."""
    x = (value,) if joint.nq == 1 else (math.cos(value), math.sin(value))
    full[joint.idx_q : joint.idx_q + joint.nq] = x


def _size(block: UnfoldedJoint) -> int:
    return {"JointModelFreeFlyer": 7, "JointModelPlanar": 4, "JointModelSpherical": 4}.get(block.kind, 3)


def _packed(kind: str, x: np.ndarray) -> np.ndarray:
    """Convert the coordinates x of a joint with several degrees of freedom to Pinocchio's representation."""
    if kind == "JointModelPlanar":
        return np.array([x[0], x[1], math.cos(x[2]), math.sin(x[2])])
    if kind in ("JointModelFreeFlyer", "JointModelSpherical"):
        return np.concatenate([x[:-3], matrix_quat(rpy_matrix(x[:-4:-1]))])
    return x


def _unpacked(kind: str, q: np.ndarray) -> np.ndarray:
    """Convert Pinocchio's representation q of a joint with several degrees of freedom to its coordinates."""
    if kind == "JointModelPlanar":
        return np.array([q[0], q[1], math.atan2(q[3], q[2])])
    if kind in ("JointModelFreeFlyer", "JointModelSpherical"):
        return np.concatenate([q[:-4], matrix_rpy(quat_matrix(q[-4:]))[::-1]])
    return q


# ------------------------------------------------------------------------------------------------------------- models
def _add(model: pin.Model, parent: int, prefix: str, part: str, placement: pin.SE3, pitch: float) -> int:
    """Append a joint of one coordinate, whose name is PREFIX_PART ('base_x'), to a model and return its index."""
    name = f"{prefix}_{part}"
    if model.existJointName(name):
        raise ModelError(f"the robot already has a joint '{name}', a name that its base needs")
    far = np.array([pitch if part == "pitch" else ENDLESS])
    none = np.array([ENDLESS])
    joint = model.addJoint(parent, AXES[part](), placement, name, none, none, -far, far)
    model.addJointFrame(joint)
    return joint


def _several(model: pin.Model) -> list[int]:
    return [j for j in range(1, model.njoints) if model.joints[j].shortname() in PARTS]


def root_joint(model: pin.Model) -> int:
    """Return the id of the free-flyer or planar joint at the root that moves the whole model, or 0 if there is none."""
    first = [j for j in range(1, model.njoints) if model.parents[j] == 0]
    return first[0] if len(first) == 1 and model.joints[first[0]].shortname() in ROAMS else 0


def carried(model: pin.Model, tip: str) -> tuple[str, str] | None:
    """Return the names of the last floating or planar joint on the way from root to tip and of its link, or None."""
    joint = next((frame.parentJoint for frame in model.frames if frame.name == tip), 0)
    above = model.supports[joint]
    roams = [j for j in above if j and model.joints[j].shortname() in ROAMS]
    links = (
        (model.names[roams[-1]], frame.name)
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.parentJoint in roams[-1:]
    )
    return next(links, None)


def unfold(model: pin.Model) -> tuple[pin.Model, GivenModel | None]:
    """Return a model whose joints with several degrees of freedom are replaced by joints of one, and a GivenModel of the original.

    The GivenModel converts configurations; it is None if no joint needed a replacement. Frames keep their names. In a model with
    mimic joints, which Pinocchio cannot copy, only a joint at the root is replaced.
    """
    several = _several(model)
    root = root_joint(model)
    if not several or (len(model.mimicking_joints) and several != [root]):
        return model, None
    prefix = {j: ROOT if j == root else model.names[j] for j in several}
    blocks = tuple(
        UnfoldedJoint(
            model.joints[j].shortname(),
            model.joints[j].idx_q,
            tuple(f"{prefix[j]}_{part}" for part in PARTS[model.joints[j].shortname()]),
        )
        for j in several
    )
    if len(model.mimicking_joints):
        base, last = pin.Model(), 0
        for k, part in enumerate(PARTS[model.joints[root].shortname()]):
            placement = model.jointPlacements[root] if k == 0 else pin.SE3.Identity()
            last = _add(base, last, ROOT, part, placement, PITCH)
        numbered, own = _numbered(model)
        held = pin.buildReducedModel(numbered, [root], pin.neutral(model))
        made = _appended(base, held, model.jointPlacements[root].inverse(), own)
    else:
        made = _copied(model, prefix)
    made.name = model.name
    _take_limits(model, made, blocks)
    return made, GivenModel(model, blocks)


def _take_limits(model: pin.Model, made: pin.Model, blocks: Sequence[UnfoldedJoint]) -> None:
    """Give the prismatic joints the limits [m] of the given model, if it has any."""
    lower, upper = np.array(made.lowerPositionLimit), np.array(made.upperPositionLimit)
    for block in blocks:
        for k, name in enumerate(block.names):
            low, high = model.lowerPositionLimit[block.idx_q + k], model.upperPositionLimit[block.idx_q + k]
            if name.rpartition("_")[2] in SLIDES and -ENDLESS < low < high < ENDLESS:
                place = made.joints[made.getJointId(name)].idx_q
                lower[place], upper[place] = low, high
    made.lowerPositionLimit, made.upperPositionLimit = lower, upper


def _copied(model: pin.Model, prefix: Mapping[int, str]) -> pin.Model:
    """Copy a model and replace the joints that have a prefix by joints of one coordinate."""
    made = pin.Model()
    joints, frames = {0: 0}, {0: 0}
    for j in range(1, model.njoints):
        parent, placement, joint = joints[model.parents[j]], model.jointPlacements[j], model.joints[j]
        if j in prefix:
            pitch = PITCH if joint.shortname() == "JointModelFreeFlyer" else BALL_PITCH
            for part in PARTS[joint.shortname()]:
                parent = _add(made, parent, prefix[j], part, placement, pitch)
                placement = pin.SE3.Identity()
            joints[j] = parent
        else:
            q, v = (slice(i, i + n) for i, n in ((joint.idx_q, joint.nq), (joint.idx_v, joint.nv)))
            effort, speed = (np.asarray(limit)[v] for limit in (model.upperEffortLimit, model.upperVelocityLimit))
            lower, upper = (np.asarray(limit)[q] for limit in (model.lowerPositionLimit, model.upperPositionLimit))
            joints[j] = made.addJoint(parent, joint, placement, model.names[j], effort, speed, lower, upper)
        made.appendBodyToJoint(joints[j], model.inertias[j], pin.SE3.Identity())
    for k, frame in enumerate(model.frames):
        if k:
            joint = joints[frame.parentJoint]
            frames[k] = made.addFrame(pin.Frame(frame.name, joint, 0, frame.placement, frame.type), False)
    for k, frame in enumerate(model.frames):  # In a reduced or appended model a frame may stand before its parent.
        made.frames[frames[k]].parentFrame = frames[frame.parentFrame]
    return made


def _numbered(model: pin.Model) -> tuple[pin.Model, dict[str, str]]:
    """Return a copy of a model whose links are numbered, for functions of Pinocchio that find frames by name, and their names.

    Those functions do not look at the type of a frame, but a joint and a link may have the same name.
    """
    made, names = pin.Model(model), {}
    for k in range(1, made.nframes):
        if made.frames[k].type not in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT):
            names[f"frame {k}"], made.frames[k].name = made.frames[k].name, f"frame {k}"
    return made, names


def _appended(base: pin.Model, model: pin.Model, T: pin.SE3, names: Mapping[str, str]) -> pin.Model:
    """Return a model of the joints of `base` and, at T on its last frame, those of `model`, whose links get their `names` again."""
    made = pin.appendModel(base, model, base.nframes - 1, T)
    for frame in made.frames:
        frame.name = names.get(frame.name, frame.name)
    return made


def stand(model: pin.Model, on_base: Any) -> pin.Model:
    """Return a copy of a Pinocchio model that is mounted on a moving base, or whose root is at another pose.

    on_base: 'rail', 'planar' or 'floating', for which joints are added before the root, or the pose (4, 4) of the root. Raises
    InvalidOption, InvalidTarget.
    """
    made, last, T = pin.Model(), 0, pin.SE3.Identity()
    if isinstance(on_base, str):
        if on_base not in BASES:
            raise InvalidOption(
                f"on_base must be 'rail', 'planar', 'floating' or a pose, not '{on_base}'.{near_match(on_base, BASES)}"
            )
        for part in BASES[on_base]:
            last = _add(made, last, ROOT, part, pin.SE3.Identity(), PITCH)
            if model.existJointName(f"{ROOT}_{part}"):
                raise InvalidOption(f"the robot already has a joint '{ROOT}_{part}', a name that its base needs")
    else:
        pose, _ = check_target(on_base, of="base")
        T = pin.SE3(pose) if pose.ndim == 2 else pin.SE3(np.eye(3), pose)
    numbered, own = _numbered(model)
    made = _appended(made, numbered, T, own)
    made.name = model.name
    return made


class BasedModel(NamedTuple):
    """A Pinocchio model `model` whose joints have one degree of freedom each, made from the model that the user gave.

    `original` is the user's model, or None if no change was needed; `given` converts configurations to it, or is None if q is the
    same in both. `names` lists the joints added for a base or for joints with several degrees of freedom, `slides` the prismatic
    ones of them.
    """

    model: pin.Model
    original: pin.Model | None
    given: GivenModel | None
    names: tuple[str, ...]
    slides: tuple[str, ...]


def on_own_base(model: pin.Model, on_base: Any = None, base_limits: Any = None) -> BasedModel:
    """Return the model that a robot computes with: the given one on its base, with one degree of freedom in every joint.

    `on_base` and `base_limits` are the options of `Robot.load`. Raises InvalidOption, InvalidTarget, ModelError.
    """
    made, given = unfold(model)
    names = [name for block in (given.blocks if given else ()) for name in block.names]
    if isinstance(on_base, str) and root_joint(model):
        raise InvalidOption("the model already has a base that moves, so on_base must be a pose")
    if on_base is not None:
        made = stand(made, on_base)
        names += [f"{ROOT}_{part}" for part in BASES[on_base]] if isinstance(on_base, str) else []
    slides = tuple(name for name in names if name.rpartition("_")[2] in SLIDES)
    if base_limits is not None:
        if not slides:
            raise InvalidOption(
                "base_limits are for a moving base: on_base='rail', 'planar' or 'floating', or a free-flyer"
            )
        set_base_limits(made, base_limits, slides, [name for name in names if name not in slides])
    return BasedModel(made, None if made is model else model, given, tuple(names), slides)


def describes(drawn: pin.Model, model: pin.Model, names: Sequence[str]) -> bool:
    """Return whether `drawn`, the model of a URDF, has the same joints and frames as `model`, and the frames `names`.

    `model` may have further frames, such as those that a program has added to it.
    """

    def parts(one: pin.Model) -> list[list[Any]]:
        frames = one.frames.tolist()[: drawn.nframes]
        return [list(one.names), one.joints.tolist(), one.jointPlacements.tolist(), frames]

    return parts(drawn) == parts(model) and all(drawn.existFrame(name) for name in names)


def put_on(geometry: pin.GeometryModel, original: pin.Model, model: pin.Model) -> None:
    """Move the shapes of `geometry`, in place, from the links of model `original` to the links of the same names in `model`."""
    for shape in geometry.geometryObjects:
        # A shape without a valid parent frame is placed relative to a frame of its parent joint.
        of_joint = (k for k, frame in enumerate(original.frames) if frame.parentJoint == shape.parentJoint)
        old = original.frames[shape.parentFrame if shape.parentFrame < original.nframes else next(of_joint)]
        k = model.getFrameId(old.name, old.type)
        new = model.frames[k]
        shape.placement = new.placement * old.placement.inverse() * shape.placement
        shape.parentFrame, shape.parentJoint = k, new.parentJoint


def set_base_limits(model: pin.Model, base_limits: Any, slides: Sequence[str], turns: Sequence[str]) -> None:
    """Write the limits of a moving base into a model, in place. Raises InvalidOption.

    slides, turns: names of the prismatic and of the revolute joints of the base. base_limits
    is one (lower, upper) [m] for all slides, one pair for each slide or each coordinate, or a dict of pairs
    by name ('base_x' or 'x').
    """
    names = [*slides, *turns]
    if isinstance(base_limits, Mapping):
        short = {name.removeprefix(f"{ROOT}_"): name for name in names}
        pairs = {}
        for key, pair in base_limits.items():
            name = short.get(key, key)
            if name not in names:
                raise InvalidOption(f"base_limits: the base has no coordinate '{key}'.{near_match(str(key), names)}")
            pairs[name] = _pair(name, pair)
    else:
        what = "base_limits must be (lower, upper) [m] for the prismatic joints of the base, or a pair for each"
        values = floats(base_limits, what, InvalidOption)
        if values.shape == (2,):
            values = np.tile(values, (len(slides), 1))
        if values.shape not in ((len(slides), 2), (len(names), 2)):
            raise InvalidOption(f"{what} of {', '.join(slides)}, not an array of shape {values.shape}")
        pairs = {name: _pair(name, pair) for name, pair in zip(names, values, strict=False)}
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    for name, (low, high) in pairs.items():
        place = model.joints[model.getJointId(name)].idx_q
        lower[place], upper[place] = low, high
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper


def _pair(name: str, pair: Any) -> tuple[float, float]:
    what = f"base_limits of '{name}' must be two finite numbers, lower and upper"
    values = floats(pair, what, InvalidOption)
    if values.shape != (2,) or not np.isfinite(values).all() or values[0] > values[1]:
        raise InvalidOption(f"{what}, not {np.asarray(pair).tolist()}")
    return float(values[0]), float(values[1])
