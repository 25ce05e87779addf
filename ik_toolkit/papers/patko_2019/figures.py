"""Figures of the report on Patko and Zelei (2019)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...servo import stability as st
from ...style import COLOURS, PALE

COLOUR: dict[str, str] = dict(zip(("cv", "av", "ca", "aa2", "aa3", "aa1", "aad"), COLOURS, strict=False))
DASH = {"aa1": "--", "aad": "--"}
NAMES = {"aa1": "aa, reading 1", "aa2": "aa, reading 2", "aa3": "aa, reading 3", "aad": "aad (ours)"}
FLOOR = 1e-8  # Lower end [m] of the axes of errors. Runs with smaller errors are not drawn but named.


def draw_charts(plt: Any, sets: Mapping[str, Any]) -> Any:
    """Draw Fig. 9: which gains are stable, for the paper's method cv over (h, kappa), for ca over (kd, kp) at several h.

    h is the sample time [s]; kappa [1/s], kp [1/s^2] and kd [1/s] are the gains. sets: the published gains, which are marked.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.2), layout="constrained")
    h = np.linspace(0.002, 0.35, 600)
    left.fill_between(h, 0, 1 / h, color="#D9D9D9", lw=0)
    left.plot(h, 1 / h, color="#000000", lw=1.0)
    left.plot(h, st.BEST["cv"][0] / h, color="#000000", lw=0.8, ls=":")
    left.text(0.262, 1 / 0.262 + 0.7, r"$\kappa h = 1$")
    left.text(0.262, st.BEST["cv"][0] / 0.262 - 1.35, r"best, $\kappa h = 2/3$")
    left.text(0.03, 3.0, "stable")
    for s in sets.values():
        _mark(left, s, (s.h, s.kappa), ("right", (-5, -11)) if s.paper == "stable" else ("left", (7, 4)))
    left.set(xlim=(0, 0.35), ylim=(0, 22), xlabel="h [s]", ylabel=r"$\kappa$ [1/s]", title="cv")
    shades = {0.0628: "#EBEBEB", 0.12: "#C9C9C9", 0.2: "#A3A3A3"}
    for h0, shade in shades.items():
        d = np.linspace(0, 1, 300)
        right.fill_between(d / h0, 0, st.p_limit(d) / h0**2, color=shade, lw=0)
        right.plot(np.append(d / h0, 1 / h0), np.append(st.p_limit(d) / h0**2, 0), color="#000000", lw=0.8)
        right.text(1 / h0 + 0.15, 0.62 * st.p_limit(1.0) / h0**2, f"h = {h0:g} s", fontsize=8)
    for s in sets.values():
        _mark(right, s, (s.kd, s.kp), ("center", (0, -13)) if s.paper == "stable" else ("right", (-7, 3)))
    right.set(xlim=(0, 19), ylim=(10, 1200), yscale="log", title="ca")
    right.set(xlabel=r"$\kappa_D$ [1/s]", ylabel=r"$\kappa_P$ [1/s$^2$]")
    right.plot([], [], ls="", marker="o", color=COLOURS[0], label="stable in the paper")
    right.plot([], [], ls="", marker="X", color=COLOURS[1], label="unstable in the paper")
    right.legend(loc="upper left", fontsize=8)
    return figure


def _mark(ax: Any, s: Any, at: tuple[float, float], place: tuple[str, tuple[int, int]]) -> None:
    """Mark a set of gains and write its name beside it; place: horizontal alignment, and shift [points]."""
    good, (side, shift) = s.paper == "stable", place
    ax.plot(*at, ls="", marker="o" if good else "X", ms=6, color=COLOURS[0] if good else COLOURS[1])
    ax.annotate(s.name, at, xytext=shift, textcoords="offset points", fontsize=8, ha=side)


