"""Explanations: their numbers are the solver's, their formulas give these numbers, and every branch reaches the target."""

import functools
import html
import json
import math
import re
import sys

import numpy as np
import pytest
from folders import read_data
from robots import load, sample
from serial_arms import apart, drawn

import ik_toolkit as ik
from ik_toolkit.errors import InvalidTarget, MissingExtra
from ik_toolkit.robot.formats.dh import dh_fk
from ik_toolkit.text import length

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
    return drawn(joints, rng.normal(size=3), rng.normal(size=3))


def odd_planar_arm(rng):
    """Two parallel axes anywhere, with angle and height offsets, the second the other way round."""
    joints = [
        ("continuous", rng.normal(size=3), rng.normal(size=3), (0, 0, 1), -1.0, 1.0),
        ("continuous", (0.5, 0.4, 0.2), (0, 0, 0.3), (0, 0, -1), -1.0, 1.0),
    ]
    return drawn(joints, (0.3, -0.2, 0.1))


def arms():
    rng = np.random.default_rng(7)
    made = [ik.Robot.load("inspection_7dof"), load("locked"), odd_inspection_arm(rng), odd_inspection_arm(rng)]
    return [*((arm, True) for arm in made), (ik.Robot.load("planar_2r"), False), (odd_planar_arm(rng), False)]


# What the formulas are made of, in plain floats. As in the solvers, a root of less than zero, by rounding, is zero.
FUNCTIONS = {
    "sqrt": lambda x: math.sqrt(0.0 if -1e-9 < x < 0.0 else x),
    **{"sin": math.sin, "cos": math.cos, "atan2": math.atan2, "pi": math.pi, "Abs": abs, "Min": min, "Max": max},
}


@functools.cache
def compiled(formula):
    """A SymPy formula as Python code."""
    return compile(str(formula), str(formula), "eval")


def check_steps(worked, tolerance=1e-9):
    """Formulas of every branch, each with the values before it, give the solver's own values."""
    assert any(step.formula is not None for step in worked.steps) and all(b.steps for b in worked.branches)
    for branch in worked.branches:
        values = {}
        for step in worked.steps_of(branch):
            if step.formula is not None:
                number = eval(compiled(step.formula), {"__builtins__": {}}, FUNCTIONS | values)
                assert number == pytest.approx(step.value, abs=tolerance), (step, branch.label)
            values[step.name] = step.value


@pytest.mark.parametrize(("arm", "posed"), arms(), ids=lambda x: getattr(x, "name", ""))
def test_formulas_give_the_solvers_numbers_and_branches_reach_the_target(arm, posed):
    for q, T in zip(*sample(arm, 6, seed=3), strict=True):
        target = T if posed else T[:3, 3].copy()
        made = ik.solve(arm, target, q0=q).explain()
        assert len(made.worked.branches) == (8 if posed else 2)
        check_steps(made.worked)
        for branch, (position, angle) in zip(made.worked.branches, made.errors, strict=True):
            T_by_pinocchio = arm.fk(branch.q).homogeneous
            assert np.abs(T_by_pinocchio[:3, 3] - T[:3, 3]).max() < 1e-9 and position < 1e-9
            assert not posed or (np.abs(T_by_pinocchio - T).max() < 1e-9 and angle < 1e-9)
            assert branch.outside == tuple(arm.outside(branch.q))
        assert np.array_equal(made.worked.branches[made.chosen].q.round(9), made.q.round(9))
        assert apart([q], [branch.q for branch in made.worked.branches]).min() < 1e-6


@pytest.mark.parametrize("case", DATA["configurations"][:6])
def test_branches_and_lifts_are_those_of_the_reference(case):
    arm = ik.Robot.load("inspection_7dof")
    T = np.array(case["T"])
    made = ik.solve(arm, T, ik.Inspection(lift=case["q"][1]), limits=False).explain().worked
    expected = np.array(case["solutions_at_lift"])
    d = apart([branch.q for branch in made.branches], expected)
    assert d.min(axis=0).max() < 1e-9 and d.min(axis=1).max() < 1e-9
    assert np.allclose(made.free.every, case["lift_intervals"], atol=1e-9)


