"""The least-squares fit of an arm's errors to measurements, by SciPy's `least_squares` with derivatives from `DrawnArm`.

Every unknown has a weak normal prior with mean 0 (the nominal value, "as drawn") and the standard deviation that `DrawnArm.scales`
gives. Combinations of unknowns that the data do not determine ("untold") are found from the singular values of the Jacobian, in
units of prior and noise (Hollerbach, Wampler 1996). A direction is untold if a move along it by one standard deviation of the prior
changes all residuals together by less than UNTOLD standard deviations of the noise. Such combinations keep their nominal value.
"""

from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import MissingExtra
from ..robot.rotation import nearest_rotation
from .drawn_arm import WIDE, DrawnArm
from .measurements import LEAST, NOISE, Measurements

# A combination of errors with a singular value below UNTOLD counts as not determined: the data narrow what was assumed beforehand
# (the prior) by less than a tenth.
UNTOLD = 0.5
# A measurement is an outlier if its error exceeds 4 standard deviations of the noise and 3 times the median of all errors.
OUTLIER = (4.0, 3.0)
# [m, rad] noise assumed while joint signs are searched for, when only offsets, base and tool are fitted and link errors are not
LOOSE = (0.05, 0.1)
# Limits of the search for joints with a wrong sign. Median squared error, in units of LOOSE: below the first nothing is searched
# for, above the second all combinations of signs are tried. Third: largest number of joints for which they are.
SIGNS = (0.01, 4.0, 7)


