"""Errors along a motion: exact step derivatives, against runs of the tracker; least rates and charts."""

import itertools
import math

import numpy as np
import pytest
import robots
from disturbed_runs import cases
from references import MIMIC

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption
from ik_toolkit.motion.reference import exp
from ik_toolkit.servo import orbit_stability as ob

GAINS = {
    "cv": {"kappa": 8.0}, "ca": {"kp": 80.0, "kd": 12.0}, "av": {"share": 0.4}, "aad": {"gamma": 0.7, "share": 0.8},
    "aa": {"share": 1.0, "reading": 1}, "aa2": {"share": 0.6, "reading": 2}, "aa3": {"share": 1.0, "reading": 3},
}  # fmt: skip
CIRCLE = ik.circle(center=[1.0, 0.6, 0.0], radius=0.35, duration=4.0 * np.pi)  # the RR circle of the Patko report


@pytest.mark.parametrize("name", ["planar_2r", "panda", "hydrolek_7w", "cartesian_pp", MIMIC])
def test_derivatives_of_the_jacobian_are_the_differences_they_replace(name):
    robot, rng = ik.Robot.load(name), np.random.default_rng(0)
    Q = np.array([robot.random_q(rng) for _ in range(3)])
    made = ob.jacobians(robot, Q, 6)
    np.testing.assert_allclose(made.J, robot.chain.forward(Q, jacobian=True)[1], atol=1e-13)
    x, y = rng.normal(size=(2, 3, robot.n))

    def curved(at):
        return np.einsum("kmji,ki,kj->km", ob.jacobians(robot, at, 6).H, x, y)

    for i in range(robot.n):
        d = 1e-5 * np.eye(robot.n)[i]
        ends = [robot.chain.forward(Q + s * d, jacobian=True)[1] for s in (1, -1)]
        np.testing.assert_allclose(made.H[..., i], (ends[0] - ends[1]) / 2e-5, atol=1e-8)
        np.testing.assert_allclose(made.third(x, y)[..., i], (curved(Q + d) - curved(Q - d)) / 2e-5, atol=1e-8)


def swing(robot, q, pose, duration):
    """A curve through the tip at q, which also turns if poses count."""
    T0 = np.eye(4)
    T0[:3, :3], T0[:3, 3] = robot.fk(q).rotation, robot.fk(q).translation
    a, b, w = np.array([0.1, 0.05, -0.08]), np.array([-0.04, 0.1, 0.06]), np.array([0.5, -0.3, 0.4])
    if robot.n == 2:
        a[2] = b[2] = 0.0

    def at(t):
        s, c = np.sin(t)[:, None], np.cos(t)[:, None]
        T, V, A = np.tile(T0, (len(t), 1, 1)), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        T[:, :3, 3] += s * a + (1.0 - c) * b
        V[:, :3], A[:, :3] = c * a + s * b, -s * a + c * b
        if pose:
            T[:, :3, :3] = exp(s * w) @ T0[:3, :3]
            V[:, 3:], A[:, 3:] = c * w, -s * w
        return T, V, A

    return ik.Reference(at, duration, position_only=not pose)


@pytest.mark.parametrize(
    ("name", "pose"), [("planar_2r", False), ("panda", True), ("panda", False), ("hydrolek_7w", True)]
)
@pytest.mark.parametrize("key", GAINS)
def test_a_disturbance_goes_as_the_exact_derivative_of_the_steps_says(name, pose, key):
    """Runs of the tracker from beside the path, so that no error, null-space motion or turning of the target is zero."""
    robot, rng, method, gains = robots.load(name), np.random.default_rng(1), key.rstrip("23"), GAINS[key]
    h, count, n, m = 0.05, 6, robot.n, 6 if pose else 3
    q = robot.home + 0.3 * rng.normal(size=n)
    path = swing(robot, q, pose, h * count)
    q0, rate0 = q + 0.02 * rng.normal(size=n), 0.3 * rng.normal(size=n)
    null = 0.0 if method in ("cv", "av") else 1.0
    options = gains | {"damping": 0.0} | ({"null_damping": null} if null else {})

    def run(q0, rate0):
        return ik.track(robot, path, method, dt=h, q0=q0, rate0=rate0, limits=False, **options)

    base = run(q0, rate0)
    T, V, A = path.at(path.times(h))
    tip = robot.chain.forward(base.q)[0]
    error, ahead = ob.tip_errors(T, tip, m)[:-1], ob.tip_errors(T[1:], tip[:-1], m)
    state = ob.OrbitState(base.rate[:-1], error, ahead, V[:-1, :m], A[:-1, :m])
    steps = ob.step_matrices(ob.jacobians(robot, base.q, m), state, method, h, gains, null)
    dq, dr = rng.normal(size=(2, n))
    if method in ("cv", "av"):
        dr[:] = 0.0  # the rates are no state of these methods
    ends = [run(q0 + s * dq, rate0 + s * dr).q for s in (1e-6, -1e-6)]
    z = np.r_[dq, dr, np.zeros(n)][: steps.shape[-1]] if method != "cv" else np.r_[dq, np.zeros(n)]
    if method in ("cv", "ca"):  # A run begins with an Euler step, as if the previous command equalled the first.
        z[-n:] = (steps[0] @ z)[-n:]
    for k, A in enumerate(steps):
        z = A @ z
        np.testing.assert_allclose((ends[0] - ends[1])[k + 1] / 2e-6, z[:n], atol=1e-7)


