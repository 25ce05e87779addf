"""Drawing of results in a scene: solves, runs, paths and trajectories, along which the robot moves, and their obstacles."""

import copy
import io
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidOption, InvalidTarget, floats
from ..files import as_output, require_place, whole_file, write_whole
from ..motion.trajectory import read_motion
from ..robot.joints import Joints
from ..robot.pose import LAST
from ..robot.ros import is_by_name
from ..solvers.collision_free import collision_model
from ..text import angle as in_words
from ..text import figure, length
from .body import GREY, drawn_shape, tube
from .feed import ROOT
from .plots import drawing, iterates
from .scene_state import css

# the palette of Okabe and Ito (2008), which colour-blind people can tell apart; plots use it as well
BLUE, ORANGE, GREEN, PURPLE = (0.0, 0.447, 0.698), (0.835, 0.369, 0.0), (0.0, 0.62, 0.451), (0.8, 0.475, 0.655)
YELLOW, SKY = (0.902, 0.624, 0.0), (0.337, 0.706, 0.914)
TRAILS = (ORANGE, PURPLE, GREEN, SKY, YELLOW)  # colours of the tips' paths, one for each tip in turn
GHOSTS = (BLUE, GREEN, YELLOW, PURPLE, SKY, ORANGE, (0.94, 0.89, 0.26), (0.45, 0.30, 0.18))
BETWEEN = 6  # number of animation frames from one iteration of a solve to the next, so that the eye can follow
OBSTACLE = (0.55, 0.58, 0.62)
SLATE = (0.30, 0.34, 0.40)  # colour of target poses and of the start of a motion
BANDS = (
    (0.05, 0.03, 0.53), (0.33, 0.01, 0.64), (0.55, 0.04, 0.65), (0.73, 0.20, 0.53), (0.86, 0.37, 0.41), (0.95, 0.53, 0.29),
    (0.99, 0.75, 0.16),
)  # fmt: skip
MAX_FRAMES = 400  # largest number of frames of an animation; a longer motion is thinned out
SECONDS = 12.0  # [s] duration of the animation of a path that has no times


class ShownMotion(NamedTuple):
    """A path or a trajectory to show: N configurations, and a value for each.

    q (N, n) [rad or m]; t (N,) [s] or None; labels (N,); values (N,) that colour the tip path, NaN where there is none, with
    name and unit; targets (N', F, 3) [m] in base axes, or None; breaks: indices of rows after which the motion is interrupted;
    lines: text shown on the page; collision: the CollisionModel whose obstacles are drawn, or None.
    """

    q: np.ndarray
    t: np.ndarray | None
    labels: list[str]
    values: np.ndarray
    name: str
    unit: str
    targets: np.ndarray | None = None
    breaks: tuple[int, ...] = ()
    lines: tuple[str, ...] = ()
    collision: Any = None


def of_path(result: Any) -> ShownMotion:
    """Convert a PathResult to a ShownMotion; its values are the bounds on the deviation from the poses."""
    finite = np.flatnonzero(np.isfinite(result.curve).all(axis=1))
    deviation = np.append(result.continuity.deviation, np.nan)[finite]
    values = 1e3 * np.fmax(deviation, np.append(np.nan, deviation[:-1]))
    ends = {piece.stop - 1 for piece in result.pieces[:-1]}
    labels = [f"pose {place:.1f}{_much(x, 'mm')}" for place, x in zip(result.at[finite], values, strict=True)]
    return ShownMotion(
        result.curve[finite], None, labels, values, "largest deviation from the path", "mm",
        result.targets[:, :, :3, 3] if result.options.relative_to is None else None,
        tuple(k for k, row in enumerate(finite.tolist()) if row in ends),
        (f"{result.status.name}: {result.message}",), result.collision,
    )  # fmt: skip


def of_run(run: Any) -> ShownMotion:
    """Convert a TrackResult to a ShownMotion without values."""
    rows = thin_rows(len(run.t), MAX_FRAMES)
    labels = [f"t = {run.t[k]:.2f} s, error {length(run.position_error[k])}" for k in rows]
    said = f"{run.method} at {1 / run.dt:.4g} Hz: {run.message or run.status.value}"
    wanted = run.target_xyz[rows].reshape(len(rows), -1, 3)
    return ShownMotion(run.q[rows], run.t[rows], labels, np.full(len(rows), np.nan), "", "", wanted, lines=(said,))


