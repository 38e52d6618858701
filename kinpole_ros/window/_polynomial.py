"""
Local polynomials on arbitrary instants: what turns samples into derivatives.

The fits are done in a basis that is orthonormal on the very samples, so they stay exact where
powers of raw times would not, and so one projection holds the fits of all degrees at once. For a
few samples it is a QR of Legendre polynomials on the window scaled to [-1, 1]; for many windows at
once, of degrees below the number of their samples, the recurrence of Stieltjes takes far less time.
A polynomial through all its samples (degree n - 1) is the finite-difference stencil on these nodes
(Fornberg 1988).
"""

from functools import cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import Real

# Members farther than this from orthogonal are made so again.
_LOST = 1e-13
_TINY = np.finfo(float).tiny


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
    """Members (..., n, D) made orthonormal, the first of them first, and their rows (..., K, D)."""
    basis, triangle = np.linalg.qr(members)
    diagonal = np.einsum('...ii->...i', triangle)
    # Each goes the way it went: coefficients of angle and position are added up.
    signs = np.where(diagonal < 0, -1.0, 1.0)
    basis *= signs[..., None, :]
    triangle *= signs[..., None]
    # Rank is lost in the last columns alone where samples are too few; keep the solve finite.
    diagonal[np.abs(diagonal) < 1e-13] = 1.0
    rows = np.linalg.solve(np.swapaxes(triangle, -1, -2), np.swapaxes(rows, -1, -2))
    return basis, np.swapaxes(rows, -1, -2)


def orthonormal_members(
    times: Real, root: Real, highest: np.ndarray, size: int, orders: int, each: int = 1
) -> tuple[Real, Real]:
    """
    Polynomials orthonormal on the weighted samples of many windows, and their derivatives at 0.

    `times` (..., n), in any unit of which a window spans about two, 0 among them or near; `root`
    (..., n) are square roots of weights, 0 for a sample outside. Both have as many axes, and are
    broadcast. Returns the members times `root`, (..., size, n), and their derivatives (..., orders
    + 1, size) by the unit of times; members beyond the degree `highest` (...), which is below the
    number of samples with weight, are 0. With `each` the samples are means of so many neighbors,
    and so are the members (..., size, n / each), so that polynomials stay exact.

    By the recurrence of Stieltjes (Gautschi, Orthogonal Polynomials, 2004, 2.2.3.1).
    """
    count = times.shape[-1]
    windows = np.broadcast_shapes(times.shape[:-1], root.shape[:-1])
    # Derivatives at 0 follow the samples: they obey the same recurrence, one order the other.
    places = np.zeros((*windows, count + orders + 1))
    places[..., :count] = times
    members = np.zeros((size, *places.shape))
    members[0, ..., :count] = root
    members[0, ..., count] = 1.0
    squares = np.ones((size, *windows))
    order = np.arange(1.0, orders + 1)
    degree = int(highest.max())
    for k in range(degree + 1):
        here = members[k]
        if k < degree:
            following = np.multiply(places, here, out=members[k + 1])
        # The square of this one, and its product with the one begun.
        pair = members[k : k + 2, ..., :count]
        sums = np.einsum('i...n,...n->i...', pair, here[..., :count])
        np.maximum(sums[0], _TINY, out=squares[k])
        if k < degree:
            following -= (sums[1] / squares[k])[..., None] * here
            following[..., count + 1 :] += order * here[..., count:-1]
        if 0 < k < degree:
            following -= (squares[k] / squares[k - 1])[..., None] * members[k - 1]
    within = np.arange(size).reshape(-1, *(1,) * highest.ndim) <= highest
    members *= np.where(within, 1 / np.sqrt(squares), 0.0)[..., None]
    axes = range(1, members.ndim - 1)
    basis = members[..., :count]
    rows = members[..., count:].transpose(*axes, -1, 0)
    if each > 1:
        # As a product: a sum over an axis this short takes ten times as long.
        ones = np.ones(each)
        weight = np.square(root).reshape(*root.shape[:-1], -1, each) @ ones
        basis = (basis * root).reshape(*basis.shape[:-1], -1, each) @ ones
        basis /= np.sqrt(np.where(weight > 0, weight, 1.0))
        lost = np.ones(windows, bool)
    else:
        # Rounding adds up where the samples are few and far from even. Each member has the product
        # 1 with the sum of all.
        product = np.einsum('i...n,...n->i...', basis, basis.sum(axis=0))
        lost = (np.abs(product - within) > _LOST).any(axis=0)
    basis = basis.transpose(*axes, 0, -1)
    if lost.any():
        # No more of them than there are samples.
        most = min(size, basis.shape[-1])
        columns = np.swapaxes(basis[lost, :most], -1, -2)
        again, rows[lost, :, :most] = _orthonormal(columns, rows[lost, :, :most])
        kept = np.arange(most) <= np.broadcast_to(highest, windows)[lost][:, None]
        basis[lost, :most] = np.where(kept[..., None], np.swapaxes(again, -1, -2), 0.0)
    return basis, rows


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
