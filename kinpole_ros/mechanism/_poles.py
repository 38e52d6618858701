"""The exact poles of a linkage's bodies, with the velocity u of the ICR and the curvature κ."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.mechanism._places import extent
from kinpole_ros.planar import centrode_curvature, icr_velocity, pole
from kinpole_ros.planar._plane import Complex, Real

# In sizes of the linkage: farther off a pole is at infinity but for rounding; an ICR that moves by
# less per rad stands still.
_INFINITY, _STILL = 1e9, 1e-9


class Poles(NamedTuple):
    """
    Of bodies (B) at T positions: `icr`, `iap`, `ijp` and `isp` (B, T), complex, m, in the ground's
    frame.

    `velocity` (B, T), complex, m/s, is that of the ICR along the centrodes, `curvature` (B, T),
    1/m, that of the fixed centrode. NaN where there is none: at infinity, at a dead point, and of
    curvatures where the ICR stands still.
    """

    icr: Complex
    iap: Complex
    ijp: Complex
    isp: Complex
    velocity: Complex
    curvature: Real


def poles(mechanism: Mechanism, motion: Motion) -> Poles:
    """
    The poles of all bodies in a motion.

    Parameters
    ----------
    mechanism
        The linkage.
    motion
        Up to the snap, (5, B, T).

    Returns
    -------
    Poles
        Of B bodies at T instants, complex, m, in the ground's frame.

    """
    position, angle = motion.position, motion.angle
    middle, size = extent(mechanism, motion.values[0])
    with np.errstate(all='ignore'):
        found = []
        for order in (1, 2, 3, 4):
            place = pole(order, position, angle).value
            near = np.abs(place - middle) < _INFINITY * size
            found.append(np.where(near, place, complex(np.nan, np.nan)))
        icr, iap, ijp, isp = found
        there, still = np.isfinite(icr), _STILL * size * np.abs(angle[1])
        velocity = np.where(there, icr_velocity(position, angle).value, complex(np.nan, np.nan))
        velocity = np.where(np.abs(velocity) < still, 0.0, velocity)
        bend = centrode_curvature(position, angle).value
        curvature = np.where(np.abs(velocity) > still, bend, np.nan)
    return Poles(icr, iap, ijp, isp, velocity, curvature)
