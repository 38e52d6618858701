"""
Windows in which derivatives step, as an impact or a drive makes them.

An event is a few columns: the step, what it is if its place is somewhat earlier or later, and a
step of the next derivative, up to that of acceleration. With these all models are a regression
more; those with events and those without are averaged by their evidence. Models are matrices of
all samples here, and signals come one by one.
"""

from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np

from derivatives_reference._evidence import KNOWN, Found, derive, weights_of
from derivatives_reference._hub import find_hub, turning_of
from derivatives_reference._models import _layout, modes_of, stencils_of
from derivatives_reference._samples import Window, seen_of
from derivatives_reference._segments import EVENT_COST, PLACE_POWER, add_segments
from kinpole_ros.planar._plane import Real

# Steps of the motion itself, of its first and of its second derivative are looked for.
_ORDERS = (0, 1, 2)
# Evidence of a signal below the negative of which a window without such a candidate is divided.
_DIVIDE_BELOW = 48.0
# Evidence after the loss of which shorter lengths of a spectrum are left out.
_DROP = 8.0
# Samples on either side of an event, and one more for each order.
_EDGE = 3
# Standard deviation of the place of an event, samples.
_PLACE = 0.5
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


class _Set(NamedTuple):
    """
    Steps by their `columns` (C, n), `here` (C, K), what they are at the instant, and the `roots`
    (2, C) of the variances of their sizes. `prior` is the logarithm of that of all `events`, and
    `spread` (2, K, K) the covariance that is due to their places. By models: `evidence` (M, 2),
    `variance` (M, 2) of the noise, and of both components, `gain` (M, C, C) and `size` (M, C, c),
    what is found of sizes, and their covariance.
    """

    columns: Real
    here: Real
    roots: Real
    prior: float
    events: int
    spread: Real
    evidence: Real
    variance: Real
    gain: tuple[Real, Real]
    size: tuple[Real, Real]


class _Screen(NamedTuple):
    """What `model` with the columns of a set leaves of samples (n, n), and its `stencil` (K, n)."""

    model: int
    left: Real
    stencil: Real


class _Candidate(NamedTuple):
    """An event before the sample `at`, what one gains at all places (n,), and there."""

    gain: float
    at: int
    gains: Real
    screens: list[_Screen]


def derive_even(window: Window, samples: Real, weights: Real | None, radians: Real) -> Found:
    """
    The derivatives of `samples` (n, 3, S), with all events there may be in the window.

    With `weights` (n, 2, S) of angle and position unless they are all 1. Angles are in units of
    `radians` (S,).
    """
    modes, stencils = modes_of(*window.models), stencils_of(*window)
    seen, lacking = seen_of(weights, samples)
    whole = derive(modes, stencils, np.ascontiguousarray(samples), seen, lacking)
    if window.exact:
        return whole
    for k in range(samples.shape[2]):
        weight = np.ones((window.size, 2)) if weights is None else weights[..., k]
        found = _derive_signal(window, samples[..., k], weight)
        for all_, part in zip(whole, found, strict=True):
            all_[..., k] = part
        own = None if weights is None else weights[..., [k]]
        _take_hub(
            window, samples[..., [k]], own, radians[k], Found(*(one[..., k] for one in whole))
        )
    return whole


