"""Pinocchio model -> kernel chain. Nothing here reads joint types by name: every joint is evaluated and its screw read.

So revolute, prismatic, continuous, unaligned and mimic joints need no special code, and a joint that moves along anything
but one fixed screw is refused by name.
"""

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..errors import ModelError
from ..kernel.chain import ROW, Chain, pack


class Path(NamedTuple):
    """The joints between base and tip, and where their coordinates live in Pinocchio's configuration."""

    joints: list[int]  # joint ids, base to tip
    leaders: list[int]  # joint id per coordinate, in order of first use
    owner: dict[int, int]  # joint id -> coordinate
    idx_q: np.ndarray  # (n,)
    circle: np.ndarray  # (n,) stored as (cos, sin)


def find_path(model: pin.Model, base: int, tip: int, locked: set[int]) -> Path:
    """Joints from the base frame to the tip frame (frame ids) that are not locked."""
    above = set()
    j = model.frames[base].parentJoint
    while j:
        above.add(j)
        j = model.parents[j]
    joints = []
    j = model.frames[tip].parentJoint
    while j and j not in above:
        joints.insert(0, j)
        j = model.parents[j]
    lead = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    leaders: list[int] = []
    owner = {}
    for j in joints:
        leader = lead.get(j, j)
        if leader in locked:
            continue
        if model.joints[leader].nv != 1:
            raise ModelError(
                f"joint '{model.names[j]}' on the path to '{model.frames[tip].name}' is a {model.joints[j].shortname()} "
                "with more than one degree of freedom; only revolute, continuous, prismatic and mimic joints are handled"
            )
        if leader not in leaders:
            leaders.append(leader)
        owner[j] = leaders.index(leader)
    if not leaders:
        raise ModelError(
            f"no moving joint between base '{model.frames[base].name}' and tip '{model.frames[tip].name}': nothing to solve"
        )
    idx_q = np.array([model.joints[j].idx_q for j in leaders])
    circle = np.array([model.joints[j].nq == 2 for j in leaders])
    return Path(joints, leaders, owner, idx_q, circle)


def _evaluate(model: pin.Model, rest: np.ndarray, path: Path, value: float) -> pin.Data:
    data, q = model.createData(), rest.copy()
    for i, circle in zip(path.idx_q, path.circle, strict=True):
        q[i : i + 1 + int(circle)] = (math.cos(value), math.sin(value)) if circle else value
    pin.forwardKinematics(model, data, q)
    return data


def _split(R: np.ndarray) -> tuple[float, float, float]:
    """Angles a, b, c of R = Rz(a) Rx(b) Rz(c)."""
    s = math.hypot(R[0, 2], R[1, 2])
    b = math.atan2(s, R[2, 2])
    if s > 1e-12:
        return math.atan2(R[0, 2], -R[1, 2]), b, math.atan2(R[2, 0], R[2, 1])
    if R[2, 2] > 0.0:
        return 0.0, 0.0, math.atan2(-R[0, 1], R[0, 0])
    return 0.0, math.pi, math.atan2(-R[0, 1], R[0, 0])


def _turn(axis: int, angle: float) -> np.ndarray:
    return pin.AngleAxis(angle, np.eye(3)[axis]).matrix()


def probe(
    model: pin.Model,
    path: Path,
    rest: np.ndarray,
    base: int,
    tip: int,
    tool: pin.SE3,
    lower: np.ndarray,
    upper: np.ndarray,
    home: np.ndarray,
) -> Chain:
    """Build the chain of `path`; joints off it and locked ones keep their values in `rest` (nq,).

    base, tip: frame ids; tool: pose of the working point in the tip frame; lower, upper, home (n,) [rad or m].
    """
    data0, data1 = _evaluate(model, rest, path, 0.0), _evaluate(model, rest, path, 0.5)
    pin.updateFramePlacements(model, data0)
    first = model.parents[path.joints[0]]
    before = data0.oMf[base].actInv(data0.oMi[first])  # pose of the last common joint in the base frame
    rows = []
    places = []
    for j in path.joints:
        if j not in path.owner:  # locked: a constant
            before = before * data0.liMi[j]
            continue
        m0, m1 = (pin.log6(model.jointPlacements[j].actInv(d.liMi[j])).vector for d in (data0, data1))
        screw = (m1 - m0) / 0.5
        turns = bool(np.linalg.norm(screw[3:]) > 1e-9)
        if turns and np.linalg.norm(screw[:3]) > 1e-9:
            raise ModelError(
                f"joint '{model.names[j]}' moves along a helix; only turning or sliding joints are handled"
            )
        vector = screw[3:] if turns else screw[:3]
        ratio = float(np.linalg.norm(vector))
        if ratio < 1e-9:
            raise ModelError(f"joint '{model.names[j]}' does not move: its axis or its mimic multiplier is zero")
        axis = vector / ratio
        offset = float((m0[3:] if turns else m0[:3]) @ axis)
        z = pin.SE3(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix(), np.zeros(3))
        places.append(before * model.jointPlacements[j] * z)
        before = z.inverse()
        row = np.zeros(ROW)
        row[4:8] = (ratio, offset, 0.0, 0.0) if turns else (0.0, 0.0, ratio, offset)
        row[8], row[9] = path.owner[j], turns
        if rows:
            a, b, c = _split(places[-1].rotation)
            rows[-1][5] += a
            row[5] += c
            t = _turn(0, b).T @ _turn(2, a).T @ places[-1].translation
            row[:4] = math.cos(b), math.sin(b), t[0], t[1]
            row[7] += t[2]
        rows.append(row)
    end = before * model.frames[tip].placement * tool

    def flat(M: pin.SE3) -> np.ndarray:
        return np.concatenate([M.rotation.ravel(), M.translation])

    return pack(np.array(rows), flat(places[0]), flat(end), lower, upper, home)
