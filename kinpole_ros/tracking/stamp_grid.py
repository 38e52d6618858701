"""
Stamps that a driver rounded to the grid of a timer: how likely their lateness is.

A camera of 60 Hz whose stamps are multiples of 15.6 ms has gaps of one and of two multiples. By the
stamps alone that may be an even clock of 64 Hz with losses, but these come regularly.
"""

import numpy as np

from kinpole_ros.planar._plane import Real

# Steps of the grid by which the earliest stamp may be late, and the least mean lateness of a driver
# that is tried.
_EDGES, _LEAST_LATENESS = (0.02, 0.1, 0.5, 0.9), 0.01


def rounding_nats(late: Real) -> Real:
    """
    Return the least negative log likelihoods (I,) of stamps that are rounded down to a grid.

    A driver that is late by an exponential time stamps a frame in a step of the grid with the
    probability of that step. It is 1 for the step of the tick, if the driver is not late.

    Parameters
    ----------
    late : (I, N) float
        Lateness of the stamps, steps of the grid, relative to the earliest.

    """
    least = np.full(len(late), np.inf)
    for edge in _EDGES:
        # The time from a tick to the end of the step of its stamp.
        until = late + edge
        beyond = np.maximum(until - 1.0, 0.0)
        # The mean lateness, if ticks are anywhere in their steps, or at the start of them.
        for mean in (until.mean(axis=1) - 0.5, beyond.mean(axis=1)):
            mean = np.maximum(mean, _LEAST_LATENESS)[:, None]
            nats = beyond / mean - np.log1p(-np.exp(-np.minimum(until, 1.0) / mean))
            least = np.minimum(least, nats.sum(axis=1))
    return np.asarray(least)
