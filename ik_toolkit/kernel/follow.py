"""The compiled tracker loops: the published methods in one, the solvers' feedback rules (one step a sample) in another."""

import functools
from collections.abc import Callable

import numpy as np

from .algebra import at3, put3, rotation_at
from .jit import cached, inline
from .kinematics import aim, angle_ratio, fk, pose_error, room
from .motion import (
    CA,
    GIVEN,
    HELD,
    MOVING,
    NOT_FINITE,
    RUNAWAY,
    RUNNING,
    STATE,
    Law,
    advance,
    apply,
    command,
    ease,
    factor,
    fastest,
    jacobian_rate,
    prepare,
    settle,
    to_local,
)
from .problem import fill
from .records import HEAD, TASK, Ends, Orders, copy, read
from .search import SINGULAR_STEP, step_class
from .serial import make_serial

LARGEST = 1e300  # a sum of joint speeds from which on it is no number to follow


@inline
def judge(wanted, h, p, state):
    """Make the joint speeds `wanted` zero where they cannot be followed or the arm brakes; whether to stop, to hold still."""
    largest = 0.0
    for k in range(wanted.shape[0]):
        largest += abs(wanted[k])
    bad = not largest < LARGEST
    still = p.brake > 0.0 or (bad and p.runaway == np.inf)
    if still:
        for k in range(wanted.shape[0]):
            wanted[k] = 0.0
    elif bad or largest * h > p.runaway * wanted.shape[0]:
        state[STATE.stop] = NOT_FINITE if bad else RUNAWAY
        return True, still
    return False, still


@inline
def note(ends, linear, turn, E):
    """Write an error, its rotation a rotation vector, in base axes [m, rad] to E (6,)."""
    base = rotation_at(ends.flat, 0)
    put3(E, 0, base.times(linear) * ends.scale())
    put3(E, 3, base.times(turn))


@inline
def twist_to(ends, T, goal, now, tip, out):
    """Write the error from the pose now to T (4, 4), the rotation as a rotation vector, to out (6,), in kernel units."""
    aim(ends, T, goal)
    linear, angular = pose_error(goal, now.axes, tip)
    put3(out, 0, linear)
    put3(out, 3, angular * angle_ratio(angular.square()))


@inline
def mark_held(code):
    """Every joint was held."""
    for k in range(code.shape[0]):
        code[k] = code[k] | HELD


