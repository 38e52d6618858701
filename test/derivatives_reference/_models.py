"""The models of a window as numpy takes them: stacked by how many modes they have."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives import _models
from kinpole_ros.derivatives._models import (
    _SIMPLE_PRIOR,
    FEWEST_SAMPLES,
    Process,
    _Functions,
    _half_window,
    _line_derivatives,
    _waves,
)
from kinpole_ros.planar._plane import Real

__all__ = ['FEWEST_SAMPLES']

MOST_EXACT = 1e13
# Processes are stacked with those that have up to so many modes, windows.
_WIDTHS = (1.0, 0.5, 0.2)


class Part(NamedTuple):
    """
    P processes, each of which has as many of the rows `first` to `last` of all modes.

    `models` are their models, P A, by A amplitudes, `share` (P, A, m) is how much of a mode is
    motion, and `lost` (P, A, m) how much is not.
    """

    first: int
    last: int
    models: slice
    share: Real
    lost: Real


class Modes(NamedTuple):
    """
    Models of a window of n samples, as modes in R rows, even and odd about its middle in turn.

    `even` and `odd` (R / 2, (n + 1) // 2) make them of the sums and differences of samples that lie
    opposite to each other. The first two are mean and slope, the others lie in `parts`; a row of
    zeros is none. M models are the processes, each with its amplitudes, and then rest: `chances`
    (M, 2, 1) are the logarithm of a model's prior less half of that of its determinant, for one and
    for two components, `freedom` (M,) is how many parameters it has for the samples, and `kinds`
    (spectra, M) is 1 for those of a spectrum, and for low polynomials and rest.

    Model by model `place` (M, m) says which rows, of R and one more of zeros, it has, and `share`
    (M, m) how much of them is motion; `vectors` (R + 1, n) are the modes on all samples.

    `simple` (L,) are the models that are low polynomials and rest, and `slowest` (L, spectra) those
    of the slowest process of each spectrum that they can hardly be told from.

    If samples are `exact` each process has as many modes as there are samples.
    """

    even: Real
    odd: Real
    parts: tuple[Part, ...]
    chances: Real
    freedom: Real
    kinds: Real
    place: np.ndarray
    share: Real
    vectors: Real
    simple: np.ndarray
    slowest: np.ndarray
    exact: bool


class Stencils(NamedTuple):
    """
    What modes say of derivatives at an instant: `modes` (K, R), of K orders.

    `products` (K K, R) are those of each two orders, and `unseen` (K K, M) is what models have
    between the samples.
    """

    modes: Real
    products: Real
    unseen: Real


class _Member(NamedTuple):
    """A process on a window: its functions, even and odd, and how many modes of each are seen."""

    process: Process
    functions: tuple[_Functions, _Functions]
    seen: tuple[int, int]


@lru_cache(maxsize=64)
def _layout(count: int, block: int, exact: bool) -> tuple[tuple[int, list[_Member]], ...]:
    """Processes by how many pairs of modes they have at most."""
    whole = (count + 1) // 2 - 1
    limits = [max(int(part * whole), 1) for part in _WIDTHS]
    # Of these functions so much is seen.
    largest = _models._amplitudes(exact)[-1]
    found: dict[int, list[_Member]] = {}
    for process in _models._processes(count, exact):
        functions = even, odd = _models._functions(process, count, block)
        seen = [
            len(one.sizes)
            if exact
            else int(np.count_nonzero(one.sizes * largest > _models._MIN_MODE_SIGMA))
            for one in (even, odd)
        ]
        width = whole if exact else min(limit for limit in limits if limit >= max(seen))
        found.setdefault(width, []).append(_Member(process, functions, (seen[0], seen[1])))
    return tuple(found.items())


@lru_cache(maxsize=64)
def modes_of(count: int, block: int = 1, exact: bool = False) -> Modes:
    """
    The models of a window of `count` samples, a few or more, each the mean of `block`.

    The largest motion is 1e7 deviations of the noise, and `MOST_EXACT` if the samples are `exact`.
    """
    _, root, lines = _half_window(count)
    amplitudes = _models._amplitudes(exact)
    rows: tuple[list[Real], list[Real]] = ([lines[0][None]], [lines[1][None]])
    parts, priors, occam, freedom = [], [], [], []
    by_model: list[Process] = []
    first = models = 0
    for width, members in _layout(count, block, exact):
        processes = [member.process for member in members]
        sizes = np.zeros((len(members), width, 2))
        for p, member in enumerate(members):
            for parity, (functions, seen) in enumerate(
                zip(member.functions, member.seen, strict=True)
            ):
                sizes[p, :seen, parity] = functions.sizes[:seen]
                vectors = np.zeros((width, len(functions.vectors)))
                kept = functions.vectors[:, : None if exact else seen].T
                vectors[: len(kept)] = kept
                rows[parity].append(vectors)
        large = (amplitudes[:, None] * sizes.reshape(len(processes), 1, -1)) ** 2
        share = large / (1 + large)
        number = len(processes) * len(amplitudes)
        begin = 2 + first
        first += 2 * width * len(processes)
        some = slice(models, models + number)
        parts.append(Part(begin, 2 + first, some, share, 1 / (1 + large)))
        models += number
        own = [process for process in processes for _ in amplitudes]
        by_model += own
        priors += [process.prior / len(amplitudes) for process in own]
        occam.append(-np.log1p(large).sum(axis=-1).ravel() / 2)
        freedom.append(2 + share.sum(axis=-1).ravel())
    even, odd = (np.concatenate(part) * root / 2 for part in rows)
    # Rest has no slope, and is more probable by all that this might be.
    occam.append(np.log([3 * amplitudes[-1]]))
    prior, less = np.log([*priors, _SIMPLE_PRIOR]), np.concatenate(occam)
    kind = np.array([*(process.spectrum for process in by_model), -1])
    return Modes(
        even,
        odd,
        tuple(parts),
        np.stack((prior + less, prior + 2 * less), axis=1)[..., None],
        np.concatenate([*freedom, [1.0]]),
        np.array(
            [(kind == k) | (kind < 0) for k in range(len(_models.SPECTRA))],
            float,
        ),
        *_by_model(parts, len(kind), 2 * len(even)),
        _whole(count, even, odd),
        *_hardly_others(by_model, len(amplitudes)),
        exact,
    )


def _hardly_others(models: list[Process], amplitudes: int) -> tuple[np.ndarray, np.ndarray]:
    """
    The models that are low polynomials, and rest, and which processes are hardly others.

    Of parabolas these are the slowest of each spectrum, of the same amplitude up to the largest
    that may look like one; of a line and rest it is the slowest and least of the first spectrum.
    """
    spectrum = np.array([*(process.spectrum for process in models), -1])
    length = np.array([*(process.length for process in models), 1])
    first = np.array(
        [np.where(spectrum == k, length, 0).argmax() for k in range(len(_models.SPECTRA))]
    )
    simple = (spectrum < 0).nonzero()[0]
    curved = length[simple, None] > 1
    amplitude = np.minimum(simple % amplitudes, _models._PARABOLA_AMPLITUDE)[:, None]
    return simple, np.where(curved, first + amplitude, first[0])


def _by_model(parts: list[Part], models: int, rows: int) -> tuple[np.ndarray, Real]:
    """Which rows models have, and how much of them is motion: `place` and `share` of `Modes`."""
    place = np.full((models, 2 + max(part.share.shape[2] for part in parts)), rows)
    share = np.zeros(place.shape)
    place[:, :2], share[:-1, :2], share[-1, 0] = (0, 1), 1.0, 1.0
    for part in parts:
        processes, amplitudes, width = part.share.shape
        own = np.arange(part.first, part.last).reshape(processes, width)
        place[part.models, 2 : 2 + width] = np.repeat(own, amplitudes, axis=0)
        share[part.models, 2 : 2 + width] = part.share.reshape(-1, width)
    return place, share


def _whole(count: int, even: Real, odd: Real) -> Real:
    """Modes on all samples, and none: `vectors` of `Modes`."""
    half, opposite = even.shape[1], slice(count // 2 - 1, None, -1)
    vectors = np.zeros((2 * len(even) + 1, count))
    vectors[:-1:2, :half], vectors[1:-1:2, :half] = even, odd
    vectors[:-1:2, half:], vectors[1:-1:2, half:] = even[:, opposite], -odd[:, opposite]
    if count % 2:
        vectors[:-1:2, half - 1] *= 2
    return vectors


def _derivatives(
    count: int, block: int, exact: bool, time: Real, orders: range
) -> tuple[Real, list[tuple[Real, Real]]]:
    """
    Derivatives (T, K, R) of the modes at times (T,).

    And of each process' functions, even and odd, (T, K, J), those that no mode has.
    """
    lines = np.stack(
        [_line_derivatives(count, time, order) for order in orders], axis=1
    )  # (T, K, 2)
    found, functions = [lines], []
    for width, members in _layout(count, block, exact):
        for member in members:
            values = _waves(member.process, count, time, orders)
            rows = np.zeros((len(time), len(orders), width, 2))
            pair = []
            for parity, (one, seen) in enumerate(zip(member.functions, member.seen, strict=True)):
                left = np.stack([value[parity] for value in values], axis=1)
                left -= lines[..., parity, None] * one.on_line
                rows[..., :seen, parity] = left @ one.right[:seen].T / one.sizes[:seen]
                pair.append(left)
            found.append(rows.reshape(len(time), len(orders), -1))
            functions.append((pair[0], pair[1]))
    return np.concatenate(found, axis=2), functions


@lru_cache(maxsize=256)
def stencils_of(count: int, at: float, block: int, orders: int, exact: bool = False) -> Stencils:
    """
    Those of a window, as in `modes_of`, at an instant so many samples from its middle.

    Of so many `orders`, from 0.
    """
    found, functions = _derivatives(count, block, exact, np.array([at]), range(orders))
    modes = found[0]
    members = [member for _, some in _layout(count, block, exact) for member in some]
    unseen = []
    for member, pair in zip(members, functions, strict=True):
        total = np.zeros((orders, orders))
        for one, seen, (left,) in zip(member.functions, member.seen, pair, strict=True):
            left = left - (left @ one.right[:seen].T) @ one.right[:seen]
            total += left @ left.T
        unseen.append(_models._amplitudes(exact)[:, None] ** 2 * total.ravel())
    unseen.append(np.zeros((1, orders * orders)))
    products = (modes[:, None] * modes).reshape(orders * orders, -1)
    return Stencils(modes, products, np.concatenate(unseen).T)


@lru_cache(maxsize=24)
def slopes_of(count: int, block: int = 1, exact: bool = False) -> Real:
    """Derivatives (orders, R, n) of the modes of a window at its samples, the first four."""
    time = np.arange(count) - (count - 1) / 2
    found, _ = _derivatives(count, block, exact, time, range(1, 5))
    return np.ascontiguousarray(np.moveaxis(found, 0, 2))
