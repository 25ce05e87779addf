"""Mapping matrices, closed-form stability regions, best gains and the check of a user's gains."""

import math

import numpy as np
import pytest
from folders import read_data

import ik_toolkit as ik
from ik_toolkit.errors import InvalidOption, InvalidTarget
from ik_toolkit.servo import stability as st

ORACLE = read_data("tracking")["stability"]


def test_published_gain_sets():
    for row in ORACLE["published"]:
        h = row["h"]
        cv = st.check_gains("cv", h, kappa=row["kappa"])
        ca = st.check_gains("ca", h, kp=row["kp"], kd=row["kd"])
        assert cv.radius == pytest.approx(row["cv_rho"], abs=1e-9)
        assert ca.radius == pytest.approx(row["ca_rho"], abs=1e-9)
        assert (cv.verdict, ca.verdict) == (row["cv_verdict"], row["ca_verdict"])
        assert st.p_limit(row["kd"] * h) == pytest.approx(row["p_limit"], abs=1e-9)


@pytest.mark.parametrize("gains", [dict(kp=0.0, kd=5.0), dict(kp=100.0, kd=0.0), dict(kp=-1.0, kd=5.0)])
def test_without_both_gains_no_step_is_short_enough(gains):
    assert st.longest_step("ca", **gains) == 0.0 and st.longest_step("ca", kp=100.0, kd=5.0) > 0.01


def test_the_contradiction_of_the_rr_set():
    """The RR set the paper calls unstable: cv exactly on the border, ca inside the region by 0.9 %."""
    A = st.mapping_matrix("cv", 0.2, kappa=5.0, dof=2)
    assert abs(st.spectral_radius(A) - 1.0) < 1e-12
    ca = st.check_gains("ca", 0.2, kp=61.0, kd=3.8)
    assert ca.stable and ca.radius == pytest.approx(0.990976596748, abs=1e-9)
    assert not st.check_gains("ca", 0.2, kp=61.6, kd=3.8).stable


def test_random_points_of_the_oracle():
    for method, names in (("cv", ("kappa",)), ("ca", ("kp", "kd"))):
        for row in ORACLE[f"random_{method}"]:
            got = st.check_gains(method, row["h"], **{name: row[name] for name in names})
            assert got.radius == pytest.approx(row["rho"], abs=1e-9) and got.stable == row["stable"]


def test_closed_form_agrees_with_eigenvalues_on_100000_points():
    rng = np.random.default_rng(5)
    p, d, k = rng.uniform(-0.5, 4.0, 100_000), rng.uniform(-0.2, 1.4, 100_000), rng.uniform(-0.5, 1.5, 100_000)
    ca = np.zeros((100_000, 3, 3))
    ca[:, 0] = np.stack([1 - 0.75 * p, 1 - 0.75 * d, np.full_like(p, -0.25)], 1)
    ca[:, 1] = np.stack([-1.5 * p, 1 - 1.5 * d, np.full_like(p, -0.5)], 1)
    ca[:, 2, 0], ca[:, 2, 1] = -p, -d
    assert np.array_equal(ca[0], st.mapping_matrix("ca", 1.0, kp=p[0], kd=d[0]))  # the vectorised copy is the real one
    rho = np.abs(np.linalg.eigvals(ca)).max(1)
    clear = np.abs(rho - 1.0) > 1e-9
    assert clear.mean() > 0.999
    stable = (0.0 < d) & (d < 1.0) & (0.0 < p) & (p < st.p_limit(np.where(d > 0.0, d, 0.0)))
    assert np.array_equal(stable[clear], rho[clear] < 1.0)
    cv = np.zeros((100_000, 2, 2))
    cv[:, 0, 0], cv[:, 0, 1], cv[:, 1, 0] = 1 - 1.5 * k, -0.5, -k
    rho = np.abs(np.linalg.eigvals(cv)).max(1)
    assert np.array_equal((0.0 < k) & (k < 1.0), rho < 1.0)


