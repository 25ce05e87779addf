"""The compiled loop of a tracker: from the target's motion to joint rates inside every limit, sample by sample.

A method (a published law, or a solver with one iteration a sample) commands joint rates. Their part along
singular directions, in which the tip can hardly move, is replaced (singular_step.py), and secondary motion is added in
the null space. If limits or inequality constraints forbid the result, `constrain` finds the best that they allow;
otherwise the commanded rates are taken unchanged, as published. An arm that is stuck before a stationary target takes damped
least-squares steps to the least error nearby (damped_descent.py). In mode clip the method is as published: damped in all
directions near singular poses, each joint clipped on its own.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..compile.array_view import flat, keep, space, view
from ..compile.jit import cached_small, inline, inner
from ..kernel.dispatch import problem_on
from ..kernel.records import SIZE, Orders, copy, read
from ..kernel.search import step_class
from ..kernel.vectors import apply_transposed, clear, dot
from .command import Moment, Published, by_law, by_rule, chosen, shift_by_secondary, unshifted
from .constrained_step import MODE, OUTCOME, Allowed, StepTaken, TaskRate, constrain, room_on, room_space
from .damped_descent import descend, notice, stuck
from .laws import Law, apply, factor, rewrite_command, settle
from .null_space_motion import SLACK, mirror_free_rows, reflect, slack_rows
from .singular_step import along_lost, by_modes
from .viability import BIT, CALMING, LIMIT, UNLIMITED, approach, box_of, boxes, calm, clip, move, watch, way_to
from .workspace import START, STATE, bench_on, bench_space, carried_of, record_of, samples_of, settings_of


class LoopEnd(NamedTuple):
    """Codes that say why the compiled loop of a tracker ended."""

    fine: int = 0  # all steps are taken
    not_finite: int = 1  # the command is not finite
    runaway: int = 2  # the joints move too far in one step


STOP = LoopEnd()
LARGEST = 1e300  # sum of commanded joint speeds [rad/s or arm reaches/s] above which a command counts as not finite


@inner
def initial_rates(law, J, f, G, y, limits, q, rate, state):
    """Set the joint rates rate (n,) at the start: unless they were given, to J^+ f, limited so that the joints can brake.

    law: the method and its gains (`Law`); f (m,): twist of the target; J, G, y: Jacobian and scratch, as in `laws.factor`; limits
    (4, n): lower, upper, speed, acceleration; state: see `workspace.State`.
    """
    if state[STATE.start] == START.with_target:
        factor(J, J.shape[1], law.damping, G, y)
        apply(J, J.shape[1], G, f, y, rate)
        for i in range(q.shape[0]):
            up = rate[i] > 0.0
            gap = max(way_to(limits[LIMIT.highest if up else LIMIT.lowest, i], q[i], 1.0 if up else -1.0), 0.0)
            top = min(
                limits[LIMIT.speed, i], approach(gap, 0.0, law.gamma, 0.0, limits[LIMIT.acceleration, i], law.late)
            )
            rate[i] = min(max(rate[i], -top), top)
    state[STATE.start] = START.ready


@inline
def keep_axes(counts, flip):
    """Do not mirror the axes (set `flip` (F, 3) to zero) of tips whose rotation errors have slack or unequal weights.

    The axes of a tip with a free rotation are otherwise mirrored, so that the free axis becomes the last one. Slack and weights
    belong to the axes before mirroring, which would mix them. counts (4, m): weights and slack of the errors, as in `Settings`.
    """
    weight, slack = counts[0], counts[1]
    for f in range(flip.shape[0]):
        k = 6 * f + 3
        even = weight[k] == weight[k + 1] and weight[k] == weight[k + 2]
        if not (even and slack[k] + slack[k + 1] + slack[k + 2] == 0.0):
            clear(flip[f])


@inline
def evaluate_task(task, look, s, V, A, plain, counts, E):
    """Write to s (Bench) the error, the Jacobian, and the target's twist V and acceleration A in the error's axes.

    E (m,) receives the error [m, rad] in base axes, reduced by the slack (dead band) of each component. task, look: the compiled
    problem and its evaluation; plain: whether no rotation is free and no target is in another tip's frame; counts (4, m): weights
    and slack of the errors, as in `Settings`.
    """
    copy(task.desk.y, s.e)
    task.jacobian(look)
    copy(flat(task.desk.J), flat(s.J))
    task.moving(V, s.f)
    task.moving(A, s.a)
    task.base_axes(s.e, E)
    slack = counts[2]
    for k in range(E.shape[0]):
        E[k] -= min(max(E[k], -slack[k]), slack[k])
    if not plain:
        task.mirrors(s.flip)
        keep_axes(counts, s.flip)
        mirror_free_rows(s.flip, s.J, s.e)
        reflect(s.flip, s.f)
        reflect(s.flip, s.a)


@inner
def leave_out(J, floor, roof):
    """Set to zero the rows of J (n, m) of joints that cannot move (both rate bounds 0): singular poses are judged without them."""
    for i in range(floor.shape[0]):
        if floor[i] == 0.0 and roof[i] == 0.0:
            clear(J[i])


@inline
def limit_oscillation(law, s, rate, swings, h, state):
    """Limit the acceleration of oscillating joints, if limits or a singular pose have hindered joints lately.

    If nothing has hindered them, the reversals may be due to the motion of the target itself. law: `Law`; s: `Bench`; rate (n,):
    present joint rates; swings (3, n): counts of reversals, see `viability.watch`; h [s]: the step.
    """
    if law.mode != MODE.clip and state[STATE.free] < CALMING.lasting:
        calm(rate, s.size, swings, h, box_of(s))


@inline
def record_oscillation(law, s, code, swings, h, state):
    """Update the detection of oscillation, and the time since joints were hindered, after a step from s.before to s.x.

    code (n,): bits of the limits that held joints back in this step; swings (3, n): counts of reversals, see `viability.watch`; h
    [s]: the step. A limit on the acceleration of an oscillating joint (BIT.calmed) does not count as a hindrance.
    """
    watch(swings, s.before, s.x, s.size, law.gamma, h)
    hindered = state[STATE.near] > 0.0
    for i in range(code.shape[0]):
        hindered = hindered or (code[i] | BIT.calmed) != BIT.calmed
    state[STATE.free] = 0.0 if hindered else state[STATE.free] + h


@inline
def weigh_levels(share, s):
    """Write to s.heavy (m,), for each error, the largest weight of all errors of the same priority level.

    share (m,): weight of each error's level relative to level 0; errors of equal shares are of the same level.
    """
    # A priority level consists of positions and orientations of tips, three errors each.
    for k in range(0, share.shape[0], 3):
        most = 0.0
        for j in range(0, share.shape[0], 3):
            if share[j] == share[k]:
                most = max(most, s.weight[j], s.weight[j + 1], s.weight[j + 2])
        s.heavy[k] = s.heavy[k + 1] = s.heavy[k + 2] = most


@inner
def copy_planes(law, lines, level, planes, edges):
    """Copy the collision inequalities on joint rates x, lines x <= level, to `planes` and `edges`; return their number law.rows."""
    for k in range(int(law.rows)):
        copy(lines[k], planes[k])
        edges[k] = level[k]
    return int(law.rows)


@inline
def clip_rates(law, s, still, h, memory, code):
    """Clip the joint rates s.x (n,) to their bounds, each joint on its own; used in mode clip and when the arm brakes (still).

    The method's `memory` of its last command receives the rates that clipped joints really took (mode clip), or zeros (if the arm
    brakes). code (n,) receives the bits of the limits that held joints back.
    """
    clip(s.x, box_of(s), code)
    if not still:
        settle(law, h, s.before, s.x, code, memory)
        return
    for k in range(code.shape[0]):
        code[k] = code[k] | BIT.held
    clear(memory)


# ---------------------------------------------------------------------------------------------------- inside the limits
@inline
def judge(wanted, h, p, state):
    """Return whether the loop must end because of the commanded rates `wanted` (n,), and whether the arm brakes.

    p: the method and its gains (`Law`). The arm brakes, and the rates become 0, if p.brake is set, or if the rates are not finite
    and p.runaway is infinite. Otherwise the loop ends if the rates are not finite, or in mode clip if the mean joint move exceeds
    p.runaway.
    """
    largest = 0.0
    for k in range(wanted.shape[0]):
        largest += abs(wanted[k])
    bad = not largest < LARGEST
    still = p.brake > 0.0 or (bad and p.runaway == np.inf)
    if still:
        clear(wanted)
    # Outside mode clip a command that is large but finite does not end the loop, because the rate bounds limit it.
    elif bad or (p.mode == MODE.clip and largest * h > p.runaway * wanted.shape[0]):
        state[STATE.stop] = STOP.not_finite if bad else STOP.runaway
        return True, still
    return False, still


@inline
def by_constraints(law, s, count, mu, h, own, work, code):
    """Write to s.x the rates that `constrain` finds within all limits; return whether they differ from the commanded rates.

    law: the method and its gains (`Law`); s: scratch arrays of the step (`Bench`); count: number of inequality constraints; h [s]:
    the step; own: state of the tracker (`Carried`); work: memory for `constrain`. If mu > 0, the step is a damped least-squares
    step with this damping, whose task is already in s. code (n,) receives the bits of the limits that held joints back.
    """
    n = s.J.shape[0]
    mode, size = int(law.mode), s.size
    if mu > 0.0:
        mode, size = MODE.leave, s.even
    else:
        apply_transposed(s.J, s.x, s.ask)
        clear(s.v)
        along_lost(s.V, s.lost, s.xk, s.v, 1.0)
        by_modes(s.J, s.W, s.U, s.lost, s.ask, s.y)
    copy(s.x, s.w)
    # Where other joints are blocked, a joint without limits would do alone what it hardly can, with a thousand turns in one step
    # (tests/servo/test_motion_limits.py). No step is meant to move a joint by more than half a turn, or the way asked of the tip.
    most = np.pi / h + math.sqrt(dot(s.ask, s.ask, s.ask.shape[0]))
    for i in range(n):
        if s.floor[i] == -np.inf:
            s.floor[i], s.why_low[i] = -most, 0
        if s.roof[i] == np.inf:
            s.roof[i], s.why_top[i] = most, 0
    allowed, taken = Allowed(s.floor, s.roof, s.planes, s.edges, count), StepTaken(s.x, own.active, own.kept)
    status = constrain(TaskRate(s.J, s.weight, s.heavy, s.ask, s.w, s.v, size, mode, h, mu), allowed, work, taken)
    if status >= OUTCOME.short:
        own.state[STATE.pressed] = SLACK.pressed
    for i in range(n):
        code[i] = (s.why_low[i] | s.why_top[i]) & BIT.recovering
        if status != OUTCOME.wanted and own.active[i] == 1:
            code[i] = s.why_top[i]
        elif status != OUTCOME.wanted and own.active[i] == -1:
            code[i] = s.why_low[i]
    for k in range(int(law.rows)):
        if status != OUTCOME.wanted and own.kept[k] != 0:
            most = 0
            for i in range(n):
                if abs(s.planes[k, i]) > abs(s.planes[k, most]):
                    most = i
            code[most] = code[most] | BIT.row
    return status != OUTCOME.wanted


@inline
def by_clipping(law, s, count, mu, h, own, work, code):
    """Clip the joint rates s.x (n,) that a solver's iteration commands to their bounds, each joint on its own.

    Solvers do not use `by_constraints`, since compiling it for every solver would take a minute. code (n,) receives the bits of the
    limits that held joints back. Always returns False: the solver's state is not corrected for clipped rates.
    """
    clip(s.x, box_of(s), code)
    return False


# ----------------------------------------------------------------------------------------------------------- the loop
@inner
def error_squared(weight, e):
    """Return the sum of the squares of the errors e (m,), each multiplied by its weight (m,)."""
    total = 0.0
    for k in range(e.shape[0]):
        total += (weight[k] * e[k]) ** 2
    return total


@inline
def size_joints(s, speed):
    """Write to s.size (n,) the speed to which each joint's rate is compared: its speed limit, or UNLIMITED if it has none."""
    for i in range(speed.shape[0]):
        s.size[i], s.even[i] = speed[i] if 0.0 < speed[i] < np.inf else UNLIMITED, 1.0


