"""What `ik.calibrate` makes of planted errors: accuracy on held-out configurations, intervals, outliers, sockets.

    python scripts/benchmarks/calibrate.py --seeds 20 --cases 504

An arm gets random errors of every joint, link and the tool (5 mm, 1 degree; for sockets a quarter), by changing the placements of
its Pinocchio model here, not by the package's own model of errors. It is measured with noise (0.5 mm and 0.05 degrees; touches 0.1
mm) and judged against the truth in 500 other configurations. Errors are root mean squares per coordinate over the noise, those of
sockets in mm and in space.
"""

import time

from common import machine, one_thread, parser, table, write

one_thread()

import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402

import ik_toolkit as ik  # noqa: E402

NOISE, TURN = 5e-4, np.radians(0.05)
PLANTED = (5e-3, np.radians(1.0))
TOUCH = 1e-4


def arms():
    """The robots: two whose tip is on the last axis, and one where it is off it."""
    ur5 = ik.Robot.load("ur5")
    off = ur5.with_tool(ik.pose(xyz=(0.08, 0.05, 0.12), rpy=(0.3, 0.2, 0.1)))
    return {"hydrolek_7w": ik.Robot.load("hydrolek_7w"), "ur5": ur5, "ur5, tip off the last axis": off}


class Truth:
    """An arm with planted errors: tip poses by a changed Pinocchio model."""

    def __init__(self, robot, rng, share=1.0):
        self.robot, self.model = robot, robot.model.copy()
        for j in robot._path.joints:
            self.model.jointPlacements[j] = self.model.jointPlacements[j] * error(rng, share)
        self.tool, self.data = robot.tool * error(rng, share), self.model.createData()

    def __call__(self, Q):
        """Poses (N, 4, 4) at Q."""
        T = []
        for q in Q:
            pin.forwardKinematics(self.model, self.data, self.robot.to_pinocchio(q))
            base, tip = (
                pin.updateFramePlacement(self.model, self.data, self.model.getFrameId(name))
                for name in (self.robot.base, self.robot.tip)
            )
            T.append((base.actInv(tip) * self.tool).homogeneous)
        return np.array(T)


def error(rng, share):
    """A random motion of a frame."""
    return pin.SE3(pin.exp3(rng.normal(0.0, share * PLANTED[1], 3)), rng.normal(0.0, share * PLANTED[0], 3))


def noisy(T, rng, noise=NOISE):
    """Poses (N, 4, 4) as an instrument measures them."""
    made = T.copy()
    made[:, :3, 3] += rng.normal(0.0, noise, (len(T), 3))
    for one in made:
        one[:3, :3] = one[:3, :3] @ pin.exp3(rng.normal(0.0, TURN, 3))
    return made


def drawn_q(robot, rng, count):
    """Random configurations, continuous joints and those of several turns within half a turn either way."""
    return rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (count, robot.n))


def judged(found, truth, H):
    """Held-out error per coordinate over the noise, and the share of coordinates inside their 95 % intervals."""
    p, half = found.predict(H)
    off = p - truth(H)[:, :3, 3]
    return float(np.sqrt((off**2).mean()) / NOISE), float((np.abs(off) < half).mean())


def instrument(robot, what, seeds, suggested):
    """Rows of one robot and kind of measurement: accuracy, coverage of predictions, outliers."""
    plan = ik.suggest_poses(robot, 30, what=what, seed=1) if suggested else None
    rows = []
    for seed in range(seeds):
        rng = np.random.default_rng(100 + seed)
        truth, H = Truth(robot, rng), drawn_q(robot, rng, 500)
        Q = drawn_q(robot, rng, 30) if plan is None else plan
        data = noisy(truth(Q), rng)
        measured = data if what == "pose" else data[:, :3, 3]
        began = time.perf_counter()
        found = ik.calibrate(robot, Q, measured, what)
        took = time.perf_counter() - began
        error, covered = judged(found, truth, H)
        row = {
            "seed": seed,
            "error": error,
            "covered": covered,
            "seconds": took,
            "rank": found.rank,
            "outliers": len(found.outliers),
        }
        row |= {
            "before_mm": 1e3 * found.rms[0],
            "after_mm": 1e3 * found.rms[1],
            "drawn": found.rank_drawn,
            "fixed": [one.fixed for one in found.fixed],
        }
        bad = sorted(rng.choice(30, 3, replace=False).tolist())
        for k in bad:
            away = rng.normal(size=3)
            data[k, :3, 3] += 0.02 * away / np.linalg.norm(away)
        spoilt = ik.calibrate(robot, Q, data if what == "pose" else data[:, :3, 3], what)
        row |= {
            "named": set(bad) <= set(spoilt.outliers),
            "exactly": bad == sorted(spoilt.outliers),
            "spoilt": judged(spoilt, truth, H)[0],
        }
        rows.append(row)
    return rows


