"""The solvers of this package, one `Row` each: plain data with dotted names, so that listing them imports no solver."""

import math
import pkgutil
from dataclasses import dataclass
from typing import Any, NamedTuple

from ..errors import IKError, UnknownSolver


class Length(NamedTuple):
    """How many iterations and attempts a solver's search takes by default, and when it gives an attempt up.

    `give_up` is (C, rho, C_free, rho_free) or None: an attempt is given up at iteration k if the squared error |e|^2, lengths over
    the reach, exceeds C rho^k; C and rho are for attempts from the table of precomputed starts, C_free and rho_free for those
    from q0 and random starts. Attempts from random starts may take twice the iterations. From attempt number `patience` on (not
    counting the one from q0) this bound is loosened, because only hard targets get so far.
    """

    iterations: int = 1000  # largest number of iterations of an attempt
    attempts: int = 1
    give_up: tuple[float, float, float, float] | None = None
    patience: float = math.inf


LENGTH = Length()


@dataclass(frozen=True)
class Row:
    """The registry's entry for a solver: what is known without importing it.

    `target` is "module:Class" of the rule or closed form, `search` its default length, `several` the same for several tips if that
    differs. `pose` and `position` say whether it solves such targets. A solver that is `one_tip` is not for several tips; one that
    `moves_all` moves every joint, so none can be held by a weight of 0; one that `tracks` makes sense with one step per sample.
    `joints` are the numbers of joints that a closed form may fit, which 'auto' uses. `levels` is true of the solver that serves the
    option `priority`. `package` is the package it comes from, if not this one (see `registered`), `cls` the class if it need not be
    imported. A solver declares everything else itself (see `protocol`).
    """

    name: str
    target: str
    summary: str
    handles: str
    citation: str
    search: Length = LENGTH
    several: Length | None = None
    closed: bool = False
    pose: bool = True
    position: bool = True
    one_tip: bool = False
    moves_all: bool = False
    tracks: bool = True
    joints: tuple[int, ...] = ()
    levels: bool = False
    package: str = ""
    cls: Any = None

    def load(self) -> Any:
        """Import and return the class. Raises UnknownSolver if another package's class cannot be imported or is not a solver."""
        if self.cls is not None:
            return self.cls
        try:
            cls = pkgutil.resolve_name(self.target)
        except Exception as error:
            if not self.package or isinstance(error, IKError):
                raise
            what = f"{type(error).__name__}: {error}"
            raise UnknownSolver(f"solver '{self.name}' of package {self.package} cannot be loaded: {what}") from error
        if not hasattr(cls, "loop"):
            raise UnknownSolver(
                f"solver '{self.name}': {self.target} is not a solver; put @ik_toolkit.rule above the class"
            )
        return cls

    def length(self, tips: int = 1) -> Length:
        """Return the default limits on the length of a search for this number of tips."""
        return self.several if tips > 1 and self.several is not None else self.search


