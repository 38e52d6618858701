"""
The force or torque that balances loads on a moving machine, by virtual work (seed 003, section 4).

The sum of the powers of all forces and torques is zero, whatever mechanism is between them, so
neither the joints nor the bodies without loads need be known. Friction and inertia are neglected.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._plane import Complex, Real
from kinpole_ros.planar._uncertainty import Linear, variance


class Port(NamedTuple):
    """
    A force or torque on a body.

    Attributes
    ----------
    body
        Index of the body.
    effort
        With a `point` a force, N, complex in the ground's axes; without one a torque, N m. One
        number or (...). Of the balancing input only its direction or sign counts.
    point
        Where the force acts, complex, m, in the body's frame, one number or (...); None for a
        torque.

    """

    body: int
    effort: complex | Complex
    point: complex | Complex | None = None


def port_power(
    effort: complex | Complex, point: complex | Complex | None, position: Complex, angle: Real
) -> Linear:
    """Power (...), W, of an effort as in Port; with an effort of size 1 the velocity along it."""
    orders = slice(1, 2), slice(0, 2)
    by_position = np.zeros((1, *np.shape(angle[1])), complex)
    if point is None:
        by_angle = np.zeros((2, *np.shape(angle[1])), complex)
        by_angle[1] = np.real(effort)
        return Linear(np.real(effort) * angle[1], by_position, by_angle, *orders)
    arm = point * np.exp(1j * angle[0])
    along = np.conj(effort)
    by_position[0] = along
    by_angle = along * np.array((-angle[1] * arm, 1j * arm))
    value = (along * (position[1] + 1j * angle[1] * arm)).real
    return Linear(value, by_position, by_angle, *orders)


def balancing_effort(
    through: tuple[int, Linear], loads: Sequence[tuple[int, Linear]]
) -> dict[int, Linear]:
    """
    The effort E = -sum(P) / v that balances loads of power P at an input of rate v, by body.

    Each has the partial derivatives by the pose of its body, dE = -(dP + E dv) / v. Bodies are
    measured independently, so their variances add. Not finite where v = 0.
    """
    _, rate = through
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        inverse = -1 / np.asarray(rate.value)
        effort = sum(power.value for _, power in loads) * inverse
        terms = [(body, power, inverse) for body, power in loads]
        terms.append((through[0], rate, effort * inverse))
        by_body: dict[int, Linear] = {}
        for body, linear, factor in terms:
            by_position, by_angle = linear.by_position * factor, linear.by_angle * factor
            if body in by_body:
                by_position = by_position + by_body[body].by_position
                by_angle = by_angle + by_body[body].by_angle
            by_body[body] = linear._replace(
                value=effort, by_position=by_position, by_angle=by_angle
            )
    return by_body


def measured_balance(
    through: Port,
    loads: Sequence[Port],
    position: Complex,
    angle: Real,
    position_covariance: Real,
    angle_covariance: Real,
    significant: float = 3.0,
) -> tuple[Real, Real, np.ndarray]:
    """
    The effort that balances loads on a machine, from its measured velocities.

    Parameters
    ----------
    through
        Where the balancing effort acts. Only its direction counts.
    loads
        Forces and torques to be balanced.
    position, angle
        Frames of all bodies with their derivatives, (K, B, ...), complex, m, and (K, B, ...), rad;
        K > 1.
    position_covariance, angle_covariance
        Between the orders (K, K, B, ...), as in `covariance`.
    significant
        Standard deviations that the input's velocity must be away from zero.

    Returns
    -------
    effort : ndarray
        Of shape (...), N or N m, positive in the direction of `through`.
    variance : ndarray
        Of shape (...), to first order.
    determined : ndarray
        Where the input's velocity is significant and the results are finite (...), bool.

    Raises
    ------
    ValueError
        For an input without direction.

    Notes
    -----
    Virtual work, sum(F . v) + sum(T w) = 0: seed 003, section 4.

    """
    unit = _unit_port(through)
    rate, *powers = (
        port_power(port.effort, port.point, position[:, port.body], angle[:, port.body])
        for port in (unit, *loads)
    )
    loaded = [(load.body, power) for load, power in zip(loads, powers, strict=True)]
    by_body = balancing_effort((through.body, rate), loaded)
    value = by_body[through.body].value.real
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        total, of_rate = (
            _variance_of(parts, position_covariance, angle_covariance)
            for parts in (by_body, {through.body: rate})
        )
        is_moving = np.abs(rate.value) > significant * np.sqrt(of_rate)
    return value, total, is_moving & np.isfinite(value) & np.isfinite(total)


def _variance_of(by_body: Mapping[int, Linear], position: Real, angle: Real) -> Real:
    """Variance (...) of a sum over bodies, by the covariances (K, K, B, ...) of their poses."""
    return np.asarray(
        sum(variance(part, position[:, :, b], angle[:, :, b]) for b, part in by_body.items())
    )


def _unit_port(port: Port) -> Port:
    """Return a port with a force of 1 N or a torque of 1 N m; raise ValueError for none."""
    size = abs(port.effort) if port.point is not None else abs(np.real(port.effort))
    if not np.all((size > 0) & (size < np.inf)):
        raise ValueError('the input of a balance needs a direction: a force or torque not zero')
    return port._replace(effort=port.effort / size)
