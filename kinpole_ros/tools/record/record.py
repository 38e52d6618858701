"""
The record that pages and pictures show: quantities of all bodies at the same instants, as arrays.

It comes from the estimates of a replay, from a bag of results, from messages of a live node, or
from a solved scene; what shows it does not know which.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, TypeAlias

import numpy as np

from kinpole_ros.tools.record.lost import lost_frames, usual_interval
from kinpole_ros.tracking.values import measured_pairs

# By subject, a body or a pair (j, i), and by quantity: arrays (T, ...), NaN where undetermined.
Subject: TypeAlias = str | tuple[str, str]
Columns: TypeAlias = dict[tuple[Subject, str], np.ndarray]
# A relative center that moves less than this fraction of the size of both bodies is a pin.
_PIN_DEVIATION = 0.05


class Pin(NamedTuple):
    """A pin of two bodies, `at` complex, m, in their frames; of one body, on the ground."""

    bodies: tuple[str, ...]
    at: tuple[complex, ...]


class Series(NamedTuple):
    """
    One quantity where it is determined: `stamp` (K,), ns, and `value` (K,), complex for vectors.

    `spread` is the standard deviation (K,) of numbers and the covariance (K, 2, 2) of vectors; NaN
    if unknown.
    """

    stamp: np.ndarray
    value: np.ndarray
    spread: np.ndarray


class MotionRecord(NamedTuple):
    """
    T instants, `stamp` (T,) ns, of a recording of `total` instants, in which `lost` frames are not.

    `columns` has, of a body: `position` and `velocity` of its origin, complex, m; `angle`, rad;
    `missing`, the reason why it has no results ('' where it has); its rates, poles, `icr_velocity`
    and `centrode_curvature`, each with `_sigma` or `_covariance` (T, 2, 2), and with `_withheld`,
    the reason why it is undetermined, where that is known; rates with `_theory` from a scene; of a
    pair (j, i) `icr` with `icr_covariance`.
    `sizes` are diameters, m, and `outlines` markers (n,) in the frame of a body from an index on.
    `along` are the directions of x and y of the plane in the frame of the markers. `events` by body
    are stamps, ns, and orders of the derivatives that step. `notes` are warnings, and `cut` says
    where a truncated bag ends.
    """

    stamp: np.ndarray
    total: int
    bodies: tuple[str, ...]
    columns: Columns
    sizes: dict[str, float]
    outlines: dict[str, list[tuple[int, np.ndarray]]]
    along: tuple[str, str]
    events: Mapping[str, list[tuple[int, int]]] = MappingProxyType({})
    lost: int = 0
    notes: tuple[str, ...] = ()
    cut: str = ''

    def series(self, subject: Subject, name: str) -> Series | None:
        """Return a quantity where it is determined; None if there is no such quantity."""
        value = self.columns.get((subject, name))
        if value is None:
            return None
        known = np.isfinite(value)
        spread = self.columns.get((subject, f'{name}_covariance'))
        if spread is None:
            spread = self.columns[subject, f'{name}_sigma']
        return Series(self.stamp[known], value[known], spread[known])

    def at_most(self, instants: int) -> 'MotionRecord':
        """Return every second instant, or fourth, and so on, so that there are no more."""
        step = 1
        while len(self.stamp[::step]) > instants:
            step *= 2
        columns = {key: values[::step] for key, values in self.columns.items()}
        outlines = {
            body: [(-(-start // step), markers) for start, markers in drawn]
            for body, drawn in self.outlines.items()
        }
        return self._replace(stamp=self.stamp[::step], columns=columns, outlines=outlines)


def pairs_of(record: MotionRecord) -> list[tuple[str, str]]:
    """Return the pairs (j, i) of bodies that have a relative center."""
    return list(dict.fromkeys(s for s, _ in record.columns if isinstance(s, tuple)))


def with_lost_frames(record: MotionRecord) -> tuple[MotionRecord, np.ndarray]:
    """
    Return a record with rows of NaN where frames are lost, and which rows these are.

    A gap begins and ends with such a row, so that no line crosses it and all of it can be marked.
    """
    lost = lost_frames(record.stamp, usual_interval(record.stamp))
    gaps = np.flatnonzero(lost)
    step = np.diff(record.stamp)[gaps] // (lost[gaps] + 1)
    ends = np.stack((record.stamp[gaps] + step, record.stamp[gaps + 1] - step), axis=-1)
    ends = ends[:, 0], ends[lost[gaps] > 1, 1]
    at = np.concatenate((gaps, gaps[lost[gaps] > 1])) + 1
    order = np.argsort(np.concatenate(ends))
    at, stamps = at[order], np.concatenate(ends)[order]
    columns = {
        key: np.insert(values, at, '' if values.dtype == object else np.nan, axis=0)
        for key, values in record.columns.items()
    }
    outlines = {
        body: [(start + int(at.searchsorted(start, 'right')), markers) for start, markers in drawn]
        for body, drawn in record.outlines.items()
    }
    is_lost = np.insert(np.zeros(len(record.stamp), bool), at, True)
    stamp = np.insert(record.stamp, at, stamps)
    return record._replace(stamp=stamp, columns=columns, outlines=outlines), is_lost


def joints_of(record: MotionRecord) -> list[Pin]:
    """Return pins: poles at rest on the ground, and relative centers at rest in both bodies."""
    joints = []
    for body in record.bodies:
        icr, velocity = (record.columns.get((body, name)) for name in ('icr', 'icr_velocity'))
        if icr is None or velocity is None:
            continue
        at_rest = (velocity == 0) & np.isfinite(icr)
        if 2 * np.count_nonzero(at_rest) > np.count_nonzero(np.isfinite(icr)):
            pin = complex(np.median(icr[at_rest].real), np.median(icr[at_rest].imag))
            joints.append(Pin((body,), (pin,)))
    for m, k in measured_pairs(len(record.bodies)):
        pair = record.bodies[k], record.bodies[m]
        points = [_point_at_rest(record, pair, body) for body in pair]
        if all(point is not None for point in points):
            joints.append(Pin(pair, tuple(point for point in points if point is not None)))
    return joints


def _point_at_rest(record: MotionRecord, pair: tuple[str, str], body: str) -> complex | None:
    """Return the mean relative center in the frame of a body; None if it moves there."""
    center = record.columns.get((pair, 'icr'))
    covariance = record.columns.get((pair, 'icr_covariance'))
    if center is None or covariance is None or not np.isfinite(center).any():
        return None
    variance = np.trace(covariance, axis1=1, axis2=2)
    # Without covariances all centers have the same weight.
    variance = np.where(np.isfinite(center) & np.isnan(variance), 0.0, variance)
    position, angle = record.columns[body, 'position'], record.columns[body, 'angle']
    points = (center - position) * np.exp(-1j * angle)
    points = points[np.isfinite(points) & (variance <= np.nanmedian(variance))]
    if not len(points) or np.sqrt(np.var(points)) > _PIN_DEVIATION * record.sizes[body]:
        return None
    return complex(points.mean())
