"""
Instants at which a derivative of a pose steps, as an impact or a drive makes them.

Samples of a pose in deviations of their noise are searched by the compiled library: see
change_points.c.
"""

from ctypes import byref
from typing import NamedTuple

import numpy as np

from kinpole_ros.core.bindings import ChangePoint, library, pass_new_array
from kinpole_ros.planar._plane import Real

# Fewest samples in which there may be an event.
_FEWEST = 16
# A sample with more than this times the usual variance does not count.
_NOISY = 4.0


class Event(NamedTuple):
    """
    A step of the derivative of this `order` at `time`, s, with its standard deviation.

    `step` (3,) is by how much the derivatives of the angle and of both coordinates of the point
    step, rad/s^order and m/s^order, with standard deviations `step_sigma` (3,). `gain` is the
    logarithm of the evidence for it.
    """

    time: float
    time_sigma: float
    order: int
    step: Real
    step_sigma: Real
    gain: float


class Samples(NamedTuple):
    """
    Samples of a pose, and where an event may be among them.

    `time` (N,), s, rising, `values` (N, 3), the angle, rad, and both coordinates of a point, m, and
    their `variance` (N, 2), of the angle and of a coordinate, not finite where a sample is missing.
    The event is between `begin` and `end`, s.
    """

    time: Real
    values: Real
    variance: Real
    begin: float
    end: float


def find_event(samples: Samples, after: float) -> Event | None:
    """
    Find an event in samples, that of the shortest window that shows one.

    In the longest window motion goes on for `after`, s, after the event, and for twice as long
    before. There is none where smooth motion explains the samples as well.
    """
    time, values, variance, begin, end = samples
    seen = np.isfinite(variance).all(axis=1)
    if np.count_nonzero(seen) < _FEWEST:
        return None
    interval = float(np.sort(np.diff(time))[(len(time) - 1) // 2])
    # Time is from half an interval before the first sample after the middle of the places.
    number = min(int(np.searchsorted(time, (begin + end) / 2)), len(time) - 1)
    middle = float(time[number]) - interval / 2
    usual = np.sort(variance, axis=0)[np.count_nonzero(seen) // 2]
    seen = (variance <= _NOISY * usual).all(axis=1)
    since, values, variance = (time[seen] - middle) / interval, values[seen], variance[seen]
    scale = np.sqrt(variance.mean(axis=0))[[0, 1, 1]]
    first = min(int(np.searchsorted(since, 0.0)), len(since) - 1)
    samples_in_sigmas = np.ascontiguousarray(((values - values[first]) / scale).T)
    found = ChangePoint()
    code = library.kinpole_find_event(
        pass_new_array(since),
        pass_new_array(samples_in_sigmas),
        len(since),
        round(after / interval),
        ((begin + end) / 2 - middle) / interval,
        (end - begin) / interval / 2,
        byref(found),
    )
    if code < 0:
        raise MemoryError
    if not code:
        return None
    unit = scale / interval**found.step_order
    return Event(
        time=middle + found.place * interval,
        time_sigma=found.place_sigma * interval,
        order=int(found.step_order),
        step=np.array(found.step) * unit,
        step_sigma=np.array(found.step_sigma) * unit,
        gain=found.gain,
    )
