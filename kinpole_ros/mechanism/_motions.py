"""
The motion of a body up to snap, and of markers on it.

Points of the plane are complex numbers, z = x + i y. A body turned by θ carries its point w to
z + w e^{iθ}. SI units, rad, counterclockwise positive.
"""

from math import comb
from typing import NamedTuple

import numpy as np

ORDERS = 5
"""Position, velocity, acceleration, jerk, snap."""


class BodyMotion(NamedTuple):
    """A body's motion at the times asked for; row k of each array is the k-th time derivative.

    `position` is complex, (5, ...): the body's reference point z = x + i y, in m, m/s, ... m/s⁴.
    `angle` is real, (5, ...): the orientation, continuous over turns, in rad, rad/s, ... rad/s⁴.
    The last axes are those of the times.
    """

    position: np.ndarray
    angle: np.ndarray


def rotation_derivatives(angle: np.ndarray) -> np.ndarray:
    """
    e^{iθ} and its time derivatives.

    Parameters
    ----------
    angle
        θ and its own derivatives (orders, ...), rad.

    Returns
    -------
    ndarray
        Derivatives (orders, ...), complex.

    Notes
    -----
    Since (e^{iθ})' = i θ' e^{iθ}, Leibniz' rule gives each order from the ones below. At θ = 0 they
    are iω, iα − ω², i(ω̈ − ω³) − 3ωα, i(ω⃛ − 6ω²α) + ω⁴ − 4ωω̈ − 3α²: the matrices ωR, B, H, G
    of the poles.

    """
    result = np.empty(angle.shape, dtype=complex)
    result[0] = np.exp(1j * angle[0])
    for k in range(1, len(angle)):
        result[k] = 1j * sum(comb(k - 1, j) * angle[j + 1] * result[k - 1 - j] for j in range(k))
    return result


def marker_positions(motion: BodyMotion, body_points: np.ndarray) -> np.ndarray:
    """
    Positions of points fixed to a body, at the times of a motion.

    Parameters
    ----------
    motion
        The motion of the body at times (...).
    body_points
        Points (n, 2), m, from the body's reference point, along its own axes.

    Returns
    -------
    ndarray
        Positions (..., n, 2), m, in the ground's frame.

    """
    points = body_points[:, 0] + 1j * body_points[:, 1]
    placed = motion.position[0][..., None] + np.exp(1j * motion.angle[0])[..., None] * points
    return np.stack((placed.real, placed.imag), axis=-1)
