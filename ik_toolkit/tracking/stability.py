"""Stability of the tracking methods as sampled systems: mapping matrices, closed-form regions, best gains, a check.

Near a resting point every method maps (error, joint velocity, earlier command) linearly from one sample to the next, and
the matrices are the same for every arm (Patko and Zelei, 2019, eqs 30-42). Stability depends on dimensionless gains
only: k = kappa h for `cv`, d = kp-and-kd pair (p, d) = (kp h^2, kd h) for `ca`. From the Jury conditions:

    cv  stable  <=>  0 < k < 1                                      (flip, eigenvalue -1, at k = 1)
    ca  stable  <=>  0 < d < 1  and  0 < p < (d + sqrt(d (9 d + 16))) / 2

The matrices describe rest. Along a fast path kappa I becomes kappa I + J^-1 dJ/dt, so gains within a few percent of the
border can still diverge in motion.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InvalidOption, near_match
from .inputs import number, one_of, positive

GAINS = {"cv": ("kappa",), "av": (), "ca": ("kp", "kd"), "aa": (), "aad": ("gamma",)}  # of each method
METHODS = tuple(GAINS)
GAMMA = 0.6  # default of aad: eigenvalue 1 - 1/gamma = -2/3
BORDER = 1e-9  # relative distance to the border within which a gain set is called marginal

# Best gains: the smallest spectral radius. cv: a complex pair turns real at k = 2/3. ca: a triple eigenvalue r, which
# solves 9 r^3 - 9 r^2 + 3 r + 1 = 0.
BEST_CV = 2.0 / 3.0
TRIPLE = (1.0 - 4.0 ** (1.0 / 3.0)) / 3.0
BEST_CA = (4.0 / 3.0 - 2.0 * TRIPLE + 2.0 * TRIPLE**3, 2.0 / 3.0 - TRIPLE - TRIPLE**3)  # (kp h^2, kd h)
BEST_CA_RADIUS = -TRIPLE


def mapping_matrix(
    method: str,
    h: float,
    *,
    kappa: float | None = None,
    kp: float | None = None,
    kd: float | None = None,
    gamma: float = GAMMA,
    dof: int = 1,
) -> np.ndarray:
    """Matrix that carries the linearised state of `method` over one sample of h [s].

    State: cv (q, previous command), ca (q, qd, previous command), aa and aad (q, qd), av (q); for `dof` joints each entry
    is repeated on the diagonal, as in eqs (39)-(42). Gains: kappa [1/s], kp [1/s^2], kd [1/s]. Source: Patko and Zelei
    (2019), eqs (30), (31), (34), (35), (39)-(42); entry (3,3) of (41) is printed with kp and must have kd.
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
        _needed(method, h)
        A = np.zeros((1, 1))
    elif method in ("aa", "aad"):
        gamma = 0.5 if method == "aa" else gamma
        _needed(method, h, gamma=positive(gamma, "gamma"))
        A = np.array([[0.0, 0.0], [-1.0 / (gamma * h), 1.0 - 1.0 / gamma]])
    else:
        raise InvalidOption(f"no tracking method '{method}'.{near_match(method, METHODS)}")
    return np.kron(A, np.eye(dof))


def _needed(method: str, h: float, **gains: float | None) -> list[float]:
    """Return the gains of a method as numbers; a missing or non-finite one, or a bad h, is the caller's mistake."""
    positive(h, "the sample time [s]")
    return [number(value, f"{method} needs {' and '.join(gains)}: {name}") for name, value in gains.items()]


def spectral_radius(A: np.ndarray) -> float:
    """Largest modulus of the eigenvalues of A (m, m)."""
    return float(np.abs(np.linalg.eigvals(A)).max())


def p_limit(d):
    """Upper border of p = kp h^2 for d = kd h (number or array)."""
    return 0.5 * (d + np.sqrt(d * (9.0 * d + 16.0)))


def cv_stable(k):
    """Whether k = kappa h (number or array) lies inside the stable interval of cv."""
    return (k > 0.0) & (k < 1.0)


def ca_stable(p, d):
    """Whether p = kp h^2, d = kd h (numbers or arrays) lie inside the stable region of ca."""
    inside = (d > 0.0) & (d < 1.0)
    return inside & (p > 0.0) & (p < p_limit(np.where(inside, d, 0.5)))


