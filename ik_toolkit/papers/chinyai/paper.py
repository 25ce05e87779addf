"""Report on Chinyai, "Numerical optimization - inverse kinematics in robotic manipulators".

The paper claims that Newton-Raphson is faster than the closed form on a planar two-link arm but prints no number, as its section
"Application" is empty. So the claim is tested here. Lengths are in metres, angles in radians unless a name says otherwise.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from ...robot.robot import Robot
from ...solvers.solve import Solver
from ...study.newton_certificate import newton_certificate
from ...text import angle as in_words
from ...text import figure
from ..report import Report, Work, cell, rounds, spread
from . import formulas as planar
from .figures import grid, outcomes, over_starts, start_basins, target_basins

ROUNDS = 15


def reproduce(count: int = 20_000, seed: int = 0) -> Report:
    """Compute the report on this paper, with `count` random targets for its table of convergence."""
    with Report("chinyai", "Chinyai: Newton-Raphson against the closed form, tested") as report:
        report.text(
            "The paper compares Newton-Raphson with the closed form of a planar two-link arm and concludes that Newton "
            "is faster. It prints **no number**: no link lengths, start, tolerance, iteration count, machine or time, "
            "and its section 'Application' is empty. So only the formulas and the claim can be checked; "
            "both are tested here."
        )
        rng = np.random.default_rng(seed)
        _formulas(report, rng, count)
        ratio = _speed(report, rng)
        _convergence(report, rng, count)
        _failures(report, rng)
        _certified(report, rng, (1.1, 0.6))
        report.heading("Verdict")
        slower = min(values.min() for values in ratio.values()) > 1.0
        words = {name: spread(values) for name, values in ratio.items()}
        report.text(
            f"The claim {'does not hold' if slower else 'holds in part'} on this arm: in this run Newton-Raphson from a "
            f"fixed start takes {words['compiled']} times as long as the closed form when both are compiled, "
            f"{words['python']} times in plain Python and {words['numpy']} times in numpy, and still {words['warm']} times "
            f"from a start 0.001 rad away (compiled; median [min-max] of {ROUNDS} rounds); and it returns one answer, or "
            "none, where the closed form returns both. The other half of the argument holds: Newton needs only the "
            "forward kinematics and the Jacobian, so it also serves arms without a closed form. The claim may "
            "come from timing a symbolic solve of the two equations against a numeric loop."
        )
        _misprints(report)
    return report


def _formulas(report: Report, rng: np.random.Generator, count: int) -> None:
    report.heading("The closed form as printed")
    l1, l2 = 1.0, 0.8
    X = planar.targets(rng, count, l1, l2)
    x, y = X.T
    c2 = np.clip((x**2 + y**2 - l1**2 - l2**2) / (2 * l1 * l2), -1, 1)
    rows, heading = [], np.arctan(y / x)
    for sign, name in ((-1.0, "upper"), (1.0, "lower")):
        t2 = sign * np.arccos(c2)
        literal, signed = 1 - c2**2, np.sin(t2)  # Eq. (2) prints the square of the sine instead of the sine.
        below, turned = l1 + l2 * c2, np.arctan2(l2 * signed, l1 + l2 * c2)
        for words, t1 in (
            (f"(4), (5), {name} signs, sine as printed in (2)", heading + sign * np.arctan(l2 * literal / below)),
            (f"(4), (5), {name} signs, sin(theta_2) with its sign", heading + sign * np.arctan(l2 * signed / below)),
            (f"the same with atan2 for both arctan, {name} signs", np.arctan2(y, x) + sign * turned),
            (f"corrected (always minus, signed sine, atan2), {name} sign of theta_2", np.arctan2(y, x) - turned),
        ):
            reached = l1 * np.exp(1j * t1) + l2 * np.exp(1j * (t1 + t2))  # The tip as x + iy.
            rows.append([words, 100.0 * float(np.mean(np.abs(reached - (x + 1j * y)) < 1e-9))])
    report.table("formulas", ["formulas", "targets reached (%)"], rows)
    report.text(
        f"{count} targets uniform over the reach of links 1 and 0.8, reached within 1e-9. In (4) and (5) only "
        "the upper signs are right: the sine already carries the sign of theta_2. (1), (8) and (9) "
        "are right; det J = l1 l2 sin(theta_2)."
    )


def _measure(rng: np.random.Generator) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """Measure times [s] by implementation and start, and mean steps by start."""
    l1, l2, n, few = 1.0, 0.8, 20_000, 200
    fixed = np.array([[math.radians(45.0), math.radians(90.0)]])
    X = planar.targets(rng, 2 * n, l1, l2)
    # Targets for which Newton does not converge are left out of the timing, because they would take all 50 steps.
    X = X[planar.converge(X, l1, l2, fixed, planar.PLAIN)[:, 2] >= 0][:n]
    both, out = np.empty((n, 4)), np.empty((n, 4))
    planar.closed_form_all(X, l1, l2, both)
    starts = {"fixed": fixed}
    for name, away in (("0.01", 0.01), ("0.001", 0.001)):
        starts[name] = both[:, :2] + rng.uniform(-away, away, (n, 2))
    python_closed = getattr(planar.closed_form, "py_func", planar.closed_form)
    python_newton = getattr(planar.newton, "py_func", planar.newton)
    extra = (planar.PLAIN, planar.NO_CLIP, planar.TOLERANCE * (l1 + l2), planar.ITERATIONS)
    goals = [(x, y, l1, l2) for x, y in X[:few].tolist()]
    arm = Robot.load("planar_2r")
    tips = arm.chain.forward(np.array([arm.random_q(rng) for _ in range(few)]))[0][:, :3, 3].copy()

    def each(function: Callable, arguments: Sequence[tuple]) -> Work:
        def work() -> None:
            for one in arguments:
                function(*one)

        return work, few

    works: dict[str, Work] = {
        "compiled, closed form": (lambda: planar.closed_form_all(X, l1, l2, both), n),
        "python, closed form": each(python_closed, goals),
        "numpy, closed form": each(planar.closed_form_numpy, goals),
        "toolkit, closed form": each(Solver(arm, "planar-2r"), [(tip,) for tip in tips]),
        "toolkit, fixed": each(Solver(arm, "newton"), [(tip,) for tip in tips]),
    }
    steps: dict[str, float] = {}
    for name, start in starts.items():
        from_start = [(*goal, *q) for goal, q in zip(goals, np.broadcast_to(start, (n, 2))[:few].tolist(), strict=True)]
        works[f"compiled, {name}"] = (
            partial(planar.newton_all, X, l1, l2, start, planar.PLAIN, planar.NO_CLIP, planar.ITERATIONS, out),
            n,
        )
        works[f"python, {name}"] = each(python_newton, [(*one, *extra) for one in from_start])
        works[f"numpy, {name}"] = each(planar.newton_numpy, from_start)
        row = planar.converge(X, l1, l2, start, planar.PLAIN)
        steps[name] = float(row[row[:, 2] >= 0, 2].mean())
    return rounds(works, ROUNDS), steps


def _speed(report: Report, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Add the table of times. Returns the ratios of Newton's time to that of the closed form, one for each round of timing.

    There is one array of ratios each for compiled code, Python, numpy, and compiled code from a warm start.
    """
    report.heading("Time per solve")
    times, steps = _measure(rng)
    labels = {
        "compiled": "compiled (numba), both branches",
        "python": "plain Python",
        "numpy": "numpy, small arrays",
        "toolkit": "the toolkit's bound solvers from Python",
    }
    columns = {
        "closed form": "closed form (us)",
        "fixed": "Newton, start (45, 90) deg (us)",
        "0.01": "start within 0.01 rad (us)",
        "0.001": "start within 0.001 rad (us)",
    }
    us = {name: spread(1e6 * values) for name, values in times.items()}
    rows = [[label, "-", *(us.get(f"{kind}, {name}", "-") for name in columns)] for kind, label in labels.items()]
    report.table("time_us", ["implementation", "published", *columns.values()], rows)
    words = "; ".join(f"{name}: {k:.1f} steps on average" for name, k in steps.items())
    report.text(
        f"Median [min-max] of {ROUNDS} interleaved rounds, processor time, on this machine; links 1 "
        "and 0.8 (toolkit row: 1 and 1, from home), "
        f"tolerance 1e-10 of the reach. Only targets that Newton solves from (45, 90) deg are timed. By start: {words}. "
        "The toolkit's row "
        "includes validation and the result object, the same for both."
    )
    ratio = {kind: times[f"{kind}, fixed"] / times[f"{kind}, closed form"] for kind in ("compiled", "python", "numpy")}
    ratio["warm"] = times["compiled, 0.001"] / times["compiled, closed form"]
    return report.number("newton_over_closed_form", ratio)


