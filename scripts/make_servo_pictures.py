"""Make the pictures of the guide's page on tracking within limits: one joint's phase plane, and the scenarios.

Run: python scripts/make_servo_pictures.py [box] [scenarios]   (needs the extra plots). The streams are those of
scripts/benchmarks/servo.py; the best achievable is an independent search, see servo_best.py.
"""

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "benchmarks"))

from servo_best import best, errors  # noqa: E402
from servo_scenarios import DT, MAKERS, Scenario, make  # noqa: E402
from servo_worker import Ours  # noqa: E402
from servo_worker import follow as drive  # noqa: E402

import ik_toolkit as ik  # noqa: E402
from ik_toolkit.show.plots import FLOOR, drawing, save  # noqa: E402
from ik_toolkit.style import COLOURS, GREY, PALE  # noqa: E402

FOLDER = HERE.parent / "docs" / "_static"
ROBOT = "hydrolek_7w"
JOINT = """<robot name="lever"><link name="base"/><link name="hand"/><joint name="lever" type="revolute"><parent link="base"/>
<child link="hand"/><origin xyz="0 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1.5" effort="1"/></joint>
<link name="tip"/><joint name="end" type="fixed"><parent link="hand"/><child link="tip"/><origin xyz="1 0 0"/></joint></robot>"""
ACCELERATION = 2.0  # rad/s^2 of the lever


def box() -> None:
    """One joint pushed towards its limit from several positions: speed over position, and the range the limits allow."""
    robot = ik.Robot.load(JOINT, tip="tip")
    speed, edge = float(robot.velocity_limits[0]), float(robot.upper[0])
    with drawing() as plt:
        figure, ax = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
        q = np.linspace(-edge, edge, 400)
        top = np.minimum(np.sqrt(2.0 * ACCELERATION * (edge - q)), speed)
        ax.fill_between(q, -top[::-1], top, color=PALE, lw=0, label="the joint can still brake in time")
        ax.plot(q, top, color=GREY, lw=1.0)
        ax.plot(q, -top[::-1], color=GREY, lw=1.0)
        for k, start in enumerate((-0.9, -0.4, 0.1, 0.6)):
            tracker = ik.Tracker(robot, q0=[start], rate0=[0.0], acceleration_limits=ACCELERATION, on_limit="leave")
            beyond = robot.fk([edge + 0.5]).translation
            steps = [tracker.update(beyond, DT) for _ in range(200)]
            place = [start, *(float(step.q[0]) for step in steps)]
            rate = [0.0, *(float(step.rate[0]) for step in steps)]
            label = "tracker, pulled past the limit" if k == 0 else ""
            ax.plot(place, rate, color=COLOURS[0], lw=1.6, label=label)
            ax.plot(place[:1], rate[:1], color=COLOURS[0], marker="o", ms=4)
        ax.axvline(edge, color=COLOURS[1], lw=1.2, label="position limit")
        ax.axhline(speed, color=COLOURS[1], lw=1.2, ls="--", label="speed limit")
        ax.set(xlabel="joint position [rad]", ylabel="joint speed [rad/s]", xlim=(-1.05, 1.08), ylim=(-0.35, 1.75))
        figure.legend(fontsize=8, loc="outside lower center", ncols=4)
        print(save(figure, FOLDER / "servo_box.png"))


def follow(s: Scenario) -> np.ndarray:
    """Commands (N + 1, n) of our tracker."""
    joint, at = s.lock or (0, -1)
    stream: dict[str, Any] = {
        "robot": ROBOT, "tips": list(s.robot.tips), "joints": list(s.robot.joint_names), "dt": DT, "delay": s.delay,
        "measured": s.measured, "noise": s.noise, "posture": s.posture, "obstacles": s.obstacles, "method": "cv", "seed": s.seed,
        "lock_joint": joint, "lock_at": at, "q0": s.q0, "acceleration": s.acceleration,
    }  # fmt: skip
    stream_of = SimpleNamespace(**stream)
    return drive(Ours(stream_of), stream_of, s.targets)[0]


def scenarios() -> None:
    """Tip error over time in each scenario, and the smallest error any method could achieve."""
    robot = ik.Robot.load(ROBOT)
    with drawing() as plt:
        figure, axes = plt.subplots(4, 3, figsize=(10.5, 9.0), layout="constrained")
        for ax, name in zip(axes.flat, MAKERS, strict=False):
            s = make(name, robot, 0)
            Q = follow(s)
            t = DT * np.arange(1, len(Q))
            if not s.lock:
                ideal = best(robot, s.targets, s.q0, robot.lower, robot.upper)[1:]
                least = 1e3 * np.linalg.norm(errors(robot, ideal, s.targets), axis=1)
                ax.semilogy(t, np.maximum(least, 1e3 * FLOOR), color=GREY, lw=3.0, label="best achievable")
            left = 1e3 * np.linalg.norm(errors(robot, Q[1:], s.targets), axis=1)
            ax.semilogy(t, np.maximum(left, 1e3 * FLOOR), color=COLOURS[0], lw=1.1, label="tracker")
            ax.set_title(s.name, loc="left", fontsize=9)
            ax.set_ylim(1e-6, 2e3)
            ax.margins(x=0.0)
        for ax in axes[:, 0]:
            ax.set_ylabel("error [mm]")
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        handles, labels = axes.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=2)
        print(save(figure, FOLDER / "servo_scenarios.png"))


if __name__ == "__main__":
    for picture in sys.argv[1:] or ("box", "scenarios"):
        {"box": box, "scenarios": scenarios}[picture]()
