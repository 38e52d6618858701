"""
Curvature of the paths of a body's points: circles, cubic, and Ball's point of an instant.

All follow from the ICR P, its velocity u along the centrodes, the angular velocity w, and one order
higher the angular acceleration a and the acceleration du of the ICR. With r = A - P, the body's
point A has the velocity i w r and the acceleration (i a - w^2) r - i w u. The inflection pole is
J = P - i u / w. Formulas are derived from these two in the notes; O. Bottema and B. Roth,
Theoretical Kinematics (1979), chapter VIII, have them in the canonical frame of P, u and J.

The motion of the ground as seen from the body has the same ICR: see `inverse_motion`. With it the
functions give what belongs to the moving centrode: the body's point to a center of curvature, and
Burmester's cubic of centers.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kinpole_ros.planar._plane import ROUNDING, Complex, Real, check_vectors, to_complex, to_plane


class Circle(NamedTuple):
    """A circle through the ICR: `center` (..., 2), m, and `diameter` (...), m."""

    center: Real
    diameter: Real


class BresseCircles(NamedTuple):
    """
    Where accelerations are along the path, and where across it.

    `inflection`: points without normal acceleration, whose paths are straight at the instant;
    `tangential`: points without tangential acceleration. They meet in the ICR and in the IAP,
    `iap` (..., 2), m.
    """

    inflection: Circle
    tangential: Circle
    iap: Real


class PathCurvature(NamedTuple):
    """Signed `curvature` (...), 1/m, left along the velocity, and `center` (..., 2), m."""

    curvature: Real
    center: Real


class StationaryCurvature(NamedTuple):
    """
    The cubic of points whose paths keep their curvature to the next order.

    In polar coordinates about `icr` (..., 2), m, from the direction `tangent` (..., 2) of its
    velocity, it is 1/r = over_m / sin(phi) + over_n / cos(phi), with `over_m` and `over_n` (...),
    1/m. Where `over_n` is 0, it is a circle and the normal; where `over_m` is, a circle and the
    tangent.
    """

    icr: Real
    tangent: Real
    over_m: Real
    over_n: Real

    @np.errstate(divide='ignore', invalid='ignore', over='ignore')
    def points(self, phi: ArrayLike) -> Real:
        """Return the points (..., K, 2) in the directions `phi` (K,), rad, from the tangent."""
        sine, cosine = np.sin(phi), np.cos(phi)
        over_r = self.over_m[..., None] * cosine + self.over_n[..., None] * sine
        radius = sine * cosine / over_r
        direction = to_complex(self.tangent)[..., None] * (cosine + 1j * sine)
        return to_plane(to_complex(self.icr)[..., None] + radius * direction)


class BobillierAxis(NamedTuple):
    """
    Bobillier's construction from two points of a body and the centers of their paths.

    `icr` (..., 2) is where both rays cross, `crossing` (..., 2) where the line of the points meets
    that of the centers, m. `axis` and `tangent` (..., 2) are unit vectors along the collineation
    axis and the tangent of the centrodes; their signs mean nothing.
    """

    icr: Real
    crossing: Real
    axis: Real
    tangent: Real


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def inflection_circle(
    angular_velocity: ArrayLike, icr: ArrayLike, icr_velocity: ArrayLike
) -> Circle:
    """
    Circle of the points of a body whose paths are straight at the instant.

    Parameters
    ----------
    angular_velocity
        Of the body (...), rad/s.
    icr, icr_velocity
        Instant center (..., 2), m, and its velocity along the centrodes (..., 2), m/s.

    Returns
    -------
    Circle
        The point `icr` where that stands still; NaN where the body does not turn.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    Its points have no acceleration across their velocity, |r|^2 = Im(conj(r) u) / w: the circle
    with the diameter from P to J = P - i u / w. It touches u in P.

    Examples
    --------
    A wheel of radius 0.5 m on the ground: its center moves on a straight line.

    >>> circle = inflection_circle(-2.0, [3.0, 0.0], [1.0, 0.0])
    >>> print(circle.center, circle.diameter)
    [3.   0.25] 0.5

    """
    w, p, u = _motion(angular_velocity, icr, icr_velocity)
    return _circle(p, -1j * u / w)


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def path_curvature(
    point: ArrayLike, angular_velocity: ArrayLike, icr: ArrayLike, icr_velocity: ArrayLike
) -> PathCurvature:
    """
    Curvature of the path of a body's point, by the equation of Euler and Savary.

    Parameters
    ----------
    point
        Where the body's point is (..., 2), m.
    angular_velocity, icr, icr_velocity
        As for `inflection_circle`.

    Returns
    -------
    PathCurvature
        NaN where the point stands still, and the center where the path is straight.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    Im(conj(v) a) / |v|^3 with the velocity v and acceleration a of the point, which is
    sign(w) Re(conj(r) (A - J)) / |r|^3; the center is A - r |r|^2 / Re(conj(r) (A - J)). With the
    distances PA, PA0 and JA along the ray this is PA^2 = A0A JA.

    Examples
    --------
    The top of a wheel of radius 0.5 m runs on a cycloid, of radius 2 m there.

    >>> print(path_curvature([3.0, 1.0], -2.0, [3.0, 0.0], [1.0, 0.0]).center)
    [ 3. -1.]

    """
    w, p, u = _motion(angular_velocity, icr, icr_velocity)
    a = to_complex(check_vectors(point, 'point'))
    r = a - p
    across = (r.conj() * (r + 1j * u / w)).real
    square = np.abs(r) ** 2
    curvature = np.sign(w) * across / (square * np.abs(r))
    center = a - r * np.where(across == 0, np.nan, square / across)
    return PathCurvature(np.asarray(curvature), to_plane(center))


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def bresse_circles(
    angular_velocity: ArrayLike,
    angular_acceleration: ArrayLike,
    icr: ArrayLike,
    icr_velocity: ArrayLike,
) -> BresseCircles:
    """
    Circles of the points without normal and without tangential acceleration.

    Parameters
    ----------
    angular_velocity, angular_acceleration
        Of the body (...), rad/s and rad/s^2.
    icr, icr_velocity
        As for `inflection_circle`.

    Returns
    -------
    BresseCircles
        The tangential one NaN where the body turns evenly: there it is the normal of the centrodes.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    Re(conj(v) a) = 0 is |r|^2 = (w / a) Re(conj(r) u), the circle from P to P + (w / a) u. The
    acceleration vanishes at r = i w u / (i a - w^2), the IAP.

    """
    w, p, u = _motion(angular_velocity, icr, icr_velocity)
    a = _nonzero(angular_acceleration)
    iap = p + 1j * w * u / (1j * np.asarray(angular_acceleration, float) - w * w)
    return BresseCircles(_circle(p, -1j * u / w), _circle(p, w / a * u), to_plane(iap))


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def stationary_curvature(
    angular_velocity: ArrayLike,
    angular_acceleration: ArrayLike,
    icr: ArrayLike,
    icr_velocity: ArrayLike,
    icr_acceleration: ArrayLike,
) -> StationaryCurvature:
    """
    Cubic of the points whose paths have stationary curvature: four-point contact with a circle.

    Parameters
    ----------
    angular_velocity, angular_acceleration
        Of the body (...), rad/s and rad/s^2.
    icr, icr_velocity, icr_acceleration
        Instant center (..., 2), m, and its derivatives by time (..., 2), m/s and m/s^2.

    Returns
    -------
    StationaryCurvature
        NaN where the body does not turn, or its ICR stands still.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    The curvature of `path_curvature` has no rate along the path of a body's point. With dr/dt =
    i w r - u it is so where, in coordinates x along u and y to the left of it,

        (x^2 + y^2) (x (2 - du_y / (w |u|)) + y (du_x / (w |u|) - a / w^2)) = -3 (|u| / w) x y.

    The cubic of the inverse motion has the centers of these paths: Burmester's curve of centers.

    """
    w, p, u = _motion(angular_velocity, icr, icr_velocity)
    across, change = _turning_tangent(w, angular_acceleration, u, icr_acceleration)
    speed = _nonzero(np.abs(u))
    tangent = u / speed
    # 2 - du_y / (w |u|) and du_x / (w |u|) - a / w^2, times the speed.
    x = _sum(2 * speed, -(change * tangent.conj()).imag)
    y = (_sum(change, across) * tangent.conj()).real
    factor = -w / (3 * speed * speed)
    return StationaryCurvature(to_plane(p), to_plane(tangent), factor * x, factor * y)


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def ball_point(
    angular_velocity: ArrayLike,
    angular_acceleration: ArrayLike,
    icr: ArrayLike,
    icr_velocity: ArrayLike,
    icr_acceleration: ArrayLike,
) -> Real:
    """
    Ball's point, whose path is straight to one order more than those of the inflection circle.

    Parameters
    ----------
    angular_velocity, angular_acceleration, icr, icr_velocity, icr_acceleration
        As for `stationary_curvature`.

    Returns
    -------
    ndarray
        Of shape (..., 2), m. NaN where the body does not turn, and where all points of the
        inflection circle are such points, as for a wheel that rolls in one of twice its radius.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    Where the cubic of stationary curvature meets the inflection circle besides P: along
    g = i u + d(u / w)/dt from P, as far as the circle goes.

    """
    w, p, u = _motion(angular_velocity, icr, icr_velocity)
    g = _sum(*_turning_tangent(w, angular_acceleration, u, icr_acceleration))
    square = _nonzero(np.abs(g) ** 2)
    return to_plane(p + g * (g.conj() * u).imag / (w * square))


def inverse_motion(
    angular_velocity: ArrayLike,
    angular_acceleration: ArrayLike,
    icr: ArrayLike,
    icr_velocity: ArrayLike,
    icr_acceleration: ArrayLike,
) -> tuple[Real, Real, Real, Real, Real]:
    """
    The motion of the ground as seen from the body, in the axes of the ground at the instant.

    Parameters
    ----------
    angular_velocity, angular_acceleration, icr, icr_velocity, icr_acceleration
        As for `stationary_curvature`.

    Returns
    -------
    tuple of ndarray
        The same five of the inverse motion, whose fixed centrode is the moving one of the body.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    Both centrodes have the velocity u (seed 001, eq. 15); seen from the body, u turns by w less.

    """
    w, p, u = _motion(angular_velocity, icr, icr_velocity)
    du = to_complex(check_vectors(icr_acceleration, 'icr_acceleration'))
    rates = -np.asarray(angular_velocity, float), -np.asarray(angular_acceleration, float)
    return *rates, to_plane(p), to_plane(u), to_plane(du - 1j * w * u)


@np.errstate(divide='ignore', invalid='ignore', over='ignore')
def bobillier_axis(
    point: ArrayLike, center: ArrayLike, other_point: ArrayLike, other_center: ArrayLike
) -> BobillierAxis:
    """
    Pole, collineation axis and pole tangent from two points of a body and their centers.

    Parameters
    ----------
    point, other_point
        Points A and B of the body (..., 2), m.
    center, other_center
        Centers of curvature A0 and B0 of their paths (..., 2), m.

    Returns
    -------
    BobillierAxis
        NaN where two lines that should cross are parallel.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    The ICR is where A0A crosses B0B, and the axis goes from there to where AB crosses A0B0.
    Bobillier's theorem: the tangent makes with one ray the angle that the axis makes with the
    other, with the opposite sense.

    """
    a, a0 = to_complex(check_vectors(point, 'point')), to_complex(check_vectors(center, 'center'))
    b = to_complex(check_vectors(other_point, 'other_point'))
    b0 = to_complex(check_vectors(other_center, 'other_center'))
    p, q = _crossing(a, a - a0, b, b - b0), _crossing(a, b - a, a0, b0 - a0)
    axis = (q - p) / np.abs(q - p)
    tangent = (a - a0) * (b - b0) * axis.conj()
    return BobillierAxis(*map(to_plane, (p, q, axis, tangent / np.abs(tangent))))


def _motion(
    angular_velocity: ArrayLike, icr: ArrayLike, icr_velocity: ArrayLike
) -> tuple[Real, Complex, Complex]:
    """Return w (...), NaN where it is 0, and P and u (...)."""
    p = to_complex(check_vectors(icr, 'icr'))
    return _nonzero(angular_velocity), p, to_complex(check_vectors(icr_velocity, 'icr_velocity'))


def _nonzero(value: ArrayLike) -> Real:
    number = np.asarray(value, float)
    return np.where(number == 0, np.nan, number)


def _circle(p: Complex, diameter: Complex) -> Circle:
    """Return the circle that a diameter from P spans."""
    return Circle(to_plane(p + diameter / 2), np.asarray(np.abs(diameter)))


def _turning_tangent(
    w: Real, angular_acceleration: ArrayLike, u: Complex, icr_acceleration: ArrayLike
) -> tuple[Complex, Complex]:
    """Return i u and d(u / w)/dt (...), m/s."""
    du = to_complex(check_vectors(icr_acceleration, 'icr_acceleration'))
    a = np.asarray(angular_acceleration, float)
    return 1j * u, (du - a / w * u) / w


def _sum(*terms: Complex) -> Complex:
    """Return the sum of terms, 0 where it is within their rounding."""
    total, size = sum(terms), sum(map(np.abs, terms))
    return np.where(np.abs(total) > ROUNDING * size, total, 0.0)


def _crossing(a: Complex, along_a: Complex, b: Complex, along_b: Complex) -> Complex:
    """Return where two lines cross, each of a point and a direction."""
    sine = (along_a.conj() * along_b).imag
    is_parallel = np.abs(sine) <= ROUNDING * np.abs(along_a) * np.abs(along_b)
    ratio = ((b - a).conj() * along_b).imag / np.where(is_parallel, np.nan, sine)
    return np.asarray(a + along_a * ratio)
