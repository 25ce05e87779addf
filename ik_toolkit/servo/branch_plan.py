"""Joint paths along a whole reference, from where the arm stands: which posture to take when, so that no pose is missed.

A run that goes from sample to sample cannot know that a posture ends at a limit, or before a singular pose, a second later. Here
the postures that the joints can come to are followed from pose to pose. Of those near each other the one is kept whose joints
had the least to do: a dynamic program as in CppFlow (Morgan et al., 2024), with candidates that grow from one start.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .path_reach import References, bound_lm, samples_of, targets_at

# Least number of poses, by attempt: they lie differently to singular ones, and so does the path.
WAYPOINTS = (40, 50, 64)
STEP = 0.1  # [rad, or reaches] largest displacement from pose to pose
TRIED = 4  # displacements of a posture
CELL = 0.03  # [rad, or reaches] in which postures count as one
BEAM = 150  # most postures kept at a pose, for an arm of SEVEN joints
SEVEN = 7
MARGIN = 0.05  # of a joint's range, next to a limit, in which a posture costs more
EDGE = 20.0  # cost of a joint at its limit; one that moves at its speed limit costs 2
HARD = 8  # power of the second cost of speed: nothing at half of the limit, 1 at the limit, forbidding at twice of it
ROUNDS = 3  # times the path is averaged over two stretches; then it is as smooth as a cubic spline
PROBE = 1e-4  # [rad, or reaches] of the difference that tells whether a singular value grows
EXACT = (1e-6, 1e-6)  # [m, rad] of the path: errors of neighbouring samples must not look like accelerations


class Planner:
    """What the search for a path needs: limits (4, n) lower, upper, speed, acceleration [rad or m (per s, s^2)]."""

    def __init__(self, robot: Any, reference: References, limits: np.ndarray, **options: Any) -> None:
        """options: what counts, as for `ik.solve`."""
        self.robot, self.reference, self.limits, self.options = robot, reference, limits, options
        self.unit = robot.chain.unit
        self.solve = bound_lm(
            robot, follow=True, position_tolerance=EXACT[0], orientation_tolerance=EXACT[1], **options
        )
        self.beam = max(BEAM * SEVEN // (robot.n * len(robot.tips)), 1)
        span = limits[1] - limits[0]
        self.margin = np.where(np.isfinite(span), MARGIN * span, 1.0)

    def paths(self, q0: np.ndarray, times: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Joint values (N + 1, n) at times (N + 1,) [s] from q0, and `sides` (N + 1, n) of them; none where a pose is out of reach.

        A path an attempt.
        """
        anywhere = bound_lm(self.robot, **self.options)
        for attempt, count in enumerate(WAYPOINTS):
            t = samples_of(self.robot, self.reference, count)[0]
            targets = targets_at(self.reference, t)
            if attempt == 0 and not all(anywhere(target, q0).success for target in targets):
                return
            found = self._search(q0, t, targets, np.random.default_rng(attempt))
            path = None if found is None else self._rounded(t, found, times)
            if path is not None:
                yield path, self.sides(path)

    def _search(self, q0: np.ndarray, t: np.ndarray, targets: list, rng: Any) -> np.ndarray | None:
        """Cheapest joint values (K, n) at times t (K,) that were found, None when none lead to the end."""
        middle = targets_at(self.reference, 0.5 * (t[1:] + t[:-1]))
        layers = [(q0[None], np.zeros(1, int), np.zeros(1))]
        for k in range(1, len(t)):
            layer = self._next(middle[k - 1], targets[k], t[k] - t[k - 1], layers[-1], rng)
            if layer is None:
                return None
            layers.append(layer)
        at, path = int(np.argmin(layers[-1][2])), []
        for postures, before, _ in reversed(layers):
            path.append(postures[at])
            at = before[at]
        return np.array(path[::-1])

    def _next(self, middle: Any, target: Any, dt: float, layer: tuple, rng: Any) -> tuple | None:
        """Postures at the next pose, which ones they come from, and what each has cost so far; None when there are none.

        How far a joint moves is measured by halves: across a singular pose one can seem near that is on its other side.
        """
        lower, upper, speed = self.limits[:3]
        far = np.where(np.isfinite(speed), speed * dt, self.unit)
        aside = np.minimum(far, STEP * self.unit)
        found, before, moved = [], [], []
        for k, q in enumerate(layer[0]):
            straight = self.solve(target, q)
            if not straight.success:
                continue
            starts = straight.q + rng.choice((-1.0, 1.0), (TRIED, len(q))) * aside
            tried = [self.solve(target, start) for start in np.clip(starts, lower, upper)]
            for one in [straight, *(one for one in tried if one.success)]:
                half = self.solve(middle, 0.5 * (q + one.q))
                if half.success:
                    found.append(one.q)
                    before.append(k)
                    moved.append(2.0 * np.maximum(np.abs(half.q - q), np.abs(one.q - half.q)))
        if not found:
            return None
        Q, came, share = np.array(found), np.array(before), np.array(moved) / far
        near = np.maximum(1.0 - np.minimum(Q - lower, upper - Q) / self.margin, 0.0)
        cost = layer[2][came] + (share**2 + share**HARD + EDGE * near**2).sum(axis=1)
        order = np.argsort(cost, kind="stable")
        _, first = np.unique(np.rint(Q[order] / (CELL * self.unit)), axis=0, return_index=True)
        kept = order[np.sort(first)[: self.beam]]
        return Q[kept], came[kept], cost[kept]

    def _rounded(self, t: np.ndarray, found: np.ndarray, times: np.ndarray) -> np.ndarray | None:
        """The path at every sample, without the corners that it has at its poses."""
        path = np.stack([np.interp(times, t, one) for one in found.T], axis=1)
        width = max(round(len(times) / len(t)), 1)
        for _ in range(ROUNDS):
            longer = np.pad(path, ((width, width), (0, 0)), mode="reflect", reflect_type="odd")
            total = np.concatenate([np.zeros((1, path.shape[1])), np.cumsum(longer, axis=0)])
            path = (total[2 * width + 1 :] - total[: -2 * width - 1]) / (2 * width + 1)
        for k, target in enumerate(targets_at(self.reference, times)):
            one = self.solve(target, path[k])
            if not one.success:
                return None
            path[k] = one.q
        return path

    def sides(self, path: np.ndarray) -> np.ndarray:
        """Direction (N + 1, n) of the joints away from the nearest singular pose: the gradient of the least singular value."""
        J = self._jacobians(path)
        U, sigma, V = np.linalg.svd(J)
        least = sigma.shape[1] - 1
        # J changes along v; the change of u'J is that of sigma = u'J v along each joint.
        change = self._jacobians(path + PROBE * V[:, least] * self.unit) - J
        slope = np.einsum("km,kmn->kn", U[:, :, least], change)
        return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), np.finfo(float).tiny)

    def _jacobians(self, path: np.ndarray) -> np.ndarray:
        """Jacobians (N + 1, m, n) of what counts at all, lengths in reaches."""
        one_each = self.reference
        every = [one_each[tip] for tip in self.robot.tips] if isinstance(one_each, Mapping) else [one_each]
        rows = []
        for arm, place, one in zip(self.robot.arms, self.robot.places, every, strict=True):
            J = np.zeros((len(path), 6, path.shape[1]))
            J[:, :, place] = arm.chain.forward(np.ascontiguousarray(path[:, place]), jacobian=True)[1]
            J[:, :3] /= self.robot.chain.scale
            rows.append(J[:, : 3 if one.position_only else 6])
        return np.concatenate(rows, axis=1) * self.unit
