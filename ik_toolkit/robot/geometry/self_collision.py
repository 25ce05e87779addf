"""Finds pairs of links that need no collision test by sampling, as MoveIt's Setup Assistant does, and writes them as an SRDF.

For every pair of links with collision shapes it finds out whether they are joined by a joint, and whether they touch in (almost)
every configuration, by construction, or in none. All joints of the model move, not only those on the path to a
tip.
"""

from collections.abc import Callable
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from ...errors import ModelError, whole
from ..joints import Joints
from ..probe import NO_LIMIT
from .convex import owner_above, read_shapes, request

ALWAYS = 0.95  # A pair that touches in at least this share of the samples gets the reason "Always", as in MoveIt.
# A pair that touches with all joints at zero and in at least this share of the samples gets the reason "Default". MoveIt asks only
# for contact at zero, which hides real contacts.
DEFAULT = 0.5
# Two links within 1 cm of each other in a sample may touch in a configuration that was not sampled. MoveIt uses 0.
NEAR = 0.01
SAMPLES = 10_000  # Number of samples, the same as in MoveIt.
REASONS = ("Adjacent", "Always", "Default", "Never")


@dataclass(frozen=True)
class SelfCollision:
    """Result of `self_collision`: which pairs of links need no collision test.

    `reasons` maps a pair that needs no test to one of REASONS, `tested` lists the other pairs. `before` is the share of the samples
    (0 to 1) in which any two links touch that are not joined by a joint and can move relative to each other, `after` the share in
    which any pair in `tested` touches. `samples` and `seed` are those of the call.
    """

    robot: str
    reasons: dict[tuple[str, str], str]
    tested: tuple[tuple[str, str], ...]
    samples: int
    seed: int
    before: float
    after: float

    def counts(self) -> dict[str, int]:
        """Return for each of REASONS the number of pairs that need no test for this reason."""
        given = list(self.reasons.values())
        return {reason: given.count(reason) for reason in REASONS}

    def to_srdf(self) -> str:
        """Return the text of an SRDF in which the pairs that need no collision test are disabled, with their reasons."""
        lines = [
            f"    <disable_collisions link1={quoteattr(a)} link2={quoteattr(b)} reason={quoteattr(reason)}/>"
            for (a, b), reason in self.reasons.items()
        ]
        said = f"{self.samples} random configurations, seed {self.seed}"
        head = f'<?xml version="1.0"?>\n<!-- Pairs of links that need no collision test, from {said}. -->\n'
        return f"{head}<robot name={quoteattr(self.robot)}>\n" + "\n".join(lines) + "\n</robot>\n"


def self_collision(
    robot: Joints, samples: int = SAMPLES, seed: int = 0, progress: Callable[[int], None] = lambda done: None
) -> SelfCollision:
    """Sample random configurations of all joints of a robot's model to find the pairs of links that need no collision test.

    A pair is Adjacent if joined by one joint, Always if it touches in 95 % of the samples, Default if it touches with
    all joints at zero and in half of the samples, Never if no joint moves the two relative to each other or they were
    never nearer than 1 cm. `progress` is called with the number of samples done. Raises ModelError for fewer than two
    links with shapes, InvalidOption for less than one sample.
    """
    samples, seed = whole(samples, "samples"), whole(seed, "seed", 0)
    model, geometry = robot.model, read_shapes(robot)
    owners = [model.frames[shape.parentFrame].name for shape in geometry.geometryObjects]
    links = tuple(dict.fromkeys(owners))
    if len(links) < 2:
        raise ModelError(f"robot '{robot.name}' has fewer than two links with collision shapes: nothing can touch")
    number = np.array([links.index(name) for name in owners])
    shapes = np.array(np.triu_indices(len(owners), 1)).T
    shapes = shapes[number[shapes[:, 0]] != number[shapes[:, 1]]]
    pairs = np.array(np.triu_indices(len(links), 1)).T
    place = np.zeros((len(links), len(links)), dtype=int)
    place[pairs[:, 0], pairs[:, 1]] = place[pairs[:, 1], pairs[:, 0]] = np.arange(len(pairs))
    pair_of = place[number[shapes[:, 0]], number[shapes[:, 1]]]
    joint_of = np.array([geometry.geometryObjects[owners.index(link)].parentJoint for link in links])
    above = {int(j): owner_above(model, int(j), set(joint_of.tolist())) for j in joint_of}
    one, other = joint_of[pairs[:, 0]], joint_of[pairs[:, 1]]
    adjacent = np.array([above[a] == b or above[b] == a for a, b in zip(one.tolist(), other.tolist(), strict=True)])
    probe = _Probe(model, geometry, shapes)
    rng = np.random.default_rng(seed)
    at_zero = pair_of[probe.contacts(np.clip(0.0, probe.lower, probe.upper), np.ones(len(shapes), dtype=bool))[0]]
    zero, near = np.zeros((2, len(pairs)), dtype=bool)
    zero[at_zero] = True
    moving = ~adjacent & (one != other)
    hits = [np.empty(0, dtype=int)]
    for k in range(samples):
        values = probe.lower + (probe.upper - probe.lower) * rng.random(len(probe.lower))
        touching, close = probe.contacts(values, moving[pair_of])
        hits.append(np.unique(pair_of[touching]))
        near[pair_of[close]] = True
        progress(k + 1)
    share = np.bincount(np.concatenate(hits), minlength=len(pairs)) / samples
    share[one == other] = zero[one == other]
    found = [adjacent, share >= ALWAYS, zero & (share >= DEFAULT), ~near]
    reasons = np.select(found, REASONS, "")
    named = [(links[a], links[b]) for a, b in pairs.tolist()]
    return SelfCollision(
        model.name,
        {pair: str(reason) for pair, reason in zip(named, reasons, strict=True) if reason},
        tuple(pair for pair, reason in zip(named, reasons, strict=True) if not reason),
        samples,
        seed,
        sum(len(hit) > 0 for hit in hits) / samples,
        sum(bool((reasons[hit] == "").any()) for hit in hits) / samples,
    )


