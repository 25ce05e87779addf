"""Explanations: their numbers are the solver's, their formulas give these numbers, and every branch reaches the target."""

import html.parser
import json
import math
import re

import numpy as np
import pytest
from folders import read_data
from robots import load, sample
from serial_arms import apart, urdf

import ik_toolkit as ik
from ik_toolkit.errors import InvalidTarget
from ik_toolkit.robot.dh import dh_fk
from ik_toolkit.solvers.dh_table import dh_of
from ik_toolkit.solvers.formula import FUNCTIONS, Latex, MathML, Quantity, Text, evaluate, write
from ik_toolkit.text import plain as plain_numbers

DATA = read_data("closed_form")
H = math.pi / 2


def odd_inspection_arm(rng):
    """An arm of the inspection robot's structure with its own base, tool, lengths, axis signs and angle offsets."""
    kinds = ["continuous", "prismatic"] + ["continuous"] * 5
    places = [rng.normal(size=3), (0, 0, 0.4), (0, 0, 0), (0, 0, 0), (0.4, 0, 0), (0, 0, 0), (0.3, 0, 0)]
    turns = [rng.normal(size=3), (0, 0, 0.4), (H, 0, 0), (H, 0, 0), (0, 0, 0), (-H, 0, 0), (0, 0, 0)]
    signs = rng.choice([-1, 1], size=7)
    joints = [
        (kind, place, turn, (0, 0, sign), -1.0, 1.0)
        for kind, place, turn, sign in zip(kinds, places, turns, signs, strict=True)
    ]
    return ik.Robot.load(urdf(joints, (rng.normal(size=3), rng.normal(size=3))), tip="tip")


def odd_planar_arm(rng):
    """Two parallel axes anywhere, with angle and height offsets, the second the other way round."""
    joints = [
        ("continuous", rng.normal(size=3), rng.normal(size=3), (0, 0, 1), -1.0, 1.0),
        ("continuous", (0.5, 0.4, 0.2), (0, 0, 0.3), (0, 0, -1), -1.0, 1.0),
    ]
    return ik.Robot.load(urdf(joints, ((0.3, -0.2, 0.1), (0, 0, 0))), tip="tip")


def arms():
    rng = np.random.default_rng(7)
    made = [ik.Robot.load("inspection_7dof"), load("locked"), odd_inspection_arm(rng), odd_inspection_arm(rng)]
    return [*((arm, True) for arm in made), (ik.Robot.load("planar_2r"), False), (odd_planar_arm(rng), False)]


def check_steps(derivation):
    """Formulas of every branch, each with the values before it, give the solver's own values."""
    for branch in derivation.branches:
        values = {}
        for step in (*derivation.given, *derivation.shared, *branch.steps):
            if step.formula:
                assert evaluate(step.formula, values) == pytest.approx(step.value, abs=1e-9), (step, branch.label)
            values[step.name] = step.value


@pytest.mark.parametrize(("arm", "posed"), arms(), ids=lambda x: getattr(x, "name", ""))
def test_formulas_give_the_solvers_numbers_and_branches_reach_the_target(arm, posed):
    for q, T in zip(*sample(arm, 6, seed=3), strict=True):
        target = T if posed else T[:3, 3].copy()
        made = ik.solve(arm, target, q0=q).explain()
        assert len(made.derivation.branches) == (8 if posed else 2)
        check_steps(made.derivation)
        for branch, (position, angle) in zip(made.derivation.branches, made.errors, strict=True):
            T_by_pinocchio = arm.fk(branch.q).homogeneous
            assert np.abs(T_by_pinocchio[:3, 3] - T[:3, 3]).max() < 1e-9 and position < 1e-9
            assert not posed or (np.abs(T_by_pinocchio - T).max() < 1e-9 and angle < 1e-9)
            assert branch.outside == tuple(arm.outside(branch.q))
        assert np.array_equal(made.derivation.branches[made.chosen].q.round(9), made.q.round(9))
        assert apart([q], [branch.q for branch in made.derivation.branches]).min() < 1e-6


