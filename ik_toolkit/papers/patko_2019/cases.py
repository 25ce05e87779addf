"""The systems, gains and paths of Patko and Zelei (2019), and the error measures of runs."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...servo import stability as st
from ...servo.methods import Run, System, simulate
from ...servo.orbit_stability import Motion, step_matrices

Path = Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]]
FRACTIONS = np.linspace(0.1, 0.9, 9)
MEASURED = ("aa1", "aa2")  # method aa with interpretations 1, 2 of dJ/dt; its error growth is measured by runs
# Tracking methods (name, options) by their names in the report; aad is our own, the others are the paper's.
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
    """Return the system r = c + sqrt(q) with one joint, eq. (37), which is not defined for q < 0."""
    return System(
        lambda q: c + np.sqrt(q),
        lambda q: np.array([[0.5 / np.sqrt(q[0])]]),
        lambda q, x, y: np.array([-0.25 * q[0] ** -1.5 * x[0] * y[0]]),
    )


def pp_arm(length: float = 0.5) -> System:
    """Return the tip of two perpendicular prismatic joints, eq. (38)."""
    return System(lambda q: length + q, lambda q: np.eye(2), lambda q, x, y: np.zeros(2))


def rr_arm(length: float = 1.0) -> System:
    """Return the tip of two links whose angles are both measured from the base, eq. (43)."""
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
    """Return the desired path r_d = a0 + a1 sin(w t), eq. (36), with its derivatives."""
    a, w = 0.6, 0.28
    s, c = np.sin(w * t), np.cos(w * t)
    return np.array([1.2 + a * s]), np.array([a * w * c]), np.array([-a * w * w * s])


def circle(center: tuple[float, float], radius: float, w: float) -> Path:
    """Return a circle in the plane that is run through at w [rad/s], with its derivatives."""

    def path(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        u = np.array([np.cos(w * t), np.sin(w * t)])
        return center + radius * u, radius * w * np.array([-u[1], u[0]]), -radius * w * w * u

    return path


@dataclass(frozen=True)
class Case:
    """A system and a path to follow, with number of steps, initial error (actual - target), and `start`: q at a task position."""

    system: System
    path: Path
    steps: int
    start: Callable[[np.ndarray], np.ndarray]
    offset: np.ndarray


CASES = {
    "1-DoF": Case(one_dof(), sine, 1870, lambda p: (p - 0.2) ** 2, np.array([0.1])),
    "PP": Case(pp_arm(), circle((1.0, 1.0), 0.3, 1.0), 1000, lambda p: p - 0.5, np.array([0.1, -0.05])),
    "RR": Case(rr_arm(), circle((1.0, 0.6), 0.35, 0.5), 630, rr_inverse, np.array([0.05, -0.05])),
}


def run(case: Case, gains: GainSet, key: str, offset: np.ndarray | float = 0.0, **changes: Any) -> Run:
    """Track a case's path by the method METHODS[key] from an initial error `offset` [m]; `changes` replace options."""
    name, options = METHODS[key]
    options = dict(options)
    if name == "cv":
        options["kappa"] = gains.kappa
    elif name == "ca":
        options.update(kp=gains.kp, kd=gains.kd)
    options.update(changes)
    h, steps = options.pop("h", gains.h), options.pop("steps", case.steps)
    with np.errstate(all="ignore"):  # a run that leaves the domain of sqrt is reported, so numpy need not warn
        return simulate(case.system, case.path, name, h, steps, case.start(case.path(0.0)[0] + offset), **options)


@functools.cache
def known_run(name: str, gains: GainSet, key: str, start: float = 0.0, **changes: Any) -> Run:
    """Run a method on the case of that name from `start` times its initial error.

    Each run is made once and its result used again, so the result must not be changed.
    """
    case = CASES[name]
    return run(case, gains, key, start * case.offset, **changes)