def coverage(robot, what, cases):
    """Share of the planted errors inside their 95 % intervals: errors are planted where the convention does not fix them."""
    from ik_toolkit.study.drawn_arm import DrawnArm

    arm = DrawnArm(robot, ("joints", "frames", "tool"))
    first = instrument(robot, what, 1, False)[0]
    free = np.array([one.name not in first["fixed"] for one in arm.unknowns])
    scale = np.array([PLANTED[one.turns] for one in arm.unknowns]) * free
    inside, predicted, other = [], [], 0
    for case in range(cases):
        rng = np.random.default_rng(7000 + case)
        x = rng.normal(size=len(scale)) * scale
        Q, H = drawn_q(robot, rng, 30), drawn_q(robot, rng, 20)
        data = noisy(arm.poses(x, Q), rng)
        found = ik.calibrate(robot, Q, data if what == "pose" else data[:, :3, 3], what)
        p, half = found.predict(H)
        predicted.append(float((np.abs(p - arm.poses(x, H)[:, :3, 3]) < half).mean()))
        if {one.fixed for one in found.fixed} != set(first["fixed"]):
            other += 1  # another convention: the numbers mean something else
            continue
        true = dict(zip((one.name for one in arm.unknowns), x.tolist(), strict=True))
        inside.append(float(np.mean([abs(value - true[name]) < half for name, (value, half) in found.errors.items()])))
    return {
        "cases": cases,
        "parameters": float(np.mean(inside)),
        "predictions": float(np.mean(predicted)),
        "other_convention": other,
    }


# ------------------------------------------------------------------------------------------------------------- sockets
def touches(robot, truth, rng, sockets, each):
    """Configurations that touch some sockets, their numbers and places; None where too few are found."""
    span = robot.upper - robot.lower
    low, high = np.maximum(robot.lower + 0.1 * span, -np.pi), np.minimum(robot.upper - 0.1 * span, np.pi)
    C = truth(rng.uniform(low, high, (400, robot.n)))[:, :3, 3]
    near = np.linalg.norm(C - C[0], axis=1)
    places = np.vstack([C[0], C[(near > 0.3) & (near < 0.8)][: sockets - 1]])
    Q, labels = [], []
    for k, place in enumerate(places):
        drawn = ik.solve_batch(
            robot, np.tile(place, (40 * each, 1)), restarts=0, q0=drawn_q(robot, rng, 40 * each), tolerance=1e-3
        )
        good = []
        for q in drawn.q[drawn.success]:
            for _ in range(8):  # Newton on the true arm
                J = np.array(
                    [(truth([q + 1e-6 * e])[0, :3, 3] - truth([q])[0, :3, 3]) / 1e-6 for e in np.eye(robot.n)]
                ).T
                q = q + np.linalg.pinv(J, rcond=1e-3) @ (place - truth([q])[0, :3, 3])
            if np.linalg.norm(truth([q])[0, :3, 3] - place) < 1e-8 and (np.abs(q) < 2 * np.pi).all():
                good.append(q)
            if len(good) == each:
                break
        if len(good) < each:
            return None
        Q += good
        labels += [k] * each
    return np.array(Q), np.array(labels), places


def aligned(X, Y):
    """X (N, 3) moved rigidly onto Y as well as it can be."""
    a, b = X - X.mean(0), Y - Y.mean(0)
    U, _, V = np.linalg.svd(a.T @ b)
    return a @ (U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V) + Y.mean(0)


def socket_rows(robot, seeds):
    """Errors in mm, 3-D root mean squares over the whole range, by number of sockets and what is known of them."""
    rows = []
    for seed in range(seeds):
        for count, known in ((2, "nothing"), (2, "distance"), (4, "distances"), (4, "places")):
            rng = np.random.default_rng(500 + seed)
            truth, H = Truth(robot, rng, 0.25), drawn_q(robot, rng, 400)
            made = touches(robot, truth, rng, count, 20)
            if made is None:
                continue
            Q, labels, places = made
            # A probe that sits off by a little: the joint values are those of a place beside the socket.
            J = [robot.jacobian(q)[:3] for q in Q]
            Q = Q + np.array([np.linalg.pinv(one, rcond=1e-2) @ rng.normal(0.0, TOUCH, 3) for one in J])
            pairs = {
                (a, b): float(np.linalg.norm(places[a] - places[b])) for a in range(count) for b in range(a + 1, count)
            }
            more = (
                {"distances": pairs}
                if known.startswith("distance")
                else {"places": places}
                if known == "places"
                else {}
            )
            found = ik.calibrate(robot, Q, labels, "socket", **more)
            p, t = found.predict(H)[0], truth(H)[:, :3, 3]
            rms = [1e3 * float(np.sqrt(((one - t) ** 2).sum(1).mean())) for one in (p, aligned(p, t))]
            drawn = np.array([robot.fk(q).translation for q in H])
            before = [1e3 * float(np.sqrt(((one - t) ** 2).sum(1).mean())) for one in (drawn, aligned(drawn, t))]
            rows.append(
                {
                    "seed": seed,
                    "sockets": count,
                    "known": known,
                    "absolute": rms[0],
                    "aligned": rms[1],
                    "before": before,
                    "rank": found.rank,
                }
            )
    return rows