def test_several_joints_repeat_the_eigenvalues():
    """Eqs (39)-(42), with kd in entry (3,3) of (41): twice the eigenvalues of the single joint."""
    one = st.mapping_matrix("ca", 0.0628, kp=365.0, kd=12.5)
    two = st.mapping_matrix("ca", 0.0628, kp=365.0, kd=12.5, dof=2)
    assert two.shape == (6, 6)
    assert two[2, 2] == two[3, 3] == pytest.approx((2 - 3 * 12.5 * 0.0628) / 2)
    assert st.spectral_radius(two) == pytest.approx(st.spectral_radius(one), abs=1e-12)
    misprint = two.copy()
    misprint[2, 2] = (2 - 3 * 365.0 * 0.0628) / 2
    assert st.spectral_radius(misprint) > 30.0


def test_best_gains_are_the_minimum():
    best = st.best_gains("ca", 0.01)
    radius = st.check_gains("ca", 0.01, **best).radius
    assert radius == pytest.approx(0.195800350656, abs=1e-4)  # a triple root: eigenvalues are good to eps^(1/3)
    assert best["kd"] * 0.01 == pytest.approx(0.869973567565, abs=1e-9)
    assert best["kp"] * 0.01**2 == pytest.approx(1.70992093416, abs=1e-9)
    rng = np.random.default_rng(0)
    for dp, dd in rng.normal(0.0, 0.05, (200, 2)):
        if math.hypot(dp, dd) > 0.01:
            assert st.check_gains("ca", 0.01, kp=best["kp"] * (1 + dp), kd=best["kd"] * (1 + dd)).radius > radius + 1e-3
    assert st.check_gains("cv", 0.01, **st.best_gains("cv", 0.01)).radius == pytest.approx(1 / math.sqrt(3), abs=1e-7)
    for k in (0.6, 0.64, 0.7, 0.75):
        assert st.spectral_radius(st.mapping_matrix("cv", 1.0, kappa=k)) > 1 / math.sqrt(3) + 1e-3


def test_methods_without_gains():
    assert st.spectral_radius(st.mapping_matrix("av", 0.1)) == 0.0
    assert sorted(np.linalg.eigvals(st.mapping_matrix("aa", 0.1)).real) == [-1.0, 0.0]
    assert st.check_gains("aa", 0.1).verdict == "marginal"
    assert "aad" in st.check_gains("aa", 0.1).message
    assert st.spectral_radius(st.mapping_matrix("aad", 0.1, gamma=0.6)) == pytest.approx(2 / 3)
    assert st.check_gains("aad", 0.1, gamma=0.45).verdict == "unstable"


@pytest.mark.parametrize("method, gains", [("cv", {"kappa": 17.0}), ("ca", {"kp": 400.0, "kd": 6.0})])
def test_unstable_gains_get_a_sentence_and_a_way_out(method, gains):
    h = 0.0628
    found = st.check_gains(method, h, **gains)
    assert found.verdict == "unstable" and found.radius > 1.0
    assert "unstable" in found.message and "Hz" in found.message
    assert st.check_gains(method, h, **found.suggestion).stable
    assert st.check_gains(method, found.longest_step * 0.999, **gains).stable
    assert not st.check_gains(method, found.longest_step * 1.001, **gains).stable
    assert st.check_gains("cv", 0.01, kappa=300.0).message == (
        "cv at h = 0.01 s is unstable at rest: kappa h = 3, stable between 0 and 1; spectral radius 3.886. "
        "Try kappa = 66.667, or a rate above 300 Hz."
    )


# ------------------------------------------------------------------------------------------- delay, noise, a path
GAINS = [
    ("cv", {"kappa": 30.0}), ("ca", {"kp": 1200.0, "kd": 50.0}), ("av", {}), ("av", {"share": 0.3}), ("aad", {"gamma": 0.7}),
    ("aad", {"gamma": 0.7, "share": 0.2}),
]  # fmt: skip