def of_trajectory(trajectory: Any) -> ShownMotion:
    """Convert a Trajectory to a ShownMotion; its values are the speeds of the fastest tip."""
    speeds = []
    for arm, columns in zip(trajectory.robot.arms, trajectory.robot.places, strict=True):
        J = arm.chain.forward(trajectory.q[:, columns], jacobian=True)[1]
        speeds.append(np.linalg.norm(np.einsum("tij,tj->ti", J[:, :3], trajectory.dq[:, columns]), axis=1))
    values = np.max(speeds, axis=0)
    labels = [
        f"t = {t:.2f} s, {f'pose {place:.1f}' if place == place else 'changing to another branch'}{_much(x, 'm/s')}"
        for t, place, x in zip(trajectory.t, trajectory.place, values, strict=True)
    ]
    said = {"lines": (trajectory.message,), "collision": trajectory.collision}
    return ShownMotion(trajectory.q, trajectory.t, labels, values, "tip speed", "m/s", **said)


def motion_from_file(robot: Joints, file: str | Path) -> ShownMotion:
    """Read a motion from a file of `ik path` (a path or a trajectory) or `ik track`, with the speed of the fastest tip.

    Raises InvalidConfiguration for a file that cannot be read, or whose joints are not the robot's.
    """
    t, q = read_motion(robot, file)
    values = np.full(len(q), np.nan)
    if t is not None and len(t) > 1:
        tips = [arm.chain.forward(q[:, at])[0][:, :3, 3] for arm, at in zip(robot.arms, robot.places, strict=True)]
        moved = np.max([np.linalg.norm(np.diff(tip, axis=0), axis=1) for tip in tips], axis=0)
        values[1:] = moved / np.maximum(np.diff(t), 1e-9)
        values[0] = values[1]
    labels = [f"row {k}" if t is None else f"t = {t[k]:.2f} s{_much(x, 'm/s')}" for k, x in enumerate(values)]
    return ShownMotion(q, t, labels, values, "tip speed", "m/s", lines=(Path(file).name,))


def motion_of(what: Any) -> ShownMotion | None:
    """Convert a PathResult, a Trajectory or a TrackResult to a ShownMotion; return None for anything else."""
    if isinstance(what, ShownMotion):
        return what
    if hasattr(what, "curve") and hasattr(what, "continuity"):
        return of_path(what)
    if hasattr(what, "target_xyz"):
        return of_run(what)
    return of_trajectory(what) if hasattr(what, "ddq") else None


def _much(value: float, unit: str) -> str:
    return f", {figure(value)} {unit}" if np.isfinite(value) else ""


# ------------------------------------------------------------------------------------------------------------- the scene
def numbered(word: str, k: int) -> str:
    """Return the name in the scene of an object of tip k: the word alone ("target") for tip 0, then "target2", "target3", ..."""
    return f"{word}{k + 1 if k else ''}"


