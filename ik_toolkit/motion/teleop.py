"""Teleoperation: the motion of a hand controller becomes the motion of a target, for a `Tracker`."""

import math
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InvalidOption, InvalidTarget, floats
from ..robot.pose import as_array, check_target
from ..validate import number, positive, switch

ROTATION = "R_base_controller must be a rotation matrix (3, 3)"


class Teleop:
    """Turns the poses of a hand controller into targets: clutch, scale, dead band and bounded speed.

    While the clutch is engaged, the target repeats the controller's motion since it was engaged, along the robot's base axes and
    scaled. Otherwise the target stays where it is, so that the hand can be brought back: nothing jumps when the clutch is engaged
    again.

    Args:
        T_base_tip: The pose (4, 4) or pin.SE3 at which the target starts, usually `robot.fk(q)`.
        scale: Metres of the target per metre of the controller.
        rotation_scale: Angle of the target per angle of the controller; 0 keeps the orientation.
        R_base_controller: Rotation (3, 3) from the controller's world to the robot's base.
        dead_band: Distance [m] and angle [rad], since the clutch was engaged, within which the target stays still.
        speed: Largest speed of the target [m/s].
        turn: Largest angular speed of the target [rad/s].

    Attributes:
        T_base_tip: (4, 4) The present target.
        engaged: Whether the target followed the hand in the last update.

    Raises:
        InvalidTarget: T_base_tip is not a pose.
        InvalidOption: Another argument is out of range, or R_base_controller is not a rotation.
    """

    def __init__(
        self,
        T_base_tip: Any,
        *,
        scale: float = 1.0,
        rotation_scale: float = 1.0,
        R_base_controller: Any = None,
        dead_band: tuple[float, float] = (0.0, 0.0),
        speed: float = 0.25,
        turn: float = 1.0,
    ) -> None:
        """Start with the target at T_base_tip, the clutch not engaged."""
        self.T_base_tip = _pose(T_base_tip)
        self.scale, self.rotation_scale = number(scale, "scale"), number(rotation_scale, "rotation_scale")
        R = np.eye(3) if R_base_controller is None else floats(R_base_controller, ROTATION, InvalidOption)
        if R.shape != (3, 3) or not np.abs(R.T @ R - np.eye(3)).max() < 1e-6 or np.linalg.det(R) < 0:
            raise InvalidOption(ROTATION)
        self.R_base_controller = R
        band = floats(dead_band, "dead_band must be a distance and an angle", InvalidOption)
        if band.shape != (2,) or not (np.isfinite(band) & (band >= 0.0)).all():
            raise InvalidOption(f"dead_band must be a distance and an angle of at least 0, not {dead_band!r:.60}")
        self.dead_band: tuple[float, float] = (float(band[0]), float(band[1]))
        self.speed, self.turn = positive(speed, "speed [m/s]"), positive(turn, "turn [rad/s]")
        self.engaged = False
        self._released = True  # whether the clutch has been released since the target was last set
        self._anchor: tuple[np.ndarray, np.ndarray] | None = None
        # rotation vector of the controller's motion since the clutch was engaged, which may be longer than pi
        self._turned = np.zeros(3)

    def update(self, T_controller: Any, engaged: bool, dt: float) -> np.ndarray:
        """Return the target (4, 4) after dt seconds.

        Args:
            T_controller: Pose (4, 4) or pin.SE3 of the controller in its own world [m].
            engaged: Whether the clutch is held.
            dt: Time since the last update [s].

        While the pose has numbers that are not finite, as from a device that lost its tracking, the target stays where it is. When
        the hand is seen again, the target follows its motion from there, without a jump.

        Raises:
            InvalidTarget: T_controller is not a pose; the target has not moved.
            InvalidOption: dt is not above 0, or `engaged` is not True or False.
        """
        # A release of the clutch takes effect even if the device sends an invalid pose with it.
        if not switch(engaged, "engaged"):
            self._anchor, self._released, self.engaged = None, True, False
        raw, dt = floats(as_array(T_controller), "a pose (4, 4) is needed", InvalidTarget), positive(dt, "dt [s]")
        hand = _pose(raw) if np.isfinite(raw).all() else None
        if hand is None:
            self._anchor = None
        elif engaged and self._anchor is None and self._released:
            self._anchor, self._turned = (hand, self.T_base_tip.copy()), np.zeros(3)
        if hand is not None and self._anchor is not None:
            self._approach(self._wanted(hand), dt)
        self.engaged = self._anchor is not None
        return self.T_base_tip.copy()

    def _wanted(self, hand: np.ndarray) -> np.ndarray:
        """Return where the target would be for a pose of the controller if its speed were not bounded."""
        from_hand, from_tip = self._anchor  # type: ignore[misc]
        R = self.R_base_controller
        moved = R @ (hand[:3, 3] - from_hand[:3, 3])
        self._turned = _nearest(pin.log3(hand[:3, :3] @ from_hand[:3, :3].T), self._turned)
        turned = R @ self._turned
        wanted = from_tip.copy()
        wanted[:3, 3] += self.scale * _beyond(moved, self.dead_band[0])
        wanted[:3, :3] = pin.exp3(self.rotation_scale * _beyond(turned, self.dead_band[1])) @ from_tip[:3, :3]
        return wanted

    def _approach(self, wanted: np.ndarray, dt: float) -> None:
        """Move the target towards the pose `wanted`, no faster than allowed."""
        T = self.T_base_tip = self.T_base_tip.copy()
        T[:3, 3] += _shortened(wanted[:3, 3] - T[:3, 3], self.speed * dt)
        T[:3, :3] = pin.exp3(_shortened(pin.log3(wanted[:3, :3] @ T[:3, :3].T), self.turn * dt)) @ T[:3, :3]

    def rebase(self, T_base_tip: Any) -> None:
        """Set the target to another pose, such as `robot.fk(step.q)` after a stop.

        Before the controller moves the target again, the clutch must be released and engaged.
        """
        self.T_base_tip = _pose(T_base_tip)
        self._anchor, self._released, self.engaged = None, False, False


def _pose(T: Any) -> np.ndarray:
    """Return a pose as a new (4, 4) array. Raises InvalidTarget."""
    made, _ = check_target(T)
    if made.ndim != 2:
        raise InvalidTarget("a pose (4, 4) is needed, not a position")
    return np.array(made)


def _nearest(v: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the rotation vector of the same rotation as v that is nearest to `before`; its angle may exceed pi."""
    size = math.sqrt(float(v @ v))
    if size == 0.0:
        turns, axis = np.rint(np.linalg.norm(before) / (2.0 * math.pi)), before
        return axis * (2.0 * math.pi * turns / np.linalg.norm(axis)) if turns else v
    return v * (1.0 + 2.0 * math.pi * np.rint((before @ v / size - size) / (2.0 * math.pi)) / size)


def _shortened(v: np.ndarray, most: float) -> np.ndarray:
    """Return a vector shortened to a length of at most `most`."""
    size = math.sqrt(float(v @ v))
    return v * (most / size) if size > most else v


def _beyond(v: np.ndarray, band: float) -> np.ndarray:
    """Return the part of a vector by which it is longer than `band`."""
    size = math.sqrt(float(v @ v))
    return v * (1.0 - band / size) if size > band else v * 0.0
