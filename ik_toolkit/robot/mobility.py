"""Motions that an arm cannot make in any configuration: rotations and translations of its tip."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..text import angle as in_words
from ..text import figure, how_many, length

SAMPLES = 24  # A motion that is possible at none of this many random configurations counts as impossible.
# A singular value below this share of the largest counts as 0, because joint axes in files have five or six digits.
ROUNDING = 1e-5
DOUBTLESS = 1e-3  # A target is called impossible only if it is off by more than this [rad, or share of the reach].
NAMES = "xyz"


@dataclass(frozen=True, eq=False)
class Mobility:
    """Which motions a tip can make at all, found from its Jacobians and poses at random configurations.

    Attributes:
        joints: moving joints on the way to the tip.
        directions: rank of the Jacobian of the tip at a random configuration, 0 to 6.
        turns: dimension of the rotations of the tip: 3 any, 1 about one fixed axis, 0 none.
        moves: dimension of the positions of the tip: 3 any, 2 a plane, 1 a line, 0 a point.
        axis: if turns is 1, the fixed axis (3,) of all rotations in base axes, else None; tip_axis: the same in tip axes.
        normals: unit vectors (3 - moves, 3) in base axes along which the position of the tip never changes, and heights
            (3 - moves,) [m]: the constant coordinates of the position along them.
        rotation: the rotation (3, 3) of the tip if it never changes, else None.
        reach: Upper bound [m] of the arm's reach.
    """

    joints: int
    directions: int
    turns: int
    moves: int
    axis: np.ndarray | None
    tip_axis: np.ndarray | None
    normals: np.ndarray
    heights: np.ndarray
    rotation: np.ndarray | None
    reach: float

    def never(
        self, T: np.ndarray, tolerances: tuple[float, float], free: Any = None, of_base: bool = False
    ) -> list[str]:
        """Return sentences, if any, on why no configuration brings the tip to a target: a pose T (4, 4) or position (3,) [m].

        Tolerances are in [m] and [rad]. `free` is the axis (3,) about which the target leaves the rotation free, or None; it is in
        tip axes, or in base axes if `of_base`.
        """
        position, angle = (
            max(given, DOUBTLESS * size) for given, size in zip(tolerances, (self.reach, 1.0), strict=True)
        )
        found = []
        point = T if T.ndim == 1 else T[:3, 3]
        for normal, height in zip(self.normals, self.heights, strict=True):
            off = float(normal @ point) - height
            if abs(off) > position:
                found.append(
                    f"the tip never moves along {named(normal)} of the base, and the target is {length(abs(off))} off"
                )
        if T.ndim == 1:
            return found
        if free is not None:
            free = np.asarray(free) / np.linalg.norm(free)
            return [*found, *self._never_stands(T[:3, :3], free, of_base, angle)]
        if self.rotation is not None:
            off = np.arccos(np.clip((np.trace(self.rotation.T @ T[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
            if off > angle:
                found.append(f"the tip never turns, and the target is turned by {in_words(float(off))}")
        elif self.axis is not None and self.tip_axis is not None:
            off = np.arccos(np.clip(self.axis @ T[:3, :3] @ self.tip_axis, -1.0, 1.0))
            if off > angle:
                opposite = "the opposite way, " if np.degrees(off) > 179.0 else ""
                found.append(
                    f"the tip's {named(self.tip_axis)} axis always points along {named(self.axis)} of the base, and the target's "
                    f"points {opposite}{in_words(float(off))} from it"
                )
        return found

    def _never_stands(self, R: np.ndarray, free: np.ndarray, of_base: bool, tolerance: float) -> list[str]:
        """Return a sentence if some tip axis never has the angle to a base axis that a target's rotation R (3, 3) demands.

        free: axis (3,) about which the rotation is free, of the tip or (of_base) of the base; the arm fixes the other one.
        """
        if self.rotation is not None and not of_base:
            tip, base, cosine = free, self.rotation @ free, 1.0
        elif self.axis is None or self.tip_axis is None:
            return []
        elif of_base:
            tip, base, cosine = self.tip_axis, free, self.axis @ free
        else:
            tip, base, cosine = free, self.axis, self.tip_axis @ free
        stands, asked = (float(np.arccos(np.clip(x, -1.0, 1.0))) for x in (cosine, base @ R @ tip))
        if abs(stands - asked) <= tolerance:
            return []
        always, wanted = in_words(stands), in_words(asked)
        return [
            f"the tip's {named(tip)} axis always stands at {always} to {named(base)} of the base, and the target's at {wanted}"
        ]

    def __str__(self) -> str:
        """Describe the mobility in one sentence."""
        text = f"{how_many(self.joints, 'joint')}, {self.directions} of 6 directions at once"
        if self.axis is not None and self.tip_axis is not None:
            text += f"; the tip's {named(self.tip_axis)} axis always points along {named(self.axis)} of the base"
        elif self.rotation is not None:
            text += "; the tip never turns"
        if len(self.normals):
            axes = f"never moves along {' and '.join(named(normal) for normal in self.normals)} of the base"
            text += f"; it {axes if len(self.normals) < 3 else 'stays in one place'}"
        return text


def named(axis: np.ndarray) -> str:
    """Return a unit vector (3,) as text: 'x', '-z' and the like for a coordinate axis, else its three numbers."""
    k = int(np.abs(axis).argmax())
    if abs(abs(axis[k]) - 1.0) < 1e-6:
        return ("-" if axis[k] < 0.0 else "") + NAMES[k]
    return "(" + ", ".join(figure(x) for x in axis + 0.0) + ")"


def mobility_of(arm: Any) -> Mobility:
    """Return the Mobility (motions that the tip can make at all) of a Robot, from Jacobians and poses at random configurations."""
    rng = np.random.default_rng(0)
    jacobians, poses = [], []
    for q in arm.random_q(rng, SAMPLES):
        J = arm.jacobian(q)
        jacobians.append(J)
        poses.append(arm.fk(q).homogeneous)
    every, T = np.hstack(jacobians), np.array(poses)
    scale = np.array([arm.reach] * 3 + [1.0] * 3)[:, None]
    directions = max(_rank(J / scale) for J in jacobians)
    axes, sizes, _ = np.linalg.svd(every[3:])
    turns = int((sizes > ROUNDING * np.sqrt(every.shape[1])).sum())
    middle = T[:, :3, 3].mean(axis=0)
    ways, spread, _ = np.linalg.svd((T[:, :3, 3] - middle).T)
    moves = int((spread > ROUNDING * arm.reach).sum())
    axis = axes[:, 0] * np.sign(axes[np.abs(axes[:, 0]).argmax(), 0]) if turns == 1 else None
    tip_axis = None
    if axis is not None:
        tip_axis = T[0, :3, :3].T @ axis
        # An axis and its opposite mean the same, so the sign is chosen that makes its largest component in tip axes positive.
        if tip_axis[np.abs(tip_axis).argmax()] < 0.0:
            axis, tip_axis = -axis, -tip_axis
    normals = ways[:, moves:].T
    normals = normals * np.sign(normals[np.arange(len(normals)), np.abs(normals).argmax(axis=1)])[:, None]
    return Mobility(
        joints=arm.n, directions=directions, turns=turns, moves=moves, axis=axis, tip_axis=tip_axis, normals=normals,
        heights=normals @ middle, rotation=T[0, :3, :3] if turns == 0 else None, reach=arm.reach,
    )  # fmt: skip


def _rank(J: np.ndarray) -> int:
    sizes = np.linalg.svd(J, compute_uv=False)
    return int((sizes > ROUNDING * sizes[0]).sum()) if sizes.size and sizes[0] > 0.0 else 0
