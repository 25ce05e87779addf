"""Stability of the tracking methods as sampled systems: mapping matrices, closed-form regions, best gains, a check.

Near a resting point every method maps (error, joint velocity, earlier command) linearly from one sample to the next,
with the same matrices for every arm (Patko and Zelei, 2019, eqs 30-42). Stability depends only on dimensionless gains:
k = kappa h for `cv`, and p = kp h^2, d = kd h for `ca`, with the sample time h. The Jury conditions give:

    cv  stable  <=>  0 < k < 1                                      (flip, eigenvalue -1, at k = 1)
    ca  stable  <=>  0 < d < 1  and  0 < p < (d + sqrt(d (9 d + 16))) / 2

The matrices hold at rest. Along a fast path kappa I becomes kappa I + J^-1 dJ/dt, so gains within a few percent of the
border can diverge in motion: `check_gains(..., robot=, path=)` multiplies the matrices along the path
(orbit_stability.py).

If measured joint values are fed back directly, the error is late and noisy, but the rates and earlier commands are not.
For this case `delayed_matrix` adds the earlier positions to the state.
"""

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, near_match
from ..text import equations
from ..validate import not_negative, number, one_of, positive

if TYPE_CHECKING:
    from .orbit_stability import Growth

GAINS = {
    "cv": ("kappa",),
    "av": ("share",),
    "ca": ("kp", "kd"),
    "aa": ("share",),
    "aad": ("gamma", "share"),
}  # the gains of each tracking method, in the order used by BEST
BORDER = 1e-9  # gains within this relative distance of the stability border count as marginal
# BEST holds the gains with the smallest spectral radius: kappa h of cv, (kp h^2, kd h) of ca, and share of av. In method cv a
# complex pair of eigenvalues becomes real at 2/3. In method ca there is then a triple eigenvalue r, the real root of 9 r^3 - 9 r^2
# + 3 r + 1 = 0.
TRIPLE = (1.0 - 4.0 ** (1.0 / 3.0)) / 3.0
BEST = {
    "cv": (2.0 / 3.0,),
    "ca": (4.0 / 3.0 - 2.0 * TRIPLE + 2.0 * TRIPLE**3, 2.0 / 3.0 - TRIPLE - TRIPLE**3),
    "av": (1.0,),
}


class DefaultGains(NamedTuple):
    """Default values of the gains gamma and share, which do not depend on the sample time."""

    gamma: float = 0.6  # new rate's weight in method aad, whose eigenvalue is then 1 - 1/gamma = -2/3; set by hand
    share: float = 1.0  # share of the error that a step of av, aa or aad removes; 1 as published


DEFAULT = DefaultGains()


def mapping_matrix(
    method: str,
    h: float,
    *,
    kappa: float | None = None,
    kp: float | None = None,
    kd: float | None = None,
    gamma: float = DEFAULT.gamma,
    share: float = DEFAULT.share,
    dof: int = 1,
) -> np.ndarray:
    """Return the matrix by which a tracking method, linearised at rest, multiplies its state in one sample time h [s].

    The state is (q, previous command) in method cv, (q, qd, previous command) in ca, (q, qd) in aa and aad, and q in
    av; each entry is repeated on the diagonal for `dof` joints, as in eqs (39)-(42). Gains: kappa [1/s], kp [1/s^2], kd
    [1/s], share (1: as published). Source: Patko and Zelei (2019), eqs (30), (31), (34), (35), (39)-(42). Entry (3,3)
    of (41) is printed with kp and must have kd. Raises InvalidOption for a missing gain or an unknown method.
    """
    if method == "cv":
        (kappa,) = _needed(method, h, kappa=kappa)
        A = np.array([[1.0 - 1.5 * kappa * h, -0.5 * h], [-kappa, 0.0]])
    elif method == "ca":
        kp, kd = _needed(method, h, kp=kp, kd=kd)
        A = np.array(
            [
                [1.0 - 0.75 * kp * h * h, h - 0.75 * kd * h * h, -0.25 * h * h],
                [-1.5 * kp * h, 1.0 - 1.5 * kd * h, -0.5 * h],
                [-kp, -kd, 0.0],
            ]
        )
    elif method == "av":
        (share,) = _needed(method, h, share=share)
        A = np.array([[1.0 - share]])
    elif method in ("aa", "aad"):
        gamma = 0.5 if method == "aa" else gamma
        gamma, share = _needed(method, h, gamma=positive(gamma, "gamma"), share=share)
        A = np.array([[1.0 - share, 0.0], [-share / (gamma * h), 1.0 - 1.0 / gamma]])
    else:
        raise InvalidOption(f"no tracking method '{method}'.{near_match(method, GAINS)}")
    return np.kron(A, np.eye(dof))


