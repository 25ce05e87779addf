"""The systems, gains and paths of Patko and Zelei (2019), and the error measures of runs."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...servo import stability as st
from ...servo.methods import Run, System, simulate
from ...servo.orbit_stability import JacobianDerivatives, OrbitState, chained, step_matrices

Path = Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]]
FRACTIONS = np.linspace(0.1, 0.9, 9)
# The paper's method aa, with two readings of how it computes dJ/dt. In both the joint rates zigzag about those of the exact motion.
ZIGZAGS = ("aa1", "aa2")
# The tracking methods of the report: name and options in the toolkit. The last one, aad, is not from the paper.
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "cv": ("cv", {}),
    "av": ("av", {}),
    "ca": ("ca", {}),
    "aa1": ("aa", {"reading": 1}),
    "aa2": ("aa", {"reading": 2}),
    "aa3": ("aa", {"reading": 3}),
    "aad": ("aad", {"gamma": 0.6}),
}


@dataclass(frozen=True)
class GainSet:
    """A published set of gains: h [s], kappa [1/s], kp [1/s^2] and kd [1/s], with the verdict and the figure of the paper."""

    name: str
    h: float
    kappa: float
    kp: float
    kd: float
    paper: str
    where: str


SETS = {
    "1-DoF": GainSet("1-DoF", 0.12, 5.5, 110.0, 6.5, "stable", "Fig. 4"),
    "PP bad": GainSet("PP bad", 0.0628, 17.0, 400.0, 6.0, "unstable", "Figs. 5, 6 left"),
    "PP good": GainSet("PP good", 0.0628, 11.5, 365.0, 12.5, "stable", "Figs. 5, 6 right"),
    "RR bad": GainSet("RR bad", 0.2, 5.0, 61.0, 3.8, "unstable", "Figs. 7, 8 left"),
    "RR good": GainSet("RR good", 0.2, 3.25, 40.0, 4.0, "stable", "Figs. 7, 8 right"),
}


# ------------------------------------------------------------------------------------------------ the three systems
def one_dof(c: float = 0.2) -> System:
    """Return the System r = c + sqrt(q) with one joint q and one task coordinate r, eq. (37). It is not defined for q < 0."""
    return System(
        lambda q: c + np.sqrt(q),
        lambda q: np.array([[0.5 / np.sqrt(q[0])]]),
        lambda q, x, y: np.array([-0.25 * q[0] ** -1.5 * x[0] * y[0]]),
    )


def pp_arm(length: float = 0.5) -> System:
    """Return the System for the tip of an arm with two perpendicular prismatic joints, eq. (38)."""
    return System(lambda q: length + q, lambda q: np.eye(2), lambda q, x, y: np.zeros(2))


def rr_arm(length: float = 1.0) -> System:
    """Return the System for the tip of two links whose angles are both measured from the base, eq. (43)."""
    return System(
        lambda q: length * np.array([np.cos(q).sum(), np.sin(q).sum()]),
        lambda q: length * np.array([-np.sin(q), np.cos(q)]),
        lambda q, x, y: -length * np.array([np.cos(q) @ (x * y), np.sin(q) @ (x * y)]),
    )


def rr_inverse(p: np.ndarray, length: float = 1.0) -> np.ndarray:
    """Return the angles of the RR arm at a tip p (2,), both measured from the base, where the second is the larger."""
    spread = np.arccos(np.hypot(p[0], p[1]) / (2.0 * length))
    return np.arctan2(p[1], p[0]) + np.array([-spread, spread])


def sine(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the target r_d = a0 + a1 sin(w t), eq. (36), at time t [s], with its first and second derivatives."""
    a, w = 0.6, 0.28
    s, c = np.sin(w * t), np.cos(w * t)
    return np.array([1.2 + a * s]), np.array([a * w * c]), np.array([-a * w * w * s])


def circle(center: tuple[float, float], radius: float, w: float) -> Path:
    """Return a function of time t [s] for a point that goes round a circle at w [rad/s].

    The function returns its position (2,) [m], velocity and acceleration.
    """

    def path(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u = np.array([np.cos(w * t), np.sin(w * t)])
        return center + radius * u, radius * w * np.array([-u[1], u[0]]), -radius * w * w * u

    return path


@dataclass(frozen=True)
class Case:
    """A robot (System) and a path for it to follow, with number of steps and initial error (actual - target).

    start: takes a task position (m,) and returns the joint values (n,) there.

    third: takes q, x, y (n,) and returns the derivative (m, n) with respect to q of the system's rate(q, x, y), which is (dJ/dt) y
    while the joints move at rates x.
    """

    system: System
    path: Path
    steps: int
    start: Callable[[np.ndarray], np.ndarray]
    offset: np.ndarray
    third: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] = lambda q, x, y: np.zeros((len(q), len(q)))


