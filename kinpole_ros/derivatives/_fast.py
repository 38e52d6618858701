"""The compiled kernel, and models and stencils as it takes them."""

from ctypes import c_double, c_longlong, c_void_p
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.compiled import library, pass_array
from kinpole_ros.derivatives._models import Modes, Stencils
from kinpole_ros.planar._plane import Real

# The noise as it was measured counts for so many samples.
KNOWN = 300.0
# Models with less weight than this do not count.
_LEAST = 1e-5
# Models of the kernel that are side by side, as many as LANES.
_LANES = 8
# How many stay packed, no more than are kept of the originals.
_MODES, _STENCILS, _SLOPES = 64, 256, 24

_COMMON: list[Any] = [c_double, c_double, *[c_void_p] * 7, c_longlong, c_longlong]
library.kinpole_derive.argtypes = [*_COMMON, c_longlong, *[c_void_p] * 3]
library.kinpole_move.argtypes = [*_COMMON, *[c_void_p] * 3]


class Found(NamedTuple):
    """
    Of S bodies: derivatives `mean` (K, 3, S) of angle and both coordinates.

    `covariance` (K, K, 2, S) is that of the angle and of one coordinate, `freedom` (2, S) how many
    parameters their motions have, and `evidence` (2, S) the logarithm of how probable the samples
    are by all models, up to a constant for so many samples.
    """

    mean: Real
    covariance: Real
    freedom: Real
    evidence: Real


class Lacking(NamedTuple):
    """
    X `cells` (X, S) of the samples of S bodies that count only for `weight` (X, 2, S), 0 to 1, of
    angle and position. Those of weight 1 are as good as others.
    """

    cells: np.ndarray
    weight: Real


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
    orders, bodies = len(stencils.modes), samples.shape[2]
    mean = np.empty((orders, 3, bodies))
    covariance = np.empty((orders, orders, 2, bodies))
    summary = np.empty((2, 2, bodies))
    tables = _packed_stencils(modes, stencils)
    arguments = _common(KNOWN, modes, tables, samples, seen, lacking)
    if not library.kinpole_derive(
        *arguments, orders, *map(pass_array, (mean, covariance, summary))
    ):
        raise MemoryError
    return Found(mean, covariance, *summary)


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
    if given.shape != samples.shape or off.shape != samples[:, 0].shape:
        raise ValueError('arrays do not fit to each other')
    moved = np.empty(samples.shape)
    arguments = _common(known, modes, _packed_slopes(modes, slopes), samples, seen, lacking)
    if not library.kinpole_move(*arguments, *map(pass_array, (given, off, moved))):
        raise MemoryError
    return moved


def _common(
    known: float,
    modes: Modes,
    tables: Real,
    samples: Real,
    seen: Real | float,
    lacking: Lacking | None,
) -> list[Any]:
    """The arguments that both functions of the kernel begin with, if they fit to each other."""
    count, three, bodies = samples.shape
    seen = np.full((2, bodies), seen) if np.ndim(seen) == 0 else np.asarray(seen)
    cells, weight = lacking or (np.empty((0, bodies), int), np.empty((0, 2, bodies)))
    fit = (count, three) == (modes.vectors.shape[1], 3) and seen.shape == (2, bodies)
    fit = fit and cells.shape == weight[:, 0].shape and weight.shape[1:] == seen.shape
    if not fit or (cells < 0).any() or (cells >= count).any():
        raise ValueError('arrays do not fit to each other')
    counts, numbers = _packed_modes(modes)
    return [
        known,
        _LEAST,
        pass_array(counts, np.int64),
        *map(pass_array, (numbers, tables, samples, seen)),
        pass_array(cells, np.int64),
        pass_array(weight),
        len(cells),
        bodies,
    ]


_Packed = tuple[np.ndarray, Real]
# By identity: to compare their arrays would take longer than what is saved. What is packed has the
# originals beside it, so that these live as long.
_modes: dict[int, tuple[Modes, _Packed]] = {}
_stencils: dict[tuple[int, int], tuple[Modes, Stencils, Real]] = {}
_slopes: dict[tuple[int, int], tuple[Modes, Real, Real]] = {}


def _packed_modes(modes: Modes) -> _Packed:
    """What the kernel takes of models."""
    found = _modes.get(id(modes))
    if found is None:
        found = _modes[id(modes)] = modes, _pack(modes)
        _forget(_modes, _MODES)
    return found[1]


def _packed_stencils(modes: Modes, stencils: Stencils) -> Real:
    """What the kernel takes of stencils."""
    key = id(modes), id(stencils)
    found = _stencils.get(key)
    if found is None:
        found = _stencils[key] = modes, stencils, _pack_stencils(modes, stencils)
        _forget(_stencils, _STENCILS)
    return found[2]


def _packed_slopes(modes: Modes, slopes: Real) -> Real:
    """What the kernel takes of slopes."""
    key = id(modes), id(slopes)
    found = _slopes.get(key)
    if found is None:
        found = _slopes[key] = modes, slopes, _pack_slopes(modes, slopes)
        _forget(_slopes, _SLOPES)
    return found[2]


def _forget(kept: dict[Any, Any], most: int) -> None:
    """The oldest, if there are too many."""
    while len(kept) > most:
        kept.pop(next(iter(kept)), None)


