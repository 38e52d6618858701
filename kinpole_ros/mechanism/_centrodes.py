"""
Centrodes of two bodies of a linkage, and the poles of all its bodies.

Centrodes are the loci of the instant center of two bodies in the frame of either. One rolls on the
other without slip, so a pair of them, cut out and laid on each other, moves as the linkage does:
pitch curves of non-circular gears.
"""

from math import comb
from typing import NamedTuple

import numpy as np

from kinpole_ros.mechanism._assembly import joint_extent, poses_of
from kinpole_ros.mechanism._joint_kinds import GROUND
from kinpole_ros.mechanism._loops import LinkageError
from kinpole_ros.mechanism._mechanism import Mechanism, Motion
from kinpole_ros.mechanism._motions import rotation_derivatives
from kinpole_ros.planar import (
    ball_point,
    centrode_curvature,
    icr_acceleration,
    icr_velocity,
    inflection_circle,
    moving_centrode_curvature,
    pole,
    to_complex,
    to_plane,
)
from kinpole_ros.planar._plane import Complex, Real

# In sizes of the linkage: beyond this distance a center is treated as at infinity; a pole is there
# but for rounding.
_FARTHEST, _INFINITY = 1e3, 1e9
# A center that moves by less than this, in sizes of the linkage per rad, stands still.
_STILL = 1e-9
# Ends of a range this near to a change point, as a share of the range, are at it.
_AT_CHANGE_POINT = 1e-9
# Distance of samples from a change point, in steps: near it digits are lost.
_CLEARANCE = 0.5
# Nodes of Gauss's rule between two samples, for arc lengths.
_NODES = 6
_NAN = complex(np.nan, np.nan)