def _needed(method: str, h: float, **gains: float | None) -> list[float]:
    """Return the gains of a method as numbers.

    Raise InvalidOption if h is not positive or a gain is missing or not finite.
    """
    positive(h, "the sample time [s]")
    return [number(value, f"{method} needs {' and '.join(gains)}: {name}") for name, value in gains.items()]


def spectral_radius(A: np.ndarray) -> float:
    """Return the largest modulus of the eigenvalues of A (m, m)."""
    return float(np.abs(np.linalg.eigvals(A)).max())


def delayed_matrix(method: str, h: float, delay: float = 0.0, **gains: Any) -> np.ndarray:
    """Return the matrix (k, k) by which a method multiplies the state of one joint in a sample, if positions are measured late.

    delay: age of the measured position in samples. The state is that of `mapping_matrix`, followed by the positions one, two, ...
    samples ago. Only the position from which the error is taken is late: rates and earlier commands are the tracker's own. A
    fraction of a sample means a position between two samples, with constant rate.
    """
    A = mapping_matrix(method, h, **gains)
    delay = _samples(delay)
    whole, part = math.floor(delay), delay - math.floor(delay)
    late = whole + (part > 0.0)
    n = len(A)
    M = np.zeros((n + late, n + late))
    M[:n, :n] = A
    feedback = feedback_column(A)
    M[:n, 0] -= feedback
    for samples, share in ((whole, 1.0 - part), (whole + 1, part)):
        if share:
            M[:n, 0 if samples == 0 else n + samples - 1] += share * feedback
    for k in range(late):
        M[n + k, 0 if k == 0 else n + k - 1] = 1.0
    return M


def feedback_column(A: np.ndarray) -> np.ndarray:
    """Return how the measured position of a joint enters its next state (k,): the feedback part of the first column of A (k, k).

    A is a matrix of `mapping_matrix` for one joint. The other part of the column keeps the position itself.
    """
    return A[:, 0] - np.eye(len(A))[0]


def _samples(delay: Any) -> float:
    """Return a delay as a number of samples from 0 to 200 (so many rows has the matrix). Raises InvalidOption for anything else."""
    found = number(delay, "delay [samples]")
    if not 0.0 <= found <= 200.0:
        raise InvalidOption(f"delay is a number of samples from 0 to 200, not {found:g}")
    return found


def noise_gains(method: str, h: float, delay: float = 0.0, **gains: Any) -> tuple[float, float]:
    """Return the RMS of a joint's position, and of its rate times h, over the RMS of noise on its measured position.

    They are the H2 norms of the maps from white noise to position and rate, at rest, and infinite if the gains are not stable.
    """
    M = delayed_matrix(method, h, delay, **gains)
    if spectral_radius(M) >= 1.0 - BORDER:
        return math.inf, math.inf
    B = np.zeros(len(M))
    column = feedback_column(mapping_matrix(method, h, **gains))
    B[: len(column)] = column
    # The covariance P = M P M' + B B' is summed by doubling: P_2k = P_k + M^k P_k M^k'.
    P, power = np.outer(B, B), M
    while np.abs(power).max() > 1e-20:
        P = P + power @ P @ power.T
        power = power @ power
    # In these methods the rate is part of the state. If it zigzags, it can be larger than the motion of a step divided by h.
    if method in ("ca", "aa", "aad"):
        return math.sqrt(P[0, 0]), h * math.sqrt(P[1, 1])
    # row that gives the motion in the next step from the state; B[0] is what the noise of this sample adds
    move = M[0] - np.eye(len(M))[0]
    return math.sqrt(P[0, 0]), math.sqrt(move @ P @ move + B[0] ** 2)