def _rows(modes: Modes) -> tuple[list[np.ndarray], np.ndarray]:
    """
    Which rows (_,) of the modes are even and odd and no padding, each by process, up to _LANES.

    And where those (2, P + 1) of each process begin among them. Mean and slope are none's.
    """
    found, first = [], np.zeros((2, _processes(modes) + 1), np.int64)
    begin = 0
    for parity, half in enumerate((modes.even, modes.odd)):
        there = half.any(axis=1)
        own = [np.zeros(1, int)]
        k = 0
        for part in modes.parts:
            for rows in np.split(np.arange(part.first // 2, part.last // 2), len(part.share)):
                own.append(rows[there[rows]])
                first[parity, k] = begin + sum(map(len, own[:-1]))
                k += 1
        each = np.concatenate(own)
        first[parity, k] = begin + len(each)
        found.append(each)
        begin += _up(len(each))
    return found, first


def _up(number: int) -> int:
    """The next multiple of the lanes."""
    return -(-number // _LANES) * _LANES


def _processes(modes: Modes) -> int:
    return sum(len(part.share) for part in modes.parts)


def _lanes(modes: Modes, values: Real, nothing: float) -> Real:
    """What is so for models (M, ...) by groups (G, _LANES, ...) of the kernel."""
    amplitudes = modes.parts[0].share.shape[1]
    shape = _processes(modes), _up(amplitudes), *values.shape[1:]
    found = np.full(shape, nothing, values.dtype)
    found[:, :amplitudes] = values[:-1].reshape(shape[0], amplitudes, *shape[2:])
    rest = np.full((1, _LANES, *shape[2:]), nothing, values.dtype)
    rest[0, 0] = values[-1]
    return np.concatenate((found.reshape(-1, _LANES, *shape[2:]), rest))


def _scattered(modes: Modes, values: Real) -> Real:
    """What is so for rows (R, ...) in the order of the kernel, (rows, ...), with zeros between."""
    each, _ = _rows(modes)
    ends = np.cumsum([_up(len(own)) for own in each])
    found = np.zeros((ends[-1], *values.shape[1:]))
    for parity, (own, end) in enumerate(zip(each, ends, strict=True)):
        begin = end - _up(len(own))
        found[begin : begin + len(own)] = values[2 * own + parity]
    return found


def _table(modes: Modes, values: list[Real], nothing: float) -> Real:
    """Of the modes of each part (P, A, m): (chunks, rows, _LANES), by amplitudes."""
    amplitudes = values[0].shape[1]
    found = np.full((2 * len(modes.even), _up(amplitudes)), nothing)
    for part, own in zip(modes.parts, values, strict=True):
        found[part.first : part.last, :amplitudes] = own.swapaxes(1, 2).reshape(-1, amplitudes)
    found = _scattered(modes, found)
    return found.reshape(len(found), -1, _LANES).swapaxes(0, 1)


def _pack(modes: Modes) -> _Packed:
    """The arrays of `Models` of the kernel, one after the other."""
    each, first = _rows(modes)
    count = modes.vectors.shape[1]
    half = np.stack((modes.even, modes.odd), axis=1).reshape(-1, modes.even.shape[1])
    half = _scattered(modes, half)
    panels = half.reshape(-1, _LANES, half.shape[1]).swapaxes(1, 2)
    kinds = len(modes.kinds)
    # The last kind is of all spectra.
    kind = np.where(modes.kinds.all(axis=0), kinds, modes.kinds.argmax(axis=0)).astype(np.int64)
    shares = _table(modes, [part.share for part in modes.parts], 0.0)
    numbers = [panels, shares]
    if modes.exact:
        # What is no model leaves all there is, as if it were the line: it has to be invertible.
        numbers.append(_table(modes, [part.lost for part in modes.parts], 1.0))
    numbers += [_lanes(modes, modes.chances[:, c, 0], -np.inf) for c in range(2)]
    numbers.append(_lanes(modes, modes.freedom, 0.0))
    head = [count, len(first[0]) - 1, len(shares), kinds, modes.exact, _up(len(each[0])), len(half)]
    counts = np.concatenate(
        (np.array([*head, 0], np.int64), first.ravel(), _lanes(modes, kind, kinds).ravel())
    )
    return counts, np.concatenate([part.ravel() for part in numbers])


def _pack_stencils(modes: Modes, stencils: Stencils) -> Real:
    """
    Stencils (K, rows) of the kernel, and then how uncertain models are.

    That is the covariance of derivatives (G, K, K, _LANES) over that of the noise, of low
    polynomials and rest that of the processes they can hardly be told from.
    """
    spread = stencils.unseen + stencils.products[:, :2].sum(axis=1)[:, None]
    for part in modes.parts:
        products = stencils.products[:, part.first : part.last]
        products = products.reshape(len(products), len(part.share), -1, 1)
        own = part.share @ products  # (K K, P, A, 1)
        spread[:, part.models] += own.reshape(len(spread), -1)
    spread[:, modes.simple] = spread[:, modes.slowest].mean(axis=-1)
    lanes = _lanes(modes, spread.T, 0.0).swapaxes(1, 2)
    rows = _scattered(modes, stencils.modes.T).T
    return np.concatenate((rows.ravel(), lanes.ravel()))


def _pack_slopes(modes: Modes, slopes: Real) -> Real:
    """Slopes (orders, panels, rows, _LANES) of the kernel, at the first half of all samples."""
    half = modes.even.shape[1]
    packed = []
    for slope in slopes:
        own = np.pad(_scattered(modes, slope[:, :half]), ((0, 0), (0, -half % _LANES)))
        packed.append(own.reshape(len(own), -1, _LANES).swapaxes(0, 1))
    return np.ascontiguousarray(packed)
