"""
Windows of even samples, whatever is missing in them or off its place.

Models are of even samples. One that is missing, or counts for less than the others, is put where
the most probable model has it by all the rest; one that is off its place is moved there along that
model. So that model has exactly the derivatives that follow from the samples as they are, and their
covariance says what is not known of what is not there.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives._evidence import Found, derive, evidence_of
from kinpole_ros.derivatives._models import (
    Modes,
    Stencils,
    modes_of,
    slopes_of,
    stencils_of,
)
from kinpole_ros.planar._plane import Real

# A sample that is missing is first put on a parabola through so many others.
_NEAREST = 6


def derive_incomplete(
    window: tuple[int, float, int, int], samples: Real, weights: Real, off: Real
) -> Found:
    """
    The same as `derive`, of `samples` (n, 3, S) with `weights` (n, 2, S), 0 to 1, of angle and
    position, all of them `off` (n, S) their places by so many samples.

    The arguments of `stencils_of` are the `window`.
    """
    count, _, block, _ = window
    modes, stencils = modes_of(count, block), stencils_of(*window)
    seen = weights.sum(axis=0)
    given = _filled(samples, weights[:, 1] <= 0)
    uneven = bool(np.count_nonzero(off))
    samples = _moved_by_neighbors(given, off) if uneven else given
    extra = np.zeros((*[window[-1]] * 2, *seen.shape))
    # By what was found with the samples as they were filled and moved at first, and once more.
    for _ in range(2):
        likeliest = evidence_of(modes, samples, seen).evidence.argmax(axis=0)
        moved = np.empty_like(samples)
        for signal, components in enumerate((slice(1), slice(1, 3))):
            model = _likeliest(modes, likeliest[signal])
            part = given[:, components]
            if uneven:
                part = _moved(
                    modes, slopes_of(count, block), model, samples[:, components], part, off
                )
            moved[:, components], extra[:, :, signal] = _by_model(
                modes, stencils, model, part, weights[:, signal]
            )
        samples = moved
    found = derive(modes, stencils, samples, seen)
    return found._replace(covariance=found.covariance + extra)


def _filled(samples: Real, missing: np.ndarray) -> Real:
    """Samples with those `missing` (n, S) on parabolas through the nearest of the others."""
    cell, signal = missing.nonzero()
    if not len(cell):
        return samples
    distance = np.abs(np.arange(len(samples)) - cell[:, None]).astype(float)
    distance[missing.T[signal]] = np.inf
    near = np.argpartition(distance, _NEAREST - 1, axis=1)[:, :_NEAREST]
    place = (near - cell[:, None]) / _NEAREST
    powers = place[..., None] ** np.arange(3)
    first = np.linalg.pinv(powers)[:, :1]  # (M, 1, _NEAREST): what a parabola is at the cell
    filled = samples.copy()
    filled[cell, :, signal] = (first @ samples[near, :, signal[:, None]])[:, 0]
    return filled


def _moved_by_neighbors(samples: Real, off: Real) -> Real:
    """Samples moved to their places by parabolas through their neighbors."""
    place = np.arange(len(samples))[:, None] + off
    a, b, c = place[:-2], place[1:-1], place[2:]
    y = samples
    first = (y[1:-1] - y[:-2]) / (b - a)[:, None]
    second = (y[2:] - y[1:-1]) / (c - b)[:, None]
    bend = (second - first) / (c - a)[:, None]
    slope = first + bend * (b - a)[:, None]
    at = off[1:-1, None]
    moved = samples.copy()
    moved[1:-1] -= at * slope - at**2 * bend
    moved[0] -= off[0] * first[0]
    moved[-1] -= off[-1] * second[-1]
    return moved


class _Model(NamedTuple):
    """The most probable models of S signals: process, amplitude, modes and their shares (S, m)."""

    process: np.ndarray
    amplitude: np.ndarray
    place: np.ndarray
    share: Real


def _likeliest(modes: Modes, model: np.ndarray) -> _Model:
    """Models by their numbers (S,), rest as the last process, a line; lines are among the modes."""
    amplitudes = modes.share.shape[1]
    number = np.minimum(model, len(modes.share) * amplitudes - 1)
    process, amplitude = np.divmod(number, amplitudes)
    lines = np.tile((0, len(modes.even)), (len(process), 1))
    place = np.concatenate((modes.place[process], lines), axis=1)
    share = np.concatenate((modes.share[process, amplitude], np.ones(lines.shape)), axis=1)
    return _Model(process, amplitude, place, share)


def _own(modes: Modes, model: _Model, samples: Real) -> Real:
    """The modes (S, m, C) of each signal's model."""
    signals = np.arange(samples.shape[-1])[:, None]
    return np.asarray(np.tensordot(modes.vectors, samples, 1)[model.place, :, signals])


def _moved(
    modes: Modes, slopes: Real, model: _Model, samples: Real, given: Real, off: Real
) -> Real:
    """The `given` samples moved to their places along the model of the `samples`."""
    own = _own(modes, model, samples) * model.share[..., None]
    first, second = (slopes[:, model.place].swapaxes(-1, -2) @ own).transpose(0, 2, 3, 1)
    return given - off[:, None] * first - off[:, None] ** 2 / 2 * second


def _by_model(
    modes: Modes, stencils: Stencils, model: _Model, samples: Real, weights: Real
) -> tuple[Real, Real]:
    """
    Samples that are not to count in full as the most probable model has them by the others.

    Also what that adds to the covariance (K, K, S).
    """
    orders = stencils.line.shape[1]
    lacking = weights < 1
    most = int(lacking.sum(axis=0).max())
    signals = np.arange(samples.shape[-1])
    if not most:
        return samples, np.zeros((orders, orders, len(signals)))
    cells = np.argsort(~lacking, axis=0, kind='stable')[:most].T  # (S, X)
    weight = weights.T[signals[:, None], cells]
    vectors = modes.vectors[model.place[:, :, None], cells[:, None]]  # (S, m, X)
    vectors = np.where(weight[:, None] < 1, vectors, 0.0)
    own = _own(modes, model, samples)
    fit = vectors.swapaxes(1, 2) @ (model.share[..., None] * own)
    there = samples[cells, :, signals[:, None]]  # (S, X, C)
    unit = np.eye(most)
    left = unit - (vectors * model.share[..., None]).swapaxes(1, 2) @ vectors
    system = left * (1 - weight)[:, None] + weight[:, :, None] * unit
    error = np.linalg.solve(system, np.where(weight[..., None] < 1, there - fit, 0.0))
    samples = samples.copy()
    samples[cells, :, signals[:, None]] = there - (1 - weight)[..., None] * error
    gains = stencils.modes.reshape(*modes.share.shape[:2], orders, -1)
    gains = gains[model.process, model.amplitude]
    line = np.broadcast_to(stencils.line.T, (len(signals), orders, 2))
    rows = np.concatenate((gains, line), axis=2) @ vectors  # (S, K, X)
    extra = (rows * (1 - weight)[:, None]) @ np.linalg.solve(system, rows.swapaxes(1, 2))
    return samples, extra.transpose(1, 2, 0)