_RULES = "ik_toolkit.solvers.rules."
_CLOSED = "ik_toolkit.solvers.closed_form."
CLOSED_FORM: dict[str, Any] = dict(search=Length(0), closed=True, one_tip=True, moves_all=True, tracks=False)
ROWS: tuple[Row, ...] = (
    Row(
        "lm",
        _RULES + "jacobian:LM",
        "Levenberg-Marquardt: error-based damping, joint limits enforced, restarts from a table of starts (default)",
        "any robot; position, pose, masks",
        "Sugihara 2011",
        # The numbers in brackets are `give_up`, which ends a hopeless attempt early. They were measured on six arms; easy targets
        # are solved by attempt 20.
        search=Length(30, 250, (30.0, 0.18, 100.0, 0.35), 20),
        several=Length(40, 400, (60.0, 0.25, 200.0, 0.4)),
    ),
    Row(
        "dls",
        _RULES + "jacobian:DLS",
        "Damped least squares with constant damping",
        "any robot; position, pose, masks",
        "Wampler 1986",
    ),
    Row(
        "pinv",
        _RULES + "jacobian:Pinv",
        "Jacobian pseudo-inverse by singular values",
        "any robot; position, pose, masks",
        "Whitney 1969; Burrell 2016 eq. 7",
    ),
    Row(
        "transpose",
        _RULES + "jacobian:Transpose",
        "Jacobian transpose with the exact line-search gain",
        "any robot; position, pose, masks; slow near the solution",
        "Buss 2004; Burrell 2016 eq. 11-12",
        search=Length(5000),
    ),
    Row(
        "newton",
        _RULES + "jacobian:Newton",
        "Newton-Raphson, plain or with a line search; stops where the Jacobian has no inverse",
        "square tasks only: as many task rows as joints",
        "Chinyai eq. 6-9",
        search=Length(100),
        one_tip=True,
        moves_all=True,
        tracks=False,
    ),
    Row(
        "ccd",
        _RULES + "ccd:CCD",
        "Cyclic coordinate descent, one joint at a time from the tip",
        "any robot; position exact per joint, pose by least squares per joint",
        "Wang and Chen 1991; Olsen and Petersen 2011",
    ),
    Row(
        "pid",
        _RULES + "pid:PID",
        "IK-PID: each joint's step from a PID law on the error, its sign found by trial",
        "any robot; position, pose with scaled orientation",
        "Burrell 2016, Algorithm I",
    ),
    Row(
        "state-space",
        _RULES + "state_space:StateSpace",
        "A static linear system maps the error to joint increments, no Jacobian",
        "any robot; position (B n x 3) or pose (B n x 6)",
        "Burrell 2016, Algorithm II",
        one_tip=True,
    ),
    Row(
        "sqp",
        _RULES + "sqp:SQP",
        "Sequential quadratic programming: errors in order of priority, with exact second derivatives (option priority)",
        "any robot; pose, masks, several tips; an arm with fewer joints than the target fixes",
        "Nocedal and Wright 2006, ch. 18",
        # If the arm has as many joints as the target has errors, the first 48 attempts reduce all errors together, the remaining 30
        # in order of priority.
        search=Length(40, 78, (30.0, 0.18, 100.0, 0.35), 20),
        several=Length(60, 108, (60.0, 0.25, 200.0, 0.4)),
        tracks=False,
        levels=True,
    ),
    Row(
        "planar-2r",
        _CLOSED + "planar_2r:Planar2R",
        "Closed form of a planar two-link arm: both elbow branches; returns the one within limits nearest q0",
        "two revolute joints with parallel axes (recognised by geometry); position",
        "Chinyai eq. 1-5, corrected",
        **CLOSED_FORM,
        pose=False,
        joints=(2,),
    ),
    Row(
        "inspection",
        _CLOSED + "inspection:Inspection",
        "Closed form of a spherical shoulder on a lift: 8 branches at each lift; returns the one within limits nearest q0",
        "a lift and six revolute joints of the inspection robot's structure (recognised by geometry); pose",
        "Shanmugasundar 2012 eq. 7-13, completed",
        **CLOSED_FORM,
        position=False,
        joints=(6, 7),
    ),
    Row(
        "elimination",
        _CLOSED + "elimination:Elimination",
        "Every solution by elimination, with a certificate that it is all; returns the one within limits nearest q0",
        "any six revolute joints; pose",
        "Raghavan and Roth 1993; Manocha and Canny 1994",
        **CLOSED_FORM,
        position=False,
    ),
    Row(
        "eaik",
        _CLOSED + "eaik:EAIK",
        "All solutions of the EAIK package, re-evaluated; returns the one within limits nearest q0",
        "six revolute joints of a structure EAIK decomposes (extra `analytic`); pose",
        "Ostermeier, Kuelz, Althoff 2025",
        **CLOSED_FORM,
        position=False,
    ),
)