def _take_hub(
    window: Window, samples: Real, weights: Real | None, radians: float, found: Found
) -> None:
    """Replace the position in what is `found` of `samples` (n, 3, 1) by that of a hub."""
    weight = np.ones((window.size, 2)) if weights is None else weights[..., 0]
    hub = find_hub(window, samples[..., 0], weight, radians, found.evidence[1])
    if hub is None:
        return
    moved = samples.copy()
    moved[:, 1:, 0] = hub.moved
    one = derive(modes_of(*window.models), stencils_of(*window), moved, *seen_of(weights, samples))
    found.mean[:, 1:] = one.mean[:, 1:, 0] * np.sqrt(hub.growth)
    off = turning_of(found.mean[:, 0], radians) - hub.path
    of_arm = np.outer(off, off.conj()).real / hub.turning
    found.covariance[..., 1] = hub.growth * (one.covariance[:, :, 1, 0] + of_arm)
    found.hub[...] = hub.arm


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
        np.sqrt(1 - weight[cells].T), 0.0, 0, np.zeros((2, window.orders, window.orders)),
        len(cells),
    )  # fmt: skip
    steps = _ranked(window, samples, seen, weight[cells].T, empty, empty.evidence.argmax(axis=0))
    sets, order = [empty], _best(steps)
    if steps[order].gain >= EVENT_COST:
        about = window, samples, seen, weight[cells].T
        sets.append(_extended(*about, empty, order, steps[order]))
    mean, freedom, evidence = np.zeros((window.orders, 3)), np.zeros(2), np.zeros(2)
    covariance = np.zeros((window.orders, window.orders, 2))
    for c in range(2):
        own = samples[:, [0]] if c == 0 else samples[:, 1:]
        likely, weights = weights_of(
            np.array([one.evidence[:, c, None] for one in sets]),
            np.array([one.prior for one in sets]),
            modes.kinds,
        )
        best = max(one.evidence[:, c].max() for one in sets)
        # The best has the probability of one over their sum.
        evidence[c] = best - np.log(likely.max())
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
            covariance[:, :, c] += by.sum() * one.spread[c]
        events = np.array([one.events for one in sets])
        freedom[c] = np.sum(likely[..., 0] * (modes.freedom + events[:, None]))
    found = Found(mean, covariance, freedom, evidence, np.zeros((), complex))
    if len(sets) > 1 or (empty.evidence.max(axis=0) < -_DIVIDE_BELOW * np.array((1, 2))).any():
        add_segments(window, samples, weight.min(axis=1), found)
    return found


