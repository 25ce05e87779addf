"""Everything a person can hold is copied and pickled rightly, or refuses with an error of ours; the original is left as it was."""

import copy
import importlib
import inspect
import multiprocessing
import pickle
import pkgutil
from enum import Enum
from typing import NamedTuple

import numpy as np
import pytest
import robots

import ik_toolkit as ik
from ik_toolkit.errors import IKError, InvalidOption, Portable
from ik_toolkit.robot.formats.dh import read_dh_table
from ik_toolkit.robot.library import find

WAYS = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda thing: pickle.loads(pickle.dumps(thing))}
AT = np.array([0.9, 0.1, 0.2])
ROUND = ik.circle(center=(1.0, 0.6, 0.0), radius=0.35)
RULES = ("LM", "DLS", "Pinv", "Transpose", "Newton", "CCD", "PID", "StateSpace", "Planar2R", "Inspection")


def hydrolek():
    return robots.load("hydrolek_7w")


def planar():
    return robots.load("planar_2r")


def world():
    return ik.CollisionModel(planar()).add_sphere(0.1, (1.2, 0.9, 0.0), name="ball")


def solved():
    return ik.solve(hydrolek(), AT)


def unsolved():
    return ik.NotSolved(ik.solve(hydrolek(), (9.0, 9.0, 9.0)))


def batch():
    return ik.solve_batch(planar(), np.array([[1.0, 1.0, 0.0], [1.2, 0.3, 0.0]]), check=0.0)


def mapped():
    return ik.reachability(planar(), resolution=0.5)


def path():
    arm = planar()
    return ik.solve_path(arm, [arm.fk(q).translation for q in np.linspace((0.2, 0.5), (0.6, 0.9), 5)])


def run():
    return ik.track(planar(), ik.line((1.2, 0.3, 0.0), (1.3, 0.4, 0.0), duration=0.2))


def calibrated():
    arm = planar()
    Q = arm.random_q(np.random.default_rng(0), 12)
    return ik.calibrate(arm, Q, [arm.fk(q).translation for q in Q], parameters="joints", noise=1e-4)


def facts_of(result):
    return result.status, result.q, result.message


def facts_of_step(step):
    return step.q, step.rate, step.status, step.reason


def doubled(t):
    return ik.line((1.0, 0.0, 0.0), (1.0, 0.2, 0.0), duration=1.0).at(t)


def held(hands):
    """A target that a hand has moved."""
    hands.update(np.eye(4), True, 0.01)
    hands.update(np.eye(4) + 0.01 * np.eye(4, k=3), True, 0.01)
    return hands


