"""
Local polynomials on arbitrary instants: what turns samples into derivatives.

The fits are done in a basis that is orthonormal on the very samples (QR of Legendre polynomials on
the window scaled to [-1, 1]), so they stay exact where powers of raw times would not, and so one
projection holds the fits of all degrees at once. A polynomial through all its samples (degree
n - 1) is the finite-difference stencil on these nodes (Fornberg 1988).
"""

from functools import cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import Real


def derivative_weights(
    times: ArrayLike, degree: int, orders: int, weights: ArrayLike | None = None
) -> Real:
    """
    Weights (orders + 1, n) that turn n samples into derivatives of order 0 to `orders` at time 0.

    `times` (n,) in s, in any spacing, need not enclose 0; `weights` (n,) are inverse variances in
    any unit. Fits a polynomial of `degree` by weighted least squares; orders above the degree come
    out 0. Raises ValueError where the samples at distinct times are too few for the degree.

    >>> derivative_weights([-0.1, 0.0, 0.1], degree=2, orders=2).round(3)
    array([[   0.,    1.,    0.],
           [  -5.,    0.,    5.],
           [ 100., -200.,  100.]])
    """
    t = np.asarray(times, float)
    w = np.ones_like(t) if weights is None else np.asarray(weights, float)
    if t.ndim != 1 or w.shape != t.shape:
        raise ValueError(f'times and weights must have one shape (n,), not {t.shape}, {w.shape}')
    if not 0 <= degree < np.unique(t[w > 0]).size:
        raise ValueError(f'degree must be 0 to the number of distinct times less 1, not {degree}')
    root = np.sqrt(w)
    basis, rows = orthonormal_basis(t[None], root[None], degree, orders)
    return np.asarray((rows[0] @ basis[0].T) * root)


def stencil(times: ArrayLike, orders: int) -> Real:
    """
    Finite-difference weights (orders + 1, n) on arbitrary nodes `times` (n,) for time 0.

    The derivatives of the one polynomial through all n samples. Raises ValueError for equal times.
    """
    return derivative_weights(times, np.size(times) - 1, orders)


def orthonormal_basis(
    times: Real, root: Real, degree: int, orders: int, each: int = 1
) -> tuple[Real, Real]:
    """
    Polynomials orthonormal on weighted samples, and their derivatives at time 0.

    `times` (..., n) in s; `root` (..., n) are square roots of weights, 0 for a sample outside.
    Returns the basis at the samples times `root`, (..., n, degree + 1), and the derivatives
    (..., orders + 1, degree + 1) of its members at time 0. Members beyond the number of samples
    mean nothing: the caller leaves them out. With `each` the samples are means of so many
    neighbors, and so are the members (..., n / each, degree + 1), so that polynomials stay exact.
    """
    inside = root > 0
    first = np.min(times, axis=-1, where=inside, initial=np.max(times))
    last = np.max(times, axis=-1, where=inside, initial=np.min(times))
    center, half = (first + last) / 2, (last - first) / 2
    half = np.where(half > 0, half, 1.0)
    scaled = np.where(inside, (times - center[..., None]) / half[..., None], 0.0)
    raw = legendre.legvander(scaled, degree) * root[..., None]
    if each > 1:
        together = (*root.shape[:-1], -1, each)
        weight = (root**2).reshape(together).sum(axis=-1)[..., None]
        raw = (raw * root[..., None]).reshape(*together, degree + 1).sum(axis=-2)
        raw /= np.sqrt(np.where(weight > 0, weight, 1.0))
    basis, triangle = np.linalg.qr(raw)
    # Rank is lost in the last columns alone where samples are too few; keep the solve finite.
    diagonal = np.einsum('...ii->...i', triangle)
    diagonal[np.abs(diagonal) < 1e-13] = 1.0
    at_zero = _legendre_derivatives(-center / half, degree, orders)
    at_zero /= half[..., None, None] ** np.arange(orders + 1)[:, None]
    rows = np.linalg.solve(np.swapaxes(triangle, -1, -2), np.swapaxes(at_zero, -1, -2))
    return basis, np.swapaxes(rows, -1, -2)


def _legendre_derivatives(x: Real, degree: int, orders: int) -> Real:
    """Derivatives (..., orders + 1, degree + 1) of the Legendre polynomials at x (...)."""
    values = legendre.legvander(x, degree)
    return np.asarray(np.einsum('...k,mkj->...mj', values, _derived(degree, orders)))


@cache
def _derived(degree: int, orders: int) -> Real:
    """Derivatives of the Legendre polynomials j as sums of those k, (orders + 1, k, j)."""
    result = np.zeros((orders + 1, degree + 1, degree + 1))
    for order in range(orders + 1):
        kept = legendre.legder(np.eye(degree + 1), order) if order else np.eye(degree + 1)
        result[order, : len(kept)] = kept if order <= degree else 0.0
    return result
