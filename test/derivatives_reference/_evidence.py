"""
What the compiled kernel does of even samples, with numpy: to read, and to test the kernel by.

Derivatives of poses within a window are the mean over all models, by how probable each is.

What the models disagree about is part of the covariance. There each spectrum counts as much as the
others: how the harmonics of a motion fall below its noise is what the samples cannot tell.
"""

from typing import NamedTuple

import numpy as np

from derivatives_reference._models import Modes, Stencils
from kinpole_ros.planar._plane import Complex, Real

# The noise as it was measured counts for so many samples.
KNOWN = 300.0
# Models with less weight in covariances, or less probable than this do not count.
_LEAST, _LEAST_PROBABLE = 1e-5, 1e-8
# Models with so much less evidence than others do not count.
_FAR = 80.0
# Of angle and position: how many components, and which of both each component is of.
_COMPONENTS = np.array((1, 2))
_SIGNAL = [0, 1, 1]


class Found(NamedTuple):
    """
    Of S bodies: derivatives `mean` (K, 3, S) of angle and both coordinates.

    `covariance` (K, K, 2, S) is that of the angle and of one coordinate, `freedom` (2, S) how many
    parameters their motions have, and `evidence` (2, S) that of all models. `hub` (S,) is where the
    point is whose position it is, at an angle of 0.
    """

    mean: Real
    covariance: Real
    freedom: Real
    evidence: Real
    hub: Complex


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


class Evidence(NamedTuple):
    """
    Modes (R, 3 S) of S bodies, and what M models say of them.

    `variance` (M, 2, S) is that of the noise, of angle and position, and `evidence` (M, 2, S) the
    logarithm of a model's probability, up to a constant.
    """

    modes: Real
    variance: Real
    evidence: Real
    lacks: Lacks | None


def evidence_of(
    modes: Modes,
    samples: Real,
    seen: Real | float,
    lacking: Lacking | None = None,
    known: float = KNOWN,
) -> Evidence:
    """
    How probable models are by the samples, as for `derive`.

    The noise as it was measured counts for so many samples as are `known`.
    """
    count, _, bodies = samples.shape
    half = (count + 1) // 2
    flat = samples.reshape(count, -1)
    first, last = flat[:half], flat[: -half - 1 : -1]
    pairs = np.empty((len(modes.even), 2, 3 * bodies))
    pairs[:, 0] = modes.even @ (first + last)
    pairs[:, 1] = modes.odd @ (first - last)
    rows = pairs.reshape(-1, 3 * bodies)
    squares = rows * rows
    rest = np.empty((len(modes.freedom), 3 * bodies))
    total = np.einsum('nr,nr->r', flat, flat) - squares[0]
    rest[-1] = total
    total = total - squares[1]
    for begin, end, models, share, lost in modes.parts:
        own = squares[begin:end].reshape(len(share), -1, 3 * bodies)
        left = lost @ own if modes.exact else total - share @ own
        rest[models] = left.reshape(-1, 3 * bodies)
    rest = rest.reshape(-1, 3, bodies)
    chances: Real = modes.chances
    lacks = None
    if lacking is not None:
        lacks = lacks_of(modes, rows, samples, lacking)
        rest -= lacks.less
        chances = chances - lacks.log * _COMPONENTS[:, None]
    rest = np.maximum(rest, 0.0, out=rest)
    rest[:, 1] += rest[:, 2]
    number = known + seen * _COMPONENTS[:, None]
    variance = (rest[:, :2] + known) / number
    evidence = chances - (number / 2) * np.log(variance)
    return Evidence(rows, variance, evidence, lacks)


def derive(
    modes: Modes,
    stencils: Stencils,
    samples: Real,
    seen: Real | float,
    lacking: Lacking | None = None,
) -> Found:
    """
    Differentiate `samples` (n, 3, S) of angle and coordinates, in deviations of their noise.

    So many of them are `seen` (2, S), some cells are `lacking`. Angle and position have
    models of their own; a position's two coordinates have one model. Time is in samples.
    """
    rows, variance, evidence, lacks = evidence_of(modes, samples, seen, lacking)
    orders, bodies = len(stencils.modes), samples.shape[2]
    best = evidence.max(axis=0)
    likely, weights = weights_of(evidence.reshape(1, len(evidence), -1), np.zeros(1), modes.kinds)
    likely, weights = likely[0], weights[0]
    noisy = weights * variance.reshape(len(variance), -1)
    # How much of each mode is motion in the mean, and how well that is known. That it is a low
    # polynomial, or rests, is known no better than that it is a process which looks like that.
    spread = noisy.copy()
    spread[modes.simple] = 0.0
    np.add.at(spread, modes.slowest, noisy[modes.simple, None] / modes.slowest.shape[1])
    mixed = mixture(modes, np.concatenate((likely, spread), axis=1))
    known = mixed[:, : 2 * bodies].reshape(-1, 2, bodies)[:, _SIGNAL]
    result = stencils.modes @ (rows.reshape(known.shape) * known).reshape(rows.shape)
    covariance = stencils.products @ mixed[:, 2 * bodies :] + stencils.unseen @ spread
    covariance = covariance.reshape(orders, orders, 2, bodies)
    # What the models disagree about.
    counts = weights + likely
    counting, off = by_models(modes, counts, stencils.modes, rows)
    off = off.reshape(-1, orders, 3, bodies)
    result = result.reshape(orders, 3, bodies)
    if lacks is not None:
        assert lacking is not None
        vectors = modes.vectors[:-1, lacking.cells].reshape(len(rows), -1)
        _, reach = by_models(modes, counts, stencils.modes, vectors)
        less, more = lacks.correct(counting, reach.reshape(len(reach), orders, -1, bodies))
        off -= less
        result -= np.einsum(
            'mkcs,mcs->kcs', less, likely[counting].reshape(-1, 2, bodies)[:, _SIGNAL]
        )
        covariance += np.einsum('mkjcs,mcs->kjcs', more, noisy[counting].reshape(-1, 2, bodies))
    off -= result
    off = np.ascontiguousarray(off.transpose(3, 2, 1, 0))  # (S, 3, K, M)
    by = weights[counting].reshape(-1, 2, bodies).transpose(2, 1, 0)[:, _SIGNAL, None]
    between = ((off * by) @ off.swapaxes(-1, -2)).transpose(2, 3, 1, 0)
    covariance[:, :, 0] += between[:, :, 0]
    covariance[:, :, 1] += (between[:, :, 1] + between[:, :, 2]) / 2
    freedom = (modes.freedom @ likely).reshape(2, bodies)
    all_ = best - np.log(likely.max(axis=0)).reshape(2, bodies)
    return Found(result, covariance, freedom, all_, np.zeros(bodies, complex))


