"""
Windows in which derivatives step, as an impact or a drive makes them.

An event is a few columns: the step, what it is if its place is somewhat earlier or later, and a
step of the next derivative. With these all models are a regression more; those with events and
those without are averaged by their evidence. Models are matrices of all samples here, and signals
come one by one.
"""

from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np

from derivatives_reference._evidence import KNOWN, Found, derive, weights_of
from derivatives_reference._models import FLAT, _layout, modes_of, stencils_of
from derivatives_reference._samples import Window, seen_of
from kinpole_ros.planar._plane import Real

# Steps of the motion itself, of its first and of its second derivative are looked for.
_ORDERS = (0, 1, 2)
# Events that are looked for in a window, one after the other.
_MOST_EVENTS = 2
# Flat priors of a parameter by which the likeliest model has less evidence than a line, or more.
_WORTH = 1
# How probable an event is, and the logarithm of the part of all sizes that is as large.
_PRIOR, _SIZE_COST = 0.05, 2.4
# Evidence that a candidate gains, by which it is at most behind another, and that it is worth.
_GAIN, _BEHIND, _PROGRESS = 12.0, 4.0, 1.0
# Samples on either side of an event.
_EDGE = 3
# Standard deviation of the place of an event, samples, at least and at most.
_PLACE = 0.5, 3.0
# Steps are screened with the likeliest of the slowest processes of each spectrum, too.
_SLOWEST = 2
# By how many samples events of an order may be seen late, at least: an acceleration may set in
# gradually, and is taken for a step then.
_LEAST_OFF = {0: 0.0, 1: 1.0, 2: 3.0}
_LEFT_OF_STEP = 1e-6
_ROUNDING = 1e-9


class _Bank(NamedTuple):
    """
    M models of a window of n samples as matrices: `left` (M, n, n) is what they leave of samples,
    `stencil` (M, K, n) how samples make derivatives, and `spread` (M, K, K) their covariance.
    """

    left: Real
    stencil: Real
    spread: Real


class _Event(NamedTuple):
    """
    The derivative of an order steps `since` (samples) before the instant; `off` (2,) is the
    deviation of that and `size` (2,) its size, by angle and position.
    """

    order: int
    since: float
    off: Real
    size: Real


class _Set(NamedTuple):
    """
    Steps by their `columns` (C, n), `here` (C, K), what they are at the instant, and the `roots`
    (2, C) of the variances of their sizes. `prior` is the logarithm of that of all `events`. By
    models: `evidence` (M, 2), `variance` (M, 2) of the noise, and of both components,
    `gain` (M, C, C) and `size` (M, C, c), what is found of sizes, and their covariance.
    """

    columns: Real
    here: Real
    roots: Real
    prior: float
    events: tuple[_Event, ...]
    evidence: Real
    variance: Real
    gain: tuple[Real, Real]
    size: tuple[Real, Real]


def derive_even(window: Window, samples: Real, weights: Real | None) -> Found:
    """
    The derivatives of `samples` (n, 3, S), with all events there may be in the window.

    With `weights` (n, 2, S) of angle and position unless they are all 1.
    """
    modes, stencils = modes_of(*window.models), stencils_of(*window)
    seen, lacking = seen_of(weights, samples)
    whole = derive(modes, stencils, np.ascontiguousarray(samples), seen, lacking)
    if window.exact:
        return whole
    some = (whole.evidence < -_WORTH * FLAT * np.array((1, 2))[:, None]).any(axis=0).nonzero()[0]
    for k in some:
        weight = np.ones((window.size, 2)) if weights is None else weights[..., k]
        found = _derive_signal(window, samples[..., k], weight)
        for all_, part in zip(whole, found, strict=True):
            all_[..., k] = part
    return whole


@lru_cache(maxsize=16)
def _bank_of(window: Window) -> _Bank:
    modes, stencils = modes_of(*window.models), stencils_of(*window)
    orders = len(stencils.modes)
    rows = np.pad(stencils.modes, ((0, 0), (0, 1)))
    left, stencil, spread = [], [], []
    for place, share in zip(modes.place, modes.share, strict=True):
        vectors, own = modes.vectors[place], rows[:, place] * share
        left.append(np.eye(window.size) - (vectors.T * share) @ vectors)
        stencil.append(own @ vectors)
        spread.append(own @ rows[:, place].T)
    all_ = np.array(spread) + stencils.unseen.T.reshape(-1, orders, orders)
    all_[modes.simple] = all_[modes.slowest].mean(axis=1)
    return _Bank(np.array(left), np.array(stencil), all_)