# What is made of each public class, and what it does next: numbers, names and sentences that are compared.
HELD = {
    "Robot": (hydrolek, lambda arm: (arm.fk(arm.home).homogeneous, arm.joint_names, ik.solve(arm, AT).q)),
    "Tree": (lambda: robots.load("two_arms"), lambda tree: [tree.fk(tree.home)[tip].homogeneous for tip in tree.tips]),
    "Solver": (lambda: ik.Solver(hydrolek()), lambda solver: [solver(AT).q, solver(AT, solver.robot.home).message]),
    "CollisionModel": (world, lambda model: (model.collisions((0.6, 0.1)), model.distance((0.2, 0.5)).distance)),
    "MotorMap": (
        lambda: ik.MotorMap(hydrolek(), sign={hydrolek().joint_names[1]: -1}, degrees=True),
        lambda motors: (motors.to_q(np.arange(6.0)), motors.to_motors(np.arange(6.0))),
    ),
    "Teleop": (lambda: held(ik.Teleop(hydrolek().fk(hydrolek().home))), lambda hands: hands.update(np.eye(4), False, 0.01)),
    "Shape": (lambda: ik.Shape.box((0.1, 0.2, 0.3)), repr),
    "Result": (solved, facts_of),
    **dict.fromkeys(("Status", "PathStatus", "StepStatus")),  # see the end
    "TrackResult": (run, facts_of),
    "PathResult": (path, facts_of),
    "Trajectory": (lambda: path().retime(acceleration=2.0), lambda one: (one.t, one.q, one.at(0.1), one.to_reference().at(0.1))),
    "Reference": (lambda: ik.circle((1.0, 0.5, 0.0), 0.2, normal=(0, 0, 1)), lambda one: one.at(np.linspace(0, 10, 5))),
    "IKError": (lambda: IKError("what is wrong"), str),
    "Interrupted": (lambda: ik.Interrupted(run()), lambda stop: (str(stop), *facts_of(stop.result))),
    "NotSolved": (unsolved, lambda error: (str(error), *facts_of(error.result))),
    "PathInterrupted": (lambda: ik.PathInterrupted(path()), lambda stop: (str(stop), *facts_of(stop.result))),
    "BatchInterrupted": (lambda: ik.BatchInterrupted(batch(), "after 2 targets"), lambda stop: (str(stop), stop.result.q)),
    "TrackInterrupted": (lambda: ik.TrackInterrupted(run()), lambda stop: (str(stop), *facts_of(stop.result))),
    "ReachabilityInterrupted": (lambda: ik.ReachabilityInterrupted(mapped(), "early"), lambda stop: (str(stop), stop.result.q)),
    "MapNotSaved": (lambda: ik.MapNotSaved(mapped(), OSError(28, "No space", "map.npz")), lambda stop: (str(stop), stop.result.q)),
    "PlaceInterrupted": (
        lambda: ik.PlaceInterrupted(ik.place(planar(), [(1.0, 1.0, 0.0)], ((0, 0), (0.1, 0.1)), count=1), "early"),
        lambda stop: (str(stop), stop.result[0].q, stop.result.shares),
    ),
    "WorkspaceInterrupted": (
        lambda: ik.WorkspaceInterrupted(ik.workspace(planar(), "planar-2r", targets=20), "early"),
        lambda stop: (str(stop), stop.result.to_dict()),
    ),
    "BenchmarkInterrupted": (
        lambda: ik.BenchmarkInterrupted(ik.benchmark("planar_2r", "planar-2r", targets=4), "early"),
        lambda stop: (str(stop), [(row.solver, row.solved, row.median) for row in stop.result.rows]),
    ),
    "BatchCheckFailed": (lambda: ik.BatchCheckFailed(batch(), 1, 0), lambda bad: (str(bad), bad.target, bad.before, bad.result.q)),
    "Tracker": None,  # see below
    **{name: (lambda name=name: getattr(ik, name)(), lambda rule: rule) for name in RULES},
    # Not public by name, but returned:
    "BatchResult": (batch, lambda made: (made.q, made.counts(), made[1].message)),
    "Solutions": (lambda: ik.solve_all(planar(), (1.0, 1.0, 0.0)), lambda made: (made.q, made.message, made.complete)),
    "DHTable": (lambda: read_dh_table(find("hydrolek_7w").dh_file), repr),
    "Step": (lambda: moving(hydrolek()).update(poses(hydrolek())[30], 0.05), facts_of_step),
    "spline": (lambda: ik.waypoints([(1, 0, 0), (1, 1, 0), (0, 1, 0)], times=(0, 1, 2), law="spline"), lambda one: one.at(0.3)),
    "legs": (lambda: ik.waypoints([(1, 0, 0), (1, 1, 0)], duration=2), lambda one: one.at(0.3)),
    "lissajous": (lambda: ik.lissajous((1, 0, 0)), lambda one: one.at(0.3)),
    "there and back": (lambda: ik.line((1, 0, 0), (1, 1, 0), duration=2, rounds=2), lambda one: one.at(0.3)),
    "custom": (lambda: ik.Reference(doubled, 1.0), lambda one: one.at(0.3)),
    "solver of a rule": (lambda: ik.Solver(hydrolek(), ik.DLS(damping=0.2)), lambda solver: solver(AT, solver.robot.home).q),
    "Benchmark": (
        lambda: ik.benchmark("planar_2r", "planar-2r", targets=4),
        lambda made: [(row.solver, row.solved, row.median) for row in made.rows],
    ),
    "Calibration": (calibrated, lambda made: (made.to_dict(), made.predict([[0.2, 0.3]]), made.robot.fk((0.2, 0.3)).homogeneous)),
    "Workspace": (lambda: ik.workspace(planar(), "planar-2r", targets=20), lambda made: made.to_dict()),
    "ReachabilityMap": (mapped, lambda made: (made.states, made.q, made.contains([[1.0, 1.0, 0.0]]), str(made.audit))),
    "GainCheck": (lambda: ik.check_gains("cv", 0.01, kappa=20.0), repr),
    "LeastRate": (lambda: ik.least_rate(planar(), ROUND, most=3.0), repr),
    "StabilityChart": (lambda: ik.stability_chart(planar(), ROUND, gain=[0.5], samples=[9]), repr),
}  # fmt: skip


