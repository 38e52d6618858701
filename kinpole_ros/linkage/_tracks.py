"""
Points in no order as tracks: each point is linked to the one that the last two places lead to.

A track ends where two ways of going on are about as likely: what is found later of bodies tells
which it was. So a track is of one marker, but a marker may have many tracks.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

# A point is of a track if it is no farther from where it should be than so many times the track's
# usual error, and in doubt if another is nearer than so many times.
_GATE = 8.0
_DOUBT = 2.5
# Frames over which a track goes on unseen.
_LONGEST_GAP = 10
# Points after which a track is one that others may be mistaken for.
_YOUNG = 3


class Tracks(NamedTuple):
    """
    K tracks: `number` (T, n) says of which track a point is, -1 for none; `first` and `last` (K,)
    are the frames that each begins and ends with.
    """

    number: np.ndarray
    first: np.ndarray
    last: np.ndarray

    def dense(self, points: np.ndarray, chosen: np.ndarray, frames: slice) -> np.ndarray:
        """Points (F, len(chosen), 3) of some tracks, NaN where they have none."""
        number = self.number[frames]
        column = np.full(len(self.first) + 1, -1)
        column[chosen] = np.arange(len(chosen))
        column = column[number]
        rows, places = np.nonzero(column >= 0)
        dense = np.full((len(number), len(chosen), points.shape[-1]), np.nan, points.dtype)
        dense[rows, column[rows, places]] = points[frames][rows, places]
        return dense


class _Live:
    """The tracks that go on: where each was last, how it moves, and how well it is predicted."""

    def __init__(self) -> None:
        self.number = np.zeros(0, np.int64)
        self.place = np.zeros((0, 3))
        self.speed = np.zeros((0, 3))
        self.error = np.zeros(0)
        self.step = np.zeros(0, np.int64)
        self.age = np.zeros(0, np.int64)

    def keep(self, which: np.ndarray) -> None:
        for name in ('number', 'place', 'speed', 'error', 'step', 'age'):
            setattr(self, name, getattr(self, name)[which])

    def begin(self, numbers: np.ndarray, places: np.ndarray, error: np.ndarray, step: int) -> None:
        count = len(numbers)
        self.number = np.concatenate((self.number, numbers))
        self.place = np.concatenate((self.place, places))
        self.speed = np.concatenate((self.speed, np.zeros((count, 3))))
        self.error = np.concatenate((self.error, error))
        self.step = np.concatenate((self.step, np.full(count, step)))
        self.age = np.concatenate((self.age, np.zeros(count, np.int64)))


def link(
    points: np.ndarray, steps: np.ndarray, progress: Callable[[float], None] | None = None
) -> Tracks:
    """
    Tracks of points (T, n, 3) in no order, NaN for none; `steps` (T,) number the frames.

    Mutual nearest neighbors of what is predicted by constant velocity. Sequential by nature.
    """
    seen = np.isfinite(points[..., 0])
    number = np.full(seen.shape, -1, np.int64)
    live = _Live()
    total = 0
    for k, step in enumerate(steps.tolist()):
        if progress is not None and k % 500 == 0:
            progress(k / len(steps))
        columns = seen[k].nonzero()[0]
        found = points[k, columns]
        taken = np.full(len(columns), -1, np.int64)
        if len(live.number) and len(found):
            taken = _go_on(live, found, step)
        # A point that comes once is soon forgotten.
        unseen = step - live.step
        live.keep(unseen < np.where(live.age < _YOUNG, 3, _LONGEST_GAP))
        new = (taken < 0).nonzero()[0]
        if len(new):
            taken[new] = np.arange(total, total + len(new))
            live.begin(taken[new], found[new], _spacing(found)[new] / (2 * _GATE), step)
            total += len(new)
        number[k, columns] = taken
    rows, places = (number >= 0).nonzero()
    which = number[rows, places]
    first = np.full(total, len(steps))
    last = np.zeros(total, np.int64)
    np.minimum.at(first, which, rows)
    np.maximum.at(last, which, rows)
    return Tracks(number, first, last)


def _go_on(live: _Live, found: np.ndarray, step: int) -> np.ndarray:
    """The track (m,) of each point found, -1 for none; ends the tracks that are in doubt."""
    gap = step - live.step
    ahead = live.place + live.speed * gap[:, None]
    off = np.sqrt(((ahead[:, None] - found) ** 2).sum(axis=-1))
    error = live.error * gap**1.5
    nearest = off.argmin(axis=1)
    rows = np.arange(len(off))
    best = off[rows, nearest]
    good = (off.argmin(axis=0)[nearest] == rows) & (best < _GATE * error)
    near = (off < _DOUBT * error[:, None]) & (live.age >= _YOUNG)[:, None]
    doubt = near & ((near.sum(axis=1) > 1)[:, None] | (near.sum(axis=0) > 1))
    ended = doubt.any(axis=1)
    good &= ~ended
    taken = np.full(len(found), -1, np.int64)
    rows, nearest = rows[good], nearest[good]
    taken[nearest] = live.number[rows]
    steps = gap[rows]
    live.speed[rows] = (found[nearest] - live.place[rows]) / steps[:, None]
    live.place[rows] = found[nearest]
    # Young tracks learn fast; the first step has no speed to go by.
    rate = np.where(live.age[rows] < 6, 0.5, 0.1)
    error = best[rows] / steps**1.5
    usual = np.median(live.error)
    live.error[rows] += np.where(live.age[rows] > 0, rate * (error - live.error[rows]), 0)
    live.error[rows] = np.maximum(live.error[rows], 0.3 * usual)
    live.step[rows] = step
    live.age[rows] += 1
    live.keep(~ended)
    return taken


def _spacing(found: np.ndarray) -> np.ndarray:
    """Distance (m,) of each point to its nearest neighbor."""
    if len(found) == 1:
        return np.ones(1)
    distances = np.sqrt(((found[:, None] - found) ** 2).sum(axis=-1))
    np.fill_diagonal(distances, np.inf)
    return np.asarray(distances.min(axis=1))


def best_window(
    tracks: Tracks, wanted: int, steps: np.ndarray, least: int
) -> tuple[slice, np.ndarray]:
    """
    The frames over which the most tracks last, and these tracks.

    A marker more is worth a window a sixteenth as long; `wanted` are enough; a window is of `least`
    steps or more.
    """
    count = len(steps)
    best: tuple[float, int, int] = (-np.inf, 0, count)
    length = count
    while length >= min(least, count):
        starts = np.unique(np.linspace(0, count - length, 400).astype(np.int64))
        # Unseen at the ends, it may begin late and end early.
        slack = min(_LONGEST_GAP, length // 20)
        covers = (tracks.first <= starts[:, None] + slack) & (
            tracks.last >= starts[:, None] + length - 1 - slack
        )
        held = np.minimum(covers.sum(axis=1), wanted)
        k = int(held.argmax())
        score = held[k] + 0.25 * np.log2(length)
        if score > best[0]:
            best = score, int(starts[k]), int(starts[k]) + length
        length = length // 2 if length > 2 * least else (least if length > least else 0)
        if not length:
            break
    frames = slice(best[1], best[2])
    slack = min(_LONGEST_GAP, (best[2] - best[1]) // 20)
    lasting = (tracks.first <= best[1] + slack) & (tracks.last >= best[2] - 1 - slack)
    return frames, lasting.nonzero()[0]
