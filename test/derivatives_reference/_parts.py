"""
Windows in two parts: a motion that stops, sets in, or is another one all at once.

The older part of a window may be of another motion than the newer. How probable that is follows
from how probable either is by itself, with a mean and a slope of its own; derivatives are then
those of the part that the instant is in.
"""

import numpy as np

from derivatives_reference._evidence import KNOWN, Found, derive
from derivatives_reference._models import FEWEST_SAMPLES, FLAT, modes_of, stencils_of
from derivatives_reference._samples import Window, seen_of, total
from kinpole_ros.planar._plane import Real

# How much of a window is the newer part, if there are two; and how probable that is.
_NEWER = (0.3, 0.46, 0.7)
_PRIOR = 0.5
# Evidence that another part costs, flat priors of a parameter.
_WORTH = 4
# A part needs so many samples that are seen.
_FEWEST = FEWEST_SAMPLES + 1
_COMPONENTS = np.array((1, 2))[:, None]
_SIGNAL = [0, 1, 1]


def derive_parts(window: Window, samples: Real, weights: Real | None) -> Found:
    """
    The derivatives of `samples` (n, 3, S), in one window or in two parts of it.

    With `weights` (n, 2, S) of angle and position unless they are all 1.
    """
    whole, seen = _derive(window, samples, weights)
    if window.exact or not window.parts:
        return whole
    # Another line, and two motions for one, have to be worth it: a window with more evidence than
    # that needs no parts.
    some = (whole.evidence < -_WORTH * FLAT * _COMPONENTS).any(axis=0).nonzero()[0]
    if not len(some):
        return whole
    found = [Found(*(part[..., some] for part in whole))]
    chances = [_chance(found[0], seen[:, some])]
    samples = samples[..., some]
    weights = None if weights is None else weights[..., some]
    for newer in _NEWER:
        cut = window.size - round(newer * window.size)
        if min(cut, window.size - cut) < _FEWEST:
            continue
        split = _derive_split(window, cut, samples, weights)
        if split is not None:
            found.append(split[0])
            chances.append(split[1] + np.log(_PRIOR / (1 - _PRIOR) / len(_NEWER)))
    return _put(whole, some, _mean(found, np.array(chances)))


def _derive_split(
    window: Window, cut: int, samples: Real, weights: Real | None
) -> tuple[Found, Real] | None:
    """
    The derivatives if another motion begins at the sample `cut`, and the chance (2, S) of that.

    The chance is a logarithm, -inf for a signal of which a part has too few samples; None if all
    signals are such.
    """
    signals = samples.shape[2]
    parts = slice(cut), slice(cut, None)
    possible = np.ones(signals, bool)
    if weights is not None:
        for part in parts:
            possible &= (total(weights[part]) >= _FEWEST).all(axis=0)
    some = possible.nonzero()[0]
    if not len(some):
        return None
    later = window.at + (window.size - 1) / 2 >= cut - 0.5
    halves = [
        _derive(
            window.part(part, window.orders if (part is parts[1]) == later else 1),
            samples[part][..., some],
            None if weights is None else weights[part][..., some],
        )
        for part in parts
    ]
    chance = np.full((2, signals), -np.inf)
    chance[:, some] = _chance(*halves[0]) + _chance(*halves[1])
    found = Found(*(np.zeros((*part.shape[:-1], signals)) for part in halves[later][0]))
    return _put(found, some, halves[later][0]), chance


def _derive(window: Window, samples: Real, weights: Real | None) -> tuple[Found, Real]:
    """Derivatives, and how many samples (2, S) of angle and position they are of."""
    modes, stencils = modes_of(*window.models), stencils_of(*window[:-1])
    seen, lacking = seen_of(weights, samples)
    return derive(modes, stencils, np.ascontiguousarray(samples), seen, lacking), seen


def _chance(found: Found, seen: Real) -> Real:
    """The logarithm (2, S) of how probable so many samples are by all models."""
    # The evidence is relative to a line with a flat prior, and to so many samples.
    chance = found.evidence - 2 * FLAT * _COMPONENTS
    return np.asarray(chance - np.log(KNOWN + seen * _COMPONENTS) / 2 + np.log(KNOWN) / 2)


def _mean(found: list[Found], chances: Real) -> Found:
    """The mean of what was found in parts, F of them, by their `chances` (F, 2, S)."""
    share = np.exp(chances - chances.max(axis=0))
    share /= total(share)
    mean = total(np.stack([by[_SIGNAL] * one.mean for by, one in zip(share, found, strict=True)]))
    covariance, freedom = np.zeros(found[0].covariance.shape), np.zeros(found[0].freedom.shape)
    for by, one in zip(share, found, strict=True):
        off = one.mean - mean
        between = off[:, None] * off
        between = np.stack((between[:, :, 0], (between[:, :, 1] + between[:, :, 2]) / 2), axis=2)
        covariance += by * (one.covariance + between)
        freedom += by * one.freedom
    return Found(mean, covariance, freedom, found[0].evidence)


def _put(whole: Found, some: np.ndarray, found: Found) -> Found:
    """The `whole` with what was `found` of some of its signals."""
    for all_, part in zip(whole, found, strict=True):
        all_[..., some] = part
    return whole
