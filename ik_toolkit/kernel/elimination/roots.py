"""The roots of the determinant, and discs that hold them.

det M(q3) is a trigonometric polynomial of degree d (at most 14 here), D = sum c_k z^k, k = -d ... d, z = exp(i q3). Its values
at 2 d + 5 angles give the c_k by a discrete Fourier transform, and two harmonics more than there are: those are nothing but
rounding, and measure the noise of D. All 2 d roots are found by Ehrlich and Aberth's method (Aberth 1973). A real q3 is a root
on the unit circle; the others come in pairs z, 1 / conj(z).
"""

# Pyright must ignore what numba's type hints lack.
# pyright: reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false
import math
from typing import NamedTuple

from ...compile.jit import compiled, inline, inner
from ..records import Array
from .terms import STATE, TRUST


@compiled
class Roots(NamedTuple):
    """The polynomial, its roots and their discs."""

    values: Array  # (K,) values of the determinant
    c: Array  # (2 d + 1,) complex coefficients of z^0 ... z^2d, the largest 1 in size
    z: Array  # (2 d,) complex roots
    radius: Array  # (2 d,) radii of their discs
    state: Array  # (2 d,) see `terms.RootState`


@inline
def size(z):
    """Return |z|^2."""
    return z.real * z.real + z.imag * z.imag


@inline
def over(z):
    """Return 1 / z, without the care for huge numbers that costs numba's own division most of its time."""
    share = 1.0 / size(z)
    return complex(z.real * share, -z.imag * share)


@inner
def fit_polynomial(values, degree, tables, c):
    """Write the coefficients c (2 degree + 1,) of the polynomial with these values (K,), the largest 1 in size.

    tables: rows 0, 1 are cos, sin of 2 pi k / K. Returns the noise of a coefficient beside the largest, or inf if all are 0.
    """
    count = 2 * degree + 5
    noise, largest = 0.0, 0.0
    for h in range(degree + 3):
        a, b = 0.0, 0.0
        for k in range(count):
            m = (h * k) % count
            a += values[k] * tables[0, m]
            b -= values[k] * tables[1, m]
        length = math.sqrt(a * a + b * b)
        if h <= degree:
            c[degree + h], c[degree - h] = complex(a, b), complex(a, -b)
            largest = max(largest, length)
        else:
            noise = max(noise, length)
    if not largest > 0.0:
        return math.inf
    share = 1.0 / largest
    for k in range(2 * degree + 1):
        c[k] = c[k] * share
    return 2.0 * noise * share + 2e-16  # twice the larger of two, and the rounding of the division


@inner
def slope(c, n, z):
    """Return P'(z) / P(z) of P = sum c_k z^k (k = 0 ... n), and whether P(z) is not 0; outside the circle by powers of 1 / z."""
    inside = size(z) <= 1.0
    x = z if inside else over(z)
    value, rate = (c[n] if inside else c[0]), complex(0.0, 0.0)
    for k in range(1, n + 1):
        rate = rate * x + value
        value = value * x + c[n - k if inside else k]
    if size(value) == 0.0:
        return rate, False
    ratio = rate * over(value)
    return (ratio if inside else (n - x * ratio) * x), True


@inner
def find_roots(r, n):
    """Write the n roots of the polynomial r.c to r.z: Newton's step for each, divided out the other roots, in turn."""
    for i in range(n):
        angle, length = 2.0 * math.pi * (i + 0.37) / n, 1.25 if i % 2 == 0 else 0.8
        r.z[i] = complex(length * math.cos(angle), length * math.sin(angle))
        r.state[i] = STATE.open
    for _ in range(TRUST.sweeps):
        worst = 0.0
        for i in range(n):
            if r.state[i] != STATE.open:
                continue
            z = r.z[i]
            ratio, some = slope(r.c, n, z)
            if not some:
                r.state[i] = STATE.settled
                continue
            for j in range(n):
                apart = z - r.z[j]
                if size(apart) > 0.0:
                    ratio -= over(apart)
            if size(ratio) == 0.0:
                continue
            step = over(ratio)
            r.z[i] = z - step
            move = math.sqrt(size(step) / (size(z) + 1e-300))
            worst = max(worst, move)
            if move < TRUST.settled:
                r.state[i] = STATE.settled
        if worst < TRUST.quiet:
            break


@inner
def find_discs(r, n, noise):
    """Write the radii of discs around the roots r.z, of which those that overlap no other hold one root each."""
    last = math.sqrt(size(r.c[n]))
    for i in range(n):
        z, value, weight = r.z[i], r.c[n], 1.0
        for k in range(n - 1, -1, -1):
            value = value * z + r.c[k]
            weight = weight * size(z) + 1.0
        product = last
        for j in range(n):
            if j != i:
                product *= math.sqrt(size(z - r.z[j]))
        left = math.sqrt(size(value)) + noise * math.sqrt(weight)
        r.radius[i] = TRUST.disc * left / product if product > 0.0 else math.inf
