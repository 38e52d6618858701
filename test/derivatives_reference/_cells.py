"""
Windows as even cells of samples, which of them are seen, how good they are, and how far off.

Most windows are complete: a frame in each cell, all of which tell as much. Any others, with frames
that are lost, wrong, or worth less, take three times as long to bring into cells.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from derivatives_reference._models import MOST_EXACT
from derivatives_reference._samples import total
from kinpole_ros.derivatives import Poses, Windows
from kinpole_ros.planar._plane import Complex, Real

# Samples that have this share of the information of the best count equally, by their mean.
SIMILAR = 0.5
# Samples are in their places if they are off by no more than this part of the interval.
OFF = 1e-4
# Of intervals between frames, by which they are none of a whole number; how many may be miscounted.
_DOUBTFUL, _COUNTED = 0.2, 4
# Cells of a window, most of which are empty.
_MOST_CELLS = 4096
# Samples that differ by more deviations of their noise are taken for exact.
EXACT = 1e7


def part_of(windows: Windows, which: slice | np.ndarray) -> Windows:
    return Windows(*(frames[which] for frames in windows))


class Cells(NamedTuple):
    """
    Windows of S instants and bodies as even cells, the newest first.

    `samples` (n, 3, S) are angles and coordinates about those of the instant, in deviations of
    their noise, 0 where none is; `weight` (n, 2, S) is how good those of angle and position are
    over the best, None if all are as good; `off` (n, S) is by how many intervals they are late,
    None if none is; `ahead` (S,) is how many cells are newer than the instant; `unit` (2, S) are
    the deviations of the noise, `interval` (S,) is in s, and `exact` (S,) where motion is so much
    larger than its noise that it matters.
    """

    samples: Real
    weight: Real | None
    off: Real | None
    ahead: np.ndarray
    unit: Real
    interval: Real
    exact: np.ndarray


def cells_of(
    poses: Poses, windows: Windows, left_out: np.ndarray, noise: Real
) -> Iterator[tuple[np.ndarray, Cells]]:
    """
    Which instants (t,) of T windows, and their cells, for all bodies; arguments as `derive_poses`.

    Those that are cut the same way come together.
    """
    count, ahead = windows.newest - windows.oldest + 1, windows.newest - windows.now
    possible = (count > 1) & ~left_out.any(axis=1)
    others = [np.flatnonzero(~possible)]
    while np.count_nonzero(possible):
        first = possible.argmax()
        equal = possible & (count == count[first]) & (ahead == ahead[first])
        possible &= ~equal
        some = np.flatnonzero(equal)
        complete, off = _complete(poses, part_of(windows, some))
        others.append(some[~complete])
        some = some[complete]
        if len(some):
            yield some, _complete_cells(poses, part_of(windows, some), off, noise[some])
    some = np.sort(np.concatenate(others))
    if len(some):
        yield some, _any_cells(poses, part_of(windows, some), left_out[some], noise[some])


def _complete(poses: Poses, windows: Windows) -> tuple[np.ndarray, Real | None]:
    """
    Which windows (T,), all of as many frames, are complete, and by how much those are off (n, t).

    None if none is off. Windows are as long, and instants lie in the same place.
    """
    now, oldest, newest = windows
    count, ahead = int(newest[0] - oldest[0]) + 1, int(newest[0] - now[0])
    rows = newest - np.arange(count)[:, None]  # (n, T)
    complete = np.ones(len(now), bool)
    for information in (poses.angle_information[rows], poses.position_information[rows]):
        least, most = np.minimum.reduce(information), np.maximum.reduce(information)
        complete &= ((least >= SIMILAR * most) & (least > 0)).all(axis=1)
    time = poses.time[rows] - poses.time[now]
    interval = (time[0] - time[-1]) / (count - 1)
    cell = ahead - np.arange(count)[:, None]
    if (np.abs(time - cell * interval) <= OFF * interval).all():
        return complete, None
    steps = time[:-1] - time[1:]
    usual = np.sort(steps, axis=0)[(count - 2) // 2]
    complete &= (np.abs(steps - usual) <= _DOUBTFUL * usual).all(axis=0)
    place = time / interval
    complete &= (_cell(place, total(np.exp(2j * np.pi * place))) == cell).all(axis=0)
    off = place - cell
    off[np.abs(off) < OFF] = 0.0
    return complete, off[:, complete]


def _cell(place: Real, turns: Complex) -> np.ndarray:
    """
    Cells of frames at places (n, T), about where frames are on the mean.

    About themselves two of them might have the same.
    """
    phase = np.angle(turns) / (2 * np.pi)
    return np.asarray(np.rint(place - phase).astype(int) - np.rint(-phase).astype(int))


def _complete_cells(poses: Poses, windows: Windows, off: Real | None, noise: Real) -> Cells:
    """The cells of windows that are complete, off their places by so much (n, T)."""
    now, oldest, newest = windows
    count = int(newest[0] - oldest[0]) + 1
    bodies = noise.shape[1]
    rows = newest - np.arange(count)[:, None]  # (n, T)
    samples = np.empty((3, count, len(now), bodies))
    samples[0] = poses.angle[rows] - poses.angle[now]
    samples[0] += 2 * np.pi * (poses.turns[rows] - poses.turns[now])
    position = poses.position[rows] - poses.position[now]
    samples[1], samples[2] = position.real, position.imag
    unit = np.empty((2, len(now), bodies))
    unit[0] = noise / np.sqrt(total(poses.angle_information[rows]) / count)
    unit[1] = noise / np.sqrt(total(poses.position_information[rows]) / count)
    signals = len(now) * bodies
    exact = _in_units(samples, unit).reshape(signals)
    interval = (poses.time[newest] - poses.time[oldest]) / (count - 1) * 1e-9
    return Cells(
        samples.reshape(3, count, signals).swapaxes(0, 1),
        None,
        None if off is None else np.repeat(off, bodies, axis=1),
        np.repeat(newest - now, bodies),
        unit.reshape(2, signals),
        np.repeat(interval, bodies),
        exact,
    )


def _any_cells(poses: Poses, windows: Windows, left_out: np.ndarray, noise: Real) -> Cells:
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
    cell = _cell(place, total(np.where(inside, np.exp(2j * np.pi * place), 0)))
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
    usual = usual_of(information.swapaxes(0, 1))
    with np.errstate(divide='ignore', invalid='ignore'):
        weight = np.where(usual[:, None] > 0, information / usual[:, None], 0.0)
        unit = noise / np.sqrt(usual)
    weight[weight >= SIMILAR] = 1.0
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
    misplaced[np.abs(misplaced) < OFF] = 0.0
    signals = noise.size
    return Cells(
        samples.reshape(3, count, signals).swapaxes(0, 1),
        weight.reshape(2, count, signals).swapaxes(0, 1),
        misplaced.reshape(count, signals),
        ahead.reshape(-1),
        unit.reshape(2, signals),
        np.repeat(interval * 1e-9, bodies),
        exact.reshape(signals),
    )


def usual_of(information: Real) -> Real:
    """The mean along the first axis of those that are not much less than the best of them."""
    similar = information >= SIMILAR * information.max(axis=0)
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
    return np.logical_or.reduce(largest > EXACT * unit)


def _intervals(time: Real, inside: np.ndarray) -> Real:
    """The interval (T,) of the frames, ns, that is usual between those `inside` (n, T)."""
    steps = np.where(inside[1:], time[:-1] - time[1:], np.inf)
    number = inside[1:].sum(axis=0)
    usual = np.sort(steps, axis=0)[np.maximum(number - 1, 0) // 2, np.arange(len(number))]
    steps = np.where(inside[1:], steps, 0.0)
    span = total(steps)
    # Most frames may come in bunches, with next to nothing between them.
    usual = np.maximum(usual, span / _MOST_CELLS)
    counts = np.rint(steps / usual)
    all_ = np.maximum(counts.sum(axis=0), 1)
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
