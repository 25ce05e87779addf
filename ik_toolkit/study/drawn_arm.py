"""Kinematics of an arm with errors: poses, and their derivatives with respect to errors of its joints, links, base and tool.

The nominal arm ("as drawn") has the frame of joint j at P_j exp(q_j S_j) in its parent's frame. An error replaces P_j by P_j C_j,
with C_j = (exp(w), t) in the joint's own frame, so it can be written into the <origin> of a URDF. The derivatives are the blocks of
Pinocchio's kinematic regressor (computeFrameKinematicRegressor). They are formed here, from Pinocchio's placements, because
Pinocchio 4.1 does not compute it for models with mimic joints. A joint's offset is the part of the error along its own axis.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import InvalidOption, near_match
from ..robot.robot import Robot
from ..robot.rotation import turn_onto

GROUPS = ("joints", "frames", "tool", "base")
WIDE = {
    "tool": 10.0,
    "base": 200.0,
}  # expected errors of tool and base (standard deviation of the prior), as multiples of those of a link


class Unknown(NamedTuple):
    """One unknown of a calibration: its name, its group, and whether it is an angle [rad] or a length [m]."""

    name: str
    group: str
    turns: bool


class _Place(NamedTuple):
    """A frame with an error: indices of its unknowns in x, its joint (0: tip, -1: base), its axes of translation and rotation."""

    columns: np.ndarray
    joint: int
    shift: np.ndarray
    turn: np.ndarray


class DrawnArm:
    """A robot whose joint, link, tool and base frames deviate from its nominal model by unknown errors x (P,), to be calibrated.

    Attributes:
        robot: The nominal robot.
        unknowns: The unknown errors, in the order of x. Groups are joints (offsets), frames, tool and base.
        sign: Factor (n,) of 1 or -1 of the joint values.
    """

    def __init__(self, robot: Robot, groups: Sequence[str], sign: np.ndarray | None = None) -> None:
        """Copy the model; groups: which errors are unknowns (joints, frames, tool, base); without `sign` no joint is reversed."""
        self.robot, self.groups, self.sign = robot, tuple(groups), np.ones(robot.n) if sign is None else sign
        self.model = pin.Model(robot.model)
        base_id, tip_id = robot._ids
        tip = self.model.frames[tip_id]
        self._tip_place = tip.placement * robot.tool
        self._tip = self.model.addFrame(
            pin.Frame("measured tip", tip.parentJoint, tip.placement, pin.FrameType.OP_FRAME)
        )
        self._base = base_id
        # joints between the root of the model and the base of the arm; the way from base to tip goes up through them
        self._up = set(robot._path.joints[: robot._path.up])
        self._drawn = [placement.copy() for placement in self.model.jointPlacements]
        self._data = self.model.createData()
        unknowns: list[Unknown] = []
        parts = ("x", "y", "z", "rx", "ry", "rz")
        self._places: list[_Place] = []
        for joint in movable(robot):
            shift, turn, along = _axes(robot.model, joint)
            names = [f"{robot.model.names[joint]}.{'offset' if k == along else part}" for k, part in enumerate(parts)]
            of = ["joints" if k == along else "frames" for k in range(6)]
            self._add(unknowns, names, of, joint, shift, turn)
        for name, joint in (("tool", 0), ("base", -1)):
            self._add(unknowns, [f"{name}.{part}" for part in parts], [name] * 6, joint, np.eye(3), np.eye(3))
        self.unknowns = tuple(unknowns)

    def _add(
        self, unknowns: list[Unknown], names: list[str], of: list[str], joint: int, shift: np.ndarray, turn: np.ndarray
    ) -> None:
        kept = [k for k in range(6) if of[k] in self.groups]
        columns = np.full(6, -1)
        columns[kept] = len(unknowns) + np.arange(len(kept))
        unknowns += [Unknown(names[k], of[k], k > 2) for k in kept]
        if kept:
            self._places.append(_Place(columns, joint, shift, turn))

    def scales(self, length: float, angle: float) -> np.ndarray:
        """Return the expected size (P,) of each unknown: `length` [m] or `angle` [rad], times WIDE for tool and base."""
        return np.array([(angle if one.turns else length) * WIDE.get(one.group, 1.0) for one in self.unknowns])

    def corrections(self, x: np.ndarray) -> dict[int, pin.SE3]:
        """Return the errors x (P,) as transforms of the frames they belong to, by the joint's number; 0 is the tip, -1 the base."""
        return {place.joint: _motion(place, x)[0] for place in self._places}

    def poses(self, x: np.ndarray, Q: np.ndarray) -> np.ndarray:
        """Return the poses (N, 4, 4) [m] of the tip, in the frame of the measurements, at Q (N, n) [rad or m]."""
        return self.evaluate(x, Q)[0]

    def evaluate(self, x: np.ndarray, Q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses (N, 4, 4) of the tip at Q (N, n) for errors x (P,), and their derivatives (N, 6, P) by x.

        The derivatives are twists of the tip in tip axes, linear rows first.
        """
        model, data, robot = self.model, self._data, self.robot
        base, tool = pin.SE3.Identity(), pin.SE3.Identity()
        joints, blocks = [place for place in self._places if place.joint > 0], {}
        for place in self._places:
            C, blocks[place.joint] = _motion(place, x)
            if place.joint > 0:
                model.jointPlacements[place.joint] = self._drawn[place.joint] * C
            elif place.joint == 0:
                tool = C
            else:
                base = C
        model.frames[self._tip].placement = self._tip_place * tool
        before, ends = np.empty((len(joints), len(Q), 4, 4)), np.empty((2, len(Q), 4, 4))
        for k, q in enumerate(Q * self.sign):
            pin.forwardKinematics(model, data, robot._filled(q))
            ends[0, k] = pin.updateFramePlacement(model, data, self._tip).homogeneous
            ends[1, k] = pin.updateFramePlacement(model, data, self._base).homogeneous
            for i, place in enumerate(joints):
                before[i, k] = data.oMi[model.parents[place.joint]].homogeneous
        back, to_base = np.linalg.inv(ends)
        T = base.homogeneous @ to_base @ ends[0]
        J = np.zeros((len(Q), 6, len(self.unknowns)))
        seen = {
            place.joint: back @ before[i] @ model.jointPlacements[place.joint].homogeneous
            for i, place in enumerate(joints)
        }
        seen |= {0: np.tile(np.eye(4), (len(Q), 1, 1)), -1: back @ ends[1]}
        for place in self._places:
            G, D, kept = seen[place.joint], blocks[place.joint], place.columns >= 0
            turned = G[:, :3, :3] @ D[3:, kept]
            moved = G[:, :3, :3] @ D[:3, kept] + np.cross(G[:, :3, 3][:, :, None], turned, axis=1)
            sign = -1.0 if place.joint in self._up else 1.0
            J[:, :3, place.columns[kept]], J[:, 3:, place.columns[kept]] = sign * moved, sign * turned
        return T, J


def read_groups(parameters: Any) -> tuple[str, ...]:
    """Return the groups of unknowns asked for, in the order of GROUPS. Raises InvalidOption."""
    given = [parameters] if isinstance(parameters, str) else parameters
    if not isinstance(given, list | tuple | set) or not given:
        raise InvalidOption(f"parameters are a list of any of {', '.join(GROUPS)}, not {parameters!r:.60}")
    for one in given:
        if one not in GROUPS:
            raise InvalidOption(f"parameters are any of {', '.join(GROUPS)}, not {one!r:.60}.{near_match(one, GROUPS)}")
    return tuple(group for group in GROUPS if group in given)


def movable(robot: Robot) -> list[int]:
    """Return the joints between base and tip that can move and are in the robot's description, without those of a moving base."""
    given = {name for block in (robot._given.blocks if robot._given is not None else ()) for name in block.names}
    own = [j for j in robot._path.joints if j in robot._path.owner]
    return [j for j in own if robot.model.names[j] not in (*robot._of_base, *given)]


def _axes(model: pin.Model, joint: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Return axes (3, 3) of the translations and rotations of a joint's error, and the index of its offset among the six.

    The axes are those of the joint's frame. If none of them is the joint's axis, they are rotated so that the third one is. An
    offset has the joint's sign.
    """
    S = np.asarray(model.joints[joint].createData().S).reshape(6)
    turns = bool(np.abs(S[3:]).max() > np.abs(S[:3]).max())
    axis = S[3:] if turns else S[:3]
    axis = axis / np.linalg.norm(axis)
    k = int(np.abs(axis).argmax())
    shift, turn = np.eye(3), np.eye(3)
    if abs(axis[k]) < 1.0 - 1e-12:
        k, shift = 2, turn_onto(np.eye(3)[2], axis)
        turn = shift.copy()
    along = (turn if turns else shift)[:, k]
    along *= np.sign(along @ axis)
    return shift, turn, k + 3 * turns


def _motion(place: _Place, x: np.ndarray) -> tuple[pin.SE3, np.ndarray]:
    """Return the error transform C of a frame at x, and its derivative (6, 6) by six unknowns: velocities in the moved frame."""
    u = np.where(place.columns >= 0, x[place.columns] if len(x) else 0.0, 0.0)
    w = place.turn @ u[3:]
    C = pin.SE3(pin.exp3(w), place.shift @ u[:3])
    D = np.zeros((6, 6))
    D[:3, :3] = C.rotation.T @ place.shift
    D[3:, 3:] = pin.Jexp3(w) @ place.turn
    return C, D
