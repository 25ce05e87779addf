"""Search for base poses: proposals of an inverse reachability map, bases spread over the floor, refinement, final count."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidTarget
from ..robot.geometry.collision import CollisionModel
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.batch.solve_batch import solve_parts
from ..solvers.solve import Solver
from .reachability import require_reaching
from .reachability_grid import memory_allowed


class SearchSizes(NamedTuple):
    """Sizes of the search for base poses, chosen on a benchmark of 800 poses along three edges of a sheet."""

    samples: int = 400_000  # random configurations of which the inverse reachability map is made
    # width of a cell of the inverse reachability map in the height of the tip, as a share of the reach
    height: float = 1 / 40
    # tool directions are sorted into cells by projecting them onto a cube, with `sides` cells along each edge
    sides: int = 9
    # width of a cell of the floor, as a share of the reach; the inverse reachability map counts poses in reach from each cell
    floor: float = 1 / 24
    yaws: int = 36  # number of cells into which the yaw of the base is divided in the inverse reachability map
    voted: int = 300  # number of candidates proposed by the inverse reachability map
    spread: int = 3000  # number of candidate bases spread evenly over the allowed region
    few: int = 32  # number of poses on which the first candidates are examined, before all poses are tried
    rounds: int = 4  # number of rounds of refinement, each with half the width of the last
    keep: int = 10  # number of best bases around which each round of refinement searches
    around: int = 20  # number of new bases around each base that is refined
    last: int = 740  # number of candidates that are examined on all poses
    # number of rounds that refine the best three bases on all poses; the bases they add are among the `last` ones
    final: int = 8
    attempts: int = 4  # number of solver attempts per pose while candidates are examined
    sure: int = 50  # number of solver attempts per pose for the placements that are returned
    followed: int = 3  # number of placements for which a path through ordered poses is computed
    measured: int = 50  # number of configurations of a placement at which the clearance to obstacles is measured


SEARCH = SearchSizes()


def base_poses(bases: np.ndarray) -> np.ndarray:
    """Convert bases (M, 4), given as x, y, yaw, height [m, rad], to poses T_world_base (M, 4, 4)."""
    c, s = np.cos(bases[:, 2]), np.sin(bases[:, 2])
    T = np.zeros((len(bases), 4, 4))
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1], T[:, 2, 2], T[:, 3, 3] = c, -s, s, c, 1.0, 1.0
    T[:, 0, 3], T[:, 1, 3], T[:, 2, 3] = bases[:, 0], bases[:, 1], bases[:, 3]
    return T


def in_base(bases: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Convert world poses W (N, 4, 4), or positions (N, 3), to the frame of each base (M, 4): (M, N, 4, 4) or (M, N, 3)."""
    inverse = np.linalg.inv(base_poses(bases))
    if W.ndim == 2:
        return np.einsum("mij,nj->mni", inverse[:, :3, :3], W) + inverse[:, None, :3, 3]
    return inverse[:, None] @ W[None]


