"""
Fixed local polynomials: what the benchmarks compare with.

The fits are done in a basis that is orthonormal on the very samples, so they stay exact where
powers of raw times would not. A polynomial through all its samples (degree n - 1) is the
finite-difference stencil on these nodes (Fornberg 1988).
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
    basis, rows = _legendre_basis(t, np.sqrt(w), degree, orders)
    return np.asarray((rows @ basis.T) * np.sqrt(w))


def stencil(times: ArrayLike, orders: int) -> Real:
    """
    Finite-difference weights (orders + 1, n) on arbitrary nodes `times` (n,) for time 0.

    The derivatives of the one polynomial through all n samples. Raises ValueError for equal times.
    """
    return derivative_weights(times, np.size(times) - 1, orders)


def _legendre_basis(times: Real, root: Real, degree: int, orders: int) -> tuple[Real, Real]:
    """
    Polynomials orthonormal on weighted samples (n,), and their derivatives at time 0.

    `times` in s; `root` are square roots of weights, 0 for a sample outside. Returns the basis at
    the samples times `root`, (n, degree + 1), and the derivatives (orders + 1, degree + 1).
    """
    first, last = times[root > 0].min(), times[root > 0].max()
    center, half = (first + last) / 2, (last - first) / 2 or 1.0
    scaled = np.where(root > 0, (times - center) / half, 0.0)
    at_zero = _legendre_derivatives(-center / half, degree, orders)
    at_zero /= half ** np.arange(orders + 1)[:, None]
    return _orthonormal(legendre.legvander(scaled, degree) * root[:, None], at_zero)


def _orthonormal(members: Real, rows: Real) -> tuple[Real, Real]:
    """Members (n, D) made orthonormal, the first of them first, and their rows (K, D)."""
    basis, triangle = np.linalg.qr(members)
    return basis, np.linalg.solve(triangle.T, rows.T).T


def _legendre_derivatives(x: float, degree: int, orders: int) -> Real:
    """Derivatives (orders + 1, degree + 1) of the Legendre polynomials at x."""
    return np.asarray(legendre.legvander([x], degree)[0] @ _derived(degree, orders))


@cache
def _derived(degree: int, orders: int) -> Real:
    """Derivatives of the Legendre polynomials j as sums of those k, (orders + 1, k, j)."""
    result = np.zeros((orders + 1, degree + 1, degree + 1))
    for order in range(orders + 1):
        kept = legendre.legder(np.eye(degree + 1), order) if order else np.eye(degree + 1)
        result[order, : len(kept)] = kept if order <= degree else 0.0
    return result
