"""The tracking methods and their options, and a runner for systems that are not robots.

Four methods are published (Patko and Zelei, 2019) and one is ours. With e = target - actual (the paper has the opposite
sign), J^+ the (damped) pseudo-inverse, qd the joint rates, v and a_d the target's velocity and acceleration, and s =
J^+ (target one step ahead - actual):

    cv   u = J^+ (v + kappa e),                                  Adams-Bashforth 2 on the joint rate        (11), (29)
    av   q' = q + s                                              one Newton step                            (16)
    ca   a = J^+ (a_d + kd (v - J qd) + kp e - Jdot qd),         AB2 on the rate, trapezoid on the angle    (21), (32),
        (33)
    aa   a = 2 s / h^2 - 2 J^+ J qd / h - J^+ Jdot(x) y,         trapezoid                                  (25)-(27)
    aad  a = (s/h - J^+ J qd) / (gamma h) - J^+ Jdot(w) w / (2 gamma),   q' = q + h qd + gamma h^2 a        ours

Eqs (29) and (32) print the indices i+1 and i. They must mean "the command computed now, and the one before", as only this
gives the paper's matrices. The text does not say at which rates x, y the term Jdot(x) y of (25) is taken. With w = s/h +
(1 - J^+ J) qd there are three interpretations, 1: Jdot(qd) qd (first line of (25)), 2: Jdot(qd) w (second line; the default,
as the paper ends with this form), 3: Jdot(w) w. `aa` keeps an eigenvalue -1, so its rate may zigzag for ever; `aad` with
gamma > 1/2 damps this zigzag at the same accuracy.

av, aa and aad remove the whole error in one step, or a share of it (our addition):
s = J^+ (target one step ahead - actual - (1 - share) e).

On a redundant arm the acceleration level adds -k (1 - J^+ J) qd (null_damping k), without which null-space motion
grows.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, near_match
from ..validate import number, one_of
from . import laws, viability
from .command import TAKEN_UP
from .orbit_stability import null_rate
from .stability import DEFAULT, best_gains

# [arm reaches per rad] default damping of the pseudo-inverse; joint speed per tip speed then stays below 1 / (2 * 0.02)
DAMPING = 0.02
# [1/s] default damping of null-space motion; with less, the joints drift during one lap of a path to where the next one is harder
NULL_DAMPING = TAKEN_UP

# For each tracking method: its code in the compiled loop, its options, and a description of one line.
METHODS: dict[str, tuple[int, tuple[str, ...], str]] = {
    "cv": (laws.LAW.cv, ("kappa",), "velocity level, error fed back with kappa (classical)"),
    "av": (laws.LAW.av, ("share",), "one Newton step a sample (alternative velocity level)"),
    "ca": (laws.LAW.ca, ("kp", "kd", "null_damping"), "acceleration level, error fed back with kp and kd (classical)"),
    "aa": (
        laws.LAW.aa,
        ("reading", "share", "null_damping"),
        "acceleration that removes the error in one step (alternative)",
    ),
    "aad": (laws.LAW.aa, ("gamma", "share", "null_damping"), "aa with its zigzag damped, gamma > 1/2 (ours)"),
}


@dataclass(frozen=True)
class Method:
    """A tracking method and its options; None means the default, which may depend on the sample time.

    kappa [1/s] (method cv), kp [1/s^2] and kd [1/s] (ca): gains, not negative; by default the best ones for the sample time.
    share (av, aa, aad): part of the error that a step removes, above 0 and at most 1; default 1, the published form. reading
    (aa): 1, 2 or 3, how dJ/dt is read in eq (25) of Patko and Zelei. gamma (aad): weight of the new rate in a step. null_damping
    [1/s]: damping of null-space motion at acceleration level, for redundant arms; in steps of h it is at most 1/h (ca: 2/3 of
    that). damping [arm reaches per rad]: damping of the pseudo-inverse near singularities; 0 inverts exactly.
    """

    name: str
    kappa: float | None = None
    kp: float | None = None
    kd: float | None = None
    reading: int = 2
    gamma: float = DEFAULT.gamma
    share: float | None = None
    null_damping: float = NULL_DAMPING
    damping: float = DAMPING

    def __post_init__(self) -> None:
        """Check the name and the options. Raises InvalidOption."""
        one_of(self.name, METHODS, "tracking method")
        for name in ("kappa", "kp", "kd", "reading", "gamma", "share", "null_damping", "damping"):
            value = getattr(self, name)
            if value is not None or name not in ("kappa", "kp", "kd", "share"):
                number(value, name)
        if self.name == "ca" and (self.kp is None) != (self.kd is None):
            raise InvalidOption("ca needs both kp and kd, or neither")
        if self.reading not in (1, 2, 3):
            raise InvalidOption(f"reading must be 1, 2 or 3 (see the docs of aa), not {self.reading}")
        if self.gamma <= 0.0:
            raise InvalidOption(f"gamma must be positive, not {self.gamma:g}")
        if self.share is not None and not 0.0 < self.share <= 1.0:
            raise InvalidOption(f"share must be above 0 and at most 1, not {self.share:g}")
        for name in ("kappa", "kp", "kd", "null_damping", "damping"):
            if (getattr(self, name) or 0.0) < 0.0:
                raise InvalidOption(f"{name} must not be negative, not {getattr(self, name):g}")

    def gains(self, h: float) -> dict[str, float]:
        """Return the gains in use at sample time h [s], by name."""
        best = best_gains(self.name, h)
        given = {"kappa": self.kappa, "kp": self.kp, "kd": self.kd, "gamma": self.gamma, "share": self.share}
        return {name: best[name] if given[name] is None else float(given[name] or 0.0) for name in best}

    @property
    def velocity_level(self) -> bool:
        """Whether the joint rate, not its derivative, is commanded.

        Joints then move at constant rate between samples.
        """
        return self.name in ("cv", "av")

    @property
    def rate_weight(self) -> float:
        """Weight gamma of the new rate in a step: q' = q + h ((1 - gamma) rate + gamma rate')."""
        return 1.0 if self.velocity_level else self.gamma if self.name == "aad" else 0.5


@functools.lru_cache(maxsize=64)  # The same few step lengths come again and again, and choosing gains takes time.
def pack_law(method: Method, h: float) -> np.ndarray:
    """Return a method and its gains at sample time h [s] as an array for the compiled loop, in the order of the fields of `Law`.

    Entries that the tracker sets, not the method, are 0.
    """
    gains = method.gains(h)
    law = laws.Law(*np.zeros(len(laws.Law._fields)))._replace(
        code=METHODS[method.name][0],
        kappa=gains.get("kappa", 0.0),
        kp=gains.get("kp", 0.0),
        kd=gains.get("kd", 0.0),
        gamma=method.rate_weight,
        null=null_rate(method.name, method.null_damping, h),
        omit=1.0 - gains.get("share", 1.0),
        damping=method.damping,
        reading=laws.READING.at_step if method.name == "aad" else method.reading - 1,
    )
    packed = np.array(law, dtype=float)
    packed.flags.writeable = False
    return packed


def make_method(method: str | Method, **options: Any) -> Method:
    """Return a tracking method (cv, av, ca, aa, aad), given by name or as a Method, with some of its options replaced.

    Raises InvalidOption for an unknown name or option, and for a value that is out of range.
    """
    made = method if isinstance(method, Method) else Method(method)
    allowed = (*METHODS[made.name][1], "damping")
    for option in options:
        if option not in allowed:
            raise InvalidOption(f"{made.name} has no option '{option}'.{near_match(option, allowed)}")
    # `number` refuses None, which would silently mean the default here.
    return replace(made, **{option: number(value, option) for option, value in options.items()})


class System(NamedTuple):
    """Any system with m task coordinates and n joints that `simulate` can control, given by three functions.

    position(q) -> (m,); jacobian(q) -> (m, n); rate(q, x, y) -> (m,) is the product (dJ/dt) y while the joints move at
    rates x.
    """

    position: Callable[[np.ndarray], np.ndarray]
    jacobian: Callable[[np.ndarray], np.ndarray]
    rate: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Run(NamedTuple):
    """Result of `simulate`: joints and errors at the N + 1 samples that were reached.

    t (N + 1,) [s]: times; q, rate (N + 1, n): joint values and rates; error (N + 1, m): target minus actual; command (n,): last
    command of methods cv and ca;
    gamma: weight of the new rate in a step; stopped: a sentence if the run ended early, else ''.
    """

    t: np.ndarray
    q: np.ndarray
    rate: np.ndarray
    error: np.ndarray
    command: np.ndarray
    gamma: float
    stopped: str

    def between(self, system: System, path: Callable[[float], np.ndarray], fractions: np.ndarray) -> np.ndarray:
        """Return the norms (N, k) of the errors between samples, at fractions (k,) of each of N steps.

        path: the target's position (m,) as a function of time [s]. Joints are taken to move as the method assumes.
        """
        h = self.t[1] - self.t[0]
        out = np.empty((len(self.t) - 1, len(fractions)))
        for j, f in enumerate(fractions):
            q = interpolate(self.q, self.rate, self.gamma, h, f)
            out[:, j] = [
                np.linalg.norm(path(t) - system.position(x)) for t, x in zip(self.t[:-1] + f * h, q, strict=True)
            ]
        return out


def interpolate(q: np.ndarray, rate: np.ndarray, gamma: float, h: float, f: float) -> np.ndarray:
    """Return joint values (N, n) a fraction f into each step: linear if gamma is 1, else of constant acceleration.

    q, rate (N + 1, n): joint values and rates at the samples; gamma: weight of the new rate in a step; h [s]: length of a step.
    """
    d = np.diff(q, axis=0)
    return q[:-1] + f * d if gamma == 1.0 else q[:-1] + f * (1.0 - f) * h * rate[:-1] + f * f * d


def simulate(
    system: System,
    path: Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]],
    method: str | Method,
    h: float,
    steps: int,
    q0: np.ndarray,
    *,
    rate0: np.ndarray | None = None,
    command0: np.ndarray | None = None,
    runaway: float = 1e6,
    **options: Any,
) -> Run:
    """Track a target on any system, not only a robot, by a method (cv, av, ca, aa, aad), with the same steps as on a robot.

    Args:
        system: The system.
        path: The target's position, velocity and acceleration (m,) as a function of time [s].
        method: A Method or its name.
        h: Sample time [s].
        steps: Number of steps.
        q0: Joint values (n,) at the start.
        rate0: Joint rates (n,) at the start; default J^+ velocity(0).
        command0: Method cv or ca: the command (n,) before the first one; default equal to the first (Euler), as the
            paper gives none.
        runaway: Largest move of a joint in one step; beyond it the run ends.
        options: Options of the method; damping is 0 by default here, which inverts J exactly.

    Returns:
        The run. It ends early, with a sentence, when a value is not finite (q left the domain) or a joint runs away.
    """
    made = make_method(method, **{"damping": 0.0, **options})
    p = laws.Law._make(pack_law(made, h).tolist())
    q = np.array(q0, dtype=float)
    n, m = len(q), len(system.position(q))
    k = max(n, m)
    G, y, bias, joints = np.empty((k, k)), np.empty(k), np.zeros(m), laws.JointMotion(*np.empty((5, n)))
    prev = np.zeros(n) if command0 is None else np.array(command0, dtype=float)
    target, v, a = path(0.0)
    rate = np.zeros(n) if rate0 is None else np.array(rate0, dtype=float)
    if rate0 is None:
        J = np.ascontiguousarray(system.jacobian(q).T)
        laws.factor(J, m, made.damping, G, y)
        laws.apply(J, m, G, v, y, rate)
    Q, R, E, stopped = [q.copy()], [rate.copy()], [target - system.position(q)], ""
    for i in range(steps):
        J = np.ascontiguousarray(system.jacobian(q).T)
        following = path((i + 1) * h)
        ahead = following[0] - system.position(q)
        laws.factor(J, m, made.damping, G, y)
        inverse, aim = laws.PseudoInverse(J, G, G, y, np.empty(m)), laws.TargetMotion(E[-1], ahead, v, a, bias)
        laws.prepare(p, inverse, aim, rate, h, joints)
        if p.code >= laws.LAW.ca:
            bias[:] = system.rate(q, joints.x1, joints.x2)
        ratio = 0.0 if i == 0 and command0 is None else 1.0
        laws.command(p, inverse, aim, rate, prev, h, ratio, joints)
        x = joints.x
        if not (np.isfinite(x).all() and np.abs(x).max() * h <= runaway):
            stopped = f"the step at t = {i * h:.6g} s is not finite or moves a joint by more than {runaway:g}"
            break
        viability.move(q, rate, x, p.gamma, h)
        target, v, a = following
        error = target - system.position(q)
        if not np.isfinite(error).all():
            stopped = f"q left the domain of the system at t = {(i + 1) * h:.6g} s"
            break
        Q.append(q.copy())
        R.append(rate.copy())
        E.append(error)
    return Run(np.arange(len(Q)) * h, np.array(Q), np.array(R), np.array(E), prev, float(p.gamma), stopped)
