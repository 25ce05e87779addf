"""Time-optimal parametrisation: the fastest time law of a joint path inside speed and acceleration limits (TOPP-RA).

The path is given by joint values q(s) over a coordinate s. With z = (ds/dt)^2, joint i has the speed q_i' sqrt(z) and
the acceleration q_i'' z + q_i' u, where ' is d/ds and u = d2s/dt2 = (dz/ds) / 2 is constant between two grid points. A
backward pass finds the largest z at each point from which the rest of the path can still be run; a forward pass then
finds the largest z that can be reached from the start (Pham and Pham, 2018).
"""

import numpy as np

from ..compile.jit import cached, inline

# Half width [samples] of the moving average that smooths s, ds/dt and d2s/dt2; jumps of d2s/dt2 would make a tracked tip deviate.
ROUNDED = 2
TINY = 1e-12  # Where |dq/ds| is below TINY (1 + |d2q/ds2|), the joint does not limit the acceleration d2s/dt2.


def time_law(
    slope: np.ndarray,
    bend: np.ndarray,
    s: np.ndarray,
    speed: np.ndarray,
    acceleration: np.ndarray,
    *,
    top: float | np.ndarray = np.inf,
    gain: float = np.inf,
    start: float = np.inf,
    end: float = np.inf,
) -> tuple[np.ndarray, np.ndarray]:
    """Find how fast a path may be run: the highest rates ds/dt at its grid points that keep the joint limits.

    A joint's acceleration is within its limit at both ends of every interval. With a limit at one end alone, single samples of
    tracked runs had twice the allowed acceleration.

    Args:
        slope: First derivatives dq/ds (N + 1, n) of the joint values.
        bend: Second derivatives d2q/ds2 (N + 1, n).
        s: Path coordinate (N + 1,) at the grid points, increasing.
        speed: Limits (n,) of joint speeds [rad/s or m/s], infinite where there are none.
        acceleration: Limits (n,) of joint accelerations [rad/s^2 or m/s^2], infinite where there are none.
        top: Largest ds/dt, one number or (N + 1,).
        gain: Largest magnitude of d2s/dt2.
        start: Largest ds/dt at the first point.
        end: Largest ds/dt at the last point.

    Returns:
        The rates ds/dt (N + 1,), and the index (N + 1,) of the joint that limits each of them (-1 where `top`, `start`
            or `end` does).
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        share = np.where(np.isfinite(speed), speed, np.inf) / np.abs(slope)
    share[np.isnan(share)] = np.inf
    joint = np.argmin(share, axis=1)
    least = share[np.arange(len(s)), joint]
    rate = np.minimum(least, top)
    rate[0], rate[-1] = min(rate[0], start), min(rate[-1], end)
    z, joint = rate * rate, np.where(rate < least, -1, joint)
    if np.isfinite(acceleration).any() or np.isfinite(gain):
        bound = np.flatnonzero(np.isfinite(acceleration))
        rows = np.ascontiguousarray(slope[:, bound]), np.ascontiguousarray(bend[:, bound])
        sweep(*rows, np.diff(s), acceleration[bound], bound, gain, z, joint)
    return np.sqrt(z), joint


def times_of(s: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the times (N + 1,) [s], from 0, at grid points s (N + 1,) where ds/dt is `rate` (N + 1,).

    d2s/dt2 is constant between grid points. The times are infinite after an interval with rate 0 at both ends.
    """
    with np.errstate(divide="ignore"):
        return np.append(0.0, np.cumsum(2.0 * np.diff(s) / (rate[1:] + rate[:-1])))


def evenly(count: int, most: int) -> np.ndarray:
    """Return the indices of at most `most` of `count` samples, evenly spaced and including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def resampled(s: np.ndarray, known: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return joint values (M, n) at path coordinates s (M,), interpolated linearly from Q (K, n) at coordinates `known` (K,)."""
    return np.stack([np.interp(s, known, one) for one in Q.T], axis=1)