def p_limit(d):
    """Return the value of p = kp h^2 above which the acceleration-level method ca is unstable, for d = kd h."""
    return 0.5 * (d + np.sqrt(d * (9.0 * d + 16.0)))


def best_gains(method: str, h: float, delay: float = 0.0) -> dict[str, float]:
    """Return the gains of a method with the smallest spectral radius at sample time h [s].

    Method cv: kappa h = 2/3, radius 0.577 (1/sqrt 3). ca: kp h^2 = 1.7099, kd h = 0.8700, where all three eigenvalues
    meet, radius 0.196. av, aa, aad: share = 1, with radius 0, 1 and 0.667. If positions are measured `delay` samples ago, the
    best gains are found by a search.
    """
    one_of(method, GAINS, "tracking method")
    h = positive(h, "the sample time [s]")
    units = {"kappa": h, "kp": h * h, "kd": h, "share": 1.0}
    # Methods aa and aad have the eigenvalue of av, and another one that does not depend on `share`.
    law = method if method in BEST else "av"
    found = BEST[law]
    if _samples(delay):
        found = _best_delayed(law, float(delay))
    best = {name: value / units[name] for name, value in zip(GAINS[law], found, strict=True)}
    return {name: best.get(name, DEFAULT.gamma) for name in GAINS[method]}


@functools.cache
def _best_delayed(method: str, delay: float) -> tuple[float, ...]:
    """Return the best gains under a delay [samples] for h = 1 s, by four logarithmic grids around the best point so far."""
    names = GAINS[method]
    middle, width = np.log(BEST[method]) - math.log(1.0 + delay), 3.0
    for _ in range(4):
        axes = np.meshgrid(*([np.linspace(-width, width, 25)] * len(names)), indexing="ij")
        points = middle + np.stack([axis.ravel() for axis in axes], axis=1)
        tried = (dict(zip(names, np.exp(point).tolist(), strict=True)) for point in points)
        matrices = np.array([delayed_matrix(method, 1.0, delay, **gains) for gains in tried])
        middle = points[int(np.argmin(np.abs(np.linalg.eigvals(matrices)).max(axis=1)))]
        width /= 4.0
    return tuple(np.exp(middle).tolist())


def longest_step(method: str, delay: float = 0.0, **gains: float) -> float:
    """Return the longest sample time [s] at which the gains of cv (kappa) or ca (kp, kd) are stable; inf for other methods.

    It is 0 if they are stable at no sample time. delay: age of the measured position in samples, whatever the sample time.
    """
    if delay and method in ("cv", "ca"):
        low, high, tried = 0.0, math.inf, longest_step(method, **gains)  # a small delay may allow longer steps
        for _ in range(52 if tried > 0.0 else 0):
            stable = spectral_radius(delayed_matrix(method, tried, delay, **gains)) < 1.0
            low, high = (tried, high) if stable else (low, tried)
            tried = min(0.5 * (low + high), 2.0 * tried)
        return low
    if method == "cv":
        return 1.0 / gains["kappa"] if gains["kappa"] > 0.0 else 0.0
    if method != "ca":
        return math.inf
    kp, kd = gains["kp"], gains["kd"]
    if not (kp > 0.0 and kd > 0.0):
        return 0.0
    # The border p = p_limit(d) is kp^2 h^3 - kp kd h^2 - 2 kd^2 h - 4 kd = 0 in h, with one positive root.
    roots = np.roots([kp * kp, -kp * kd, -2.0 * kd * kd, -4.0 * kd])
    real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real
    return min(1.0 / kd, float(real[real > 0.0].min()))


