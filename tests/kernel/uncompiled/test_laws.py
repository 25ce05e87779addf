"""The published laws, pseudo-inverses, wishes and the clock of a tracker, against numpy."""

import numpy as np
import pytest

from ik_toolkit.servo import laws, loop
from ik_toolkit.servo.constrained_step import MODE, Allowed
from ik_toolkit.servo.laws import LAW, Law
from ik_toolkit.servo.viability import approach
from ik_toolkit.servo.workspace import STATE


def law(code=LAW.cv, **values):
    return Law(**{**dict.fromkeys(Law._fields, 0.0), "code": code, "gamma": 1.0, **values})


def walls_of(planes, edges, rows):
    return Allowed(None, None, planes, edges, rows)


def target(e, ahead):
    """Of which nothing is known but where it is."""
    return laws.TargetMotion(e, ahead, *np.full((3, len(e)), np.nan))


@pytest.mark.parametrize("n", [2, 3, 6, 8])
def test_pseudo_inverses_of_tasks(n):
    rng = np.random.default_rng(n)
    for m in (3, 6):
        J, b = rng.normal(size=(n, m)), rng.normal(size=m)
        if n > 3:
            J[:, 1] = 0.0  # a row that the joints cannot move
        k = max(n, m)
        G, y, out = np.zeros((k, k)), np.empty(k), np.empty(n)
        assert laws.factor(J, m, 0.0, G, y) == 0.0
        laws.apply(J, m, G, b, y, out)
        np.testing.assert_allclose(out, np.linalg.pinv(J.T) @ b, rtol=1e-7, atol=1e-9)
        wide = n >= m
        S = (J.T @ J if wide else J @ J.T) + 0.0
        laws.gram(J, m, wide, 0.25, G)
        size = m if wide else n
        want = S + 0.25 * np.eye(size)
        if n > 3 and wide:
            want[1, 1] = 1.0
        np.testing.assert_allclose(np.tril(G[:size, :size]), np.tril(want), rtol=1e-13)
        low = laws.invert(G, size, y)
        assert low == pytest.approx(1.0 / np.trace(np.linalg.inv(want)), rel=1e-10)
        lowest = np.linalg.eigvalsh(want)[0]
        assert lowest / size <= low <= lowest


def test_damping_fades_in_near_singular_poses():
    rng = np.random.default_rng(0)
    for n in (4, 7):
        U, _ = np.linalg.qr(rng.normal(size=(n, n)))
        V, _ = np.linalg.qr(rng.normal(size=(6, 6)))
        k = min(n, 6)
        for last in (1.0, 0.15, 0.01, 1e-7):
            values = np.append(np.full(k - 1, 2.0), last)
            J = U[:, :k] * values @ V[:, :k].T
            G, y, out = np.zeros((8, 8)), np.empty(8), np.empty(n)
            extra = laws.factor(J, 6, 0.1, G, y)
            s2 = 1.0 / ((k - 1) / 4.0 + 1.0 / last**2)
            want = 0.01 * (1.0 - s2 / 0.04) if s2 < 0.04 else 0.0
            assert extra == pytest.approx(want, rel=1e-5, abs=1e-15)
            b = rng.normal(size=6)
            laws.apply(J, 6, G, b, y, out)
            np.testing.assert_allclose(
                out, U[:, :k] @ (values / (values**2 + extra) * (V[:, :k].T @ b)), rtol=1e-5, atol=1e-8
            )


def test_large_errors_are_closed_no_faster_than_the_joints_brake():
    rng = np.random.default_rng(2)
    h, n, m = 0.01, 7, 6
    for code, natural in ((LAW.cv, 4.0), (LAW.ca, 20.0 / 8.0), (LAW.av, 100.0), (LAW.aa, 100.0)):
        p = law(code, kappa=4.0, kp=20.0, kd=8.0)
        J = rng.normal(size=(n, m))
        for size in (1e-6, 0.3, 5.0):
            for a in (np.inf, 3.0):
                e, ahead = size * rng.normal(size=m), rng.normal(size=m)
                limits = np.array([np.full(n, -9.0), np.full(n, 9.0), rng.uniform(0.5, 1.0, n), np.full(n, a)])
                limits[2, 3] = 0.0  # locked
                G, y, c = np.zeros((n, n)), np.empty(n), np.empty(n)
                laws.factor(J, m, 0.0, G, y)
                want = np.abs(np.linalg.pinv(J.T) @ e)
                f = 1.0
                for i in (0, 1, 2, 4, 5, 6):
                    cap = 0.5 * limits[2, i]
                    if a < np.inf:
                        cap = min(cap, approach(want[i], 0.0, 1.0, h, 0.4 * a, h))
                    f = min(f, cap / (natural * want[i]))
                eased, front = e.copy(), ahead.copy()
                walls, brisk = walls_of(np.empty((0, n)), np.empty(0), -1), laws.CorrectionLimits(0.5, 0.4, 0.0)
                inverse, aim = laws.PseudoInverse(J, G, np.zeros((n, n)), y, np.empty(m)), target(eased, front)
                blocked = laws.ease(p, inverse, aim, h, np.zeros(n), limits, walls, brisk, c)
                assert not blocked
                np.testing.assert_allclose(eased, f * e, rtol=1e-9)
                np.testing.assert_allclose(front, ahead - (1.0 - f) * e, rtol=1e-9, atol=1e-12)


