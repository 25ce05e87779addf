"""Pictures of where a robot reaches and where it should stand: planes through a map, its cells in 3-D, scores over the floor."""

import textwrap
from typing import Any

import numpy as np

from ..errors import InvalidOption
from ..study.place import Placements
from ..study.reachability_map import Reach, ReachabilityMap
from ..style import COLOURS, GREY, PALE
from .meshcat_server import Cloud
from .plots import charts, literal_text, raster, two_views
from .scene_state import css

# for each side of a box, the numbers of its four corners in order
SIDES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def plot_map(found: ReachabilityMap) -> Any:
    """Draw a ReachabilityMap as cuts through the middle of its reached cells.

    Cells are coloured by the share of orientations that are reached or, if there is only one, by manipulability. White is proven
    out of reach; grey means that no configuration was found and nothing is proven. The title says how many cells are of each
    kind, and how many of the grey ones more attempts reached (the audit).
    """
    total = found.states.size
    share = {name: f"{100 * count / total:.3g} %" for name, count in found.counts().items()}
    words = f"{share['yes']} of {total:,} answers reached, {share['no']} proven no, {share['unknown']} not found, not proven"
    figure = _planes(found) if found.grid.poses is None else _loose(found)
    text = [f"{found.robot}, {found.tip}: {words}", str(found.audit)]
    lines = [line for one in text for line in textwrap.wrap(one, int(15 * figure.get_figwidth()))]
    figure.suptitle(literal_text("\n".join(lines)), x=0.01, ha="left", fontsize=8.5)
    return figure


def _planes(found: ReachabilityMap) -> Any:
    grid = found.grid
    what = "share" if grid.turns > 1 else "manipulability"
    planes = ((2, 0, 1, "from above"), (1, 0, 2, "from the side"), (0, 1, 2, "from the front"))
    drawn = [one for one in planes if all(grid.size[k] > 0.0 for k in one[1:3])] or [planes[0]]
    top = 1.0 if what == "share" else max(float(found.manipulability.max(initial=0.0)), 1e-12)
    open_ = ((found.states >= Reach.FEW).any(axis=1) & ~(found.states == Reach.YES).any(axis=1)).reshape(grid.shape)
    middle, low = _middle(found), np.array(grid.low)
    high = low + np.where(grid.size > 0.0, grid.size, max(float(grid.size.max()), 1e-3)) * grid.shape
    with charts(1, len(drawn), (max(4.6, 3.3 * len(drawn)), 4.2), squeeze=False) as (figure, axes):
        for axis, (k, i, j, side) in zip(axes[0], drawn, strict=True):
            values, at = found.slice("xyz"[k], middle[k], what)
            row = 0 if grid.size[k] == 0.0 else round((at - grid.low_centre[k]) / grid.size[k])
            at = at if grid.size[k] > 0.0 else grid.low[k]
            ends = low[[i, j]], high[[i, j]]
            unknown = np.where(np.take(open_, row, axis=k), 0.0, np.nan)
            raster(axis, unknown, *ends, cmap="Greys", vmin=-0.17, vmax=1.0)
            image = raster(axis, np.where(values > 0.0, values, np.nan), *ends, cmap="viridis", vmin=0.0, vmax=top)
            title = f"{side}, {'xyz'[k]} = {at:.3g} m"
            axis.set(xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]", title=title, aspect="equal")
        for colour, label in (("0.925", "not found, not proven"), ("white", "proven out of reach")):
            axes[0, 0].fill([], [], facecolor=colour, edgecolor="0.6", lw=0.5, label=label)
        figure.legend(loc="outside lower center", ncols=2, frameon=False)
        label = "share of orientations reached" if what == "share" else "manipulability"
        figure.colorbar(image, ax=axes, label=label, shrink=0.7, aspect=25, pad=0.02)
    return figure


def _middle(found: ReachabilityMap) -> np.ndarray:
    """Return the cell centre (3,) [m] through which the planes go: that of the cell nearest the mean of those reached."""
    reached = found.reached.reshape(found.grid.shape)
    at = np.argwhere(reached if reached.any() else ~reached)
    return found.grid.low_centre + found.grid.size * np.round(at.mean(axis=0))


def _loose(found: ReachabilityMap) -> Any:
    at, yes, no = found.grid.centres(), found.reached.ravel(), (found.states == Reach.NO).ravel()
    kinds = (~yes & ~no, GREY, "not found, not proven"), (no, PALE, "proven out of reach"), (yes, COLOURS[0], "reached")
    with charts(1, 2, (8.2, 4.0)) as (figure, axes):
        for axis, (i, j) in two_views(axes):
            for some, colour, label in kinds:
                axis.plot(at[some, i], at[some, j], ".", ms=2, color=colour, label=label, rasterized=True)
            axis.set_aspect("equal")
        axes[0].legend(loc="upper left", markerscale=4)
    return figure


