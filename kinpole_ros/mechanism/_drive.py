"""
What drives a mechanism: values over time with four exact derivatives.

Each function returns the motion of one driver, `motion(t)` -> (5, ...) at times (...) in s. Before
and after their time a step and a table stand still, with continuous derivatives: to the fourth for
the step, of degree 9, to the fourth inside the table and to the second at its ends.
"""

from collections.abc import Callable, Sequence
from math import factorial, pi

import numpy as np

from kinpole_ros.planar._plane import Real

_ORDERS = 5  # position to snap
Drive = Callable[[Real], Real]


def constant_rate(rate: float, start: float) -> Drive:
    """`start` + `rate` t."""

    def motion(t: Real) -> Real:
        found = np.zeros((_ORDERS, *np.shape(t)))
        found[0], found[1] = start + rate * np.asarray(t), rate
        return found

    return motion


def sine(mean: float, amplitude: float, frequency: float, phase: float) -> Drive:
    """`mean` + `amplitude` sin(2 pi `frequency` t + `phase`); frequency in Hz, phase in rad."""

    def motion(t: Real) -> Real:
        rate = 2 * pi * frequency
        angle = rate * np.asarray(t) + phase
        found = np.stack([amplitude * rate**k * np.sin(angle + k * pi / 2) for k in range(_ORDERS)])
        found[0] += mean
        return found

    return motion


def smooth_step(low: float, high: float, begin: float, duration: float) -> Drive:
    """From `low` to `high` between `begin` and `begin` + `duration` (s), smooth to the snap."""
    # The polynomial of degree 9 from 0 to 1 whose first four derivatives vanish at both ends.
    rise = np.polynomial.Polynomial((0, 0, 0, 0, 0, 126, -420, 540, -315, 70))

    def motion(t: Real) -> Real:
        u = np.clip((np.asarray(t) - begin) / duration, 0.0, 1.0)
        rows = [rise(u), *(rise.deriv(k)(u) / duration**k for k in range(1, _ORDERS))]
        found = (high - low) * np.stack(rows)
        found[1:, (u == 0) | (u == 1)] = 0.0
        found[0] = np.where(u == 1, high, low + found[0])
        return found

    return motion


def table(times: Sequence[float], values: Sequence[float]) -> Drive:
    """
    Through `values` at rising `times` (s): the interpolating spline of degree 5, at rest at both
    ends (rates and accelerations zero).

    Its fourth derivative is continuous in between, which, with the values, leaves one system of
    linear equations for the rates and accelerations at the inner times.
    """
    knots = np.asarray(times, dtype=float)
    pieces = quintics(knots, np.asarray(values, dtype=float))

    def motion(t: Real) -> Real:
        at = np.clip(np.asarray(t, dtype=float), knots[0], knots[-1])
        found = spline(knots, pieces, at)
        # Held outside. At the very ends the jerk is that of the inside.
        found[1:, (np.asarray(t) < knots[0]) | (np.asarray(t) > knots[-1])] = 0.0
        return found

    return motion


def spline(knots: Real, pieces: Real, at: Real) -> Real:
    """The spline of `quintics` and its derivatives (5, ...) between the first and last knot."""
    piece = np.clip(np.searchsorted(knots, at, side='right') - 1, 0, len(knots) - 2)
    step, shares = at - knots[piece], pieces[piece]
    found = np.zeros((_ORDERS, *at.shape))
    for k in range(_ORDERS):
        for power in range(5, k - 1, -1):
            weight = factorial(power) / factorial(power - k)
            found[k] = found[k] * step + weight * shares[..., power]
    return found


def quintics(knots: Real, values: Real, closed: bool = False) -> Real:
    """
    Coefficients (pieces, 6), by rising powers of what is past each piece's beginning.

    At rest at both ends, or, if `closed`, as smooth from the last knot to the first as in between.
    """
    count = len(knots)
    steps = np.diff(knots)
    # Unknowns: rate and acceleration at each knot. A piece's coefficients are linear in the
    # values, rates and accelerations at its two ends (Hermite).
    hermite = np.linalg.inv(
        np.array(
            [
                [1, 0, 0, 0, 0, 0],
                [0, 1, 0, 0, 0, 0],
                [0, 0, 2, 0, 0, 0],
                [1, 1, 1, 1, 1, 1],
                [0, 1, 2, 3, 4, 5],
                [0, 0, 2, 6, 12, 20],
            ],
            dtype=float,
        )
    )

    def derivative(piece: int, end: bool, order: int) -> tuple[Real, float]:
        """A derivative at an end of a piece: weights of the unknowns, and what values add."""
        h = steps[piece]
        powers = np.array(
            [
                factorial(p) / factorial(p - order) * (1.0 if end else float(p == order))
                if p >= order
                else 0.0
                for p in range(6)
            ]
        )
        share = powers @ hermite / h**order
        weights = np.zeros(2 * count)
        for side, knot in ((0, piece), (3, piece + 1)):
            weights[2 * knot] = share[side + 1] * h
            weights[2 * knot + 1] = share[side + 2] * h**2
        return weights, float(share[0] * values[piece] + share[3] * values[piece + 1])

    ends = np.eye(2 * count)[[0, 1, -2, -1]]
    rows, right = [*ends], [0.0] * 4
    joined = [(knot - 1, knot) for knot in range(1, count - 1)]
    if closed:
        rows, right = [*(ends[:2] - ends[2:])], [0.0] * 2
        joined.append((count - 2, 0))
    for one, other in joined:
        for order in (3, 4):
            before, had = derivative(one, True, order)
            after, has = derivative(other, False, order)
            size = np.abs(before).max()
            rows.append((before - after) / size)
            right.append((has - had) / size)
    slopes = np.linalg.solve(np.array(rows), np.array(right)).reshape(-1, 2)
    states = np.stack((values, slopes[:, 0], slopes[:, 1]), axis=-1)
    scale = steps[:, None] ** np.arange(3)
    both = np.concatenate((states[:-1] * scale, states[1:] * scale), axis=1)
    return np.asarray(both @ hermite.T / steps[:, None] ** np.arange(6))