@pytest.mark.parametrize("case", DATA["singular"], ids=lambda c: c["name"])
def test_singular_poses_are_explained_too(case):
    arm = ik.Robot.load("inspection_7dof")
    q = np.array(case["q"], dtype=float)
    made = ik.solve(arm, np.array(case["T"]), ik.Inspection(lift=q[1]), q0=q, limits=False).explain()
    assert len(made.worked.branches) == case["solutions_at_lift"] and made.chosen is not None
    assert max(position for position, _ in made.errors) < 1e-9
    check_steps(made.worked, 2e-7)  # roots of rounding
    assert "0" in made.worked.branches[0].label or "free" in str(made) or case["solutions_at_lift"] == 8


@pytest.mark.parametrize("case", DATA["unreachable"], ids=lambda c: c["name"])
def test_an_unreachable_pose_is_said(case):
    arm = ik.Robot.load("inspection_7dof")
    made = ik.solve(arm, np.array(case["T"]), ik.Inspection(lift=0.22), limits=False).explain()
    assert f"{length(-case['reach_margin_at_0_220'], 4)} out of reach at lift 220 mm" in made.worked.words
    assert made.worked.words[1:] in re.sub(r"\s+", " ", str(made))
    check_steps(made.worked, 2e-7)  # the elbow is straight: roots of rounding
    (nearest,) = {tuple(arm.fk(branch.q).homogeneous.round(9).ravel()) for branch in made.worked.branches}
    assert np.allclose(np.reshape(nearest, (4, 4))[:3, :3], np.array(case["T"])[:3, :3], atol=1e-8)


@pytest.mark.parametrize(
    "target", [(3.0, 0.0, 0.0), (2.0, 0.0, 0.0), (-1.0, 2.5, 0.3), (0.2, 0.1, 0.0), (-3e-9, 1e-9, 0.0)]
)
@pytest.mark.parametrize("l2", [1.0, 0.6])
def test_formulas_hold_for_points_out_of_reach_and_at_its_edges(target, l2):
    joints = [("continuous", (x, 0, 0), (0, 0, 0), (0, 0, 1), -1.0, 1.0) for x in (0.0, 1.0)]
    worked = ik.solve(drawn(joints, (l2, 0, 0)), target).explain().worked
    check_steps(worked, 2e-7)
    assert ("out of reach" in worked.words) != (abs(1.0 - l2) <= math.hypot(*target[:2]) <= 1.0 + l2)


@pytest.mark.parametrize("case", [c for c in DATA["planar_2r"] if c["status"] == "ok"][:4])
def test_both_elbows_are_those_of_the_reference(case):
    joints = [("continuous", (x, 0, 0), (0, 0, 0), (0, 0, 1), -1.0, 1.0) for x in (0, case["l1"])]
    made = ik.solve(drawn(joints, (case["l2"], 0, 0)), (case["x"], case["y"], 0.0)).explain()
    found, expected = [branch.q for branch in made.worked.branches], np.array(case["solutions"])
    assert len(found) == len(expected) and apart(found, expected).min(axis=1).max() < 1e-9
    labels = {"elbow right (+)": 1, "elbow left (-)": -1}
    assert all(labels.get(b.label, 0) * math.sin(b.q[1]) >= 0 for b in made.worked.branches)
    i = made.iterations
    assert i.solver == "newton" and (not i.success or i.position[-1] < 1e-6)


def equations(text):
    """(symbol, sides) of every formula in a text of 80 columns: in symbols, in numbers (where it is not one number), its value."""
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
            yield head[1], [re.sub(r"  \(.*", "", part.split("= ", 1)[1]) for part in parts]


def given(text):
    """Values [mm, rad or 1] of the numbers that a text gives before the formulas, and half of their last digits."""
    found = re.findall(r"[ (](\w+) = (-?[\d.]+)( mm| deg)?(?:,|$|  \()", text, re.MULTILINE)
    scales = {" deg": math.radians(1.0)}
    values = {name: float(x) * scales.get(unit, 1.0) for name, x, unit in found}
    return values, {name: half_digit(x) * scales.get(unit, 1.0) for name, x, unit in found}