class _Probe:
    """Tests pairs of shapes (P, 2) of a model for contact at joint values within `lower` and `upper` (m,) of its one-DOF joints."""

    def __init__(self, model: pin.Model, geometry: pin.GeometryModel, shapes: np.ndarray) -> None:
        """Prepare two tests for all pairs: whether they touch, and whether they are nearer than NEAR."""
        self.model, self.geometry, self.shapes = model, geometry, shapes
        geometry.removeAllCollisionPairs()
        for a, b in shapes.tolist():
            geometry.addCollisionPair(pin.CollisionPair(a, b))
        self._data, self._touch, self._near = model.createData(), geometry.createData(), geometry.createData()
        for k in range(len(shapes)):
            self._touch.collisionRequests[k] = request(0.0)
            self._near.collisionRequests[k] = request(NEAR)
        self._middle, self._size = np.empty((len(geometry.geometryObjects), 3)), np.empty(len(geometry.geometryObjects))
        for k, shape in enumerate(geometry.geometryObjects):
            shape.geometry.computeLocalAABB()
            self._middle[k], self._size[k] = np.array(shape.geometry.aabb_center), shape.geometry.aabb_radius
        joints = [joint for joint in model.joints[1:] if joint.nv == 1]
        self._circles = np.array([joint.nq == 2 for joint in joints], dtype=bool)
        self._places = np.array([joint.idx_q for joint in joints], dtype=int)
        free = np.array([1.0 if joint.shortname().startswith("JointModelP") else np.pi for joint in joints])
        limits = (np.asarray(x)[self._places] for x in (model.lowerPositionLimit, model.upperPositionLimit))
        lower, upper = (
            np.where(self._circles | (np.abs(x) > NO_LIMIT), s * free, x) for s, x in zip((-1, 1), limits, strict=True)
        )
        self.lower, self.upper = np.minimum(lower, upper), np.maximum(lower, upper)

    def contacts(self, values: np.ndarray, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices of the pairs that touch and of those nearer than NEAR, at joint values (m,) [rad or m].

        Only pairs for which `asked` (P,) is True are tested.
        """
        full, circles = pin.neutral(self.model), self._circles
        full[self._places] = np.where(circles, np.cos(values), values)
        full[self._places[circles] + 1] = np.sin(values[circles])
        pin.forwardKinematics(self.model, self._data, full)
        for space in (self._touch, self._near):
            pin.updateGeometryPlacements(self.model, self._data, self.geometry, space)
        at = np.array([M.act(middle) for M, middle in zip(self._near.oMg, self._middle, strict=True)])
        a, b = self.shapes.T
        apart = np.linalg.norm(at[a] - at[b], axis=1) - self._size[a] - self._size[b]
        close = [
            k
            for k in np.flatnonzero(asked & (apart < NEAR)).tolist()
            if pin.computeCollision(self.geometry, self._near, k)
        ]
        touching = [k for k in close if pin.computeCollision(self.geometry, self._touch, k)]
        return np.array(touching, dtype=int), np.array(close, dtype=int)