@pytest.mark.parametrize("case", DATA["configurations"][:6])
def test_branches_and_lifts_are_those_of_the_reference(case):
    arm = ik.Robot.load("inspection_7dof")
    T = np.array(case["T"])
    made = ik.solve(arm, T, ik.Inspection(lift=case["q"][1]), limits=False).explain().derivation
    expected = np.array(case["solutions_at_lift"])
    d = apart([branch.q for branch in made.branches], expected)
    assert d.min(axis=0).max() < 1e-9 and d.min(axis=1).max() < 1e-9
    assert np.allclose(made.free.every, case["lift_intervals"], atol=1e-9)


@pytest.mark.parametrize("case", DATA["singular"], ids=lambda c: c["name"])
def test_singular_poses_are_explained_too(case):
    arm = ik.Robot.load("inspection_7dof")
    q = np.array(case["q"], dtype=float)
    made = ik.solve(arm, np.array(case["T"]), ik.Inspection(lift=q[1]), q0=q, limits=False).explain()
    assert len(made.derivation.branches) == case["solutions_at_lift"] and made.chosen is not None
    assert max(position for position, _ in made.errors) < 1e-9
    assert "0" in made.derivation.branches[0].label or "free" in str(made) or case["solutions_at_lift"] == 8


@pytest.mark.parametrize("case", DATA["unreachable"], ids=lambda c: c["name"])
def test_an_unreachable_pose_is_said(case):
    arm = ik.Robot.load("inspection_7dof")
    made = ik.solve(arm, np.array(case["T"]), ik.Inspection(lift=0.22), limits=False).explain()
    assert f"{-1000 * case['reach_margin_at_0_220']:.4g} mm out of reach at lift 220 mm" in made.derivation.words
    assert made.derivation.words[1:] in re.sub(r"\s+", " ", str(made))


@pytest.mark.parametrize("case", [c for c in DATA["planar_2r"] if c["status"] == "ok"][:4])
def test_both_elbows_are_those_of_the_reference(case):
    joints = [("continuous", (x, 0, 0), (0, 0, 0), (0, 0, 1), -1.0, 1.0) for x in (0, case["l1"])]
    limb = urdf(joints, ((case["l2"], 0, 0), (0, 0, 0)))
    made = ik.solve(ik.Robot.load(limb, tip="tip"), (case["x"], case["y"], 0.0)).explain()
    found, expected = [branch.q for branch in made.derivation.branches], np.array(case["solutions"])
    assert len(found) == len(expected) and apart(found, expected).min(axis=1).max() < 1e-9
    labels = {"elbow right (+)": 1, "elbow left (-)": -1}
    assert all(labels.get(b.label, 0) * math.sin(b.q[1]) >= 0 for b in made.derivation.branches)
    i = made.iterations
    assert i.solver == "newton" and (not i.success or i.position[-1] < 1e-6)


def blocks(text):
    """(name, formula with numbers, value) of every step in a text; the value alone where the formula is one number."""
    lines = text.split("\n")
    for k, line in enumerate(lines):
        head = re.match(r"  (\w+) = ", line)
        if not head:
            continue
        indent = " " * (len(head[1]) + 2) + " = "
        parts = [line]
        for more in lines[k + 1 :]:
            if not more.startswith("   "):
                break
            if more.startswith(indent):
                parts.append(more)
            else:
                parts[-1] += " " + more.strip()
        if len(parts) > 1:
            yield head[1], *(part.split("= ", 1)[1] for part in (parts[-2] if len(parts) > 2 else parts[-1], parts[-1]))