def thin_rows(count: int, most: int) -> np.ndarray:
    """Choose at most `most` (2 or more) of `count` rows, evenly spread, with the first and the last; return their indices."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def each_target(robot: Joints, target: Any) -> dict[str, Any]:
    """Return targets by tip, from a dict, a list in the order of the tips, or one. Raises FrameNotFound, InvalidTarget."""
    each = robot.each_tip(target)
    if is_by_name(each):
        return {tip: each[tip] for tip in robot.tips if each.get(tip) is not None}
    if len(each) != len(robot.tips):
        raise InvalidTarget(f"give one target for each of {', '.join(robot.tips)}, or a dict by tip; not {len(each)}")
    return dict(zip(robot.tips, each, strict=True))


def shown_rows(robot: Joints, what: Any) -> tuple[np.ndarray, ShownMotion | None]:
    """Return the configurations (N, n) [rad or m] in anything a user may want shown, and the ShownMotion if it is a motion.

    Raises InvalidConfiguration for what does not fit the robot, InvalidOption if there is no configuration.
    """
    if what is None:
        raise InvalidOption(
            "there is nothing to show: give a configuration q (n,), several of them, or a result, not None"
        )
    motion = motion_of(what)
    many = isinstance(what, list | tuple) and any(hasattr(item, "q") or np.ndim(item) for item in what)
    rows = motion.q if motion is not None else getattr(what, "q", what)
    rows = rows if many or np.ndim(rows) == 2 else [rows]
    if not len(rows):
        raise InvalidOption("there is nothing to show: the list of configurations is empty")
    # The rows of a result are valid, and may be many, so only the first is checked against the robot.
    if rows is not what and len(rows) > 1:
        robot.check_q(rows[0])
        return np.array(rows, dtype=float), motion
    return np.array([robot.check_q(getattr(item, "q", item)) for item in rows]).reshape(-1, robot.n), motion


def model_of(what: Any, motion: ShownMotion | None) -> Any:
    """Return the CollisionModel with which a result avoided collisions, or None."""
    if motion is not None:
        return motion.collision
    asked = what._of.plan.options.avoid_collisions if hasattr(what, "_of") and hasattr(what._of, "plan") else False
    return None if asked is False else collision_model(what.robot, asked)


def draw_obstacles(scene: Any, model: Any, name: str = "obstacle") -> None:
    """Draw the obstacles of a CollisionModel at the scene paths NAME/SHAPE; shapes held by the robot move with the tip."""
    for one, placed in model._placed.items():
        if placed.arm is None:
            scene._shape(placed.shape, placed.T, f"{name}/{one}")
        elif numbered("tip", placed.arm) in scene.window.transforms:
            path = f"{numbered('tip', placed.arm)}/{one}"
            scene.window.draw(path, drawn_shape(placed.shape, OBSTACLE, 0.75))
            scene.window.place(path, placed.T)


def draw_solve(scene: Any, result: Any) -> None:
    """Draw how a Result with history was found: animate the robot through the iterations of the attempt that found it.

    The tip path and a ghost at the attempt's start are drawn, too, and the tip paths of the other attempts, thin and grey.
    """
    Q, position, angle, others = iterates(result)
    rows = thin_rows(len(Q), MAX_FRAMES)
    between = max(1, min(BETWEEN, MAX_FRAMES // len(rows)))
    words = [
        f"iteration {row}: {length(float(position[row]))}"
        + (f", {in_words(float(angle[row]))}" if np.isfinite(angle[row]) else "")
        for row in rows
    ]
    number = np.arange(between * (len(rows) - 1) + 1)
    frames = np.stack([np.interp(number / between, np.arange(len(rows)), joint) for joint in Q[rows].T], axis=1)
    labels = [words[k] for k in number // between]
    scene.show(Q[0], "start", SLATE, 0.22, "start")
    for number, other in enumerate(others):
        ways = scene._tips(result.history["q"][other])
        for k in range(ways.shape[1]):
            label = "" if number or k else "other attempts"
            scene.trail(ways[:, k], f"trail_of_{number}_{k}", GREY, 0.0015 * scene._extent(), label)
    ways = scene._tips(Q[rows])
    several = len(scene.robot.tips) > 1
    for k, tip in enumerate(scene.robot.tips):
        label = f"path of {tip}" if several else "tip path"
        scene.trail(ways[:, k], numbered("trail", k), TRAILS[k % len(TRAILS)], label=label)
    scene.animate(frames, labels, fps=max(12.0, len(frames) / 12.0), first=len(frames) - 1)


def animate(scene: Any, motion: ShownMotion) -> None:
    """Animate the robot of a Scene along a motion; the path of each tip is coloured by the motion's values, if there are any."""
    wide = 0.004 * scene._extent()
    ways = scene._tips(motion.q)
    for f in range(len(scene.robot.tips)):
        if motion.targets is not None:
            scene.trail(motion.targets[:, f], numbered("path", f), SLATE, 0.45 * wide, "" if f else "requested path")
        _coloured(scene, ways[:, f], motion.values, numbered("trail", f), wide, motion.breaks)
    look, label = css(ORANGE), "tip path"
    if np.isfinite(motion.values).any():
        low, high = np.nanmin(motion.values), np.nanmax(motion.values)
        look = f"linear-gradient(90deg, {', '.join(map(css, BANDS))})"
        label = f"{motion.name}: {figure(low)} to {figure(high)} {motion.unit}"
    scene._say("trail/0", (look, label))
    rows = thin_rows(len(motion.q), MAX_FRAMES)
    span = SECONDS if motion.t is None else float(motion.t[-1] - motion.t[0])
    scene.animate(motion.q[rows], [motion.labels[k] for k in rows], fps=max(1.0, (len(rows) - 1) / (span or 1.0)))
    scene.say(*motion.lines)


