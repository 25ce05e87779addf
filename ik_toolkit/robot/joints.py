"""Named joint values with limits: what a robot with one tip and a tree with several have in common."""

import functools
import html
import logging
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Self

import numpy as np
import pinocchio as pin

from ..errors import (
    FEW_TURNS,
    ConfigurationNotFound,
    FrameNotFound,
    InvalidConfiguration,
    InvalidOption,
    doubt_angles,
    floats,
    near_match,
    whole,
)
from ..kernel.records import POINTS
from ..readonly import ReadOnly
from .base import Given
from .formats.srdf import Srdf
from .mobility import mobility_of
from .narrow import narrowed
from .probe import Path
from .ros import read_joint_state

LOG = logging.getLogger("ik_toolkit")
ROWS = {"pose": [*range(6)], "position": [0, 1, 2], "orientation": [3, 4, 5]}  # rows of each tip's Jacobian


class Named(dict[str, np.ndarray]):
    """Configurations q (n,) [rad or m] by name; an unknown name raises ConfigurationNotFound."""

    def __missing__(self, name: str) -> np.ndarray:
        """Raise ConfigurationNotFound."""
        raise ConfigurationNotFound(
            f"the robot has no configuration named '{str(name)[:200]}'.{near_match(name, self)}"
        )


def values_by_joint(locked: Mapping[str, float] | None) -> dict[str, float]:
    """What `locked` holds, as a dict; None holds nothing. Raises InvalidConfiguration."""
    if not isinstance(locked, Mapping | None):
        raise InvalidConfiguration(f"locked takes a dict from joint names to values [rad or m], not {locked!r:.60}")
    return dict(locked or {})


