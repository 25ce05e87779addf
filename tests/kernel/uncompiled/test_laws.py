"""Damping near singular poses, and slow joints that are spared, against numpy."""

import numpy as np
import pytest
from constrained import law

from ik_toolkit.servo import laws
from ik_toolkit.servo.constrained_step import Allowed
from ik_toolkit.servo.laws import LAW


def walls_of(planes, edges, rows):
    return Allowed(None, None, planes, edges, rows)


def target(e, ahead):
    """Of which nothing is known but where it is."""
    return laws.TargetMotion(e, ahead, *np.full((3, len(e)), np.nan))


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
