"""
From poses at stamps to derivatives at instants.

Nothing is remembered: what is found at an instant depends on the poses in its window alone.
"""

import math

import numpy as np

from derivatives_reference._cells import (
    EXACT,
    OFF,
    SIMILAR,
    Cells,
    cells_of,
    part_of,
    usual_of,
)
from derivatives_reference._evidence import Found
from derivatives_reference._samples import Window, place, total
from derivatives_reference._sizes import LACKING, Group, groups_of
from derivatives_reference._steps import derive_even
from kinpole_ros.derivatives import Derivatives, Poses, Windows
from kinpole_ros.planar._plane import Real, complex_of

# Of a block those samples count that have this share of the information of the best of it.
_POOR = 0.25
# So many pairs of cells that are lacking are treated at once.
_PAIRS = 1000
# Instants and bodies that are differentiated at once, as many as fit into the cache.
_AT_ONCE = 64


def derive_poses(
    poses: Poses,
    windows: Windows,
    left_out: np.ndarray,
    noise: Real,
    window: float,
    order: int,
) -> Derivatives:
    """
    Differentiate poses at the instants of `windows`, up to `order`.

    `left_out` (T, B) is how many of the newest frames of each window do not count, `noise` (T, B)
    the deviation of a sample with information of 1, and `window`, s, the longest there is.
    """
    instants, bodies = noise.shape
    step = max(1, _AT_ONCE // bodies)
    shape, square = (order + 1, instants, bodies), (order + 1, order + 1, instants, bodies)
    result = Derivatives(
        np.empty(shape, complex),
        np.empty(shape),
        np.empty(square),
        np.empty(square),
        *np.empty((2, instants, bodies)),
        np.empty((instants, bodies), complex),
    )
    for first in range(0, instants, step):
        part = slice(first, first + step)
        for some, cells in cells_of(poses, part_of(windows, part), left_out[part], noise[part]):
            found = _derive_all(cells, window, order + 1)
            for array, values in zip(result, found, strict=True):
                array[..., first + some, :] = values.reshape(*values.shape[:-1], -1, bodies)
    # What was found is about the poses at the instants.
    result.angle[0] += poses.angle[windows.now]
    result.position[0] += poses.position[windows.now]
    turned = result.reference != 0
    result.reference[turned] *= np.exp(-1j * poses.angle[windows.now][turned])
    return result


def _derive_all(cells: Cells, window: float, orders: int) -> Derivatives:
    """Derivatives (..., S) of all signals, per s, NaN for those of which there is too little."""
    groups = groups_of(cells, window)
    if groups and isinstance(groups[0].which, slice):
        return _derive(cells, groups[0], orders)
    shape, square = (orders, len(cells.ahead)), (orders, orders, len(cells.ahead))
    result = Derivatives(
        np.empty(shape, complex),
        np.empty(shape),
        np.empty(square),
        np.empty(square),
        *np.empty((2, len(cells.ahead))),
        np.empty(len(cells.ahead), complex),
    )
    for array in result:
        array.fill(np.nan)
    for group in groups:
        for array, found in zip(result, _derive(cells, group, orders), strict=True):
            array[..., group.which] = found
    return result


def _derive(cells: Cells, group: Group, orders: int) -> Derivatives:
    """Derivatives (..., S) of a group, per s."""
    which, size, block, ahead, exact = group
    count = size * block
    more = count - len(cells.samples)
    if more > 0:
        cells = _longer(cells, more)
    # From the oldest.
    samples = cells.samples[:count, :, which][::-1]
    interval = cells.interval[which] * block
    weight = None if cells.weight is None else cells.weight[:count, :, which][::-1]
    off = None if cells.off is None else cells.off[:count, which][::-1]
    less: Real | float = math.sqrt(block)
    if block > 1 and (weight is not None or off is not None):
        samples, weight, off, less = _blocks(samples, weight, off, size, block)
        samples = samples * less[[0, 1, 1]]
    elif block > 1:
        samples = samples.reshape(size, block, 3, -1).mean(axis=1) * less
    # The oldest cells of a window may not be in it.
    if weight is not None and not np.count_nonzero(weight < 1):
        weight = None
    if off is not None and not np.count_nonzero(off):
        off = None
    at = (size - 1) / 2 - (ahead - (block - 1) / 2) / block
    window = Window(size, at, block, orders, bool(exact))
    units = cells.unit[:, which] / less
    if weight is None and off is None:
        found = derive_even(window, samples, None, units[0])
    else:
        found = _derive_uneven(window, samples, weight, off, units[0])
    scale = interval ** -np.arange(float(orders))[:, None]  # (K, S)
    of_angle, of_position = units[:, None] * scale
    mean, covariance, freedom, *_ = found
    return Derivatives(
        complex_of(mean[:, 1] * of_position, mean[:, 2] * of_position),
        mean[:, 0] * of_angle,
        covariance[:, :, 1] * of_position * of_position[:, None],
        covariance[:, :, 0] * of_angle * of_angle[:, None],
        (size - 1) * interval,
        freedom[0],
        found.hub * units[1],
    )


def _longer(cells: Cells, more: int) -> Cells:
    """The same with so many cells more that are older, of which nothing is seen."""
    samples = np.pad(cells.samples, ((0, more), (0, 0), (0, 0)))
    weight = np.zeros((len(samples), 2, samples.shape[2]))
    weight[:-more] = 1.0 if cells.weight is None else cells.weight
    off = None if cells.off is None else np.pad(cells.off, ((0, more), (0, 0)))
    return cells._replace(samples=samples, weight=weight, off=off)


def _derive_uneven(
    window: Window, samples: Real, weight: Real | None, off: Real | None, radians: Real
) -> Found:
    """The same of samples some of which are lacking, or not in their places."""
    given = samples
    signals = np.arange(samples.shape[2])
    noise = np.ones((2, len(signals)))
    if weight is not None:
        lacking = (weight < 1).any(axis=1).sum(axis=0)
        # What is lacking goes by its square: not too much of it at once.
        if len(signals) > 1 and len(signals) * int(lacking.max()) ** 2 > _PAIRS:
            halves = np.array_split(signals, 2)
            offs = [None if off is None else off[:, some] for some in halves]
            parts = [
                _derive_uneven(window, samples[..., some], weight[..., some], late, radians[some])
                for some, late in zip(halves, offs, strict=True)
            ]
            return Found(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))
        many = lacking > LACKING
        if np.count_nonzero(many):
            # To treat many by what they are takes too long: all have their mean.
            there = (weight > 0) & many
            sums = total(np.divide(1.0, weight, out=np.zeros_like(weight), where=there))
            noise = np.where(many, np.sqrt(sums / np.maximum(there.sum(axis=0), 1)), 1.0)
            weight = np.where(there, 1.0, weight)
            samples = samples / noise[[0, 1, 1]]
    samples, more = place(window, samples, weight, off)
    more = more * noise
    found = derive_even(window, samples, weight, radians * more[0])
    mean, covariance = found.mean * more[[0, 1, 1]], found.covariance * more**2
    found = found._replace(mean=mean, covariance=covariance, hub=found.hub * more[1])
    if window.exact:
        lost = np.flatnonzero(~np.isfinite(found.mean).all(axis=(0, 1)))
        if len(lost):
            late = None if off is None else off[:, lost]
            own = None if weight is None else weight[..., lost]
            noisy = _derive_as_noisy(window, given[..., lost], own, late, radians[lost])
            for array, part in zip(found, noisy, strict=True):
                array[..., lost] = part
    return found