def _evaluate(
    window: Window,
    samples: Real,
    seen: Real,
    lacking: Real,
    columns: Real,
    here: Real,
    roots: Real,
    prior: float,
    events: int,
    spread: Real,
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
        found.append((evidence, variance, inverse, size))
    evidence, variance, gain, size = zip(*found, strict=True)
    all_ = np.stack(evidence, 1)
    if events:
        all_[_left_out(window, all_)] = -np.inf
    return _Set(
        columns, here, roots, prior, events, spread, all_, np.stack(variance, 1),
        (gain[0], gain[1]), (size[0], size[1]),
    )  # fmt: skip


def _processes(window: Window) -> list[tuple[int, float, slice]]:
    """The spectrum and the length of processes, and their models."""
    layout = _layout(window.size, window.block, window.exact)
    processes = [member.process for _, members in layout for member in members]
    amplitudes = (len(modes_of(*window.models).freedom) - 1) // len(processes)
    return [
        (one.spectrum, one.length, slice(k * amplitudes, (k + 1) * amplitudes))
        for k, one in enumerate(processes)
    ]


def _left_out(window: Window, evidence: Real) -> np.ndarray:
    """Which models (M,) with steps are left out: lengths beyond much worse ones."""
    out = np.zeros(len(evidence), bool)
    processes = _processes(window)
    for spectrum in {one for one, _, _ in processes if one >= 0}:
        top, dropped = np.full(2, -np.inf), False
        for _, _, models in sorted(
            (one for one in processes if one[0] == spectrum), key=lambda one: -one[1]
        ):
            out[models] |= dropped
            most = evidence[models].max(axis=0)
            dropped |= bool((most < top - _DROP).all())
            top = np.maximum(top, most)
    return np.asarray(out)


def _derivatives(order: int, since: float, orders: int) -> Real:
    """Derivatives (K,) of a step so many samples after it."""
    each = [_power(np.float64(since), order - k) if order >= k else 0.0 for k in range(orders)]
    return np.array(each, float)


def _ranked(
    window: Window, samples: Real, seen: Real, lacking: Real, empty: _Set, models: Real
) -> dict[int, _Candidate]:
    """The best step of each order by these models (2,) of angle and position."""
    screens = [_screen(window, empty, lacking, c, models[c]) for c in range(2)]
    return _candidates(window, samples, seen, screens)


def _best(found: dict[int, _Candidate]) -> int:
    return max(found, key=lambda order: found[order].gain)


def _screen(window: Window, base: _Set, lacking: Real, c: int, model: int) -> _Screen:
    """What a model with the columns of a set leaves of samples, and how it makes derivatives."""
    cells = lacking.shape[1]
    weight = np.concatenate((lacking[c], np.ones(len(base.columns) - cells)))
    bank = _bank_of(window)
    left, stencil = bank.left[model], bank.stencil[model]
    for column, here, root, own in zip(base.columns, base.here, base.roots[c], weight, strict=True):
        removed = left @ column
        factor = root**2 / (own + root**2 * (column @ removed))
        stencil = stencil + np.outer(here - stencil @ column, factor * removed)
        left = left - factor * np.outer(removed, removed)
    return _Screen(model, left, stencil)


def _square(window: Window, order: int, screen: _Screen, own: Real) -> tuple[Real, Real]:
    """Of steps before each sample (n,): one over the variances of their sizes, and these (n, c)."""
    bank, steps = _bank_of(window), _steps(window.size, order)
    whole = ((steps @ bank.left[screen.model]) * steps).sum(axis=1)
    whole[whole < _ROUNDING * (steps**2).sum(axis=1)] = np.inf
    if screen.model == len(bank.left) - 1:
        whole[:] = np.inf
    left = ((steps @ screen.left) * steps).sum(axis=1)
    left = np.where(left > _LEFT_OF_STEP * whole, left, np.inf)
    return left, steps @ screen.left @ own / left[:, None]


def _candidates(
    window: Window, samples: Real, seen: Real, screens: list[_Screen]
) -> dict[int, _Candidate]:
    """The best step of each order."""
    found = {}
    for order in _ORDERS:
        gains = np.zeros(window.size)
        for c in range(2):
            own = samples[:, [0]] if c == 0 else samples[:, 1:]
            squares = max(float((own * (screens[c].left @ own)).sum()), 0.0) + KNOWN
            number = KNOWN + seen[c] * (c + 1)
            square, size = _square(window, order, screens[c], own)
            known = np.where(np.isinf(square), 0.0, square)
            gains += known * (size**2).sum(axis=1) * number / squares / 2
        edge = _EDGE + order
        if 2 * edge > window.size:
            continue
        at = edge + int(gains[edge : window.size - edge + 1].argmax())
        found[order] = _Candidate(float(gains[at]), at, gains, screens)
    return found


def _spread(window: Window, samples: Real, order: int, candidate: _Candidate) -> Real:
    """The covariance (2, K, K) of derivatives that is due to the place of an event."""
    spread = np.zeros((2, window.orders, window.orders))
    places = np.arange(_EDGE + order, window.size - _EDGE - order + 1)
    gains = candidate.gains[places]
    chance = np.exp(PLACE_POWER * (gains - gains.max()))
    since = window.at + (window.size - 1) / 2 - (places - 0.5)
    here = np.array([_derivatives(order, each, window.orders) for each in since])
    for c, screen in enumerate(candidate.screens):
        own = samples[:, [0]] if c == 0 else samples[:, 1:]
        _, size = _square(window, order, screen, own)
        change = here - _steps(window.size, order)[places] @ screen.stencil.T  # (P, K)
        off = size[places, :, None] * change[:, None]
        off -= off[gains.argmax()]
        spread[c] = np.einsum('p,pck,pcj->kj', chance / chance.sum(), off, off) / (c + 1)
    return spread


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
    candidate: _Candidate,
) -> _Set:
    """The set with another event, with sizes as the screens estimate them, of each alone."""
    place = candidate.at - 0.5
    orders = [order, *(each for each in (order - 1, order + 1) if each in _ORDERS)]
    columns = [_step(window, each, place) for each in orders]
    instant = window.at + (window.size - 1) / 2 - place
    here = np.array([_derivatives(each, instant, window.orders) for each in orders])
    roots = np.zeros((2, len(orders)))
    for c, screen in enumerate(candidate.screens):
        own = samples[:, [0]] if c == 0 else samples[:, 1:]
        for k, each in enumerate(orders):
            square, size = (one[candidate.at] for one in _square(window, each, screen, own))
            of_noise = 0.0 if np.isinf(square) else 1 / square
            roots[c, k] = np.sqrt(max((size**2).mean(), of_noise))
            if each < order:
                roots[c, k] = roots[c, 0] * _PLACE
    return _evaluate(
        window, samples, seen, lacking, np.concatenate((base.columns, columns)),
        np.concatenate((base.here, here)), np.concatenate((base.roots, roots), axis=1),
        base.prior - EVENT_COST,
        base.events + 1, base.spread + _spread(window, samples, order, candidate),
        lacking.shape[1],
    )  # fmt: skip
