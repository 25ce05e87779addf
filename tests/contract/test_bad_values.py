"""Every public call, with each of its arrays replaced by something else: an error of ours or an answer, never a raw exception."""

from dataclasses import fields
from decimal import Decimal

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidOption
from ik_toolkit.solvers.options import Options

BAD = {
    "0-d": np.array(1.0),
    "0-d text": np.array("x"),
    "0-d object": np.array(None),
    "empty": np.array([]),
    "empty rows": np.empty((0, 3)),
    "empty poses": np.empty((0, 4, 4)),
    "text": "abc",
    "letters": ["a", "b", "c"],
    "bytes": b"abc",
    "number": 1.5,
    "bool": True,
    "dict": {},
    "dict of text": {"a": "b"},
    "dict of nothing": {"x": None},
    "objects": np.array([None, 1.0, {}], dtype=object),
    "object": object(),
    "NaN": np.full(3, np.nan),
    "NaN rows": np.full((2, 3), np.nan),
    "NaN pose": np.full((4, 4), np.nan),
    "infinite": np.full(2, np.inf),
    "complex": np.array([1j, 2.0, 3.0]),
    "dates": np.array(["2020-01-01"] * 3, dtype="datetime64"),
    "ragged": [[1.0], [1.0, 2.0]],
    "set": {1.0, 2.0},
    "None in a list": [None, None],
    "deep": np.ones((1, 1, 1, 1, 3)),
    "huge": np.full(3, 1e308),
    "type": float,
    "class": np.ndarray,
    "masked": np.ma.masked_array([1.0, 2.0, 3.0], mask=[1, 0, 0]),
    "generator": (k for k in ()),
    "huge int": 10**400,
    "structured": np.zeros(3, dtype=[("x", float)]),
    "nested dict": {"tip": {"tip": 1}},
    "slice": slice(1),
    "function": len,
    "complex number": np.complex128(1.0 + 1.0j),
    "Decimal": Decimal(1),
    "whole": 2.0,
    "pair of arrays": (np.zeros(2), np.ones(2)),
}


def arm():
    return robots.load("planar_2r")


def tracker():
    made = ik.Tracker(arm())
    made.update((1.0, 0.5, 0.0), 0.01)
    return made


def shapes():
    return ik.CollisionModel(arm())


