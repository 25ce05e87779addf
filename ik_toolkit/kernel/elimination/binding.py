"""Choose the orderings of a robot's loop for the elimination, by trying all twelve of them on random poses.

The loop equation can be reversed or not, and begun at any of six joints. An ordering is good if its remaining unknown q3 tells the
solutions apart. With a spherical wrist, for example, joints 1 to 3 have the same values in the two solutions of the wrist, so the
unknown must be another joint. This is not decided by geometry but by solving for the same poses with each ordering, and counting
how many solutions it finds and certifies. An arm whose geometry splits into subproblems is decomposed first.
"""

from typing import NamedTuple

import numpy as np

from .answer import solve_loops
from .decomposition import nearest_point, splits_of
from .terms import DOUBT, SIZES, VERDICT, Form


class OrderingChoice(NamedTuple):
    """Constants for choosing the orderings of an arm's loop equation, set after tries on 60 arms with 33 kinds of structure."""

    poses: int = 12  # number of random poses that are solved to compare the orderings
    kept: int = 4  # highest number of orderings that are kept
    share: float = 0.6  # an ordering is kept if it finds the most solutions at this share of the poses
    # Fourier coefficients of the determinant below this share of the largest are taken for rounding; true ones of 1e-10 occur.
    tone: float = 1e-12
    seed: int = 0


CHOICE = OrderingChoice()


class OrderingResult(NamedTuple):
    """An ordering of an arm's loop equation, and how well it has solved for random poses.

    The loop is reversed or not, and begun at one of six joints.
    """

    row: np.ndarray  # (SIZES.whole,) the ordering, as `answer.solve_loops` takes it
    real: np.ndarray  # (N,) number of real solutions at each pose
    certain: int  # number of poses at which the list of solutions is certified
    pairs: bool  # whether two solutions of a pose had the same q3, the angle of joint 3, which should tell them apart
    radius: float  # median over the poses of the radius of the largest error disc around a root


