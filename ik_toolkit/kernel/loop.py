"""The one iteration loop, compiled once per rule.

A rule is a NamedTuple class (its fields document the parameters) and one function registered for it with `@rule`. The
class is the type that selects the compiled loop: one source of the loop, no call overhead, and a disk cache that works
between processes, because a class is pickled by reference. With NUMBA_DISABLE_JIT=1 the same code runs as plain Python.

Order in every iteration: evaluate, best-so-far, test, budget, give up, step, limits, integrate, stall. The q reported is
always one that was evaluated. Restarts wrap the loop.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from .checks import (
    BAD_START,
    BAD_TARGET,
    CONVERGED,
    ITERATION_LIMIT,
    LIMIT_BLOCKED,
    NOT_FINITE,
    SINGULAR,
    STALLED,
    TOO_FAR,
    UNREACHABLE,
    beyond,
    edge,
    rigid,
    why,
)
from .jit import OPTIONS, cached, inline
from .kinematics import TAU, aim, chord, columns, error, fk, rotation_angle
from .limits import face, held_back, hold, integrate, legal, neighbourhood, turn
from .seeds import BEST, nearest, rnd, sow
from .slots import (
    O_C,
    O_C_FREE,
    O_CLOSEST,
    O_DESCENTS,
    O_EVALUATIONS,
    O_FOLLOW,
    O_FOLLOW_SLIDE,
    O_GIVEN,
    O_HOLD,
    O_ITERATIONS,
    O_KIND,
    O_LIMITS,
    O_RHO,
    O_RHO_FREE,
    O_SEED,
    O_STALL,
    O_TOL_P,
    O_TOL_R,
    O_W,
    OPT_HEAD,
    OUT_HEAD,
    R_ATTEMPT,
    R_EVALUATIONS,
    R_EXCESS,
    R_HISTORY,
    R_ITERATIONS,
    R_POSITION,
    R_RESTARTS,
    R_ROTATION,
    R_STATUS,
    vectors,
)
from .task import AXIS, MASK_BASE, MASK_TIP, POSE, POSITION, shape_columns, shape_error

SINGULAR_STEP, WAITING = -1, -2  # what a rule may return instead of a count of evaluations

# Near a singular pose the iteration converges too slowly for the give-up of the first attempts. From this attempt on each has
# twice the iterations and is given up later, so that hard targets are not lost and easy ones cost what they did.
PATIENT, PATIENT_RHO = 20, 0.6

Array = np.ndarray


class Step(NamedTuple):
    """What a step rule sees. Lengths are divided by the chain's scale; axes are those of the first joint.

    Few arrays on purpose: each costs reference counting in the hot loop.
    """

    q: Array  # (n,) current coordinates
    dq: Array  # (n,) to be written
    w: Array  # (n,) joint weights; 0 holds a joint in this step
    J: Array  # (n, 6) Jacobian, one joint a row, linear part first; may be overwritten
    x: Array  # (4 n + 8,) state of the rule, zeroed at the start of a descent
    V: Array  # (6, 6) scratch
    y: Array  # (6,) scratch


class Sweep(NamedTuple):
    """What a sweep rule sees: it moves one joint at a time, so it evaluates the chain itself (`try_out`)."""

    q: Array  # (n,) current coordinates; a sweep may write it and puts it back
    dq: Array  # (n,) to be written
    w: Array  # (n,) 0 holds a joint
    x: Array  # (4 n + 8,) state of the rule, zeroed at the start of a descent
    lower: Array
    upper: Array
    unit: Array  # (n,) 1 for an angle, the chain's scale for a slide
    rows: Array
    ends: Array
    tip: Array  # (12,)
    goal: Array  # (12,) see kinematics.aim
    mask: Array  # (6,)
    Z: Array
    ang: Array
    sn: Array
    cs: Array
    V: Array
    y: Array
    opt: Array


class Err(NamedTuple):
    """Error target - tip: position, 2 sin(angle/2) * axis, and the squared norm of all six."""

    e0: float
    e1: float
    e2: float
    e3: float
    e4: float
    e5: float
    pp: float
    rr: float
    ee: float


RULES: dict[type, Callable] = {}
SWEEPS: set[type] = set()
FREE: set[type] = set()  # rules that read no Jacobian


def rule(cls: type, *, sweep: bool = False, jacobian: bool = True) -> Callable:
    """Register the decorated function f(cls, p, s, e) as the step of the rule class `cls`.

    p: parameters; s: Step, or Sweep; e: Err. It writes s.dq and returns the number of FK evaluations it made itself (0),
    SINGULAR_STEP, or WAITING (a step of zero that is no stall). It never tests convergence, counts or clips for the caller.
    jacobian=False: the rule reads no s.J, and the loop saves itself the work (a sweep never gets one). At a limit a joint
    stops. A class attribute `hold = True` redoes the step without the joints it would push past theirs; `wrap = True` lets a
    bounded joint with a full turn or more go on from the other end of its range.
    """

    def add(function: Callable) -> Callable:
        RULES[cls] = function
        if sweep:
            SWEEPS.add(cls)
        if sweep or not jacobian:
            FREE.add(cls)
        return function

    return add


def step(cls, p, s, e):
    """Call the rule's function (plain Python; numba resolves it by class at compile time)."""
    return RULES[cls](cls, p, s, e)


