"""
From poses at stamps to derivatives at instants: which samples a window has, and how good they are.

Nothing is remembered: what is found at an instant depends on the poses in its window alone.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from kinpole_ros.derivatives._evidence import Found
from kinpole_ros.derivatives._models import FEWEST_SAMPLES, MOST_EXACT
from kinpole_ros.derivatives._parts import derive_parts
from kinpole_ros.derivatives._samples import Window, place, total
from kinpole_ros.planar._plane import Complex, Real, complex_of

# More samples than this in a window are averaged in blocks.
_MOST = 128
# Windows with too few samples are shorter by powers of this. So much of a window is there.
_SHORTER = 0.95
_PRESENT = 0.5
# Samples that have this share of the information of the best count equally, by their mean.
_SIMILAR = 0.5
# If more cells than that are lacking, two of them make one; if more count for less, all count
# equally, by their mean noise.
_LACKING = 24
# Of a block those samples count that have this share of the information of the best of it.
_POOR = 0.25
# Samples are in their places if they are off by no more than this part of the interval.
_OFF = 1e-4
# Of intervals between frames, by which they are none of a whole number; how many may be miscounted.
_DOUBTFUL, _COUNTED = 0.2, 4
# Samples that differ by more deviations of their noise are taken for exact.
_EXACT = 1e7
# So many pairs of cells that are lacking are treated at once.
_PAIRS = 1000
# Instants and bodies that are differentiated at once, as many as fit into the cache.
_AT_ONCE = 64


class Poses(NamedTuple):
    """
    Poses of B bodies in N frames at `time` (N,), ns.

    `angle` (N, B), rad, is that beyond so many whole `turns` (N, B): separate, since their sum
    would be rounded by how many turns it is counted from. `position` (N, B) is complex, m.
    `angle_information` and `position_information` (N, B) are inverse variances of angles and of
    each coordinate, in units of the noise; 0 where a body is not known.
    """

    time: np.ndarray
    angle: Real
    turns: Real
    position: Complex
    angle_information: Real
    position_information: Real


class Derivatives(NamedTuple):
    """
    Derivatives (K, T, B) of poses of B bodies at T instants, K orders; NaN where too few are known.

    With covariances (K, K, T, B), of one coordinate. `span` (T, B) is how long the window is, s,
    and `freedom` (T, B) how many parameters the angle's motion has in it, 2 if it is steady.
    """

    position: Complex
    angle: Real
    position_covariance: Real
    angle_covariance: Real
    span: Real
    freedom: Real


class Windows(NamedTuple):
    """Frames (T,) that are instants, and the oldest and newest frames of their windows."""

    now: np.ndarray
    oldest: np.ndarray
    newest: np.ndarray

    def part(self, which: slice) -> 'Windows':
        return Windows(self.now[which], self.oldest[which], self.newest[which])


class _Cells(NamedTuple):
    """
    Windows of S instants and bodies as even cells, the newest first.

    `samples` (n, 3, S) are angles and coordinates about those of the instant, in deviations of
    their noise, 0 where none is; `weight` (n, 2, S) is how good those of angle and position are
    over the best; `off` (n, S) is by how many intervals they are late; `ahead` (S,) is how many
    cells are newer than the instant; `unit` (2, S) are the deviations of the noise, `interval` (S,)
    is in s, and `exact` (S,) where motion is so much larger than its noise that it matters.
    """

    samples: Real
    weight: Real
    off: Real
    ahead: np.ndarray
    unit: Real
    interval: Real
    exact: np.ndarray


def derive_poses(
    poses: Poses,
    windows: Windows,
    left_out: np.ndarray,
    noise: Real,
    window: float,
    order: int,
    effort: str = 'normal',
) -> Derivatives:
    """
    Differentiate poses at the instants of `windows`, up to `order`.

    `left_out` (T, B) is how many of the newest frames of each window do not count, `noise` (T, B)
    the deviation of a sample with information of 1, and `window`, s, the longest there is. With low
    `effort` no window is taken for two parts, with high effort there are twice as many processes.
    """
    instants, bodies = noise.shape
    step = max(1, _AT_ONCE // bodies)
    even = not np.count_nonzero(left_out) and _are_even(poses, windows)
    parts = []
    for first in range(0, instants, step):
        part = slice(first, first + step)
        cells = (_even_cells if even else _cells)(
            poses, windows.part(part), left_out[part], noise[part]
        )
        parts.append(_derive_all(cells, window, order + 1, effort))
    found = parts[0]
    if len(parts) > 1:
        found = Derivatives(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))
    found = Derivatives(*[each.reshape(*each.shape[:-1], instants, bodies) for each in found])
    # What was found is about the poses at the instants.
    found.angle[0] += poses.angle[windows.now]
    found.position[0] += poses.position[windows.now]
    return found


def _derive_all(cells: _Cells, window: float, orders: int, effort: str) -> Derivatives:
    """Derivatives (..., S) of all signals, per s, NaN for those of which there is too little."""
    groups = _groups(cells, window)
    if groups and isinstance(groups[0].which, slice):
        return _derive(cells, groups[0], orders, effort)
    shape, square = (orders, len(cells.ahead)), (orders, orders, len(cells.ahead))
    result = Derivatives(
        np.empty(shape, complex),
        np.empty(shape),
        np.empty(square),
        np.empty(square),
        *np.empty((2, len(cells.ahead))),
    )
    for array in result:
        array.fill(np.nan)
    for group in groups:
        for array, found in zip(result, _derive(cells, group, orders, effort), strict=True):
            array[..., group.which] = found
    return result


def _are_even(poses: Poses, windows: Windows) -> bool:
    """Whether all windows have as many frames, evenly, all of which tell as much."""
    now, oldest, newest = windows
    rows = slice(int(oldest[0]), int(newest[-1]) + 1)
    held, ahead = newest - oldest, newest - now
    if np.count_nonzero(held != held[0]) or np.count_nonzero(ahead != ahead[0]):
        return False
    time = poses.time[rows]
    steps = time[1:] - time[:-1]
    if (np.maximum.reduce(steps) - np.minimum.reduce(steps)) * held[0] > _OFF * steps[0]:
        return False
    for information in (poses.angle_information[rows], poses.position_information[rows]):
        least = _SIMILAR * np.maximum.reduce(information)
        good = np.count_nonzero(information >= least) == information.size
        if not good or np.count_nonzero(information[0]) < len(least):
            return False
    return True


def _even_cells(poses: Poses, windows: Windows, left_out: np.ndarray, noise: Real) -> _Cells:
    """The cells of windows that are even."""
    now, oldest, newest = windows
    count = int(newest[0] - oldest[0]) + 1
    bodies = noise.shape[1]
    rows = newest - np.arange(count)[:, None]  # (n, T)
    samples = np.empty((3, count, len(now), bodies))
    samples[0] = poses.angle[rows] - poses.angle[now]
    samples[0] += 2 * np.pi * (poses.turns[rows] - poses.turns[now])
    off = poses.position[rows] - poses.position[now]
    samples[1], samples[2] = off.real, off.imag
    unit = np.empty((2, len(now), bodies))
    unit[0] = noise / np.sqrt(total(poses.angle_information[rows]) / count)
    unit[1] = noise / np.sqrt(total(poses.position_information[rows]) / count)
    signals = len(now) * bodies
    exact = _in_units(samples, unit).reshape(signals)
    interval = (poses.time[newest] - poses.time[oldest]) * 1e-9 / (count - 1)
    return _Cells(
        samples.reshape(3, count, signals).swapaxes(0, 1),
        np.ones((1, 2, 1)),
        np.zeros((1, 1)),
        np.repeat(newest - now, bodies),
        unit.reshape(2, signals),
        np.repeat(interval, bodies),
        exact,
    )


def _cells(poses: Poses, windows: Windows, left_out: np.ndarray, noise: Real) -> _Cells:
    """The cells of any windows."""
    now, oldest, newest = windows
    bodies = noise.shape[1]
    most = int((newest - oldest).max()) + 1
    rows = newest - np.arange(most)[:, None]  # (n, T)
    inside = rows >= oldest
    rows = np.maximum(rows, 0)
    time = np.where(inside, poses.time[rows] - poses.time[now], 0)
    interval = _intervals(time, inside)
    place = time / interval
    # Cells are about where frames are on the mean, or two of them might have the same.
    phase = np.angle(total(np.where(inside, np.exp(2j * np.pi * place), 0))) / (2 * np.pi)
    cell = np.rint(place - phase).astype(int) - np.rint(-phase).astype(int)
    late = place - cell
    known = (poses.angle_information[rows] > 0) & (poses.position_information[rows] > 0)
    known &= inside[..., None] & (np.arange(most)[:, None, None] >= left_out)
    # (n, T, B) from here on.
    ahead = np.where(known, cell[..., None], -1).max(axis=0)
    oldest_cell = np.where(known, cell[..., None], ahead).min(axis=0)
    count = max(int((ahead - oldest_cell).max()) + 1, 1)
    frame, instant, body = known.nonzero()
    at = ahead[instant, body] - cell[frame, instant], instant, body
    row = rows[frame, instant]
    shape = count, *noise.shape
    information = np.zeros((2, *shape))
    information[0][at] = poses.angle_information[row, body]
    information[1][at] = poses.position_information[row, body]
    usual = _usual(information.swapaxes(0, 1))
    with np.errstate(divide='ignore', invalid='ignore'):
        weight = np.where(usual[:, None] > 0, information / usual[:, None], 0.0)
        unit = noise / np.sqrt(usual)
    weight[weight >= _SIMILAR] = 1.0
    samples = np.zeros((3, *shape))
    angle, turned, position = poses.angle[now], poses.turns[now], poses.position[now]
    if np.count_nonzero(np.isnan(angle)):
        # Where the body is not seen at the instant, about nothing.
        angle, turned, position = (np.nan_to_num(a) for a in (angle, turned, position))
    turns = poses.turns[row, body] - turned[instant, body]
    samples[0][at] = poses.angle[row, body] - angle[instant, body] + 2 * np.pi * turns
    off = poses.position[row, body] - position[instant, body]
    samples[1][at], samples[2][at] = off.real, off.imag
    exact = _in_units(samples, unit)
    misplaced = np.zeros(shape)
    misplaced[at] = late[frame, instant]
    misplaced[np.abs(misplaced) < _OFF] = 0.0
    signals = noise.size
    return _Cells(
        samples.reshape(3, count, signals).swapaxes(0, 1),
        weight.reshape(2, count, signals).swapaxes(0, 1),
        misplaced.reshape(count, signals),
        ahead.reshape(-1),
        unit.reshape(2, signals),
        np.repeat(interval * 1e-9, bodies),
        exact.reshape(signals),
    )


def _usual(information: Real) -> Real:
    """The mean along the first axis of those that are not much less than the best of them."""
    similar = information >= _SIMILAR * information.max(axis=0)
    return np.asarray(total(information * similar) / similar.sum(axis=0))


def _in_units(samples: Real, unit: Real) -> np.ndarray:
    """
    Bring samples (3, n, ...) and the deviations (2, ...) of their noise into such units.

    Both in place: there is no noise below rounding. Returns where samples are all but exact.
    """
    each = np.maximum.reduce(np.abs(samples), axis=1)
    largest = each[:2]
    np.maximum(largest[1], each[2], out=largest[1])
    np.maximum(unit, largest / MOST_EXACT, out=unit)
    samples[0] /= unit[0]
    samples[1:] /= unit[1]
    return np.logical_or.reduce(largest > _EXACT * unit)


def _intervals(time: Real, inside: np.ndarray) -> Real:
    """The interval (T,) of the frames, ns, that is usual between those `inside` (n, T)."""
    steps = np.where(inside[1:], time[:-1] - time[1:], np.inf)
    number = inside[1:].sum(axis=0)
    usual = np.sort(steps, axis=0)[np.maximum(number - 1, 0) // 2, np.arange(len(number))]
    steps = np.where(inside[1:], steps, 0.0)
    counts = np.rint(steps / usual)
    span, all_ = total(steps), np.maximum(counts.sum(axis=0), 1)
    doubtful = (np.abs(steps / usual - counts) > _DOUBTFUL).any(axis=0).nonzero()[0]
    interval = span / all_
    if len(doubtful):
        parts = time[:, doubtful], inside[:, doubtful], span[doubtful], all_[doubtful]
        interval[doubtful] = _clearest(*parts)
    return np.asarray(interval)


def _clearest(time: Real, inside: np.ndarray, span: Real, counts: Real) -> Real:
    """The interval by which frames are nearest to even places, with about so many in the `span`."""
    number = np.maximum(counts + np.arange(-_COUNTED, _COUNTED + 1)[:, None], 1)
    turns = np.exp(2j * np.pi * time[:, None] / span * number) * inside[:, None]  # (n, tries, T)
    best = np.abs(total(turns)).argmax(axis=0)
    each = np.arange(len(span))
    interval = span / number[best, each]
    # The ends of the span are as late as any other frame.
    phase = np.angle(total(turns)[best, each]) / (2 * np.pi)
    off = time / interval - phase
    off = (off - np.rint(off)) * inside
    distance = (time / interval - total(time / interval * inside) / total(inside * 1.0)) * inside
    return np.asarray(
        interval * (1 + total(distance * off) / np.maximum(total(distance**2), 1e-300))
    )


class _Group(NamedTuple):
    """
    Signals `which` (S,) with windows of `size` cells, each of `block` samples, `ahead` newer.

    All of them or none are `exact`.
    """

    which: np.ndarray | slice
    size: int
    block: int
    ahead: int
    exact: int


def _groups(cells: _Cells, window: float) -> list[_Group]:
    """Signals by their windows, those left out of which there is too little."""
    count = len(cells.samples)
    whole = np.maximum(np.rint(window / cells.interval).astype(int) + 1, FEWEST_SAMPLES)
    blocks = -(-whole // _MOST)
    sizes = whole // blocks
    if len(cells.weight) > 1 or np.count_nonzero(sizes * blocks > count):
        sizes, blocks = _all_sizes(cells, whole, blocks)
    keys = np.array((sizes, blocks, cells.ahead, cells.exact))
    if not np.count_nonzero(keys != keys[:, :1]):
        return [_Group(slice(None), *keys[:, 0].tolist())] if sizes[0] else []
    each, number = np.unique(keys, axis=1, return_inverse=True)
    return [
        _Group(np.flatnonzero(number.reshape(-1) == k), *key)
        for k, key in enumerate(each.T.tolist())
        if key[0]
    ]


def _all_sizes(
    cells: _Cells, whole: np.ndarray, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    How many blocks (S,) windows have, 0 for none, and how many cells (S,) a block.

    That is `blocks` (S,), or twice as many, and so on, until little of them is lacking: frames may
    come in bunches.
    """
    there = np.broadcast_to((cells.weight > 0).all(axis=1), (len(cells.samples), len(whole)))
    possible = (cells.ahead >= 0) & (np.count_nonzero(there, axis=0) >= FEWEST_SAMPLES)
    # Not beyond the oldest that is there.
    oldest = len(there) - there[::-1].argmax(axis=0)
    sizes, longest = np.zeros(len(whole), int), blocks.copy()
    while np.count_nonzero(possible):
        for block in np.unique(blocks[possible]).tolist():
            some = np.flatnonzero(possible & (blocks == block))
            seen = _blocks_seen(there[:, some], block)
            if not len(seen):
                possible[some] = False
                continue
            found = _sizes(seen, *(a[some] // block for a in (whole, cells.ahead, oldest)))
            lacking = found - seen[found - 1, np.arange(len(some))]
            known = found > 0
            sizes[some[known]], longest[some[known]] = found[known], block
            possible[some[known & (lacking <= _LACKING)]] = False
        blocks = np.where(possible, 2 * blocks, blocks)
        possible &= whole // blocks >= FEWEST_SAMPLES
    return sizes, longest


def _blocks_seen(there: np.ndarray, block: int) -> np.ndarray:
    """Of how many (n, S) blocks up to each something is `there` (N, S), a block being so many."""
    if block > 1:
        whole = len(there) // block
        there = there[: whole * block].reshape(whole, block, there.shape[1]).any(axis=1)
    return there.cumsum(axis=0)


def _sizes(seen: np.ndarray, full: np.ndarray, ahead: np.ndarray, oldest: np.ndarray) -> np.ndarray:
    """
    How many blocks (S,) the longest windows have of which enough is there, 0 for none.

    So many (n, S) are `seen` up to each, so many (S,) are `ahead` of the instant, and so many up to
    the `oldest` that is there.
    """
    sizes, signals = np.zeros(len(full), int), np.arange(len(full))
    for size in _ladder(full, oldest):
        there = seen[np.minimum(size, len(seen)) - 1, signals]
        enough = there >= np.maximum(_PRESENT * size, FEWEST_SAMPLES)
        enough &= (ahead < size) & (size <= oldest) & (size >= FEWEST_SAMPLES)
        sizes = np.where((sizes == 0) & enough, size, sizes)
        if not np.count_nonzero(sizes == 0):
            break
    return sizes


def _ladder(full: np.ndarray, last: np.ndarray) -> Iterator[np.ndarray]:
    """Sizes (S,) to try one after the other, from the `full` ones on."""
    yield full
    # Where stamps are not even a window has one frame more or less.
    size = full - 1
    while (size >= FEWEST_SAMPLES).any():
        yield size
        size = (size * _SHORTER).astype(int)
    # All there is, if the instant is the oldest of it.
    yield np.minimum(full, last)


def _derive(cells: _Cells, group: _Group, orders: int, effort: str) -> Derivatives:
    """Derivatives (..., S) of a group, per s."""
    which, size, block, ahead, exact = group
    count = size * block
    # From the oldest.
    samples = cells.samples[:count, :, which][::-1]
    interval = cells.interval[which] * block
    less: Real | float = math.sqrt(block)
    even = len(cells.weight) == 1
    if not even:
        weight, off = cells.weight[:count, :, which][::-1], cells.off[:count, which][::-1]
        if block > 1:
            samples, weight, off, less = _blocks(samples, weight, off, size, block)
            samples = samples * less[[0, 1, 1]]
        even = not (np.count_nonzero(off) or np.count_nonzero(weight < 1))
    elif block > 1:
        samples = samples.reshape(size, block, 3, -1).mean(axis=1) * less
    at = (size - 1) / 2 - (ahead - (block - 1) / 2) / block
    window = Window(size, at, block, orders, bool(exact), effort == 'high', effort != 'low')
    if even:
        found = derive_parts(window, samples, None)
    else:
        found = _derive_uneven(window, samples, weight, off)
    scale = interval ** -np.arange(float(orders))[:, None]  # (K, S)
    of_angle, of_position = (cells.unit[:, which] / less)[:, None] * scale
    mean, covariance, freedom, _ = found
    return Derivatives(
        complex_of(mean[:, 1] * of_position, mean[:, 2] * of_position),
        mean[:, 0] * of_angle,
        covariance[:, :, 1] * of_position * of_position[:, None],
        covariance[:, :, 0] * of_angle * of_angle[:, None],
        (size - 1) * interval,
        freedom[0],
    )


def _derive_uneven(window: Window, samples: Real, weight: Real, off: Real) -> Found:
    """The same of samples some of which are lacking, or not in their places."""
    lacking = (weight < 1).any(axis=1).sum(axis=0)
    most, signals = int(lacking.max()), np.arange(len(lacking))
    # What is lacking goes by its square: not too much of it at once.
    if len(signals) > 1 and len(signals) * most**2 > _PAIRS:
        half = len(signals) // 2
        parts = [
            _derive_uneven(window, samples[..., some], weight[..., some], off[:, some])
            for some in (signals[:half], signals[half:])
        ]
        return Found(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))
    noise = np.ones((2, len(signals)))
    if most > _LACKING:
        # To treat many that count for less by what they are takes too long: all have their mean.
        there = (weight > 0) & (lacking > _LACKING)
        sums = total(np.divide(1.0, weight, out=np.zeros_like(weight), where=there))
        noise = np.where(lacking > _LACKING, np.sqrt(sums / np.maximum(there.sum(axis=0), 1)), 1.0)
        weight = np.where(there, 1.0, weight)
        samples = samples / noise[[0, 1, 1]]
    weights = weight if most else None
    samples, more = place(window, samples, weights, off)
    more = more * noise
    found = derive_parts(window, samples, weights)
    mean, covariance = found.mean * more[[0, 1, 1]], found.covariance * more**2
    return found._replace(mean=mean, covariance=covariance)


def _blocks(
    samples: Real, weight: Real, off: Real, size: int, block: int
) -> tuple[Real, Real, Real, Real]:
    """
    Means over blocks, each of those samples in it that there are.

    With their weights, how much they are off, and by how much (2, S) their noise is less.
    """
    weight = weight.reshape(size, block, *weight.shape[1:])
    off = off.reshape(size, block, -1)
    samples = samples.reshape(size, block, *samples.shape[1:])
    # All that are counted of count similar, or the middle would not be where the block's is.
    best = weight.max(axis=1, keepdims=True)
    counted = ((weight >= _POOR * best) & (weight > 0)).all(axis=2)
    number = counted.sum(axis=1)
    share = counted / np.maximum(number, 1)[:, None]
    samples = (samples * share[:, :, None]).sum(axis=1)
    variance = np.divide(counted[:, :, None], weight, out=np.zeros_like(weight), where=weight > 0)
    good = number[:, None] ** 2 / np.maximum(variance.sum(axis=1), 1e-300) / block
    good = np.where(number[:, None] > 0, good, 0.0)
    usual = _usual(good)
    weight = good / usual
    weight[weight >= _SIMILAR] = 1.0
    # What is missing in a block moves its middle.
    offsets = (np.arange(block) - (block - 1) / 2)[:, None]
    late = (share * (off + offsets)).sum(axis=1) / block
    late[np.abs(late) < _OFF] = 0.0
    return samples, weight, np.where(number > 0, late, 0.0), np.sqrt(block * usual)