def late_joint(method, h, gains, delay, steps, noise=None):
    """Positions of a joint held at 0 from 1, and rates, its error measured `delay` samples late: the published steps."""
    q, rate, before = 1.0, 0.0, None
    seen, rates = [q], [rate]
    for i in range(steps):
        at = max(i - delay, 0)
        k = math.floor(at)
        e = -(seen[k] + (at - k) * (seen[min(k + 1, i)] - seen[k])) - (0.0 if noise is None else noise[i])
        if method == "cv":
            u = gains["kappa"] * e
            rate, before = (3.0 * u - (u if before is None else before)) / 2.0, u
            q += h * rate
        elif method == "ca":
            a = gains["kp"] * e - gains["kd"] * rate
            faster = rate + h * (3.0 * a - (a if before is None else before)) / 2.0
            q, rate, before = q + h * (rate + faster) / 2.0, faster, a
        elif method == "av":
            e *= gains.get("share", 1.0)
            q, rate = q + e, e / h
        else:
            e *= gains.get("share", 1.0)
            a = (e / h - rate) / (gains["gamma"] * h)
            q, rate = q + h * rate + gains["gamma"] * h * h * a, rate + h * a
        seen.append(q)
        rates.append(rate)
    return np.array(seen), np.array(rates)


@pytest.mark.parametrize("delay", [0, 1, 2.5, 6])
@pytest.mark.parametrize(("method", "gains"), GAINS)
def test_a_delay_grows_or_shrinks_as_simulated(method, gains, delay):
    h = 0.01
    found = st.check_gains(method, h, delay=delay, **gains)
    q = np.abs(late_joint(method, h, gains, delay, 1200)[0])
    # the envelope, for a complex pair swings
    early, late = q[100:600].max(), q[600:].max()
    if found.radius > 1.0 + 1e-3:
        assert not found.stable and late > 2.0 * early
        assert math.log(q[1100:].max() / q[600:701].max()) / 500 == pytest.approx(math.log(found.radius), rel=0.05)
    elif found.radius < 1.0 - 1e-3:
        assert found.stable and late < max(early, 1e-12)
    assert st.check_gains(method, h, delay=0.0, **gains).radius == pytest.approx(
        st.spectral_radius(st.mapping_matrix(method, h, **gains)), abs=1e-12
    )


def test_gains_for_a_delay_are_stable_and_the_least_that_a_search_finds():
    rng = np.random.default_rng(4)
    for method, delay in (("cv", 2), ("ca", 2), ("cv", 8), ("ca", 5.5), ("av", 3), ("aad", 2)):
        usual = st.check_gains(method, 0.01, delay=delay, **st.best_gains(method, 0.01))
        assert not usual.stable and "samples ago" in usual.message and "Try" in usual.message
        best = st.check_gains(method, 0.01, delay=delay, **usual.suggestion)
        assert best.stable and best.radius < 0.97
        for factors in rng.uniform(0.7, 1.4, (15, 2)):
            other = {k: v * f for (k, v), f in zip(usual.suggestion.items(), factors, strict=False)}
            assert st.check_gains(method, 0.01, delay=delay, **other).radius > best.radius - 0.01
        gains = best.suggestion
        longest = st.check_gains(method, 0.01, delay=delay, **gains).longest_step
        if "share" in gains:  # is one of samples, whatever their length
            assert longest == math.inf
            continue
        assert st.check_gains(method, 0.999 * longest, delay=delay, **gains).stable
        assert not st.check_gains(method, 1.001 * longest, delay=delay, **gains).stable


@pytest.mark.parametrize("method, delay, gains", [("cv", 0.5, {"kappa": 1.0}), ("ca", 0.1, {"kp": 5.0, "kd": 1.0})])
def test_a_delay_of_part_of_a_sample_may_allow_longer_steps_than_none(method, delay, gains):
    longest = ik.check_gains(method, 0.01, delay=delay, **gains).longest_step
    assert longest > 1.05 * ik.check_gains(method, 0.01, **gains).longest_step
    assert ik.check_gains(method, 0.999 * longest, delay=delay, **gains).stable
    assert not ik.check_gains(method, 1.001 * longest, delay=delay, **gains).stable


