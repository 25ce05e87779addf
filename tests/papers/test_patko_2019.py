"""Patko and Zelei (2019): settled errors, orders, growth and the report, against an independent implementation."""

import json
import re

import numpy as np
import pytest
from folders import read_data

from ik_toolkit.papers.patko_2019 import cases, dynamics, paper
from ik_toolkit.servo import stability as st
from ik_toolkit.servo.methods import simulate
from ik_toolkit.show.plots import drawing
from ik_toolkit.style import PRINTED

ORACLE = read_data("tracking")
# Case and gain set of each of the oracle's runs; there `aad` has gamma 1.
SETS = {
    "1dof": "1-DoF",
    "PP_unstable": "PP bad",
    "PP_stable": "PP good",
    "RR_unstable": "RR bad",
    "RR_stable": "RR good",
}
RUNS = [(case, name) for case in ("1dof", "PP", "RR") for name in ORACLE["runs"][case]]
CHAOTIC = ("RR_unstable|exact|cv", "RR_unstable|offset|cv")


def one_run(case, name):
    gains, start, key = name.split("|")
    system = "1-DoF" if case == "1dof" else case
    changes = {"gamma": 1.0} if key == "aad" else {}
    made = cases.known_run(system, cases.SETS[SETS[gains]], key, 1.0 if start == "offset" else 0.0, **changes)
    return cases.CASES[system], made