class Joints(ReadOnly):
    """Coordinates q (n,) of a model: names, kinds, limits, home, and their places in the model's full configuration.

    Robots and trees have `arms`, one Robot per tip; `tips`, their names; `places`, index arrays that select each arm's
    coordinates from q; and `memo`, a dict that caches things made for this robot (a bound solver, its collision shapes), each
    under its own key. Copies and pickles start with an empty one. Attributes cannot be assigned (ReadOnlyAttribute), except for
    the name: solvers are made from them.
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
        "on_base": "load it with on_base=",
        "base_limits": "load it with base_limits=",
        "package_dirs": "load it with package_dirs=",
        "": "load the robot again as it should be",
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
    by_tip = False  # whether targets are given by tip, as for a tree, even with a single tip
    _path: Path
    _given: Given | None
    _original: pin.Model | None
    _wide: Any = None  # the robot of which this is a variant with narrower limits

    def _note(self, notes: Iterable[str]) -> None:
        """Keep notes on the description, and log those that are new."""
        new = [note for note in notes if note not in self.notes]
        self.notes = (*self.notes, *new)
        for note in new:
            LOG.warning("%s: %s", self.name, note)

    def _route(self) -> str:
        """Base and tips, for display."""
        raise NotImplementedError

    def jacobian(self, q: Any) -> np.ndarray:
        """Jacobian (6 tips, n) at q (n,), base axes, linear rows of a tip first."""
        raise NotImplementedError

    @property
    def n(self) -> int:
        """Number of coordinates in q."""
        return len(self.joint_names)

    @property
    def reach(self) -> float:
        """Longest distance [m] of a tip from its first joint: path offsets plus finite strokes (1 m where unbounded)."""
        return max(arm.chain.reach for arm in self.arms)

    @property
    def slides(self) -> np.ndarray:
        """Which joints are prismatic (n,)."""
        return np.array([kind == "prismatic" for kind in self.joint_kinds], dtype=bool)

    @property
    def named(self) -> Named:
        """Configurations by name: those of the SRDF that set any joint of q (the others stay at home), and always "home".

        Where several groups of the SRDF use a name, see `Srdf.state`.
        """
        found = Named(home=self.home.copy())
        for name in self.srdf.states:
            given = self.srdf.state(name, self.joint_names, self.tips, self.model)
            if given:
                found[name] = self.home.copy()
                found[name][[self.joint_names.index(joint) for joint in given]] = list(given.values())
        return found

    @functools.cached_property
    def mobility(self) -> Any:
        """What the tip can never do, however the joints stand: a `Mobility`; of a Tree a dict of them by tip."""
        found = {arm.tip: mobility_of(arm) for arm in self.arms}
        return found if self.by_tip else found[self.tips[0]]

    def check_tips(self, names: Iterable[Any]) -> None:
        """Raise FrameNotFound for a name that is not one of the tips."""
        for tip in names:
            if tip not in self.tips:
                raise FrameNotFound(f"'{tip}' is not one of the tips solved for.{near_match(tip, self.tips)}")

    def check_q(self, q: Any, name: str = "q") -> np.ndarray:
        """Return q as a float64 copy (n,); raises InvalidConfiguration if it has the wrong size or is not finite."""
        array = self._values(q, name)
        if not np.abs(array).max(initial=0.0) <= FEW_TURNS:  # also true for NaN
            if not np.isfinite(array).all():
                bad = ", ".join(j for j, x in zip(self.joint_names, array, strict=True) if not np.isfinite(x))
                raise InvalidConfiguration(f"{name} is not finite at joint {bad}")
            meant = (self.lower <= array) & (array <= self.upper) & (self.upper - self.lower < np.inf)
            # A value inside the limits is not a mistake, and often our own.
            values = zip(self.joint_names, self.joint_kinds, np.where(meant, 0.0, array).tolist(), strict=True)
            far = {joint: x for joint, kind, x in values if kind != "prismatic" and abs(x) > FEW_TURNS}
            if far:
                doubt_angles(name, far)
        return array

    def read_q(self, q: Any, name: str = "q") -> tuple[np.ndarray, str]:
        """Joint values in any form as an array (n,), which is not checked, and a notice ('' or what was ignored).

        Args:
            q: numbers (n,); the name of a configuration (see `named`); or values by joint, as a dict or a ROS JointState, of
                which other joints are ignored.
            name: of the argument, for messages.

        Raises:
            InvalidConfiguration: a joint is missing, or these are no numbers.
            ConfigurationNotFound: no configuration has this name.
        """
        notice = ""
        if isinstance(q, str):
            q = self.named[q]
        elif not isinstance(q, np.ndarray | list | tuple):
            by_joint = q if isinstance(q, Mapping) else read_joint_state(q, name)
            if by_joint is not None:
                missing = [joint for joint in self.joint_names if joint not in by_joint]
                others = [str(joint) for joint in by_joint if joint not in self.joint_names]
                if missing:
                    meant = near_match(missing[0], others) if others else ""
                    raise InvalidConfiguration(f"{name} has no value for joint {', '.join(missing)}.{meant}")
                if others:
                    notice = (
                        f"{name}: joint{'s' * (len(others) > 1)} {', '.join(others)} ignored, not of this robot's q"
                    )
                q = [by_joint[joint] for joint in self.joint_names]
        array = floats(q, f"{name} must be {self.n} numbers", InvalidConfiguration)
        if array.shape != (self.n,):
            raise InvalidConfiguration(
                f"{name} must have {self.n} values, one per joint ({', '.join(self.joint_names)}); got shape {array.shape}"
            )
        return array, notice

    def _values(self, q: Any, name: str = "q") -> np.ndarray:
        """As `check_q`, for any numbers."""
        return self.read_q(q, name)[0]

    def locked(self, joints: Mapping[str, float]) -> Self:
        """Return a copy with joints held at values [rad or m] and left out of q.

        A value outside its joint's limits is used as it is, with a warning in the log "ik_toolkit". Raises JointNotFound,
        InvalidConfiguration.
        """
        joints = values_by_joint(joints)
        made = self._locked(joints)
        outside = [
            f"{joint} ({joints[joint]:.4g} {'m' if kind == 'prismatic' else 'rad'}, limits {low:.4g} to {high:.4g})"
            for joint, kind, low, high in zip(self.joint_names, self.joint_kinds, self.lower, self.upper, strict=True)
            if joint in joints and not low <= joints[joint] <= high
        ]
        if outside:
            LOG.warning("locked outside the limits: %s", ", ".join(outside))
        return made

    def _locked(self, joints: Mapping[str, float]) -> Self:
        """The copy of `locked`."""
        raise NotImplementedError

    def narrowed(self, limits: Any) -> Self:
        """Return a variant with narrower limits; the same as `limits=` of a call, which makes and keeps one.

        limits: a dict from joint names to (lower, upper) [rad or m], None for an end that stays, or a pair of arrays (lower,
        upper), each (n,) or None. Home is moved inside. A model of collisions made for the robot serves its variants too.
        Raises InvalidOption (wider than the robot's own, reversed, not a number), JointNotFound.
        """
        return narrowed(self, limits)

    def _narrowed(self, ranges: Mapping[str, tuple[float, float]]) -> Self:
        """The variant of `narrowed` for ranges of all joints."""
        raise NotImplementedError

    def check_home(self, home: Any) -> np.ndarray:
        """Return home as `check_q` does; also raises InvalidConfiguration outside the limits, because searches start there."""
        q = self.check_q(home, "home")
        outside = self.outside(q)
        if outside:
            raise InvalidConfiguration(f"home is outside the limits at joint {', '.join(outside)}")
        return q

    def manipulability(self, q: Any, rows: Any = "pose") -> float:
        """Manipulability sqrt(det(J J^T)) at q (n,): proportional to the volume of the velocity ellipsoid; 0 where singular.

        rows: 'position' [the three linear rows, m per rad or m], 'orientation', 'pose' (all six, in metres and radians), or the
        indices of the rows x, y, z, rx, ry, rz in base axes: (0, 1) for a planar arm. With several tips, the rows of all are
        stacked. With fewer joints than rows it is 0 everywhere. Yoshikawa 1985. Raises InvalidConfiguration, InvalidOption.
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
        """Names of the joints whose value in q (n,) lies outside its limits, or is NaN. Raises InvalidConfiguration."""
        q = self._values(q)
        return [j for j, x, a, b in zip(self.joint_names, q, self.lower, self.upper, strict=True) if not a <= x <= b]

    def at_limits(self, q: Any) -> list[str]:
        """Names of the joints whose value in q (n,) is at a limit (within 1e-9) or beyond. Raises InvalidConfiguration."""
        q = self._values(q)
        near = (q - self.lower <= 1e-9) | (self.upper - q <= 1e-9)
        return [j for j, hit in zip(self.joint_names, near, strict=True) if hit]

    @functools.cached_property
    def _sampling(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower end and span (n,) of random q."""
        n, ends = self.n, np.atleast_2d(self.chain.ends)[0, POINTS:]
        return ends[4 * n : 5 * n] * self.chain.unit, ends[5 * n : 6 * n] * self.chain.unit

    def random_q(self, rng: np.random.Generator, count: int | None = None) -> np.ndarray:
        """Uniform random q (n,), or (count, n), inside the limits (one turn, or one reach, where there are none).

        Raises InvalidOption: rng is no generator, or count no whole number of at least 0.
        """
        low, span = self._sampling
        size = self.n if count is None else (whole(count, "count", 0), self.n)
        if not isinstance(rng, np.random.Generator):
            raise InvalidOption(f"rng must be a numpy.random.Generator (numpy.random.default_rng(0)), not {rng!r:.60}")
        return (low + span * rng.random(size)).clip(self.lower, self.upper)

    def to_pinocchio(self, q: Any, rest: np.ndarray | None = None) -> np.ndarray:
        """Full configuration (nq,) of the model for q (n,); joints off the path keep `rest` (default: the robot's).

        If the given model has a free-flyer, ball or planar joint, the result is in that model's form, with quaternions.
        """
        given = self._given
        full = self.rest.copy() if rest is None else self._full(rest, "rest")
        full = self._fill(full, self.check_q(q))
        return full if given is None else given.form(self.model, full)

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

    def _fill(self, full: np.ndarray, q: np.ndarray) -> np.ndarray:
        idx, circle = self._path.idx_q, self._circles
        full[idx] = q
        if len(circle):
            full[idx[circle]] = np.cos(q[circle])
            full[idx[circle] + 1] = np.sin(q[circle])
        return full

    def from_pinocchio(self, q_full: np.ndarray) -> np.ndarray:
        """Return q (n,) of a full configuration (nq,); continuous joints come back as angles in -pi..pi."""
        full = self._full(q_full, "a full configuration")
        idx, circle = self._path.idx_q, self._path.circle
        q = full[idx].copy()
        q[circle] = np.arctan2(full[idx[circle] + 1], full[idx[circle]])
        return q

    def _repr_html_(self) -> str:
        """Joint table for notebooks."""
        head = "<tr><th>joint</th><th>kind</th><th>lower</th><th>upper</th><th>home</th></tr>"
        rows = "".join(
            f"<tr><td>{html.escape(j)}</td><td>{k}</td><td>{a:.4g}</td><td>{b:.4g}</td><td>{h:.4g}</td></tr>"
            for j, k, a, b, h in zip(self.joint_names, self.joint_kinds, self.lower, self.upper, self.home, strict=True)
        )
        return f"<b>{html.escape(self.name)}</b>: {html.escape(self._route())}<table>{head}{rows}</table>"