@pytest.mark.parametrize("name", ["inspection_7dof", "planar_2r"])
def test_the_numbers_of_the_text_can_be_followed_by_hand(name):
    """Each formula with the printed numbers gives the printed number, and the printed angles bring the tip to the target."""
    arm = ik.Robot.load(name)
    q, T = (x[0] for x in sample(arm, 1, seed=5))
    result = ik.solve(arm, T if arm.n > 2 else T[:3, 3].copy(), q0=q)
    text = str(result.explain())
    assert max(map(len, text.split("\n"))) <= 80 and text.isascii()
    number = r"(-?[\d.]+)"
    found = {}
    for symbol, formula, value in blocks(text):
        said, unit = re.match(number + r"( deg| mm)?", value).groups()
        plain = (
            re.sub(number + " deg", lambda m: repr(math.radians(float(m[1]))), formula.split("  (")[0])
            .replace(" mm", "")
            .replace("^", "**")
        )
        result_of = eval(plain, {"__builtins__": {}}, FUNCTIONS)
        scale, tolerance = {" deg": (math.degrees(1.0), 2e-3), " mm": (1.0, 2e-3)}.get(unit, (1.0, 2e-6))
        if symbol not in ("u", "v", "beta"):  # square roots of small differences of rounded numbers
            assert scale * result_of == pytest.approx(float(said), abs=tolerance * max(1.0, 5e-3 * abs(float(said))))
        found[symbol] = math.radians(float(said)) if unit == " deg" else float(said)
    read = np.array([found.get(f"theta_{k + 1}", result.q[1]) for k in range(arm.n)])
    assert np.abs(read - result.q).max() < 2e-6
    assert np.linalg.norm(arm.fk(read).translation - T[:3, 3]) < 1e-5


def test_the_papers_sample():
    """The published pose cannot be had at the published lift; from 220.455 mm on it can."""
    arm = ik.Robot.load("inspection_7dof")
    case = DATA["sample"]
    made = ik.solve(arm, np.array(case["target"])).explain()
    assert np.allclose(made.derivation.free.every, case["lift_intervals"], atol=1e-6)
    assert "from 220.455 to 440.000 mm within its limits, and from 220.455 to 546.057 mm without" in re.sub(
        r"\s+", " ", str(made)
    )
    assert made.chosen is not None and max(p for p, _ in made.errors) < 1e-6


def test_without_a_closed_form_the_iterations_are_shown():
    arm = load("hydrolek_7w")
    q, T = (x[0] for x in sample(arm, 1, seed=2))
    result = ik.solve(arm, T)
    made = result.explain()
    assert made.derivation is None and "No closed form of the toolkit fits 'hydrolek_7w'" in str(made)
    i = made.iterations
    assert i.solver == result.solver == "lm" and np.array_equal(i.q[-1], result.q)
    assert i.position[-1] == pytest.approx(result.position_error, abs=1e-12)
    assert ik.solve(arm, T, mask=(1, 1, 1, 0, 0, 0)).explain().why.startswith("Only part of a pose")
    failed = ik.solve(arm, (9.0, 0.0, 0.0))
    assert not failed.success and "beyond reach" in str(failed.explain())


def test_a_solve_by_iteration_is_shown_beside_the_closed_form_that_fits():
    made = ik.solve(ik.Robot.load("planar_2r"), (0.9, 0.5, 0.0), "newton", q0=(0.1, 0.5)).explain()
    assert made.form == "planar-2r" and made.chosen is not None and made.iterations.solver == "newton"
    assert np.allclose(made.iterations.q[0], (0.1, 0.5))


def test_newton_starts_elsewhere_where_the_start_is_the_answer():
    robot = ik.Robot.load("planar_2r")
    made = ik.solve(robot, robot.fk(robot.home).translation, q0=robot.home).explain()
    assert len(made.iterations.position) > 1 and made.iterations.solver == "newton"


