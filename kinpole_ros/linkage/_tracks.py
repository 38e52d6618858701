"""
Points in no order linked to tracks, each point to the track whose prediction it is nearest to.

A track ends where two continuations are about equally likely, so that it is of one marker. A marker
may have many tracks; the bodies found later connect them.
"""

from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage.limits import GATE

# A point is in doubt if a second point or track is within so many prediction errors.
_DOUBT = 2.5
# Frames over which a track, and a young track, goes on unseen.
_MAX_GAP, _MAX_YOUNG_GAP = 10, 3
# Points after which a track may cause doubt, and after which its error is known.
_MIN_AGE, _SETTLED_AGE = 3, 6
# Least prediction error of a track, as a share of the median of all.
_MIN_ERROR = 0.3
# One more track is worth a window shorter by this power of two.
_WINDOW_BITS = 4
# Windows that are compared for each length.
_STARTS = 400

_LIVE = np.dtype(
    [
        ('number', np.int64),
        ('position', float, 3),
        ('speed', float, 3),
        ('error', float),
        ('step', np.int64),
        ('age', np.int64),
    ]
)


class Tracks(NamedTuple):
    """
    K tracks of points in no order.

    `number` (T, n) is the track of each point, -1 for none; `first` and `last` (K,) are the frames
    that each track begins and ends with.
    """

    number: np.ndarray
    first: np.ndarray
    last: np.ndarray

    def dense(self, points: np.ndarray, chosen: np.ndarray, frames: slice) -> np.ndarray:
        """Points (F, len(chosen), ...) of some tracks in some frames, NaN where they have none."""
        number = self.number[frames]
        column = np.full(len(self.first) + 1, -1)
        column[chosen] = np.arange(len(chosen))
        column = column[number]
        rows, slots = np.nonzero(column >= 0)
        dense = np.full((len(number), len(chosen), *points.shape[2:]), np.nan, points.dtype)
        dense[rows, column[rows, slots]] = points[frames][rows, slots]
        return dense


def link(points: np.ndarray, steps: np.ndarray) -> Tracks:
    """
    Link points (T, n, 3) in no order, NaN for none, to tracks; `steps` (T,) number the frames.

    Mutual nearest neighbors of the predictions by constant velocity, frame by frame.
    """
    seen = np.isfinite(points[..., 0])
    number = np.full(seen.shape, -1, np.int64)
    live = np.zeros(0, _LIVE)
    total = 0
    for k, step in enumerate(steps.tolist()):
        columns = seen[k].nonzero()[0]
        measured = points[k, columns]
        taken = np.full(len(columns), -1, np.int64)
        if len(live) and len(measured):
            live, taken = _continued(live, measured, step)
        gap = step - live['step']
        live = live[gap < np.where(live['age'] < _MIN_AGE, _MAX_YOUNG_GAP, _MAX_GAP)]
        begun = (taken < 0).nonzero()[0]
        if len(begun):
            taken[begun] = np.arange(total, total + len(begun))
            total += len(begun)
            new = np.zeros(len(begun), _LIVE)
            new['number'], new['position'], new['step'] = taken[begun], measured[begun], step
            new['error'] = _spacing(measured)[begun] / (2 * GATE)
            live = np.concatenate((live, new))
        number[k, columns] = taken
    rows, slots = (number >= 0).nonzero()
    tracks = number[rows, slots]
    first = np.full(total, len(steps))
    last = np.zeros(total, np.int64)
    np.minimum.at(first, tracks, rows)
    np.maximum.at(last, tracks, rows)
    return Tracks(number, first, last)


def _continued(live: np.ndarray, measured: np.ndarray, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Live tracks continued by measured points (m, 3), without doubtful ones; track of each."""
    gap = step - live['step']
    predicted = live['position'] + live['speed'] * gap[:, None]
    off = np.sqrt(((predicted[:, None] - measured) ** 2).sum(axis=-1))
    error = live['error'] * gap**1.5
    nearest = off.argmin(axis=1)
    rows = np.arange(len(off))
    best = off[rows, nearest]
    is_mutual = (off.argmin(axis=0)[nearest] == rows) & (best < GATE * error)
    near = (off < _DOUBT * error[:, None]) & (live['age'] >= _MIN_AGE)[:, None]
    ambiguous = near & ((near.sum(axis=1) > 1)[:, None] | (near.sum(axis=0) > 1))
    is_ended = ambiguous.any(axis=1)
    rows = (is_mutual & ~is_ended).nonzero()[0]
    nearest, best, gap = nearest[rows], best[rows], gap[rows]
    taken = np.full(len(measured), -1, np.int64)
    taken[nearest] = live['number'][rows]
    age = live['age'][rows]
    live['speed'][rows] = (measured[nearest] - live['position'][rows]) / gap[:, None]
    live['position'][rows] = measured[nearest]
    # The error of the first step is that of an unknown speed. Young tracks adapt fast.
    rate = np.where(age < _SETTLED_AGE, 0.5, 0.1)
    median = np.median(live['error'])
    new_error = best / gap**1.5 - live['error'][rows]
    live['error'][rows] += np.where(age > 0, rate * new_error, 0)
    live['error'][rows] = np.maximum(live['error'][rows], _MIN_ERROR * median)
    live['step'][rows] = step
    live['age'][rows] += 1
    return live[~is_ended], taken


def _spacing(points: np.ndarray) -> np.ndarray:
    """Distance (m,) of each point (m, 3) to its nearest neighbor."""
    if len(points) == 1:
        return np.ones(1)
    distances = np.sqrt(((points[:, None] - points) ** 2).sum(axis=-1))
    np.fill_diagonal(distances, np.inf)
    return np.asarray(distances.min(axis=1))


def best_window(
    tracks: Tracks, enough: int, steps: np.ndarray, least: int
) -> tuple[slice, np.ndarray]:
    """
    The frames over which the most tracks last, and these tracks.

    A track more is worth a window a sixteenth as long, up to `enough` tracks. The window has at
    least `least` steps.
    """
    count = len(steps)
    best: tuple[float, int, int] = (-np.inf, 0, count)
    length = count
    while length >= min(least, count):
        starts = np.unique(np.linspace(0, count - length, _STARTS).astype(np.int64))
        lasting = np.minimum(_lasting(tracks, starts[:, None], length).sum(axis=1), enough)
        k = int(lasting.argmax())
        score = lasting[k] + np.log2(length) / _WINDOW_BITS
        if score > best[0]:
            best = score, int(starts[k]), length
        length = length // 2 if length > 2 * least else (least if length > least else 0)
        if not length:
            break
    _, start, length = best
    return slice(start, start + length), _lasting(tracks, start, length).nonzero()[0]


def _lasting(tracks: Tracks, start: np.ndarray | int, length: int) -> np.ndarray:
    """Which tracks last from `start` on; they may begin a little late and end a little early."""
    slack = min(_MAX_GAP, length // 20)
    return np.asarray((tracks.first <= start + slack) & (tracks.last >= start + length - 1 - slack))