@functools.cache
def tracker() -> Callable:
    """Return the compiled loop follow(rows, ends, T, V, A, h, m, p, limits, q, rate, prev, state, Q, R, E, C, D) -> steps.

    T (N+1, 4, 4) [m], V, A (N+1, 6): pose, twist and acceleration of the target; m: 3 positions or 6 poses. p: a `Law`. q,
    rate, prev (n,) and state (3,) are carried from call to call. Kernel units: lengths over the chain's scale; p, limits, q,
    rate, prev, Q, R in them. Q, R (N+1, n), E (N+1, 6) error [m, rad], C (N, n) limit codes, D (N,) damping lambda^2.
    """

    @cached
    def follow(rows, ends, T, V, A, h, m, p, limits, q, rate, prev, state, Q, R, E, C, D):
        n = q.shape[0]
        law, box = read(Law, p), Ends(ends, n)
        size, angles = room(rows.shape[0])
        joints, trig, goal = np.empty(size), np.zeros(angles), np.empty(12)
        task, kept = np.zeros(TASK), np.empty(0)  # all of the pose
        J = np.empty((n, 6))
        G = np.empty((6, 6))
        y = np.empty(6)
        t = np.empty(6)
        e = np.empty(6)
        ahead = np.empty(6)
        v = np.empty(6)
        a = np.empty(6)
        bias = np.zeros(6)
        move = np.empty(n)
        null = np.empty(n)
        x1 = np.empty(n)
        x2 = np.empty(n)
        x = np.empty(n)
        before = np.empty(n)
        steps = T.shape[0] - 1
        limited = False
        for k in range(n):
            limited = limited or limits[3, k] < np.inf
        for i in range(steps + 1):
            now = fk(rows, q, joints, trig)
            tip = now.point + now.axes.times(at3(ends, 21))
            twist_to(box, T[i], goal, now, tip, e)
            note(box, at3(e, 0), at3(e, 3), E[i])
            if i < steps or state[STATE.start] == MOVING:
                fill(rows, task, kept, joints, tip, J, 0)
                to_local(box, V[i], v)
            if state[STATE.start] == MOVING:
                factor(J, m, law.damping, G, y)
                apply(J, m, G, v, y, rate)
                for k in range(n):
                    gap = limits[1, k] - q[k] if rate[k] > 0.0 else q[k] - limits[0, k]
                    top = min(limits[2, k], fastest(gap, 0.0, law.gamma, h, limits[3, k]))
                    rate[k] = min(max(rate[k], -top), top)
                state[STATE.start] = GIVEN
            copy(q, Q[i])
            copy(rate, R[i])
            if i == steps:
                break
            to_local(box, A[i], a)
            twist_to(box, T[i + 1], goal, now, tip, ahead)
            D[i] = factor(J, m, law.damping, G, y)
            if limited:
                ease(law, J, m, e, ahead, h, limits, G, y, x)
            prepare(law, J, m, ahead, rate, h, G, y, t, move, null, x1, x2)
            if law.code >= CA:
                jacobian_rate(rows, joints, J, tip, x1, x2, bias)
            ratio = h / state[STATE.period] if state[STATE.start] == RUNNING else 0.0
            if law.brake == 0.0:
                command(law, J, m, e, v, a, bias, rate, prev, h, ratio, G, y, t, move, null, x)
            copy(rate, before)
            stop, still = judge(x, h, law, state)
            if stop:
                return i
            if still:
                for k in range(n):
                    prev[k] = 0.0
            advance(q, rate, x, law.gamma, h, limits, C[i])
            settle(law, h, before, x, C[i], prev)
            if still:
                mark_held(C[i])
            state[STATE.start] = RUNNING
            state[STATE.period] = h
        return steps

    return follow


@functools.cache
def rule_tracker(cls: type) -> Callable:
    """Return the loop of a solver's rule: follow(rows, ends, T, h, opt, p, limits, q, rate, memory, state, Q, R, E, C) -> steps.

    One step of the rule a sample, towards the target at its end; memory (4 n + 8,) is the rule's state, carried on. opt as
    the solver packs it; p, limits, state and the arrays as in `tracker`.
    """
    step = step_class(cls)

    def follow(rows, ends, T, h, opt, p, limits, q, rate, memory, state, Q, R, E, C):
        n = q.shape[0]
        law = read(Law, p)
        o = read(Orders, opt)
        task = make_serial(rows, ends, opt[HEAD:], n, o)
        rule = read(step, opt, HEAD + TASK + n)
        weights = opt[HEAD + TASK : HEAD + TASK + n]
        s = task.desk
        steps = T.shape[0] - 1
        copy(memory, s.x)
        s.spent[1] = np.inf
        done = steps
        for i in range(steps + 1):
            aim(task.ends, T[i], task.goal)
            e = task.evaluate(q)
            note(task.ends, e.linear, e.angular * angle_ratio(e.angular.square()), E[i])
            copy(q, Q[i])
            copy(rate, R[i])
            if i == steps:
                break
            aim(task.ends, T[i + 1], task.goal)
            copy(q, s.q)
            e = task.evaluate(q)
            task.jacobian(e)
            copy(weights, s.w)
            code = 0
            if law.brake == 0.0:
                code = rule.step(task, e)
            for k in range(n):
                s.dq[k] = s.dq[k] / h if code != SINGULAR_STEP else 0.0
            stop, still = judge(s.dq, h, law, state)
            if stop:
                done = i
                break
            advance(q, rate, s.dq, 1.0, h, limits, C[i])
            if still:
                mark_held(C[i])
        copy(s.x, memory)
        return done

    return cached(follow, cls, step.step)
