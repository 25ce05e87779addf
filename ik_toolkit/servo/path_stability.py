"""Stability of a tracking method in motion: the least sample rate for a path, and charts over gains and speed.

Both come from the product of the exact derivatives of all steps along the motion without error (orbit_stability.py), so they hold
for small errors, without limits and without damping near singular poses. Only the gains times the sample time and the number of
samples of a path count. In a chart of the gain times h over the travel in a sample, a gain that is fixed while the rate changes is
therefore a ray from the origin. The least rate is where this ray enters the stable region for good.

No path of fewer than 4 samples is judged.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InvalidOption, floats
from ..motion.reference import Reference
from ..robot.robot import Robot
from ..text import equations
from ..validate import not_negative, one_of, positive
from .orbit_stability import PathMotion, stable_bands
from .stability import BEST, DEFAULT, best_gains, complete, longest_step, mapping_matrix

# [rad or arm reaches] largest joint move in a sample for which the linearisation predicted all runs of scripts/theory_patko.py
FAR = 0.15


@dataclass(frozen=True, repr=False)
class LeastRate:
    """The least sample rate at which a tracking method is stable along a path, found by `least_rate`.

    Attributes:
        rate: [Hz] The method is stable at every rate that was tried from here to `most`; infinite if it is unstable at `most`.
        most: [Hz] The highest rate that was tried.
        at_rest: [Hz] The least stable rate at rest; 0 if every rate is stable there.
        bands: Intervals (low, high) [Hz] of stable rates; the last one is from `rate` to `most`. Bands narrower than the spacing of
            the rates tried may have been missed.
        rates: (K,) [Hz] the rates that were tried, at most 5 % apart.
        growth: (K,) factor by which a small error changes over the path (over a lap if it is closed), at each of `rates`.
        largest_move: Largest move of a joint in a sample at `rate` [rad or arm reaches].
        message: One sentence; a second one if a joint moves so far in a sample that the linearisation says little.
    """

    rate: float
    most: float
    at_rest: float
    bands: tuple[tuple[float, float], ...]
    rates: np.ndarray
    growth: np.ndarray
    largest_move: float
    message: str

    def __repr__(self) -> str:
        """Return the message."""
        return f"LeastRate: {self.message}"


def least_rate(
    robot: Robot,
    path: Reference,
    method: str = "cv",
    *,
    most: float | None = None,
    q0: Any = None,
    null_damping: float = 0.0,
    **gains: float,
) -> LeastRate:
    """Return the least sample rate above which a method is stable along a path, with fixed gains or the best ones for each rate.

    Args:
        robot: The robot.
        path: The reference to follow, as from `ik.circle`.
        method: Name of the tracking method.
        most: Highest rate to try [Hz]; default: ten times the least stable rate at rest, but no more than gives 2000 samples of the
            path, and no less than 1.6 times the least stable rate at rest.
        q0: (n,) configuration [rad or m] near which the motion starts; default: home.
        null_damping: Damping of null-space motion [1/s], as in `Method`.
        gains: Gains of the method, as in `check_gains`, the same at every rate; without any, those of `best_gains` for each rate.

    Returns:
        The rate, the bands of stable rates, and a sentence.

    Raises:
        InvalidOption: A gain is missing or not one of the method's, or a number is out of range.
        InvalidTarget: The path cannot be followed.
    """
    fixed: dict[str, Any] = complete(method, gains)
    own = [name for name in gains if name not in DEFAULT._fields]
    tried: dict[str, Any] = fixed if own else best_gains(method, 1.0) | gains
    mapping_matrix(method, 1.0, **tried)  # only to raise an error if a gain is missing or wrong
    motion, damping = PathMotion(robot, path, q0), not_negative(null_damping, "null_damping [1/s]")
    longest = longest_step(method, **fixed) if own else math.inf
    if longest == 0.0:
        raise InvalidOption(f"{method} with {equations(gains)} is stable at no rate: gains must be positive")
    at_rest = 1.0 / longest
    low = max(0.8 * at_rest, 4.0 / path.duration)
    top = max(min(10.0 * at_rest, 2000 / path.duration) if own else 100.0 * low, 2.0 * low)
    top = top if most is None else positive(most, "most [Hz]")
    if top <= low:
        raise InvalidOption(f"most must be above {low:.4g} Hz, not {top:g}")

    def factor(rate: float) -> float:
        used = fixed if own else best_gains(method, 1.0 / rate) | gains
        return motion.growth(method, 1.0 / rate, used, damping).factor

    rates, growth, bands = stable_bands(factor, low, top)
    found = bands[-1][0] if bands and bands[-1][1] == top else math.inf
    words = f"{method} with {equations(gains) if gains else 'its best gains for each rate'} along '{path.name}'"
    held = (rates >= found).sum()
    words += (
        f" is stable at each of {held} rates tried from {found:.4g} to {top:.4g} Hz (at rest from {at_rest:.4g} Hz)"
        if held
        else f" is unstable at {top:.4g} Hz, the highest rate tried"
    )
    others = [f"{a:.4g} to {b:.4g} Hz" for a, b in bands if b < top]
    words += f"; also stable from {', '.join(others)}." if others else "."
    move = motion.largest_move(1.0 / found)
    if move > FAR:
        words += f" At the first of these a joint moves {move:.2g} rad in a sample; above {FAR:g} runs may differ."
    words += motion.beyond_limits()
    return LeastRate(found, top, at_rest, bands, rates, growth, move, words)


@dataclass(frozen=True, repr=False)
class StabilityChart:
    """How fast a small error grows along a path, for a range of gains and speeds; `ik.plot` draws it.

    Attributes:
        method: "cv" or "ca".
        robot, path: Names.
        shape: For ca, kp / kd^2, which is the same in the whole chart; 0 for cv.
        gain: (G,) kappa h of cv, kd h of ca.
        samples: (S,) number of samples of the path.
        travel: (S,) mean distance [m] by which the target moves from one sample to the next.
        per_step: (S, G) mean factor by which a small error changes in a sample; stable below 1.
    """

    method: str
    robot: str
    path: str
    shape: float
    gain: np.ndarray
    samples: np.ndarray
    travel: np.ndarray
    per_step: np.ndarray

    def __repr__(self) -> str:
        """Return what the chart is of, and how much of it is stable."""
        points = f"{len(self.samples)} numbers of samples x {len(self.gain)} gains"
        return f"StabilityChart({self.method}, {self.robot} along '{self.path}': {points}, {100 * self.stable.mean():.0f} % stable)"

    @property
    def stable(self) -> np.ndarray:
        """Whether a small error dies out, for each number of samples and each gain (S, G)."""
        return self.per_step < 1.0


def stability_chart(
    robot: Robot,
    path: Reference,
    method: str = "cv",
    *,
    shape: float | None = None,
    gain: Any = None,
    samples: Any = None,
    q0: Any = None,
    null_damping: float = 0.0,
) -> StabilityChart:
    """Return where the tracking method cv or ca is stable along a path, over gains (times the sample time) and speeds.

    Args:
        robot: The robot.
        path: The reference to follow, as from `ik.circle`. Its shape counts, and how its speed changes, but not its duration.
        method: "cv" or "ca".
        shape: For ca, kp / kd^2; default that of the best gains, 2.259.
        gain: (G,) values of kappa h or kd h; default 0.04 to 1.1.
        samples: (S,) whole numbers of samples of the path; default 12 to 240, about evenly spaced in the distance from sample to
            sample.
        q0: (n,) configuration [rad or m] near which the motion starts; default: home.
        null_damping: Damping of null-space motion times the sample time, without unit.

    Returns:
        The chart.

    Raises:
        InvalidOption: The method is another one, or a number is out of range.
        InvalidTarget: The path cannot be followed.

    Source: the method after Patko and Zelei (2019), Fig. 9, which holds at rest; the extension to motion is ours.
    """
    one_of(method, ("cv", "ca"), "method of a stability chart")
    motion, damping = PathMotion(robot, path, q0), not_negative(null_damping, "null_damping")
    kp_share = positive(BEST["ca"][0] / BEST["ca"][1] ** 2 if shape is None else shape, "shape")
    gain = np.linspace(0.04, 1.1, 28) if gain is None else _positive(gain, "gain")
    counts = 1.0 / np.linspace(1 / 12, 1 / 240, 14) if samples is None else _positive(samples, "samples")
    counts = np.unique(np.round(counts).astype(int)) if samples is None else counts
    if (counts != np.round(counts)).any() or counts.min() < 4:
        raise InvalidOption("samples must be whole numbers from 4 up")
    points = path.at(np.linspace(0.0, path.duration, 1001))[0][:, :3, 3]
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    per_step = np.empty((len(counts), len(gain)))
    for i, count in enumerate(counts):
        for j, x in enumerate(gain):
            used = {"kappa": x} if method == "cv" else {"kp": kp_share * x * x, "kd": x}
            # With a sample time of 1 s gains equal their products with it; `pace` then sets how many samples the path takes.
            per_step[i, j] = motion.growth(method, 1.0, used, damping, pace=path.duration / float(count)).per_step
    kept = kp_share if method == "ca" else 0.0
    return StabilityChart(method, robot.name, path.name, kept, gain, counts, length / counts, per_step)


def _positive(values: Any, name: str) -> np.ndarray:
    """Return positive numbers (K,) as an array. Raises InvalidOption."""
    words = f"{name} must be one or more positive numbers"
    found = floats(values, words, InvalidOption)
    if found.ndim != 1 or not len(found) or not (np.isfinite(found) & (found > 0.0)).all():
        raise InvalidOption(words)
    return found