def put_together(counted: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Concatenate bases (M, 4) that were examined in parts, and the shares of poses (M,) reached from them."""
    return np.concatenate([bases for bases, _ in counted]), np.concatenate([share for _, share in counted])


class Candidates:
    """Candidate base poses found so far, and the steps of the search for better ones."""

    def __init__(
        self,
        robot: Robot | Tree,
        W: dict[str, np.ndarray],
        ends: tuple[np.ndarray, np.ndarray],
        scene: CollisionModel | None,
        options: Any,
        progress: Callable[[int], None] | None,
    ) -> None:
        self.robot, self.W, (self.low, self.high) = robot, W, ends
        self.scene, self.options, self.progress = scene, options, progress
        placed = [] if scene is None else scene.placed()
        self.shapes = [(name, T.copy()) for name, _, T in placed]
        self.boxes = np.array([shape.corners() @ T[:3, :3].T + T[:3, 3] for _, shape, T in placed]).reshape(-1, 8, 3)
        self.rng = np.random.default_rng(options["seed"])
        solver = Solver(robot, **options, avoid_collisions=False if scene is None else scene)
        require_reaching(solver.plan.options, "place")
        self.limited, self.moving = solver.robot, np.setdiff1d(np.arange(robot.n), solver.plan.held)
        self.tried: list[tuple[np.ndarray, np.ndarray]] = []
        self.full: list[tuple[np.ndarray, np.ndarray]] = []

    def run(self) -> None:
        """Search for bases from which most poses are reached; `best` returns those found, also after an interruption."""
        S, N = SEARCH, sum(map(len, self.W.values()))
        few, some = ({tip: W[:: max(1, -(-N // k))] for tip, W in self.W.items()} for k in (S.few, 4 * S.few))
        # how far [m, m, rad, m] from a good base the first round of refinement draws new ones: the size of the region, but at most
        # a share of the reach
        width = np.minimum(
            self.high - self.low, np.array([0.15, 0.15, 0.3 / self.robot.reach, 0.15]) * self.robot.reach
        )
        bases = np.concatenate([self.votes(), self.spread(S.spread)])
        bases, _ = self.top(bases, self.count(bases, few, 4 * S.keep), len(bases))
        bases = self.apart(bases, width, 4 * S.keep)
        score = self.count(bases, some, S.keep)
        for k in range(S.rounds):
            bases, score = self.top(bases, score, 4 * S.keep)
            new = self.near(self.apart(bases, width * 0.5**k, S.keep), width * 0.5**k, S.around)
            bases, score = np.concatenate([bases, new]), np.append(score, self.count(new, some, S.keep, score))
        bases, score = self.top(bases, score, S.last - S.final * 3 * S.around)
        self.full.append((bases, self.count(bases, self.W, S.keep)))
        for k in range(S.final):
            start, score = self.top(*put_together(self.full), S.keep)
            new = self.near(start[:3], width * 0.7 ** (k + 6), S.around)
            self.full.append((new, self.count(new, self.W, S.keep, score)))

    def best(self) -> np.ndarray:
        """Return the bases (M, 4) examined so far, best first; once some have been examined on all poses, only those."""
        bases, score = put_together(self.full or self.tried)
        return self.top(bases, score, len(bases))[0]

    @staticmethod
    def apart(bases: np.ndarray, width: np.ndarray, count: int) -> np.ndarray:
        """Choose up to `count` bases (M, 4) that differ from each other by more than width (4,), preferring the first.

        The width is for x, y [m], yaw [rad] and height [m].
        """
        found = bases[:1]
        for base in bases[1:]:
            away = np.abs(base - found)
            away[:, 2] = np.minimum(away[:, 2], np.abs(2.0 * np.pi - away[:, 2]))
            if len(found) < count and (away > width).any(axis=1).all():
                found = np.append(found, base[None], axis=0)
        return found

    @staticmethod
    def top(bases: np.ndarray, score: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the `count` bases with the highest scores, best first, and the scores; equal scores keep their order."""
        order = np.argsort(-score, kind="stable")[:count]
        return bases[order], score[order]

    def near(self, bases: np.ndarray, width: np.ndarray, count: int) -> np.ndarray:
        """Return `count` random bases inside the region around each of `bases` (M, 4), at most width (4,) away."""
        new = np.repeat(bases, count, axis=0) + self.rng.normal(size=(len(bases) * count, 4)) * width
        if self.high[2] - self.low[2] > 2.0 * np.pi - 1e-9:
            new[:, 2] = (new[:, 2] - self.low[2]) % (2.0 * np.pi) + self.low[2]
        return np.clip(new, self.low, self.high)

    def spread(self, count: int) -> np.ndarray:
        """Return bases spread evenly over the region, by the additive recurrence (quasi-random sequence) of Roberts (2018)."""
        g = 1.1673039782614187  # the root of x^5 = x + 1, on which Roberts' sequence is based
        steps = (0.5 + np.outer(np.arange(1, count + 1), g ** -np.arange(1.0, 5.0))) % 1.0
        return self.low + steps * (self.high - self.low)

    def count(self, bases: np.ndarray, W: dict[str, np.ndarray], keep: int, than: Any = ()) -> np.ndarray:
        """Return for each of M bases the share of the poses W that the robot reaches from there.

        With obstacles, each base is first examined without them, because obstacles can only lower its share. If that share already
        rules it out of the best `keep` bases (of those examined so far, and of others whose shares are `than`), it is returned, and
        the base is not examined with obstacles.
        """
        share, best = np.zeros(len(bases)), np.sort(than)[-keep:]
        once = max(1, 2**13 // sum(map(len, W.values())))
        for a in range(0, len(bases), once):
            some = bases[a : a + once]
            reached, q = self.reach(some, W)
            part = reached.mean(axis=1)
            if self.scene is not None:
                look = part > (best[0] if len(best) == keep else 0.0)
                part[look] = self.reach_beside(some[look], W, reached[look], q[look]).mean(axis=1)
                best = np.sort([*best, *part[look]])[-keep:]
            share[a : a + once] = part
            self.tried.append((some, part))
            if self.progress is not None:
                self.progress(sum(len(one) for one, _ in self.tried))
        return share

    def reach(self, bases: np.ndarray, W: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return which of N poses W are reached from m bases without regard to obstacles (m, N), and joint values (m, N, n)."""
        found = [self.solve(tip, in_base(bases, T).reshape(-1, *T.shape[1:]), SEARCH.attempts) for tip, T in W.items()]
        good, q = zip(*found, strict=True)
        return (
            np.concatenate([one.reshape(len(bases), -1) for one in good], axis=1),
            np.concatenate([one.reshape(len(bases), -1, self.robot.n) for one in q], axis=1),
        )

    def reach_beside(
        self, bases: np.ndarray, W: dict[str, np.ndarray], reached: np.ndarray, q: np.ndarray
    ) -> np.ndarray:
        """Return which poses (m, N) are reached from bases (m, 4) without touching an obstacle.

        reached (m, N), q (m, N, n): which are reached at all, and how. Where q is in contact, the pose is solved again from a few
        random starts.
        """
        free, tries, first = np.zeros_like(reached), SEARCH.attempts - 1, 0
        base, pose = np.nonzero(reached)
        free[base, pose] = self.untouched(bases[base], q[base, pose])
        for tip, T in W.items():
            base, pose = (np.repeat(x, tries) for x in np.nonzero((reached & ~free)[:, first : first + len(T)]))
            if len(base):
                starts = q[base, first + pose]
                starts[:, self.moving] = self.limited.random_q(self.rng, len(starts))[:, self.moving]
                good, found = self.solve(tip, in_base(bases, T)[base, pose], 1, q0=starts)
                base, pose = base[good], first + pose[good]
                clear = self.untouched(bases[base], found[good])
                free[base[clear], pose[clear]] = True
            first += len(T)
        return free

    def untouched(self, bases: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return which configurations q (k, n) at bases (k, 4) touch no obstacle; rows of the same base must follow each other."""
        free, at = np.zeros(len(q), bool), None
        for k, base in enumerate(bases):
            if at is None or (base != at).any():
                self.stand(at := base)
            free[k] = not self.scene.collides(q[k])  # pyright: ignore[reportOptionalMemberAccess]
        return free

    def solve(self, tip: str, T: np.ndarray, attempts: int, **more: Any) -> tuple[np.ndarray, np.ndarray]:
        """Solve for targets (m, ...) of a tip in the base frame; return which are reached (m,), and q (m, n)."""
        asked = {"restarts": attempts - 1, "check": 0.0, "finish": False, **self.options, **more}
        parts = list(solve_parts(self.robot, self.robot.for_tips({tip: T}), **asked))
        return np.concatenate([part.success for part in parts]), np.concatenate([part.q for part in parts])

    def solve_beside(self, base: np.ndarray, attempts: int) -> tuple[np.ndarray, np.ndarray]:
        """Solve for all poses from one base (4,), avoiding the obstacles; return which are reached (N,), and q (N, n)."""
        more: dict[str, Any] = {"check": 1.0}
        if self.scene is not None:
            self.stand(base)
            more = {"avoid_collisions": self.scene}
        found = [self.solve(tip, in_base(base[None], T)[0], attempts, **more) for tip, T in self.W.items()]
        return np.concatenate([good for good, _ in found]), np.concatenate([q for _, q in found])

    def stand(self, base: np.ndarray) -> None:
        """Put the obstacles where they are as seen from a base (4,), because collisions are computed in the robot's base frame."""
        back = np.linalg.inv(base_poses(base[None])[0])
        for name, at in self.shapes:
            self.scene.move(name, back @ at)  # pyright: ignore[reportOptionalMemberAccess]

    def votes(self) -> np.ndarray:
        """Propose bases (M, 4) by an inverse reachability map: those from which most poses are in reach. None for positions.

        The map counts, for each cell of the floor and each yaw, the poses that random configurations reach from there.
        """
        S, reach = SEARCH, self.robot.reach
        cell, found, tables = reach * S.floor, [np.empty((0, 4))], []
        for arm in self.robot.arms:
            if arm.tip in self.W and self.W[arm.tip].ndim == 3 and self.options.get("free_turn") is None:
                A = arm.chain.forward(arm.random_q(self.rng, S.samples))[0]
                keys, W = _keys(A, 0.0, reach * S.height), self.W[arm.tip]
                order = np.argsort(keys, kind="stable")
                tables.append((keys[order], np.linalg.inv(A[order]), W[:: max(1, len(W) // 400)]))
        low, sides = self._floor(cell) if tables else (self.low[:2], np.ones(3, int))
        for height in np.unique(np.linspace(self.low[3], self.high[3], 5)) if tables else ():
            votes = np.zeros(sides, np.int32)
            for keys, inverse, W in tables:
                asked = _keys(W, height, reach * S.height)
                first, last = np.searchsorted(keys, asked, "left"), np.searchsorted(keys, asked, "right")
                for T, a, b in zip(W, first, last, strict=True):
                    at = _cells(T @ inverse[a:b], low, cell)
                    at = at[((at >= 0) & (at < sides)).all(axis=1)]
                    votes.ravel()[np.unique(np.ravel_multi_index(tuple(at.T), votes.shape))] += 1
            smooth = votes.astype(float)
            # Each cell gets the counts of its neighbours added. `roll` wraps around, which is right for yaw and harmless in x and
            # y, whose outer cells are empty.
            for axis in range(3):
                smooth = smooth + np.roll(smooth, 1, axis) + np.roll(smooth, -1, axis)
            top = np.argsort(-smooth.ravel(), kind="stable")[: S.voted]
            x, y, turn = np.unravel_index(top[smooth.ravel()[top] > 0.0], votes.shape)
            yaw = (turn + 0.5) / S.yaws * 2.0 * np.pi - np.pi
            at = low[0] + (x + 0.5) * cell, low[1] + (y + 0.5) * cell
            found.append(np.column_stack([*at, yaw, np.full(len(x), height)]))
        return np.clip(np.concatenate(found), self.low, self.high)

    def _floor(self, cell: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the lower corner (2,) [m] and numbers of cells (x, y, yaw) of the part of the region from which poses are reached.

        Raises InvalidTarget if the poses are so far apart that counting votes takes more memory than a study may.
        """
        at = np.concatenate([W[:, :2, 3] for W in self.W.values() if W.ndim == 3])
        near, far = at.min(axis=0) - self.robot.reach, at.max(axis=0) + self.robot.reach
        # Cells without a pose in reach are skipped. Only whole cells are, so that the grid of the others does not shift.
        skipped = np.maximum(np.floor((near - self.low[:2]) / cell), 0.0)
        low = self.low[:2] + skipped * cell
        counts = np.maximum(np.ceil((np.minimum(far, self.high[:2]) - low) / cell), 1.0)
        # bytes: one array of int32 and four of floats with an entry for each cell
        need = 4.5 * 8.0 * SEARCH.yaws * float(counts.prod())
        if need > memory_allowed():
            raise InvalidTarget(
                f"the poses are spread over {' x '.join(f'{x:.4g}' for x in np.ptp(at, axis=0))} m, and the robot reaches "
                f"{self.robot.reach:.3g} m: the search takes {need / 1e9:,.3g} GB, more than half of this machine's memory; were "
                "millimetres meant? Else place the robot for one part of them at a time"
            )
        return low, np.append(counts.astype(int), SEARCH.yaws)


def _cells(B: np.ndarray, low: np.ndarray, cell: float) -> np.ndarray:
    """Return the cells (m, 3) of x, y and yaw of base poses B (m, 4, 4); low: lower corner (2,) of the first cell [m]."""
    turn = np.arctan2(B[:, 1, 0] - B[:, 0, 1], B[:, 0, 0] + B[:, 1, 1])
    yaw = (turn + np.pi) / (2.0 * np.pi) * SEARCH.yaws
    at = np.floor(np.column_stack([(B[:, :2, 3] - low) / cell, yaw])).astype(int)
    at[:, 2] %= SEARCH.yaws
    return at


def _keys(T: np.ndarray, height: float, wide: float) -> np.ndarray:
    """Return cell numbers (N,) of the tip's height and the direction of z in its frame, which a base on the floor cannot change."""
    z, S = T[:, 2, :3], SEARCH.sides
    side = np.abs(z).argmax(axis=1)
    rows = np.arange(len(z))
    top = z[rows, side]
    cells = [np.arctan(z[rows, (side + k) % 3] / np.abs(top)) / (0.5 * np.pi) + 0.5 for k in (1, 2)]
    u, v = (np.minimum((x * S).astype(int), S - 1) for x in cells)
    level = np.floor((T[:, 2, 3] - height) / wide).astype(int)
    return (((level * 6 + side * 2 + (top > 0.0)) * S) + u) * S + v
