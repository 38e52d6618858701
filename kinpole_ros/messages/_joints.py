"""What robot stacks read: states of joints between bodies."""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kinpole_ros.messages._cdr import HEAD, TIME, Writer, rows_of_bytes, stamp_bytes
from kinpole_ros.messages._rows import Build, Built
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.parameters import GROUND

_STATE_ORDERS = 3  # angle, rate and acceleration: what a state between two instants is made of
_MAX_AHEAD = 0.25  # of its window: how far from an instant a state is extrapolated


class _Angles(NamedTuple):
    """Angles of B bodies and their derivatives (K, T, B), as an estimate has them."""

    stamp: np.ndarray  # (T, 1)
    angle: np.ndarray
    covariance: np.ndarray  # (K, K, T, B)
    determined: np.ndarray  # (T, B)
    span: np.ndarray  # (T, B), s: the window of each

    @classmethod
    def of(cls, estimate: Estimate) -> '_Angles':
        """The angles of an estimate up to the acceleration."""
        return cls(
            estimate.stamp[:, None],
            estimate.angle[:_STATE_ORDERS],
            estimate.angle_covariance[:_STATE_ORDERS, :_STATE_ORDERS],
            estimate.missing == '',
            estimate.span,
        )

    def last(self) -> '_Angles':
        """The last instant."""
        return _Angles(*(array[..., -1:, :] for array in self))

    def following(self, earlier: '_Angles') -> '_Angles':
        """These angles after the earlier ones, up to the order that both have."""
        orders = min(len(earlier.angle), len(self.angle))
        cut = (
            a._replace(angle=a.angle[:orders], covariance=a.covariance[:orders, :orders])
            for a in (earlier, self)
        )
        return _Angles(*(np.concatenate(pair, axis=-2) for pair in zip(*cut, strict=True)))


class _JointBodies:
    """The bodies of joints, as indices: of the second against the first, with the ground."""

    def __init__(self, pairs: Sequence[tuple[str, str]], bodies: Sequence[str]) -> None:
        number = {GROUND: len(bodies)} | {body: b for b, body in enumerate(bodies)}
        self._first, self._second = (np.array([number[pair[k]] for pair in pairs]) for k in (0, 1))

    def combine(
        self, values: np.ndarray, operation: Callable[..., np.ndarray], ground: object
    ) -> np.ndarray:
        """Combine values (T, B) of second and first body; `ground` is the value of the ground."""
        extended = np.concatenate((values, np.full((len(values), 1), ground)), axis=1)
        return operation(extended[:, self._second], extended[:, self._first])


def joint_states(
    joints: Mapping[str, tuple[str, str]], bodies: Sequence[str], rate: float, deviation: bool
) -> Build:
    """
    Return a function that makes angles and rates of joints, or their standard deviations.

    A joint is that of its second body against its first. A message has the joints whose bodies are
    determined, at each instant; with a `rate`, Hz, at multiples of its period by the stamps, by the
    derivatives at the nearest instant. Angles, rad, are within half a turn. They are 0 where the
    axes of the bodies' frames are parallel; those of a body without a given shape are parallel to
    the axes of the ground where it is first seen.
    """
    names = list(joints)
    joint_bodies = _JointBodies(list(joints.values()), bodies)
    last: _Angles | None = None
    last_run = -1

    def build(estimate: Estimate) -> Built:
        nonlocal last, last_run
        angles = _Angles.of(estimate)
        stamps, nearest = estimate.stamp, np.arange(len(estimate))
        instants = nearest
        if rate:
            earlier = last if last_run == estimate.run else None
            if earlier is not None:
                angles = angles.following(earlier)
            last, last_run = angles.last(), estimate.run
            stamps, nearest, instants = _even_stamps(angles, rate)
            instants = instants - (earlier is not None)
        determined = joint_bodies.combine(angles.determined[nearest], np.logical_and, True)
        ahead = ((stamps - angles.stamp[nearest, 0]) * 1e-9)[:, None]
        states = _extrapolated(angles, nearest, ahead, joint_bodies, deviation)
        messages: list[tuple[int, bytes]] = []
        for mask in np.unique(determined[determined.any(axis=1)], axis=0):
            rows = (determined == mask).all(axis=1).nonzero()[0]
            listed = [name for name, is_listed in zip(names, mask, strict=True) if is_listed]
            angle, angle_rate = (state[np.ix_(rows, mask)] for state in states)
            data = _joint_data(stamps[rows], listed, angle, angle_rate)
            messages += zip(rows.tolist(), data, strict=True)
        rows, data = _in_order(messages)
        return instants[rows].tolist(), data

    return build