def move(
    modes: Modes,
    slopes: Real,
    given: Real,
    samples: Real,
    off: Real,
    seen: Real,
    lacking: Lacking | None,
    known: float,
) -> Real:
    """
    The `given` samples (n, 3, S) moved from where they are `off` (n, S) their places.

    Along what is found from the `samples`, moved before, by the `slopes` of the modes; the noise as
    measured counts for so many samples as are `known`.
    """
    bodies = off.shape[1]
    found = evidence_of(modes, samples, seen, lacking, known)
    likely = probabilities(modes, found)
    share = mixture(modes, likely).reshape(-1, 2, bodies)[:, _SIGNAL]
    some = share.any(axis=(1, 2)).nonzero()[0]
    motion = found.modes.reshape(-1, 3, bodies)[some] * share[some]
    moved = given.copy()
    power = np.ones(off.shape)
    for order, slope in enumerate(slopes[:, some], 1):
        power = power * off / order
        moved -= power[:, None] * np.tensordot(slope, motion, ((0,), (0,)))
    if lacking is not None and found.lacks is not None:
        # What is missing is where the others have it.
        by = likely.reshape(-1, 2, bodies)[:, _SIGNAL]
        wrong = np.einsum('xmcs,mcs->xsc', found.lacks.error, by)
        where = lacking.cells, slice(None), np.arange(bodies)
        missing = (lacking.weight <= 0).all(axis=1)[..., None]
        moved[where] = np.where(missing, samples[where] - wrong, moved[where])
    return moved


def probabilities(modes: Modes, found: Evidence) -> Real:
    """How probable (M, 2 S) models are."""
    evidence = found.evidence.reshape(1, len(found.evidence), -1)
    return np.asarray(weights_of(evidence, np.zeros(1), modes.kinds)[0][0])


def mixture(modes: Modes, weights: Real) -> Real:
    """How much of modes is motion by models with `weights` (M, C): (R, C)."""
    mixed = np.zeros((2 * len(modes.even), weights.shape[1]))
    mixed[0], mixed[1] = weights.sum(axis=0), weights[:-1].sum(axis=0)
    for begin, end, models, share, _ in modes.parts:
        own = weights[models].reshape(*share.shape[:2], -1)
        np.matmul(share.swapaxes(1, 2), own, out=mixed[begin:end].reshape(*share.shape[::2], -1))
    return mixed


def by_models(modes: Modes, weights: Real, stencils: Real, rows: Real) -> tuple[np.ndarray, Real]:
    """
    What models make (M, K, C) of modes that are `rows` (R, C), by their `stencils` (K, R).

    Of models that count in any of the `weights` (M, ...), by their numbers.
    """
    counts = weights.any(axis=1)
    line = stencils[:, 0, None] * rows[0] + stencils[:, 1, None] * rows[1]
    numbers, found = [], []
    for begin, end, models, share, _ in modes.parts:
        processes, amplitudes, width = share.shape
        some = counts[models].reshape(processes, amplitudes).any(axis=1).nonzero()[0]
        if not len(some):
            continue
        own = rows[begin:end].reshape(processes, width, 1, -1)[some]
        by = stencils[:, begin:end].T.reshape(processes, width, -1, 1)[some]
        terms = (by * own).reshape(len(some), width, -1)
        found.append((share[some] @ terms).reshape(-1, *line.shape) + line)
        numbers.append((models.start + some[:, None] * amplitudes + np.arange(amplitudes)).ravel())
    numbers.append(np.array([len(weights) - 1]))
    found.append((stencils[:, 0, None] * rows[0])[None])
    return np.concatenate(numbers), np.concatenate(found)


def weights_of(evidence: Real, prior: Real, kinds: Real) -> tuple[Real, Real]:
    """
    Probabilities (N, M, S) of models of the `evidence` (N, M, S), and their weights in covariances.

    With N sets of steps, the logarithms of whose `prior` (N,) are part of the evidence.
    """
    best = evidence.max(axis=(0, 1))
    likely = np.exp(evidence - best)
    likely[evidence < best - _FAR] = 0.0
    # For covariances evidence counts to the power of 1/2: the likeliest model is not the only one.
    # So does half of the prior of steps.
    up = evidence - prior[:, None, None] / 2
    weights = np.exp((up - up.max(axis=(0, 1))) / 2)
    # Of each spectrum beside the line and rest, unless it is out of the question.
    total = np.einsum('km,nms->ks', kinds, weights)
    inverse = np.divide(1.0, total, out=np.zeros_like(total), where=total > 1e-300)
    weights *= kinds.T @ inverse
    weights /= weights.sum(axis=(0, 1))
    weights[weights < _LEAST] = 0.0
    likely[likely < _LEAST_PROBABLE] = 0.0
    return likely / likely.sum(axis=(0, 1)), weights


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
