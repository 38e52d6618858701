"""Poles, their motion and the inflection circle, and where they are determined."""

from ctypes import byref

import numpy as np

from kinpole_ros import planar
from kinpole_ros.core.bindings import (
    SIZES,
    Motion,
    address_of,
    codes_of,
    library,
    pass_new_array,
)
from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.tracking.values import POLE_NAMES

# What is computed: see codes.h. Poles have their order, 1 to 4, and FREE is added for a pole by the
# motion alone, whatever is known of pins.
QUANTITIES = codes_of('QUANTITIES')
VELOCITY, CURVATURE, CIRCLE_CENTER, CIRCLE_DIAMETER, FREE = (
    QUANTITIES[name]
    for name in ('VELOCITY', 'CURVATURE', 'CIRCLE_CENTER', 'CIRCLE_DIAMETER', 'FREE')
)
# The highest derivative that each of them needs; poles need their own order.
_NEEDED = {VELOCITY: 2, CURVATURE: 3, CIRCLE_CENTER: 2, CIRCLE_DIAMETER: 2}
# Bits of the flags: a quantity stands out of its noise; the ICR is seen to move.
_FLAGS = codes_of('QUANTITY_FLAGS')
DETERMINED, MOVES = _FLAGS['DETERMINED'], _FLAGS['MOVES']


def withheld_quantities(order: int) -> dict[int, str]:
    """
    Return the quantities that may be undetermined though the pose is known, and their names.

    They are those up to the derivative of `order` that have a reason of their own.
    """
    wanted = dict(enumerate(POLE_NAMES[:order], 1))
    if order >= 3:
        wanted[CURVATURE] = 'centrode_curvature'
    if order >= 2:
        wanted[CIRCLE_CENTER] = 'inflection_circle'
    return wanted


def motion_of(*arrays: np.ndarray) -> Motion:
    """
    Return derivatives of bodies at instants, of any shape (...), as `Motion` of motion.h.

    Parameters
    ----------
    *arrays : ndarray
        In the order of `Motion.elements`: position and angle (K, ...), derivatives from order 0 on,
        complex, m/s^k, and float, rad/s^k. Their covariances (K, K, ...) between the orders, of one
        coordinate. Diameters of the bodies (...), m. The pin (...) that each body turns about,
        complex, m, NaN for none, and the variance (...) of one of its coordinates, m^2. Reference,
        height and stamp (...) as in `Estimate`: messages need them, no quantity does. Why bodies
        have no motion (...), of REASONS; without it all have one.

    Returns
    -------
    Motion
        With its `shape`, and the arrays as `owners`.

    Raises
    ------
    ValueError
        If the shapes do not fit to each other.

    """
    motion = Motion()
    pairs = zip(arrays, Motion.elements.values(), strict=False)
    motion.owners = owners = [np.asarray(array, kind, order='C') for array, kind in pairs]
    position, angle, of_position, of_angle, *rest = owners
    motion.orders, *shape = angle.shape
    motion.shape, motion.poses = tuple(shape), rest[0].size
    motion.stride = motion.poses
    square, each = (motion.orders, *angle.shape), {array.shape for array in rest[:5]}
    if position.shape != angle.shape or each != {motion.shape}:
        raise ValueError(f'expected arrays of one shape, got {[a.shape for a in arrays]}')
    if of_position.shape != square or of_angle.shape != square:
        raise ValueError(f'expected covariances of shape {square}, got {of_position.shape}')
    for name, array in zip(Motion.elements, owners, strict=False):
        motion.bind(name, array)
    return motion


def compute_quantity(quantity: int, motion: Motion) -> tuple[Complex, Real, np.ndarray, np.ndarray]:
    """
    Compute a quantity with its covariance, and why it is undetermined.

    Parameters
    ----------
    quantity : int
        Order of a pole, 1 to 4, that plus FREE, or another of QUANTITIES.
    motion : Motion
        What it follows from.

    Returns
    -------
    value : (...) complex
        m, m/s or 1/m; a curvature and a diameter are real.
    covariance : (..., 2, 2) float
        Its covariance; the variance of a real one is its first element.
    flags : (...) uint8
        DETERMINED and MOVES.
    reasons : (...) uint8
        Numbers of REASONS.

    Raises
    ------
    ValueError
        If the motion lacks derivatives that the quantity needs.

    """
    needed = _NEEDED.get(quantity, quantity % FREE)
    if not 1 <= needed < motion.orders <= SIZES['HIGHEST'] + 1:
        raise ValueError(f'expected derivatives up to order {needed}, got {motion.orders - 1}')
    arrays = *_empty(motion.shape), np.empty(motion.shape, np.uint8)
    library.kinpole_quantities(quantity, byref(motion), *map(pass_new_array, arrays))
    return arrays


def compute_origins(motion: Motion) -> Complex:
    """Compute the origins (...) of the bodies' frames, m, as messages have them to the last bit."""
    origins = np.empty(motion.shape, complex)
    library.kinpole_origins(byref(motion), pass_new_array(origins))
    return origins


def relative_centers(motion: Motion, pairs: np.ndarray) -> tuple[Complex, Real, np.ndarray]:
    """
    Compute the instant centers of bodies with respect to others.

    Parameters
    ----------
    motion : Motion
        Of bodies (..., B).
    pairs : (2, P) int64
        The bodies j, and those i with respect to which their centers are.

    Returns
    -------
    tuple
        Arrays (..., P) as those of `compute_quantity`, without reasons.

    """
    *shape, bodies = motion.shape
    number = pairs.shape[1]
    arrays = _empty((*shape, number))
    if motion.poses:
        into = map(pass_new_array, arrays)
        library.kinpole_relative_centers(byref(motion), bodies, address_of(pairs), number, *into)
    return arrays


def ball_of_motion(position: Complex, angle: Real) -> Complex:
    """Return Ball's points (...), m, of bodies; `position` and `angle` are (4, ...) or more."""
    icr, u, du = (
        planar.to_plane(center.value)
        for center in (
            planar.pole(1, position, angle),
            planar.icr_velocity(position, angle),
            planar.icr_acceleration(position, angle),
        )
    )
    return planar.to_complex(planar.ball_point(angle[1], angle[2], icr, u, du))


def _empty(shape: tuple[int, ...]) -> tuple[Complex, Real, np.ndarray]:
    return np.empty(shape, complex), np.empty((*shape, 2, 2)), np.empty(shape, np.uint8)
