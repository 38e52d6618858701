"""Vectors of the plane, written as (x, y) or as the complex number x + iy."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Real: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
# A result smaller than this share of the terms that it is computed from is rounding error.
ROUNDING = 64 * np.finfo(float).eps


def complex_of(real: Real | float, imag: Real) -> Complex:
    """Complex numbers (...) from their parts, faster than real + 1j * imag."""
    result = np.empty(imag.shape, complex)
    result.real, result.imag = real, imag
    return result


def to_complex(vectors: ArrayLike) -> Complex:
    """
    Write vectors as complex numbers.

    Parameters
    ----------
    vectors
        Of shape (..., 2).

    Returns
    -------
    ndarray
        x + iy, of shape (...), complex.

    """
    array = check_vectors(vectors, 'vectors')
    # x + 1j * y would turn x into NaN where y is infinite.
    return complex_of(array[..., 0], array[..., 1])


def to_plane(numbers: ArrayLike) -> Real:
    """
    Write complex numbers as vectors.

    Parameters
    ----------
    numbers
        Of shape (...), complex.

    Returns
    -------
    ndarray
        (x, y), of shape (..., 2).

    """
    array = np.asarray(numbers, complex)
    return np.stack((array.real, array.imag), axis=-1)


def check_vectors(vectors: ArrayLike, name: str) -> Real:
    """Return `vectors` as float64 of shape (..., 2), or raise ValueError with its name."""
    array = np.asarray(vectors, float)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ValueError(f'{name} must have shape (..., 2), not {array.shape}')
    return array
