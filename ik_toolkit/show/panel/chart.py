"""The convergence chart in the panel shows the error at every evaluation."""

from typing import Any

import numpy as np

from ...style import COLOURS

FLOOR = 1e-12  # Smaller values [m, rad] are drawn here, because a logarithmic axis has no zero.
CURVES: Any = (  # The first curve is the abscissa, the others are errors.
    {"label": "evaluation"},
    {"label": "position, 10^x m", "stroke": COLOURS[0], "width": 2},
    {"label": "orientation, 10^x rad", "stroke": COLOURS[1], "width": 2, "dash": (6, 4)},
)


class Chart:
    """A chart of a solve's errors over its evaluations, in the page of a viser client."""

    def __init__(self, client: Any) -> None:
        """Build the chart, empty and hidden."""
        self.client = client
        self.plot = client.gui.add_uplot(
            (np.array([0.0, 1.0]), np.zeros(2)),
            CURVES[:2],
            title="error per iteration (log scale)",
            scales={"x": {"time": False}},
            height=200,
            visible=False,
        )

    def hide(self) -> None:
        """Hide the chart while the robot is moved by something other than a solve."""
        self.plot.visible = False

    def show(self, result: Any) -> None:
        """Draw the history of a Result; for several attempts, the best so far."""
        history = result.history
        if history is None or len(history["position_error"]) < 2:
            self.hide()
            return
        position, angle = (np.asarray(history[f"{kind}_error"], dtype=float) for kind in ("position", "orientation"))
        rows = np.arange(len(position))
        if result.restarts:
            rows = np.maximum.accumulate(np.where(position <= np.minimum.accumulate(position), rows, 0))
        known = [position, angle] if np.isfinite(angle).all() else [position]  # A position has no angle.
        curves = [np.log10(np.maximum(values[rows], FLOOR)) for values in known]
        with self.client.atomic():
            self.plot.series = CURVES[: 1 + len(curves)]
            self.plot.data = (np.arange(len(rows), dtype=float), *curves)
            self.plot.visible = True
