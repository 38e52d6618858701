"""
Centrodes of two bodies of a linkage: the loci of their instant center in the frame of either.

One rolls on the other without slip, so a pair of them, cut out and laid on each other, moves as the
linkage does: pitch curves of non-circular gears.
"""

from math import comb
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import joint_extent
from kinpole_ros.mechanism._joints import GROUND, Revolute
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.mechanism._motions import rotation_derivatives
from kinpole_ros.planar import (
    centrode_curvature,
    icr_velocity,
    moving_centrode_curvature,
    pole,
)
from kinpole_ros.planar._plane import Complex, Real

# In sizes of the linkage: farther off a center is as good as at infinity.
_FARTHEST = 1e3
# A center that moves by less than so many sizes of the linkage per rad stands still.
_STILL = 1e-9
# Ends of a range this near to a change point, in shares of the range, are at it.
_ROUNDING = 1e-9
# Samples keep so far from a change point, in steps: right there nothing is determined, and digits
# are lost near by.
_CLEARANCE = 0.5
# Nodes of Gauss's rule between two samples, for arc lengths.
_NODES = 6
_NOWHERE = complex(np.nan, np.nan)
# In sizes of the linkage: beyond this distance a pole is at infinity but for rounding.
_INFINITY = 1e9


class Centrodes(NamedTuple):
    """
    Centrodes of the bodies `one` and `other` at the inputs `at` (T,).

    `fixed` (T,) complex, m, is the center in the frame of `one`, `moving` (T,) in that of `other`,
    NaN where it is at infinity or the linkage at a dead point. Curvatures (T,), 1/m, are positive
    where a curve turns left as `at` rises, NaN where the center stands still. `piece` (T,) numbers
    the pieces between breaks, where the center passes infinity, -1 at NaN; arc lengths (T,), m,
    are from the start of each piece, each by its own curve's velocity. `pins` are those of `one`
    and of `other`, complex, m, in their own frames; `size`, m, is that of the linkage.
    """

    one: str
    other: str
    at: Real
    fixed: Complex
    moving: Complex
    fixed_curvature: Real
    moving_curvature: Real
    fixed_length: Real
    moving_length: Real
    piece: np.ndarray
    pins: tuple[Complex, Complex]
    size: float

    @property
    def slip(self) -> float:
        """By how much the lengths rolled differ at most, over the longer of 1 size and the way."""
        differ = np.abs(self.fixed_length - self.moving_length)
        return float(np.nanmax(differ / np.fmax(self.size, self.fixed_length)))


