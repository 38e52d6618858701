"""The seeds' own method: rates and poles straight from the derivatives of landmarks (seed 000)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._centrode import centrode_curvature, icr_velocity
from kinpole_ros.planar._linear import Linear
from kinpole_ros.planar._plane import ROUNDING, Complex, Real, check_vectors, to_complex, to_plane
from kinpole_ros.planar._poles import (
    body_point_derivative,
    pole,
    rotation,
)


@dataclass(frozen=True)
class LandmarkKinematics:
    """
    Planar kinematics of bodies, each field of shape (...) or (..., 2); NaN where undetermined.

    Rates in rad/s, rad/s^2, rad/s^3 and rad/s^4; poles in the unit of the points; `icr_velocity`
    in that unit per second; `centrode_curvature` in its inverse. `position` (5, ..., 2) and `angle`
    (5, ...) are the weighted mean of the landmarks and the angle with their derivatives, order
    first.
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
    Rates, poles and centrode of rigid bodies from the derivatives of their landmarks (seed 000).

    Parameters
    ----------
    points, velocities, accelerations, jerks, snaps
        Arrays (..., n, 2), in one unit of length and its rates by the second.
    weights
        How far each landmark counts (..., n), >= 0; 0 is not available, and its numbers may then be
        anything, NaN included.

    Returns
    -------
    LandmarkKinematics
        NaN where something is lacking: a derivative that is not given, a second distinct landmark,
        or a turn, where there is none within rounding.

    Raises
    ------
    ValueError
        For shapes that do not fit, negative weights, or a derivative without the one before it.

    Examples
    --------
    >>> still, moving = [0.0, 0.0], [0.0, 2.0]  # a rod that turns about its first end
    >>> motion = landmark_kinematics([[0.0, 0.0], [1.0, 0.0]], [still, moving])
    >>> print(motion.angular_velocity, motion.icr)
    2.0 [0. 0.]

    """
    r = check_vectors(points, 'points')
    if r.ndim < 2:
        raise ValueError(f'points must have shape (..., n, 2), not {r.shape}')
    if weights is None:
        f = np.ones(r.shape[:-1])
    else:
        f = np.asarray(weights, float)
        if np.any(f < 0) or not np.all(np.isfinite(f)):
            raise ValueError('weights must be finite and not negative')
        try:
            f = np.broadcast_to(f, r.shape[:-1])
        except ValueError:
            raise ValueError(f'weights must have shape {r.shape[:-1]}, not {f.shape}') from None
    given: list[Complex] = [to_complex(r)]
    names = ('velocities', 'accelerations', 'jerks', 'snaps')
    values = (velocities, accelerations, jerks, snaps)
    for name, value in zip(names, values, strict=True):
        if value is None:
            continue
        array = check_vectors(value, name)
        if array.shape != r.shape:
            raise ValueError(f'{name} must have the shape of points {r.shape}, not {array.shape}')
        if names.index(name) != len(given) - 1:
            raise ValueError(f'{name} need {names[len(given) - 1]} as well')
        given.append(to_complex(array))
    position, angle, error = _rates(given, f)

    missing = np.full(position.shape[1:], complex(np.nan, np.nan))
    poles = []
    for order in range(1, 5):
        if order >= len(given):
            poles.append(to_plane(missing))
            continue
        turn = denominator, partials = rotation(order, angle)
        rounding = (np.abs(partials) * error[1 : order + 1]).sum(axis=0)
        found = pole(order, position, angle, turn)
        poles.append(_where(np.abs(denominator) > rounding, found))
    turning = np.abs(angle[1]) > error[1]
    velocity, curvature = to_plane(missing), missing.real
    if len(given) > 2:
        u = icr_velocity(position, angle)
        velocity = _where(turning, u)
        with np.errstate(invalid='ignore'):
            speed_rounding = ROUNDING * (
                np.abs(position[1]) + np.abs(u.by_position[1] * position[2])
            ) + (np.abs(u.by_angle) * error[1:3]).sum(axis=0)
        if len(given) > 3:
            moves = turning & (np.abs(u.value) > speed_rounding)
            value = centrode_curvature(position, angle).value.real
            curvature = np.where(moves, value, np.nan)
    return LandmarkKinematics(
        angular_velocity=angle[1],
        angular_acceleration=angle[2],
        angular_jerk=angle[3],
        angular_snap=angle[4],
        icr=poles[0],
        iap=poles[1],
        ijp=poles[2],
        isp=poles[3],
        icr_velocity=velocity,
        centrode_curvature=curvature,
        position=to_plane(position),
        angle=angle,
    )


def im2kin2d(
    f: ArrayLike, r: ArrayLike, rd: ArrayLike, rdd: ArrayLike, rddd: ArrayLike
) -> tuple[float, Real, float, Real, float, Real, Real, float]:
    """
    Call `landmark_kinematics` as the MATLAB function of seed 000 is called.

    Parameters
    ----------
    f
        Weights (n,): 1 for a landmark that is available, 0 for one that is not.
    r, rd, rdd, rddd
        Places and derivatives of the landmarks to the jerk (2, n).

    Returns
    -------
    tuple
        w, rICR, wd, rIAP, wdd, rIJP, rdICR and kappa: rates in rad/s to rad/s^3, points (2,) in the
        unit of r, the velocity of the ICR, and the curvature of the fixed centrode.

    Raises
    ------
    ValueError
        As `landmark_kinematics`.

    Notes
    -----
    Seed 000, pages 7 to 9 (printed lm2kin2d). What is undetermined is NaN, not an error.

    """
    points, *rates = (np.asarray(part, float).T for part in (r, rd, rdd, rddd))
    found = landmark_kinematics(points, rates[0], rates[1], rates[2], weights=f)
    return (
        float(found.angular_velocity),
        found.icr,
        float(found.angular_acceleration),
        found.iap,
        float(found.angular_jerk),
        found.ijp,
        found.icr_velocity,
        float(found.centrode_curvature),
    )


def point_derivatives(kinematics: LandmarkKinematics, points: ArrayLike) -> tuple[Real, ...]:
    """
    Velocity, acceleration, jerk and snap of points of bodies.

    Parameters
    ----------
    kinematics
        What `landmark_kinematics` gives, of shape (...).
    points
        Where the bodies' points are now (..., 2), in the unit of the landmarks.

    Returns
    -------
    tuple of ndarray
        Four of shape (..., 2), in that unit per s to s^4; NaN in the orders whose derivatives were
        not given.

    Notes ----- Seed 000: wR(P - ICR), B(P - IAP), H(P - IJP), G(P - ISP), written so that it holds
    for a body that does not turn as well.

    """
    p = to_complex(check_vectors(points, 'points'))
    position = to_complex(kinematics.position)
    return tuple(
        to_plane(body_point_derivative(k, p, position, kinematics.angle)) for k in range(1, 5)
    )


def _rates(given: list[Complex], f: Real) -> tuple[Complex, Real, Real]:
    """Mean landmark and angle with derivatives, (5, ...), and the rounding error of the latter."""
    seen = f > 0
    shape = f.shape[:-1]
    position = np.full((5, *shape), complex(np.nan, np.nan))
    angle = np.full((5, *shape), np.nan)
    error = np.full((5, *shape), np.nan)
    angle[0] = 0.0
    with np.errstate(divide='ignore', invalid='ignore'):
        total = f.sum(axis=-1)
        means = [np.where(seen, d, 0) for d in given]
        for k, d in enumerate(means):
            position[k] = (f * d).sum(axis=-1) / total
        c = np.where(seen, given[0] - position[0][..., None], 0)
        spread = (f * np.abs(c) ** 2).sum(axis=-1)
        size = np.sqrt(spread / total)
        far = np.max(np.abs(means[0]), axis=-1, initial=0.0)
        distinct = size > ROUNDING * far
        spread = np.where(distinct, spread, np.nan)
        for k in range(1, len(given)):
            relative = np.where(seen, given[k] - position[k][..., None], 0)
            angle[k] = (f * (c.conj() * relative).imag).sum(axis=-1) / spread
            # Rounding of the derivatives, and of the arms, which a far origin makes coarse.
            largest = np.max(np.abs(means[k]), axis=-1, initial=0.0)
            error[k] = ROUNDING * (largest + far * np.abs(angle[k])) / size
        if len(given) > 3:
            angle[3] += angle[1] ** 3
        if len(given) > 4:
            angle[4] += 6 * angle[1] ** 2 * angle[2]
    return position, angle, error


def _where(determined: np.ndarray, linear: Linear) -> Real:
    return np.where(determined[..., None], to_plane(linear.value), np.nan)