def best_gains(method: str, h: float) -> dict[str, float]:
    """Gains with the smallest spectral radius at sample time h [s]: cv 0.577 (1/sqrt 3), ca 0.196, aad 0.667; av has none.

    cv: kappa h = 2/3. ca: kp h^2 = 1.7099, kd h = 0.8700, where all three eigenvalues meet.
    """
    one_of(method, METHODS, "tracking method")
    h = positive(h, "the sample time [s]")
    if method == "cv":
        return {"kappa": BEST_CV / h}
    if method == "ca":
        return {"kp": BEST_CA[0] / (h * h), "kd": BEST_CA[1] / h}
    return {"gamma": GAMMA} if method == "aad" else {}


def longest_step(method: str, **gains: float) -> float:
    """Longest sample time [s] at which the gains (kappa; kp and kd) are stable; inf where the method has no gains."""
    if method == "cv":
        return 1.0 / gains["kappa"] if gains["kappa"] > 0.0 else 0.0
    if method != "ca":
        return math.inf
    kp, kd = gains["kp"], gains["kd"]
    if not (kp > 0.0 and kd > 0.0):
        return 0.0
    # The border p = p_limit(d) written in h: kp^2 h^3 - kp kd h^2 - 2 kd^2 h - 4 kd = 0 has one positive root.
    roots = np.roots([kp * kp, -kp * kd, -2.0 * kd * kd, -4.0 * kd])
    real = roots[np.abs(roots.imag) < 1e-9 * np.abs(roots)].real
    return min(1.0 / kd, float(real[real > 0.0].min()))


@dataclass(frozen=True)
class GainCheck:
    """What `check_gains` found.

    verdict is "stable", "marginal" or "unstable"; radius the spectral radius of the mapping matrix (growth of the error
    per sample); message one sentence for people; suggestion the best gains at this sample time; longest_step [s] the
    slowest sampling at which the same gains are stable.
    """

    method: str
    h: float
    verdict: str
    radius: float
    message: str
    suggestion: dict[str, float]
    longest_step: float

    @property
    def stable(self) -> bool:
        """Whether the gains lie strictly inside the stable region."""
        return self.verdict == "stable"


def check_gains(method: str, h: float, **gains: float) -> GainCheck:
    """Judge a method's gains (cv: kappa; ca: kp, kd; aad: gamma) at sample time h [s], with a sentence and a suggestion.

    The verdict comes from the closed-form region, the radius from the eigenvalues. Raises InvalidOption on a gain the
    method does not have or lacks.
    """
    one_of(method, METHODS, "tracking method")
    for name in gains:
        if name not in GAINS[method]:
            raise InvalidOption(f"{method} has no gain '{name}'.{near_match(name, GAINS[method])}")
    radius = spectral_radius(mapping_matrix(method, h, dof=1, **gains))
    best = best_gains(method, h)
    longest = longest_step(method, **gains)
    if method == "cv":
        k = gains["kappa"] * h
        margin = min(k, 1.0 - k)
        where = f"kappa h = {k:.4g}, stable between 0 and 1"
    elif method == "ca":
        p, d = gains["kp"] * h * h, gains["kd"] * h
        top = float(p_limit(d)) if d > 0.0 else 0.0
        margin = min(d, 1.0 - d, p, (top - p) / max(top, 1e-300))
        where = f"kd h = {d:.4g} (stable between 0 and 1), kp h^2 = {p:.4g} (stable between 0 and {top:.4g})"
    elif method == "aa":
        margin = 0.0
        where = "eigenvalue -1 whatever the gains: the joint velocity may zigzag for ever"
        best = {}
    elif method == "aad":
        gamma = gains.get("gamma", GAMMA)
        margin = gamma - 0.5
        where = f"gamma = {gamma:.4g}, stable above 0.5"
    else:
        margin, where = 1.0, "eigenvalue 0: no gains to choose"
    verdict = "marginal" if abs(margin) <= BORDER else "stable" if margin > 0.0 else "unstable"
    message = f"{method} at h = {h:.4g} s is {verdict} at rest: {where}; spectral radius {radius:.4g}."
    if verdict != "stable":
        if best:
            message += " Try " + ", ".join(f"{name} = {value:.5g}" for name, value in best.items())
            message += f", or a rate above {1.0 / longest:.4g} Hz." if math.isfinite(longest) and longest > 0.0 else "."
        elif method == "aa":
            message += " aad removes that eigenvalue at the same accuracy."
    return GainCheck(method, h, verdict, radius, message, best, longest)