def _extrapolated(
    angles: _Angles,
    nearest: np.ndarray,
    ahead: np.ndarray,
    joint_bodies: _JointBodies,
    deviation: bool,
) -> list[np.ndarray]:
    """
    Return angles and rates (T, J) of joints, or their standard deviations.

    By the Taylor series from the instants `nearest` (T,), `ahead` (T, 1) s; that of the rate has
    one order less.
    """
    series = np.stack([np.ones_like(ahead), ahead, ahead**2 / 2])[: len(angles.angle)]
    states = []
    for order in range(2):
        terms = series[: len(series) - order]
        if deviation:
            products = terms[:, None] * terms
            covariance = angles.covariance[order:, order:, nearest]
            variance = (products * covariance[: len(terms), : len(terms)]).sum(axis=(0, 1))
            summed = joint_bodies.combine(np.maximum(variance, 0.0), np.add, 0.0)
            states.append(np.sqrt(summed))
        else:
            value = (terms * angles.angle[order:, nearest][: len(terms)]).sum(axis=0)
            states.append(joint_bodies.combine(value, np.subtract, 0.0))
    if not deviation:
        states[0] = np.angle(np.exp(1j * states[0]))
    return states


def _joint_data(
    stamps: np.ndarray, names: Sequence[str], positions: np.ndarray, velocities: np.ndarray
) -> list[bytes]:
    """Write a sensor_msgs/JointState of n joints for each of `stamps` (T,); values are (T, n)."""
    writer, zeros, columns = Writer(), np.zeros(len(names)), []
    writer.header(0, '')
    writer.pack('I', len(names))
    for name in names:
        writer.string(name)
    for _ in range(2):
        writer.pack('I', len(names))
        writer.doubles(zeros)
        columns.append(slice(len(writer.data) - zeros.nbytes, len(writer.data)))
    # No efforts, but padding up to where they would begin.
    writer.pack('I', 0)
    writer.align(8)
    rows = np.tile(np.frombuffer(bytes(writer.data), np.uint8), (len(stamps), 1))
    rows[:, HEAD : HEAD + TIME.size] = stamp_bytes(stamps)
    for column, values in zip(columns, (positions, velocities), strict=True):
        rows[:, column] = np.ascontiguousarray(values, '<f8').view(np.uint8)
    return rows_of_bytes(rows)


def _even_stamps(angles: _Angles, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return stamps (G,), ns, at multiples of the period from the first instant to the last.

    Also the index of the nearest instant of each, and of the first one at it or after it. There is
    no stamp farther from an instant than a quarter of its window.
    """
    exact = Fraction(rate).limit_denominator(10**6)
    count, period = exact.numerator, exact.denominator * 10**9
    longest = np.nan_to_num(np.where(angles.determined, angles.span, 0.0)).max(axis=1)
    max_ahead = longest * 1e9 * _MAX_AHEAD
    rows: list[tuple[int, int, int]] = []
    for k, (start, end) in enumerate(pairwise(angles.stamp[:, 0].tolist()), 1):
        after_start = min(end, start + int(max_ahead[k - 1]))
        before_end = max(start, after_start, end - int(max_ahead[k]))
        for first, last in ((start, after_start), (before_end, end)):
            for n in range(first * count // period + 1, last * count // period + 1):
                stamp = (2 * n * period + count) // (2 * count)
                rows.append((stamp, k - (stamp - start <= end - stamp), k))
    return tuple(np.array(rows, np.int64).reshape(-1, 3).T)


def _in_order(messages: list[tuple[int, bytes]]) -> Built:
    """Sort messages by the instants that they are of."""
    messages.sort(key=lambda row: row[0])
    return [instant for instant, _ in messages], [data for _, data in messages]