def settled(case: Case, made: Run) -> dict[str, float]:
    """Return four errors of a run, all NaN if it stopped early.

    They are the largest and the RMS error of the second half, the RMS error of the whole run, and the largest error between
    samples of the second half.
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

    It is the spectral radius of the product of the matrices that carry a disturbance over each step of the exact
    motion; h is adjusted to divide the lap. Method aa with interpretation 1 or 2 of dJ/dt zigzags about that motion, so the
    factor is then measured by disturbed runs (`measured_growth`).
    """
    if key in MEASURED:
        return measured_growth(case, gains, key, lap)
    steps = round(lap / gains.h)
    h = lap / steps
    # Method aa with interpretation 3 of dJ/dt is method aad without its damping.
    known = {"cv": {"kappa": gains.kappa}, "ca": {"kp": gains.kp, "kd": gains.kd}, "aa3": {"gamma": 0.5, "share": 1.0}}
    of_key = known.get(key) or {**METHODS[key][1], "share": 1.0}
    method = "aad" if key == "aa3" else METHODS[key][0]
    matrices = step_matrices(exact_motion(case, h * np.arange(steps + 1)), method, h, of_key)
    return st.spectral_radius(functools.reduce(lambda total, A: A @ total, matrices))


def exact_motion(case: Case, times: np.ndarray) -> Motion:
    """Return J^+ J, J^+ dJ/dt etc. along the motion without error at some times [s]; J is square and has an inverse."""
    system, rows = case.system, []
    near = 1e-5  # [s] step of the difference quotient for dJ/dt; its error is about 1e-10
    jacobians = [system.jacobian(case.start(case.path(t)[0])) for t in times]
    for t, J in zip(times[:-1], jacobians, strict=False):
        p, v, a = case.path(t)
        q = case.start(p)

        def along(x: np.ndarray, at: np.ndarray = q) -> np.ndarray:
            """Return the derivative of J along joint velocities x (n,)."""
            return np.column_stack([system.rate(at, x, y) for y in np.eye(len(x))])

        qd = np.linalg.solve(J, v)
        curve = system.rate(q, qd, qd)
        second = (along(qd, q + near * qd) - along(qd, q - near * qd)) / (2.0 * near)
        bend, acceleration = along(np.linalg.solve(J, curve)), along(np.linalg.solve(J, a - curve))
        rows.append([np.linalg.solve(J, part) for part in (J, along(qd), acceleration, bend, second)])
    row, rate, acceleration, bend, second = (np.array(part) for part in zip(*rows, strict=True))
    return Motion(row, rate, acceleration, bend, second, jacobians[0], jacobians[-1])


def measured_growth(case: Case, gains: GainSet, key: str, lap: float, disturbance: float = 1e-6) -> float:
    """Return the growth factor as `growth` does, but from disturbed runs; a factor below about 1e-8 is rounding.

    The state (angles, and rates or the previous command if the method has them) is disturbed one component at a time at the
    start of a lap; returns the spectral radius of the resulting matrix. h is adjusted to divide the lap.
    """
    steps = round(lap / gains.h)
    h = lap / steps
    q0 = case.start(case.path(0.0)[0])
    n = len(q0)
    rate0 = np.linalg.solve(case.system.jacobian(q0), case.path(0.0)[1])
    command0 = rate0 if key == "cv" else run(case, gains, key, h=h, steps=1, rate0=rate0).command
    # The states of a method are some of q (0), rate (1) and previous command (2).
    sizes = {"cv": (0, 2), "av": (0,), "ca": (0, 1, 2)}.get(key, (0, 1))
    start = np.concatenate([q0, rate0, command0])

    def after_a_lap(state: np.ndarray) -> np.ndarray:
        task = case.system.position(state[:n]) - case.path(0.0)[0]
        made = run(case, gains, key, task, h=h, steps=steps, rate0=state[n : 2 * n], command0=state[2 * n :])
        return np.concatenate([made.q[-1], made.rate[-1], made.command])

    columns = [i + n * part for part in sizes for i in range(n)]
    M = np.zeros((len(columns), len(columns)))
    for j, column in enumerate(columns):
        moved = [start.copy(), start.copy()]
        moved[0][column] += disturbance
        moved[1][column] -= disturbance
        M[:, j] = ((after_a_lap(moved[0]) - after_a_lap(moved[1])) / (2.0 * disturbance))[columns]
    return st.spectral_radius(M)