STARTS = {  # Starting angles [degrees] of both joints that are compared, by link lengths (l1, l2) of the arm.
    (1.0, 1.0): ((0.0, 5.7), (0.0, 0.06), (28.6, 28.6), (0.0, 90.0), (45.0, 90.0), (0.0, 143.0), (0.0, 0.0)),
    (1.0, 0.6): ((0.0, 5.7), (45.0, 90.0), (0.0, 143.0), (0.0, 0.0)),
}


def _convergence(report: Report, rng: np.random.Generator, count: int) -> None:
    report.heading("Where Newton converges")
    rows = []
    variants = {
        "plain": (planar.PLAIN, planar.NO_CLIP),
        "search": (planar.SEARCH, planar.NO_CLIP),
        "LM": (planar.LEVENBERG, planar.NO_CLIP),
        "step": (planar.STEP, planar.NO_CLIP),
        "plain + clip": (planar.PLAIN, planar.LIMIT),
        "step + clip": (planar.STEP, planar.LIMIT),
    }
    for (l1, l2), starts in STARTS.items():
        X = planar.targets(rng, count, l1, l2)
        for start in starts:
            ends = {name: planar.converge(X, l1, l2, np.radians(start), *how)[:, 2] for name, how in variants.items()}
            solved = {name: 100.0 * float(np.mean(steps >= 0)) for name, steps in ends.items()}
            rows.append({"l1, l2": f"{l1:g}, {l2:g}", "start (deg)": f"{start[0]:g}, {start[1]:g}", **solved})
    report.records("convergence", rows)
    (drawn,) = (row for row in rows if row["l1, l2"] == "1, 1" and row["start (deg)"] == "45, 90")
    X = planar.targets(rng, count, 1.0, 1.0)
    both = np.empty((count, 4))
    planar.closed_form_all(X, 1.0, 1.0, both)
    both = np.remainder(both + math.pi, 2 * math.pi) - math.pi
    legal = (np.abs(both[:, :2]).max(axis=1) <= planar.LIMIT) | (np.abs(both[:, 2:]).max(axis=1) <= planar.LIMIT)
    share = report.number("closed_form_inside_limits_percent", 100.0 * float(legal.mean()))
    report.text(
        f"Percent of {count} targets, uniform over the reach, solved to 1e-10 in at most {planar.ITERATIONS} steps; "
        "published: nothing. search: the step is halved until the error falls; LM: Levenberg-Marquardt; step: at "
        f"most {planar.LONGEST} rad a joint; clip: joints cut to +-150 deg after each step. With those limits the two "
        f"branches of the closed form, filtered, solve {cell(share)} % of the targets of the arm 1, 1: all that can be "
        "solved. Where det J is small a step depends on the last digits of the angles, so another processor may differ in the "
        "last digits of the shares of plain Newton."
    )
    caption = (
        "Links 1 and 1, start (45, 90) deg, marked: which of the two solutions each target of the workspace leads "
        "to. Plain Newton fails in the white regions and jumps between the branches; clipping at limits loses more."
    )
    report.figure("targets.png", caption, target_basins, drawn)
    caption = (
        "Links 1 and 1, target (1.1, 0.6): the basins of the two solutions over all starting angles. Plain Newton's "
        "are endlessly interleaved near theta_2 = 0 and 180 deg, where det J = 0."
    )
    report.figure("starts.png", caption, start_basins, (1.1, 0.6))


