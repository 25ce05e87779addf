"""What this project set out to reach, beside what was measured."""

from typing import Any

import common
from kernel import UNREACHABLE


def mark(met: bool) -> str:
    """Whether an aim is met, as a table shows it."""
    return "yes" if met else "**no**"


def aims(found: dict[str, dict[str, Any]]) -> list[list[str]]:
    """Rows (aim, measured, met) of what this project set out to reach."""
    rows = []
    if "success" in found:
        for r in found["success"]["rows"]:
            share = r["solved"] / r["targets"]
            rows.append(
                [f"{r['robot']}: 99.99 % of {r['targets']:,} targets", common.percent(r), mark(share >= 0.9999)]
            )
        big = found["success"].get("million")
        if big:
            wrong = big["pinocchio"]["not_confirmed"]
            text = f"{big['solved']:,} of {big['targets']:,}; {wrong} of {big['pinocchio']['checked']:,} not confirmed"
            rows.append(["1,000,000 Panda targets, 1 % checked by Pinocchio", text, mark(not wrong)])
            left = big["again"]
            text = f"{left['targets']} fail; with {left['restarts']} restarts {left['solved']} of them are solved"
            rows.append(["no failure among them left unexplained", text, mark(left["solved"] == left["targets"])])
            growth = big["peak_at_end"] - big["peak_at_quarter"]
            rows.append(["the same from an iterator: memory flat", f"{growth / 1e6:+.1f} MB", mark(growth < 50e6)])
    if "solve" in found:
        runs = {(r["robot"], r["start"], r["tolerance"]): r["rows"] for r in found["solve"]["runs"]}
        for robot, least, tail in (("panda", 12, 20), ("ur5", 6, None), ("kinova", 6, None)):
            rows += faster(runs.get((robot, "random", "strict"), {}), robot, least, tail)
        strict = runs.get(("ur5", "random", "strict"), {})
        if {"ik", "eaik"} <= strict.keys():
            for key in ("median", "mean"):
                ours, theirs = strict["ik"]["wall"][key], strict["eaik"]["wall"][key]
                text = f"{ours:.2f} us against {theirs:.2f} us"
                rows.append([f"ur5: {key} faster than EAIK (its all answers)", text, mark(ours < theirs)])
        for (robot, start, tolerance), run in runs.items():
            if start == "near" and tolerance == "strict" and {"ik", "cartan"} <= run.keys():
                ours, theirs = run["ik"]["wall"]["median"], run["cartan"]["wall"]["median"]
                text = f"{ours:.2f} us; cartan {theirs:.2f} us"
                rows.append(
                    [
                        f"{robot}: near start, median at most 5 us, faster than cartan",
                        text,
                        mark(ours <= 5 and ours < theirs),
                    ]
                )
        worst = max(
            (
                (run["ik.solve"]["wall"]["median"], key[0])
                for key, run in runs.items()
                if "ik.solve" in run and key[1] == "random"
            ),
            default=None,
        )
        if worst:
            text = f"{worst[0]:.1f} us ({worst[1]}, the slowest)"
            rows.append(["`ik.solve` with everything on, median at most 25 us", text, mark(worst[0] <= 25)])
    if "batch" in found:
        for r in found["batch"]["rows"]:
            if r["targets"] == 100_000 and r["threads"] == 2:
                text = f"{r['per_second']:,.0f} a second, best run {r['best_per_second']:,.0f}"
                for aim in (400_000, 1_000_000):
                    name = f"{r['robot']}: batch of 100,000 on 2 cores, {aim:,} a second"
                    rows.append([name, text, mark(r["per_second"] >= aim)])
        most = max(r["memory"] for r in found["batch"]["rows"]) / 1e6
        rows.append(["memory of a batch beyond input and output, under 50 MB", f"{most:.1f} MB", mark(most < 50)])
    if "kernel" in found:
        most = max(found["kernel"]["median_ns"][UNREACHABLE].values()) / 1e3
        rows.append(
            ["target proven out of reach, answered in 200 us", f"{most:.0f} us (slowest robot)", mark(most <= 200)]
        )
    return rows


def faster(run: dict[str, Any], robot: str, least: float, tail: float | None) -> list[list[str]]:
    """Rows of the comparison with the Robotics Toolbox, by the clock and by processor time."""
    if "faster" not in run.get("ik", {}) or "rtb" not in run:
        return []
    rows = []
    for key, name, bound in (("median", "median", least), ("p99", "99th percentile", tail)):
        if bound is None:
            continue
        wall, processor = (run["ik"]["faster"][clock][key] for clock in ("wall", "processor"))
        text = f"{wall:.1f} times ({run['ik']['wall'][key]:.1f} against {run['rtb']['wall'][key]:.0f} us)"
        text += f"; processor time {processor:.1f} times"
        rows.append([f"{robot}: {name} {bound} times faster than `ik_LM(k=0.1)`", text, mark(wall >= bound)])
    return rows
