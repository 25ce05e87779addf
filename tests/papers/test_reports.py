"""Parts of the paper reports that can be checked separately: times, plain methods, edges, inverse dynamics."""

import numpy as np
import pinocchio as pin
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.papers.burrell_2016 import design, gains, paper, solutions, speed, stability
from ik_toolkit.papers.burrell_2016.published import PAPER_OPTIONS, TO_PAPER
from ik_toolkit.papers.burrell_2016.uncompiled import Interpreted, PlainPinv
from ik_toolkit.papers.patko_2019 import dynamics
from ik_toolkit.papers.report import Report, cell, rounds, spread
from ik_toolkit.papers.shanmugasundar_2012 import formulas as printed_numbers
from ik_toolkit.papers.shanmugasundar_2012 import paper as inspection


@pytest.fixture(scope="module")
def hydrolek():
    return robots.load("hydrolek_7w")


def test_rounds_take_turns_and_the_spread_names_the_ends():
    seen = []
    works = {"a": (lambda: seen.append("a"), 10), "b": (lambda: seen.append("b"), 1)}
    times = rounds(works, 3)
    assert seen == ["a", "b"] * 4 and all(len(values) == 3 for values in times.values())
    seen.clear()
    rounds(works, 2, warm=True)
    assert seen == ["a", "b"] * 2
    assert spread(np.array([3.0, 1.0, 2.0]), ".2f") == "2.00 [1.00-3.00]"


def test_times_spread_over_runs_with_the_same_goals(hydrolek, monkeypatch):
    timed = []

    def once(works, count, warm):
        timed.append((count, {name: solves for name, (_, solves) in works.items()}))
        return {name: np.ones(count) for name in works}

    monkeypatch.setattr(speed, "rounds", once)
    sets = [paper.goals(hydrolek, seed, 20) for seed in (1, 2)]
    rules = {"J+": ("pinv", hydrolek.home), "DLS": ("dls", hydrolek.home)}
    times, steps = speed._compiled(hydrolek, rules, sets)
    assert {count for count, _ in timed} == {speed.AMOUNT.runs} and all(
        len(one) == speed.AMOUNT.runs for one in times["J+"]
    )
    assert all(len(set(solves.values())) == 1 and 30 < solves["J+"] <= 40 for _, solves in timed)
    assert 900 < steps["J+"][0]["solved"] <= 1000


def test_a_table_has_no_digits_of_rounding():
    assert cell(7.02e-14, 1e-11) == "under 1e-11" and cell(7.02e-14) == "7.02e-14" and cell(0.0, 1e-11) == "0"
    assert cell(99.985) == "99.985" and cell(float("nan"), 1.0) == "-"


def test_the_plain_pseudo_inverse_is_that_by_singular_values(hydrolek):
    """The same iterates, also from a stretched start, where it falls back on singular values."""
    goals = paper.goals(hydrolek, 3, 60)
    one, other = (
        ik.solve_batch(hydrolek, goals, rule, q0=hydrolek.home, **PAPER_OPTIONS) for rule in ("pinv", PlainPinv())
    )
    assert (one.status == other.status).all() and (one.iterations == other.iterations).all()
    assert np.abs(one.q - other.q)[one.success].max() < 1e-6
    arm = robots.load("inspection_7dof")
    straight = np.zeros(7)  # the arm points up: no joint moves the tip along itself
    target = arm.fk(straight).translation + np.array([0.05, 0.02, -0.1])
    first = [
        ik.solve(arm, target, rule, q0=straight, max_iterations=1, tolerance=1e-9, history=True).history["q"][-1]
        for rule in ("pinv", PlainPinv())
    ]
    assert np.abs(first[0] - first[1]).max() < 1e-9
    with pytest.raises(ik.errors.InvalidOption, match="positions in space"):
        ik.solve(arm, arm.fk(straight), PlainPinv(), q0=straight)


