"""The two ways to write a vector of the plane, (x, y) and x + iy, and the checks at the door."""

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Real: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
# A sum of n products is off by a few units in the last place; what should stand out from it
# counts as zero below this many of them.
ROUNDING = 64 * np.finfo(float).eps


def complex_of(real: Real | float, imag: Real) -> Complex:
    """Numbers x + iy (...), without the conversions that take most of the time of that sum."""
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
        Of shape (...), complex.

    """
    array = check_vectors(vectors, 'vectors')
    # Not x + 1j * y: an infinite y would make x NaN.
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
        Of shape (..., 2).

    """
    array = np.asarray(numbers, complex)
    return np.stack((array.real, array.imag), axis=-1)


def check_vectors(vectors: ArrayLike, name: str) -> Real:
    """Return `vectors` as float64 of shape (..., 2), or raise ValueError with its name."""
    array = np.asarray(vectors, float)
    if array.ndim == 0 or array.shape[-1] != 2:
        raise ValueError(f'{name} must have shape (..., 2), not {array.shape}')
    return array