def same(one, other):
    """Whether two answers agree: numbers to the last bit or nearly, everything else exactly."""
    if isinstance(one, np.ndarray | float):
        return np.allclose(one, other, rtol=0.0, atol=1e-9, equal_nan=True)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return type(one) is type(other) and one == other


@pytest.mark.parametrize("name", [name for name in ik.__all__ if inspect.isclass(getattr(ik, name))])
def test_every_public_class_is_looked_at(name):
    assert name in HELD, f"{name} is public: say in HELD how one is made, and what it does"


@pytest.mark.parametrize("name", [name for name, how in HELD.items() if how])
def test_a_copy_does_what_the_original_does(name):
    make, act = HELD[name]
    thing = make()
    before = act(thing)
    for way, duplicate in WAYS.items():
        assert same(act(duplicate(thing)), before), way
    assert same(act(thing), before)


# -------------------------------------------------------------------------------------------------------------- trackers
def moving(robot, steps=20, **options):
    """A tracker in the middle of a motion."""
    tracker = ik.Tracker(robot, q0=robot.home, **options)
    for T in poses(robot)[:steps]:
        tracker.update(T, 0.05)
    return tracker


def poses(robot):
    return [robot.fk(q) for q in np.linspace(robot.home, ik.solve(robot, AT).q, 60)]


def on_the_way(robot):
    """Something the tip would run into."""
    return ik.CollisionModel(robot).add_sphere(0.05, poses(robot)[45].translation, name="ball")


TRACKERS = {
    "cv": {},
    "aad": {"method": "aad", "acceleration_limits": 5.0},
    "a solver": {"method": "dls"},
    "beside the task": {"posture": np.zeros(6), "manipulability": 0.1},
    "a cost": {"cost": np.sum},
    "an obstacle": {"avoid_collisions": on_the_way, "acceleration_limits": 5.0},
    "an obstacle, ca": {"avoid_collisions": on_the_way, "acceleration_limits": 5.0, "method": "ca"},
}


@pytest.mark.parametrize("name", TRACKERS)
def test_a_copied_tracker_goes_on_by_itself(name):
    robot, options = hydrolek(), dict(TRACKERS[name])
    if callable(options.get("avoid_collisions")):
        options["avoid_collisions"] = options["avoid_collisions"](robot)
    original = moving(robot, **options)
    copies = {way: duplicate(original) for way, duplicate in WAYS.items()}
    rest = poses(robot)[20:]

    def go_on(tracker):
        return [facts_of_step(tracker.update(T, 0.05)) for T in rest]

    copies["again"] = copy.deepcopy(copies["pickle"])
    gone = {way: go_on(tracker) for way, tracker in copies.items()}
    there = original.q
    expected = go_on(original)  # after the copies: they have not moved it
    assert same(there, moving(robot, **options).q)
    for way, steps in gone.items():
        assert same(steps, expected), way
    if "avoid_collisions" not in options:
        assert np.linalg.norm(robot.fk(original.q).translation - rest[-1].translation) < 1e-3