def main():
    """Run all, print tables, write the data."""
    made = parser(__doc__, "benchmark_calibrate.json")
    made.add_argument("--seeds", type=int, default=20)
    made.add_argument("--cases", type=int, default=504, help="cases of coverage, of all robots and kinds together")
    made.add_argument("--part", choices=("instrument", "coverage", "sockets"), help="only one part")
    asked = made.parse_args()
    data = {"machine": machine()}
    robots = arms()
    tables = []
    if asked.part in (None, "instrument"):
        tables.append(instruments(robots, asked.seeds, data))
    if asked.part in (None, "coverage"):
        tables.append(intervals(robots, asked.cases // 6, data))
    if asked.part in (None, "sockets"):
        tables.append(probes(robots, asked.seeds, data))
    write(asked.output, data, *tables)


def instruments(robots, seeds, data):
    """Table of accuracy and outliers; its rows go into the data."""
    rows = []
    for name, robot in robots.items():
        for what, suggested in (("pose", False), ("position", False), ("position", True)):
            title = f"30 {what}s{', suggested' if suggested else ''}"
            some = data[f"{name}: {title}"] = instrument(robot, what, seeds, suggested)
            of = {key: np.array([row[key] for row in some], dtype=float) for key in some[0] if key != "fixed"}
            ratio = of["spoilt"].mean() / of["error"].mean()
            rank = f"{of['rank'].min():.0f}-{of['rank'].max():.0f} ({of['drawn'].min():.0f})"
            named = f"{of['named'].sum():.0f} ({of['exactly'].sum():.0f}) of {len(some)}"
            error = f"{of['error'].mean():.2f}, {of['error'].max():.2f}"
            cells = (
                f"{of['before_mm'].mean():.0f}",
                error,
                f"{100 * of['covered'].mean():.1f} %",
                f"{ratio:.2f}",
                named,
            )
            rows.append([name, title, rank, *cells, f"{np.median(of['seconds']):.2f}"])
            print(rows[-1], flush=True)
    head = ["robot", "measured", "rank (as drawn)", "mm before", "error / noise: mean, worst", "intervals cover"]
    return table([*head, "with outliers, times", "all named (and no other)", "s"], rows)


def intervals(robots, cases, data):
    """Table of the coverage of intervals."""
    rows = []
    for name, robot in robots.items():
        for what in ("pose", "position"):
            one = data[f"{name}: {what}, coverage"] = coverage(robot, what, cases)
            other = f"{one['other_convention']} of {one['cases']}"
            rows.append([name, what, f"{100 * one['parameters']:.1f} %", f"{100 * one['predictions']:.1f} %", other])
            print(rows[-1], flush=True)
    return table(["robot", "measured", "errors inside", "predictions inside", "other convention"], rows)


def probes(robots, seeds, data):
    """Table of the sockets."""
    rows = []
    for name, robot in robots.items():
        found = data[f"{name}: sockets"] = socket_rows(robot, seeds)
        for count, known in dict.fromkeys((row["sockets"], row["known"]) for row in found):
            some = [row for row in found if (row["sockets"], row["known"]) == (count, known)]
            a, b = (np.array([row[key] for row in some]) for key in ("absolute", "aligned"))
            before = np.mean([row["before"] for row in some], axis=0)
            cells = (
                f"{before[0]:.1f} ({before[1]:.1f})",
                f"{a.mean():.2f}, {a.max():.2f}",
                f"{b.mean():.2f}, {b.max():.2f}",
            )
            rows.append([name, f"{count} x 20, {known}", *cells, len(some)])
            print(rows[-1], flush=True)
    return table(
        ["robot", "sockets, known", "mm before (aligned)", "absolute: mean, worst", "aligned: mean, worst", "n"], rows
    )


if __name__ == "__main__":
    main()