class Centrodes(NamedTuple):
    """
    Centrodes of the bodies `one` and `other` at the inputs `at` (T,).

    `fixed` (T,) complex, m, is the center in the frame of `one`, `moving` (T,) in that of `other`,
    NaN where it is at infinity or the linkage at a dead point. Curvatures (T,), 1/m, are positive
    where a curve turns left as `at` rises, NaN where the center stands still. `piece` (T,) numbers
    the pieces between breaks, where the center passes infinity, -1 at NaN. Arc lengths (T,), m, are
    from the start of each piece, each by its own curve's velocity. `pins` are those of `one` and of
    `other`, complex, m, in their own frames; `size`, m, is that of the linkage.
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
        """The largest difference of the rolled lengths, over the larger of them and 1 size."""
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
        Range of the input, m or rad, or as far as the linkage goes.
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
    _check(mechanism, one, other, low, high, count)
    low, high, ends, crossings = _range(mechanism, low, high)
    samples = _samples(count, ends, (crossings - low) / (high - low))
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    step = np.diff(samples)
    between = samples[:-1, None] + step[:, None] * (nodes + 1) / 2
    share, rate = _warp(np.concatenate((samples, between.ravel())), ends)
    motion = mechanism.sweep(low + (high - low) * share)
    of_other = _relative(mechanism, motion, one, other)
    of_one = _relative(mechanism, motion, other, one)
    _, size = joint_extent(mechanism.assembly, poses_of(mechanism.assembly, motion.values[0]))
    omega = np.where(motion.regular, of_other[1][1], np.nan)
    with np.errstate(all='ignore'):
        fixed, moving = pole(1, *of_other).value, pole(1, *of_one).value
        exists = _existing(fixed, moving, omega, size)
        _check_turns(exists[:count], one, other)
        speeds = np.abs(np.stack([icr_velocity(*part).value for part in (of_other, of_one)]))
        moves = exists & (speeds.min(axis=0) > _STILL * size * np.abs(omega))
        curvature = np.where(moves, centrode_curvature(*of_other).value.real, np.nan)
        moving_curvature = moving_centrode_curvature(curvature, of_other[1][1], speeds[0])
    rates = (speeds[:, count:] * (high - low) * rate[count:]).reshape(2, count - 1, _NODES)
    unbroken = _unbroken(exists, omega, count)
    piece, arc = _pieces(exists[:count], unbroken, rates @ weights * (step / 2))
    fixed, moving = (np.where(exists, points, _NAN)[:count] for points in (fixed, moving))
    curvatures = curvature[:count], moving_curvature[:count]
    inputs, lengths = low + (high - low) * share[:count], (arc[0], arc[1])
    pins = _pins(mechanism, one), _pins(mechanism, other)
    return Centrodes(one, other, inputs, fixed, moving, *curvatures, *lengths, piece, pins, size)


def _check_turns(exists: np.ndarray, one: str, other: str) -> None:
    if not exists.any():
        raise LinkageError(
            f'{other} does not turn as seen from {one}: their center is at infinity, and there are '
            'no centrodes'
        )


def _existing(fixed: Complex, moving: Complex, omega: Real, size: float) -> np.ndarray:
    """
    Return where centers at `fixed` and `moving` (T,), m, in both bodies' frames are not far away.

    Distances are from the bodies' origins, of which one alone may be far away.
    """
    is_near = (np.abs(fixed) < _FARTHEST * size) | (np.abs(moving) < _FARTHEST * size)
    return is_near & np.isfinite(fixed) & np.isfinite(moving) & (omega != 0)


def _unbroken(exists: np.ndarray, omega: Real, count: int) -> np.ndarray:
    """Return where the center exists between samples, and the bodies turn one way."""
    sign = np.where(exists, np.sign(omega), 0)
    inside = sign[count:].reshape(count - 1, _NODES)
    turns_alike = (inside == sign[: count - 1, None]).all(axis=1) & exists[1:count]
    return np.asarray(turns_alike & (sign[: count - 1] == sign[1:count]))


def _check(mechanism: Mechanism, one: str, other: str, low: float, high: float, count: int) -> None:
    bodies = (GROUND, *mechanism.bodies)
    for name in (one, other):
        if name not in bodies:
            raise LinkageError(f'there is no body {name}: name one of {", ".join(bodies)}')
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


def _range(
    mechanism: Mechanism, low: float, high: float
) -> tuple[float, float, tuple[bool, bool], Real]:
    """The reached inputs from `low` to `high`, which ends are limits, and the change points."""
    # A little more is requested, so that no node of the path is at an end that is a change point.
    margin = (high - low) / 20
    path = mechanism.path(low - margin, high + margin)
    crossings = np.array([dead.at for dead in path.dead_points if not dead.turns_back])
    if path.period:
        first, last = (np.floor((end - path.inputs[0]) / path.period) for end in (low, high))
        turns = path.period * np.arange(first - 1, last + 2)
        return low, high, (False, False), np.add.outer(turns, crossings).ravel()
    limits = [dead.at for dead in path.dead_points if dead.turns_back]
    first, last = float(path.inputs[0]), float(path.inputs[-1])
    is_limit = low < first, high > last
    # The last node lies just inside of the limit.
    if is_limit[0]:
        low = float(min(limits, key=lambda at: abs(at - first), default=first))
    if is_limit[1]:
        high = float(min(limits, key=lambda at: abs(at - last), default=last))
    return low, high, is_limit, crossings


def _samples(count: int, ends: tuple[bool, bool], crossings: Real) -> Real:
    """Samples (count,) from 0 to 1, half a step inside of limits, and clear of change points."""
    first, last = (0.5 if limit else 0.0 for limit in ends)
    steps = count - 1 + first + last
    samples = (np.arange(count) + first) / steps
    inside = (crossings > -_AT_CHANGE_POINT) & (crossings < 1 + _AT_CHANGE_POINT)
    for at in np.interp(crossings[inside], _warp(samples, ends)[0], samples):
        # All to the same side, so that a whole turn stays one.
        clearance = _CLEARANCE / steps
        samples = np.where(np.abs(samples - at) < clearance, at + clearance, samples)
    return samples


def _warp(share: Real, ends: tuple[bool, bool]) -> tuple[Real, Real]:
    """
    Share (T,) of the range of the input for a share of the samples, and its derivative.

    Toward a limit it is the square, since all else moves as the root of the input there.
    """
    if ends == (True, True):
        return np.sin(np.pi / 2 * share) ** 2, np.pi / 2 * np.sin(np.pi * share)
    if ends == (True, False):
        return share**2, 2 * share
    if ends == (False, True):
        return share * (2 - share), 2 * (1 - share)
    return share, np.ones(share.shape)


def _relative(mechanism: Mechanism, motion: Motion, one: str, other: str) -> tuple[Complex, Real]:
    """Motion of `other` relative to `one`: origin (5, T), complex, m, and angle (5, T), rad."""
    still = np.zeros(motion.angle[:, 0].shape)
    origins, angles = [], []
    for name in (one, other):
        k = -1 if name == GROUND else mechanism.bodies.index(name)
        origins.append(still + 0j if k < 0 else motion.position[:, k])
        angles.append(still if k < 0 else motion.angle[:, k])
    between, turn = origins[1] - origins[0], rotation_derivatives(-angles[0])
    relative = [
        sum(comb(order, j) * between[j] * turn[order - j] for j in range(order + 1))
        for order in range(len(between))
    ]
    return np.stack(relative), angles[1] - angles[0]


def _pieces(exists: np.ndarray, unbroken: np.ndarray, lengths: Real) -> tuple[np.ndarray, Real]:
    """Number the pieces (T,), and sum up the lengths (2, T - 1) between samples on each (2, T)."""
    starts = exists & np.concatenate(([True], ~unbroken))
    piece = np.where(exists, np.cumsum(starts) - 1, -1)
    total = np.zeros((2, len(exists)))
    total[:, 1:] = np.cumsum(np.where(unbroken, lengths, 0.0), axis=1)
    before = total[:, np.flatnonzero(starts)][:, np.maximum(piece, 0)]
    return piece, np.where(exists, total - before, np.nan)


def _pins(mechanism: Mechanism, body: str) -> Complex:
    """The pins on a body, in its own frame, each once."""
    joints = [joint for joint in mechanism.assembly.joints if joint.center().kind == 'pin']
    points = [joint.a for joint in joints if joint.one == body]
    points += [joint.b for joint in joints if joint.other == body]
    return np.array(list(dict.fromkeys(complex(point) for point in points)), complex)


class Poles(NamedTuple):
    """
    The poles `icr`, `iap`, `ijp` and `isp` (B, T) of bodies, complex, m, in the ground's frame.

    `velocity` (B, T), complex, m/s, is that of the ICR along the centrodes, `curvature` (B, T),
    1/m, that of the fixed centrode. `inflection_circle` and `ball_point` (B, T) are complex, m, and
    `inflection_diameter` (B, T) is in m. NaN where it does not exist: at infinity, at a dead point,
    and of what is behind `velocity` where the ICR stands still.
    """

    icr: Complex
    iap: Complex
    ijp: Complex
    isp: Complex
    velocity: Complex
    curvature: Real
    inflection_circle: Complex
    inflection_diameter: Real
    ball_point: Complex


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
        Those of B bodies at T instants, complex, m, in the ground's frame.

    """
    position, angle = motion.position, motion.angle
    middle, size = joint_extent(mechanism.assembly, poses_of(mechanism.assembly, motion.values[0]))
    with np.errstate(all='ignore'):
        points = [pole(order, position, angle).value for order in (1, 2, 3, 4)]
        near = [np.where(np.abs(p - middle) < _INFINITY * size, p, _NAN) for p in points]
        icr, iap, ijp, isp = near
        still = _STILL * size * np.abs(angle[1])
        velocity = np.where(np.isfinite(icr), icr_velocity(position, angle).value, _NAN)
        velocity = np.where(np.abs(velocity) < still, 0.0, velocity)
        moves = np.abs(velocity) > still
        curvature = np.where(moves, centrode_curvature(position, angle).value, np.nan)
        moving = to_plane(icr), to_plane(np.where(moves, velocity, _NAN))
        circle = inflection_circle(angle[1], *moving)
        acceleration = to_plane(icr_acceleration(position, angle).value)
        ball = ball_point(angle[1], angle[2], *moving, acceleration)
    of_circle = to_complex(circle.center), circle.diameter, to_complex(ball)
    return Poles(icr, iap, ijp, isp, velocity, curvature, *of_circle)