NUMBER = r"-?\d+\.?\d*"


def followed(formula, values, rounding):
    """Value of a formula with these values, and how far it may be off as they are rounded."""
    code = compiled(formula)

    def at(moved):
        return eval(code, {"__builtins__": {}}, FUNCTIONS | values | moved)

    used = [(name, values[name], half) for name, half in rounding.items() if name in code.co_names]
    off = sum(max(abs(at({name: x + side}) - at({})) for side in (-half, half)) for name, x, half in used)
    return at({}), off


def half_digit(text):
    """Half of the last digit of a number."""
    return 0.5 * 10.0 ** -len(text.partition(".")[2])


@pytest.mark.parametrize("name", ["inspection_7dof", "planar_2r", "odd_inspection_arm", "odd_planar_arm"])
@pytest.mark.parametrize("seed", [5, 6])
def test_the_numbers_of_the_text_can_be_followed_by_hand(name, seed):
    """Each printed formula, with the numbers printed before it, gives the printed number, both in symbols and in numbers."""
    rng = np.random.default_rng(seed)
    arm = globals()[name](rng) if name in globals() else ik.Robot.load(name)
    q, T = (x[0] for x in sample(arm, 1, seed=seed))
    result = ik.solve(arm, T if arm.n > 2 else T[:3, 3].copy(), q0=q)
    text = str(result.explain())
    assert max(map(len, text.split("\n"))) <= 80 and text.isascii()
    values, rounding = given(text)
    count = 0
    for symbol, sides in equations(text):
        said, unit = re.match(rf"({NUMBER})( deg| mm)?$", sides[-1]).groups()
        scale = math.degrees(1.0) if unit == " deg" else 1.0
        for side in sides[:-1]:
            numbers = {f"_{k}": x for k, x in enumerate(re.findall(r"(?<![\w.])(\d+\.\d+( deg)?)", side))}
            plain = side
            for k, (x, _) in numbers.items():
                plain = plain.replace(x, k, 1)
            put_in = {k: math.radians(float(x[:-4])) if deg else float(x) for k, (x, deg) in numbers.items()}
            halves = {
                k: half_digit(x.partition(" ")[0]) / (math.degrees(1.0) if deg else 1.0)
                for k, (x, deg) in numbers.items()
            }
            plain = plain.replace("180 deg", "pi")
            number, off = followed(plain, values | put_in, rounding | halves)
            wrong = abs(scale * number - float(said))
            if unit == " deg":
                wrong = min(wrong, abs(wrong - 360.0))
            assert wrong < 1.01 * (scale * off + half_digit(said)) + 1e-9, (symbol, side, number)
            count += 1
        values[symbol], rounding[symbol] = float(said) / scale, half_digit(said) / scale
    assert count > 10
    # The printed angles, as joint values, bring the tip to the target.
    read = result.q.copy()
    for i in range(arm.n):
        if f"theta_{i + 1}" in values or f"q_{i + 1}" in values:
            read[i] = values.get(f"q_{i + 1}", values.get(f"theta_{i + 1}"))
    assert np.abs(read - result.q).max() < 3e-6
    assert np.linalg.norm(arm.fk(read).translation - T[:3, 3]) < 1e-5


@pytest.mark.parametrize("name", ["inspection_7dof", "planar_2r"])
def test_text_latex_and_html_show_the_same_numbers(name):
    arm = ik.Robot.load(name)
    q, T = (x[0] for x in sample(arm, 1, seed=8))
    made = ik.solve(arm, T if arm.n > 2 else T[:3, 3].copy(), q0=q).explain()
    text, latex, page = str(made), made.to_markdown(), html.unescape(made.to_html())
    assert "; the answer" in text and "not exactly one of these branches" not in text
    assert all(branch.label in text for branch in made.worked.branches)

    def numbers(text):
        return re.findall(r"\d+\.\d{3,}", text)

    shown = [sorted(numbers(each)) for each in (text, latex, re.sub("<[^>]*>", " ", page))]
    assert shown[0] == shown[1] == shown[2] and len(shown[0]) > 60
    written = "".join(re.findall(r"\$\$(.*?)\$\$", latex)), "".join(re.findall('data-step.*?">(.*?)</div></div>', page))
    signs = sum(side.count("-") for _, sides in equations(text) for side in sides)
    assert signs == written[0].count("-") == written[1].count("\N{MINUS SIGN}") > 10