@dataclass(frozen=True)
class GainCheck:
    """Result of `check_gains`: whether the gains of a tracking method are stable.

    verdict: "stable", "marginal" or "unstable", at rest and, if a path was given, along it; radius: spectral radius of the mapping
    matrix (factor by which an error changes per sample, at rest); message: one sentence, more with noise or a path;
    suggestion: the best gains at this sample time and delay; longest_step [s]: the longest sample time at which the same gains
    are stable (along the path, if they are unstable there). delay [samples]: as given; noise_gain: RMS of a joint's position over
    the RMS of the noise on its measurement; along: growth of an error on the path (factor, per_step, closed), or None.
    """

    method: str
    h: float
    verdict: str
    radius: float
    message: str
    suggestion: dict[str, float]
    longest_step: float
    delay: float = 0.0
    noise_gain: float = 0.0
    along: "Growth | None" = None

    @property
    def stable(self) -> bool:
        """Whether the gains lie strictly inside the stable region."""
        return self.verdict == "stable"


def complete(method: str, gains: dict[str, float]) -> dict[str, float]:
    """Return the given gains of a tracking method and the defaults of those not given. Raises InvalidOption for an unknown name."""
    one_of(method, GAINS, "tracking method")
    for name in gains:
        if name not in GAINS[method]:
            raise InvalidOption(f"{method} has no gain '{name}'.{near_match(name, GAINS[method])}")
    return {name: value for name, value in DEFAULT._asdict().items() if name in GAINS[method]} | gains


def check_gains(
    method: str,
    h: float,
    *,
    delay: float = 0.0,
    noise: float | None = None,
    robot: Any = None,
    path: Any = None,
    q0: Any = None,
    null_damping: float = 0.0,
    **gains: float,
) -> GainCheck:
    """Judge a method's gains at sample time h, with a sentence and a suggestion.

    At rest the verdict comes from the closed-form region, or with a delay from the eigenvalues.

    Args:
        method: Name of the method.
        h: Sample time [s].
        delay: Age of measured joint positions that are fed back directly, in samples (20 ms at h = 0.01 s are 2 samples;
            fractions are allowed). Leave it 0 for `Tracker.update(q=...)`, which takes the delay out, see `JointObserver`.
        noise: RMS of the noise on a measured position [rad or m]; the message tells the resulting RMS of the joints.
        robot: A Robot. With `path`, the gains are also judged along this path, by the growth of a small error over the path,
            or over a lap if the path is closed.
        path: A Reference, as from ik.circle. A delay cannot be judged along it.
        q0: (n,) configuration [rad or m] near which the motion along the path starts; default: home.
        null_damping: Damping of null-space motion along the path [1/s], as in `Method`.
        gains: By method: kappa (cv); kp and kd (ca); share (av and aa); gamma and share (aad).

    Returns:
        A GainCheck with the verdict, the spectral radius, a message and the best gains.

    Raises:
        InvalidOption: A gain is missing or not one of the method's, or a number is out of range.
        InvalidTarget: The path cannot be followed.
    """
    complete(method, gains)
    delay, null_damping = _samples(delay), not_negative(null_damping, "null_damping [1/s]")
    if (robot is None) != (path is None):
        raise InvalidOption("gains are judged along a path with both robot= and path=")
    radius = spectral_radius(delayed_matrix(method, h, delay, **gains))
    best = best_gains(method, h, delay)
    longest = longest_step(method, delay, **gains)
    margin, where = _region(method, h, **gains)
    if delay:
        margin, where = 1.0 - radius, f"positions measured {delay:g} samples ago"
    verdict = "marginal" if abs(margin) <= BORDER else "stable" if margin > 0.0 else "unstable"
    message = f"{method} at h = {h:.4g} s is {verdict} at rest: {where}; spectral radius {radius:.4g}."
    gain = noise_gains(method, h, delay, **gains)
    if noise is not None:
        rms = positive(noise, "noise")
        message += (
            f" Noise of {rms:.3g} on a measured position becomes {rms * gain[0]:.3g} in the joint and {rms * gain[1] / h:.3g} "
            "per second in its rate."
            if math.isfinite(gain[0])
            else " Noise on the measured positions grows without bound."
        )
    found = None
    # Gains that would be stable at rest at a higher sample rate are judged along the path as well, which may need a still higher
    # rate.
    rescued = path is not None and verdict != "stable" and 0.0 < longest < math.inf and not delay
    if verdict != "stable" and not rescued:
        message += _way_out(method, best, longest, delay)
    if path is not None:
        from .orbit_stability import PathMotion, stable_bands

        if delay:
            raise InvalidOption("gains with a delay are judged at rest only; omit delay or path")
        motion = PathMotion(robot, path, q0)

        def along(h: float, gains: dict[str, float]) -> "Growth":
            return motion.growth(method, h, complete(method, gains), null_damping)

        found = along(h, gains)
        judged = "stable" if found.factor < 1.0 else "unstable"
        message += f" Along the path it is {judged}: {found.words} ({found.per_step:.5g} a sample)."
        message += motion.beyond_limits()
        if rescued or (judged == "unstable" and verdict == "stable"):
            low = 1.0 / longest if rescued else 1.0 / h
            verdict = judged if judged == "unstable" else verdict
            most = max(min(10.0 * low, 2000 / path.duration), 2.0 * low)
            bands = stable_bands(lambda rate: along(1.0 / rate, gains).factor, low, most)[2]
            longest = 1.0 / bands[-1][0] if bands and bands[-1][1] == most else 0.0
            tries = [equations(best)]
            tries = tries if along(h, best).factor < 1.0 else []
            tries += [f"a rate above {1.0 / longest:.4g} Hz"] if longest > 0.0 else []
            message += f" There {' or '.join(tries)} is stable." if tries else ""
    return GainCheck(method, h, verdict, radius, message, best, longest, delay, gain[0], found)