def draw_errors(plt: Any, panels: Mapping[str, Mapping[str, Any]], xlim: tuple[float, float]) -> Any:
    """Draw Fig. 4: the error over time on a logarithmic axis, in a panel for each start."""
    figure, axes = plt.subplots(1, len(panels), figsize=(9.6, 3.8), sharey=True, layout="constrained")
    for ax, (title, runs) in zip(axes, panels.items(), strict=True):
        for key, run in runs.items():
            _curve(ax, key, run, xlim[1])
        _below(ax, runs)
        ax.set(xlim=xlim, ylim=(FLOOR, 3.0), yscale="log", xlabel="time [s]", title=title)
        ax.grid(axis="y", color=PALE, lw=0.5)
    axes[0].set_ylabel("|error| [m]")
    axes[-1].legend(fontsize=8, ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _curve(ax: Any, key: str, run: Any, until: float) -> None:
    error = np.linalg.norm(run.error, axis=1)
    keep = run.t <= until
    look = {"color": COLOUR[key], "ls": DASH.get(key, "-"), "label": NAMES.get(key, key)}
    ax.plot(run.t[keep], np.maximum(error[keep], 0.1 * FLOOR), **look)
    if run.stopped and run.t[-1] <= until:
        ax.plot(run.t[-1], error[-1], color=COLOUR[key], marker="X", ms=7, ls="")


def _below(ax: Any, runs: Mapping[str, Any]) -> None:
    """Write the names of the runs whose error falls below the axes for good."""
    late = {key: run.error[len(run.error) // 2 :] for key, run in runs.items() if not run.stopped}
    names = [NAMES.get(key, key) for key, error in late.items() if np.linalg.norm(error, axis=1).max() < FLOOR]
    if names:
        text = f"{'; '.join(names)}: below {FLOOR:g} m after a step or two"
        box = {"fc": "white", "ec": "none", "pad": 1}
        ax.text(0.98, 0.03, text, transform=ax.transAxes, ha="right", fontsize=7.5, bbox=box)


def draw_plane(plt: Any, case: Any, lap: float, panels: Mapping[str, Mapping[str, Any]]) -> Any:
    """Draw Figs. 5 to 8 with a column for each set of gains: the tip's path in its first lap above, its error over time [s] below.

    Of the unstable set only half a lap is drawn.
    """
    figure, axes = plt.subplots(2, 2, figsize=(9.6, 7.2), height_ratios=(1.25, 1.0), layout="constrained")
    for (top, low), (title, runs), shown in zip(axes.T, panels.items(), (0.5 * lap, lap), strict=True):
        t = np.linspace(0, lap, 600)
        target = np.array([case.path(x)[0] for x in t])
        span = np.ptp(target, axis=0).max()
        middle = 0.5 * (target.min(axis=0) + target.max(axis=0))
        for key, run in runs.items():
            first = run.t <= shown
            xy = np.array([case.path(x)[0] for x in run.t[first]]) - run.error[first]
            top.plot(xy[:, 0], xy[:, 1], color=COLOUR[key], ls=DASH.get(key, "-"), lw=1.0)
            _curve(low, key, run, np.inf)
        top.plot(target[:, 0], target[:, 1], color="#000000", lw=1.4, ls=(0, (1, 2)), label="target")
        top.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=f"{title}; first {shown:.3g} s")
        top.set_xlim(middle[0] - 0.95 * span, middle[0] + 0.95 * span)
        top.set_ylim(middle[1] - 0.75 * span, middle[1] + 0.75 * span)
        _below(low, runs)
        low.set(yscale="log", ylim=(FLOOR, 1e6), xlabel="time [s]")
        low.grid(axis="y", color=PALE, lw=0.5)
    axes[0, 0].legend(fontsize=8, loc="upper left", frameon=True, framealpha=1.0, edgecolor="none")
    axes[1, 0].set_ylabel("|error| [m]")
    axes[1, 1].legend(fontsize=8, loc="upper right", ncols=3)
    return figure


def draw_orders(plt: Any, steps: Sequence[float], curves: Mapping[str, Sequence[float]]) -> Any:
    """Draw the tracking error over the sample time h on logarithmic axes, with the slopes 2 and 3 for comparison.

    curves: by method, the errors [m] for the sample times `steps` [s].
    """
    figure, ax = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    for label, errors in curves.items():
        key = label.split(",")[0]
        ls = "--" if "scaled" in label else (0, (3, 3)) if key == "aad" else DASH.get(key, "-")
        ax.loglog(
            steps, errors, color=COLOUR[key], ls=ls, marker="o", ms=0 if key == "aad" else 3.5, lw=1.3, label=label
        )
    h = np.array([steps[-1], steps[0]])
    for order, top in ((2, 6e-4), (3, 6e-7 * 8**3 / 512)):
        ax.loglog(h, top * (h / h[1]) ** order, color="#9A9A9A", lw=0.8)
        ax.text(h[1] * 1.04, top, f"h$^{order}$", ha="left", va="center", color="#6A6A6A")
    ax.set(xlabel="h [s]", ylabel="largest settled error [m]")
    ax.set_xticks(list(steps), [f"{x:g}" for x in steps])
    ax.minorticks_off()
    ax.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def draw_motion(plt: Any, charts: Sequence[tuple[Any, str]], sets: Mapping[str, Any], lap: float) -> Any:
    """Draw stability charts, each with a title, and on each a line for each published set of gains as the sample rate changes."""
    from ...show.plot import stability_map

    rows = len(charts) // 2
    figure, axes = plt.subplots(rows, 2, figsize=(9.6, 3.9 * rows), layout="constrained", squeeze=False)
    shades = None
    for ax, (chart, title) in zip(axes.flat, charts, strict=True):
        shades = stability_map(ax, chart)
        ax.set_title(title)
        speed = chart.travel[0] * chart.samples[0] / lap  # Mean speed [m/s] of the target.
        for k, (label, s) in enumerate(sets.items()):
            if chart.method == "ca" and abs(s.kp / s.kd**2 - chart.shape) > 1e-9:
                continue  # A chart of this method is for one ratio kp / kd^2, so gains of another ratio are not on it.
            gain = s.kappa if chart.method == "cv" else s.kd
            ax.plot([0.0, gain], [0.0, speed], color=COLOURS[1 - k], lw=1.2, label=label)
            ax.plot(gain * s.h, speed * s.h, "o", color=COLOURS[1 - k], ms=5)
        ax.legend(fontsize=8, loc="upper left", frameon=True, framealpha=1.0, edgecolor="none")
    figure.colorbar(shades, ax=axes, label="factor of a small error in a sample (mean of a lap)", shrink=0.5)
    return figure