def test_limits_changed_in_a_copy_are_its_own():
    original = moving(hydrolek())
    copied = copy.copy(original)
    copied.change_limits(speed=1e-3)
    copied.reset()
    one, other = (tracker.update(poses(hydrolek())[30], 0.05) for tracker in (original, copied))
    assert np.abs(one.rate).max() > 0.1 > 2e-3 > np.abs(other.rate).max()
    assert copied.robot is original.robot and copy.deepcopy(original).robot is not original.robot


def test_another_process_goes_on_with_a_tracker_and_passes_an_error_on():
    tracker, targets = moving(hydrolek()), poses(hydrolek())[20:]
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        there = pool.apply(follow, (tracker, [T.homogeneous for T in targets]))
        with pytest.raises(ik.NotSolved, match="UNREACHABLE") as caught:
            pool.map_async(fail, [(9.0, 9.0, 0.0)]).get(timeout=100)
    assert same(there, follow(tracker, [T.homogeneous for T in targets]))
    assert caught.value.result.status.name == "UNREACHABLE"


def follow(tracker, targets):
    return [tracker.update(T, 0.05).q for T in targets][-1]


def test_what_another_process_would_not_find_is_refused_by_name():
    @ik.rule
    class Local(NamedTuple):
        gain: float = 0.1

        def step(self, p, e):
            return 0

    for thing, what in (
        (ik.Solver(planar(), Local), "the rule of"),
        (ik.Reference(lambda t: t, 1.0), "the function of this reference"),
        (moving(hydrolek(), 1, cost=lambda q: float(q @ q)), "the cost"),
    ):
        copy.deepcopy(thing)
        with pytest.raises(InvalidOption, match=f"{what}.*cannot be pickled"):
            pickle.dumps(thing)


@pytest.mark.parametrize("way", WAYS)
def test_what_belongs_to_a_window_is_refused(way):
    scene = ik.view(planar())
    with pytest.raises(InvalidOption, match="a Scene cannot be copied or pickled"):
        WAYS[way](scene)


# ------------------------------------------------------------------------------------------------------------ exceptions
def exceptions():
    """Every exception of the package."""
    for module in pkgutil.walk_packages(ik.__path__, "ik_toolkit."):
        if not module.name.endswith(("_worker", "__main__")):
            importlib.import_module(module.name)
    found, new = set(), {Portable}
    while new:
        found |= new
        new = {below for one in new for below in one.__subclasses__()} - found
    ours = [one for one in found - {Portable} if one.__module__.startswith("ik_toolkit")]
    return sorted(ours, key=lambda one: one.__name__)


def test_every_exception_of_ours_crosses_processes():
    """Whatever its constructor takes: as it would be after it was raised."""
    every = exceptions()
    assert {IKError, ik.NotSolved, ik.PathInterrupted, ik.BatchCheckFailed} < set(every) and len(every) > 18
    for kind in every:
        error = kind.__new__(kind)
        error.args = ("what is wrong", 2)
        error.tips, error.result, error.extra = ("a", "b"), {"q": 1.0}, "plots"
        error.add_note("a note")
        for way, duplicate in WAYS.items():
            again = duplicate(error)
            assert type(again) is kind and again.args == error.args and vars(again) == vars(error), (kind, way)
            assert str(again) == str(error)


def fail(position):
    return ik.solve(planar(), position).raise_for_status()


def test_enums_stay_what_they_are():
    for name in ("Status", "PathStatus", "StepStatus"):
        for one in getattr(ik, name):
            assert isinstance(one, Enum) and all(duplicate(one) is one for duplicate in WAYS.values())