@pytest.mark.parametrize(
    "method, delay", [("cv", 0), ("cv", 2), ("ca", 0), ("ca", 2), ("aad", 0), ("av", 0), ("av", 2)]
)
def test_noise_gain_is_what_a_simulation_shows(method, delay):
    h = 0.01
    gains = {"gamma": 0.7} if method == "aad" else st.best_gains(method, h, delay)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(60_000)
    q, rates = (part[1000:] for part in late_joint(method, h, gains, delay, len(noise), noise))
    found = st.check_gains(method, h, delay=delay, noise=1e-3, **gains)
    rate = h * np.sqrt((rates**2).mean())
    assert np.sqrt((q**2).mean()) == pytest.approx(1e-3 * found.noise_gain, rel=0.02)
    assert rate == pytest.approx(1e-3 * st.noise_gains(method, h, delay, **gains)[1], rel=0.02)
    assert "Noise of 0.001" in found.message
    assert st.noise_gains("av", h)[0] == pytest.approx(1.0)  # av does what the noise says
    assert st.check_gains("av", h, delay=2, noise=1e-3).noise_gain == math.inf


@pytest.mark.parametrize(
    ("delay", "gain"), [(0, 0.3), (0, 0.9), (0, 1.1), (2, 0.2), (2, 0.5), (2, 0.7), (5, 0.1), (5, 0.4)]
)
def test_feedback_of_late_joints_rests_or_swings_as_its_gains_are_judged(delay, gain):
    """A loop written here: cv by Adams-Bashforth 2, fed back where the joints were `delay` samples ago."""
    h, robot = 0.01, ik.Robot.load("hydrolek_7w")
    target = robot.fk(robot.home).translation
    commands = [robot.home + 1e-3 * np.random.default_rng(3).standard_normal(robot.n)]
    before = np.zeros(robot.n)
    for k in range(400):
        late = commands[max(k - delay, 0)]
        move = gain * np.linalg.pinv(robot.jacobian(late)[:3]) @ (target - robot.fk(late).translation)
        commands.append(commands[-1] + 1.5 * move - 0.5 * before)
        before = move
    move = np.abs(np.diff(commands, axis=0)).max(axis=1)
    if st.check_gains("cv", h, delay=delay, kappa=gain / h).stable:
        assert move[-50:].max() < 1e-7
    else:
        assert move[-50:].max() > 1e-4


def test_growth_along_a_path_is_the_papers_lap():
    """The set of the RR arm that is inside the region at rest and yet diverges on its circle, as measured by disturbing a run."""
    robot = ik.Robot.load("planar_2r")
    circle = ik.circle(center=[1.0, 0.6, 0.0], radius=0.35, duration=4.0 * np.pi)
    h = 4.0 * np.pi / 63
    gains = {"kp": 61.0, "kd": 3.8}
    ca = st.check_gains("ca", h, robot=robot, path=circle, **gains)
    assert st.check_gains("ca", h, **gains).stable and not ca.stable
    assert ca.along.closed and ca.along.factor == pytest.approx(17.57, rel=0.02)  # per_step 1.0465 in the seed's notes
    cv = st.check_gains("cv", h, kappa=5.0, robot=robot, path=circle)
    assert cv.along.factor == pytest.approx(3.216, rel=0.02) and "a lap" in cv.message
    good = st.check_gains("ca", h, kp=40.0, kd=4.0, robot=robot, path=circle)
    assert good.stable and good.along.factor < 1e-6
    assert st.check_gains("aa", h, robot=robot, path=circle).along.factor == pytest.approx(10.7, rel=0.05)
    assert st.check_gains("aad", h, robot=robot, path=circle).stable


