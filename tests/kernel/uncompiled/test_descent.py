"""Stuck before a target that stands: when that is noticed, what is asked for then, and how the damping is found."""

from types import SimpleNamespace

import numpy as np
import pytest
from constrained import law

from ik_toolkit.servo import damped_descent
from ik_toolkit.servo.constrained_step import MODE
from ik_toolkit.servo.damped_descent import adapt, notice, stop_in_time, stuck
from ik_toolkit.servo.viability import BIT, approach
from ik_toolkit.servo.workspace import STATE, bench_on, bench_space

H = 0.01


def fed_back(**values):
    return law(**{"kappa": 40.0, "kp": 60.0, "kd": 3.0, **values})


def new_state(**values):
    state = np.zeros(len(STATE))
    for name, value in values.items():
        state[getattr(STATE, name)] = value
    return state


def noticed(state, before, x, code=(0, 0), swings=((0.0, 0.0), (1.0, 1.0))):
    """State after a step of two joints."""
    joints = (np.array(one) for one in (before, x, (1.0, 2.0), swings))
    notice(fed_back(), *joints, np.array(code, np.uint8), 1.0, H, state)
    return state


FIRST = np.ones(6)  # share of each error's level: all are at level 0
LIMITS = np.array([[-9.0, -9.0], [9.0, 9.0], [np.inf, np.inf], [np.inf, np.inf]])


def standing(f=(0.0,) * 6, e=(1.0,) * 6, ahead=(1.0,) * 6):
    """A bench of two joints before a target."""
    J = np.zeros((2, 6))
    J[0, 0], J[1, 1] = 0.5, -0.5
    return SimpleNamespace(
        f=np.array(f), e=np.array(e), ahead=np.array(ahead), J=J, weight=np.ones(6), floor=-np.ones(2), roof=np.ones(2)
    )


def test_an_arm_is_stuck_where_hindered_joints_get_no_nearer():
    at_limit, s = (BIT.position, 0), standing()
    state = new_state()
    for k in range(11):
        assert not stuck(fed_back(), s, LIMITS, FIRST, 1.0, H, state), k
        noticed(state, [1.0, 0.0], [1.0, 0.0], code=at_limit)
    assert stuck(fed_back(), s, LIMITS, FIRST, 1.0, H, state) and state[STATE.share] == damped_descent.DESCENT.first
    assert stuck(fed_back(), s, LIMITS, FIRST, 0.25, H, state), "until the target moves, or is reached"
    assert (
        not stuck(fed_back(), standing(f=(0.0, 0.0, 2e-6)), LIMITS, FIRST, 1.0, H, state) and state[STATE.share] == 0.0
    )
    assert state[STATE.stalled] == 0.0
    state = new_state(share=1.0)
    near = standing(e=(1e-5,) * 6, ahead=(1e-5,) * 6)
    assert not stuck(fed_back(), near, LIMITS, FIRST, 6e-10, H, state) and state[STATE.share] == 0.0
    low = standing(e=(0.01,) * 6, ahead=(0.01,) * 6)
    low.weight *= 1e-3
    assert stuck(fed_back(), low, LIMITS, 1e-3 * FIRST, 6e-10, H, new_state(share=1.0)), (
        "at a lower level, as at the first"
    )
    state = new_state(share=1.0, nearest=0.1)
    assert not stuck(fed_back(), standing(ahead=(1.0 + 1e-7,) * 6), LIMITS, FIRST, 1.0, H, state), (
        "it moves, whatever twist was given"
    )
    assert state[STATE.share] == state[STATE.nearest] == 0.0
    state = new_state(share=1.0, stalled=1.0, nearest=1.0)
    assert not stuck(fed_back(mode=MODE.clip), s, LIMITS, FIRST, 1.0, H, state), "something else gives way"
    assert state[STATE.share] == 0.0
    state = new_state(stalled=1.0, nearest=1.0)
    assert not stuck(fed_back(kappa=0.0), s, LIMITS, FIRST, 1.0, H, state), "nothing is fed back"
    assert not stuck(fed_back(), s, LIMITS, FIRST, 0.998**2, H, state) and state[STATE.stalled] == 0.0, "it came nearer"
    assert state[STATE.nearest] == pytest.approx(0.998)


def test_slow_joints_are_not_stuck_while_they_go_as_fast_as_they_may():
    """The error comes down by 0.002 a second, a fifth of what counts as progress; a joint that cannot go on has no part in it."""
    s, error = standing(e=(0.0, -1.0, 0.0, 0.0, 0.0, 0.0), ahead=(0.0, -1.0, 0.0, 0.0, 0.0, 0.0)), 1.0
    s.J[0, 1], s.floor[0] = 2.0, 0.0
    for top, share in ((0.02, 0.2), (0.08, 0.05), (np.inf, 0.0)):
        limits = LIMITS.copy()
        limits[2] = 1.0, top
        state, ever = new_state(), False
        for k in range(40):
            ever = stuck(fed_back(), s, limits, FIRST, (error - 0.002 * H * k) ** 2, H, state) or ever
            noticed(state, [0.0, 1.0], [0.0, 1.0], code=(BIT.position, BIT.velocity))
        assert ever == (share < damped_descent.DESCENT.pace), top


