"""Targets as they arrive in a control loop: checked, with the motion from the last one to the next."""

import math

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


@cached
def arrive(samples, given, slot, how, posed, first, moved, twist, acceleration, dt):
    """Write the target of `given`, samples of length 1, into the last sample (slot 0) or the next (1) of `samples`.

    Blocks as of session.py. how: READ, CHECK or REFUSED; posed: bit f says that tip f has an orientation. first: any target may
    have come before; moved: the next target has become the last one; twist, acceleration: whether they are given, else the last
    two targets give a twist, in dt [s], and the acceleration is 0. Returns TAKEN, DOUBTFUL or HELD.
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
    return TAKEN
