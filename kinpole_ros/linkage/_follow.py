"""
Bodies of estimated shape followed through points in no order.

Where single points pass each other they cannot be identified; the shapes of the bodies identify
them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kinpole_ros.linkage.limits import GATE, OUTLIER_SIGMAS
from kinpole_ros.planar._plane import Complex, Real

# A point may be this share of a body's size away.
_MAX_STEP = 0.4
# Least gain of a smoothed rate.
_MIN_GAIN = 0.25
# First prediction error, as a share of the size of the body.
_FIRST_ERROR = 0.05
_ROUNDS = 3
_NAN = complex(np.nan, np.nan)


@dataclass
class Shapes:
    """
    Markers of B bodies, one body after the other, N in all.

    `local` (B, w) are their places in the body's frame, filled with 0. `body` and `column` (N,) are
    their rows and columns in it. `number` (N,) is the same for one marker on the axis of a pin that
    is on two bodies. `size` (B,) is the largest distance of two markers.
    """

    local: Complex
    body: np.ndarray
    column: np.ndarray
    number: np.ndarray
    size: Real


@dataclass
class _State:
    """Last poses (B,) of bodies, their rates per step, prediction errors, and step numbers."""

    position: Complex
    angle: Real
    speed: Complex
    turning: Real
    error: Real
    step: np.ndarray


def stacked_shapes(shapes: Sequence[Complex], numbers: Sequence[Sequence[int]]) -> Shapes:
    """Stack the `shapes` of bodies, whose markers have these `numbers`."""
    counts = [len(shape) for shape in shapes]
    body = np.repeat(np.arange(len(shapes)), counts)
    column = np.concatenate([np.arange(count) for count in counts])
    local = np.zeros((len(shapes), max(counts)), complex)
    local[body, column] = np.concatenate(shapes)
    size = np.array([np.abs(shape[:, None] - shape).max() for shape in shapes])
    return Shapes(local, body, column, np.concatenate(numbers), size)


def follow(
    points: Complex,
    steps: np.ndarray,
    shapes: Shapes,
    poses: tuple[Complex, Real],
    noise: float,
    progress: Callable[[float], None] | None = None,
    begin: tuple[int, int] | None = None,
) -> Complex:
    """
    Find the markers of bodies (T, N) among `points` (T, n) in no order, NaN for none.

    `poses` are the positions and angles (T, B) as far as they are known, NaN elsewhere. The bodies
    are followed back from the first frame of `begin` and on from the second, by default from the
    middle of the estimated poses. `steps` (T,) number the frames.
    """
    position, angle = poses
    tracks = np.full((len(points), len(shapes.body)), _NAN)
    estimated = np.isfinite(angle).all(axis=1).nonzero()[0]
    middle = int(estimated[len(estimated) // 2])
    back, on = begin or (middle, middle)
    seen = np.isfinite(points.real)
    done = 0
    for start, frames in ((on, range(on, len(points))), (back, range(back - 1, -1, -1))):
        first, second = estimated[np.abs(estimated - start).argsort()[:2]]
        interval = int(steps[second] - steps[first])
        state = _State(
            position[start].copy(),
            angle[start].copy(),
            (position[second] - position[first]) / interval,
            (angle[second] - angle[first]) / interval,
            _FIRST_ERROR * shapes.size,
            np.full(len(shapes.size), int(steps[start])),
        )
        for k in frames:
            done += 1
            if progress is not None and done % 500 == 0:
                progress(min(1.0, done / len(points)))
            measured = points[k, seen[k]]
            if len(measured):
                match = _advance(state, measured, int(steps[k]), shapes, noise)
                tracks[k] = np.where(match >= 0, measured[match], _NAN)
    return tracks


def _advance(
    state: _State, measured: Complex, step: int, shapes: Shapes, noise: float
) -> np.ndarray:
    """Move the state on; returns which of the measured points (m,) each marker (N,) is, or -1."""
    body, column, local = shapes.body, shapes.column, shapes.local
    gap = step - state.step
    turn = np.exp(1j * (state.angle + state.turning * gap))
    predicted = (state.position + state.speed * gap)[body] + (turn[:, None] * local)[body, column]
    off = np.abs(predicted[:, None] - measured)
    growth = np.abs(gap) ** 1.5
    gate = GATE * np.maximum(state.error, noise) * np.maximum(growth, 1)
    gate = np.minimum(gate, _MAX_STEP * shapes.size)
    match = off.argmin(axis=1)
    nearest = off[np.arange(len(match)), match]
    is_mutual = shapes.number[off.argmin(axis=0)[match]] == shapes.number
    used = is_mutual & (nearest < gate[body])
    for _ in range(_ROUNDS):
        weight = np.zeros(local.shape)
        weight[body[used], column[used]] = 1.0
        at = np.zeros(local.shape, complex)
        at[body[used], column[used]] = measured[match[used]]
        count = weight.sum(axis=1)
        mean = at.sum(axis=1) / np.maximum(count, 1)
        center = (weight * local).sum(axis=1) / np.maximum(count, 1)
        arms = weight * (local - center[:, None])
        cross = (at * arms.conj()).sum(axis=1)
        is_fitted = (count > 1) & (np.abs(cross) > 0)
        fitted_turn = np.where(is_fitted, cross / np.where(is_fitted, np.abs(cross), 1), 1)
        residual = weight * np.abs(at - mean[:, None] - fitted_turn[:, None] * arms)
        is_bad = is_fitted & (residual.max(axis=1) > OUTLIER_SIGMAS * noise)
        if not is_bad.any():
            break
        # The worst marker is left out; of two markers neither is estimated to be right.
        worst = residual.argmax(axis=1)
        used &= ~(is_bad[body] & ((column == worst[body]) | (count[body] == 2)))
    position = mean - fitted_turn * center
    swing = np.angle(fitted_turn * turn.conj())
    angle = state.angle + state.turning * gap + swing
    error = np.zeros(len(shapes.size))
    np.maximum.at(error, body[used], nearest[used])
    moved = is_fitted & (gap != 0)
    interval = np.where(gap == 0, 1, gap)
    # Rates are smoothed where an innovation is mostly noise, so that gaps are bridged.
    gain = np.maximum(_MIN_GAIN, error**2 / (error**2 + (4 * noise) ** 2))
    change = gain * (position - state.position - state.speed * gap) / interval
    state.speed = np.where(moved, state.speed + change, state.speed)
    state.turning = np.where(moved, state.turning + gain * swing / interval, state.turning)
    smoothed = 0.7 * state.error + 0.3 * error / np.maximum(growth, 1)
    state.error = np.where(is_fitted, smoothed, state.error)
    state.position = np.where(is_fitted, position, state.position)
    state.angle = np.where(is_fitted, angle, state.angle)
    state.step = np.where(is_fitted, step, state.step)
    return np.where(used & is_fitted[body], match, -1)
