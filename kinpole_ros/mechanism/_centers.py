"""Instant centers of all pairs of bodies: by Kennedy's theorem, and all others by the rates."""

from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import joint_extent, poses_of
from kinpole_ros.mechanism._kennedy import (
    KennedyStep,
    Pair,
    bodies_of,
    deduce,
    kennedy_centers,
    number_of,
    outward,
    pairs_of,
    unit,
)
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism
from kinpole_ros.planar._plane import Complex, Real

# Two bodies whose rates differ by this share of the largest one have equal motions.
EQUAL_RATES = 1e-9


class Centers(NamedTuple):
    """
    All n(n - 1)/2 instant centers of n bodies, the ground first, at T positions.

    `pairs` (c) are the bodies i < j of each; `places` (3, c, T) holds (x, y, 1) of a center at
    (x, y), m, in the ground frame, (cos, sin, 0) of one at infinity, NaN if none exists. `by_rates`
    (c, T) tells which are from the rates, `steps` (c) how the others were deduced.
    """

    bodies: tuple[str, ...]
    pairs: tuple[Pair, ...]
    places: Real
    by_rates: np.ndarray
    steps: tuple[KennedyStep, ...]

    @property
    def points(self) -> Complex:
        """Centers (c, T) as complex numbers, m; NaN where at infinity or none."""
        x, y, w = self.places
        return np.where(w == 1, x + 1j * y, complex(np.nan, np.nan))

    @property
    def directions(self) -> Real:
        """Directions (c, T) of centers at infinity, rad, from 0 to π; NaN for all others."""
        x, y, w = self.places
        return np.where(w == 0, np.arctan2(y, x), np.nan)

    def row(self, one: str, other: str) -> int:
        """The row of the center of two bodies; raises LinkageError if they are not a pair."""
        numbers = sorted(number_of(self.bodies, name) for name in (one, other))
        if numbers[0] == numbers[1]:
            raise LinkageError(f'{one} has no center with itself: name two bodies')
        return self.pairs.index((numbers[0], numbers[1]))


def instant_centers(mechanism: Mechanism, values: Real, rates: Real | None = None) -> Centers:
    """
    All instant centers: by Kennedy's theorem, and those that it does not determine by the rates.

    Parameters
    ----------
    mechanism
        The linkage.
    values
        Its variables (n, T), m and rad.
    rates
        Rates of the drivers (d,) or (d, T), per s, needed for several drivers. Kennedy's centers
        do not depend on them, and hold also where the drivers do not determine the motion.

    Returns
    -------
    Centers
        The centers of all pairs of bodies, m, in the ground's frame, with the steps that lead to
        them.

    Raises
    ------
    LinkageError
        If the rates are needed and not given.

    """
    steps = deduce(mechanism, values)
    centers = kennedy_centers(mechanism, steps, values)
    missing = np.isnan(centers[2])
    if missing.any():
        centers = np.where(missing, centers_by_rates(mechanism, values, rates), centers)
    return Centers(bodies_of(mechanism), pairs_of(mechanism), centers, missing, steps)


def centers_by_rates(mechanism: Mechanism, values: Real, rates: Real | None = None) -> Real:
    """
    All instant centers, `places` (3, c, T) as in Centers, from the rates alone.

    With velocities c + iωP of the points P of each body, the center is at i (c_j - c_i) /
    (ω_j - ω_i), so where the rates are equal it is at infinity, at a right angle to the velocity.
    NaN where two bodies have equal motions, or the drivers do not determine the motion (a dead
    point). Arguments and errors as in `instant_centers`.
    """
    values = np.asarray(values, float)
    velocity, turning = mechanism.unit_rates(values)[:2]
    if rates is None:
        if len(velocity) != 1:
            raise LinkageError(
                f'centers depend on the rates of the {len(velocity)} drivers: give them'
            )
        rates = np.ones(1)
    weights = np.asarray(rates, float).reshape(len(velocity), 1, -1)
    poses = poses_of(mechanism.assembly, values)
    middle, size = joint_extent(mechanism.assembly, poses)
    position = np.stack([pose.position for pose in poses.values()])
    omega = np.concatenate((np.zeros((1, len(middle))), (weights * turning).sum(axis=0)))
    shift = (weights * velocity).sum(axis=0) - 1j * omega[1:] * (position[1:] - middle)
    shift = np.concatenate((np.zeros((1, len(middle)), complex), shift)) / size
    largest = np.sqrt(np.abs(shift) ** 2 + omega**2).max(axis=0)
    i, j = np.array(pairs_of(mechanism)).reshape(-1, 2).T
    toward, w = 1j * (shift[j] - shift[i]), omega[j] - omega[i]
    vectors, length = unit(np.stack((toward.real, toward.imag, w)))
    return outward(np.where(length > EQUAL_RATES * largest, vectors, np.nan), middle, size)