def _failures(report: Report, rng: np.random.Generator) -> None:
    report.heading("How it fails")
    X = planar.targets(rng, 20_000, 1.0, 1.0)
    out = planar.converge(X, 1.0, 1.0, np.radians((0.0, 0.06)), planar.PLAIN)
    good = out[:, 2] >= 0
    outside = 100.0 * float(np.mean(np.abs(out[good, :2]).max(axis=1) > math.pi))
    other = 100.0 * float(np.mean(np.sin(out[good, 1]) < 0))
    border = {
        r: planar.converge(np.array([[r, 0.0]]), 1.0, 1.0, np.radians((45.0, 90.0)), planar.PLAIN)[0]
        for r in (2.0, 1.9)
    }
    angle = rng.uniform(-np.pi, np.pi, 2000)
    far = 2.4 * np.column_stack([np.cos(angle), np.sin(angle)])
    lost = {
        kind: planar.converge(far, 1.0, 1.0, np.radians((45.0, 90.0)), kind)
        for kind in (planar.PLAIN, planar.LEVENBERG)
    }
    line = planar.converge(np.array([[1.2, 0.0]]), 1.0, 1.0, (0.0, 0.0), planar.LEVENBERG)[0]
    left = {kind: float(np.median(rows[:, 3])) for kind, rows in lost.items()}
    cases = {
        "start with theta_2 = 0 or 180 deg": "det J = 0: no step exists; LM leaves it, "
        f"{'and' if line[2] >= 0 else 'but not'} for a target on the arm's own line",
        "start with small sin(theta_2), (0, 0.06) deg": f"huge first step: {outside:.0f} % of the answers lie outside +-180 deg, "
        f"{other:.0f} % in the other elbow branch",
        "target on the border, r = l1 + l2": f"double root: {abs(int(border[2.0][2]))} steps against {int(border[1.9][2])} at "
        f"r = 1.9, theta_2 off by {in_words(abs(border[2.0][1]), deg=False)}",
        "unreachable target, r = 2.4": f"plain Newton never stops: |e| = {left[planar.PLAIN]:.2f} m at the end (best possible "
        f"0.40), angles up to {figure(np.abs(lost[planar.PLAIN][:, :2]).max(), 1)} rad; LM ends at {left[planar.LEVENBERG]:.2f} m",
    }
    report.table("failures", ["case", "what happens"], [*cases.items()])
    report.number("lm_unreachable_median_error", left[planar.LEVENBERG])