@pytest.mark.parametrize(
    ("arguments", "options", "words"),
    [
        (("ca", 0.1), dict(kp=1.0), "kp and kd"),
        (("aadd", 0.1), {}, "Did you mean 'aad'"),
        (("cv", 0.1), dict(kapa=1.0), r"no gain 'kapa'\. Did you mean 'kappa'"),
        (("cv", 0.0), dict(kappa=1.0), "sample time"),
        (("cv", 0.01), dict(kappa=10.0, delay=-1), "number of samples"),
        (("cv", 0.01), dict(kappa=10.0, robot="planar_2r"), "both robot= and path="),
        (("cv", 0.01), dict(kappa=10.0, robot="planar_2r", path=[1, 2]), "a Reference"),
        (
            ("cv", 0.01),
            dict(kappa=10.0, robot="planar_2r", path=ik.line((1, 0, 0), (3, 0, 0), duration=1.0)),
            "cannot be followed",
        ),
        (
            ("cv", 0.01),
            dict(kappa=10.0, robot="planar_2r", path=ik.circle((1, 0, 0), 9e99, duration=1.0)),
            r"'circle' is not finite, or beyond 1e\+100, at t = 0 s",
        ),
    ],
)
def test_mistakes_are_typed(arguments, options, words):
    if "robot" in options:
        options = options | {"robot": ik.Robot.load(options["robot"])}
    with pytest.raises((InvalidOption, InvalidTarget), match=words):
        st.check_gains(*arguments, **options)


@pytest.mark.parametrize("method", ["cv", "ca", "av"])
def test_gains_for_late_measurements_are_the_best(method):
    given = st.best_gains(method, 0.01, 2)
    assert all(ik.check_gains(method, 0.01, delay=age, **given).verdict == "stable" for age in range(7))


@pytest.mark.parametrize(("method", "gains"), [("cv", {"kappa": 40.0}), ("ca", {"kp": 61.0, "kd": 3.8})])
def test_a_rate_that_is_named_is_stable_along_the_path(method, gains):
    """Also where the gains are unstable at rest: the rate that is stable there is too low along the path."""
    robot = ik.Robot.load("planar_2r")
    path = ik.circle(robot.fk(robot.home + 0.4).translation, 0.3, duration=2.0)
    check = st.check_gains(method, 1.0 / 4.97, robot=robot, path=path, **gains)
    assert check.verdict == "unstable" and f"a rate above {1.0 / check.longest_step:.4g} Hz is stable" in check.message
    assert "Try" not in check.message
    above, below = (
        st.check_gains(method, check.longest_step * f, robot=robot, path=path, **gains) for f in (0.999, 1.1)
    )
    assert above.along.factor < 1.0 <= below.along.factor


@pytest.mark.parametrize(("turns", "rates"), [(1.0, (9.0, 9.93, 10.0)), (0.9, (5.0, 50.0))])
def test_a_lap_is_closed_whatever_the_rate_and_most_of_one_is_not(turns, rates):
    """At 9.93 Hz the last sample of a lap of 2 s is 0.09 s before its end; at 5 Hz half of a gap is one sample long."""
    robot = ik.Robot.load("planar_2r")
    path = ik.circle(robot.fk(robot.home + 0.4).translation, 0.3, turns=turns, duration=2.0)
    for rate in rates:
        assert st.check_gains("ca", 1.0 / rate, robot=robot, path=path, kp=61.0, kd=3.8).along.closed == (turns == 1.0)


def test_a_path_outside_the_joint_limits_is_said():
    """The hole that the limits of the elbow leave: without limits the path is followed, with them it is not."""
    robot = ik.Robot.load("planar_2r")
    path = ik.circle((0.3, 0.0, 0.0), 0.15, duration=10.0)
    for message in (
        st.check_gains("cv", 0.02, robot=robot, path=path, kappa=20.0).message,
        ik.least_rate(robot, path, "cv", kappa=20.0, most=50.0).message,
    ):
        assert "would leave theirs" in message and robot.joint_names[1] in message
    near = ik.circle(robot.fk(robot.home + 0.4).translation, 0.1, duration=2.0)
    assert "leave theirs" not in st.check_gains("cv", 0.02, robot=robot, path=near, kappa=20.0).message
