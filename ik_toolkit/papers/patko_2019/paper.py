"""Report on Patko and Zelei (2019), tracking at velocity and acceleration level.

Source: D. Patko, A. Zelei, "Alternative inverse kinematic calculation methods in velocity and acceleration level", in:
Theoretical Approaches in Non-Linear Dynamical Systems (DSTA), Lodz 2019, pp. 405-417. The paper prints no error numbers and
leaves out the arms' paths, lengths, initial errors and durations; those chosen here are named in the report.
"""

from typing import Any

import numpy as np

from ...motion.reference import Reference
from ...motion.shapes import circle
from ...robot.robot import Robot
from ...servo import stability as st
from ...servo.orbit_stability import PathMotion
from ...servo.path_stability import least_rate, stability_chart
from ...servo.run import track
from ...solvers.solve import solve
from ..report import ROUNDING, Report
from .cases import CASES, METHODS, SETS, ZIGZAGS, GainSet, growth, known_run, settled
from .dynamics import dynamics
from .figures import draw_charts, draw_errors, draw_motion, draw_orders, draw_plane


def reproduce() -> Report:
    """Compute the report on this paper, with everything in it that can be checked. This takes about half a minute."""
    with Report("patko_2019", "Patko and Zelei (2019): tracking at velocity and acceleration level") as made:
        made.text(
            """The paper compares four ways of following a moving target: classical feedback at velocity level (cv) and at
            acceleration level (ca), and alternatives that remove the error in one step (av, aa). It prints gains, mapping matrices
            and charts, but no error values, paths, link lengths, initial errors, durations or start values. So matrices and
            verdicts are compared exactly, and the curves are redrawn for our own choices: PP l = 0.5 m on a
            circle of 0.3 m about (1, 1) at 1 rad/s; RR l = 1 m on a circle of 0.35 m about (1, 0.6) at 0.5 rad/s; initial errors
            0.1, (0.1, -0.05) and (0.05, -0.05) m. Errors are target minus actual; the paper uses the opposite sign."""
        )
        dynamics(made, {name: (SETS[name].kp, SETS[name].kd) for name in ("PP good", "RR good")})
        _radii(made)
        _figures(made)
        runs = _errors(made)
        _orders(made)
        growths = _growth(made)
        _in_motion(made)
        _claims(made, runs, growths)
    return made


def _radii(made: Report) -> None:
    made.heading("Stability of the published gain sets")
    made.text(
        """Spectral radius of the mapping matrices, eqs. (30) and (34); below 1 is stable. Closed form (ours): cv is stable for
        0 < kappa h < 1, ca for 0 < kd h < 1 and 0 < kp h^2 < (d + sqrt(d (9 d + 16))) / 2 with d = kd h."""
    )
    rows = []
    for s in SETS.values():
        cv = st.check_gains("cv", s.h, kappa=s.kappa)
        ca = st.check_gains("ca", s.h, kp=s.kp, kd=s.kd)
        agree = "yes" if cv.verdict == ca.verdict == s.paper else "NO"
        d = s.kd * s.h
        row = {"set": s.name, "where": s.where, "paper says": s.paper}
        row |= {"kappa h": s.kappa * s.h, "radius cv": cv.radius, "cv is": cv.verdict}
        row |= {"kd h": d, "kp h^2": s.kp * s.h**2, "limit of kp h^2": float(st.p_limit(d))}
        rows.append(row | {"radius ca": ca.radius, "ca is": ca.verdict, "agree": agree})
    made.records("radii", rows)
    misprint = st.mapping_matrix("ca", 0.2, kp=40.0, kd=4.0, dof=2)
    misprint[2, 2] = (2.0 - 3.0 * 40.0 * 0.2) / 2.0
    wrong = SETS["RR bad"]
    border = float(st.p_limit(wrong.kd * wrong.h)) / wrong.h**2
    bad = made.number("radius_with_misprint_of_41", st.spectral_radius(misprint))
    made.text(
        f"""**The contradiction:** the RR set of Figs. 7 and 8 left, "unstable" in the paper, is not outside the paper's own
        region: cv is exactly on the border (radius 1) and ca inside it (kp = {wrong.kp:g} against the border at
        {border:.4g}). It does
        diverge on a fast path, because the matrices describe the arm at rest (see growth below). Two misprints: entry (3,3) of
        eq. (41) has kp where it should have kd (as printed the radius of the good RR set would be {bad:.3g}); eqs. (29) and
        (32) print the
        indices i+1, i, which would make every gain stable, contradicting eqs. (30) and (34): read "current and previous"."""
    )
    caption = "Fig. 9 redrawn: stable regions of cv and ca, with all the published gain sets"
    made.figure("fig9_charts.png", caption, draw_charts, SETS)