def _step(window: Window, order: int, place: float) -> Real:
    """What a step adds to the samples (n,), each the mean of a block."""
    offsets = (np.arange(window.block) - (window.block - 1) / 2) / window.block
    since = np.arange(window.size)[:, None] + offsets - place
    return np.asarray((_power(since, order)).mean(axis=1))


def _power(since: Real, order: int) -> Real:
    return np.where(since > 0, np.maximum(since, 0) ** order / factorial(max(order, 0)), 0.0)


def _derive_signal(window: Window, samples: Real, weight: Real) -> Found:
    """The derivatives of one signal, `samples` (n, 3), as of `derive_even` but without the S."""
    modes, bank = modes_of(*window.models), _bank_of(window)
    seen = weight.sum(axis=0)
    cells = np.flatnonzero((weight < 1).any(axis=1))
    none = np.zeros((len(cells), window.orders))
    empty = _evaluate(
        window, samples, seen, weight[cells].T, np.eye(window.size)[cells], none,
        np.sqrt(1 - weight[cells].T), 0.0, (), len(cells),
    )  # fmt: skip
    sets = _sets(window, samples, seen, weight[cells].T, empty)
    mean, freedom = np.zeros((window.orders, 3)), np.zeros(2)
    covariance = np.zeros((window.orders, window.orders, 2))
    for c in range(2):
        own = samples[:, [0]] if c == 0 else samples[:, 1:]
        likely, weights = weights_of(
            np.array([one.evidence[:, c, None] for one in sets]),
            np.array([one.prior for one in sets]),
            modes.kinds,
        )
        derived = []
        for one, by in zip(sets, weights[..., 0], strict=True):
            reach = one.here.T - bank.stencil @ one.columns.T  # (M, K, C)
            derived.append(bank.stencil @ own + reach @ one.size[c])
            noisy = by * one.variance[:, c]
            covariance[:, :, c] += np.tensordot(noisy, bank.spread, 1)
            covariance[:, :, c] += np.einsum(
                'm,mkc,mcd,mjd->kj', noisy, reach, one.gain[c], reach, optimize=True
            )
        all_ = np.array(derived)  # (N, M, K, c)
        mean[:, [0] if c == 0 else [1, 2]] = total = np.einsum('nm,nmkc->kc', likely[..., 0], all_)
        off = all_ - total
        covariance[:, :, c] += np.einsum('nm,nmkc,nmjc->kj', weights[..., 0], off, off) / (c + 1)
        for one, by in zip(sets, weights[..., 0], strict=True):
            covariance[:, :, c] += by.sum() * _of_places(one, c, window.orders)
        events = np.array([len(one.events) for one in sets])
        freedom[c] = np.sum(likely[..., 0] * (modes.freedom + events[:, None]))
    return Found(mean, covariance, freedom, np.zeros(2))


def _evaluate(
    window: Window,
    samples: Real,
    seen: Real,
    lacking: Real,
    columns: Real,
    here: Real,
    roots: Real,
    prior: float,
    events: tuple[_Event, ...],
    cells: int,
) -> _Set:
    """What models say of a window with such columns, the first of which are cells that lack."""
    modes, bank = modes_of(*window.models), _bank_of(window)
    left = bank.left @ columns.T  # (M, n, C)
    between = columns @ left
    found = []
    for c in range(2):
        own = samples[:, [0]] if c == 0 else samples[:, 1:]
        square = (own * (bank.left @ own)).sum(axis=(1, 2))
        root = roots[c]
        system = between * root * root[:, None]
        system[:, np.arange(len(root)), np.arange(len(root))] += np.concatenate(
            (lacking[c], np.ones(len(root) - cells))
        )
        inverse = np.linalg.inv(system) * root * root[:, None]
        along = left.swapaxes(1, 2) @ own
        size = inverse @ along
        square = np.maximum(square - np.einsum('mcj,mcj->m', along, size), 0.0)
        number = KNOWN + seen[c] * (c + 1)
        variance = (square + KNOWN) / number
        log = np.linalg.slogdet(system)[1] / 2
        evidence = modes.chances[:, c, 0] - number / 2 * np.log(variance) - (c + 1) * log + prior
        if events:
            evidence[modes.kinds[-1] > 0] = -np.inf
        found.append((evidence, variance, inverse, size))
    evidence, variance, gain, size = zip(*found, strict=True)
    return _Set(
        columns, here, roots, prior, events, np.stack(evidence, 1), np.stack(variance, 1),
        (gain[0], gain[1]), (size[0], size[1]),
    )  # fmt: skip


