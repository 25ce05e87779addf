"""Which joint rates the limits allow, near those wanted."""

# numba's own types know neither options in a dict nor that overloads and intrinsics are called by numba.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import numpy as np
from numba.extending import overload

from ..compile.jit import INLINE, inline
from ..kernel.records import copy
from .command import Published
from .constrained_step import LEAVE, SHORT, WANTED, Allowed, StepTaken, TaskRate, constrain
from .laws import CLIP, NOT_FINITE, RUNAWAY, STATE
from .null_space_motion import PRESSED
from .singular_step import along_lost, by_modes
from .viability import RECOVERING, ROW, box_of, clip

LARGEST = 1e300  # sum of joint speeds above which they cannot be followed


@inline
def judge(wanted, h, p, state):
    """Set the joint speeds `wanted` to zero where they cannot be followed or the arm brakes; returns whether to stop, to hold."""
    largest = 0.0
    for k in range(wanted.shape[0]):
        largest += abs(wanted[k])
    bad = not largest < LARGEST
    still = p.brake > 0.0 or (bad and p.runaway == np.inf)
    if still:
        for k in range(wanted.shape[0]):
            wanted[k] = 0.0
    elif bad or (p.mode == CLIP and largest * h > p.runaway * wanted.shape[0]):  # otherwise the box decides
        state[STATE.stop] = NOT_FINITE if bad else RUNAWAY
        return True, still
    return False, still


@inline
def by_constraints(law, s, count, mu, h, state, work, active, kept, code):
    """Rates that the limits allow, to s.x; returns whether anything prevented those wanted.

    mu above 0: those of a step down, which `descend` has asked for.
    """
    n, m = s.J.shape
    mode, size = int(law.mode), s.size
    if mu > 0.0:
        mode, size = LEAVE, s.even
    else:
        for k in range(m):
            s.ask[k] = -s.f[k]
            for i in range(n):
                s.ask[k] += s.J[i, k] * s.x[i]
        for i in range(n):
            s.v[i] = 0.0
        along_lost(s.V, s.lost, s.xk, s.v, 1.0)
        by_modes(s.J, s.W, s.U, s.lost, s.f, s.ask, s.y)
    copy(s.x, s.w)
    allowed, taken = Allowed(s.floor, s.roof, s.planes, s.edges, count), StepTaken(s.x, active, kept, s.multiplier)
    asked = TaskRate(s.J, s.weight, s.ask, s.f, s.w, s.v, size, mode, h, mu)
    status, _ = constrain(asked, allowed, work, taken)
    if status >= SHORT:
        state[STATE.pressed] = PRESSED
    for i in range(n):
        code[i] = (s.why_low[i] | s.why_top[i]) & RECOVERING
        if status != WANTED and active[i] == 1:
            code[i] = s.why_top[i]
        elif status != WANTED and active[i] == -1:
            code[i] = s.why_low[i]
    for k in range(int(law.rows)):
        if status != WANTED and kept[k] != 0:
            most = 0
            for i in range(n):
                if abs(s.planes[k, i]) > abs(s.planes[k, most]):
                    most = i
            code[most] = code[most] | ROW
    return status != WANTED


@inline
def by_clipping(law, s, count, mu, h, state, work, active, kept, code):
    """The same for a solver's rule: each joint on its own. (`constrain` in each rule's loop would take a minute to compile.)"""
    clip(s.x, box_of(s), code)
    return False


def obey(rule, law, s, count, mu, h, state, work, active, kept, code):
    """Rates that the limits allow, see `by_constraints`."""
    how = by_constraints if isinstance(rule, Published) else by_clipping
    return how(law, s, count, mu, h, state, work, active, kept, code)


@overload(obey, jit_options=INLINE)
def _obey(rule, law, s, count, mu, h, state, work, active, kept, code):
    how = by_constraints if rule.instance_class is Published else by_clipping
    return lambda rule, law, s, count, mu, h, state, work, active, kept, code: how(
        law, s, count, mu, h, state, work, active, kept, code
    )
