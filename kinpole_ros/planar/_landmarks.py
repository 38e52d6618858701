"""Rates, poles and centrode of bodies straight from the derivatives of landmarks (seed 000)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._centrode import centrode_curvature, icr_velocity
from kinpole_ros.planar._plane import ROUNDING, Complex, Real, check_vectors, to_complex, to_plane
from kinpole_ros.planar._poles import body_point_derivative, pole, rotation
from kinpole_ros.planar._uncertainty import Linear

_DERIVATIVES = ('velocities', 'accelerations', 'jerks', 'snaps')


@dataclass(frozen=True)
class LandmarkKinematics:
    """
    Planar kinematics of rigid bodies; NaN where undetermined.

    Attributes
    ----------
    angular_velocity, angular_acceleration, angular_jerk, angular_snap
        Of shape (...), rad/s to rad/s^4.
    icr, iap, ijp, isp
        Instant center of rotation and poles of acceleration, jerk and snap (..., 2), in the unit
        of the landmarks.
    icr_velocity
        Velocity of the ICR along the centrodes (..., 2), in that unit per s.
    centrode_curvature
        Signed curvature of the fixed centrode (...), in one over that unit.
    position, angle
        Weighted mean of the landmarks (5, ..., 2) and angle (5, ...) with their derivatives. The
        angle itself is 0.

    """

    angular_velocity: Real
    angular_acceleration: Real
    angular_jerk: Real
    angular_snap: Real
    icr: Real
    iap: Real
    ijp: Real
    isp: Real
    icr_velocity: Real
    centrode_curvature: Real
    position: Real
    angle: Real


def landmark_kinematics(
    points: ArrayLike,
    velocities: ArrayLike,
    accelerations: ArrayLike | None = None,
    jerks: ArrayLike | None = None,
    snaps: ArrayLike | None = None,
    weights: ArrayLike | None = None,
) -> LandmarkKinematics:
    """
    Rates, poles and centrode of rigid bodies from the derivatives of their landmarks.

    Parameters
    ----------
    points, velocities, accelerations, jerks, snaps
        Arrays (..., n, 2), in one unit of length and that unit per s to s^4.
    weights
        Weight of each landmark (..., n), >= 0; 1 by default. A landmark of weight 0 is not
        available, and its coordinates may be NaN.

    Returns
    -------
    LandmarkKinematics
        NaN for all that needs a derivative that is not given, a second distinct landmark, or a
        rotation where there is none within rounding.

    Raises
    ------
    ValueError
        For shapes that do not fit, negative weights, or a derivative without the one before it.

    Notes
    -----
    Seed 000, pages 1 to 3. Rates are moments of the derivatives about the mean landmark, poles are
    those of `pole`, the centrode is that of `icr_velocity` and `centrode_curvature`.

    Examples
    --------
    >>> still, moving = [0.0, 0.0], [0.0, 2.0]  # a rod that rotates about its first end
    >>> motion = landmark_kinematics([[0.0, 0.0], [1.0, 0.0]], [still, moving])
    >>> print(motion.angular_velocity, motion.icr)
    2.0 [0. 0.]

    """
    r = check_vectors(points, 'points')
    if r.ndim < 2:
        raise ValueError(f'points must have shape (..., n, 2), not {r.shape}')
    derivatives = _check_derivatives(r, (velocities, accelerations, jerks, snaps))
    position, angle, rounding = _mean_motion(derivatives, _check_weights(weights, r.shape[:-1]))
    missing = np.full((*position.shape[1:], 2), np.nan)
    poles = [missing] * 4
    for order in range(1, len(derivatives)):
        coefficient, partials = turn = rotation(order, angle)
        error = (np.abs(partials) * rounding[1 : order + 1]).sum(axis=0)
        poles[order - 1] = _where(np.abs(coefficient) > error, pole(order, position, angle, turn))
    velocity, curvature = _centrode(position, angle, rounding, len(derivatives) - 1)
    w, alpha, jerk, snap = angle[1:]
    icr, iap, ijp, isp = poles
    rates_and_poles = w, alpha, jerk, snap, icr, iap, ijp, isp
    return LandmarkKinematics(*rates_and_poles, velocity, curvature, to_plane(position), angle)


def _centrode(position: Complex, angle: Real, rounding: Real, order: int) -> tuple[Real, Real]:
    """Return the velocity of the ICR (..., 2) and the curvature of its path (...)."""
    velocity = np.full((*position.shape[1:], 2), np.nan)
    if order < 2:
        return velocity, velocity[..., 0]
    is_rotating = np.abs(angle[1]) > rounding[1]
    u = icr_velocity(position, angle)
    velocity = _where(is_rotating, u)
    if order < 3:
        return velocity, np.full(velocity.shape[:-1], np.nan)
    with np.errstate(invalid='ignore'):
        error = ROUNDING * (np.abs(position[1]) + np.abs(u.by_position[1] * position[2]))
        error += (np.abs(u.by_angle) * rounding[1:3]).sum(axis=0)
    is_moving = is_rotating & (np.abs(u.value) > error)
    return velocity, np.where(is_moving, centrode_curvature(position, angle).value.real, np.nan)


def _check_derivatives(points: Real, values: Sequence[ArrayLike | None]) -> list[Complex]:
    """Points and their derivatives (..., n) as far as they are given."""
    derivatives = [to_complex(points)]
    for order, (name, value) in enumerate(zip(_DERIVATIVES, values, strict=True), 1):
        if value is None:
            continue
        array = check_vectors(value, name)
        if array.shape != points.shape:
            raise ValueError(
                f'{name} must have the shape of points {points.shape}, not {array.shape}'
            )
        if order != len(derivatives):
            raise ValueError(f'{name} need {_DERIVATIVES[len(derivatives) - 1]} as well')
        derivatives.append(to_complex(array))
    return derivatives


def _check_weights(weights: ArrayLike | None, shape: tuple[int, ...]) -> Real:
    if weights is None:
        return np.ones(shape)
    f = np.asarray(weights, float)
    if np.any(f < 0) or not np.all(np.isfinite(f)):
        raise ValueError('weights must be finite and not negative')
    try:
        return np.broadcast_to(f, shape)
    except ValueError:
        raise ValueError(f'weights must have shape {shape}, not {f.shape}') from None


def im2kin2d(
    f: ArrayLike, r: ArrayLike, rd: ArrayLike, rdd: ArrayLike, rddd: ArrayLike
) -> tuple[float, Real, float, Real, float, Real, Real, float]:
    """
    Call `landmark_kinematics` with the arguments and results of the MATLAB function of seed 000.

    Parameters
    ----------
    f
        Weights (n,): 1 for a landmark that is available, 0 for one that is not.
    r, rd, rdd, rddd
        Positions of the landmarks (2, n) with their derivatives up to the jerk.

    Returns
    -------
    tuple
        w, rICR, wd, rIAP, wdd, rIJP, rdICR and kappa: rates in rad/s to rad/s^3, points (2,) in the
        unit of r, the velocity of the ICR, and the curvature of the fixed centrode.

    Raises
    ------
    ValueError
        For arrays of other shapes, and as `landmark_kinematics`.

    Notes
    -----
    Seed 000, pages 7 to 9, where it is printed as lm2kin2d. Undetermined results are NaN.

    """
    arrays = {'r': r, 'rd': rd, 'rdd': rdd, 'rddd': rddd}
    shape = 2, np.size(f)
    for name, array in arrays.items():
        if np.shape(array) != shape:
            raise ValueError(
                f'{name} must have shape {shape}, two rows and a column for each weight in f, not '
                f'{np.shape(array)}'
            )
    points, velocities, accelerations, jerks = (np.asarray(a, float).T for a in arrays.values())
    motion = landmark_kinematics(points, velocities, accelerations, jerks, weights=f)
    return (
        float(motion.angular_velocity),
        motion.icr,
        float(motion.angular_acceleration),
        motion.iap,
        float(motion.angular_jerk),
        motion.ijp,
        motion.icr_velocity,
        float(motion.centrode_curvature),
    )


def point_derivatives(kinematics: LandmarkKinematics, points: ArrayLike) -> tuple[Real, ...]:
    """
    Velocity, acceleration, jerk and snap of points of bodies.

    Parameters
    ----------
    kinematics
        From `landmark_kinematics`, of shape (...).
    points
        Present positions of points of the bodies (..., 2), in the unit of the landmarks.

    Returns
    -------
    tuple of ndarray
        Four of shape (..., 2), in that unit per s to s^4. NaN for orders whose derivatives were
        not given.

    Notes
    -----
    Seed 000, pages 1 and 2: w R (P - ICR), B (P - IAP), H (P - IJP) and G (P - ISP), computed from
    the mean landmark so that it holds for a body that does not rotate as well.

    """
    p = to_complex(check_vectors(points, 'points'))
    position = to_complex(kinematics.position)
    return tuple(
        to_plane(body_point_derivative(k, p, position, kinematics.angle)) for k in range(1, 5)
    )


def _mean_motion(derivatives: list[Complex], f: Real) -> tuple[Complex, Real, Real]:
    """
    Weighted mean landmark and angle with derivatives (5, ...), and the angle's rounding error.

    With landmarks c about their mean and S = sum(f |c|^2), the moment sum(f c x r(n)) / S is
    w, a, j - w^3 and s - 6 w^2 a for n = 1 to 4 (seed 000, pages 8 and 9).
    """
    seen = f > 0
    shape = f.shape[:-1]
    position = np.full((5, *shape), complex(np.nan, np.nan))
    angle = np.full((5, *shape), np.nan)
    rounding = np.full((5, *shape), np.nan)
    angle[0] = 0.0
    with np.errstate(divide='ignore', invalid='ignore'):
        total = f.sum(axis=-1)
        values = [np.where(seen, d, 0) for d in derivatives]
        for k, d in enumerate(values):
            position[k] = (f * d).sum(axis=-1) / total
        c = np.where(seen, derivatives[0] - position[0][..., None], 0)
        spread = (f * np.abs(c) ** 2).sum(axis=-1)
        size = np.sqrt(spread / total)
        distance = np.max(np.abs(values[0]), axis=-1, initial=0.0)
        spread = np.where(size > ROUNDING * distance, spread, np.nan)
        for k in range(1, len(derivatives)):
            relative = np.where(seen, derivatives[k] - position[k][..., None], 0)
            angle[k] = (f * (c.conj() * relative).imag).sum(axis=-1) / spread
            # Rounding of the derivatives, and of the arms, which are coarse far from the origin.
            largest = np.max(np.abs(values[k]), axis=-1, initial=0.0)
            rounding[k] = ROUNDING * (largest + distance * np.abs(angle[k])) / size
        if len(derivatives) > 3:
            angle[3] += angle[1] ** 3
        if len(derivatives) > 4:
            angle[4] += 6 * angle[1] ** 2 * angle[2]
    return position, angle, rounding


def _where(determined: np.ndarray, linear: Linear) -> Real:
    return np.where(determined[..., None], to_plane(linear.value), np.nan)