def _of_places(one: _Set, c: int, orders: int) -> Real:
    """What may be if events near the instant are on its other side, (K, K)."""
    found = np.zeros((orders, orders))
    for event in one.events:
        if abs(event.since) < event.off[c]:
            here, *sides = (
                event.size[c] * _derivatives(event.order, event.since + off, orders)
                for off in (0.0, event.off[c], -event.off[c])
            )
            found += sum(np.outer(side - here, side - here) for side in sides) / 2
    return found


def _derivatives(order: int, since: float, orders: int) -> Real:
    """Derivatives (K,) of a step so many samples after it."""
    each = [_power(np.float64(since), order - k) if order >= k else 0.0 for k in range(orders)]
    return np.array(each, float)


def _sets(window: Window, samples: Real, seen: Real, lacking: Real, empty: _Set) -> list[_Set]:
    """All sets of steps that count: the empty one, and those that explain samples better."""
    modes = modes_of(*window.models)
    smooth = modes.kinds[-1] == 0
    sets, base, best = [empty], empty, empty.evidence[smooth].max(axis=0)
    for event in range(_MOST_EVENTS):
        found: dict[int, tuple[float, float, int, list[Real]]] = {}
        for allowed in (smooth,) if event else (smooth, _slow(window)):
            evidence = np.where(allowed[:, None], base.evidence, -np.inf)
            models = evidence.argmax(axis=0)
            value = evidence.max(axis=0).sum()
            screens = [_screen(window, base, lacking, c, models[c]) for c in range(2)]
            for order, (gain, at) in _candidates(window, samples, seen, screens, models).items():
                if order not in found or value + gain > found[order][0]:
                    found[order] = value + gain, gain, at, screens
        top = max(value for value, *_ in found.values())
        progress, following = _PROGRESS, None
        for order, (value, gain, at, screens) in found.items():
            if gain < _GAIN or value < top - _BEHIND:
                continue
            sets.append(_extended(window, samples, seen, lacking, base, order, at, screens))
            more = np.maximum(sets[-1].evidence.max(axis=0) - best, 0.0).sum()
            if more >= progress:
                progress, following = more, sets[-1]
        if following is None:
            break
        base, best = following, np.maximum(best, following.evidence.max(axis=0))
    return sets


def _slow(window: Window) -> np.ndarray:
    """Which models (M,) are of the slowest processes of the smooth spectra."""
    modes = modes_of(*window.models)
    layout = _layout(window.size, window.block, window.exact)
    processes = [member.process for _, members in layout for member in members]
    longest = [
        sum(other.spectrum == one.spectrum and other.length > one.length for other in processes)
        < _SLOWEST
        and 0 <= one.spectrum < len(modes.kinds) - 1
        for one in processes
    ]
    amplitudes = (len(modes.freedom) - 1) // len(processes)
    return np.append(np.repeat(longest, amplitudes), False)


def _screen(window: Window, base: _Set, lacking: Real, c: int, model: int) -> Real:
    """What a model with the columns of a set leaves of samples, (n, n)."""
    cells = lacking.shape[1]
    weight = np.concatenate((lacking[c], np.ones(len(base.columns) - cells)))
    left = _bank_of(window).left[model]
    for column, root, own in zip(base.columns, base.roots[c], weight, strict=True):
        left = _removed(left, column, root, own)
    return left