P = (1.0, 0.5, 0.0)
SRDF = '<robot name="r"><group name="arm"><chain base_link="base_link" tip_link="tool"/></group></robot>'
CALLS = {
    "solve, target": lambda x: ik.solve(arm(), x),
    "solve, q0": lambda x: ik.solve(arm(), P, q0=x),
    "solve, mask": lambda x: ik.solve(arm(), P, "lm", mask=x),
    "solve, slack": lambda x: ik.solve(arm(), P, "lm", slack=x),
    "solve, weights": lambda x: ik.solve(arm(), P, "lm", joint_weights=x),
    "solve, hold": lambda x: ik.solve(arm(), P, "dls", hold=x),
    "solve, a matrix": lambda x: ik.solve(arm(), P, "state-space", A=x, B=np.ones((2, 3)), C=np.eye(2)),
    "Solver, target": lambda x: ik.Solver(arm())(x),
    "Solver, q0": lambda x: ik.Solver(arm())(P, x),
    "Solver.all": lambda x: ik.Solver(arm()).all(x),
    "Tree": lambda x: ik.solve(robots.load("two_arms"), x),
    "Tree, a tip": lambda x: ik.solve(robots.load("two_arms"), dict.fromkeys(robots.load("two_arms").tips, x)),
    "solve_batch, targets": lambda x: ik.solve_batch(arm(), x),
    "solve_batch, a list": lambda x: ik.solve_batch(arm(), [x, x]),
    "solve_batch, parts": lambda x: ik.solve_batch(arm(), iter([x])),
    "solve_batch, a tip": lambda x: ik.solve_batch(robots.load("two_arms"), dict.fromkeys(robots.load("two_arms").tips, x)),
    "solve_batch, q0": lambda x: ik.solve_batch(arm(), [P], q0=x),
    "solve_all": lambda x: ik.solve_all(arm(), x),
    "solve_all, q0": lambda x: ik.solve_all(arm(), P, q0=x),
    "solve_path": lambda x: ik.solve_path(arm(), x),
    "solve_path, a list": lambda x: ik.solve_path(arm(), [x, x]),
    "solve_path, q0": lambda x: ik.solve_path(arm(), [P, P], q0=x),
    "Tracker, q0": lambda x: ik.Tracker(arm(), q0=x),
    "Tracker, rate0": lambda x: ik.Tracker(arm(), rate0=x),
    "Tracker, accelerations": lambda x: ik.Tracker(arm(), acceleration_limits=x),
    "Tracker, posture": lambda x: ik.Tracker(arm(), posture=x),
    "Tracker, elbow": lambda x: ik.Tracker(arm(), elbow=x),
    "Tracker, limits": lambda x: tracker().change_limits(speed=x),
    "Tracker.reset": lambda x: tracker().reset(x),
    "update, target": lambda x: tracker().update(x, 0.01),
    "update, first target": lambda x: ik.Tracker(arm()).update(x, 0.01),
    "update, dt": lambda x: tracker().update(P, x),
    "update, twist": lambda x: tracker().update(P, 0.01, twist=x),
    "update, acceleration": lambda x: tracker().update(P, 0.01, acceleration=x),
    "update, q": lambda x: tracker().update(P, 0.01, q=x),
    "track": lambda x: ik.track(arm(), x),
    "track, q0": lambda x: ik.track(arm(), ik.line((1.2, 0.3, 0), (1.3, 0.4, 0), duration=0.1), q0=x),
    "fk": lambda x: arm().fk(x),
    "check_q": lambda x: arm().check_q(x),
    "errors": lambda x: arm().errors(arm().home, x),
    "with_tool": lambda x: arm().with_tool(x),
    "locked": lambda x: arm().locked(x),
    "pose, xyz": lambda x: ik.pose(xyz=x),
    "pose, rpy": lambda x: ik.pose(xyz=P, rpy=x),
    "pose, quat": lambda x: ik.pose(xyz=P, quat_xyzw=x),
    "line": lambda x: ik.line(x, P, duration=1.0),
    "circle": lambda x: ik.circle(x),
    "circle, normal": lambda x: ik.circle(P, normal=x),
    "lissajous": lambda x: ik.lissajous(P, x),
    "waypoints": lambda x: ik.waypoints(x, duration=1.0),
    "waypoints, a list": lambda x: ik.waypoints([x, P], duration=1.0),
    "waypoints, times": lambda x: ik.waypoints([P, (0, 0, 0)], times=x),
    "Reference.at": lambda x: ik.circle(P).at(x),
    "collides": lambda x: shapes().collides(x),
    "distance": lambda x: shapes().distance(x),
    "add_box": lambda x: shapes().add_box(x, P),
    "add_sphere, where": lambda x: shapes().add_sphere(0.1, x),
    "Shape": lambda x: ik.Shape.box(x),
    "check_gains": lambda x: ik.check_gains("cv", x),
    "least_rate": lambda x: ik.least_rate(arm(), ik.circle(center=(1.0, 0.6, 0.0)), "cv", kappa=x),
    "least_rate, gamma": lambda x: ik.least_rate(arm(), ik.circle(center=(1.0, 0.6, 0.0)), "aad", gamma=x),
    "stability_chart, gain": lambda x: ik.stability_chart(arm(), ik.circle(center=(1.0, 0.6, 0.0)), gain=x, samples=[9]),
    "stability_chart, samples": lambda x: ik.stability_chart(arm(), ik.circle(center=(1.0, 0.6, 0.0)), gain=[0.5], samples=x),
    "best_gains": lambda x: ik.best_gains("cv", x),
    "load, group": lambda x: ik.Robot.load("planar_2r", srdf=SRDF, group=x),
}  # fmt: skip
TAKE_OPTIONS = {
    "solve": lambda given: ik.solve(arm(), P, "lm", **given),
    "solve, auto": lambda given: ik.solve(robots.load("hydrolek_7w"), P, **given),
    "solve_batch": lambda given: ik.solve_batch(arm(), [P], "lm", **given),
    "solve_all": lambda given: ik.solve_all(arm(), P, "lm", starts=3, **given),
    "solve_path": lambda given: ik.solve_path(arm(), [P], **given),
    "Tracker": lambda given: ik.Tracker(arm(), **given).update(P, 0.01),
}
OPTIONS = [*(option.name for option in fields(Options)), "damping", "kappa"]
CALLS |= {
    f"{call}({name}=)": lambda x, f=f, name=name: f({name: x}) for call, f in TAKE_OPTIONS.items() for name in OPTIONS
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", CALLS)
def test_what_is_no_such_array_is_refused_by_name(name):
    for kind, bad in BAD.items():
        try:
            CALLS[name](bad)
        except IKError as error:
            assert str(error), kind
        except Exception as error:
            raise AssertionError(f"{name} of {kind}: {error!r}") from error


@pytest.mark.parametrize(
    "solver", [ik.LM(damping=0.1 + 1j), ik.StateSpace(A=np.eye(2) * 1j, B=np.ones((2, 3)), C=np.eye(2))]
)
def test_a_complex_parameter_is_refused(solver):
    with pytest.raises(InvalidOption, match="must be finite numbers"):
        ik.solve(arm(), P, solver)