def one_third(q: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the derivative (1, 1) with respect to q of the function `rate` of the system `one_dof`."""
    return np.array([0.375 * q**-2.5 * x * y])


def rr_third(q: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the derivative (2, 2) with respect to q of the function `rate` of the system `rr_arm`, for links of 1 m."""
    return np.array([np.sin(q), -np.cos(q)]) * x * y


CASES = {
    "1-DoF": Case(one_dof(), sine, 1870, lambda p: (p - 0.2) ** 2, np.array([0.1]), one_third),
    "PP": Case(pp_arm(), circle((1.0, 1.0), 0.3, 1.0), 1000, lambda p: p - 0.5, np.array([0.1, -0.05])),
    "RR": Case(rr_arm(), circle((1.0, 0.6), 0.35, 0.5), 630, rr_inverse, np.array([0.05, -0.05]), rr_third),
}


def run(case: Case, gains: GainSet, key: str, offset: np.ndarray | float = 0.0, **changes: Any) -> Run:
    """Track a case's path by the method METHODS[key] from an initial error `offset` [m]; `changes` replace options."""
    name, options = METHODS[key]
    own: dict[str, Any] = {"cv": {"kappa": gains.kappa}, "ca": {"kp": gains.kp, "kd": gains.kd}}
    options = {**options, **own.get(name, {}), **changes}
    h, steps = options.pop("h", gains.h), options.pop("steps", case.steps)
    # A run that stops because sqrt(q) is undefined is reported, so numpy need not warn.
    with np.errstate(all="ignore"):
        return simulate(case.system, case.path, name, h, steps, case.start(case.path(0.0)[0] + offset), **options)


@functools.cache
def known_run(name: str, gains: GainSet, key: str, start: float = 0.0, **changes: Any) -> Run:
    """Run a method on the case of that name from `start` times its initial error.

    Each run is made once and its result used again, so the result must not be changed.
    """
    case = CASES[name]
    return run(case, gains, key, start * case.offset, **changes)


def settled(case: Case, made: Run) -> dict[str, float]:
    """Return four tracking errors [m] that summarise a run, all NaN if the run stopped early.

    They are the largest ("max") and the RMS error ("rms") in the second half of the run, the RMS error of the whole run
    ("rms_all"), and the largest error between the samples of the second half ("dense").
    """
    if made.stopped:
        return dict.fromkeys(("max", "rms", "rms_all", "dense"), np.nan)
    e = np.linalg.norm(made.error, axis=1)
    late = slice(len(e) // 2, None)
    half = e[late]
    later = made._replace(t=made.t[late], q=made.q[late], rate=made.rate[late], error=made.error[late])
    dense = later.between(case.system, lambda t: case.path(t)[0], FRACTIONS)
    return {
        "max": float(half.max()),
        "rms": float(np.sqrt((half**2).mean())),
        "rms_all": float(np.sqrt((e**2).mean())),
        "dense": float(dense.max()),
    }


def growth(case: Case, gains: GainSet, key: str, lap: float) -> float:
    """Return the largest factor by which a small disturbance changes in one lap [s] of the moving target (Floquet multiplier).

    It is the spectral radius of the product of the exact derivatives of all steps. The derivatives are taken along the motion
    without error; for method aa with reading 1 or 2 of dJ/dt, along the zigzagging run that starts there. h is adjusted to divide
    the lap.
    """
    steps = round(lap / gains.h)
    h = lap / steps
    times = h * np.arange(steps + 1)
    target, v, a = (np.array(part) for part in zip(*(case.path(t) for t in times), strict=True))
    system = case.system
    q = np.array([case.start(p) for p in target])
    J = np.array([system.jacobian(x) for x in q])
    rate = np.linalg.solve(J, v[..., None])[..., 0]
    if key in ZIGZAGS:
        made = run(case, gains, key, h=h, steps=steps, rate0=rate[0])
        q, rate = made.q, made.rate
        J = np.array([system.jacobian(x) for x in q])
    units = np.eye(q.shape[1])
    H = np.array([[[system.rate(x, i, j) for i in units] for j in units] for x in q]).transpose(0, 3, 1, 2)

    def third(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.array([case.third(*at) for at in zip(q[:-1], x, y, strict=True)])

    tip = np.array([system.position(x) for x in q])
    orbit = OrbitState(rate[:-1], (target - tip)[:-1], target[1:] - tip[:-1], v[:-1], a[:-1])
    name, options = METHODS[key]
    known = {"kappa": gains.kappa, "kp": gains.kp, "kd": gains.kd, "share": 1.0}
    total, scale = chained(step_matrices(JacobianDerivatives(J, H, third), orbit, name, h, known | options))
    return st.spectral_radius(total) * float(np.exp(scale))
