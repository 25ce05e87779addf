"""Parts of a tracker step around its law: wishes, curvature, and joints that swing."""

from types import SimpleNamespace

import numpy as np
import pytest
from constrained import law

from ik_toolkit.servo import command, laws, loop, null_space_motion, viability
from ik_toolkit.servo.constrained_step import MODE
from ik_toolkit.servo.laws import LAW
from ik_toolkit.servo.workspace import STATE, bench_on, bench_space


def scratch(rng, n=7, m=6):
    """A bench with a Jacobian that is factored."""
    s = bench_on(np.zeros(bench_space(n, m, 1)), n, m, 1)
    s.J[:], s.floor[:], s.roof[:] = rng.normal(size=(n, m)), -1.0, 1.0
    laws.factor(s.J, m, 0.0, s.G, s.y)
    return s


def null(J):
    return np.eye(len(J)) - np.linalg.pinv(J.T) @ J.T


def test_wishes_are_found_and_added():
    rng = np.random.default_rng(1)
    n = 7
    limits = np.array([np.full(n, -2.0), np.full(n, 2.0), np.ones(n), np.ones(n)])
    wish = np.array([rng.uniform(-1, 1, n), rng.uniform(0.0, 0.2, n), 0.1 * rng.normal(size=n)])
    s = scratch(rng)
    s.at[:] = rng.uniform(-1.9, 1.9, n)
    for avoid in (0.0, 0.4):
        goal = wish[1] * (wish[0] - s.at) + wish[2]
        if avoid:
            null_space_motion.away_from_limits(s.at, limits, avoid, goal)
        base = 0.1 * rng.normal(size=n)
        assert command.desired_null_velocity(law(avoid=avoid), s, limits, wish, base)
        want = null(s.J) @ goal
        room = np.where(want > 0, 0.5 * (1.0 - base), 0.5 * (base + 1.0))
        want *= min(1.0, (room / np.abs(want)).min())
        np.testing.assert_allclose(s.g, want, atol=1e-12)
        s.null[:] = null(s.J) @ rng.normal(size=n)
        for code, h, damped in (
            (LAW.cv, 0.01, 2.0),
            (LAW.av, 0.01, 2.0),
            (LAW.ca, 0.01, 2.0),
            (LAW.ca, 0.2, 2.0),
            (LAW.aa, 0.01, 0.0),
            (LAW.aa, 0.01, 40.0),
        ):
            s.x[:], memory = base, np.full(n, 7.0)
            command.add_secondary_motion(
                law(code, avoid=avoid, null=damped), s, SimpleNamespace(limits=limits, wish=wish), 0.6, h, memory
            )
            # With the damping of the law, which is elsewhere, the joints' own motion comes to what is wished, at 20 1/s or more,
            # or in one step (ca: two thirds of it).
            rate = max(min(20.0, (2.0 / 3.0 if code == LAW.ca else 1.0) / h), damped)
            much = np.linalg.norm(want) / (np.linalg.norm(want) + command.LITTLE)
            more = min(rate * h, 1.0) * much * (want - (1.0 - damped / rate) * s.null) if code >= LAW.ca else want
            kept = {LAW.cv: 1.0, LAW.ca: 1.0 / h}.get(code, 0.0)
            np.testing.assert_allclose(s.x, base + (1.3 if code in (LAW.cv, LAW.ca) else 1.0) * more, atol=1e-12)
            np.testing.assert_allclose(memory, 7.0 + kept * more, atol=1e-12)
    assert not command.desired_null_velocity(law(mode=MODE.clip), s, limits, wish, base)
    assert not command.desired_null_velocity(law(), s, limits, 0.0 * wish, base)
    old = s.at.copy()
    assert command.shift_by_secondary(law(), s, limits, wish, base, 0.1)
    np.testing.assert_allclose(s.at, old + 0.1 * s.g)
    assert s.g.any() and not command.shift_by_secondary(law(), s, limits, 0.0 * wish, base, 0.1) and not s.g.any()
    s.g[:] = 1.0
    assert not command.shift_by_secondary(law(mode=MODE.clip), s, limits, wish, base, 0.1) and not s.g.any()
    both = command.unshifted, command.shift_by_secondary
    assert [command.chosen(rule, *both) for rule in (command.Published(0.0), None)] == [*both]
    assert not command.unshifted(law(), s, limits, wish, base, 0.1)


class Bent:
    """A task whose Jacobian is a function of q."""

    def __init__(self, rng, n=7, m=6):
        self.base, self.slope = rng.normal(size=(n, m)), rng.normal(size=(n, n, m))
        self.desk = SimpleNamespace(
            J=np.zeros((n, m)), w=np.zeros(n), q=np.zeros(n), x=np.zeros(n), dq=np.zeros(n), spent=np.ones(2)
        )
        self.asked = 0

    def stand(self, q):
        self.q = q.copy()

    def see(self):
        return None

    def plain(self):
        return True

    def jacobian(self, look):
        self.asked += 1
        q = getattr(self, "q", np.zeros(len(self.base)))
        self.desk.J[:] = self.base + np.einsum("k,kim->im", q, self.slope)


def test_curvature_by_differences():
    rng = np.random.default_rng(2)
    task, s = Bent(rng), scratch(rng)
    s.weight[:] = 1.0, 1.0, 0.0, 1.0, 1.0, 1.0
    s.at[:], s.x1[:], s.x2[:] = rng.normal(size=(3, 7))
    n = rng.normal(size=3)
    s.flip[:] = n / np.linalg.norm(n)
    null_space_motion.by_difference(task, s)
    want = np.einsum("k,kim,i->m", s.x1, task.slope, s.x2)
    want[3:] -= 2.0 * s.flip[0] * (s.flip[0] @ want[3:])
    want[2] = 0.0
    np.testing.assert_allclose(s.bias, want, atol=1e-8)
    s.x1[:] = 0.0
    null_space_motion.by_difference(task, s)
    np.testing.assert_array_equal(s.bias, 0.0)


# -------------------------------------------------------------------------------------------------- the constrained step


@pytest.mark.parametrize("mode", [MODE.leave, MODE.direct, MODE.clip])
def test_joints_that_swing_gain_speed_gradually_where_something_hinders_them(mode):
    calmed, cases = (
        viability.BIT.calmed,
        ((viability.BIT.velocity, 0.0, True), (0, 1.0, True), (0, 0.0, False), (0, -1.0, False)),
    )
    for why, near, hindered in (*cases, (calmed, 0.0, False), (calmed | viability.BIT.position, 0.0, True)):
        s = scratch(np.random.default_rng(5))
        swings, state = np.zeros((3, 7)), np.zeros(len(STATE))
        s.size[:], s.before[:], s.x[:], state[STATE.near] = 0.8, 1.0, 1.0, near
        for _ in range(1 if hindered else 21):  # for 0.2 s after the last hindrance
            loop.record_oscillation(
                law(mode=mode, gamma=1.0), s, np.array([0] * 6 + [why], np.uint8), swings, 0.01, state
            )
        swings[0, 0] = 3.0
        loop.limit_oscillation(law(mode=mode), s, np.zeros(7), swings, 0.01, state)
        gain = viability.CALMING.gain * 0.8 * 0.01 if hindered and mode != MODE.clip else 1.0
        assert s.roof.tolist() == [gain, *[1.0] * 6] and s.floor.tolist() == [-gain, *[-1.0] * 6]
        assert (swings[2] == 1.0).all()