def test_what_hinders_joints():
    for code, near, x, hindered in (
        ((BIT.position, 0), 0.0, 1.0, True),
        ((BIT.velocity, 0), 0.0, 1.0, False),
        ((0, 0), 1.2, 1.0, True),
        ((0, 0), 0.0, 1.0, False),
        ((0, 0), 0.0, 0.3, True),  # 0.4 is a hundredth of what is fed back
        ((BIT.velocity, 0), 0.0, 0.3, False),
    ):
        state = noticed(new_state(near=near), [x, 0.0], [x, 0.0], code=code)
        assert state[STATE.stalled] == (H if hindered else 0.0), (code, near, x)


def test_joints_that_turn_back_twice_make_it_stuck():
    state = new_state(near=1.0, nearest=1.0)
    noticed(state, [1.0, 0.0], [-1.0, 0.0])
    assert state[STATE.turned] == 1.0 and not stuck(fed_back(), standing(), LIMITS, FIRST, 1.0, H, state)
    noticed(state, [-1.0, 2.0], [0.05, 2.0])
    assert state[STATE.turned] == pytest.approx(1.0 - H / damped_descent.DESCENT.forgotten), (
        "a twentieth of the motion goes back"
    )
    state[STATE.turned] = 1.0
    noticed(state, [-1.0, 2.0], [0.2, 2.0])
    assert state[STATE.turned] == 2.0 and stuck(fed_back(), standing(), LIMITS, FIRST, 1.0, H, state)
    state = noticed(new_state(near=1.0), [-1.0, 2.0], [0.05, 2.0], swings=((2.0, 0.0), (0.0, 1.0)))
    assert state[STATE.turned] == 1.0, "a joint that swings"
    state = noticed(new_state(near=1.0), [-1.0, 2.0], [0.05, 2.0], swings=((2.0, 0.0), (0.1, 0.0)))
    assert state[STATE.turned] == 0.0, "that has swung"
    state = noticed(new_state(), [1.0, 0.0], [-1.0, 0.0])
    assert state[STATE.turned] == 0.0, "nothing hinders it"
    state = noticed(new_state(share=1.0, nearest=1.0), [1.0, 0.0], [-1.0, 0.0])
    assert state[STATE.share] == damped_descent.DESCENT.turned


@pytest.mark.parametrize("n", [5, 7])
def test_joints_can_stop_at_the_end_of_their_way(n):
    rng = np.random.default_rng(n)
    s, mu = bench_on(np.zeros(bench_space(n, 6, 1)), n, 6, 1), 0.3
    s.J[:], s.e[:], s.weight[:] = rng.normal(size=(n, 6)), rng.normal(size=6), rng.uniform(0.5, 2.0, 6)
    s.floor[:], s.roof[:] = -9.0, 9.0
    limits = np.array([np.full(n, -1.0), np.full(n, 1.0), np.full(n, 9.0), np.full(n, 10.0)])
    limits[3, 1] = np.inf
    slope = s.J @ s.e
    if slope[0] > 0.0:
        s.roof[0] = 0.0
    else:
        s.floor[0] = 0.0
    free = np.arange(n) > 0
    way = np.zeros(n)
    way[free] = np.linalg.solve(s.J[free] @ s.J[free].T + mu * np.eye(n - 1), slope[free])
    floor, roof = s.floor.copy(), s.roof.copy()
    stop_in_time(s, limits, mu, H)
    for i in range(n):
        most = approach(abs(way[i]), 0.0, 1.0, H, 5.0, H) if i != 1 else np.inf
        assert s.roof[i] == pytest.approx(min(roof[i], most)) and s.floor[i] == pytest.approx(max(floor[i], -most))
    assert s.why_top[2] == BIT.calmed and s.why_top[1] == 0


def test_the_damping_is_found_by_trying():
    state = new_state(share=0.5, nearest=1.0)
    adapt(False, 0.9, H, state)
    assert state[STATE.share] == 0.45 and state[STATE.nearest] == 0.9
    adapt(True, 0.8, H, state)
    assert state[STATE.share] == pytest.approx(3.6) and state[STATE.lowest] == pytest.approx(0.9)
    for k in range(1000):
        adapt(False, 0.8 - 1e-6 * k, H, state)
        assert state[STATE.share] >= state[STATE.lowest]
        if k == 25:
            assert state[STATE.share] == state[STATE.lowest] > 0.3
    assert state[STATE.share] == damped_descent.DESCENT.least
    for k in range(1000):
        adapt(False, 1.0, H, state)
        if k == 10:
            assert state[STATE.share] == pytest.approx(2.0 * damped_descent.DESCENT.least)
            assert state[STATE.nearest] == 1.0, "what comes next is compared with this"
            assert state[STATE.lowest] == damped_descent.DESCENT.least, "and does not lead back at once"
    assert state[STATE.share] == damped_descent.DESCENT.most
    adapt(True, 1.0, H, state)
    assert state[STATE.share] == damped_descent.DESCENT.most