def _coloured(
    scene: Any, points: np.ndarray, values: np.ndarray, name: str, radius: float, breaks: tuple[int, ...]
) -> None:
    """Draw a trail in pieces coloured by the values at its points, or in orange if no value is known; none crosses a break."""
    known = np.isfinite(values)
    low, high = (values[known].min(), values[known].max()) if known.any() else (0.0, 0.0)
    share = np.where(known, values - low, 0.0) / (high - low if high > low else 1.0)
    band = np.minimum((share * len(BANDS)).astype(int), len(BANDS) - 1)
    first = np.append(True, np.diff(band) != 0)
    first[[k + 1 for k in breaks]] = True
    starts = np.flatnonzero(first)
    for number, (start, stop) in enumerate(zip(starts, [*starts[1:], len(points)], strict=True)):
        # Pieces of the tip path meet, except where the motion is interrupted.
        last = stop if stop - 1 in breaks else stop + 1
        P = scene._world(points[start:last])
        scene._draw(f"{name}/{number}", tube(P, radius, BANDS[band[start]] if known.any() else ORANGE), P)


# ------------------------------------------------------------------------------------------------------------- pictures
def write_pictures(path: str | Path, window: Any, size: Any, most: int = 0) -> Path:
    """Write a 3-D scene (Window) as a .png file of a size [pixels], or its animation as .gif or .mp4 of at most `most` pictures."""
    from .picture import encoder, film, picture

    with drawing():  # raises MissingExtra early, with what to install, if matplotlib is missing
        from PIL import Image
    file = as_output(path, "the picture", *((".gif", ".mp4") if most else (".png",)))
    kind, made = file.suffix.lower(), window.about["animation"]
    # found first, so that MissingExtra is raised before many pictures are made
    coder = encoder() if kind == ".mp4" else ""
    require_place(file)
    pixels = floats(size, "size must be width and height [pixels]", InvalidOption)
    if pixels.shape != (2,) or not ((pixels >= 16) & (pixels <= 4000) & (pixels % 1 == 0)).all():
        raise InvalidOption(f"size must be width and height of 16 to 4000 pixels, not {size!r:.60}")
    wide, high = (int(x) for x in pixels)
    if not most:
        write_whole(file, picture(window, (wide, high)))
        return file
    if made is None:
        raise InvalidOption("there is no animation to record: see animate, or show a result with history or a run")
    rows = thin_rows(made["count"], most)
    frames, seen = [], copy.copy(window)
    for row in rows.tolist():
        there = zip(made["paths"], made["data"][row], strict=True)
        moved = {path.removeprefix(ROOT): np.vstack([T, LAST]) for path, T in there}
        seen.transforms = window.transforms | moved
        seen.about = window.about | {"lines": [*window.about["lines"], made["labels"][row]]}
        frames.append(Image.open(io.BytesIO(picture(seen, (wide, high)))))
    lasts = np.diff(rows, append=rows[-1] + 1) / made["fps"] * 1e3  # [ms]
    lasts[-1] = 1500.0  # [ms] how long the last picture of a film is shown
    if coder:
        write_whole(file, film(coder, frames, lasts))
        return file
    with whole_file(file) as stream:
        frames[0].save(stream, "gif", save_all=True, append_images=frames[1:], duration=lasts.round().tolist(), loop=0)
    return file