def centrodes(
    mechanism: Mechanism, one: str, other: str, low: float, high: float, count: int = 721
) -> Centrodes:
    """
    Centrodes of two bodies of a linkage with one driver.

    Parameters
    ----------
    mechanism
        The linkage.
    one, other
        Names of the bodies; the curves are in their frames.
    low, high
        Inputs from where to where, m or rad, or as far as the linkage goes.
    count
        Samples at equal inputs; toward a limit, closer and closer, since there the input stands
        still while all else moves.

    Returns
    -------
    Centrodes
        Both curves, m, with the inputs.

    Raises
    ------
    LinkageError
        For several drivers, bodies that are not a pair of the linkage's, fewer than two samples,
        and bodies that never turn against each other.

    """
    for name in (one, other):
        if name != GROUND and name not in mechanism.bodies:
            names = ', '.join((GROUND, *mechanism.bodies))
            raise LinkageError(f'there is no body {name}: name one of {names}')
    if one == other:
        raise LinkageError(f'{one} has no centrode with itself: name two bodies')
    if len(mechanism.drivers) != 1:
        raise LinkageError(
            f'{len(mechanism.drivers)} drivers leave the centrodes open: hold all but one'
        )
    if count < 2 or not low < high:
        raise LinkageError(
            f'{count} samples from {low:g} to {high:g} are no range: '
            'give two or more, from a lower to a higher input'
        )
    low, high, ends, crossings = _range(mechanism, low, high)
    samples = _samples(count, ends, (crossings - low) / (high - low))
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    step = np.diff(samples)
    between = samples[:-1, None] + step[:, None] * (nodes + 1) / 2
    shares = np.concatenate((samples, between.ravel()))
    along, rate = _warp(shares, ends)
    motion = mechanism.sweep(low + (high - low) * along)
    seen, back = _seen(mechanism, motion, one, other), _seen(mechanism, motion, other, one)
    _, size = joint_extent(mechanism.assembly, motion.values[0])

    with np.errstate(all='ignore'):
        turning = np.where(motion.regular, seen[1][1], np.nan)
        fixed, moving = pole(1, *seen).value, pole(1, *back).value
        far = _FARTHEST * size
        # Measured from the bodies' origins, the one of which may be far off and the other not.
        there = (np.abs(fixed) < far) | (np.abs(moving) < far)
        there &= np.isfinite(fixed) & np.isfinite(moving) & (turning != 0)
        if not there[:count].any():
            raise LinkageError(
                f'{other} does not turn as seen from {one}: their center is at infinity, and '
                'there are no centrodes'
            )
        forward, backward = icr_velocity(*seen).value, icr_velocity(*back).value
        speeds = np.abs(np.stack((forward, backward)))
        curved = there & (speeds.min(axis=0) > _STILL * size * np.abs(turning))
        bends = np.where(curved, centrode_curvature(*seen).value.real, np.nan)
        mates = moving_centrode_curvature(bends, seen[1][1], speeds[0])
        lengths = speeds[:, count:] * (high - low) * rate[count:]
        lengths = lengths.reshape(2, count - 1, _NODES) @ weights * (step / 2)
    sign = np.where(there, np.sign(turning), 0)
    inside = sign[count:].reshape(count - 1, _NODES)
    whole = (inside == sign[: count - 1, None]).all(axis=1) & (sign[: count - 1] == sign[1:count])
    whole &= there[1:count]
    piece, way = _pieces(there[:count], whole, lengths)
    fixed, moving = (np.where(there, points, _NOWHERE)[:count] for points in (fixed, moving))
    return Centrodes(
        one,
        other,
        low + (high - low) * along[:count],
        fixed,
        moving,
        bends[:count],
        mates[:count],
        way[0],
        way[1],
        piece,
        (_pins(mechanism, one), _pins(mechanism, other)),
        size,
    )


def _range(
    mechanism: Mechanism, low: float, high: float
) -> tuple[float, float, tuple[bool, bool], Real]:
    """The inputs from `low` to `high` that are reached, which are limits, and the change points."""
    # Asked for a little more, so that no node of the path is at an end that is a change point.
    more = (high - low) / 20
    path = mechanism.path(low - more, high + more)
    crossings = np.array([dead.at for dead in path.dead_points if not dead.turns_back])
    if path.period:
        first, last = (np.floor((end - path.inputs[0]) / path.period) for end in (low, high))
        turns = path.period * np.arange(first - 1, last + 2)
        return low, high, (False, False), np.add.outer(turns, crossings).ravel()
    limits = [dead.at for dead in path.dead_points if dead.turns_back]
    ends, found = [], []
    for asked, last, beyond in (
        (low, path.inputs[0], low < path.inputs[0]),
        (high, path.inputs[-1], high > path.inputs[-1]),
    ):
        # The last node lies just inside of the limit.
        limit = min(limits, key=lambda at: abs(at - last), default=last)
        found.append(bool(beyond))
        ends.append(float(limit) if beyond else asked)
    return ends[0], ends[1], (found[0], found[1]), crossings


def _samples(count: int, ends: tuple[bool, bool], crossings: Real) -> Real:
    """Samples (count,) from 0 to 1, half a step inside of limits, and clear of change points."""
    first, last = (0.5 if limit else 0.0 for limit in ends)
    steps = count - 1 + first + last
    samples = (np.arange(count) + first) / steps
    crossings = crossings[(crossings > -_ROUNDING) & (crossings < 1 + _ROUNDING)]
    for at in np.interp(crossings, _warp(samples, ends)[0], samples):
        # All to the same side, so that a whole turn stays one.
        clearance = _CLEARANCE / steps
        samples = np.where(np.abs(samples - at) < clearance, at + clearance, samples)
    return samples


