"""A robot whose target is dragged in a notebook while solvers follow it, with the curves of their errors."""

from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..robot.robot import Robot
from ..robot.tree import Tree
from ..solvers.result import Result
from ..solvers.solve import Solver, require_robot
from ..text import duration, how_many, length
from .animation import GHOSTS, SLATE, thin_rows
from .plots import iterates
from .scene import Scene, view
from .scene_state import css


class Interaction:
    """One or several solvers that solve again whenever the target of a live scene is dragged, each from its last solution.

    results: the last Result of each, by label.
    """

    def __init__(self, scene: Scene, solvers: dict[str, Solver], target: Any, q0: np.ndarray) -> None:
        """Solve once for the first target, and then whenever the target is dragged."""
        self.scene, self.solvers, self.q0 = scene, solvers, q0
        self.results: dict[str, Result] = {}
        for one in solvers.values():
            # a first call that compiles, so that the displayed time of later calls does not include compiling
            one(target, q0)
        self.follow(target)
        scene.on_drag(self.follow)
        eye, to = np.array(scene.window.about["camera"][:2])
        # The camera moves back, so that there is room to drag the target.
        scene.look((to + 1.5 * (eye - to)).tolist(), to.tolist())

    def follow(self, target: Any) -> None:
        """Solve for a target, and show the answers: the first solver's as the robot, the others' as translucent copies."""
        for label, solver in self.solvers.items():
            last = self.results.get(label)
            self.results[label] = solver(target, self.q0 if last is None else last.q)
        (_, first), *others = self.results.items()
        with self.scene.window.lock:
            self.scene.update(first.q, target)
            for (label, result), color in zip(others, GHOSTS, strict=False):
                self.scene.show(result.q, f"with_{label}", color, 0.35, label)
            self.scene.say(*([f"the robot goes with {next(iter(self.results))}"] if others else []))
            curves = zip(self.results.items(), (SLATE, *GHOSTS), strict=False)
            self.scene.window.say(curves=[_curve(label, result, css(color)) for (label, result), color in curves])

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, str]:
        """Return the outputs that a notebook cell displays: scene, curves and text."""
        return self.scene._repr_mimebundle_(include, exclude)


def interact(
    robot: Robot | Tree, solver: Any = "auto", *, target: Any = None, q0: Any = None, **options: Any
) -> Interaction:
    """Show a robot with a target to drag in a cell of a notebook: one or several solvers follow it, and curves show their errors.

    Drag the ball in the plane of the picture, the end of an arrow along it, and with the shift key the end of an arrow to turn
    the target. Each solver starts from its last solution. The first solver moves the robot, the others move translucent copies.
    Without a connection to a notebook kernel (a file, a saved notebook) the first solutions are shown.

    Args:
        robot: The Robot or Tree.
        solver: Name, class or instance of a solver, or a list of them.
        target: The first target, as for `solve`; its form says whether orientation counts. By default a pose, and a position for
            an arm of fewer than six joints.
        q0: Configuration (n,) [rad or m] in which all solvers start; by default home.
        **options: Options of the solvers, as for `solve`.

    Returns:
        An object that a notebook cell displays; `.results` are the last results by solver, `.scene` is the Scene.

    Raises:
        UnknownSolver, InvalidOption, InvalidTarget, InvalidConfiguration: An argument is wrong.
        MissingExtra: meshcat or trimesh is not installed.
    """
    require_robot(robot)
    asked = list(solver) if isinstance(solver, list | tuple) else [solver]
    if not 0 < len(asked) <= len(GHOSTS) or None in asked:
        raise InvalidOption(
            f"interact takes a solver (name, class or instance), or a list of up to {len(GHOSTS)}, not {solver!r:.60}"
        )
    q = robot.home if q0 is None else robot.check_q(q0)
    solvers: dict[str, Solver] = {}
    options["history"] = True
    for one in asked:
        bound = Solver(robot, one, **options)
        solvers[bound.name if bound.name not in solvers else f"{bound.name} {len(solvers) + 1}"] = bound
    if target is None:
        poses = [T.homogeneous for T in robot.tip_poses(robot.random_q(np.random.default_rng(2)))]
        each = [T if robot.n >= 6 * len(robot.tips) else T[:3, 3] for T in poses]
        target = robot.for_tips(dict(zip(robot.tips, each, strict=True)))
    scene = view(robot, q, target=target, title=f"{robot.name}: drag the target", live=True)
    return Interaction(scene, solvers, target, q)


def _curve(label: str, result: Result, color: str) -> tuple[str, str, list[tuple[int, float]], str]:
    """Return label, colour, position errors [m] over the iterations of the attempt that found the result, and a summary."""
    errors = iterates(result)[1] if result.history else np.array([result.position_error])
    rows = thin_rows(len(errors), 200)
    left = "" if result.success else f", {length(result.position_error)} left"
    found = result.status.name.lower().replace("_", " ") + left
    words = f"{found}, {how_many(result.iterations, 'iteration')}, {duration(result.elapsed, 2)}"
    return label, color, [(k, round(x, 10)) for k, x in zip(rows.tolist(), errors[rows].tolist(), strict=True)], words
