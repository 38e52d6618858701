"""
The effort that balances a load on a machine in motion, from its velocities as measured (seed 003).

What goes in at one port comes out at another, whatever is between them: neither the joints nor
bodies that carry no markers need be known. Friction and inertia are left out.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.planar._linear import Linear, variance
from kinpole_ros.planar._plane import Complex, Real


class Port(NamedTuple):
    """
    Where power goes in or out of a body, the index `body`.

    With a `point` (complex, m, of the body's frame, one or (...)) `effort` is a force there, N,
    complex in the ground's axes, one or (...); without, a torque, N m. Of an input only its
    direction counts, or its sign.
    """

    body: int
    effort: complex | Complex
    point: complex | Complex | None = None


def port_power(
    effort: complex | Complex, point: complex | Complex | None, position: Complex, angle: Real
) -> Linear:
    """
    Power (W) of a force at a point of a body, or of a torque where `point` is None, as in Port.

    `position` (K, ...) complex and `angle` (K, ...) hold the body's frame with its derivatives,
    K > 1. With an effort of 1 it is the velocity along it, m/s or rad/s.
    """
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
    The effort E that balances loads: the sum of their powers and of E times the input's rate is 0.

    `through` is the body and the rate of the input, `loads` those of each load with its power, as
    `port_power` gives them. Returns E once for each body, as it depends on that body; bodies are
    measured separately, so their variances add. Not finite where the input stands still.
    """
    _, rate = through
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        inverse = -1 / np.asarray(rate.value)
        effort = sum(power.value for _, power in loads) * inverse
        # dE = -(dP + E dv) / v; the loads' bodies have the first, the input's the second.
        parts = [(body, power, inverse) for body, power in loads]
        parts.append((through[0], rate, effort * inverse))
        found: dict[int, Linear] = {}
        for body, linear, factor in parts:
            by_position, by_angle = linear.by_position * factor, linear.by_angle * factor
            if body in found:
                by_position = by_position + found[body].by_position
                by_angle = by_angle + found[body].by_angle
            found[body] = linear._replace(value=effort, by_position=by_position, by_angle=by_angle)
    return found


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
    The effort that balances loads on a machine, from its velocities as measured.

    Parameters
    ----------
    through
        Where the effort acts; only its direction counts.
    loads
        What it balances.
    position, angle
        All bodies' frames with their derivatives, (K, B, ...), complex, m, and (K, B, ...), rad,
        K > 1.
    position_covariance, angle_covariance
        Between orders (K, K, B, ...), as in `covariance`.
    significant
        It is determined where the input's velocity is more than so many standard deviations from
        zero.

    Returns
    -------
    effort : ndarray
        Of shape (...), N or N m, positive along that of `through`.
    variance : ndarray
        Of shape (...), to first order.
    determined : ndarray
        Where it is, (...).

    Raises
    ------
    ValueError
        For an input without direction.

    Notes
    -----
    Virtual work, seed 003; friction and inertia are left out.

    """
    size = abs(through.effort) if through.point is not None else abs(np.real(through.effort))
    if not np.all((size > 0) & (size < np.inf)):
        raise ValueError('the input of a balance needs a direction: a force or torque not zero')

    def spread(body: int, linear: Linear) -> Real:
        return variance(linear, position_covariance[:, :, body], angle_covariance[:, :, body])

    unit = through._replace(effort=through.effort / size)
    rate, *powers = (
        port_power(port.effort, port.point, position[:, port.body], angle[:, port.body])
        for port in (unit, *loads)
    )
    by_body = balancing_effort(
        (through.body, rate),
        [(load.body, power) for load, power in zip(loads, powers, strict=True)],
    )
    value = by_body[through.body].value.real
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        noise = np.asarray(sum(spread(body, linear) for body, linear in by_body.items()))
        moving = np.abs(rate.value) > significant * np.sqrt(spread(through.body, rate))
    return value, noise, moving & np.isfinite(value) & np.isfinite(noise)
