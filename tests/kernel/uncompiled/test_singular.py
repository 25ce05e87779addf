"""Singular directions: how they are found and damped, and how joints move along them."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from constrained import law

from ik_toolkit.servo import command, singular_directions, singular_step
from ik_toolkit.servo.laws import LAW
from ik_toolkit.servo.singular_step import WEAK
from ik_toolkit.servo.viability import approach
from ik_toolkit.servo.workspace import STATE, bench_on, bench_space


def speed(sigma, curve, own=0.0, left=0.0, moved=0.0, a=np.inf, near=0.0, away=(0.0, 0.0), rest=0.0, full=None):
    """`mode_speed` for the direction (0.6, 0.8) of two joints: its speed where it is lost (None: it is not), edge, away."""
    V, gain, h = np.array([[0.6, 0.8]]), 5.0, 0.01
    limits = np.array([[-9.0] * 2, [9.0] * 2, [1.0] * 2, [a] * 2])
    lost, xk, side = np.zeros(1), np.full(1, np.nan), np.array(away)
    full = sigma if full is None else full
    s = SimpleNamespace(V=V, t=np.array(curve), lost=lost, xk=xk)
    mode = singular_directions.WeakMode(0, full, sigma, rest, own, left, moved)
    out = singular_directions.mode_speed(s, mode, gain, h, limits, near, side)
    return (xk[0] if lost[0] else None), out, side


def test_the_speed_along_a_singular_direction():
    h, gain, cap = 0.01, 5.0, 1.0 / 0.8
    for own in (0.0, 0.3):
        for left, moved in ((2e-4, 1e-5), (-1e-4, 0.0), (0.0, 2e-5)):
            E = moved + h * gain * left - 0.5 * 4e-6
            sigma = 3e-3 + 0.5 * (9e-6 - 1e-6 - 4e-6)  # what moves beside it changes the direction's own sigma
            y = singular_step.way_along(sigma, 1e-6, E, h * own, 0.0, False, h)[0]
            x, out, _ = speed(3e-3, [1e-6, 4e-6, 9e-6], own, left, moved)
            assert x == pytest.approx(np.clip(y / h, -cap, cap), rel=1e-9) and not out
    assert speed(3e-3, [0.0, 0.0, 0.0], left=1.0)[0] == pytest.approx(cap)
    assert speed(3e-3, [0.0, 0.0, 0.0], left=-1.0)[0] == pytest.approx(-cap)
    assert (
        speed(0.0051, [0.0, 0.0, 0.0], left=1e-6)[0] is None
        and speed(0.0049, [0.0, 0.0, 0.0], left=1e-6)[0] is not None
    )
    assert speed(0.1, [0.0, 0.0, 0.0], left=1.0)[0] is not None  # above what is lost: the joints are too slow for it
    assert speed(0.1, [0.0, 0.0, 0.0], moved=0.9 * h * cap * 0.1)[0] is None
    assert speed(0.1, [0.0, 0.0, 0.0], moved=1.1 * h * cap * 0.1)[0] is not None
    # or it bends: |b E| above a fifth of sigma^2
    assert speed(0.1, [1.9, 0, 1.9], moved=1e-3)[0] is None and speed(0.1, [2.1, 0, 2.1], moved=1e-3)[0] is not None
    # out of reach: D = sigma^2 + 2 b E below 0
    assert speed(3e-3, [-1.0, 0.0, -1.0], moved=1e-4)[1] and not speed(3e-3, [1.0, 0.0, 1.0], moved=1e-4)[1]


def test_a_singular_direction_brakes_in_time():
    h, gain, a = 0.01, 5.0, 0.5
    limit = a / 0.8
    for left in (1e-3, 1e-2):
        y = singular_step.way_along(4e-3, 0.0, left, 0.0, 0.0, False, h)[0]
        most = approach(abs(y), 0.0, 1.0, h, 0.5 * limit, h)
        less = left * min(1.0, most / (gain * abs(y)))
        again = singular_step.way_along(4e-3, 0.0, h * gain * less, 0.0, 0.0, False, h)[0]
        assert speed(4e-3, [0.0, 0.0, 0.0], left=left, a=a)[0] == pytest.approx(
            np.clip(again / h, -1.25, 1.25), rel=1e-9
        )
    x, out, _ = speed(4e-3, [-1.0, 0.0, -1.0], left=1e-2, a=a)
    y = singular_step.way_along(4e-3, -1.0, 1e-2, 0.0, 0.0, False, h)[0]
    assert out and abs(x) <= approach(abs(y), 0.0, 1.0, h, 0.5 * limit, h) + 1e-9


def test_the_side_the_joints_come_from_is_remembered():
    v = np.array([0.6, 0.8])
    beside = np.array([0.8, -0.6])  # of that nothing is known
    for near, share in ((0.0, 1.0), (0.5, 0.01 / WEAK.side)):
        for b in (0.3, -0.3):
            away = 0.7 * v + 0.2 * beside
            *_, side = speed(3e-3, [b, 0.0, b], near=near, away=away)
            np.testing.assert_allclose(side, away + share * (np.sign(b) - 0.7) * v, atol=1e-14)
            *_, side = speed(3e-3, [b, 0.0, b], near=near, away=0.3 * v + 2.0 * beside)  # of another singular pose
            np.testing.assert_allclose(side, np.sign(b) * v + 2.0 * beside, atol=1e-14)
    for far in (0.9, 0.1):  # out of reach it is kept, if it is known
        *_, side = speed(3e-3, [-1.0, 0.0, -1.0], moved=1e-3, away=far * v)
        np.testing.assert_allclose(side, far * v if far > 0.5 else -v, atol=1e-14)
    for unclear in (dict(sigma=0.9e-4), dict(sigma=1.4e-3, full=3e-3)):
        np.testing.assert_array_equal(speed(curve=[0.3, 0.0, 0.3], away=(0.2, -0.1), **unclear)[2], [0.2, -0.1])
    # carried far to the other side of the edge: back across
    x, out, _ = speed(6e-3, [-1.0, 0.0, -1.0], moved=1e-3, away=tuple(0.9 * v))
    assert out and x == pytest.approx(min((6e-3 + 5e-3) * 5.0, 1.25))
    x, out, _ = speed(6e-3, [1.0, 0.0, 1.0], moved=-1e-3, away=tuple(-0.9 * v))
    assert out and x == pytest.approx(-min((6e-3 + 5e-3) * 5.0, 1.25))


def test_of_two_directions_that_move_nothing_the_bent_one_is_taken():
    rng = np.random.default_rng(3)
    Q = np.linalg.qr(rng.normal(size=(7, 7)))[0]
    sigma = np.array([1.0, 2e-3, 0.5])
    W = sigma[:, None] * Q[:, :3].T
    bent, straight = 0.3 * Q[:, 1] + np.sqrt(0.91) * Q[:, 5], np.sqrt(0.91) * Q[:, 1] - 0.3 * Q[:, 5]
    V = np.full((3, 7), np.nan)
    for away in (np.zeros(7), 0.9 * bent + 2.0 * Q[:, 0], -0.9 * bent):  # what is known counts, if anything is
        V[1] = Q[:, 1]
        x, slope = np.empty(7), np.empty(7)
        singular_step.begin_curved(W, V[1], sigma, 1, away, x)
        np.testing.assert_allclose(x, np.sign(away @ bent) * bent if away.any() else Q[:, 1], atol=1e-12)
        slope[:] = 0.2 * (x @ bent) * bent + 0.4 * Q[:, 0] - 0.1 * Q[:, 2]  # what other modes move is not free
        thin = singular_step.bent_direction(W, V[1], sigma, 1, slope)
        np.testing.assert_allclose(V[1], bent, atol=1e-12)
        assert thin == pytest.approx(0.3 * 2e-3)
    V[1] = Q[:, 1]
    slope[:] = 0.5e-3 * straight  # hardly bent
    assert singular_step.bent_direction(W, V[1], sigma, 1, slope) == 2e-3
    np.testing.assert_array_equal(V[1], Q[:, 1])


class Curved:
    """A task with a constant second derivative."""

    def __init__(self, rng, n, m):
        self.B = rng.normal(size=(n, n, m))
        self.B = 0.5 * (self.B + self.B.transpose(1, 0, 2))

    def plain(self):
        return True

    def bending(self, look, x, y, out):
        out[:] = np.einsum("i,j,ijm->m", x, y, self.B)


@pytest.mark.parametrize("code", [LAW.cv, LAW.av])
@pytest.mark.parametrize("n", [5, 7])
def test_only_the_singular_direction_leaves_the_task(code, n):
    rng = np.random.default_rng(n)
    m, h = 6, 0.02
    k = min(n, m)
    U, _ = np.linalg.qr(rng.normal(size=(m, m)))
    W, _ = np.linalg.qr(rng.normal(size=(n, n)))
    for last, near in ((2e-3, 0.0), (2e-3, 1.1), (2e-3, 1.0 + WEAK.side), (1e-12, 0.0), (0.5, 0.0)):
        values = np.append(np.linspace(2.0, 1.0, k - 1), last)
        s = bench_on(np.zeros(bench_space(n, m, 1)), n, m, 1)
        s.J[:] = W[:, :k] * values @ U[:, :k].T
        J = s.J.copy()
        s.floor[:], s.roof[:], s.weight[:] = -9e9, 9e9, 1.0
        s.e[:] = 1e-3 * rng.normal(size=m)
        if near == 1.0 + WEAK.side:  # little is left of what could be closed
            s.e[:] -= 0.99 * (U[:, k - 1] @ s.e) * U[:, k - 1]
        s.f[:], s.ahead[:] = 0.01 * rng.normal(size=m), s.e + 2e-4 * rng.normal(size=m)
        e, f, ahead = s.e.copy(), s.f.copy(), s.ahead.copy()
        limits = np.array([np.full(n, -9e9), np.full(n, 9e9), np.full(n, 2.0), np.full(n, np.inf)])
        state, away, memory = np.zeros(len(STATE)), W[:, k - 1].copy(), np.zeros(n)
        state[STATE.near] = near
        task, rate = Curved(rng, n, m), 0.1 * rng.normal(size=n)
        none = np.zeros((3, n))
        settings = SimpleNamespace(counts=np.zeros((4, m)), limits=limits, wish=none)
        own = SimpleNamespace(
            motion=np.array([np.zeros(n), rate]), memory=memory, away=away, basis=np.zeros((m, m)), state=state
        )
        lost = command.by_law(
            law(code, damping=0.05, kappa=4.0), None, task, None, None, s, settings, own, command.Moment(0, h, 0.0)
        )
        want = U.T @ (f + 4.0 * e if code == LAW.cv else ahead / h)
        done = U.T @ (J.T @ s.x)
        if state[STATE.near] != 1.0 + WEAK.side:  # else the others are fed back less
            np.testing.assert_allclose(done[: k - 1], want[: k - 1], atol=1e-9)
        if n > m:
            assert lost == (last < 0.005) and state[STATE.near] in (
                (1.0, max(near - h, 1.0), 1.0 + WEAK.side) if last < 0.1 else (0.0,)
            )
        if last < 0.005 and (n > m or last > 1e-9):  # else two directions without a singular value share it
            u, free, v = U[:, k - 1], W[:, k - 1 :], W[:, k - 1]
            if near > 1.0:  # out of reach a moment ago: of the directions that move nothing, the bent one
                v = free @ (free.T @ np.array([task.B[:, i].T @ W[:, k - 1] @ u for i in range(n)]))
                v *= np.sign(v @ W[:, k - 1]) / np.linalg.norm(v)
            along, curve = v @ rate, np.empty(3)
            for part in range(3):
                x = (part != singular_step.BESIDE) * v + (part != singular_step.ALONG) * h * (rate - along * v)
                task.bending(None, x, x, s.bias)
                curve[part] = u @ s.bias
            gain = 4.0 if code == LAW.cv else 2.0 / 3.0 / h
            known = near > 0.0 or last < singular_step.WEAK.clear
            lost_, xk, side = np.zeros(1), np.zeros(1), known * W[:, k - 1]
            full = last if last > 1e-9 else s.sv.min()
            rest = np.sqrt(e @ e - (u @ e) ** 2) if near == 1.0 + WEAK.side else 0.0
            mode = singular_directions.WeakMode(
                0, full, full * (v @ W[:, k - 1]), rest, along, u @ e, u @ ahead - u @ e
            )
            one = SimpleNamespace(V=v[None], t=curve, lost=lost_, xk=xk)
            singular_directions.mode_speed(one, mode, gain, h, limits, near, side)
            assert v @ s.x == pytest.approx(xk[0], rel=1e-6, abs=1e-9)
            if code == LAW.cv:
                assert v @ memory == pytest.approx(xk[0], rel=1e-6, abs=1e-9)


def test_what_is_kept_of_singular_poses():
    state, h = np.zeros(len(STATE)), 0.01
    for near, beyond, kept in (
        (False, False, 0.0),  # never met: `away` is a default
        (True, True, 1.0 + WEAK.side),
        (True, False, 1.0 + WEAK.side - h),
        (False, False, -1.0),  # met once: `away` stays what it is
        (True, False, 1.0),
    ):
        singular_directions.remember(state, near, beyond, h)
        assert state[STATE.near] == pytest.approx(kept)


def test_joints_that_have_to_stand_still_take_no_part_in_bending():
    n, m = 4, 6
    s = bench_on(np.zeros(bench_space(n, m, 1)), n, m, 1)
    s.U[2], s.bias[:] = np.arange(6.0), 1.0
    s.floor[:], s.roof[:] = (-1.0, 0.0, 0.0, -1.0), (1.0, 0.0, 1.0, 0.0)
    for part in range(-n, 1):
        singular_directions.note_curve(s, 2, part)
    np.testing.assert_array_equal(s.null, [15.0, 0.0, 15.0, 15.0])
    assert s.t[0] == 15.0


def test_less_is_asked_for_beside_a_direction_that_is_out_of_reach():
    rng = np.random.default_rng(7)
    U = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    sigma, lost, bend = np.array([1.0, 0.5, 0.2, 0.0]), np.array([0.0, 0.0, 1.0, 1.0]), 0.7
    asked = rng.normal(size=(3, 4))  # e, ahead, f
    more = bend * np.hypot(U[2] @ asked[0], U[3] @ asked[0])
    command = asked - (np.where(lost, 0.0, more / (sigma**2 + more)) * (asked @ U.T)) @ U
    singular_step.hold_back(U, sigma, lost, bend, *asked, np.empty(4))
    np.testing.assert_allclose(asked, command, atol=1e-14)


def test_joints_go_down_what_a_bent_direction_leaves_of_a_slope():
    rng = np.random.default_rng(9)
    Q = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    W, V = np.zeros((2, 2, 5))
    V[1], W[1] = Q[:, 0], 3e-4 * Q[:, 0] - 4e-3 * Q[:, 1]
    W[0] = Q[:, 2]
    ways = itertools.product(
        (50.0, 0.0), (1.0, 0.0), ((6e-3, 1.0), (5e-3, 1.0), (4e-3, 0.6), (2.5e-3, 0.0), (1e-3, 0.0))
    )
    for pull, speeds, (sigma, share) in ways:
        x = rng.normal(size=5)
        along = -4e-3 * pull * speeds if pull else Q[:, 1] @ x
        command = x + share * (along - Q[:, 1] @ x) * Q[:, 1]
        singular_step.down_slopes(W, V, np.array([1.0, sigma]), np.array([0.0, pull]), x, speeds)
        np.testing.assert_allclose(x, command, atol=1e-14)
    W[1] = 3e-4 * Q[:, 0]  # nothing is left of it
    singular_step.down_slopes(W, V, np.array([1.0, 6e-3]), np.array([0.0, 50.0]), x, 1.0)
    np.testing.assert_allclose(x, command, atol=1e-12)


def test_what_is_left_beside_an_error_out_of_reach_is_fed_back_less():
    for left, rest in ((1e-4, 0.01), (-9e-4, 0.01), (1.1e-3, 0.01), (1e-4, 0.0)):
        less = 9e-6 / (9e-6 + rest) if abs(left) < 0.1 * rest else 1.0
        alone = speed(3e-3, [0.0, 0.0, 0.0], left=less * left, moved=less * 2e-6)[0]
        found = speed(3e-3, [0.0, 0.0, 0.0], left=left, rest=rest, moved=2e-6)[0]
        assert found == pytest.approx(alone, rel=1e-12)
