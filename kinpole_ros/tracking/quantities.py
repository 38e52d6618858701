"""Poles, the velocity of the ICR and the curvature of centrodes, and where they are determined."""

from ctypes import POINTER, Structure, byref, c_int, c_longlong, c_void_p
from typing import Any, ClassVar

import numpy as np

from kinpole_ros.compiled import address_of, library
from kinpole_ros.planar._plane import Complex, Real

# The numbers that _quantities.c gives to what it computes. Poles have their order, 1 to 4, and FREE
# is added for a pole by the motion alone, whatever is known of pins.
VELOCITY, CURVATURE, FREE = 5, 6, 10
# The highest derivative that each of them needs; poles need their own order.
_NEEDED = {VELOCITY: 2, CURVATURE: 3}
# Bits of the flags: a quantity stands out of its noise; the ICR is seen to move.
DETERMINED, MOVES = 1, 2
_ARRAYS = {
    'position': complex,
    'angle': float,
    'position_covariance': float,
    'angle_covariance': float,
    'size': float,
    'pin': complex,
    'pin_variance': float,
}


class Motion(Structure):
    """
    `Motion` of _quantities.c: derivatives of bodies at instants, of any shape (...).

    Parameters
    ----------
    position, angle : (K, ...)
        Derivatives from order 0 on, complex, m/s^k, and float, rad/s^k.
    position_covariance, angle_covariance : (K, K, ...) float
        Covariances between the orders, of one coordinate.
    size : (...) float
        Diameters of the bodies, m.
    pin, pin_variance : (...)
        Fixed points that bodies turn about, complex, m, NaN for none, and the variance of one
        coordinate, m^2.

    """

    _fields_: ClassVar[Any] = [
        *((name, c_longlong) for name in ('count', 'orders')),
        *((name, c_void_p) for name in _ARRAYS),
    ]

    def __init__(self, *arrays: np.ndarray) -> None:
        pairs = zip(arrays, _ARRAYS.values(), strict=True)
        self._arrays = [np.asarray(array, kind, order='C') for array, kind in pairs]
        position, angle, of_position, of_angle, *rest = self._arrays
        self.orders, *self.shape = angle.shape
        self.count = rest[0].size
        square, each = (self.orders, *angle.shape), [list(array.shape) for array in rest]
        if position.shape != angle.shape or each != 3 * [self.shape]:
            raise ValueError(f'expected arrays of one shape, got {[a.shape for a in arrays]}')
        if of_position.shape != square or of_angle.shape != square:
            raise ValueError(f'expected covariances of shape {square}, got {of_position.shape}')
        for name, array in zip(_ARRAYS, self._arrays, strict=True):
            setattr(self, name, address_of(array))


_compute = library.kinpole_quantities
_compute.argtypes = [c_int, POINTER(Motion), *[c_void_p] * 3]
_compute.restype = None


def compute_quantity(what: int, motion: Motion) -> tuple[Complex, Real, np.ndarray]:
    """
    Compute a quantity with its covariance.

    Parameters
    ----------
    what : int
        Order of a pole, 1 to 4, that plus FREE, VELOCITY or CURVATURE.
    motion : Motion
        What it follows from.

    Returns
    -------
    value : (...) complex
        m, m/s or 1/m; a curvature is real.
    covariance : (..., 2, 2) float
        Its covariance; the variance of a curvature is its first element.
    flags : (...) uint8
        DETERMINED and MOVES.

    Raises
    ------
    ValueError
        If the motion lacks derivatives that the quantity needs.

    """
    needed = _NEEDED.get(what, what % FREE)
    if not 1 <= needed < motion.orders <= 5:
        raise ValueError(f'expected derivatives up to order {needed}, got {motion.orders - 1}')
    value, spread = np.empty(motion.shape, complex), np.empty((*motion.shape, 2, 2))
    flags = np.empty(motion.shape, np.uint8)
    _compute(what, byref(motion), address_of(value), address_of(spread), address_of(flags))
    return value, spread, flags