def draw_cells(scene: Any, found: ReachabilityMap) -> None:
    """Draw the reached cells of a ReachabilityMap around the robot in a 3-D scene, with a slider that cuts them open.

    Colours are those of `plot_map`. Each plane of cells is a cloud of its own; frame k of the animation hides the planes before
    k.
    """
    if found.tip != scene.robot.tips[0] or found.joint_names != scene.robot.joint_names:
        raise InvalidOption(
            f"this map is of {found.tip} on {found.robot}, not of {scene.robot.tips[0]} on {scene.robot.name}"
        )
    yes = found.reached.ravel()
    if not yes.any():
        scene.say("nothing of this region is reached")
        return
    colours = ramp(found.share.ravel() if found.grid.turns > 1 else found.manipulability)
    points, base = found.grid.centres(), scene.body.T_world_base
    points = points @ base[:3, :3].T + base[:3, 3]
    sizes, shape = found.grid.size, found.grid.shape
    across = next((k for k in (1, 0, 2) if shape[k] > 1), 1) if found.grid.poses is None else 1
    # A map of single poses has no grid, so all of them count as one plane.
    plane = np.unravel_index(np.arange(found.grid.cells), shape)[across]
    big = 0.55 * float(sizes[sizes > 0].min()) if (sizes > 0).any() else 0.01 * scene._extent()
    used = np.unique(plane[yes])
    for k in used:
        some = yes & (plane == k)
        scene._draw(f"cells/{k}", Cloud(points[some], colours[some], big), points[some])
        scene._shown.add(f"cells/{k}")
    what = "share of orientations reached" if found.grid.turns > 1 else "manipulability"
    ends = ((0.0, "low"), (1.0, "high"))
    scene._say(f"cells/{used[0]}", *((css(ramp(np.array([0.0, x, 1.0]))[1]), f"{what}: {word}") for x, word in ends))
    scene.say(str(found.audit))
    if len(used) < 2:
        return
    # In the animation, a plane of cells that is cut away is scaled to size zero. At first half of the planes are, to show the
    # inside.
    poses, half = np.zeros((len(used), len(used), 3, 4), "<f4"), len(used) // 2
    for frame in range(len(used)):
        poses[frame, frame:, :, :3] = np.eye(3)
    for k in used[:half]:
        scene.window.place(f"cells/{k}", np.diag((0.0, 0.0, 0.0, 1.0)))
    at = found.grid.low_centre[across] + found.grid.size[across] * used
    labels = ["all cells", *(f"{'xyz'[across]} from {x:.3g} m" for x in at[1:])]
    scene.window.animate([f"cells/{k}" for k in used], poses, labels, 8.0, half)


def ramp(values: np.ndarray) -> np.ndarray:
    """Return colours (N, 3) in 0..1 of matplotlib's map viridis for values (N,), from 0 to their largest."""
    red, green = (0.267, 0.229, 0.128, 0.369, 0.993), (0.005, 0.322, 0.567, 0.789, 0.906)
    blue = (0.329, 0.546, 0.551, 0.383, 0.144)
    high = max(float(np.max(values, initial=0.0)), 1e-300)
    x = np.clip(np.asarray(values, dtype=float) / high, 0.0, 1.0)
    return np.stack([np.interp(x, np.linspace(0.0, 1.0, 5), stops) for stops in (red, green, blue)], axis=-1)


def plot_places(found: Placements) -> Any:
    """Draw Placements as a map of the floor: for each square the share of poses reached from it at its best yaw and height.

    Grey means that no pose is reached.
    """
    bases, shares = found.candidates, found.shares
    each = found.poses.values() if isinstance(found.poses, dict) else [found.poses]
    at = np.concatenate([one if one.ndim == 2 else one[:, :3, 3] for one in each])
    low, high = bases[:, :2].min(axis=0), bases[:, :2].max(axis=0)
    wide = max(float((high - low).max()) / 32.0, 1e-6)
    sides = np.maximum(np.ceil((high - low) / wide - 1e-9).astype(int), 1)
    best = np.full(sides, np.nan)
    cell = np.minimum(((bases[:, :2] - low) / wide).astype(int), sides - 1)
    np.fmax.at(best, (cell[:, 0], cell[:, 1]), shares)
    with charts(1, 1, (6.6, 5.2)) as (figure, axis):
        ends = low, low + wide * sides
        raster(axis, np.where(best > 0.0, np.nan, best), *ends, cmap="Greys", vmin=-0.17, vmax=1.0)
        image = raster(axis, np.where(best > 0.0, best, np.nan), *ends, cmap="viridis", vmin=0.0)
        for k, corners in enumerate(found.obstacles[..., :2]):
            # Each side of the box is drawn as seen from above; together they cover the box's outline.
            for j, side in enumerate(SIDES):
                axis.fill(
                    *corners[list(side)].T, color=COLOURS[3], lw=0, label=None if k + j else "boxes around obstacles"
                )
        axis.plot(at[:, 0], at[:, 1], ".", color=COLOURS[1], ms=2.5, label="poses")
        for k, one in enumerate(found):
            end = 0.06 * float((high - low).max()) * np.array([np.cos(one.yaw), np.sin(one.yaw)])
            arrow = {"arrowstyle": "->", "lw": 1.6}
            axis.annotate("", (one.x + end[0], one.y + end[1]), (one.x, one.y), arrowprops=arrow)
            axis.plot(one.x, one.y, "o", ms=4 if k else 7, color="black", mfc="white", label=None if k else "places")
        axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axis.fill([], [], color="0.925", label="none reached")
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
        figure.colorbar(image, ax=axis, label="best share of the poses counted", shrink=0.8)
        if len(found):
            one = found[0]
            words = f"best: {one.count} of {len(at)} poses from x {one.x:.3f} m, y {one.y:.3f} m"
            words += f", yaw {np.degrees(one.yaw):.1f} deg"
            figure.suptitle(literal_text(f"{found.robot}, {words}"), x=0.01, ha="left", fontsize=9)
    return figure