def _removed(left: Real, column: Real, root: float, weight: float) -> Real:
    """What is left with another column."""
    own = left @ column
    return np.asarray(left - root**2 / (weight + root**2 * (column @ own)) * np.outer(own, own))


def _candidates(
    window: Window, samples: Real, seen: Real, screens: list[Real], models: Real
) -> dict[int, tuple[float, int]]:
    """By order, how much evidence the best step gains, and before which sample it is."""
    found = {}
    for order in _ORDERS:
        steps = _steps(window.size, order)
        rank, gain = np.zeros(window.size), np.zeros(window.size)
        for c in range(2):
            own = samples[:, [0]] if c == 0 else samples[:, 1:]
            squares = max(float((own * (screens[c] @ own)).sum()), 0.0) + KNOWN
            number = KNOWN + seen[c] * (c + 1)
            whole = ((steps @ _bank_of(window).left[models[c]]) * steps).sum(axis=1)
            whole[whole < _ROUNDING * (steps**2).sum(axis=1)] = np.inf
            if models[c] == len(_bank_of(window).left) - 1:
                whole[:] = np.inf
            left = ((steps @ screens[c]) * steps).sum(axis=1)
            left = np.where(left > _LEFT_OF_STEP * whole, left, np.inf)
            square = ((steps @ screens[c] @ own) ** 2).sum(axis=1) / left / (c + 1)
            explained = (c + 1) * square**2 / (1 + square)
            part = np.minimum(explained / squares, 1.0)
            rank += number * part * (6 - part) / (6 - 4 * part)
            after = np.maximum(squares - explained, KNOWN)
            gain += np.maximum(
                number / 2 * np.log(squares / after) - (c + 1) / 2 * np.log1p(square), 0.0
            )
        at = _EDGE + int(rank[_EDGE : window.size - _EDGE + 1].argmax())
        found[order] = float(gain[at]), at
    return found


@lru_cache(maxsize=16)
def _steps(count: int, order: int) -> Real:
    """Steps (n, n) half a sample before each sample."""
    return np.asarray(_power(np.arange(count) - np.arange(count)[:, None] + 0.5, order))


def _extended(
    window: Window,
    samples: Real,
    seen: Real,
    lacking: Real,
    base: _Set,
    order: int,
    at: int,
    screens: list[Real],
) -> _Set:
    """The set with another event before the sample `at`, with sizes as the models estimate."""
    place = at - 0.5
    orders = [order, *range(order - 1, -1, -1), order + 1]
    columns = [_step(window, each, place) for each in orders]
    instant = window.at + (window.size - 1) / 2 - place
    here = np.array([_derivatives(each, instant, window.orders) for each in orders])
    roots = np.zeros((2, len(orders)))
    late = np.zeros(2)
    for c, left in enumerate(screens):
        own = samples[:, [0]] if c == 0 else samples[:, 1:]
        off = _PLACE[0]
        for k, (each, column) in enumerate(zip(orders, columns, strict=True)):
            some = column @ left @ column
            if each >= order and some > 0:
                along = np.sqrt(((column @ left @ own) ** 2).sum() / (c + 1))
                roots[c, k] = along / some
            elif each == order - 1:
                known = roots[c, 0] * np.sqrt((c + 1) * max(some, 0.0))
                off = min(max(1 / known, _PLACE[0]), _PLACE[1]) if known > 0 else _PLACE[0]
                roots[c, k] = roots[c, 0] * off
                late[c] = (
                    _PLACE[1] if known == 0 else min(max(1 / known, _LEAST_OFF[order]), _PLACE[1])
                )
            elif each == order - 2:
                roots[c, k] = roots[c, 0] * off**2 / 2
            left = _removed(left, column, roots[c, k], 1.0)
    prior = base.prior + np.log(_PRIOR / (1 - _PRIOR) / (len(_ORDERS) * window.size)) - _SIZE_COST
    return _evaluate(
        window, samples, seen, lacking, np.concatenate((base.columns, columns)),
        np.concatenate((base.here, here)), np.concatenate((base.roots, roots), axis=1), prior,
        (*base.events, _Event(order, instant, late, roots[:, 0])), lacking.shape[1],
    )  # fmt: skip