def test_the_interpreted_methods_are_the_compiled_ones(hydrolek):
    """What is timed in numpy is the method that is timed compiled: they agree on which goals are reached."""
    plain = Interpreted(hydrolek)
    goals = paper.goals(hydrolek, 8, 6)
    damping = 0.1 / hydrolek.chain.scale
    rules = {
        "J+": "pinv",
        "J+, plain": PlainPinv(),
        "DLS, clipped": ik.DLS(damping=damping, hold=False),
        "IK-PID": ik.PID.preset("burrell-2016"),
    }
    for name, rule in rules.items():
        ours = ik.solve_batch(hydrolek, goals, rule, q0=hydrolek.home, **PAPER_OPTIONS).success
        assert [plain.run(name, goal, hydrolek.home, 1e-3) for goal in goals] == ours.tolist(), name
    assert set(plain.names) >= set(rules)


def test_the_distance_to_the_workspace_is_a_minimum(hydrolek):
    """548 mm in mm and 584 mm in cm, whatever the seed; no random configuration is nearer."""
    goal = TO_PAPER.T @ np.array([-10.0, 50.0, -20.0])
    tips = hydrolek.chain.forward(hydrolek.random_q(np.random.default_rng(3), 20_000))[0][:, :3, 3]
    for scale, wanted in ((1e-3, 0.5479), (1e-2, 0.5840)):
        found = ik.solve(hydrolek, goal * scale, seed=3).position_error
        assert found == pytest.approx(wanted, abs=2e-4)
        assert np.linalg.norm(tips - goal * scale, axis=1).min() > found


def test_the_edge_of_a_workspace_is_measured():
    """Planar reach 2 m about the origin, made a sphere by a turn of the plane."""
    arm = robots.load("hydrolek_7w")
    points = paper.goals(arm, 100, 30)
    far = gains.edge_distance(arm, points)
    stretched = arm.fk(np.clip(np.zeros(6), arm.lower, arm.upper)).translation[None] * 0.999
    assert set(far) <= {*gains.EDGE, 2 * gains.EDGE[-1]}
    assert far.max() > gains.EDGE[0] and gains.edge_distance(arm, stretched)[0] <= 0.1


def test_gains_by_theory_and_by_search(hydrolek, monkeypatch):
    published = ik.StateSpace.preset("burrell-2016")
    q0 = hydrolek.home
    designed = design.theory(hydrolek, published, q0)
    here = ik.analyse(hydrolek, designed, q0)
    assert np.allclose(here.loop_gain, 0.5625, rtol=1e-6) and here.gain_bound == 1.5
    # |a| of the states that move no tip; the loop's own poles are both 0.25
    assert abs(here.spectral_radius[0] - 0.5) < 1e-6
    targets = paper.goals(hydrolek, 300, 30)
    solved = [
        ik.solve_batch(hydrolek, targets, rule, q0=q0, **PAPER_OPTIONS).success.mean() for rule in (designed, published)
    ]
    assert solved[0] > 0.9 > solved[1]
    assert 0.005 < design.margin_gain(hydrolek) < 0.02
    space = design.all_entries(published)
    assert space.size == 90
    start = space.build(space.start)
    assert all(np.allclose(getattr(start, key), getattr(published, key)) for key in "ABC")
    for name, value in (("GENERATIONS", 2), ("PARTICLES", 6), ("GOALS", 60)):
        monkeypatch.setattr(design, name, value)
    for rule in (design.search(hydrolek, space, q0, design.Swarm), design.search_theory(hydrolek, published, q0, 3)):
        assert np.shape(rule.A) == (6, 6) and np.shape(rule.B) == (6, 3)


