"""Confidence intervals of success rates."""

import math

Z95 = 1.959963984540054  # quantile of the normal distribution for a two-sided interval of 95 %


def wilson(successes: int, trials: int, z: float = Z95) -> tuple[float, float]:
    """Return the Wilson score interval (low, high) of a success probability; it is (0, 1) without trials.

    z is the quantile of the normal distribution, by default for 95 %. Source: Wilson (1927); Brown, Cai, DasGupta (2001), eq. (4).
    """
    if trials == 0:
        return 0.0, 1.0
    share, zz = successes / trials, z * z
    middle = (share + zz / (2 * trials)) / (1 + zz / trials)
    half = z / (1 + zz / trials) * math.sqrt(share * (1 - share) / trials + zz / (4 * trials * trials))
    low = 0.0 if successes == 0 else middle - half
    high = 1.0 if successes == trials else middle + half
    return low, high