def _proven(target: Any, count: int, steps: int) -> tuple[np.ndarray, np.ndarray, list[Any]]:
    """Return the outcomes from a grid of starts, those proven after `steps` steps (NaN: not proven), and a row of the table."""
    starts = grid(count)
    X = np.tile(target, (len(starts), 1))
    ends = outcomes(planar.converge(X, 1.0, 1.0, starts, planar.PLAIN))
    at = planar.converge(X, 1.0, 1.0, starts, planar.PLAIN, iterations=steps)[:, :2]
    made = newton_certificate(Robot.load("planar_2r"), (*target, 0.0), at, limits=False)
    index = made.leads_to(np.reshape(planar.closed_form(*target, 1.0, 1.0), (2, 2)))
    shares = [100.0 * float(made.proven.mean()), 100.0 * float(made.proven.sum() / np.isfinite(ends).sum())]
    return ends, np.where(index < 0, np.nan, index), [steps, *shares, int((made.proven & (index != ends)).sum())]


def _certified(report: Report, rng: np.random.Generator, target: tuple[float, float]) -> None:
    report.heading("Beyond the paper: Newton that knows")
    panels, rows = {}, []
    for steps in (0, 1, 2, 3, 4, 6, 8):
        ends, known, row = _proven(target, 241, steps)
        rows.append(row)
        if steps in (0, 3):
            panels[f"sampled:\n{100 * np.isfinite(ends).mean():.1f} % converge"] = ends
            when = "beforehand" if steps == 0 else f"after {steps} steps"
            panels[f"proven {when}:\n{row[2]:.1f} % of these"] = np.where(np.isfinite(known), known, ends + 2.0)
    head = ["steps before the test", "starts proven (%)", "of those that converge (%)", "exceptions"]
    report.table("certified", head, rows)
    others = [_proven(x, 121, 0)[2] for x in planar.targets(rng, 20, 1.0, 1.0)]
    shares = report.number("certified_other_targets_percent", [row[2] for row in others])
    wrong = report.number("certified_exceptions", sum(row[3] for row in rows + others))
    report.text(
        f"""`ik.newton_certificate` applies the theorem of Newton and Kantorovich before any step is taken. With eta, the length of
        the first step, beta = |F'(q0)^-1| and a Lipschitz constant L of F', which follows from the link lengths alone,
        h = beta eta L of at most 1/2 proves that whole steps converge, to which of the two solutions, within what radius, and
        within what second radius there is no other. The table and the picture test it for the target {target} on {241**2}
        starts. For 20 other targets it proves {spread(np.array(shares))} % of the starts that converge (median [min-max];
        {121**2} starts each). Exceptions, which end elsewhere than proven: {wrong} in all. What is proven is true, but most of
        what is true is not proven beforehand: one bound serves for the whole arm and all directions. Each step shortens the
        next, so the same test soon passes on the way, and tells a run that has come close enough from one that still wanders.
        `python scripts/theory_newton.py` looks for counterexamples among random arms of one to six joints."""
    )
    caption = (
        f"Links 1 and 1, target {target}: basins as sampled, and the starts from which convergence to a solution (marked) is "
        "proven beforehand or three steps later. Pale: converges, but not proven."
    )
    report.figure("proven.png", caption, over_starts, panels, target)


def _misprints(report: Report) -> None:
    report.heading("Misprints")
    rows = """
        (2) sin(theta_2) = sqrt((1 - cos^2))^2 | that is the square of the sine | +-sqrt(1 - cos^2)
        (3) theta_1 = gamma - beta | for theta_2 > 0 only | gamma - atan2(l2 s2, l1 + l2 c2), s2 signed
        (4), (5) paired signs | the lower ones are wrong | always minus, s2 signed
        arctan(y/x), arctan(a2 s2/(a1 + a2 c2)) | wrong quadrant for a negative denominator, undefined at 0 | atan2
        a1, a2 beside l1, l2 | two names for one thing | l1, l2
        'error = desired - current joint angles' | contradicts (9) | position error f(theta) - x_d
        (6) (x - x_n) | not the residual | f(theta_n) - x_d, as (9)
        'minimise' | (7) looks for a root; where there is none it wanders | reach test, or Levenberg-Marquardt
        stop rule, singular case, reach test, numbers | absent | above
    """
    report.table("misprints", ["published", "what is wrong", "reading used"], rows)