@pytest.mark.parametrize(
    ("method", "gains", "rate"), [("cv", {"kappa": 5.0}, 5.083), ("ca", {"kp": 61.0, "kd": 3.8}, 5.185)]
)
def test_runs_stay_just_above_the_least_rate_and_diverge_just_below(method, gains, rate):
    """The "bad" RR gains of Patko and Zelei, which at rest are stable from 5 and 4.964 Hz."""
    robot, laps = robots.load("planar_2r"), 16
    found = ik.least_rate(robot, CIRCLE, method, **gains)
    assert found.rate == pytest.approx(rate, abs=2e-3) and found.bands == ((found.rate, found.most),)
    assert f"{rate:.4g} to" in found.message and found.at_rest < 0.99 * rate
    long = ik.circle(center=[1.0, 0.6, 0.0], radius=0.35, turns=laps, duration=4.0 * np.pi * laps)
    q0 = ik.solve(robot, long.target(0.0), q0=robot.home).q
    for factor, stays in ((1.01, True), (0.99, False)):
        h = 1.0 / (factor * found.rate)
        assert ik.check_gains(method, h, robot=robot, path=CIRCLE, **gains).stable == stays
        run, other = (
            ik.track(robot, long, method, dt=h, q0=q, limits=False, damping=0.0, **gains)
            for q in (q0, q0 + np.array([1e-8, -5e-9]))
        )
        last = min(len(run.q), len(other.q)) - 1
        assert (np.abs(run.q[last] - other.q[last]).max() < 1e-9) == stays
        assert (run.position_error[-20:].max() < 1e-3) == stays


def test_bands_of_stable_rates_are_found_and_the_last_one_counts():
    """Growth over the rate need not fall steadily; here it is below 1 from 2 to 3, and from 5 on."""

    def factor(rate):
        return 0.5 if 2.0 < rate < 3.0 or rate > 5.0 else 2.0

    rates, factors, bands = ob.stable_bands(factor, 1.0, 50.0)
    assert np.abs(np.array(bands) - [[2.0, 3.0], [5.0, 50.0]]).max() < 1e-3
    assert all(factor(rate) < 1.0 for band in bands for rate in band)  # the stable side of each border
    assert (rates[1:] / rates[:-1]).max() <= 1.05 and rates[-1] == 50.0 and len(rates) == len(factors)
    assert ob.stable_bands(lambda rate: 2.0, 1.0, 9.0)[2] == ()
    assert ob.stable_bands(lambda rate: 0.5, 1.0, 9.0)[2] == ((1.0, 9.0),)


def test_a_lower_band_is_told_apart_from_the_least_rate(monkeypatch):
    """No path with such a band is known, so the growth is made up: below 1 from 4 to 4.6 Hz, and from 6 Hz on."""

    def growth(motion, method, h, gains, null_damping):
        return ob.Growth(0.5 if 4.0 < 1.0 / h < 4.6 or 1.0 / h > 6.0 else 2.0, 1.0, True)

    monkeypatch.setattr(ob.PathMotion, "growth", growth)
    found = ik.least_rate(robots.load("planar_2r"), CIRCLE, "cv", kappa=5.0)
    assert found.rate == pytest.approx(6.0, abs=1e-3) and len(found.bands) == 2
    assert "; also stable from 4" in found.message and found.message.endswith("to 4.6 Hz.")


def test_the_best_gains_for_each_rate_need_a_rate_of_their_own():
    robot = robots.load("planar_2r")
    found = ik.least_rate(robot, CIRCLE, "ca")
    assert 0.5 < found.rate < 2.0 and found.at_rest == 0.0 and "best gains for each rate" in found.message
    marginal = ik.least_rate(robot, CIRCLE, "aa", most=20.0)
    assert marginal.rate == math.inf and "is unstable at 20 Hz" in marginal.message
    assert ik.least_rate(robot, CIRCLE, "aad").rate < 0.4


def test_a_fixed_gain_leaves_the_chart_at_its_least_rate():
    robot = robots.load("planar_2r")
    least = ik.least_rate(robot, CIRCLE, "cv", kappa=5.0).rate
    samples = [round(f * least * CIRCLE.duration) for f in (1.05, 0.95)]
    found = ik.stability_chart(
        robot, CIRCLE, "cv", gain=[5.0 / (s / CIRCLE.duration) for s in samples], samples=samples
    )
    assert found.stable[0, 0] and not found.stable[1, 1]
    assert found.travel == pytest.approx(0.7 * np.pi / np.array(samples), rel=1e-4)
    axis = ik.plot(found).axes[0]
    assert axis.get_xlabel() == r"$\kappa$ h" and axis.get_title(loc="left") == "planar_2r along 'circle': cv"
    assert ik.stability_chart(robot, CIRCLE, gain=[0.5]).samples[[0, -1]].tolist() == [12, 240]
    slow = ik.stability_chart(robot, CIRCLE, "ca", gain=[0.2, 0.9, 0.99, 1.01], samples=[3000])
    assert slow.stable.tolist() == [[True, True, True, False]] and slow.shape == pytest.approx(2.259, abs=1e-3)


