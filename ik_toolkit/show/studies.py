"""Pictures of studies: convergence of a tuning run, success over the workspace."""

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InvalidOption, MissingExtra
from ..study.tune import TuneResult
from ..study.workspace import Workspace

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def pyplot(file: Path) -> Any:
    """Matplotlib's pyplot without a window. Raises MissingExtra, and InvalidOption for a file it cannot write."""
    try:
        import matplotlib
    except ImportError:
        raise MissingExtra("matplotlib", "plots") from None
    if file.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise InvalidOption(f"a plot is written as .png, .pdf or .svg, not '{file.suffix}'")
    matplotlib.use("Agg", force=False)
    import matplotlib.pyplot as plt

    return plt


def plot_tuning(result: TuneResult, file: str | Path) -> Path:
    """Draw cost over generations, with the held-out result in words, to a .png, .pdf or .svg."""
    path = Path(file)
    plt = pyplot(path)
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(6.2, 3.4), layout="constrained")
        generation = np.arange(1, len(result.history) + 1)
        axis.semilogy(generation, result.history[:, 2], color="0.7", lw=1, label="median of the generation")
        axis.semilogy(generation, result.history[:, 1], color=COLOURS[1], lw=1, label="best of the generation")
        axis.semilogy(generation, result.history[:, 0], color=COLOURS[0], lw=2, label="best so far")
        axis.set(xlabel="generation", ylabel="cost (1 = everything lost)")
        low, high = result.held_out.interval
        axis.set_title(
            f"{result.solver} on {result.robot}, {result.method}: {1000 * result.before.share:.1f} before,\n"
            f"{1000 * result.held_out.share:.1f} [{1000 * low:.1f}, {1000 * high:.1f}] of 1000 held-out goals after"
        )
        axis.legend(loc="upper right")
        figure.savefig(path, dpi=160)
        plt.close(figure)
    return path


def plot_workspace(found: Workspace, file: str | Path) -> Path:
    """Draw, for each solver, the share of goals solved seen from the side and from above, failures marked."""
    path = Path(file)
    plt = pyplot(path)
    with plt.rc_context(STYLE):
        rows = len(found.outcomes)
        figure, axes = plt.subplots(rows, 2, figsize=(9.0, 0.5 + 3.7 * rows), layout="constrained", squeeze=False)
        image = None
        for row, (name, outcome) in zip(axes, found.outcomes.items(), strict=True):
            for axis, across, keep in ((row[0], 2, (0, 1)), (row[1], 1, (0, 2))):
                goals, solved = found.map[name].sum(axis=1 + across)
                with np.errstate(invalid="ignore"):
                    share = np.where(goals > 0, solved / goals, np.nan)
                ends = found.low + found.cell * np.array(found.map[name].shape[1:])
                extent = (found.low[keep[0]], ends[keep[0]], found.low[keep[1]], ends[keep[1]])
                image = axis.imshow(
                    share.T, origin="lower", extent=extent, cmap="cividis", vmin=0, vmax=1, interpolation="nearest"
                )
                bad = found.failures[name]
                axis.plot(bad[:, keep[0]], bad[:, keep[1]], "o", mfc="none", mec=COLOURS[1], ms=3, mew=0.7)
                axis.set(xlabel=f"{'xyz'[keep[0]]} (m)", ylabel=f"{'xyz'[keep[1]]} (m)", aspect="equal")
            row[0].set_title(f"{name}: {outcome.solved} of {outcome.goals} solved, seen from above")
            row[1].set_title(
                "seen from the side; circles: first failures" if len(found.failures[name]) else "from the side"
            )
        figure.colorbar(image, ax=axes, label="share of goals solved", shrink=0.7)
        figure.savefig(path, dpi=160)
        plt.close(figure)
    return path