def _figures(made: Report) -> None:
    made.heading("The error curves")
    curves = {}
    for sign, label in ((-1.0, "starting 0.1 m short"), (1.0, "starting 0.1 m too far")):
        curves[label] = {k: known_run("1-DoF", SETS["1-DoF"], k, sign) for k in ("cv", "av", "ca", "aa1", "aa2", "aa3")}
    caption = "Fig. 4 redrawn: error of the 1-DoF case, the three readings of aa; aa2 leaves the domain q > 0 in the right panel"
    made.figure("fig4_one_dof.png", caption, draw_errors, curves, (0.0, 60.0))
    for name, files in (("PP", "fig5_6_pp.png"), ("RR", "fig7_8_rr.png")):
        case = CASES[name]
        panels = {
            f"{word}: kappa {s.kappa:g}, kp {s.kp:g}, kd {s.kd:g}, h {s.h:g}": {
                k: known_run(name, s, k, 1.0) for k in ("cv", "av", "ca", "aa2", "aad")
            }
            for word, s in (('"unstable" set', SETS[f"{name} bad"]), ("stable set", SETS[f"{name} good"]))
        }
        number, lap = ("5 and 6", 2.0 * np.pi) if name == "PP" else ("7 and 8", 4.0 * np.pi)
        caption = (
            f"Figs. {number} redrawn: {name} arm, path of the tip and error at the samples (aa is its second reading)"
        )
        made.figure(files, caption, draw_plane, case, lap, panels)


def _errors(made: Report) -> dict[tuple[str, str, str], dict[str, float]]:
    made.heading("Errors reached")
    made.text(
        """Second half of the run [m]; "between" is the largest error between samples, on the motion the method itself assumes
        (straight at velocity level, constant acceleration else). "diverges": a value left the domain or grew without bound; at
        which step depends on rounding.
        Stable gain sets."""
    )
    found, rows = {}, []
    for name, gains in (("1-DoF", "1-DoF"), ("PP", "PP good"), ("RR", "RR good")):
        for start in ("exact", "offset"):
            for key in METHODS:
                result = known_run(name, SETS[gains], key, 1.0 if start == "offset" else 0.0)
                numbers = found[name, start, key] = settled(CASES[name], result)
                about = f"after about {float(f'{len(result.t) - 1:.2g}'):g} steps"
                rows.append([name, start, key, *(["diverges", "", "", about] if result.stopped else numbers.values())])
    made.table("errors", ["case", "start", "method", "max", "RMS", "RMS of the whole run", "between"], rows, ROUNDING)
    return found