class ArmFit:
    """A least-squares fit of an arm's errors to measurements, in progress.

    Attributes:
        arm, measured, Q: The arm, a copy of the measurements for this fit, and the joint values (N, n).
        scales: Expected size (P,) of the unknowns x [m or rad]: the standard deviation of their prior.
        noise: Standard deviations [m, rad] of the measurements.
        kept: Which measurements (N,) count; the others are outliers.
        free: Which unknowns (P,) are fitted; the others are fixed at 0, the nominal arm.
        x, z: The unknowns of the arm, and of the touched sockets, planes or fixed ends.
        first: The x and z with which the fit begins.
    """

    def __init__(
        self, arm: DrawnArm, measured: Measurements, Q: np.ndarray, scales: np.ndarray, noise: Any = None
    ) -> None:
        """Begin at the nominal arm, with all measurements; if noise is None, it is estimated."""
        try:
            from scipy.optimize import least_squares
        except ImportError:
            raise MissingExtra("scipy", "tune") from None
        self._solve: Any = least_squares
        self.arm, self.Q, self.scales = arm, Q, scales
        self.given = noise is not None
        self.noise = tuple(NOISE if noise is None else noise)
        self.kept = np.ones(len(Q), dtype=bool)
        self.free = np.ones(len(scales), dtype=bool)
        self.x = first_guess(arm, measured, Q)
        self.measured, self.z = measured.begun(arm.poses(self.x, Q))
        self.first = self.x, self.z
        self.converged = True

    @property
    def used(self) -> np.ndarray:
        """Which unknowns (P + Z,) are fitted: the free ones of the arm, and all of the touched objects."""
        return np.append(self.free, np.ones(len(self.z), dtype=bool))

    # -------------------------------------------------------------------------------------------------------- one fit
    def weighted(self, x: np.ndarray, z: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals (m,) that least squares minimises, divided by their noise, and their Jacobian (m, P + Z).

        They belong to the measurements `rows` and to known positions of sockets. The Jacobian is with respect to the unknowns of
        the arm in units of their expected size, and to z in metres.
        """
        taken = self.measured.taken(rows)
        T, J = self.arm.evaluate(x, self.Q[rows])
        E, D, Z = taken.errors(T, z)
        sigma = taken.sigma(self.noise)
        A = np.concatenate([D @ J * self.scales, Z], axis=2) / sigma[:, None]
        known, slope = taken.known(z)
        part = np.hstack([np.zeros((len(known), len(x))), slope]) / self.noise[0]
        return np.append(E / sigma, known / self.noise[0]), np.vstack([A.reshape(-1, A.shape[2]), part])

    def run(self, rows: np.ndarray, robust: bool = False, most: int = 100) -> tuple[np.ndarray, np.ndarray]:
        """Fit the unknowns x and z to some measurements, from their present values, in at most `most` evaluations."""
        P, free, used = len(self.x), self.free, self.used
        start = np.append(self.x, self.z)
        prior = np.eye(int(free.sum()), int(used.sum()))
        last: dict[bytes, Any] = {}

        def unknowns(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            every = start.copy()
            every[used] = v
            every[:P] *= np.where(free, self.scales, 1.0)
            return every[:P], every[P:]

        def at(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            if v.tobytes() not in last:
                e, A = self.weighted(*unknowns(v), rows)
                last.clear()
                last[v.tobytes()] = np.append(e, v[: len(prior)]), np.vstack([A[:, used], prior])
            return last[v.tobytes()]

        # loss function for SciPy: soft_l1 for the measurements, so that outliers count less; quadratic for the prior
        def soft(squares: np.ndarray) -> np.ndarray:
            grown = np.sqrt(1.0 + squares)
            rho = np.array([2.0 * (grown - 1.0), 1.0 / grown, -0.5 / grown**3])
            rho[:, -len(prior) :] = squares[-len(prior) :], np.ones(len(prior)), np.zeros(len(prior))
            return rho

        first = start.copy()
        first[:P][free] /= self.scales[free]
        how = {"loss": soft if robust else "linear", "x_scale": "jac", "max_nfev": most}
        made = self._solve(lambda v: at(v)[0], first[used], lambda v: at(v)[1], **how)
        self.converged = bool(made.status > 0)
        return unknowns(made.x)

    def errors(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the residuals (N, per) [m, rad] of all measurements for unknowns x and z; each measurement gives `per` numbers."""
        return self.measured.errors(self.arm.poses(x, self.Q), z)[0]

    def typical(self) -> float:
        """Return the median of the measurements' errors for the present fit, in units of the default noise NOISE."""
        return float(np.sqrt(np.median(((self.errors(self.x, self.z) / self.measured.sigma(NOISE)) ** 2).sum(1))))

    # ------------------------------------------------------------------------------------------------- noise, outliers
    def settle(self) -> None:
        """Fit robustly, estimate the noise, detect outliers and fit again without them, until nothing changes."""
        every = np.ones(len(self.Q), dtype=bool)
        for _ in range(1 if self.given else 3):
            self.x, self.z = self.run(every, robust=True)
            if not self.given:
                self.noise = self._scatter(every, robust=True)
        for _ in range(6):
            far = self._far()
            before, self.kept = self.kept, ~far
            self.x, self.z = self.run(self.kept)
            if not self.given:
                self.noise = self._scatter(self.kept)
            if (before == self.kept).all():
                break

    def _far(self) -> np.ndarray:
        """Return which measurements (N,) are outliers: their length or angle error exceeds both thresholds of OUTLIER.

        For measurements that took no part in the fit, the uncertainty of the fit is added to the noise.
        """
        every = np.ones(len(self.Q), dtype=bool)
        e, A = self.weighted(self.x, self.z, every)
        per = self.measured.per
        E, A = e[: len(every) * per].reshape(-1, per), A[: len(every) * per, self.used]
        root = covariance_root(A[np.repeat(self.kept, per)], len(self.z))
        doubt = ((A @ root.T) ** 2).sum(axis=1).reshape(-1, per)
        E = E / np.sqrt(1.0 + doubt * ~self.kept[:, None])
        far = np.zeros(len(E), dtype=bool)
        for part in (E[:, :3], E[:, 3:]) if per > 3 else (E,):
            size = np.linalg.norm(part, axis=1)
            far |= size > max(OUTLIER[0], OUTLIER[1] * float(np.median(size)))
        return far

    def _scatter(self, rows: np.ndarray, robust: bool = False) -> tuple[float, float]:
        """Estimate the noise [m, rad] from the residuals and their degrees of freedom."""
        E = self.errors(self.x, self.z)[rows]
        share = 1.0 - min(0.9, self.taken_up(rows) / E.size)
        found = []
        for part in (E[:, :3], E[:, 3:]):
            if not part.size:
                found.append(self.noise[1])
                continue
            if robust:
                size = 1.4826 * float(np.median(np.abs(part)))
            else:
                size = float(np.sqrt((part**2).mean()))
            found.append(max(size / np.sqrt(share), LEAST))
        return found[0], found[1]

    def taken_up(self, rows: np.ndarray) -> float:
        """Return how many degrees of freedom of the data the fit uses up: the trace of its projection (hat) matrix."""
        A = self.weighted(self.x, self.z, rows)[1][:, self.used]
        H, Z = A.T @ A, len(self.z)
        prior = np.diag(np.append(np.ones(len(H) - Z), np.zeros(Z)))
        return float(np.trace(np.linalg.pinv(H + prior, hermitian=True) @ H))

    # ------------------------------------------------------------------------------------------------------ what is told
    def untold(self, x: np.ndarray, z: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return a basis (P, k) of the combinations of unknowns that the measurements `rows` do not determine.

        They follow from the singular values of the Jacobian with respect to all unknowns of the arm; the unknowns z of touched
        objects are eliminated from it.
        """
        A = self.weighted(x, z, rows)[1]
        P = len(x)
        A, Z = A[:, :P], A[:, P:]
        if Z.shape[1]:
            U, s, _ = np.linalg.svd(Z, full_matrices=False)
            U = U[:, s > 1e-9 * s[0]]
            A = A - U @ (U.T @ A)
        return untold_directions(A)

    def fix(self, N: np.ndarray) -> dict[int, list[int]]:
        """Fix one unknown at 0 for each undetermined direction (basis N (P, k)); return each with those it cannot be told from.

        Errors of link frames are fixed first, so that offsets of joints, tool and base stay free if possible.
        """
        groups = [one.group for one in self.arm.unknowns]
        order = [p for group in ("frames", "tool", "joints", "base") for p in range(len(groups)) if groups[p] == group]
        left, fixed = N.copy(), []
        # Unknowns whose rows of N are far from linearly dependent are chosen first, so that small changes of the data hardly change
        # the choice.
        for least in (0.5, 0.25, 0.1, 1e-3):
            for p in order:
                size = float(np.linalg.norm(left[p]))
                if size > least and len(fixed) < N.shape[1]:
                    along = left[p] / size
                    left -= np.outer(left @ along, along)
                    fixed.append(p)
        # undo the wider scales of tool and base, so that a length counts the same in all groups
        equal = N * np.array([[WIDE.get(group, 1.0)] for group in groups])
        B = np.abs(equal @ np.linalg.pinv(equal[fixed]))
        self.free[fixed], self.x[fixed] = False, 0.0
        return {p: [int(k) for k in np.flatnonzero(B[:, j] > 0.05) if k != p] for j, p in enumerate(fixed)}

    def width(self) -> float:
        """Return the half width of a 95 % interval in standard deviations (Student's t distribution if the noise is estimated)."""
        from scipy.special import stdtrit

        if self.given:
            return 1.96
        return float(stdtrit(max(1.0, self.kept.sum() * self.measured.per - self.taken_up(self.kept)), 0.975))

    def spread(self, every: bool = False) -> np.ndarray:
        """Return the covariance (P, P) of the unknowns [m, rad]: zero for fixed ones, or if `every` as if none were fixed."""
        P = len(self.x)
        used = np.full(P + len(self.z), True) if every else self.used
        A = self.weighted(self.x, self.z, self.kept)[1][:, used]
        C = np.zeros((P, P))
        at = np.flatnonzero(used[:P])
        W = covariance_root(A, len(self.z))[:, : len(at)]
        C[np.ix_(at, at)] = W.T @ W
        return C * np.outer(self.scales, self.scales)

    def held_out(self) -> np.ndarray | None:
        """Return cross-validated errors (N,) [m]: each fifth of the measurements is left out of a fit in turn.

        Returns None if too few measurements would remain for a fit.
        """
        parts, rows = 5, np.random.default_rng(0).permutation(np.flatnonzero(self.kept))
        found, labels = np.full(len(self.Q), np.nan), self.measured.labels
        if (len(rows) - len(rows) // parts - 1) * self.measured.per < self.taken_up(self.kept):
            return None
        for k in range(parts):
            out = np.zeros(len(self.Q), dtype=bool)
            out[rows[k::parts]] = True
            if self.measured.count and np.setdiff1d(labels[out], labels[self.kept & ~out]).size:
                return None
            x, z = self.run(self.kept & ~out)
            E = self.errors(x, z)[out][:, :3]
            found[out] = np.linalg.norm(E, axis=1)
        return found


def covariance_root(A: np.ndarray, touched: int) -> np.ndarray:
    """Return W with W' W = (A' A + D)^-1, the covariance of a fit; D is 1 (the prior), and almost 0 for the last `touched`."""
    known = np.append(np.ones(A.shape[1] - touched), np.full(touched, 1e-6))
    _, s, V = np.linalg.svd(np.vstack([A, np.diag(np.sqrt(known))]), full_matrices=False)
    return V / s[:, None]


def untold_directions(A: np.ndarray) -> np.ndarray:
    """Return a basis (P, k) of the combinations of unknowns that data with the scaled Jacobian A (m, P) do not determine.

    They are the directions whose singular values, in units of prior and noise, are below UNTOLD.
    """
    squares, V = np.linalg.eigh(A.T @ A)
    return V[:, squares < UNTOLD**2][:, ::-1]


def first_guess(arm: DrawnArm, measured: Measurements, Q: np.ndarray) -> np.ndarray:
    """Return the unknowns x (P,) with which a fit begins: estimates of the base and of the tool's orientation; the others are 0.

    The base is the rotation and translation that fits the positions best (Kabsch 1976); the tool is rotated by the mean of the
    remaining orientation errors.
    """
    x = np.zeros(len(arm.unknowns))
    at = {group: [k for k, one in enumerate(arm.unknowns) if one.group == group] for group in ("base", "tool")}
    if measured.what not in ("pose", "position"):
        return x
    drawn = arm.poses(x, Q)
    p, m = drawn[:, :3, 3], measured.positions
    R = np.eye(3)
    if at["base"]:
        R = nearest_rotation((m - m.mean(0)).T @ (p - p.mean(0)))[0]
        x[at["base"]] = [*(m.mean(0) - R @ p.mean(0)), *pin.log3(R)]
    if at["tool"] and measured.what == "pose":
        turned = np.swapaxes(R @ drawn[:, :3, :3], 1, 2) @ measured.rotations
        x[at["tool"][3:]] = pin.log3(nearest_rotation(turned.sum(0))[0])
    return x


def joint_signs(robot: Any, groups: Any, measured: Measurements, Q: np.ndarray) -> tuple[np.ndarray, float]:
    """Find joints that turn in the direction opposite to the model's, by fits with some joints reversed.

    Only offsets, base and tool are fitted. Returns the signs (n,), 1 or -1, and the ratio of the median error after to before.
    All are 1 unless reversing at least halves the error.
    """
    loose = ("joints", *(group for group in groups if group in ("base", "tool")))

    def left(sign: np.ndarray) -> float:
        arm = DrawnArm(robot, loose, sign)
        fit = ArmFit(arm, measured, Q, arm.scales(*LOOSE), LOOSE)
        x, z = fit.run(fit.kept, robust=True, most=12)
        return float(np.median((fit.errors(x, z) ** 2 / measured.sigma(LOOSE) ** 2).sum(1)))

    asked = reversible(robot, Q)
    sign = np.ones(robot.n)
    first = best = left(sign)
    for _ in asked if best > SIGNS[0] else ():
        tried = [(left(np.where(np.arange(robot.n) == i, -sign, sign)), i) for i in asked]
        value, i = min(tried)
        if value > 0.6 * best:
            break
        sign[i], best = -sign[i], value
    # reversing joints one by one did not help, so all combinations are tried
    if best > SIGNS[1] and len(asked) <= SIGNS[2]:
        for flips in product((1.0, -1.0), repeat=len(asked)):
            other = np.ones(robot.n)
            other[asked] = flips
            value = left(other)
            if value < 0.6 * best:
                sign, best = other, value
    share = float(np.sqrt(best / max(first, 1e-300)))
    return (sign, share) if share < 0.5 else (np.ones(robot.n), 1.0)


def reversible(robot: Any, Q: np.ndarray) -> list[int]:
    """Return the joints whose reversal is tried: those that move in the data, and that no mimic joint follows."""
    lead = {robot.joint_names.index(tie.leader) for tie in robot.mimic_joints.values()}
    return [i for i in range(robot.n) if i not in lead and np.ptp(Q[:, i]) > 1e-3]