def _warp(share: Real, ends: tuple[bool, bool]) -> tuple[Real, Real]:
    """
    Share of the way (T,) in the input for that in the samples, and its derivative.

    Toward a limit as the square, for there all else moves as the root of the input.
    """
    if ends == (True, True):
        return np.sin(np.pi / 2 * share) ** 2, np.pi / 2 * np.sin(np.pi * share)
    if ends == (True, False):
        return share**2, 2 * share
    if ends == (False, True):
        return share * (2 - share), 2 * (1 - share)
    return share, np.ones(share.shape)


def _seen(mechanism: Mechanism, motion: Motion, one: str, other: str) -> tuple[Complex, Real]:
    """Motion of `other` as seen from `one`: origin (5, T), complex, m, and angle (5, T), rad."""
    still = np.zeros(motion.angle[:, 0].shape)
    places, angles = [], []
    for name in (one, other):
        k = -1 if name == GROUND else mechanism.bodies.index(name)
        places.append(still + 0j if k < 0 else motion.position[:, k])
        angles.append(still if k < 0 else motion.angle[:, k])
    between, turn = places[1] - places[0], rotation_derivatives(-angles[0])
    seen = [
        sum(comb(order, j) * between[j] * turn[order - j] for j in range(order + 1))
        for order in range(len(between))
    ]
    return np.stack(seen), angles[1] - angles[0]


def _pieces(there: np.ndarray, whole: np.ndarray, lengths: Real) -> tuple[np.ndarray, Real]:
    """Number the pieces (T,), and sum up the lengths (2, T - 1) between samples on each (2, T)."""
    starts = there & np.concatenate(([True], ~whole))
    piece = np.where(there, np.cumsum(starts) - 1, -1)
    total = np.zeros((2, len(there)))
    total[:, 1:] = np.cumsum(np.where(whole, lengths, 0.0), axis=1)
    before = total[:, np.flatnonzero(starts)][:, np.maximum(piece, 0)]
    return piece, np.where(there, total - before, np.nan)


def _pins(mechanism: Mechanism, body: str) -> Complex:
    """The pins on a body, in its own frame, each once."""
    joints = [joint for joint in mechanism.assembly.joints if isinstance(joint, Revolute)]
    points = [joint.a for joint in joints if joint.one == body]
    points += [joint.b for joint in joints if joint.other == body]
    return np.array(list(dict.fromkeys(complex(point) for point in points)), complex)


class Poles(NamedTuple):
    """
    Of bodies (B) at T positions: `icr`, `iap`, `ijp` and `isp` (B, T), complex, m, in the ground's
    frame.

    `velocity` (B, T), complex, m/s, is that of the ICR along the centrodes, `curvature` (B, T),
    1/m, that of the fixed centrode. NaN where there is none: at infinity, at a dead point, and of
    curvatures where the ICR stands still.
    """

    icr: Complex
    iap: Complex
    ijp: Complex
    isp: Complex
    velocity: Complex
    curvature: Real


def poles(mechanism: Mechanism, motion: Motion) -> Poles:
    """
    The poles of all bodies in a motion.

    Parameters
    ----------
    mechanism
        The linkage.
    motion
        Up to the snap, (5, B, T).

    Returns
    -------
    Poles
        Of B bodies at T instants, complex, m, in the ground's frame.

    """
    position, angle = motion.position, motion.angle
    middle, size = joint_extent(mechanism.assembly, motion.values[0])
    with np.errstate(all='ignore'):
        found = []
        for order in (1, 2, 3, 4):
            place = pole(order, position, angle).value
            near = np.abs(place - middle) < _INFINITY * size
            found.append(np.where(near, place, complex(np.nan, np.nan)))
        icr, iap, ijp, isp = found
        there, still = np.isfinite(icr), _STILL * size * np.abs(angle[1])
        velocity = np.where(there, icr_velocity(position, angle).value, complex(np.nan, np.nan))
        velocity = np.where(np.abs(velocity) < still, 0.0, velocity)
        bend = centrode_curvature(position, angle).value
        curvature = np.where(np.abs(velocity) > still, bend, np.nan)
    return Poles(icr, iap, ijp, isp, velocity, curvature)