# ------------------------------------------------------------------------------------------------------ Patko, eqs. 1-4
def test_inverse_dynamics_cancels_the_arm():
    """M and C of the equation of motion, from Pinocchio's own matrices: u = M v + C is what `rnea` gives."""
    model = dynamics.heavy_arm()
    data = model.createData()
    q, rate, v = np.array([0.4, -1.1]), np.array([0.7, 0.3]), np.array([2.0, -1.0])
    u = pin.crba(model, data, q) @ v + pin.nonLinearEffects(model, data, q, rate)
    assert np.abs(u - pin.rnea(model, data, q, rate, v)).max() < 1e-12
    assert np.linalg.norm(pin.computeGeneralizedGravity(model, data, q)) > 1.0  # gravity counts in this plane
    assert dynamics.cancellation(model) < 1e-11


def test_the_closed_loop_obeys_equation_4(monkeypatch):
    monkeypatch.setattr(dynamics, "STEPS", 800)
    model = dynamics.heavy_arm()
    wanted = dynamics.linear_error(40.0, 4.0)
    assert wanted[0] == pytest.approx(dynamics.SHIFT)
    rate, change = np.gradient(wanted[:, 0], 1e-3), np.gradient(np.gradient(wanted[:, 0], 1e-3), 1e-3)
    assert np.abs(change + 4.0 * rate + 40.0 * wanted[:, 0])[3:-3].max() < 1e-3 * np.abs(change).max()
    assert np.abs(dynamics.follow(model, model, 40.0, 4.0) - wanted).max() < 1e-9
    heavier = dynamics.heavy_arm(1.2 * dynamics.MASS)
    assert np.abs(dynamics.follow(heavier, model, 40.0, 4.0) - wanted).max() > 1e-3


# -------------------------------------------------------------------------------------------------------- Shanmugasundar
def test_table_2_and_the_lift_stand_in_the_report():
    report = Report("x", "x")
    robot = robots.load("inspection_7dof")
    inspection.model(report, robot)
    rows = report.data["table_2"]["rows"]
    assert len(rows) == 7 and rows[3] == [4, "0 / 0", "290 / 290", "0 / 0"] and rows[4][1] == "-90 / -90"
    assert all(cell.split(" / ")[0] == cell.split(" / ")[1] for row in rows for cell in row[1:] if "lift" not in cell)
    printed = printed_numbers.pose_matrix(printed_numbers.PRINTED_POSE)
    inspection.answers(report, printed, printed)
    angles = {row[0]: row for row in report.data["published_angles"]["rows"]}
    assert angles["theta_2"][1:3] == ["0", "0"] and "220" in angles["theta_2"][3]
    inspection.formulas(report, robot, 20, 0)
    assert report.data["formulas"]["rows"][-1][1] == "100 [83.9-100]"


def test_solutions_of_the_hydrolek_are_counted(hydrolek):
    report = Report("burrell", "numbers of solutions")
    solutions.solutions(report, hydrolek, range(100, 101))
    columns = np.array(report.data["solutions"]["rows"], float)
    assert np.allclose(columns[:, 1:].sum(axis=0), 100.0)  # each column is a distribution
    even = columns[:, 0] % 2 == 0
    assert (columns[~even][:, [1, 3]] == 0.0).all()  # solutions come and go in pairs
    assert columns[columns[:, 0] == 0][:, [1, 3, 4]].sum() == 0.0  # the poses are made from joint values
    assert min(report.data["solutions_certified"].values()) > 0.99


def test_limits_and_not_instability_explain_lost_goals(hydrolek):
    report, mid = Report("burrell", "stability"), paper.starts(hydrolek)["mid-range"]
    stability.stability(report, hydrolek, {"mid-range": mid}, [paper.goals(hydrolek, 100, 300)])
    (row,) = report.data["stability"]["rows"]
    assert 65.0 < row[1] < 85.0 and row[2] > 90.0 and row[3] < 5.0 and row[5] >= 99.0
    foretold, solved = np.array(report.data["gain_margin"]["rows"])[:, 1:].T
    assert np.abs(foretold - solved).max() < 15.0 and np.corrcoef(foretold, solved)[0, 1] > 0.98
