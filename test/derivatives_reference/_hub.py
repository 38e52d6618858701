"""
The hub of a body: the point that it turns about.

With the angle a and the position z, the point c of the body is at z + c exp(i a). Where its path is
a low polynomial, with more evidence than all models of z, it is followed in place of z.
"""

from math import comb, factorial
from typing import NamedTuple

import numpy as np

from derivatives_reference._samples import Window
from kinpole_ros.planar._plane import Complex, Real

# Powers of time that are fitted, of which a path has at most as many less the degrees that its
# covariance has more.
_POWERS, _MORE = 7, 2
# Evidence that a coefficient of one coordinate costs, and the arm of both.
_COEFFICIENT, _ARM = 5.0, 10.0
# Turning exceeds that by the noise of the angle so many times.
_LEAST_TURNING = 16.0
# Most squares of the steps of the turning over those about its mean.
_MOST_STEPS = 3.5


class Hub(NamedTuple):
    """
    A hub, `arm` from the position at an angle of 0.

    `growth` is the variance of its noise over that of the position, `turning` the squares of what
    its path leaves of the turning, and `path` (K,) the turning that is on it at the instant.
    `moved` (n, 2) are its positions over their noise.
    """

    arm: complex
    growth: float
    turning: float
    path: Complex
    moved: Real


def find_hub(
    window: Window, samples: Real, weight: Real, radians: float, least: float
) -> Hub | None:
    """Find the hub of `samples` (n, 3), angles in `radians`, with more evidence than `least`."""
    count = len(samples)
    root = np.sqrt(weight.min(axis=1))
    present = np.count_nonzero(root)
    time = (np.arange(count) - window.at - (count - 1) / 2) / count
    columns = min(_POWERS, present)
    basis, factor = np.linalg.qr(root[:, None] * time[:, None] ** range(columns))
    position, turned = samples[:, 1] + 1j * samples[:, 2], np.exp(1j * radians * samples[:, 0])
    seen = turned[root > 0]
    steps = np.diff(turned)[(root[1:] > 0) & (root[:-1] > 0)]
    about_mean = present - abs(seen.sum()) ** 2 / present
    if np.vdot(steps, steps).real > _MOST_STEPS * about_mean:
        return None
    found = []
    for degree in range(_POWERS):
        own = basis[:, : degree + 1]
        z, e = (root * one - own @ (own.T @ (root * one)) for one in (position, turned))
        turning, noise = np.vdot(e, e).real, (present - degree - 1) * radians**2
        arm = -np.vdot(e, z) / (turning - noise)
        growth = 1 + abs(arm) ** 2 * radians**2
        value = present * (1 - np.log(growth)) - (np.abs(z + arm * e) ** 2).sum() / growth / 2
        found.append((value - 2 * _COEFFICIENT * degree, arm, growth, turning, noise))
    known = [
        found[degree + _MORE][4] > 0
        and found[degree + _MORE][3] > _LEAST_TURNING * found[degree + _MORE][4]
        for degree in range(_POWERS - _MORE)
    ]
    values = [one[0] if fits else -np.inf for one, fits in zip(found, known, strict=False)]
    degree = int(np.argmax(values))
    if not values[degree] > least + _ARM:
        return None
    _, arm, growth, turning, _ = found[degree + _MORE]
    moved = (position + arm * turned) / np.sqrt(growth)
    powers = np.zeros((window.orders, columns))
    for order in range(min(window.orders, columns)):
        powers[order, order] = factorial(order) / float(count) ** order
    stencil = (powers @ np.linalg.inv(factor))[:, : degree + 1]
    path = stencil @ (basis[:, : degree + 1].T @ (root * turned))
    return Hub(arm, growth, turning, path, np.stack((moved.real, moved.imag), 1))


def turning_of(angle: Real, radians: float) -> Complex:
    """Derivatives (K,) of exp(i angle), of an angle with derivatives (K,) in `radians`."""
    turn = [np.exp(1j * angle[0] * radians)]
    for n in range(1, len(angle)):
        turn.append(
            sum(comb(n - 1, k - 1) * angle[k] * radians * 1j * turn[n - k] for k in range(1, n + 1))
        )
    return np.array(turn)