@inline
def run(step, arm, given, own, samples, out, h, block):
    """Take the steps of a tracker, of h [s] each, until `out` is full or the loop must end; return the number of steps.

    step: class of the solver's iteration, or Published; arm: the arrays rows, ends and orders of `servo`; given: inputs (Settings);
    own: state between steps (Carried); samples: targets (Samples); out: results (Record); block: array of zeros, used as scratch
    memory.
    """
    (rows, ends, orders), (_, p, counts, limits, wish, lines, level, measured) = arm, given
    (_, T, V, A), (_, Q, R, E, S, C) = samples, out
    q, rate, memory, swings, state = own.motion[0], own.motion[1], own.memory, own.swings, own.state
    n, m, room = q.shape[0], V.shape[1], own.kept.shape[0]
    law, o = read(Law, p), read(Orders, orders)
    first = SIZE.orders + SIZE.task * (m // 6)
    task = problem_on(block, rows, ends, orders[SIZE.orders : first], n, o)
    weights, rule = orders[first : first + n], read(step, orders, first + n)
    shift, command = chosen(rule, unshifted, shift_by_secondary), chosen(rule, by_law, by_rule)
    apply_limits = chosen(rule, by_constraints, by_clipping)
    s, work = bench_on(block, n, m, room), room_on(block, n, m, room)
    plain = task.plain()
    size_joints(s, limits[LIMIT.speed])
    for i in range(E.shape[0]):
        copy(measured if law.measured > 0.0 else q, s.at)
        task.stand(s.at)
        # First the error to this sample's target is evaluated, then the error to the next sample's target.
        for stage in range(2):
            task.head_for(T[i + stage])
            look = task.see()
            task.stack(look)
            if stage == 1:
                copy(task.desk.y, s.ahead)
                if not plain:
                    reflect(s.flip, s.ahead)
                break
            evaluate_task(task, look, s, V[i], A[i], plain, counts, E[i])
            if state[STATE.start] == START.with_target or state[STATE.start] == START.given:
                initial_rates(law, s.J, s.f, s.G, s.y, limits, q, rate, state)
            copy(q, Q[i])
            copy(rate, R[i])
            S[i] = 0.0
            if i == E.shape[0] - 1:
                return i
            boxes(q, rate, limits, law.gamma, h, law.late, box_of(s))
            if shift(law, s, limits, wish, rate, h):
                task.stand(s.at)
        if law.mode != MODE.clip:
            leave_out(s.J, s.floor, s.roof)
        count = copy_planes(law, lines, level, s.planes, s.edges)
        copy(counts[0], s.weight)
        count = slack_rows(counts[1], s, count, h, state)
        weigh_levels(counts[3], s)
        square = error_squared(s.weight, s.e)
        ratio = h / state[STATE.period] if state[STATE.start] == START.running else 0.0
        mu = descend(law, s, limits, h, state) if stuck(law, s, limits, counts[3], square, h, state) else 0.0
        S[i] = min(max(state[STATE.near], 0.0), 1.0)
        limit_oscillation(law, s, rate, swings, h, state)
        if mu == 0.0:
            S[i] = command(law, rule, task, look, weights, s, given, own, Moment(count, h, ratio))
        copy(rate, s.before)
        stop, still = judge(s.x, h, law, state)
        if stop:
            return i
        if still or law.mode == MODE.clip:
            clip_rates(law, s, still, h, memory, C[i])
        else:
            held = apply_limits(law, s, count, mu, h, own, work, C[i])
            record_oscillation(law, s, C[i], swings, h, state)
            if held and mu == 0.0:
                rewrite_command(law, h, ratio, s.w, s.x, memory)
        if not still:
            notice(law, s.before, s.x, s.size, swings, C[i], square, h, state)
        move(q, rate, s.x, law.gamma, h)
        # After a damped least-squares step the method has no previous command to continue from.
        state[STATE.start] = START.running if mu == 0.0 else START.ready
        state[STATE.period] = h
    return 0


@functools.cache
def servo(cls: type | None = None) -> Callable:
    """Return the compiled loop of a tracker for the control laws (cls None), or for a solver, given the class of its iteration.

    follow(rows, ends, orders, settings, carried, samples, out, h) takes at most as many steps of h [s] as the `Record`
    `out` has room for, and returns how many it took.

    rows, ends: the packed chain (several tips: ends (F, ...)); orders: SIZE.orders numbers, a Task for each tip (weights 1 or
    0, no slack), joint weights (n,), parameters of the solver. Each other argument is one array that holds all fields of
    Settings, Carried, Samples or Record. Numbers are in rad and arm reaches; h, T, V, A, errors and tolerances in s, m and rad.
    """
    step: Any = Published if cls is None else step_class(cls)

    def follow(rows, ends, orders, settings, carried, samples, out, h):
        given, own = settings_of(view(settings)), carried_of(view(carried))
        n, m, room = given.limits.shape[1], given.counts.shape[1], own.kept.shape[0]
        size = space(n, m, rows.shape[0], 0) + bench_space(n, m, room) + room_space(n, m, room)
        block = np.zeros(size)
        taken = run(
            step, (view(rows), view(ends), view(orders)), given, own, samples_of(view(samples)), record_of(view(out)), h,
            view(block),
        )  # fmt: skip
        keep(block)
        return taken

    return cached_small(follow) if cls is None else cached_small(follow, cls, step.step)