@pytest.mark.parametrize("case, name", RUNS)
def test_settled_errors(case, name):
    wanted = ORACLE["runs"][case][name]
    system, made = one_run(case, name)
    if "diverged_at" in wanted:
        assert made.stopped and np.isfinite(made.q).all() and np.isfinite(made.error).all()
        assert len(made.t) - 1 == pytest.approx(wanted["diverged_at"], abs=10)
        return
    if name in CHAOTIC:  # wanders at metres; its numbers depend on rounding
        assert np.abs(made.error[len(made.error) // 2 :]).max() > 1.0
        return
    got = cases.settled(system, made)
    for figure in ("max", "rms", "rms_all"):
        assert got[figure] == pytest.approx(wanted[figure], rel=0.02, abs=1e-15)
    if not name.endswith(("aad", "unstable|offset|ca")):  # grids between samples differ there
        assert got["dense"] == pytest.approx(wanted["dense"], rel=0.02)


def test_a_linear_arm_is_exact_at_samples_and_zigzags_between():
    """PP: av and aa are exact at the samples; aa then overshoots by half the initial error for ever, aad does not."""
    case = cases.CASES["PP"]
    for key in ("av", "aa1", "aa2", "aa3", "aad"):
        made = cases.run(case, cases.SETS["PP good"], key, case.offset)
        assert np.abs(made.error[2:]).max() < 1e-15
        dense = cases.settled(case, made)["dense"]
        half = 0.5 * np.linalg.norm(case.offset)
        assert dense == pytest.approx(half, rel=1e-3) if key.startswith("aa") and key != "aad" else dense < 2e-4


@pytest.mark.parametrize("gamma", ["0.5", "0.55", "0.6", "0.75", "1.0", "1.5"])
def test_aad_trades_zigzag_for_nothing_at_the_samples(gamma):
    wanted = ORACLE["aad_gamma"][gamma]
    case = cases.CASES["RR"]
    made = cases.run(case, cases.SETS["RR good"], "aad", case.offset, gamma=float(gamma))
    got = cases.settled(case, made)
    assert got["max"] == pytest.approx(wanted["max"], rel=1e-6)
    assert got["dense"] == pytest.approx(wanted["dense"], rel=0.02)


@pytest.mark.parametrize("row", [*ORACLE["orders"]["RR"]])
def test_orders_on_the_rr_arm(row):
    wanted = ORACLE["orders"]["RR"][row]
    key = row.split("_")[0]
    errors = []
    for h in wanted["h"][1:4]:
        gains = cases.GainSet("", h, 2 / 3 / h, 1.6 / h**2, 0.8 / h, "", "") if "scaled" in row else cases.SETS["1-DoF"]
        e = np.linalg.norm(cases.known_run("RR", gains, key, h=h, steps=round(8 * np.pi / h)).error, axis=1)
        errors.append(e[len(e) // 2 :].max())
    assert errors == pytest.approx(wanted["max"][1:4], rel=0.02)
    order = 2 if row in ("cv_fixed_gain", "av", "ca_fixed_gain") else 3
    if row != "aa1":  # its growing zigzag adds to its third order
        assert np.log2(errors[1] / errors[2]) == pytest.approx(order, abs=0.05)


def test_leading_errors():
    """Settled errors follow the leading terms: av h^2/2 Jdot qd; cv and ca from the sampled error equation (PP circle)."""
    h, w, radius = 0.0628, 1.0, 0.3
    case, gains = cases.CASES["PP"], cases.SETS["PP good"]
    cv = cases.settled(case, cases.run(case, gains, "cv"))["max"]
    assert cv == pytest.approx(5 / 12 * h**2 * radius * w**3 / np.hypot(gains.kappa, w), rel=0.01)
    ca = cases.settled(case, cases.run(case, gains, "ca"))["max"]
    lead = h**2 / gains.kp * radius * np.hypot(gains.kd / 12 * w**3, w**4 / 3)
    assert ca == pytest.approx(lead, rel=0.02)
    case = cases.CASES["RR"]
    h = 0.01
    made = cases.run(case, cases.SETS["RR good"], "av", h=h, steps=1300)
    for i in (700, 1000, 1250):
        bend = case.system.rate(made.q[i], made.rate[i + 1], made.rate[i + 1])
        assert made.error[i + 1] == pytest.approx(-0.5 * h * h * bend, rel=0.05)  # e = target - actual


def linearised(after, start, key):
    """Derivative, by differences, of a state (angles, rates, last command) by what of the state before a method looks at."""
    n = len(start) // 3
    parts = {"cv": (0, 2), "av": (0,), "ca": (0, 1, 2)}.get(key, (0, 1))
    columns = [i + n * part for part in parts for i in range(n)]
    moves = 1e-6 * np.eye(3 * n)[columns]
    return np.array([(after(start + d) - after(start - d))[columns] / 2e-6 for d in moves]).T


def test_mapping_matrices_are_the_linearised_steps():
    """Finite differences of the RR steps about a resting point have the eigenvalues of eqs (30)-(42)."""
    case, gains = cases.CASES["RR"], cases.SETS["RR good"]
    q0 = np.array([0.4, 1.3])
    target = case.system.position(q0)
    h, n = gains.h, 2

    def rest(t):
        return target, np.zeros(n), np.zeros(n)

    for key in ("cv", "av", "ca", "aa1", "aa2", "aa3", "aad"):
        name, options = cases.METHODS[key]
        options = options | {"cv": {"kappa": gains.kappa}, "ca": {"kp": gains.kp, "kd": gains.kd}}.get(key, {})

        def after_a_step(state, name=name, options=options):
            start = {"rate0": state[n : 2 * n], "command0": state[2 * n :]}
            made = simulate(case.system, rest, name, h, 1, state[:n], **start, **options)
            return np.concatenate([made.q[-1], made.rate[-1], made.command])

        A = linearised(after_a_step, np.concatenate([q0, np.zeros(2 * n)]), key)
        gain = {"cv": {"kappa": gains.kappa}, "ca": {"kp": gains.kp, "kd": gains.kd}, "aad": {"gamma": 0.6}}.get(
            key, {}
        )
        wanted = np.linalg.eigvals(st.mapping_matrix(name, h, dof=n, **gain))
        got = np.linalg.eigvals(A)
        for value in wanted:
            assert np.abs(got - value).min() < 1e-4  # double eigenvalues: square root of the rounding
        assert np.poly(got) == pytest.approx(np.poly(wanted), abs=1e-7)


def test_zigzag_at_rest_never_fades_for_aa_and_does_for_aad():
    case = cases.CASES["RR"]
    q0 = np.array([0.4, 1.3])
    target = case.system.position(q0)

    def rest(t):
        return target, np.zeros(2), np.zeros(2)

    for name, options, fades in (("aa", {"reading": 2}, False), ("aa", {"reading": 3}, False), ("aad", {}, True)):
        made = simulate(case.system, rest, name, 0.2, 400, q0, rate0=np.array([0.3, -0.2]), **options)
        last = np.linalg.norm(made.rate[-1])
        assert last < 1e-12 if fades else last > 0.1


def test_growth_in_motion():
    """Floquet multipliers: aa decays on the 1-DoF path and explodes on the RR circle; the bad RR set grows."""
    wanted = ORACLE["floquet"]
    period = 2 * np.pi / 0.28
    for key in ("aa1", "aa2", "aa3"):
        assert cases.growth(cases.CASES["1-DoF"], cases.SETS["1-DoF"], key, period) == pytest.approx(
            wanted[f"1dof|{key}"], rel=1e-3
        )
        got = cases.growth(cases.CASES["RR"], cases.SETS["RR good"], key, 4 * np.pi)
        assert got == pytest.approx(wanted[f"RR_stable|{key}"], rel=0.02)
    for key in ("cv", "ca"):
        got = cases.growth(cases.CASES["RR"], cases.SETS["RR bad"], key, 4 * np.pi)
        assert got == pytest.approx(wanted[f"RR_unstable|{key}"], rel=0.02)
    for key in ("cv", "ca"):  # too small for a disturbed run to show
        got = cases.growth(cases.CASES["RR"], cases.SETS["RR good"], key, 4 * np.pi)
        assert got == pytest.approx(wanted[f"RR_stable|{key}"], rel=1e-4)
        got = cases.growth(cases.CASES["1-DoF"], cases.SETS["1-DoF"], key, period)
        assert got == pytest.approx(wanted[f"1dof|{key}"], rel=1e-2)


@pytest.mark.parametrize(("name", "key", "gains"), [
    ("RR", "cv", "RR bad"), ("RR", "ca", "RR bad"), ("RR", "aa1", "RR good"), ("RR", "aa2", "RR good"), ("RR", "aa3", "RR good"),
    ("1-DoF", "aa1", "1-DoF"), ("1-DoF", "aa2", "1-DoF"), ("PP", "aa2", "PP good"),
])  # fmt: skip
def test_growth_is_that_of_disturbed_runs_where_these_show_it(name, key, gains):
    """Runs over a lap, disturbed in one state at a time (angles, and rates or the previous command if the method has them)."""
    case, lap = cases.CASES[name], {"RR": 4 * np.pi, "1-DoF": 2 * np.pi / 0.28, "PP": 2 * np.pi}[name]
    gains = cases.SETS[gains]
    steps = round(lap / gains.h)
    h = lap / steps
    q0 = case.start(case.path(0.0)[0])
    n = len(q0)
    rate0 = np.linalg.solve(case.system.jacobian(q0), case.path(0.0)[1])
    command0 = rate0 if key == "cv" else cases.run(case, gains, key, h=h, steps=1, rate0=rate0).command
    start = np.concatenate([q0, rate0, command0])

    def after_a_lap(state):
        task = case.system.position(state[:n]) - case.path(0.0)[0]
        made = cases.run(case, gains, key, task, h=h, steps=steps, rate0=state[n : 2 * n], command0=state[2 * n :])
        return np.concatenate([made.q[-1], made.rate[-1], made.command])

    M = linearised(after_a_lap, start, key)
    # The product of the other methods is taken on the motion without error, which their runs leave by their truncation error.
    exact = {"rel": 1e-5} if key in cases.ZIGZAGS else {"rel": 0.01}
    assert cases.growth(case, gains, key, lap) == pytest.approx(st.spectral_radius(M), **exact)


def test_report(tmp_path, monkeypatch):
    least, chart = paper.least_rate, paper.stability_chart
    # Fewer rates, a coarse chart and short runs: what no test looks at.
    monkeypatch.setattr(dynamics, "STEPS", 800)
    monkeypatch.setattr(paper, "least_rate", lambda *given, **asked: least(*given, **asked | {"most": 7.0}))
    monkeypatch.setattr(
        paper, "stability_chart", lambda *given, **asked: chart(*given, gain=[0.3, 0.9], samples=[9, 64], **asked)
    )
    made = paper.reproduce()
    pictures = {file: (draw, arguments) for file, draw, arguments in made._figures}
    assert len(pictures) == len(made._figures) == 6
    for draw, arguments in pictures.values():
        with drawing(PRINTED) as plt:
            assert all(axis.has_data() for axis in draw(plt, *arguments).axes)
    made._figures[:] = [("fig9_charts.png", *pictures["fig9_charts.png"])]  # the one with formulas
    files = {file.name for file in made.write(tmp_path)}
    assert files == {"report.md", "report.json", "fig9_charts.png"}
    assert (tmp_path / "fig9_charts.png").stat().st_size > 20_000
    text = (tmp_path / "report.md").read_text()
    assert "contradiction" in text and "misprint" in text
    data = json.loads((tmp_path / "report.json").read_text())
    (slope,) = (row[-1] for row in data["orders"]["rows"] if row[0] == "aa1")
    assert f"aa1 shows {slope:.1f}:" in text  # what the table has
    factors = {(row[0], row[1]): row[2] for row in data["growth"]["rows"]}
    assert 0.0 < factors["RR good", "ca"] < factors["RR good", "cv"] < 1e-14
    assert not re.search(
        r"e-1[5-9] \|", text.partition("## Errors reached")[2].partition("## ")[0]
    )  # no digits of rounding
    verdicts = {row[0]: (row[2], row[5], row[10], row[11]) for row in data["radii"]["rows"]}
    assert verdicts["RR bad"] == ("unstable", "marginal", "stable", "NO")
    assert verdicts["PP bad"] == ("unstable", "unstable", "unstable", "yes")
    assert all(verdicts[name][-1] == "yes" for name in ("1-DoF", "PP good", "RR good"))
    assert len(data["claims"]["rows"]) == 8
    rates = {(row[0][:2], row[1], row[2]): row[3:] for row in data["least_rates"]["rows"]}
    assert rates["RR", "RR bad", "cv"][1] == pytest.approx(5.083, abs=2e-3)
    assert rates["RR", "RR bad", "ca"][1] == pytest.approx(5.185, abs=2e-3)
    for (_, _, method), (rest, moving, _, below, below_runs, above, above_runs) in rates.items():
        assert moving > rest
        # Runs just beside the least rate grow and decay; complex multipliers of ca make their ratio fluctuate.
        if below:
            assert below > 1.0 > above and (below_runs == "diverge" or below_runs > 1.0) and above_runs < 1.0
            assert method == "ca" or [below_runs, above_runs] == pytest.approx([below, above], rel=0.03)