def coordinate_at(
    t: np.ndarray, times: np.ndarray, s: np.ndarray, rate: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return s, ds/dt and d2s/dt2 (M,) of a time law at the times t (M,) [s].

    The law is given by times [s], s and rate ds/dt (N + 1,) at its grid points, as from `times_of` and `time_law`.
    """
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    steps = np.diff(times)
    # An interval without duration has d2s/dt2 = 0, to avoid a division by zero.
    gain = np.divide(np.diff(rate), steps, out=np.zeros_like(steps), where=steps > 0.0)[k]
    past = t - times[k]
    return np.clip(s[k] + (rate[k] + 0.5 * gain * past) * past, s[0], s[-1]), rate[k] + gain * past, gain


def smoothed(values: np.ndarray) -> np.ndarray:
    """Return the centred moving average of evenly spaced values (M,), over up to ROUNDED neighbours on each side of each."""
    total, k = np.append(0.0, np.cumsum(values)), np.arange(len(values))
    side = np.minimum(np.minimum(k, k[::-1]), ROUNDED)
    # The first and the last value are copied, because a difference of running sums would change their last digit.
    return np.where(side > 0, (total[k + side + 1] - total[k - side]) / (2 * side + 1), values)


@inline
def highest(low, high, slant, names, count, top, by):
    """Return the largest z up to `top` for which some u satisfies low - slant z <= u <= high - slant z in all `count` rows.

    Also returns the joint that limits z. Here z is (ds/dt)^2 and u is d2s/dt2 on a path. names (count,): joint that sets the bounds
    of each row, or -1; by: the joint that limits z to `top`, or -1.
    """
    for j in range(count):
        for m in range(count):
            both = slant[m] - slant[j]
            if both * top > high[m] - low[j]:
                top = max((high[m] - low[j]) / both, 0.0)
                by = names[m] if names[m] >= 0 else names[j]
    return top, by


@cached
def sweep(slope, bend, steps, acceleration, names, gain, z, joint):
    """Lower z = (ds/dt)^2 (N + 1,) in place until all joints keep their acceleration limits (one backward and one forward pass).

    slope, bend (N + 1, n): dq/ds and d2q/ds2 of the joints with a limit; steps (N,): lengths of the intervals of s; acceleration
    (n,): limits [rad/s^2 or m/s^2]; names (n,): indices of these joints in q; gain: limit of |u|, u = d2s/dt2. joint (N + 1,)
    receives the index in q of the joint that limits each z; where `gain` limits z near a slow point, it is the joint that limits
    that point. In one interval the largest z is the optimum of a linear program in (z, u); u is eliminated by combining each of
    its lower bounds with each of its upper bounds.
    """
    n, last = slope.shape[1], steps.shape[0]
    low, high, slant = np.empty(2 * n + 2), np.empty(2 * n + 2), np.empty(2 * n + 2)
    limiting = np.empty(2 * n + 2, np.int64)
    for k in range(last - 1, -1, -1):
        h, top, by = steps[k], z[k], -1
        # The bounds on u = d2s/dt2 have the form low - slant z <= u <= high - slant z. The first pair keeps z + 2 h u, the z at
        # the end of the interval, between 0 and z[k + 1]. The second pair keeps |u| <= gain.
        low[0], high[0], slant[0], limiting[0] = 0.0, 0.5 * z[k + 1] / h, 0.5 / h, joint[k + 1]
        low[1], high[1], slant[1], limiting[1] = -gain, gain, 0.0, -1
        count = 2
        for i in range(n):
            for at in range(2):
                b = bend[k + at, i]
                # q'' = d2q/ds2. At the end of the interval (at = 1) z has become z + 2 h u, which adds 2 h q'' to the factor of u.
                g = slope[k + at, i] + at * 2.0 * h * b
                if abs(g) <= TINY * (1.0 + abs(b)):
                    if abs(b) * top > acceleration[i]:
                        top, by = acceleration[i] / abs(b), names[i]
                    continue
                low[count], high[count] = -acceleration[i] / abs(g), acceleration[i] / abs(g)
                slant[count], limiting[count] = b / g, names[i]
                count += 1
        top, by = highest(low, high, slant, limiting, count, top, by)
        if top < z[k]:
            z[k], joint[k] = top, by
    for k in range(last):
        h, most, by = steps[k], gain, joint[k]
        for i in range(n):
            for at in range(2):
                b = bend[k + at, i]
                g = slope[k + at, i] + at * 2.0 * h * b
                if abs(g) > TINY * (1.0 + abs(b)):
                    u = (acceleration[i] - np.sign(g) * b * z[k]) / abs(g)
                    if u < most:
                        most, by = u, names[i]
        reached = max(z[k] + 2.0 * h * most, 0.0)
        if reached < z[k + 1]:
            z[k + 1], joint[k + 1] = reached, by
