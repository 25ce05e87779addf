"""Where the joints are, from the commands sent to them and from measurements that are late and noisy.

The estimate is the command plus a slowly varying offset. A critically damped filter of second order drives the offset to the
difference between the measured joints and the command sent `delay` samples before. So neither a constant delay nor noise enters
the feedback, and the gains of the feedback are those of a loop without delay. The filter cannot know that a delay is longer than
assumed: at a constant rate it then takes the additional lag for an offset, and the tip leads its target by as much.
"""

import math
from collections import deque
from typing import Any, NamedTuple

import numpy as np

from ..errors import InvalidConfiguration, InvalidOption, whole
from ..kernel.limits import LIMIT
from ..validate import number


class FilterAssumptions(NamedTuple):
    """Assumptions about measured joint values, from which the bandwidth of the filter of a `JointObserver` follows."""

    delay: int = 2  # age of measured joints [samples]
    longest: int = 10_000  # largest delay [samples]; one command is kept for each of these samples
    noise: float = 1e-4  # standard deviation of the measurement noise [rad or arm reaches]
    acceleration: float = 0.01  # [rad/s^2] standard deviation of the joint accelerations that noise may cause
    # Bandwidth of the filter [rad/s] times the age [s] of the newest command to which a measurement can answer. With this value the
    # control loop stays stable even if the true delay is four times the assumed one (tests/servo/test_measured.py).
    steady: float = 0.3


FILTER = FilterAssumptions()


def read_measured(robot: Any, q: Any) -> np.ndarray:
    """Convert measured joints q of a robot [rad or m] to (n,) [rad or arm reaches]; numbers that are not finite are let through.

    Raises InvalidConfiguration for a wrong size.
    """
    try:
        found = robot.check_q(q, "q")
    except InvalidConfiguration:
        found = robot.read_q(q, "q")[0]
        if np.isfinite(found).all():
            raise
    return found / robot.chain.unit


class JointObserver:
    """Estimates where the joints of an arm are (n,) [rad or arm reaches], from the commands and from late, noisy measurements.

    Args:
        n: Number of joints.
        delay: Age of the measured joints [samples].
        noise: Standard deviation of their noise [rad or arm reaches].
    """

    def __init__(self, n: int, delay: int, noise: float) -> None:
        """Begin without an offset. Raises InvalidOption for a delay that is not a whole number, or a negative noise."""
        self.delay, self.noise = whole(delay, "delay [samples]", 0), number(noise, "noise [rad]")
        if self.delay > FILTER.longest:
            raise InvalidOption(f"delay must be at most {FILTER.longest} samples, not {delay!r:.60}")
        if self.noise < 0.0:
            raise InvalidOption(f"noise must be at least 0 [rad], not {noise!r}")
        self.offset, self._rate = np.zeros(n), np.zeros(n)
        self._sent: deque[np.ndarray] = deque(maxlen=self.delay + 1)
        self._unheard = 0  # number of coming samples whose measurements are ignored: they may date from before a jump
        self.far: Any = None  # the last measurement if it was doubted, being too far from its command; else None
        self.doubts = 0  # number of consecutive measurements that were doubted
        self.confirmed = False  # whether the last two doubted measurements agree, so that the joints really are there
        self.used = False  # whether joints have been measured; from then on the estimate is the command plus the offset

    def reset(self, *, jumped: bool = False) -> None:
        """Forget the commands and the offset between commands and joints; jumped: whether the command has just jumped.

        Measurements that still answer to commands from before a jump are then ignored: compared with later commands, they would
        cause another jump. For safety the true delay is assumed to be up to twice `delay`.
        """
        self.offset[:], self._rate[:] = 0.0, 0.0
        self._sent.clear()
        self.far, self.doubts, self.confirmed = None, 0, False
        self._unheard, self.used = 2 * (self.delay + 1) if jumped else 0, jumped

    def bandwidth(self, h: float) -> float:
        """Return the bandwidth [rad/s] of the filter that estimates the joints, at sample time h [s].

        A difference e between measurement and estimate accelerates the estimate by bandwidth^2 e, so noise and delay limit the
        bandwidth.
        """
        steady = FILTER.steady / ((self.delay + 1) * h)
        return min(steady, math.sqrt(FILTER.acceleration / self.noise)) if self.noise > 0.0 else steady

    def send(self, command: np.ndarray) -> None:
        """Remember the present command (n,) [rad or arm reaches], to compare a later measurement with it; call it every sample."""
        self._sent.append(command)
        if self._unheard:
            self._unheard -= 1

    def take(self, measured: np.ndarray, h: float, most: float, limits: np.ndarray) -> float:
        """Take the joints measured now (n,) [rad or arm reaches], after `send` was called for this sample; h [s]: sample time.

        Returns the largest difference between the measured joints and the command they answer to, infinite if a number is not
        finite. A measurement that differs by more than `most` is not believed until the next one agrees with it, and never if it is
        outside the limits by more than `most`. limits (2 or more, n): lower and upper in the first two rows.
        """
        if self._unheard:
            return 0.0
        w, apart = self.bandwidth(h), measured - self._sent[0]
        largest = float(np.abs(apart).max())
        if not largest <= most:  # Written so that NaN counts as too far.
            agree = self.far is not None and np.abs(measured - self.far).max() <= most
            inside = (measured >= limits[LIMIT.lowest] - most) & (measured <= limits[LIMIT.highest] + most)
            self.confirmed = bool(agree and inside.all())
            self.far, self.doubts = measured, self.doubts + 1
            return largest if largest < math.inf else math.inf
        self.far, self.doubts, self.confirmed, self.used = None, 0, False, True
        self._rate += h * w * (w * (apart - self.offset) - 2.0 * self._rate)
        self.offset += h * self._rate
        return largest