def _way_out(method: str, best: dict[str, float], longest: float, delay: float) -> str:
    """Return a sentence on gains or a sample time that would work."""
    words = f" Try {equations(best)}"
    if method == "aa":  # Method aa is marginal even with its best gains.
        out = " aad removes that eigenvalue at the same accuracy."
        return f"{words} with aad, which removes aa's eigenvalue -1." if delay else out
    # At a higher sample rate the same delay is more samples, so no rate is suggested.
    if delay or not 0.0 < longest < math.inf:
        return f"{words}."
    return f"{words}, or a rate above {1.0 / longest:.4g} Hz."


def _region(method: str, h: float, **gains: float) -> tuple[float, str]:
    """Return the distance of the gains from the border of the stability region (negative outside), and words on the region."""
    if method == "cv":
        k = gains["kappa"] * h
        return min(k, 1.0 - k), f"kappa h = {k:.4g}, stable between 0 and 1"
    if method == "ca":
        p, d = gains["kp"] * h * h, gains["kd"] * h
        top = float(p_limit(d)) if d > 0.0 else 0.0
        where = f"kd h = {d:.4g} (stable between 0 and 1), kp h^2 = {p:.4g} (stable between 0 and {top:.4g})"
        return min(d, 1.0 - d, p, (top - p) / max(top, 1e-300)), where
    share, gamma = gains.get("share", DEFAULT.share), gains.get("gamma", DEFAULT.gamma)
    margin, where = min(share, 2.0 - share), f"share = {share:.4g}, stable between 0 and 2"
    if method == "aa":
        return min(margin, 0.0), "eigenvalue -1 whatever the gains: the joint velocity may zigzag for ever"
    if method == "aad":
        return min(margin, gamma - 0.5), f"gamma = {gamma:.4g}, stable above 0.5, {where}"
    return margin, where
