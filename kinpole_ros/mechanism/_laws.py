"""
Functions of time or of an angle with four exact derivatives: drivers, cams and Geneva drives.

A motion of a driver gives its value and derivatives (5, ...) at times (...), s. Before and after
their time a step and a table stand still. All derivatives of a step are continuous to the fourth;
those of a table are to the fourth inside and to the second at its ends. A law gives a value and its
derivatives (5, T) at angles (T,), rad; where these jump, as the jerk does at the ends of a dwell,
they are those just after.
"""

from collections.abc import Callable, Sequence
from math import comb, factorial, pi
from typing import NamedTuple

import numpy as np

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

    `name` is for messages; `row` and `of` are (n,). The function depends on the positions of the
    points with the names `hubs`.
    """

    name: str
    row: Real
    of: Real
    function: Function
    hubs: tuple[str, ...]


def compose(outer: Real, inner: Real) -> Real:
    """Derivatives (k, T) of f(g) from those of f by its argument (k or more, T) and of g (k, T)."""
    composed = [outer[0]]
    if len(inner) > 1:
        slope = compose(outer[1:], inner[:-1])
        for k in range(1, len(inner)):
            composed.append(sum(comb(k - 1, j) * slope[j] * inner[k - j] for j in range(k)))
    return np.stack(composed)


def constant_rate(rate: float, start: float) -> Function:
    """`start` + `rate` t."""

    def motion(t: Real) -> Real:
        result = np.zeros((_ORDERS, *np.shape(t)))
        result[0], result[1] = start + rate * np.asarray(t), rate
        return result

    return motion


def sine(mean: float, amplitude: float, frequency: float, phase: float) -> Function:
    """`mean` + `amplitude` sin(2 pi `frequency` t + `phase`); frequency in Hz, phase in rad."""

    def motion(t: Real) -> Real:
        rate = 2 * pi * frequency
        angle = rate * np.asarray(t) + phase
        rows = [amplitude * rate**k * np.sin(angle + k * pi / 2) for k in range(_ORDERS)]
        rows[0] += mean
        return np.stack(rows)

    return motion


def smooth_step(low: float, high: float, begin: float, duration: float) -> Function:
    """From `low` to `high` between `begin` and `begin` + `duration` (s), smooth to the snap."""
    # The polynomial of degree 9 from 0 to 1 whose first four derivatives vanish at both ends.
    rise = np.polynomial.Polynomial((0, 0, 0, 0, 0, 126, -420, 540, -315, 70))

    def motion(t: Real) -> Real:
        u = np.clip((np.asarray(t) - begin) / duration, 0.0, 1.0)
        rows = [rise(u), *(rise.deriv(k)(u) / duration**k for k in range(1, _ORDERS))]
        result = (high - low) * np.stack(rows)
        result[1:, (u == 0) | (u == 1)] = 0.0
        result[0] = np.where(u == 1, high, low + result[0])
        return result

    return motion


def table(times: Sequence[float], values: Sequence[float]) -> Function:
    """Through `values` at rising `times` (s), by the quintic spline at rest at both ends."""
    knots = np.asarray(times, dtype=float)
    pieces = _quintics(knots, np.asarray(values, dtype=float))

    def motion(t: Real) -> Real:
        result = _spline(knots, pieces, np.clip(np.asarray(t, float), knots[0], knots[-1]))
        # At the very ends the jerk is that of the inside.
        result[1:, (np.asarray(t) < knots[0]) | (np.asarray(t) > knots[-1])] = 0.0
        return result

    return motion


def geneva(slots: int, start: float, offset: float) -> Function:
    """
    The angle of a Geneva wheel over that of its crank, rad, through engagement and dwell.

    At the angle `start` the pin is on the line of centers and the wheel at `offset`. With
    z = e^{iψ} sin(π/slots), ψ from `start` on, the slot points along 1 - z.
    """
    engaged, ratio = pi / 2 - pi / slots, np.sin(pi / slots)

    def function(at: Real) -> Real:
        turns = np.round((at - start) / (2 * pi))
        psi = at - start - 2 * pi * turns
        z = ratio * np.exp(1j * psi)
        result = np.zeros((_ORDERS, *np.shape(at)))
        inside = (psi >= -engaged) & (psi < engaged)
        result[0] = np.where(inside, np.angle(1 - z), -np.sign(psi) * pi / slots)
        result[0] += offset - 2 * pi / slots * turns
        # The derivatives of log(1 - z) are polynomials of q = z / (1 - z), as q' = i q (1 + q).
        slope, q = np.polynomial.Polynomial((0, 1j, 1j)), z / (1 - z)
        power = np.polynomial.Polynomial((0, -1j))
        for k in range(1, _ORDERS):
            result[k] = np.where(inside, power(q).imag, 0.0)
            power = power.deriv() * slope
        return result

    return function


def cam(angles: Sequence[float], lifts: Sequence[float], rise: str) -> Function:
    """
    The lift of a cam's follower over the angle of the cam, from a table over one turn.

    From each of the rising `angles` (rad) to the next, the last 2π after the first, the lift goes
    from one of `lifts` to the next by one of RISES; 'spline' goes through all of them with four
    continuous derivatives.
    """
    knots, steps = np.array(angles), np.diff(lifts)
    widths = np.diff(knots)
    pieces = _quintics(knots, np.array(lifts), closed=True) if rise == 'spline' else None

    def function(at: Real) -> Real:
        angle = knots[0] + np.mod(at - knots[0], 2 * pi)
        if pieces is not None:
            return _spline(knots, pieces, angle)
        piece = np.clip(np.searchsorted(knots, angle, side='right') - 1, 0, len(steps) - 1)
        result = _rise(rise, (angle - knots[piece]) / widths[piece])
        result *= steps[piece] / widths[piece] ** np.arange(_ORDERS).reshape(-1, *[1] * angle.ndim)
        result[0] += np.array(lifts)[piece]
        return result

    return function


def _rise(law: str, x: Real) -> Real:
    """A rise from 0 to 1 over `x` from 0 to 1, and its derivatives (5, T)."""
    orders = range(_ORDERS)
    if law in _POLYNOMIALS:
        rise = np.polynomial.Polynomial(_POLYNOMIALS[law])
        return np.stack([rise.deriv(k)(x) if k else rise(x) for k in orders])
    if law == 'harmonic':
        result = np.stack([-(pi**k) / 2 * np.cos(pi * x + k * pi / 2) for k in orders])
        result[0] += 0.5
        return result
    result = np.stack([-((2 * pi) ** (k - 1)) * np.sin(2 * pi * x + k * pi / 2) for k in orders])
    result[0] += x
    result[1] += 1
    return result


def _spline(knots: Real, pieces: Real, at: Real) -> Real:
    """The spline of `_quintics` and its derivatives (5, ...) between the first and last knot."""
    piece = np.clip(np.searchsorted(knots, at, side='right') - 1, 0, len(knots) - 2)
    step, coefficients = at - knots[piece], pieces[piece]
    result = np.zeros((_ORDERS, *at.shape))
    for k in range(_ORDERS):
        for power in range(5, k - 1, -1):
            weight = factorial(power) / factorial(power - k)
            result[k] = result[k] * step + weight * coefficients[..., power]
    return result


def _quintics(knots: Real, values: Real, closed: bool = False) -> Real:
    """
    Coefficients (pieces, 6) of the interpolating quintic spline, by rising powers in each piece.

    The third and fourth derivatives are continuous at the inner knots, which determines the rates
    and accelerations there. At both ends it is at rest, or, if `closed`, as smooth from the last
    knot to the first as in between.
    """
    count, steps = len(knots), np.diff(knots)
    # Derivatives (order, power) of the powers at 0 and at 1, and the coefficients of a piece of
    # length 1 from value, rate and acceleration at both ends (Hermite).
    at_begin = np.diag([float(factorial(k)) for k in range(6)])
    at_end = np.array(
        [[factorial(p) / factorial(p - k) if p >= k else 0.0 for p in range(6)] for k in range(6)]
    )
    hermite = np.linalg.inv(np.concatenate((at_begin[:3], at_end[:3])))
    at_begin, at_end = at_begin @ hermite, at_end @ hermite
    ends = np.eye(2 * count)[[0, 1, -2, -1]]
    rows, right = (list(ends[:2] - ends[2:]), [0.0] * 2) if closed else (list(ends), [0.0] * 4)
    neighbors = [(knot - 1, knot) for knot in range(1, count - 1)]
    for before, after in [*neighbors, *([(count - 2, 0)] if closed else [])]:
        for order in (3, 4):
            # Weights of value, rate and acceleration at each knot in the jump of the derivative.
            row = np.zeros((count, 3))
            for piece, weights in ((before, at_end[order]), (after, -at_begin[order])):
                powers = steps[piece] ** (np.arange(3.0) - order)
                row[[piece, piece + 1]] += weights.reshape(2, 3) * powers
            size = np.abs(row[:, 1:]).max()
            rows.append(row[:, 1:].ravel() / size)
            right.append(-(row[:, 0] @ values) / size)
    slopes = np.linalg.solve(np.array(rows), np.array(right)).reshape(-1, 2)
    states = np.column_stack((values, slopes))
    scale = steps[:, None] ** np.arange(3)
    both_ends = np.concatenate((states[:-1] * scale, states[1:] * scale), axis=1)
    return np.asarray(both_ends @ hermite.T / steps[:, None] ** np.arange(6))