def test_redundant_arms_are_judged_by_their_tip():
    """Null-space motion, which av and cv leave as it is, is no error: the growth is that of the tip."""
    robot = robots.load("planar_3r")
    path = ik.circle(robot.fk(robot.home + 0.3).translation - [0.3, 0.0, 0.0], 0.3, duration=4.0)
    found = ik.least_rate(robot, path, "cv", kappa=10.0)
    assert 10.0 < found.rate < 10.5
    for rate, grows in ((1.02 * found.rate, False), (0.98 * found.rate, True)):
        assert (ik.check_gains("cv", 1.0 / rate, kappa=10.0, robot=robot, path=path).along.factor > 1.0) == grows


RATE, CHART = ik.least_rate, ik.stability_chart


@pytest.mark.parametrize(("ask", "method", "wrong", "words"), [
    (RATE, "cv", {"kapa": 1.0}, "no gain 'kapa'"), (RATE, "cv", {"kappa": 0.0}, "stable at no rate"),
    (RATE, "cv", {"kappa": 5.0, "most": 1.0}, "above"), (RATE, "cv", {"most": -1.0}, "most"), (RATE, "cv", {"kappa": "x"}, "kappa"),
    (RATE, "cv", {"null_damping": None}, "null_damping"), (RATE, "ca", {"kp": 3.0}, "kd must be a number"),
    (CHART, "av", {}, "av"), (CHART, "cv", {"gain": [0.0]}, "gain"), (CHART, "cv", {"samples": [2]}, "samples"),
    (CHART, "cv", {"samples": [7.5]}, "samples"), (CHART, "ca", {"shape": -1.0}, "shape"),
])  # fmt: skip
def test_mistakes_are_typed(ask, method, wrong, words):
    with pytest.raises(InvalidOption, match=words):
        ask(robots.load("planar_2r"), CIRCLE, method, **wrong)
    with pytest.raises(InvalidOption, match="a Reference"):
        ask(robots.load("planar_2r"), "circle")


def test_the_product_foretells_which_runs_stay():
    """The first 60 cases of scripts/theory_patko.py.

    A redundant arm at acceleration level has null-space motion, by which its runs may leave the configurations that were judged.
    """
    made = []
    for seed in itertools.count():
        made += cases(seed)
        if len(made) >= 60:
            break
    wrong = [one for one in made if one.verdict == "contradict"]
    assert all(one.method in ("ca", "aad") and one.joints > one.errors for one in wrong)
    assert len(wrong) <= 0.03 * len(made) and sum(one.verdict == "agree" for one in made) > 0.85 * len(made)
    assert min(sum((one.foretold > 1.0) == grows for one in made) for grows in (True, False)) > 10


def test_an_open_path_is_judged_alike_in_every_unit_of_time():
    arm = robots.load("planar_2r")
    seen = []
    for duration in (0.1, 1.0, 100.0):
        h = duration / 12.0
        path = ik.line((1.4, 0.2, 0.0), (1.2, 0.9, 0.0), duration=duration)
        cv = ik.check_gains("cv", h, kappa=0.9 / h, robot=arm, path=path).along
        ca = ik.check_gains("ca", h, kp=1.6 / h**2, kd=0.8 / h, robot=arm, path=path).along
        seen.append((cv.factor, ca.factor))
    assert np.allclose(seen, seen[0], rtol=1e-9) and seen[0] == pytest.approx((0.1353859, 0.00777213), rel=1e-5)


def test_the_posture_near_q0_is_judged_and_the_verdict_includes_the_path():
    arm, q0 = robots.load("ur5"), np.array([0.1, -0.86, 1.17, 2.23, 1.2, -2.84])
    path = ik.circle(start=arm.fk(q0).homogeneous, radius=0.2, duration=2.0)
    home, there = (
        ik.check_gains("cv", 1 / 13, kappa=12.0, robot=arm, path=path, **given) for given in ({}, {"q0": q0})
    )
    assert home.along.factor < 0.2 and home.verdict == "stable"
    assert there.along.factor > 1.5 and there.verdict == "unstable"
    far = ik.circle((1.35, 0.6, 0.0), radius=0.6, duration=4.0)
    assert ik.check_gains("cv", 0.2, kappa=5.0, robot=robots.load("planar_2r"), path=far).verdict == "unstable"
    for words, change in (("at rest only", {"delay": 2}), ("null_damping", {"null_damping": -1.0}), ("samples", {})):
        kappa = 20000.0 if not change else 4.0
        with pytest.raises(InvalidOption, match=words):
            ik.check_gains("cv", 1.0 / kappa / 4, kappa=kappa, robot=robots.load("planar_2r"), path=far, **change)