def test_links_folded_onto_the_base_leave_an_angle_free():
    made = ik.solve(ik.Robot.load("planar_2r"), (0.0, 0.0, 0.0), limits=False).explain()
    (branch,) = made.derivation.branches
    theta = {step.name: step for step in branch.steps}
    check_steps(made.derivation)
    assert theta["theta_1"].formula == "" and "free" in theta["theta_1"].words


def test_several_tips_and_batches():
    pair = load("two_arms")
    q = pair.random_q(np.random.default_rng(1))
    made = ik.solve(pair, pair.fk(q)).explain()
    assert set(made.tables) == {"left_tip", "right_tip"} and "several tips are solved together" in str(made)
    arm = load("hydrolek_7w")
    with pytest.raises(InvalidTarget, match="keeps no target"):
        ik.solve_batch(arm, sample(arm, 2)[1])[0].explain()


@pytest.mark.parametrize(
    "name", ["inspection_7dof", "hydrolek_7w", "planar_3r", "cartesian_pp", "slides_mix", "continuous_mix"]
)
def test_the_table_multiplies_to_pinocchios_kinematics(name):
    arm = load(name)
    table = dh_of(arm)
    for q, T in zip(*sample(arm, 20, seed=4), strict=True):
        assert np.abs(dh_fk(table, q) - T).max() < 1e-6
    assert dh_of(load("mimic_mix")) is None


def test_a_robot_of_another_name_has_the_same_rows():
    """The table of the file is that of the axes: written without the name of a robot of ours, they are read off."""
    arm = ik.Robot.load("inspection_7dof")
    other = ik.Robot.load(arm.urdf.replace('name="inspection_7dof"', 'name="elsewhere"'), tip="tool")
    for a, b in zip(dh_of(arm).rows, dh_of(other).rows, strict=True):
        assert (a.name, a.type) == (b.name, b.type)
        assert np.allclose((a.theta, a.a, a.alpha), (b.theta, b.a, b.alpha), atol=1e-9)


class Tags(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.text = [], ""

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_one_formula_in_three_forms():
    formula = "-((a4 - x)*2/hypot(x, y)) + atan2(sin(theta_5), 1 - pi)"
    numbers = {name: Quantity(name, value, unit) for name, value, unit in (("a4", 0.29, "m"), ("x", -0.1, "m"))}
    numbers |= {"y": Quantity("y", 0.2, "m"), "theta_5": Quantity("theta_5", math.radians(-30), "rad")}
    assert write(formula, Text()) == "-(a4 - x)*2/hypot(x, y) + atan2(sin(theta_5), 1 - pi)"
    put_in = write(formula, Text(), numbers, 1)
    assert put_in == "-(290.0 - (-100.0))*2/hypot(-100.0, 200.0) + atan2(sin(-30.0000 deg), 1 - 180 deg)"
    latex = write(formula, Latex(), numbers, 1)
    assert (
        r"\frac" in latex
        and r"\sqrt{\left(-100.0\right)^{2} + 200.0^{2}}" in latex
        and latex.count("{") == latex.count("}")
    )
    assert r"\theta_{5}" in write(formula, Latex())
    page = Tags()
    page.feed(write(formula, MathML(), numbers, 1))
    assert page.open == [] and "100.0" in page.text
    page.feed(MathML().name("<b>_x</b>"))
    assert page.open == []


def test_markdown_and_plain_numbers():
    made = ik.solve(ik.Robot.load("inspection_7dof"), np.array(DATA["configurations"][0]["T"])).explain()
    text = made._repr_markdown_()
    assert text == made.to_markdown() and r"$$\theta_{5} = \operatorname{atan2}" in text and r"column\_yaw" in text
    assert text.count("$$") % 2 == 0
    plain = json.loads(json.dumps(plain_numbers(made.to_dict()), allow_nan=False))
    assert plain["branches"][plain["chosen"]]["q"] == pytest.approx(made.q.tolist(), abs=1e-9)
    assert {step["unit"] for step in plain["steps"]} == {"m", "rad"}
