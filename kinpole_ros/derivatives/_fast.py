"""
`derive` as the package uses it: compiled if that could be built, of numpy otherwise.

Both do the same: _evidence.py says what, and _kernel.c why it is there twice.
"""

from importlib import import_module
from typing import Any

import numpy as np

from kinpole_ros.derivatives import _evidence
from kinpole_ros.derivatives._evidence import Found
from kinpole_ros.derivatives._lacking import Lacking
from kinpole_ros.derivatives._models import Modes, Stencils
from kinpole_ros.planar._plane import Real

_kernel: Any
try:
    _kernel = import_module('kinpole_ros.derivatives._kernel')
except ImportError:
    _kernel = None

# Models of the kernel that are side by side, as many as LANES.
_LANES = 8
# With more cells lacking than this numpy does it: no window of 64 has more of them missing.
_MOST_LACKING = 32
# How many stay packed, no more than are kept of the originals.
_MODES, _STENCILS, _SLOPES = 64, 256, 24


def derive(
    modes: Modes,
    stencils: Stencils,
    samples: Real,
    seen: Real | float,
    lacking: Lacking | None = None,
) -> Found:
    """The same as `derive` of _evidence.py."""
    if _kernel is None or (lacking is not None and len(lacking.cells) > _MOST_LACKING):
        return _evidence.derive(modes, stencils, samples, seen, lacking)
    orders, bodies = len(stencils.modes), samples.shape[2]
    if not isinstance(seen, np.ndarray):
        seen = np.full((2, bodies), float(seen))
    mean = np.empty((orders, 3, bodies))
    covariance = np.empty((orders, orders, 2, bodies))
    summary = np.empty((2, 2, bodies))
    _kernel.derive(
        _evidence.KNOWN,
        _evidence._LEAST,
        *_packed_modes(modes),
        _packed_stencils(modes, stencils),
        np.ascontiguousarray(samples, float),
        np.ascontiguousarray(seen, float),
        *_cells(lacking),
        mean,
        covariance,
        summary,
    )
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
    """The same as `move` of _evidence.py."""
    if _kernel is None or (lacking is not None and len(lacking.cells) > _MOST_LACKING):
        return _evidence.move(modes, slopes, given, samples, off, seen, lacking, known)
    moved = np.empty(samples.shape)
    _kernel.move(
        known,
        _evidence._LEAST,
        *_packed_modes(modes),
        _packed_slopes(modes, slopes),
        np.ascontiguousarray(samples, float),
        np.ascontiguousarray(seen, float),
        *_cells(lacking),
        moved,
        np.ascontiguousarray(given, float),
        np.ascontiguousarray(off, float),
    )
    return moved


def _cells(lacking: Lacking | None) -> tuple[np.ndarray | None, Real | None]:
    if lacking is None:
        return None, None
    cells, weight = lacking
    return np.ascontiguousarray(cells, np.int64), np.ascontiguousarray(weight, float)


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
