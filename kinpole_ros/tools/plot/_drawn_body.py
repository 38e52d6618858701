"""A body of a record as the picture draws it: its series over time and its centrodes."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.tools.record.record import Record, Series
from kinpole_ros.tracking.values import POLE_NAMES, RATE_NAMES

_DRAWN = (*RATE_NAMES[:3], *POLE_NAMES[:3], 'icr_velocity', 'centrode_curvature')


class Body(NamedTuple):
    """
    The results of one body at the stamps (T,) of its poses; other quantities are in `series`.

    `frames` (F,), ns, are the stamps with any result. A frame that is not among them is lost; a
    quantity without a value in one that is, is undetermined.
    `position` (T,) is complex, m, and `angle` (T,), rad; `size`, m, is the diameter, NaN if
    unknown; `outline` (n,) are the markers in the body's frame, complex, m. `events` (E,), ns, are
    the instants at which a derivative steps.
    """

    name: str
    frames: np.ndarray
    stamp: np.ndarray
    position: np.ndarray
    angle: np.ndarray
    size: float
    outline: np.ndarray
    series: dict[str, Series]
    events: np.ndarray


class DrawnCentrodes(NamedTuple):
    """
    The ICR at `stamp` (K,), complex, m: `fixed` in the plane, and `moving` in the body's frame.

    `rate` (K,) is the angular velocity, rad/s, and `sigma` (K,) the standard deviation of the ICR,
    m.
    """

    stamp: np.ndarray
    fixed: np.ndarray
    moving: np.ndarray
    rate: np.ndarray
    sigma: np.ndarray


def body_of(record: Record, name: str) -> Body:
    """Return a body of a record; it has a pose at one instant at least."""
    position, angle = (record.columns[name, key] for key in ('position', 'angle'))
    known = np.isfinite(position)
    drawn = record.outlines[name]
    found = {key: record.series(name, key) for key in _DRAWN}
    return Body(
        name,
        record.stamp,
        record.stamp[known],
        position[known],
        angle[known],
        record.sizes[name],
        drawn[-1][1] if drawn else np.empty(0, complex),
        {key: series for key, series in found.items() if series is not None},
        np.array([stamp for stamp, _ in record.events.get(name, [])], np.int64),
    )


def centrodes(body: Body) -> DrawnCentrodes:
    """Return both centrodes of a body, at the instants with a pose and an ICR."""
    if 'icr' not in body.series:
        none = np.empty(0)
        return DrawnCentrodes(none.astype(np.int64), none + 0j, none + 0j, none, none)
    icr = body.series['icr']
    stamp, pose, point = np.intersect1d(body.stamp, icr.stamp, return_indices=True)
    fixed = icr.value[point]
    moving = (fixed - body.position[pose]) * np.exp(-1j * body.angle[pose])
    sigma = np.sqrt(np.trace(icr.spread[point], axis1=1, axis2=2))
    rate = body.series['angular_velocity']
    return DrawnCentrodes(stamp, fixed, moving, rate.value[rate.stamp.searchsorted(stamp)], sigma)
