"""What robot stacks read: the frames of the bodies on /tf, and joints between them."""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from kinpole_ros.messages._cdr import joint_data
from kinpole_ros.messages._loci import Build, Built
from kinpole_ros.messages._rows import At, Found, each
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.parameters import GROUND
from kinpole_ros.tracking.plane import Plane

TF = '/tf'
"""The topic of frames, the same for all nodes."""


def frame_poses(estimate: Estimate, given: Plane, at: At) -> np.ndarray:
    """
    Where the frames of the bodies `at` these (N,) are, (N, 7): a point, m, and a quaternion.

    In the frame of the markers; `given` is the plane of an estimate that does not say where it is.
    """
    plane = estimate.plane or given
    turn = np.exp(0.5j * estimate.angle[0][at])
    found = np.empty((len(turn), 7))
    found[:, :3] = plane.in_space(estimate.origin(0)[at], estimate.height[at])
    found[:, 3:6], found[:, 6] = plane.along_normal(turn.imag), turn.real
    return found


def frames(names: Sequence[str], given: Plane) -> Build:
    """A message of /tf for each body, whose frame has the name of these, at each instant."""

    def figures(estimate: Estimate, which: int | slice) -> Found:
        return estimate.missing[:, which] == '', partial(frame_poses, estimate, given)

    builds = each(len(names), figures, names, listed=True)

    def build(estimate: Estimate) -> Built:
        made: list[tuple[int, bytes]] = []
        for of_body in builds:
            made += zip(*of_body(estimate), strict=True)
        return _in_order(made)

    return build


class _Angles(NamedTuple):
    """Angles and their derivatives (K, T, B) at T instants, as an estimate has them."""

    stamp: np.ndarray
    angle: np.ndarray
    covariance: np.ndarray
    known: np.ndarray
    span: np.ndarray


def joint_states(
    joints: Mapping[str, tuple[str, str]], bodies: Sequence[str], rate: float, deviation: bool
) -> Build:
    """
    Angles and rates of joints, each of its second body against its first; or their deviations.

    Of those whose bodies are known, at each instant, or `rate` times a second where that is not 0:
    at multiples of its period, by the derivatives at the nearest instant. Angles, rad, within half
    a turn, are 0 where the axes of the bodies' frames are parallel: those of a body that is learned
    are along the ground's where it is first seen.
    """
    names = list(joints)
    # The ground is one more body.
    number = {GROUND: len(bodies)} | {body: b for b, body in enumerate(bodies)}
    first, second = (np.array([number[pair[k]] for pair in joints.values()]) for k in (0, 1))
    # The last instant of the estimate before, and of which run it was.
    before: _Angles | None = None
    run = -1

    def between(values: np.ndarray, join: Callable[..., np.ndarray], ground: object) -> np.ndarray:
        wide = np.concatenate((values, np.full((len(values), 1), ground)), axis=1)
        return join(wide[:, second], wide[:, first])

    def build(estimate: Estimate) -> Built:
        nonlocal before, run
        angles = _angles(estimate)
        stamps, nearest = estimate.stamp, np.arange(len(estimate))
        when = nearest
        if rate:
            older = before if run == estimate.run else None
            angles = angles if older is None else _concatenated(older, angles)
            before, run = _Angles(*(part[..., -1:, :] for part in angles)), estimate.run
            stamps, nearest, when = _evenly(angles, rate)
            when = when - (older is not None)
        ahead = ((stamps - angles.stamp[nearest, 0]) * 1e-9)[:, None]
        known = between(angles.known[nearest], np.logical_and, True)
        # Taylor's series: of the angle one order more than of its rate.
        series = np.stack([np.ones_like(ahead), ahead, ahead**2 / 2])[: len(angles.angle)]
        found = []
        for order in range(2):
            part = series[: len(series) - order]
            if deviation:
                both = part[:, None] * part
                some = angles.covariance[order:, order:, nearest]
                variance = (both * some[: len(part), : len(part)]).sum(axis=(0, 1))
                found.append(np.sqrt(between(np.maximum(variance, 0.0), np.add, 0.0)))
            else:
                value = (part * angles.angle[order:, nearest][: len(part)]).sum(axis=0)
                found.append(between(value, np.subtract, 0.0))
        if not deviation:
            found[0] = np.angle(np.exp(1j * found[0]))
        made: list[tuple[int, bytes]] = []
        for seen in np.unique(known[known.any(axis=1)], axis=0):
            rows = (known == seen).all(axis=1).nonzero()[0]
            called = [name for name, there in zip(names, seen, strict=True) if there]
            figures = (each[np.ix_(rows, seen)] for each in found)
            data = joint_data(stamps[rows], called, *figures)
            made += zip(rows.tolist(), data, strict=True)
        rows, data = _in_order(made)
        return when[rows].tolist(), data

    return build


def _angles(estimate: Estimate) -> _Angles:
    """Angles of an estimate, up to the acceleration."""
    return _Angles(
        estimate.stamp[:, None],
        estimate.angle[:3],
        estimate.angle_covariance[:3, :3],
        estimate.missing == '',
        estimate.span,
    )


def _concatenated(older: _Angles, newer: _Angles) -> _Angles:
    """Both, one after the other, up to the order that both have."""
    orders = min(len(older.angle), len(newer.angle))
    cut = (
        _Angles(a.stamp, a.angle[:orders], a.covariance[:orders, :orders], a.known, a.span)
        for a in (older, newer)
    )
    return _Angles(*(np.concatenate(pair, axis=-2) for pair in zip(*cut, strict=True)))


def _evenly(angles: _Angles, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Stamps (G,) at multiples of the period from the first instant to the last.

    With the number of the nearest instant of each, and of the one that comes at it or after it.
    There are none farther from an instant than it can be followed: a quarter of its window.
    """
    exact = Fraction(rate).limit_denominator(10**6)
    count, period = exact.numerator, exact.denominator * 10**9
    reach = np.nan_to_num(np.where(angles.known, angles.span, 0.0)).max(axis=1) * 1e9 / 4
    stamps = angles.stamp[:, 0].tolist()
    found: list[tuple[int, int, int]] = []
    for k, (start, end) in enumerate(pairwise(stamps), 1):
        last = min(end, start + int(reach[k - 1]))
        again = max(start, last, end - int(reach[k]))
        for first, final in ((start, last), (again, end)):
            for n in range(first * count // period + 1, final * count // period + 1):
                stamp = (2 * n * period + count) // (2 * count)
                found.append((stamp, k - (stamp - start <= end - stamp), k))
    return tuple(np.array(found, np.int64).reshape(-1, 3).T)


def _in_order(made: list[tuple[int, bytes]]) -> Built:
    """Messages by the instants that they are of."""
    made.sort(key=lambda row: row[0])
    return [when for when, _ in made], [data for _, data in made]
