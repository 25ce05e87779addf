"""Named joint values with limits: what a robot with one tip and a tree with several have in common."""

import functools
import logging
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Self

import numpy as np
import pinocchio as pin

from ..copying import ReadOnly
from ..errors import (
    FEW_TURNS,
    FrameNotFound,
    InvalidConfiguration,
    InvalidOption,
    doubt_angles,
    floats,
    near_match,
    whole,
)
from ..kernel.records import POINTS
from ..text import TextTable
from .base import GivenModel
from .configuration import Named, configuration_in, joint_values, leaders_of, read_configuration, values_by_joint
from .formats.mimic import Tie
from .formats.srdf import Srdf
from .mobility import mobility_of
from .narrow import narrowed
from .probe import JointPath
from .ros import is_by_name

LOG = logging.getLogger("ik_toolkit")
# For each word that the argument `rows` of a method takes, the rows of a tip's (6, n) Jacobian.
ROWS = {"pose": [*range(6)], "position": [0, 1, 2], "orientation": [3, 4, 5]}


class Joints(ReadOnly):
    """Base class of Robot and Tree: the joint coordinates q (n,) of a Pinocchio model, with limits, home and named configurations.

    Attributes cannot be assigned (ReadOnlyAttribute), except for the name, because solvers are made from them.

    Attributes:
        name: Name of the robot.
        model: The pin.Model, in which mimic joints follow their leaders.
        joint_names: Names of the joints of q (n,), one for each moving joint of the paths from base to tip.
        joint_kinds: 'revolute', 'continuous' or 'prismatic' for each joint.
        lower, upper: Limits (n,) [rad or m], infinite for joints without limits.
        home: Configuration (n,) [rad or m] at which searches start.
        velocity_limits: Limits (n,) [rad/s or m/s].
        rest: Values (nq,) of the joints off the path.
        tips: Names of the tips.
        arms: A Robot for each tip.
        places: For each arm (tip), the indices in q of its joints.
        srdf: Contents of the SRDF.
        collision_model, visual_model: The shapes given with a Pinocchio model, or None.
        notes: Sentences on parts of the description that were changed or left out.
        chain: Geometry of the joints as arrays, for the compiled code.
        memo: Cache of things made for this robot, by key; copies and pickles start with an empty one.
    """

    _LOOSE = ("name",)
    _INSTEAD: ClassVar[Mapping[str, str]] = {
        "lower": "narrow limits with limits= of a call, or robot.narrowed({joint: (lower, upper)})",
        "upper": "narrow limits with limits= of a call, or robot.narrowed({joint: (lower, upper)})",
        "limits": "narrow limits with limits= of a call, or robot.narrowed({joint: (lower, upper)})",
        "velocity_limits": "give other speed limits to tracker.change_limits(speed=) or retime(velocity=)",
        "home": "give q0= to a call, or home= to ik.Robot",
        "rest": "hold joints elsewhere with robot.locked({joint: value})",
        "locked_joints": "hold joints with robot.locked({joint: value})",
        "tool": "use robot.with_tool(T_tip_tool)",
        "tool_shapes": "use robot.with_tool(T_tip_tool, shape)",
        "tip": "load it with tip=",
        "tips": "load it with tips=",
        "base": "load it with base=",
        "srdf": "load it with srdf=",
        "visual_model": "give it to ik.Robot",
        "collision_model": "give it to ik.Robot",
        "on_base": "load it with on_base=",
        "base_limits": "load it with base_limits=",
        "package_dirs": "load it with package_dirs=",
        "": "load the robot again with the settings you want",
    }

    name: str
    model: pin.Model
    joint_names: tuple[str, ...]
    joint_kinds: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    home: np.ndarray
    velocity_limits: np.ndarray
    rest: np.ndarray
    chain: Any
    tips: tuple[str, ...]
    arms: tuple[Any, ...]
    places: tuple[np.ndarray, ...]
    memo: dict[Any, Any]
    notes: tuple[str, ...]
    srdf: Srdf
    collision_model: pin.GeometryModel | None = None
    visual_model: pin.GeometryModel | None = None
    by_tip = False  # True if targets are given by tip, as for a tree, even with a single tip.
    _path: JointPath
    _given: GivenModel | None
    _original: pin.Model | None
    _wide: Any = None  # For a variant with narrower limits, the robot from which it was made.

    def _note(self, notes: Iterable[str]) -> None:
        """Store notes on the description, and log those that are new."""
        new = [note for note in notes if note not in self.notes]
        self.notes = (*self.notes, *new)
        for note in new:
            LOG.warning("%s: %s", self.name, note)

    def _route(self) -> str:
        """Return the names of base and tips, for display."""
        raise NotImplementedError

    def jacobian(self, q: Any) -> np.ndarray:
        """Compute the Jacobian (6 F, n) of F tips at q (n,) in base axes: by tip three linear rows [m], three angular [rad]."""
        raise NotImplementedError

    @property
    def n(self) -> int:
        """Number of coordinates in q."""
        return len(self.joint_names)

    @property
    def reach(self) -> float:
        """Upper bound [m] of the distance of a tip from its first joint; the true reach may be much smaller.

        It is the sum of the offsets along the path and of the strokes of prismatic joints (1 m where unbounded), and sets the
        internal unit of length. `ik.workspace` estimates the true reach by sampling.
        """
        return max(arm.chain.reach for arm in self.arms)

    @property
    def slides(self) -> np.ndarray:
        """For each joint (n,) whether it is prismatic."""
        return np.array([kind == "prismatic" for kind in self.joint_kinds], dtype=bool)

    @property
    def named(self) -> Named:
        """Configurations by name: those of the SRDF that set any joint of q (the others stay at home), and always "home".

        If several groups of the SRDF use a name, `Srdf.state` says which counts.
        """
        found = {"home": self.home.copy()}
        for name in self.srdf.states:
            given = self.srdf.state(name, self.joint_names, self.tips, self.model)
            if given:
                found[name] = self.home.copy()
                found[name][[self.joint_names.index(joint) for joint in given]] = list(given.values())
        return Named(found)

    @property
    def named_tips(self) -> tuple[str, ...]:
        """Names of the tips for a Tree, whose targets are given by tip; () for a Robot, which has a single tip."""
        return ()

    @property
    def pose_shape(self) -> tuple[int, ...]:
        """Shape of the array with the poses of all tips in compiled code: (4, 4) for one tip, (F, 4, 4) for F tips."""
        return (4, 4) if len(self.tips) == 1 else (len(self.tips), 4, 4)

    def each_tip(self, given: Any) -> dict[str, Any]:
        """Return targets or poses as a dict by tip; for a Robot a single one, not in a dict, is its tip's. Raises FrameNotFound."""
        if named := is_by_name(given):
            self.check_tips(given)
        return given if named or self.by_tip else {self.tips[0]: given}

    def for_tips(self, each: Mapping[str, Any]) -> Any:
        """Return a dict of results by tip in the form for users: for a Robot the value of its only tip, for a Tree the dict."""
        return each if self.by_tip else each[self.tips[0]]

    def tip_poses(self, q: np.ndarray) -> list[pin.SE3]:
        """Compute T_base_tip (pin.SE3) of each tip at a valid q (n,), in the order of `tips`, by Pinocchio."""
        return [arm._fk(q[place]) for arm, place in zip(self.arms, self.places, strict=True)]

    @functools.cached_property
    def mobility(self) -> Any:
        """A Mobility: which positions and rotations the tip can have in any configuration at all; for a Tree a dict by tip."""
        return self.for_tips({arm.tip: mobility_of(arm) for arm in self.arms})

    def check_tips(self, names: Iterable[Any]) -> None:
        """Raise FrameNotFound for a name that is not one of the tips."""
        fields = ("position", "orientation") if isinstance(names, Mapping) and len(self.tips) == 1 else ()
        for tip in (name for name in names if not (isinstance(name, str) and name in self.tips)):
            raise FrameNotFound(f"'{tip}' is not one of the tips solved for.{near_match(tip, (*self.tips, *fields))}")

    def check_q(self, q: Any, name: str = "q") -> np.ndarray:
        """Return q as a float64 copy (n,); raises InvalidConfiguration if it has the wrong size or is not finite."""
        array = self.read_q(q, name)[0]
        if not np.abs(array).max(initial=0.0) <= FEW_TURNS:  # NaN fails this comparison too.
            if not np.isfinite(array).all():
                bad = ", ".join(j for j, x in zip(self.joint_names, array, strict=True) if not np.isfinite(x))
                raise InvalidConfiguration(f"{name} is not finite at joint {bad}")
            meant = (self.lower <= array) & (array <= self.upper) & (self.upper - self.lower < np.inf)
            # A large angle is probably in degrees, unless the limits allow it.
            values = zip(self.joint_names, self.joint_kinds, np.where(meant, 0.0, array).tolist(), strict=True)
            far = {joint: x for joint, kind, x in values if kind != "prismatic" and abs(x) > FEW_TURNS}
            if far:
                doubt_angles(name, far)
        return array

    def read_q(self, q: Any, name: str = "q") -> tuple[np.ndarray, str]:
        """Return joint values in any accepted form as an array (n,), not checked, and a sentence on ignored joints, or ''."""
        return read_configuration(self, q, name)

    def locked(self, joints: Mapping[str, float]) -> Self:
        """Return a copy with joints held at values and left out of q.

        A value outside its joint's limits is used as it is, with a warning in the log "ik_toolkit".

        Args:
            joints: Values [rad or m] by joint name.

        Returns:
            A robot with fewer coordinates.

        Raises:
            JointNotFound: A joint does not exist or does not move.
            InvalidConfiguration: A value is not a finite number.
        """
        joints = values_by_joint(joints)
        made = self._locked(joints)
        if outside := [
            f"{joint} ({joints[joint]:.4g} {'m' if kind == 'prismatic' else 'rad'}, limits {low:.4g} to {high:.4g})"
            for joint, kind, low, high in zip(self.joint_names, self.joint_kinds, self.lower, self.upper, strict=True)
            if joint in joints and not low <= joints[joint] <= high
        ]:
            LOG.warning("locked outside the limits: %s", ", ".join(outside))
        return made

    def _locked(self, joints: Mapping[str, float]) -> Self:
        """Make the copy that `locked` returns."""
        raise NotImplementedError

    def narrowed(self, limits: Any) -> Self:
        """Return a variant of the robot with narrower limits, the same one that the option `limits=` of a call uses.

        A collision model made for the robot serves its variants too.

        Args:
            limits: A dict from joint names to (lower, upper) [rad or m], None for an end that stays, or a pair of
                arrays (lower, upper), each (n,) or None.

        Returns:
            The variant, whose home is moved inside the limits.

        Raises:
            InvalidOption: A limit is wider than the robot's own, reversed, or no number.
            JointNotFound: A joint does not exist.
        """
        return narrowed(self, limits)

    def _narrowed(self, ranges: Mapping[str, tuple[float, float]]) -> Self:
        """Make the variant that `narrowed` returns, for ranges of all joints."""
        raise NotImplementedError

    def check_home(self, home: Any) -> np.ndarray:
        """Return a home configuration as a float64 copy (n,); InvalidConfiguration if it does not fit or is outside the limits."""
        q = self.check_q(home, "home")
        if outside := self.outside(q):
            raise InvalidConfiguration(f"home is outside the limits at joint {', '.join(outside)}")
        return q

    def manipulability(self, q: Any, rows: Any = "pose") -> float:
        """Compute the manipulability sqrt(det(J J^T)) (Yoshikawa 1985), proportional to the volume of the velocity ellipsoid.

        It is 0 at a singular q, and everywhere if there are fewer joints than rows.

        Args:
            q: Configuration (n,) [rad or m].
            rows: Rows of the Jacobian in base axes: 'position' (the three linear ones, m per rad or m), 'orientation',
                'pose' (all six, in metres and radians), or indices of x, y, z, rx, ry, rz: (0, 1) for a planar arm. The
                rows of several tips are stacked.

        Returns:
            The manipulability, in the units of the rows.

        Raises:
            InvalidConfiguration: q does not fit the robot.
            InvalidOption: `rows` names no rows.
        """
        try:
            picked = ROWS[rows] if isinstance(rows, str) else [int(range(6)[i]) for i in rows]
            if not picked or len({*picked}) < len(picked):
                raise ValueError
        except (KeyError, IndexError, TypeError, ValueError):
            names = ", ".join(f"'{name}'" for name in ROWS)
            close = near_match(rows, ROWS) if isinstance(rows, str) else ""
            raise InvalidOption(
                f"rows must be {names} or different numbers from 0 to 5, not {str(rows)[:100]!r}.{close}"
            ) from None
        J = self.jacobian(q).reshape(-1, 6, self.n)[:, picked].reshape(-1, self.n)
        return float(np.prod(np.linalg.svd(J, compute_uv=False))) if len(J) <= self.n else 0.0

    def outside(self, q: Any) -> list[str]:
        """Return the names of joints whose value in q (n,) is outside its limits, or NaN. Raises InvalidConfiguration."""
        q = self.read_q(q)[0]
        return [j for j, x, a, b in zip(self.joint_names, q, self.lower, self.upper, strict=True) if not a <= x <= b]

    def at_limits(self, q: Any) -> list[str]:
        """Return the names of joints whose value in q (n,) is at a limit (within 1e-9) or beyond. Raises InvalidConfiguration."""
        q = self.read_q(q)[0]
        near = (q - self.lower <= 1e-9) | (self.upper - q <= 1e-9)
        return [j for j, hit in zip(self.joint_names, near, strict=True) if hit]

    @functools.cached_property
    def _sampling(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower end and span (n,) [rad or m] of random q."""
        n, ends = self.n, np.atleast_2d(self.chain.ends)[0, POINTS:]
        return ends[4 * n : 5 * n] * self.chain.unit, ends[5 * n : 6 * n] * self.chain.unit

    def random_q(self, rng: np.random.Generator, count: int | None = None) -> np.ndarray:
        """Draw uniform random q inside the limits (one turn, or one reach, where there are none).

        Args:
            rng: Generator of random numbers.
            count: Number of rows, or None for a single q.

        Returns:
            q (n,), or (count, n) [rad or m].

        Raises:
            InvalidOption: rng is not a generator, or count is not a whole number of at least 0.
        """
        low, span = self._sampling
        size = self.n if count is None else (whole(count, "count", 0), self.n)
        if not isinstance(rng, np.random.Generator):
            raise InvalidOption(f"rng must be a numpy.random.Generator (numpy.random.default_rng(0)), not {rng!r:.60}")
        return (low + span * rng.random(size)).clip(self.lower, self.upper)

    @property
    def mimic_joints(self) -> dict[str, Tie]:
        """Mimic joints that follow a joint of q, by name, each with its leader, ratio, and offset [rad or m]."""
        return {joint: tie for joint, tie in leaders_of(self.model) if tie.leader in self.joint_names}

    def joint_values(self, q: Any) -> dict[str, float]:
        """Return the values [rad or m] of all joints at q (n,) by name, also those of mimic joints and of joints off the path."""
        return joint_values(self, self.check_q(q))

    def to_pinocchio(self, q: Any, rest: np.ndarray | None = None, *, model: pin.Model | None = None) -> np.ndarray:
        """Return the Pinocchio configuration (nq,) of the model that the robot was made from, or of `model`, for q (n,) [rad or m].

        Joints off the path get their values from `rest` (nq,), by default those of the robot. `model` may have further joints,
        which stay neutral, joints with several degrees of freedom, and mimic joints as independent ones. Raises JointNotFound.
        """
        if model is not None:
            return configuration_in(model, self, self.check_q(q), rest)
        full = self._filled(self.check_q(q), None if rest is None else self._full(rest, "rest"))
        return full if self._given is None else self._given.form(self.model, full)

    def _full(self, values: Any, what: str) -> np.ndarray:
        """Convert a configuration of the given model to `model`. Raises InvalidConfiguration."""
        given = self._given
        full = floats(values, f"{what} must be numbers", InvalidConfiguration)
        nq = self.model.nq if given is None else given.model.nq
        if full.shape != (nq,):
            raise InvalidConfiguration(f"{what} must have {nq} values for this model, not shape {full.shape}")
        return full if given is None else given.back(self.model, full)

    @functools.cached_property
    def _circles(self) -> np.ndarray:
        """Indices in q of the joints that Pinocchio stores as cosine and sine."""
        return np.flatnonzero(self._path.circle)

    def _filled(self, q: np.ndarray, rest: np.ndarray | None = None) -> np.ndarray:
        """Return the configuration (nq,) of `model` at q (n,), with its other joints as in `rest` (nq,), by default the robot's."""
        full, idx, circle = (self.rest if rest is None else rest).copy(), self._path.idx_q, self._circles
        full[idx] = q
        if len(circle):
            full[idx[circle]] = np.cos(q[circle])
            full[idx[circle] + 1] = np.sin(q[circle])
        return full

    def from_pinocchio(*_: Any) -> Any:
        """Raise AttributeError, whose text says that this method is now called `q_from_pinocchio`."""
        raise AttributeError("from_pinocchio is now q_from_pinocchio(q_full); ik.Robot(model) wraps a pin.Model")

    def q_from_pinocchio(self, q_full: np.ndarray) -> np.ndarray:
        """Return q (n,) [rad or m] for a Pinocchio configuration (nq,); the angle of a continuous joint is in -pi..pi."""
        full = self._full(q_full, "a full configuration")
        idx, circle = self._path.idx_q, self._path.circle
        q = full[idx].copy()
        q[circle] = np.arctan2(full[idx[circle] + 1], full[idx[circle]])
        return q

    def _repr_html_(self) -> str:
        """Return a table of the joints for notebooks."""
        head, route = ("joint", "kind", "lower", "upper", "home"), self._route()
        rows = zip(self.joint_names, self.joint_kinds, self.lower, self.upper, self.home, strict=True)
        ties = [f"{joint} follows {tie.leader}" for joint, tie in self.mimic_joints.items()]
        return TextTable(self.name, route, head, rows, *ties, most=100).html()
