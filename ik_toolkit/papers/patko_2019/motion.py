"""Beyond Patko and Zelei (2019): their stability charts in motion, and the least sample rate for a path."""

import warnings
from typing import Any

import numpy as np

from ...motion.reference import Reference
from ...motion.shapes import circle
from ...robot.robot import Robot
from ...servo.orbit_stability import PathMotion
from ...servo.path_stability import least_rate, stability_chart
from ...servo.run import track
from ...solvers.solve import solve
from ..report import Report
from .cases import SETS
from .figures import draw_motion

LAP = 4.0 * np.pi  # [s] a lap of the RR circle
APART = 1e-8  # [rad] distance of two runs that show the growth of an error
LAPS = 4  # laps of these runs; later the error of an unstable run is no longer small
BESIDE = 0.01  # share by which the rates of these runs are below and above the least one


def rr_circle(size: float = 1.0, laps: int = 1) -> Reference:
    """Return the RR circle of the report, `size` times as large, as a reference of so many laps."""
    return circle(center=[size, 0.6 * size, 0.0], radius=0.35 * size, turns=laps, duration=LAP * laps)


def in_motion(made: Report) -> None:
    """Add the section on stability in motion."""
    made.heading("Beyond the paper: stability in motion")
    rr, three, panda = (Robot.load(name) for name in ("planar_2r", "planar_3r", "panda"))
    pose = circle(panda.fk(panda.home).homogeneous, 0.1, duration=4.0)
    bad, good = SETS["RR bad"], SETS["RR good"]
    rows = []
    for name, robot, path, sets in (
        ("RR, circle", rr, rr_circle(), (bad, good, None)),
        ("3R (redundant), circle 3 x as large", three, rr_circle(3.0), (bad, None)),
        ("Panda (redundant), poses on a circle of 0.1 m in 4 s", panda, pose, (bad, None)),
    ):
        for s in sets:
            for method in ("cv", "ca"):
                gains = {} if s is None else {"kappa": s.kappa} if method == "cv" else {"kp": s.kp, "kd": s.kd}
                found = least_rate(robot, path, method, **gains)
                runs = [["", ""], ["", ""]]
                if robot is rr and gains:
                    runs = [by_runs(rr, method, (1.0 + f) * found.rate, gains) for f in (-BESIDE, BESIDE)]
                label = "best for each rate" if s is None else s.name
                rows.append([name, label, method, found.at_rest, found.rate, found.most, *runs[0], *runs[1]])
    made.table(
        "least_rates",
        ["arm and path", "gains", "method", "at rest (Hz)", "in motion (Hz)", "tried to (Hz)",
         f"{100 * BESIDE:g} % below: product", "runs", f"{100 * BESIDE:g} % above: product", "runs"],
        rows,
    )  # fmt: skip
    made.text(
        """**Least sample rates.** With these gains, fixed while the rate changes, every rate that was tried (5 % apart) from "in
        motion" to "tried to" is stable: the product of the exact derivatives of all steps shrinks a small error over a lap. The
        last four columns say, just beside the least rate, by which factor an error changes in a lap: by the product, and by two
        runs that start 1e-8 rad apart (mean of laps 2 to 4). Motion costs the published RR sets a few percent of rate;
        with the best gains for each rate, a dozen
        samples a lap are enough for stability, though not for accuracy. A redundant arm is judged by its tip, without null-space
        motion; at acceleration level its runs do have such motion, and may then leave the configurations that were judged."""
    )
    shape = bad.kp / bad.kd**2
    charts = [
        (stability_chart(robot, path, method, shape=shape if method == "ca" else None), f"{name}: {method}")
        for name, robot, path in (("RR", rr, rr_circle()), ("3R (redundant)", three, rr_circle(3.0)))
        for method in ("cv", "ca")
    ]
    made.figure(
        "fig9_in_motion.png",
        "Fig. 9 in motion: stable gains (shaded) over the distance that the target moves in a sample; for a target at rest, at the "
        "bottom, the border is that of Fig. 9. Lines: the published sets while the rate changes; dots: h = 0.2 s",
        lambda plt: draw_motion(plt, charts, {"RR bad": bad, "RR good": good}, LAP),
    )
    made.text(
        f"""**Fig. 9 in motion.** Only kappa h (for ca kd h, with kp / kd^2 = {shape:g} as in the bad RR set) and the number of
        samples of a lap count, so one chart holds for every speed: a lap in half the time at twice the rate is the same point. The
        faster the target, the smaller the stable region. A fixed gain moves along a line through the origin as the rate changes, and
        leaves the region at its least rate. `ik.stability_chart` and `ik.plot` draw the same for any robot and path."""
    )


def by_runs(robot: Robot, method: str, rate: float, gains: dict[str, float]) -> list[Any]:
    """Return the factor by which an error changes in a lap of the RR circle, by the product and by two runs APART."""
    h = 1.0 / rate
    factor = PathMotion(robot, rr_circle()).growth(method, h, gains).factor
    path, lap = rr_circle(laps=LAPS), LAP * rate
    q0 = solve(robot, path.target(0.0), q0=robot.home).q
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Unstable gains are meant.
        runs = [
            track(robot, path, method, dt=h, q0=q, limits=False, damping=0.0, **gains).q
            for q in (q0, q0 + APART * np.array([1.0, -0.5]))
        ]
    first, last = round(lap), round(LAPS * lap) - 1
    ratio: Any = "diverge"
    if min(len(q) for q in runs) > last:
        d = [float(np.linalg.norm(runs[0][k] - runs[1][k])) for k in (first, last)]
        ratio = (d[1] / d[0]) ** (1.0 / (LAPS - 1))
    return [factor, ratio]
