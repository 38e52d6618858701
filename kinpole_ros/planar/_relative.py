"""Motion of one body as seen from another: the relative rate and the relative instant center."""

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._linear import Linear
from kinpole_ros.planar._plane import Complex, Real, check_vectors


def relative_center(
    omega_j: ArrayLike, icr_j: ArrayLike, omega_i: ArrayLike, icr_i: ArrayLike
) -> Real:
    """
    Relative instant center of body j with respect to body i, seed 000, 'Relative velocity'.

    `omega_j`, `omega_i` (...) in rad/s; `icr_j`, `icr_i` (..., 2) in m, in the ground frame, as is
    the result (..., 2). NaN where the bodies turn alike within rounding, or where an ICR is NaN.
    """
    w_j, w_i = np.asarray(omega_j, float), np.asarray(omega_i, float)
    p_j, p_i = check_vectors(icr_j, 'icr_j'), check_vectors(icr_i, 'icr_i')
    difference = w_j - w_i
    rounding = 8 * np.finfo(float).eps * np.maximum(np.abs(w_j), np.abs(w_i))
    turning = np.where(np.abs(difference) > rounding, difference, np.nan)
    # Written from p_i, so that a far origin does not cost digits.
    return np.asarray(p_i + (w_j / turning)[..., None] * (p_j - p_i))


def relative_pole(
    position_j: Complex, angle_j: Real, position_i: Complex, angle_i: Real
) -> tuple[Linear, Linear]:
    """
    Relative instant center of body j with respect to body i, from both bodies' poses.

    Arguments as in `pole`, K > 1. Unlike `relative_center` it does not go through the two ICRs, so
    it holds where one of the bodies does not turn. Returns the center (complex, m) twice: as it
    depends on body j and as it depends on body i; their covariances add. Not finite where both turn
    alike. With q = i w z - v of each body it is (q_j - q_i) / (i w_ji).
    """
    w_j, w_i = angle_j[1], angle_i[1]
    between = position_j[0] - position_i[0]
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        # Not 1j / (w_j - w_i): of one pair that is a number, and Python refuses to divide by 0.
        q = 1 / (w_j - w_i)
        arm = (w_j * between + 1j * (position_j[1] - position_i[1])) * q
        by_j = {0: w_j * q + 0j, 1: 1j * q}
        by_i = {0: -w_i * q + 0j, 1: -1j * q}
        linear_j = Linear(position_i[0] + arm, by_j, {1: (between - arm) * q})
        linear_i = Linear(position_i[0] + arm, by_i, {1: arm * q})
    return linear_j, linear_i