def test_formulas_are_for_sympy():
    """The law of cosines of the two-link arm: its derivative by the distance of the target, and the value at another target."""
    worked = ik.solve(ik.Robot.load("planar_2r"), (0.9, 0.9, 0.0)).explain().worked
    steps = {step.name: step for step in worked.steps_of(worked.branches[0])}
    cosine, r, l1, l2 = steps["c2"].formula, *(steps[name].symbol for name in ("r", "l1", "l2"))
    assert (cosine.diff(r) - r / (l1 * l2)).simplify() == 0
    assert float(cosine.subs({r: 1.0, l1: 1.0, l2: 1.0})) == -0.5  # an equilateral triangle: 120 degrees
    assert not {"q_1", "q_2"} & {*steps}  # The joint values are theta_1 and theta_2 themselves.


def test_without_sympy_only_formulas_are_missing(monkeypatch):
    arm, planar = load("hydrolek_7w"), ik.Robot.load("planar_2r")
    T = sample(arm, 1, seed=2)[1][0]
    for module in [name for name in sys.modules if name.partition(".")[0] == "sympy" or name.endswith("_steps")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.delitem(sys.modules, "ik_toolkit.solvers.explain.worksheet", raising=False)
    monkeypatch.setitem(sys.modules, "sympy", None)
    with pytest.raises(MissingExtra, match="sympy is not installed; run: pip install sympy"):
        ik.solve(planar, (0.9, 0.9, 0.0)).explain()
    made = ik.solve(arm, T).explain()
    assert "Iterations of" in str(made) and "joint" in made.to_html() and made.to_markdown()


def test_the_papers_sample():
    """The published pose cannot be had at the published lift; from 220.455 mm on it can."""
    arm = ik.Robot.load("inspection_7dof")
    case = DATA["sample"]
    made = ik.solve(arm, np.array(case["target"])).explain()
    assert np.allclose(made.worked.free.every, case["lift_intervals"], atol=1e-6)
    assert "from 220.455 to 440.000 mm within its limits, and from 220.455 to 546.057 mm without" in re.sub(
        r"\s+", " ", str(made)
    )
    assert made.chosen is not None and max(p for p, _ in made.errors) < 1e-6


def test_without_a_closed_form_the_iterations_are_shown():
    arm = load("hydrolek_7w")
    q, T = (x[0] for x in sample(arm, 1, seed=2))
    result = ik.solve(arm, T)
    made = result.explain()
    assert made.worked is None and "No closed form of the toolkit fits 'hydrolek_7w'" in str(made)
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
    near = ik.solve(ik.Robot.load("planar_2r"), (0.9, 0.9, 0.0), "lm", q0=(0.1, 1.5), tolerance=1e-2, restarts=0)
    assert "the nearest is branch 1, where joint_1 differs by 0.0105 deg" in " ".join(str(near.explain()).split())
    other = str(ik.solve(ik.Robot.load("planar_2r"), (0.9, 0.9, 0.0), "lm", q0=(1.5, -1.5), tolerance=1e-2).explain())
    assert "Branch 2, elbow left (-):" in other  # The formulas are those of the branch that the answer is near.


@pytest.mark.parametrize(
    "options", [{"closest": True}, {"priority": "position"}, {"follow": 0.5, "q0": (0.0, 1.7)}], ids=str
)
def test_options_that_a_closed_form_does_not_take_are_explained_beside_it(options):
    made = ik.solve(ik.Robot.load("planar_2r"), (0.9, 0.9, 0.0), **options).explain()
    assert made.form == "planar-2r" and made.iterations.solver != "planar-2r"


def test_without_limits_the_branches_are_still_compared_with_them():
    planar, lifted = ik.Robot.load("planar_2r"), ik.Robot.load("inspection_7dof")
    flat = ik.solve(planar, (-0.3, 0.05, 0.0), limits=False).explain()
    high = ik.solve(lifted, lifted.fk([2.0, 0.8, 2.5, 1.0, 2.0, 0.5, 0.1]), limits=False).explain()
    assert all(b.outside == tuple(made.robot.outside(b.q)) != () for made in (flat, high) for b in made.worked.branches)
    assert not high.worked.free.inside and "from nowhere within its limits" in " ".join(str(high).split())


def test_newton_starts_elsewhere_where_the_start_is_the_answer():
    robot = ik.Robot.load("planar_2r")
    made = ik.solve(robot, robot.fk(robot.home).translation, q0=robot.home).explain()
    assert len(made.iterations.position) > 1 and made.iterations.solver == "newton"


def test_links_folded_onto_the_base_leave_an_angle_free():
    made = ik.solve(ik.Robot.load("planar_2r"), (0.0, 0.0, 0.0), limits=False).explain()
    (branch,) = made.worked.branches
    theta = {step.name: step for step in branch.steps}
    check_steps(made.worked)
    assert theta["theta_1"].formula is None and "free" in theta["theta_1"].words


def test_several_tips_and_batches():
    pair = load("two_arms")
    q = pair.random_q(np.random.default_rng(1))
    made = ik.solve(pair, pair.fk(q)).explain()
    assert set(made.tables) == {"left_tip", "right_tip"} and "several tips are solved together" in str(made)
    arm = load("hydrolek_7w")
    with pytest.raises(InvalidTarget, match="keeps no target"):
        ik.solve_batch(arm, sample(arm, 2)[1])[0].explain()


def tables(arm):
    """The D-H tables of an explanation of a robot."""
    return list(ik.solve(arm, arm.fk(arm.home)).explain().tables.values())


@pytest.mark.parametrize(
    "name", ["inspection_7dof", "hydrolek_7w", "planar_3r", "cartesian_pp", "slides_mix", "continuous_mix"]
)
def test_the_table_multiplies_to_pinocchios_kinematics(name):
    arm = load(name)
    (table,) = tables(arm)
    for q, T in zip(*sample(arm, 20, seed=4), strict=True):
        assert np.abs(dh_fk(table, q) - T).max() < 1e-6
    assert tables(load("mimic_mix")) == [None]


def test_a_robot_of_another_name_has_the_same_rows():
    """The table of the file is that of the axes: written without the name of a robot of ours, they are read off."""
    arm = ik.Robot.load("inspection_7dof")
    other = ik.Robot.load(arm.urdf.replace('name="inspection_7dof"', 'name="elsewhere"'), tip="tool")
    for a, b in zip(tables(arm)[0].rows, tables(other)[0].rows, strict=True):
        assert (a.name, a.type) == (b.name, b.type)
        assert np.allclose((a.theta, a.a, a.alpha), (b.theta, b.a, b.alpha), atol=1e-9)


def test_markdown_and_plain_numbers():
    made = ik.solve(ik.Robot.load("inspection_7dof"), np.array(DATA["configurations"][0]["T"])).explain()
    text = made._repr_markdown_()
    assert text == made.to_markdown() and r"\operatorname{atan2}" in text and r"column\_yaw" in text
    assert text.count("$$") % 2 == 0
    plain = json.loads(json.dumps(made.to_dict(), allow_nan=False))
    assert plain["branches"][plain["chosen"]]["q"] == pytest.approx(made.q.tolist(), abs=1e-9)
    assert {step["unit"] for step in plain["steps"]} == {"m", "rad"}
    searched = ik.solve(ik.Robot.load("planar_2r"), (1.0, 1.0, 0.0), "lm").explain()  # it has iterations, as arrays
    assert len(json.loads(json.dumps(searched.to_dict(), allow_nan=False))["iterations"]["q"]) > 1
    values = {step["name"]: step["value"] for step in plain["given"]}
    for step in plain["steps"] + plain["branches"][plain["chosen"]]["steps"]:
        number = eval(compiled(step["formula"]), {"__builtins__": {}}, FUNCTIONS | values)
        assert number == pytest.approx(step["value"], abs=1e-9)
        values[step["name"]] = step["value"]
