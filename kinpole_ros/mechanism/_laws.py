"""
Cams and Geneva drives: one variable that follows another by a law, with four exact derivatives.

A law is a function of an angle (T,), rad, that gives its value and derivatives by it (5, T). Where
these jump, as jerks do at the ends of a dwell, they are those just after.
"""

from collections.abc import Callable, Sequence
from math import comb, pi
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._drive import quintics, spline
from kinpole_ros.planar._plane import Real

_ORDERS = 5  # position to snap
Function = Callable[[Real], Real]
# Rises from 0 to 1 over 0 to 1 as polynomials, by rising powers.
_POLYNOMIALS = {
    '3-4-5': (0, 0, 0, 10, -15, 6),
    '4-5-6-7': (0, 0, 0, 0, 35, -84, 70, -20),
}
RISES = ('cycloidal', 'harmonic', *_POLYNOMIALS, 'spline')


class Law(NamedTuple):
    """
    A variable, or the difference of two, as a function of another: row @ u = function(of @ u).

    `name` is for people, `row` and `of` are (n,). The function depends on where points with the
    names `hubs` are.
    """

    name: str
    row: Real
    of: Real
    function: Function
    hubs: tuple[str, ...]


def compose(outer: Real, inner: Real) -> Real:
    """Derivatives (k, T) of f(g) from those of f by its argument (k or more, T) and of g (k, T)."""
    found = [outer[0]]
    if len(inner) > 1:
        slope = compose(outer[1:], inner[:-1])
        for k in range(1, len(inner)):
            found.append(sum(comb(k - 1, j) * slope[j] * inner[k - j] for j in range(k)))
    return np.stack(found)


def geneva(slots: int, start: float, offset: float) -> Function:
    """
    The angle of a Geneva wheel over that of its crank, rad, through engagement and dwell.

    At the angle `start` the pin is on the line of centers and the wheel at `offset`. With
    z = e^{iψ} sin(π/slots), ψ from `start` on, the slot points along 1 - z.
    """
    engaged, share = pi / 2 - pi / slots, np.sin(pi / slots)

    def function(at: Real) -> Real:
        turns = np.round((at - start) / (2 * pi))
        psi = at - start - 2 * pi * turns
        z = share * np.exp(1j * psi)
        found = np.zeros((_ORDERS, *np.shape(at)))
        inside = (psi >= -engaged) & (psi < engaged)
        found[0] = np.where(inside, np.angle(1 - z), -np.sign(psi) * pi / slots)
        found[0] += offset - 2 * pi / slots * turns
        # The derivatives of log(1 - z) are polynomials of q = z / (1 - z), as q' = i q (1 + q).
        slope, q = np.polynomial.Polynomial((0, 1j, 1j)), z / (1 - z)
        power = np.polynomial.Polynomial((0, -1j))
        for k in range(1, _ORDERS):
            found[k] = np.where(inside, power(q).imag, 0.0)
            power = power.deriv() * slope
        return found

    return function


def cam(angles: Sequence[float], lifts: Sequence[float], rise: str) -> Function:
    """
    The lift of a cam's follower over the cam's angle, from a table that goes once round.

    From each of the rising `angles` (rad) to the next, the last 2π after the first, the lift goes
    from one of `lifts` to the next by one of RISES; 'spline' goes through all of them with four
    continuous derivatives.
    """
    knots, steps = np.array(angles), np.diff(lifts)
    widths = np.diff(knots)
    pieces = quintics(knots, np.array(lifts), closed=True) if rise == 'spline' else None

    def function(at: Real) -> Real:
        here = knots[0] + np.mod(at - knots[0], 2 * pi)
        if pieces is not None:
            return spline(knots, pieces, here)
        piece = np.clip(np.searchsorted(knots, here, side='right') - 1, 0, len(steps) - 1)
        found = _rise(rise, (here - knots[piece]) / widths[piece])
        found *= steps[piece] / widths[piece] ** np.arange(_ORDERS).reshape(-1, *[1] * here.ndim)
        found[0] += np.array(lifts)[piece]
        return found

    return function


def _rise(law: str, x: Real) -> Real:
    """A rise from 0 to 1 over `x` from 0 to 1, and its derivatives (5, T)."""
    orders = range(_ORDERS)
    if law in _POLYNOMIALS:
        rise = np.polynomial.Polynomial(_POLYNOMIALS[law])
        return np.stack([rise.deriv(k)(x) if k else rise(x) for k in orders])
    if law == 'harmonic':
        found = np.stack([-(pi**k) / 2 * np.cos(pi * x + k * pi / 2) for k in orders])
        found[0] += 0.5
        return found
    found = np.stack([-((2 * pi) ** (k - 1)) * np.sin(2 * pi * x + k * pi / 2) for k in orders])
    found[0] += x
    found[1] += 1
    return found