def make_arm(axes: np.ndarray, points: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Return the geometry of an arm of six revolute joints as one array (52,), see `answer.solve_loops`.

    axes, points: (6, 3) directions and points [m] of the joints at q = 0; T (4, 4): the tip's pose there. The arm's centre is the
    point nearest to all axes, its size the largest distance of an axis from there.
    """
    centre = nearest_point(np.hstack([axes, points]))
    near = points + axes * ((centre - points) * axes).sum(axis=1, keepdims=True) - centre
    size = max(float(np.linalg.norm(near, axis=1).max()), 1e-9)
    tip = (T[:3, 3] - centre) / size
    return np.concatenate([np.hstack([axes, near / size]).ravel(), T[:3, :3].ravel(), tip, centre, [size]])


def arm_tip(arm: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the tip's pose (4, 4) [m] of an arm at q (6,) [rad], by the product of exponentials.

    arm: (52,) geometry, see `answer.solve_loops`.
    """
    R, p = np.eye(3), np.zeros(3)
    for (x, y, z, *point), angle in zip(arm[:36].reshape(6, 6), q, strict=True):
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
        p = p + R @ (point - turn @ point)
        R = R @ turn
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R @ arm[36:45].reshape(3, 3), arm[48:51] + arm[51] * (p + R @ arm[45:48])
    return T


def answers(forms: np.ndarray, arm: np.ndarray, T: np.ndarray, within: float = 0.0) -> np.ndarray:
    """Return the joint solutions of target poses T (N, 4, 4) [m] as an array (N, SIZES.rows, SIZES.columns).

    The layout of the array, and the arguments forms, arm and within, are described at `answer.solve_loops`.
    """
    found = np.zeros((len(T), SIZES.rows, SIZES.columns))
    solve_loops(forms, arm, T, found, np.empty((0, SIZES.samples)), within)
    return found


def make_forms(arm: np.ndarray) -> np.ndarray:
    """Return the orderings of the loop equation (F, SIZES.whole) that suit an arm, best first; none if no ordering works.

    They are compared by solving for the same random poses with each. arm: (52,) geometry, see `answer.solve_loops`.
    """
    rng = np.random.default_rng(CHOICE.seed)
    Q = rng.uniform(-np.pi, np.pi, (CHOICE.poses, 6))
    T = np.array([arm_tip(arm, q) for q in Q])
    mix = np.linalg.qr(rng.normal(size=(14, 14)))[0][:6].ravel()
    split = next((row for row in splits_of(arm) if _sure(row, arm, Q, T) >= CHOICE.share * CHOICE.poses), None)
    first = np.empty((0, SIZES.whole)) if split is None else split[None]
    tried = [reading for k in range(12) if (reading := _try(arm, T, mix, k // 6, k % 6)) is not None]
    if not tried:
        return first
    most = np.max([reading.real for reading in tried], axis=0)

    def rank(one: OrderingResult) -> tuple:
        """Return the key by which tried orderings are sorted, so that the best comes first.

        The best finds all solutions, tells them apart by the angle of joint 3, certifies its lists and has small error discs.
        """
        accuracy = round(np.log10(min(one.radius, 1e9) + 1e-16)) + one.row[Form._fields.index("degree")] / 8.0
        return -(one.real == most).sum(), one.pairs, -one.certain, accuracy

    tried.sort(key=rank)
    good = [one.row for one in tried if (one.real == most).sum() >= CHOICE.share * CHOICE.poses]
    return np.vstack([first, (good or [tried[0].row])[: CHOICE.kept]])


def _sure(split: np.ndarray, arm: np.ndarray, Q: np.ndarray, T: np.ndarray) -> int:
    """Return at how many poses T (N, 4, 4), those of the configurations Q (N, 6), a decomposition certifies its list of solutions.

    Returns 0 if a certified list lacks the configuration in Q. This happens if the arm has a self-motion at every pose, as with two
    axes on one line.
    """
    found = answers(split[None], arm, T)
    count, verdict = found[:, :1, 0], found[:, 0, 1]
    apart = np.abs((found[:, 1:, :6] - Q[:, None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2)
    apart[np.arange(apart.shape[1]) >= count] = np.inf
    certain = verdict == VERDICT.certain
    return int(certain.sum()) if (apart.min(axis=1)[certain] < DOUBT.apart).all() else 0


def _try(arm: np.ndarray, T: np.ndarray, mix: np.ndarray, backwards: int, shift: int) -> OrderingResult | None:
    """Return an ordering with its results at the poses T, or None if its determinant vanishes or has too high a degree."""
    plain = _row(Form(backwards, shift, 0, SIZES.degree, 0.0), mix)
    found, values = np.zeros((len(T), SIZES.rows, SIZES.columns)), np.empty((len(T), SIZES.samples))
    solve_loops(plain[None], arm, T, found, values, 0.0)
    tones = np.abs(np.fft.rfft(values))[:, : SIZES.degree + 3]
    present = np.flatnonzero((tones > CHOICE.tone * tones.max(axis=1, keepdims=True)).any(axis=0))
    degree = int(present.max(initial=0))
    if not 0 < degree <= SIZES.degree:
        return None
    row = _row(Form(backwards, shift, found[:, 0, 3].max(), degree, np.median(np.abs(values).max(axis=1))), mix)
    notes = answers(row[None], arm, T)
    kept = [np.sort(one[1 : 1 + int(one[0, 0]), 7]) for one in notes]
    return OrderingResult(
        row, notes[:, 0, 0], int((notes[:, 0, 1] == VERDICT.certain).sum()), any((np.diff(roots) == 0.0).any() for roots in kept),
        float(np.median(notes[:, 0, 5])),
    )  # fmt: skip


def _row(form: Form, mix: np.ndarray) -> np.ndarray:
    """Return an ordering and its tables as one row (SIZES.whole,)."""
    count = 2 * int(form.degree) + 5
    turns, tables = 2 * np.pi * np.arange(count) / count, np.zeros((2, SIZES.samples))
    tables[:, :count] = np.cos(turns), np.sin(turns)
    return np.concatenate([form, np.zeros(SIZES.form - len(form)), tables.ravel(), mix])
