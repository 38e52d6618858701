"""
Derivatives of poses within a window: the mean over all models, by how probable each is.

What the models disagree about is part of the covariance. There each spectrum counts as much as the
others: how the harmonics of a motion fall below its noise is what the samples cannot tell.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives._models import Modes, Stencils
from kinpole_ros.planar._plane import Real

# The noise as it was measured counts for so many samples.
_KNOWN = 300.0
# Models with less weight than this do not count.
_LEAST = 1e-5
# Of angle and position: how many components, and which of both each component is of.
_COMPONENTS = np.array((1, 2))
_SIGNAL = [0, 1, 1]


class Found(NamedTuple):
    """
    Of S bodies: derivatives `mean` (K, 3, S) of angle and both coordinates.

    `covariance` (K, K, 2, S) is that of the angle and of one coordinate, `freedom` (2, S) how many
    parameters their motions have.
    """

    mean: Real
    covariance: Real
    freedom: Real


class Evidence(NamedTuple):
    """
    Modes (modes + 1, 3 S) of S bodies, and what M models say of them.

    `variance` (M, 2, S) is that of the noise, of angle and position, and `evidence` (M, 2, S) the
    logarithm of a model's probability, up to a constant.
    """

    modes: Real
    variance: Real
    evidence: Real


def evidence_of(modes: Modes, samples: Real, seen: Real | float) -> Evidence:
    """How probable models are by the samples, as for `derive`."""
    count, _, bodies = samples.shape
    half = (count + 1) // 2
    flat = samples.reshape(count, -1)
    first, last = flat[:half], flat[: -half - 1 : -1]
    rows = np.zeros((len(modes.vectors), flat.shape[1]))
    np.matmul(modes.even, first + last, out=rows[: len(modes.even)])
    np.matmul(modes.odd, first - last, out=rows[len(modes.even) : -1])
    mean, slope = rows[0], rows[len(modes.even)]
    each = rows[modes.place]  # (P, m, 3 S)
    moved = modes.share @ (each * each)  # (P, A, 3 S)
    rest = np.empty((len(modes.prior), 3 * bodies))
    rest[-1] = np.einsum('nr,nr->r', flat, flat) - mean * mean
    np.subtract(rest[-1] - slope * slope, moved.reshape(-1, 3 * bodies), out=rest[:-1])
    rest = np.maximum(rest, 0.0, out=rest).reshape(-1, 3, bodies)
    rest[:, 1] += rest[:, 2]
    number = _KNOWN + seen * _COMPONENTS[:, None]
    variance = (rest[:, :2] + _KNOWN) / number
    evidence = modes.chances - (number / 2) * np.log(variance)
    return Evidence(rows, variance, evidence)


def derive(modes: Modes, stencils: Stencils, samples: Real, seen: Real | float) -> Found:
    """
    Differentiate `samples` (n, 3, S) of angle and coordinates, in deviations of their noise.

    So many of them are `seen` (2, S), the others are not. Angle and position are judged apart; a
    position's two coordinates have one model. Time is in samples.
    """
    rows, variance, evidence = evidence_of(modes, samples, seen)
    bodies = samples.shape[2]
    mean = rows[0]
    likely, weights = _weights(evidence.reshape(len(evidence), -1), modes.groups)
    orders, amplitudes = stencils.line.shape[1], modes.share.shape[1]
    # Only of processes that count for any of the bodies.
    some = weights[:-1].reshape(-1, amplitudes * 2 * bodies).any(axis=1).nonzero()[0]
    models = np.append((amplitudes * some[:, None] + np.arange(amplitudes)).ravel(), -1)
    off = np.zeros((len(models), orders, 3 * bodies))
    within = off[:-1].reshape(len(some), amplitudes * orders, 3 * bodies)
    np.matmul(stencils.modes[some], rows[modes.place[some]], out=within)
    off[:-1] += stencils.line.T @ rows[[0, len(modes.even)]]
    off[-1, 0] = stencils.line[0, 0] * mean
    off = off.reshape(len(models), orders, 3, bodies)
    by = likely[models].reshape(-1, 2, bodies)[:, _SIGNAL]
    result = np.einsum('mcs,mkcs->kcs', by, off)
    off -= result
    covariance = stencils.covariance.T @ (weights * variance.reshape(len(variance), -1))
    # (S, 3, K, M): what the models disagree about.
    off = np.ascontiguousarray(off.transpose(3, 2, 1, 0))
    by = weights[models].reshape(-1, 2, bodies).transpose(2, 1, 0)[:, _SIGNAL, None]
    apart = ((off * by) @ off.swapaxes(-1, -2)).transpose(2, 3, 1, 0)
    covariance = covariance.reshape(orders, orders, 2, bodies)
    covariance[:, :, 0] += apart[:, :, 0]
    covariance[:, :, 1] += (apart[:, :, 1] + apart[:, :, 2]) / 2
    freedom = (modes.freedom @ likely).reshape(2, bodies)
    return Found(result, covariance, freedom)


def _weights(evidence: Real, groups: np.ndarray) -> tuple[Real, Real]:
    """Probabilities (M, S) of models of the `evidence` (M, S), and their weights in covariances."""
    *spectra, simple = groups
    # For covariances evidence counts to the power of 1/2: the likeliest model is not the only one.
    weights = np.exp((evidence - evidence.max(axis=0)) / 2)
    likely = weights * weights
    # Of each spectrum beside the low polynomials and rest, unless it is out of the question.
    low = weights[simple:]
    total = np.add.reduceat(weights[:simple], spectra) + low.sum(axis=0)
    inverse = np.divide(1.0, total, out=np.zeros_like(total), where=total > 1e-300)
    weights[:simple] *= np.repeat(inverse, np.diff(groups), axis=0)
    low *= inverse.sum(axis=0)
    weights /= weights.sum(axis=0)
    least = weights < _LEAST
    weights[least] = likely[least] = 0.0
    return likely / likely.sum(axis=0), weights
