"""Inverse kinematics for any robot description: solve targets, follow paths, track, tune and compare solvers, view robots.

A public name is imported when it is first used, so that importing the package takes almost no time.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

_NAMES = {
    "Robot": "robot.robot",
    "Tree": "robot.tree",
    "MotorMap": "robot.motors",
    "approach": "robot.pose",
    "pose": "robot.pose",
    "solve": "solvers.solve",
    "Solver": "solvers.solve",
    "solve_batch": "solvers.batch.solve_batch",
    "solve_path": "paths.solve_path",
    "PathInterrupted": "paths.solve_path",
    "BatchCheckFailed": "solvers.batch.result",
    "BatchInterrupted": "solvers.batch.result",
    "TrackInterrupted": "servo.run",
    "ReachabilityInterrupted": "study.reachability",
    "MapNotSaved": "study.reachability",
    "PlaceInterrupted": "study.place",
    "WorkspaceInterrupted": "study.workspace",
    "BenchmarkInterrupted": "study.benchmark",
    "CollisionModel": "robot.geometry.collision",
    "Shape": "robot.geometry.shape",
    "Result": "solvers.result",
    "Status": "solvers.status",
    "rule": "solvers.protocol",
    "closed_form": "solvers.protocol",
    "LM": "solvers.rules.jacobian",
    "DLS": "solvers.rules.jacobian",
    "Pinv": "solvers.rules.jacobian",
    "Transpose": "solvers.rules.jacobian",
    "Newton": "solvers.rules.jacobian",
    "CCD": "solvers.rules.ccd",
    "PID": "solvers.rules.pid",
    "StateSpace": "solvers.rules.state_space",
    "Planar2R": "solvers.closed_form.planar_2r",
    "Inspection": "solvers.closed_form.inspection",
    "solve_all": "solvers.solve",
    "prepare": "solvers.prepare",
    "benchmark": "study.benchmark",
    "track": "servo.run",
    "Tracker": "servo.tracker",
    "StepStatus": "servo.step",
    "TrackResult": "servo.result",
    "PathResult": "paths.result",
    "PathStatus": "paths.result",
    "Trajectory": "motion.trajectory",
    "Reference": "motion.reference",
    "Teleop": "motion.teleop",
    "line": "motion.shapes",
    "circle": "motion.shapes",
    "lissajous": "motion.shapes",
    "waypoints": "motion.waypoints",
    "reference_from_file": "motion.waypoints",
    "place": "study.place",
    "reachability": "study.reachability",
    "ReachabilityMap": "study.reachability_map",
    "tune": "study.tune",
    "workspace": "study.workspace",
    "analyse": "study.analyse",
    "gain_margins": "study.analyse",
    "newton_certificate": "study.newton_certificate",
    "calibrate": "study.calibrate",
    "Calibration": "study.calibration",
    "suggest_poses": "study.suggest_poses",
    "best_gains": "servo.stability",
    "check_gains": "servo.stability",
    "least_rate": "servo.path_stability",
    "stability_chart": "servo.path_stability",
    "view": "show.scene",
    "interact": "show.interact",
    "plot": "show.plot",
    "Interrupted": "errors",
    "IKError": "errors",
    "NotSolved": "errors",
}
__all__ = sorted([*_NAMES, "__version__"])


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _NAMES:
        raise AttributeError(f"module 'ik_toolkit' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"ik_toolkit.{_NAMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, for completion in an editor or a shell."""
    return __all__