@overload(step, jit_options=dict(OPTIONS, forceinline=True))  # type: ignore[arg-type]
def _step(cls, p, s, e):
    return RULES[cls.instance_class]


@inline
def measure(rows, ends, tip, goal, w, kind, q, Z, ang, sn, cs, V, y):
    """Evaluate the chain at q: tip point, and the error with what does not count set to zero."""
    x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz = fk(rows, q, Z, ang, sn, cs)
    px, py, pz, e0, e1, e2, e3, e4, e5 = error(goal, tip, x0, x1, x2, y0, y1, y2, z0, z1, z2, px, py, pz)
    if kind != POSE:
        e0, e1, e2, e3, e4, e5 = shape_error(
            kind, w, ends, goal, V, y, x0, x1, x2, y0, y1, y2, z0, z1, z2, e0, e1, e2, e3, e4, e5
        )
    pp = e0 * e0 + e1 * e1 + e2 * e2
    rr = e3 * e3 + e4 * e4 + e5 * e5
    return px, py, pz, Err(e0, e1, e2, e3, e4, e5, pp, rr, pp + rr)


ENTRIES: dict[type, Callable] = {}


def entry(cls: type) -> Callable:
    """Return the compiled loop of a rule class: solve(rows, ends, seeds, feat, T, Q0, out, opt, hist).

    T (N, 4, 4) [m]; Q0 (1 or N, n) start if opt[O_GIVEN], and the turn nearest to it is returned; out (N, OUT_HEAD + n);
    hist (H, 2 + n) receives position error, orientation error and q of each evaluation (H may be 0).
    """
    if cls in ENTRIES:
        return ENTRIES[cls]
    sweeping = cls in SWEEPS
    using_jacobian = cls not in FREE

    def solve(rows, ends, seeds, feat, T, Q0, out, opt, hist):
        L = rows.shape[0]
        n = seeds.shape[1]
        Lp = (L + 3) // 4 * 4
        tip = ends[12:24]
        lower, upper, turns, unit, low, span, home, tail = vectors(ends, n)
        scale = tail[0]
        q = np.empty(n)
        dq = np.empty(n)
        w = np.empty(n)
        x = np.empty(4 * n + 8)
        J = np.empty((n, 6))
        Z = np.empty((L, 6))
        ang = np.zeros(Lp)
        sn = np.empty(Lp)
        cs = np.empty(Lp)
        goal = np.empty(12)
        V = np.empty((6, 6))
        y = np.empty(6)
        target = np.empty(3)
        best_q = np.empty(n)
        q_found = np.empty(n)
        score = np.empty(seeds.shape[0], np.float32)
        val = np.empty(BEST, np.float32)
        best = np.empty(BEST, np.int64)
        state = np.empty(1, np.uint64)
        kind = int(opt[O_KIND])
        given = int(opt[O_GIVEN])
        following = opt[O_FOLLOW] > 0.0
        # The box of a step: the limits, or with `follow` what lies near the start, and there no full turn is taken.
        low_q = np.empty(n) if following else lower
        high_q = np.empty(n) if following else upper
        whole_turns = np.zeros(n) if following else turns
        limits = opt[O_LIMITS] > 0.0
        boxed = limits or following
        holding = boxed and opt[O_HOLD] > 0.0
        iterations = int(opt[O_ITERATIONS])
        closest = int(opt[O_CLOSEST])
        jw = opt[OPT_HEAD : OPT_HEAD + n]
        mask = opt[O_W : O_W + 6]
        p = opt[OPT_HEAD + n :]
        if sweeping:
            s = Sweep(q, dq, w, x, low_q, high_q, unit, rows, ends, tip, goal, mask, Z, ang, sn, cs, V, y, opt)
        else:
            s = Step(q, dq, w, J, x, V, y)
        tol_p = opt[O_TOL_P] / scale
        tp = tol_p * tol_p
        tr = opt[O_TOL_R] * opt[O_TOL_R] if kind == MASK_BASE or kind == MASK_TIP else chord(opt[O_TOL_R])
        for t in range(T.shape[0]):
            given_row = t if Q0.shape[0] > 1 else 0
            if not rigid(T[t]):
                out[t, R_STATUS] = BAD_TARGET
                continue
            if (given > 0 or closest > 0) and not legal(Q0[given_row], unit, lower, upper, turns, limits):
                out[t, R_STATUS] = BAD_START
                continue
            if following:
                start = Q0[given_row]
                neighbourhood(
                    start, rows, opt[O_FOLLOW], opt[O_FOLLOW_SLIDE], unit, limits, lower, upper, turns, low_q, high_q
                )
            sow(state, opt[O_SEED])
            aim(ends, tip, scale, T[t], goal)
            excess = beyond(goal, tip, tail, kind, tol_p, opt[O_TOL_R])
            descents = int(opt[O_DESCENTS])
            if excess > 0.0:  # aim at the edge of the reach instead: there the damping vanishes and the descent is fast
                descents = min(descents, 3)
                edge(goal, tail, excess, target)
            wp = 1.0
            wr = 0.0 if kind == POSITION else 1.0
            if kind > POSITION:
                wp = 1.0 if opt[O_W] + opt[O_W + 1] + opt[O_W + 2] > 0.0 or kind == AXIS else 0.0
                wr = 1.0 if kind != AXIS and opt[O_W + 3] + opt[O_W + 4] + opt[O_W + 5] > 0.0 else 0.0
            status = STALLED
            held = -1
            total = 0
            count = 0
            tries = 0
            best_try = 0
            found_try = 0
            rows_h = 0
            best_ee = np.inf
            best_pp = np.inf
            best_rr = np.inf
            for i in range(n):
                best_q[i] = Q0[given_row, i] / unit[i] if given > 0 else home[i]
            found = 0
            found_distance = np.inf
            found_pp = 0.0
            found_rr = 0.0
            while tries < descents:
                c = opt[O_C_FREE]
                rho = opt[O_RHO_FREE]
                most = iterations
                if tries < given:
                    for i in range(n):
                        q[i] = Q0[given_row, i] / unit[i]
                else:
                    k = tries - given
                    if k == 0:
                        nearest(feat, goal, wp, wr, score, val, best)
                    if k < BEST:
                        for i in range(n):
                            q[i] = seeds[best[k], i]
                        c = opt[O_C]
                        rho = opt[O_RHO]
                    else:
                        for i in range(n):
                            q[i] = low[i] + span[i] * rnd(state)
                        if k >= PATIENT and c < np.inf:
                            most = 2 * iterations
                            rho = PATIENT_RHO
                for i in range(x.shape[0]):
                    x[i] = 0.0
                tries += 1
                ended = ITERATION_LIMIT
                solved = False
                still = False
                for k in range(most + 1):
                    px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                    count += 1
                    if rows_h < hist.shape[0]:
                        hist[rows_h, 0] = math.sqrt(e.pp) * scale
                        hist[rows_h, 1] = rotation_angle(e.rr)
                        for i in range(n):
                            hist[rows_h, 2 + i] = q[i] * unit[i]
                        rows_h += 1
                    if e.ee < best_ee:
                        best_ee = e.ee
                        best_pp = e.pp
                        best_rr = e.rr
                        best_try = tries - 1
                        for i in range(n):
                            best_q[i] = q[i]
                    if e.pp < tp and e.rr < tr:
                        solved = True
                        break
                    if not e.ee < 1e300:
                        ended = NOT_FINITE
                        break
                    if k == most or count >= opt[O_EVALUATIONS]:
                        break
                    if e.ee > c and e.ee > 1e-9 and excess == 0.0:
                        ended = STALLED
                        break
                    c *= rho
                    if using_jacobian:
                        columns(rows, Z, J, px, py, pz)
                        if kind != POSE:
                            shape_columns(kind, mask, V, y, J)
                    for i in range(n):
                        w[i] = jw[i]
                    for _ in range(2):
                        r = step(cls, p, s, e)
                        if not (holding and hold(q, dq, w, low_q, high_q)):
                            break
                    if r == -1:
                        ended = SINGULAR
                        break
                    if r > 0:
                        count += r
                    total += 1
                    moved, far = integrate(q, dq, boxed, low_q, high_q, whole_turns)
                    if not far < 1e6:
                        ended = NOT_FINITE
                        break
                    if moved <= opt[O_STALL] and r != -2:
                        ended = STALLED
                        still = True
                        break
                status = ended
                if solved and excess > 0.0:
                    status = UNREACHABLE
                    break
                if solved:
                    if closest == 0:
                        status = CONVERGED
                        break
                    found += 1
                    d = 0.0
                    for i in range(n):
                        a = q[i] - Q0[given_row, i] / unit[i]
                        if turns[i] > 0.0:
                            a += TAU * turn(-a, q[i], lower[i], upper[i], turns[i])
                        d += a * a / max(jw[i], 1e-12)
                    if d < found_distance:
                        found_distance = d
                        found_pp = e.pp
                        found_rr = e.rr
                        found_try = tries - 1
                        for i in range(n):
                            q_found[i] = q[i]
                    if found >= closest:
                        break
                if count >= opt[O_EVALUATIONS]:
                    break
            if found > 0:
                status = CONVERGED
                best_pp = found_pp
                best_rr = found_rr
                best_try = found_try
                for i in range(n):
                    best_q[i] = q_found[i]
            if status == CONVERGED and found == 0:
                best_pp = e.pp
                best_rr = e.rr
                best_try = tries - 1
                for i in range(n):
                    best_q[i] = q[i]
            elif status != CONVERGED:
                if excess > 0.0:
                    status = UNREACHABLE
                    goal[9], goal[10], goal[11] = target[0], target[1], target[2]
                    for i in range(n):
                        q[i] = best_q[i]
                    px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                    count += 1
                    best_pp = e.pp
                    best_rr = e.rr
                elif count >= opt[O_EVALUATIONS] and status != NOT_FINITE:
                    status = ITERATION_LIMIT
                elif (descents > 1 or following or still) and status != NOT_FINITE:
                    for i in range(n):
                        q[i] = best_q[i]
                    px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                    columns(rows, Z, J, px, py, pz)
                    if kind != POSE:
                        shape_columns(kind, mask, V, y, J)
                    count += 1
                    reason = why(q, low_q, high_q, J, e, boxed)
                    if following:
                        held = held_back(q, low_q, high_q, lower, upper, turns, limits, J, e)
                    if held >= 0:
                        status = TOO_FAR
                    elif descents > 1:
                        status = LIMIT_BLOCKED if reason == LIMIT_BLOCKED else STALLED
                    elif still:
                        status = reason
            # Of the same answer several turns away, give the legal one nearest the start (or home).
            for i in range(n):
                q[i] = best_q[i]
                dq[i] = Q0[given_row, i] / unit[i] if given > 0 or closest > 0 else home[i]
            shifted = limits and not following and face(q, dq, lower, upper, turns)
            if shifted:
                px, py, pz, e = measure(rows, ends, tip, goal, mask, kind, q, Z, ang, sn, cs, V, y)
                count += 1
                if status != CONVERGED or (e.pp < tp and e.rr < tr):
                    best_pp = e.pp
                    best_rr = e.rr
                else:  # rounding of the turn broke a tolerance at the edge: keep the evaluated one
                    for i in range(n):
                        q[i] = best_q[i]
            out[t, R_STATUS] = status
            out[t, R_ITERATIONS] = total
            out[t, R_RESTARTS] = tries - 1
            out[t, R_POSITION] = math.sqrt(best_pp) * scale
            out[t, R_ROTATION] = (
                math.sqrt(best_rr) if kind == MASK_BASE or kind == MASK_TIP else rotation_angle(best_rr)
            )
            out[t, R_EVALUATIONS] = count
            out[t, R_HISTORY] = rows_h
            out[t, R_EXCESS] = held if held >= 0 else excess * scale
            out[t, R_ATTEMPT] = best_try
            for i in range(n):
                out[t, OUT_HEAD + i] = q[i] * unit[i]

    ENTRIES[cls] = cached(solve, cls, RULES[cls])
    return ENTRIES[cls]
