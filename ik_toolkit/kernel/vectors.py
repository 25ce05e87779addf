"""Operations on vectors, views of arrays, that take numba less time to compile than loops written out in every place."""

from ..compile.jit import inline


@inline
def dot(x, y, n):
    """Return the scalar product of the first n numbers of two vectors."""
    s = 0.0
    for i in range(n):
        s += x[i] * y[i]
    return s


@inline
def dot_of_columns(A, r, B, c, n):
    """Return the scalar product of column r of A and column c of B, over their first n rows."""
    s = 0.0
    for i in range(n):
        s += A[i, r] * B[i, c]
    return s


@inline
def dot_with_column(x, A, c, n):
    """Return the scalar product of the vector x and column c of A, over their first n numbers."""
    s = 0.0
    for i in range(n):
        s += x[i] * A[i, c]
    return s


@inline
def add_multiple(x, factor, y, n):
    """Add `factor` times the vector y to the vector x in place, over their first n numbers."""
    for i in range(n):
        x[i] += factor * y[i]


@inline
def apply_transposed(A, x, out):
    """Write A' x to out (m,), for a matrix A (n, m) and a vector x (n,)."""
    for k in range(A.shape[1]):
        s = 0.0
        for i in range(A.shape[0]):
            s += A[i, k] * x[i]
        out[k] = s


@inline
def clear(x):
    """Set all numbers of the vector x to 0."""
    for i in range(x.shape[0]):
        x[i] = 0.0


@inline
def any_of(x):
    """Return whether any number of the vector x is not 0."""
    for i in range(x.shape[0]):
        if x[i] != 0.0:
            return True
    return False


@inline
def largest(x):
    """Return the largest absolute value in the vector x."""
    most = 0.0
    for i in range(x.shape[0]):
        most = max(most, abs(x[i]))
    return most
