"""
What is different for models where samples of a window are missing, or count for less than others.

Models are of even samples that are all as good. One that is less good has more noise, one that is
missing has no end of it: that changes few rows of the covariance of all samples, and what follows
is exact for each model (the matrix inversion lemma; Rasmussen and Williams, Gaussian Processes for
Machine Learning, 2006, A.3).
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives._models import Modes
from kinpole_ros.planar._plane import Real

_SIGNAL = [0, 1, 1]


class Lacking(NamedTuple):
    """
    X `cells` (X, S) of the samples of S bodies that count only for `weight` (X, 2, S), 0 to 1, of
    angle and position. Those of weight 1 are as good as others.
    """

    cells: np.ndarray
    weight: Real


class Lacks(NamedTuple):
    """
    What M models lack: `less` (M, 3, S) by which the squares of what is left are smaller, and
    `log` (M, 2, S), half of the logarithm by which the determinant is larger.

    `gain` (X, X, M, 2, S) is the covariance of what is off at the cells, over that of the noise,
    inverted, and `error` (X, M, 3, S) how far cells are off by it.
    """

    less: Real
    log: Real
    gain: Real
    error: Real

    def correct(self, models: np.ndarray, reach: Real) -> tuple[Real, Real]:
        """
        How much less (M, K, 3, S) derivatives are, and how much larger their covariances
        (M, K, K, 2, S) over the variance of the noise.

        Of some `models` (M,), that make so much of the cells, `reach` (M, K, X, S).
        """
        less = np.einsum('mkxs,xmcs->mkcs', reach, self.error[:, models])
        half = np.einsum('mkxs,xymcs->mkycs', reach, self.gain[:, :, models])
        return less, np.einsum('mkycs,mjys->mkjcs', half, reach)


def lacks_of(modes: Modes, rows: Real, samples: Real, lacking: Lacking) -> Lacks:
    """What models lack of `samples` (n, 3, S), whose modes are `rows` (R, 3 S)."""
    cells, weight = lacking
    number, bodies = cells.shape
    models = len(modes.freedom)
    rows = rows.reshape(-1, 1, 3, bodies)
    vectors = modes.vectors[:-1, cells]  # (R, X, S)
    left = np.empty((models, number, number, bodies))
    off = np.empty((models, number, 3, bodies))
    # Of rest, and then of all, unless modes are as many as samples.
    whole = np.eye(number)[..., None], np.moveaxis(samples[cells, :, np.arange(bodies)], 1, 2)
    for k, end in ((0, models), (1, -1)):
        parts = _terms(vectors[k : k + 1], rows[k : k + 1])
        whole = whole[0] - parts[0][0], whole[1] - parts[1][0]
        left[:end], off[:end] = whole
    for begin, end, some, share, lost in modes.parts:
        parts = _terms(vectors[begin:end], rows[begin:end])
        for target, part, other in zip((left, off), parts, whole, strict=True):
            part = part.reshape(len(share), share.shape[2], -1)
            own = lost @ part if modes.exact else other.reshape(-1) - share @ part
            target[some] = own.reshape(-1, *other.shape)
    # (X, X, M, S) of what is off at the cells, in a window where all are as good.
    left, off = left.transpose(1, 2, 0, 3), np.moveaxis(off, 1, 0)
    weight = weight[:, None]
    system = left[:, :, :, None] * (1 - weight)[:, None]
    system[np.arange(number), np.arange(number)] += weight
    log = _invert(system)
    gain = system * (1 - weight)
    error = np.einsum('xymcs,ymcs->xmcs', gain[:, :, :, _SIGNAL], off)
    return Lacks(np.einsum('xmcs,xmcs->mcs', off, error), log / 2, gain, error)


def _terms(vectors: Real, rows: Real) -> tuple[Real, Real]:
    """What modes (R, ...) have of the products of cells (R, X, X, S), and at each (R, X, 3, S)."""
    return vectors[:, :, None] * vectors[:, None], vectors[:, :, None] * rows


def _invert(system: Real) -> Real:
    """Invert positive definite matrices (X, X, ...) in place; logarithms of their determinants."""
    log = np.zeros(system.shape[2:])
    for k in range(len(system)):
        pivot = system[k, k].copy()
        log += np.log(pivot)
        system[k, k] = 1.0
        system[k] /= pivot
        for i in range(len(system)):
            if i != k:
                factor = system[i, k].copy()
                system[i, k] = 0.0
                system[i] -= factor * system[k]
    return log