def _derive_as_noisy(
    window: Window, samples: Real, weight: Real | None, off: Real | None, radians: Real
) -> Found:
    """
    Differentiate samples as if their noise were the least of a window that is not exact.

    The samples in a gap follow from the others by a matrix. It is singular by rounding where motion
    is much larger than noise and the gap is long.
    """
    largest = np.abs(samples).max(axis=0)
    least = np.stack((largest[0], np.maximum(largest[1], largest[2]))) / EXACT
    noise = np.maximum(least, 1.0)
    by = noise[[0, 1, 1]]
    noisy = window._replace(exact=False)
    found = _derive_uneven(noisy, samples / by, weight, off, radians * noise[0])
    mean, covariance = found.mean * by, found.covariance * noise**2
    return found._replace(mean=mean, covariance=covariance, hub=found.hub * noise[1])


def _blocks(
    samples: Real, weight: Real | None, off: Real | None, size: int, block: int
) -> tuple[Real, Real, Real, Real]:
    """
    Means over blocks, each of those samples in it that there are.

    With their weights, how much they are off, and by how much (2, S) their noise is less.
    """
    if weight is None:
        weight = np.ones((len(samples), 2, samples.shape[2]))
    if off is None:
        off = np.zeros((len(samples), samples.shape[2]))
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
    usual = usual_of(good)
    weight = good / usual
    weight[weight >= SIMILAR] = 1.0
    # What is missing in a block moves its middle.
    offsets = (np.arange(block) - (block - 1) / 2)[:, None]
    late = (share * (off + offsets)).sum(axis=1) / block
    late[np.abs(late) < OFF] = 0.0
    return samples, weight, np.where(number > 0, late, 0.0), np.sqrt(block * usual)
