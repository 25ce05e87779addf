"""Targets as they arrive in a control loop: checked, with the motion from the last one to the next, and whether they stand."""

import math
from typing import NamedTuple

from .algebra import V3, put3
from .checks import rigid
from .clock import turn_left
from .jit import cached, inner
from .records import copy
from .session import samples_of
from .view import flat, view

TIGHT = 1e-9  # of a rotation accepted as it is: far stricter than the full check, outside the kernel, which corrects or refuses
READ, CHECK, REFUSED = range(3)  # a target that was read in full, one that is to be checked here, one that is no target
TAKEN, DOUBTFUL, HELD = range(3)  # taken; to be read in full; not finite, so the last target stays
STILL = 2e-3  # [m, or of a rotation] by which a target that stands may move in WAIT: 20 mm/s, or 0.014 rad/s
WAIT = 0.1  # [s]
RESTS = 5e-4  # [m/s, or of a rotation] up to which it is at rest: where its motion turns back it is that slow for a moment only
JUMP = 0.05  # [m, or of a rotation] from one target to the next by which it leaps: a fast hand moves by a fifth of it


class Stand(NamedTuple):
    """Whether a target stands. Before its first motion it counts as having leapt."""

    seconds: int  # [s] for which it has been where it is, give or take STILL
    leapt: int  # 1: it came there at once
    still: int  # 1: it hardly moved from the last sample to this one, or only trembles as measured targets do
    rest: int  # [s] for which it has been at rest; one that trembles, as measured ones do, never is
    known: int  # 1: what follows is known, F poses: where it is


STAND = Stand._make(range(len(Stand._fields)))  # places in the array


@inner
def finite(A):
    """Whether all numbers of A (K,) are."""
    total = 0.0
    for k in range(A.shape[0]):
        total += abs(A[k])
    return total < math.inf


@inner
def replace(T, V, A, source, place):
    """One sample becomes another."""
    copy(flat(T[source]), flat(T[place]))
    copy(V[source], V[place])
    copy(A[source], A[place])


@inner
def difference(T0, T1, dt, V, first):
    """Twist from one pose to another in dt, to V[first:]; of no turn it is exactly zero."""
    put3(V, first, V3(T1[0, 3] - T0[0, 3], T1[1, 3] - T0[1, 3], T1[2, 3] - T0[2, 3]) * (1.0 / dt))
    turned = False
    for r in range(3):
        for c in range(3):
            turned = turned or T0[r, c] != T1[r, c]
    put3(V, first + 3, turn_left(T0, T1) * (1.0 / dt) if turned else V3(0.0, 0.0, 0.0))


@inner
def gap(A, B, first):
    """How far numbers A (K,) are from those of B from `first` on, as one number."""
    total = 0.0
    for k in range(A.shape[0]):
        total += (A[k] - B[first + k]) ** 2
    return math.sqrt(total)


@inner
def look(T, stand, dt):
    """See whether targets T (2, F, 4, 4), dt [s] apart, stand; stand (5 + 16 F,) as of `Stand`."""
    at, first, now = STAND, len(STAND), flat(T[1])
    moved, most = gap(now, flat(T[0]), 0), STILL * dt / WAIT
    if stand[at.known] == 0.0 or moved > JUMP or gap(now, stand, first) > STILL:
        stand[at.leapt] = 1.0 if moved > JUMP or (stand[at.leapt] != 0.0 and moved <= most) else 0.0
        stand[at.seconds], stand[at.known] = 0.0, 1.0
        for k in range(now.shape[0]):
            stand[first + k] = now[k]
    else:
        stand[at.seconds] += dt
    stand[at.rest] = stand[at.rest] + dt if moved <= RESTS * dt else 0.0
    stand[at.still] = 1.0 if moved <= most or stand[at.seconds] >= WAIT else 0.0


@cached
def arrive(samples, given, stand, slot, how, posed, first, moved, twist, acceleration, dt):
    """Write the target of `given`, samples of length 1, into the last sample (slot 0) or the next (1) of `samples`.

    Blocks as of session.py; stand (5 + 16 F,) as of `Stand`, of the next. how: READ, CHECK or REFUSED; posed: bit f says that
    tip f has an orientation. first: any target may have come before; moved: the next target has become the last one; twist,
    acceleration: whether they are given, else the last two targets give a twist, in dt [s], and the acceleration is 0. Returns
    TAKEN, DOUBTFUL or HELD.
    """
    (_, T, V, A, _), (_, Ts, Vs, As, _) = samples_of(view(samples)), samples_of(view(given))
    if moved:
        replace(T, V, A, 1, 0)
    held = how == REFUSED or (twist and not finite(Vs[0])) or (acceleration and not finite(As[0]))
    for f in range(T.shape[1]):
        if not abs(Ts[0, f, 0, 3]) + abs(Ts[0, f, 1, 3]) + abs(Ts[0, f, 2, 3]) < math.inf:
            held = True
        elif how == CHECK and (posed >> f) & 1 and not rigid(Ts[0, f], TIGHT):
            return DOUBTFUL
    if held:
        copy(flat(T[0]), flat(T[1]))
        for k in range(V.shape[1]):
            V[1, k] = A[1, k] = 0.0
        return HELD
    for f in range(T.shape[1]):
        for r in range(4):
            for c in range(0 if (posed >> f) & 1 else 3, 4):
                T[slot, f, r, c] = Ts[0, f, r, c]
    if first and slot == 1:
        copy(flat(T[1]), flat(T[0]))
    for k in range(V.shape[1]):
        V[slot, k] = Vs[0, k] if twist else 0.0
        A[slot, k] = As[0, k] if acceleration else 0.0
    if slot == 1 and not twist:
        for f in range(T.shape[1]):
            difference(T[0, f], T[1, f], dt, V[1], 6 * f)
    if first and slot == 1:
        copy(V[1], V[0])
        copy(A[1], A[0])
    if slot == 1:
        look(T, stand, dt)
    return TAKEN