def test_slow_joints_are_spared_where_others_can_close_the_error():
    rng = np.random.default_rng(4)
    p, h, n, m = law(LAW.cv, kappa=4.0), 0.01, 8, 4
    shares = np.array([1.0, 0.004, 0.5, 1.0, 0.03, 0.2, 1.0, 1.0])
    weights = np.array([1.0, 2.0**-8, 1.0, 1.0, 2.0**-6, 1.0, 1.0, 1.0])
    limits = np.array([np.full(n, -9.0), np.full(n, 9.0), 2.0 * shares, np.full(n, 5.0)])
    J, e = rng.normal(size=(n, m)), rng.normal(size=m)
    kept, G, H, y, c = J.copy(), np.zeros((n, n)), np.zeros((n, n)), np.empty(n), np.empty(n)
    assert laws.spare(J, m, e, limits, H, y, c)
    assert np.array_equal(J, kept)
    np.testing.assert_allclose(c, weights * (np.linalg.pinv(J.T * weights) @ e), rtol=1e-6, atol=1e-12)
    laws.factor(J, m, 0.0, G, y)
    eased = {}
    for name, count in (("published", -1), ("spared", 0)):  # walls are looked at in all but the published form
        eased[name] = e.copy()
        inverse, walls = laws.PseudoInverse(J, G, H, y, np.empty(m)), walls_of(np.empty((0, n)), np.empty(0), count)
        brisk = laws.CorrectionLimits(0.5, 0.4, 0.0)
        laws.ease(p, inverse, target(eased[name], e.copy()), h, np.zeros(n), limits, walls, brisk, c)
    assert np.linalg.norm(eased["spared"]) > 5.0 * np.linalg.norm(eased["published"])
    limits[2] = np.linspace(0.2, 2.0, n)  # none below a tenth of the fastest
    before = c.copy()
    assert not laws.spare(J, m, e, limits, H, y, c) and np.array_equal(c, before)


def test_a_way_that_is_barred_is_not_as_far_as_it_seems():
    """Two unit links nearly stretched out, a target beyond: the joints go some way, not the hundreds of radians of J^+ e."""
    p, h, bend, limits = law(LAW.aa), 0.01, 0.01, np.array([[-9.0] * 2, [9.0] * 2, [2.0] * 2, [5.0] * 2])
    J = np.array([[-np.sin(bend), 1.0 + np.cos(bend)], [-np.sin(bend), np.cos(bend)]])
    eased, G, y, c = {}, np.zeros((2, 2)), np.empty(2), np.empty(2)
    laws.factor(J, 2, 0.0, G, y)
    for name, at, planes, curved in (
        ("free", 0.0, [], 1.0), ("at its limit", 9.0, [], 1.0), ("wall", 0.0, [[0.0, -1.0]], 1.0), ("near", 9.0, [], 0.0),
    ):  # fmt: skip
        e, ahead, count = np.array([1.0, 0.0]), np.array([1.0, 0.0]), len(planes)
        walls, brisk = (
            walls_of(np.array(planes).reshape(count, 2), np.zeros(count), count),
            laws.CorrectionLimits(1.0, 0.5, curved),
        )
        inverse = laws.PseudoInverse(J, G, np.zeros((2, 2)), y, np.empty(2))
        blocked = laws.ease(p, inverse, target(e, ahead), h, np.array([at, at]), limits, walls, brisk, c)
        eased[name] = e[0]
        assert blocked == (name != "free")
    assert eased["free"] < 1e-3 and eased["near"] < 1e-3
    assert eased["at its limit"] > 10.0 * eased["free"] and eased["wall"] > 10.0 * eased["free"]


def test_what_was_held_back_becomes_the_earlier_command():
    before, x, code = np.array([1.0, 2.0, 3.0]), np.array([1.5, 1.0, 9.0]), np.array([1, 0, 4])
    for kind, want in ((LAW.cv, [1.5, 7.0, 9.0]), (LAW.ca, [5.0, 7.0, 60.0]), (LAW.av, [7.0] * 3), (LAW.aa, [7.0] * 3)):
        prev = np.full(3, 7.0)
        laws.settle(law(kind), 0.1, before, x, code, prev)
        np.testing.assert_allclose(prev, want)
    wanted, h, ratio = np.array([1.0, 2.0, 3.0]), 0.1, 0.8
    for kind in (LAW.cv, LAW.av, LAW.ca, LAW.aa):
        prev = np.full(3, 7.0)
        laws.rewrite_command(law(kind), h, ratio, wanted, x, prev)
        change = (
            (x - wanted) / {LAW.cv: 1.0, LAW.ca: h}.get(kind, np.inf) / 1.4
        )  # the rates taken are u + ratio/2 (u - old)
        np.testing.assert_allclose(prev, 7.0 + change, rtol=1e-13)


def test_rates_that_cannot_be_followed():
    for mode, runaway, brake, wanted, h, stop in (
        (MODE.clip, 1.0, 0.0, [0.5, -0.5], 1.0, 0), (MODE.clip, 1.0, 0.0, [3.0, -3.0], 0.3, 0),
        (MODE.clip, 1.0, 0.0, [3.0, -3.0], 0.4, 2),
        (0, 1.0, 0.0, [3.0, -3.0], 0.4, 0), (0, 1.0, 0.0, [np.nan, 1.0], 0.1, 1), (0, np.inf, 0.0, [np.nan, 1.0], 0.1, -1),
        (MODE.clip, 1.0, 1.0, [30.0, 1.0], 1.0, -1), (0, 1.0, 0.0, [1.1e300, 0.0], 0.1, 1), (0, 1.0, 0.0, [-0.9e300, 0.0], 0.1, 0),
    ):  # fmt: skip
        x, state = np.array(wanted), np.zeros(len(STATE))
        ended, still = loop.judge(x, h, law(mode=mode, runaway=runaway, brake=brake), state)
        assert ended == (stop > 0) and still == (stop < 0) and state[STATE.stop] == max(stop, 0)
        np.testing.assert_array_equal(x, [0.0, 0.0] if still else wanted)