def _orders(made: Report) -> None:
    made.heading("Order in the sample time")
    lap = 4.0 * np.pi
    steps = (0.1, 0.05, 0.025, 0.0125)
    rows, curves = [], {}
    for label, key, scaled in (
        ("cv, fixed gain", "cv", False), ("cv, scaled gain", "cv", True), ("av", "av", False),
        ("ca, fixed gains", "ca", False), ("ca, scaled gains", "ca", True),
        ("aa1", "aa1", False), ("aa2", "aa2", False), ("aa3", "aa3", False), ("aad", "aad", False),
    ):  # fmt: skip
        errors = []
        for h in steps:
            s = GainSet("", h, 2 / 3 / h, 1.6 / h**2, 0.8 / h, "", "") if scaled else SETS["1-DoF"]
            e = np.linalg.norm(known_run("RR", s, key, h=h, steps=round(2 * lap / h)).error, axis=1)
            errors.append(float(e[len(e) // 2 :].max()))
        curves[label] = errors
        rows.append([label, *errors, float(np.log2(errors[-2] / errors[-1]))])
    (slope,) = (row[-1] for row in rows if row[0] == "aa1")
    made.text(
        f"""RR arm, exact start, largest error in the second half as h is halved, and the slope between the last two; fixed
        gains are
        those of the 1-DoF case, scaled ones keep kappa h = 2/3, kp h^2 = 1.6, kd h = 0.8. The paper says only that smaller steps
        give smaller errors. (aa1 shows {slope:.1f}: its growing zigzag still adds to its third order.)"""
    )
    made.table("orders", ["method", *(f"h = {h:g}" for h in steps), "slope"], rows)
    made.figure("orders.png", "Largest settled error against the sample time (RR arm)", draw_orders, steps, curves)


def _growth(made: Report) -> dict[tuple[str, str], float]:
    made.heading("Growth of small disturbances in motion")
    made.text(
        """The matrices are valid at rest. In motion, each lap (the RR circle, or a period of the
        1-DoF path) multiplies a small disturbance by the factor below; above 1 it grows until the run diverges. It is the
        spectral radius of the product of the exact derivatives of every step, taken on the motion without error. The first two
        readings of aa leave that motion by their zigzag; the derivatives are then taken on the run that the method itself makes
        from there, zigzag included (disturbed runs show the same factors to 5 digits)."""
    )
    found, rows = {}, []
    for name, gains, keys in (
        ("1-DoF", "1-DoF", ("aa1", "aa2", "aa3", "aad")),
        ("RR", "RR good", ("cv", "ca", "aa1", "aa2", "aa3", "aad")),
        ("RR", "RR bad", ("cv", "ca")),
    ):
        lap = 2 * np.pi / 0.28 if name == "1-DoF" else 4 * np.pi
        for key in keys:
            factor = found[gains, key] = growth(CASES[name], SETS[gains], key, lap)
            per_step = factor ** (1.0 / round(lap / SETS[gains].h))
            so = "grows" if factor > 1.01 else "kept" if factor > 0.99 else "decays"
            rows.append([gains, key, factor, per_step, so, "its run" if key in ZIGZAGS else "no error"])
    made.table("growth", ["gain set", "method", "per lap", "per step", "so it", "linearised on"], rows)
    return found


def _rr_circle(size: float = 1.0, laps: int = 1) -> Reference:
    """Return the RR circle of the report, `size` times as large, as a reference of so many laps."""
    return circle(center=[size, 0.6 * size, 0.0], radius=0.35 * size, turns=laps, duration=4.0 * np.pi * laps)


def _in_motion(made: Report) -> None:
    """Add the section on stability in motion."""
    made.heading("Beyond the paper: stability in motion")
    rr, three, panda = (Robot.load(name) for name in ("planar_2r", "planar_3r", "panda"))
    pose = circle(panda.fk(panda.home).homogeneous, 0.1, duration=4.0)
    bad, good = SETS["RR bad"], SETS["RR good"]
    rows = []
    for name, robot, path, sets in (
        ("RR, circle", rr, _rr_circle(), (bad, good, None)),
        ("3R (redundant), circle 3 x as large", three, _rr_circle(3.0), (bad, None)),
        ("Panda (redundant), poses on a circle of 0.1 m in 4 s", panda, pose, (bad, None)),
    ):
        for s in sets:
            for method in ("cv", "ca"):
                gains = {} if s is None else {"kappa": s.kappa} if method == "cv" else {"kp": s.kp, "kd": s.kd}
                found = least_rate(robot, path, method, most=20.0, **gains)
                runs = [["", ""], ["", ""]]
                if robot is rr and gains:
                    runs = [_by_runs(rr, method, (1.0 + f) * found.rate, gains) for f in (-0.01, 0.01)]
                label = "best for each rate" if s is None else s.name
                rows.append([name, label, method, found.at_rest, found.rate, found.most, *runs[0], *runs[1]])
    made.table(
        "least_rates",
        ["arm and path", "gains", "method", "at rest (Hz)", "in motion (Hz)", "tried to (Hz)",
         "1 % below: product", "runs", "1 % above: product", "runs"],
        rows,
    )  # fmt: skip
    made.text(
        """**Least sample rates.** With these gains, fixed while the rate changes, every rate that was tried (5 % apart) from "in
        motion" to "tried to" is stable: the product of the exact derivatives of all steps shrinks a small error over a lap. The
        last four columns say, beside the least rate, by which factor an error changes in a lap: by the product, and by two runs
        that start 1e-8 rad apart (mean of laps 2 to 4). Motion costs the published RR sets a few percent of rate (with a whole
        number of samples a lap, the bad set needs 64 for cv, 5.09 Hz, and 66 for ca, 5.25 Hz); with the best gains for each rate,
        some 15 samples a lap are stable, though not accurate. A redundant arm is judged by its tip, without null-space motion; at
        acceleration level its runs have such motion, and may leave the configurations that were judged.
        `scripts/theory_patko.py` compares the product with runs on random arms, paths and gains: of 10,020 cases the two
        contradict each other in 50, all of them redundant arms at acceleration level."""
    )
    shape = bad.kp / bad.kd**2
    charts = [
        (stability_chart(robot, path, method, shape=shape if method == "ca" else None), f"{name}: {method}")
        for name, robot, path in (("RR", rr, _rr_circle()), ("3R (redundant)", three, _rr_circle(3.0)))
        for method in ("cv", "ca")
    ]
    caption = (
        "Fig. 9 in motion: stable gains (shaded) over the distance that the target moves in a sample; for a target at rest, at the "
        "bottom, the border is that of Fig. 9. Lines: the published sets while the rate changes; dots: h = 0.2 s"
    )
    made.figure("fig9_in_motion.png", caption, draw_motion, charts, {"RR bad": bad, "RR good": good}, 4.0 * np.pi)
    made.text(
        f"""**Fig. 9 in motion.** Only kappa h (for ca kd h, with kp / kd^2 = {shape:g} as in the bad RR set) and the number of
        samples of a lap count, so one chart holds for every speed: a lap in half the time at twice the rate is the same point. The
        faster the target, the smaller the stable region. As the rate changes, a fixed gain moves along a line through the
        origin, and leaves the region at its least rate. `ik.stability_chart` and `ik.plot` draw the same for any robot and path."""
    )


def _by_runs(robot: Robot, method: str, rate: float, gains: dict[str, float]) -> list[Any]:
    """Return the factor by which an error changes in a lap of the RR circle, by the product and by two runs."""
    h = 1.0 / rate
    factor = PathMotion(robot, _rr_circle()).growth(method, h, gains).factor
    path, lap = _rr_circle(laps=4), 4.0 * np.pi * rate
    q0 = solve(robot, path.target(0.0), q0=robot.home).q
    options: dict[str, Any] = {"dt": h, "limits": False, "damping": 0.0, **gains}
    runs = [track(robot, path, method, q0=q, **options).q for q in (q0, q0 + 1e-8 * np.array([1.0, -0.5]))]
    first, last = round(lap), round(4 * lap) - 1
    if min(len(q) for q in runs) <= last:
        return [factor, "diverge"]
    d = [float(np.linalg.norm(runs[0][k] - runs[1][k])) for k in (first, last)]
    return [factor, (d[1] / d[0]) ** (1.0 / 3.0)]


def _claims(
    made: Report, runs: dict[tuple[str, str, str], dict[str, float]], growths: dict[tuple[str, str], float]
) -> None:
    made.heading("What the paper concludes, and what was found")

    def ratio(name: str, a: str, b: str) -> float:
        return runs[name, "exact", a]["max"] / runs[name, "exact", b]["max"]

    slow = min(
        st.spectral_radius(st.mapping_matrix("ca", s.h, kp=s.kp, kd=s.kd)) for s in SETS.values() if s.paper == "stable"
    )
    best = st.best_gains("ca", 1.0)
    near = [SETS[name].kappa * SETS[name].h for name in ("PP good", "RR good")]
    rows = [
        ["The same stability chart for all three systems (3.4)", "holds", "the matrices are those of one joint, repeated"],
        ["Eigenvalues of av are 0, of aa 0 and -1 (3.4)", "holds", "exactly"],
        [
            "Bad gain sets are out of the stable range (3.2.2, 3.3)", "half",
            "PP: both methods are outside. RR: cv exactly on the border, ca inside",
        ],
        [
            "Simulations are stable with gains from the stable domain (4)", "mostly",
            f"true for the stable sets; the bad RR set has ca inside the domain and grows {growths['RR bad', 'ca']:.3g} x a lap",
        ],
        [
            "Tracking error of av is smaller than of cv (4)", "transients only",
            f"gone in 1-2 steps and exactly 0 on PP; once settled av is {ratio('1-DoF', 'av', 'cv'):.3g} x worse on 1-DoF and "
            f"{ratio('RR', 'av', 'cv'):.3g} x on RR",
        ],
        [
            "ca performs better than aa (4)", "depends",
            f"1-DoF: aa1 {ratio('1-DoF', 'aa1', 'ca'):.3g} x, aa2 {ratio('1-DoF', 'aa2', 'ca'):.3g} x the error of ca; RR: both "
            "diverge; PP: aa exact at the samples but swings between them by half the initial error; aa3 beats ca on RR",
        ],
        [
            "aa is marginal, yet its error decays by nonlinear effects (3.4, 4)", "mostly refuted",
            f"the position error goes in one step already in eq. (35); the joint rate's zigzag is kept at rest, and in motion "
            f"changes per lap by {growths['1-DoF', 'aa1']:.3g} (aa1), {growths['1-DoF', 'aa2']:.3g} (aa2), "
            f"{growths['1-DoF', 'aa3']:.4g} (aa3) on 1-DoF, but {growths['RR good', 'aa1']:.3g}, {growths['RR good', 'aa2']:.3g}, "
            f"{growths['RR good', 'aa3']:.4g} on the RR circle",
        ],
        [
            "The good PP and RR gains are nearly optimal (Figs. 5, 7)", "cv yes, ca no",
            f"cv: kappa h {near[0]:.2g} and {near[1]:.2g} against 2/3; "
            f"ca: radius {slow:.3g} or more against {-st.TRIPLE:.3g} at kp h^2 = "
            f"{best['kp']:.4g}, kd h = {best['kd']:.4g}",
        ],
    ]  # fmt: skip
    made.table("claims", ["claim", "verdict", "found"], rows)
    made.text(
        """Ours: aad, which is the third reading of aa with the step weighted gamma > 1/2 (0.6 here): the eigenvalue -1 becomes
        1 - 1/gamma, the error at the samples stays third order, and the zigzag is gone."""
    )
