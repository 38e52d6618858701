"""
Frames that repeat the one before, or are missing, in films of which a program changed the rate.

From 24 to 30 Hz each fourth picture is shown twice; a film of uneven stamps that is made even has
repeats where a stamp was late. All points then stay for a frame, and go on as before. Repeats tell
nothing and are left out. The stamps of the others are off by up to a frame; they are right again
if the camera took its pictures evenly, which the motion shows: stamps that are off move points
along their paths, and noise moves them across as well. From 30 to 24 Hz each fifth picture is
left out, and the stamps of the others are made even: the motion shows that alike.
"""

import shlex
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import chain
from typing import NamedTuple

import numpy as np

from kinpole_ros.bags._files import BagError
from kinpole_ros.bags._path_errors import (
    go_along_paths,
    largest_size,
    median_size,
    path_errors,
    rms_size,
    stamp_error,
)
from kinpole_ros.findings import ERROR, Finding
from kinpole_ros.tracking.frame import MarkerFrames

# Of the steps before and after: so little is noise, and no motion. Even pictures are found with
# the most noise, and pictures at uneven times, whose steps differ, with less.
_SMALLS = 0.3, 0.1, 0.03
_LARGE = 0.6  # of these: so much is motion
_STILL = 0.1  # of the fast steps of a film: where all are shorter, nothing moves
_MOST_BETWEEN = 0.2  # of the repeats: more steps of up to twice this are noise, of all sizes
FEWEST_REPEATS = 5  # repeats that say something of the stamps; fewer are left out
_AROUND = 7  # frames, of which the usual step is taken
_LONGEST = 5  # repeats in a row; what stays longer may stand still
_SAME_WAY = 0.5  # cosine between the steps before and after; a body that turns back has -1
_ROUNDED = 0.2  # of a step: larger steps between values are rounding, which looks like repeats
_COLUMNS = 20  # or points, that are looked at
_BLOCK = 1 << 18  # values in memory at a time
_MOST_PARTS = 12  # frames of a pattern, as 12 from 25 to 60 Hz
_NEAR_RATIO = 0.25  # of itself: so far is the share of repeats from a pattern, where some are slow
_OFF = 0.05  # of a step: stamps that are more off, along the path alone, are wrong
_ONE_FRAME = 1.3  # as the line through few of them is not the best one
_TRIED = 300  # repeats, or frames by which a pattern of missing ones is found: time only
_PART, _PARTS = 60, 5  # frames of a part, and parts, most of which have a pattern of missing ones
_CLEARLY = 0.5  # of how far stamps are off otherwise: so far at most by that pattern
_LEAST_FRAMES = 200  # by which the rate of a film without a pattern is known to 0.5%
_NTSC = 1.001


class Kept(NamedTuple):
    """Frames that repeat no other: which they are (T,), their stamps, ns, and what was found."""

    is_kept: np.ndarray
    stamps: np.ndarray
    finding: Finding | None


def leave_out_repeats(
    path: str,
    noun: str,
    stamps: np.ndarray,
    points: np.ndarray,
    rate: float | None = None,
    least_step: float = 0.0,
) -> Kept:
    """
    Leave out frames that repeat the one before, and estimate when the others were taken.

    Parameters
    ----------
    path : str
        The file.
    noun : str
        What it calls frames, for a line.
    stamps : ndarray
        (T,) int64, ns.
    points : ndarray
        (T, N, D), in any unit; NaN where not seen.
    rate : float, optional
        Frames per second that the camera took, Hz, if it is known: of those that repeat no other.
    least_step : float
        How far points move between frames, rms, where it is no noise.

    Returns
    -------
    Kept

    Raises
    ------
    BagError
        If it is not known when frames were taken.

    """
    kept = _kept(noun, stamps, points, rate, least_step)
    if kept.finding is not None and kept.finding.level == ERROR:
        raise BagError(f'{path}: {kept.finding.words()}')
    return kept


def _kept(
    noun: str, stamps: np.ndarray, points: np.ndarray, rate: float | None, least_step: float
) -> Kept:
    """Return the frames; where it is not known when they were taken, the finding is an ERROR."""
    everything = Kept(np.ones(len(stamps), bool), stamps, None)
    if len(stamps) < 2 * _LONGEST:
        return everything
    is_repeat, is_known = _find(points, least_step)
    if not is_repeat.any():
        return _without_lost(noun, everything, points, rate)
    interval = float(np.median(np.diff(stamps)))
    off, own, times, even = _likeliest(stamps, points, is_repeat, is_known, rate)
    about = {'count': len(stamps), 'noun': noun, 'after': 1e9 / interval}
    if off > _OFF and is_repeat.sum() >= FEWEST_REPEATS:
        about['repeats'] = int(own.sum())
        return everything._replace(finding=Finding('repeats_uneven', '', about, ERROR))
    if off > _OFF:
        own, times, even = is_repeat, (stamps - stamps[0])[~is_repeat], 0.0
    about |= {'repeats': int(own.sum()), 'before': even}
    code = ('repeats_rated' if rate else 'repeats_converted') if even else 'repeats'
    stamps = stamps[0] + np.rint(times).astype(np.int64)
    return Kept(~own, stamps, Finding(code, values=about))


def _likeliest(
    stamps: np.ndarray,
    points: np.ndarray,
    is_repeat: np.ndarray,
    is_known: np.ndarray,
    rate: float | None,
) -> tuple[float, np.ndarray, np.ndarray, float]:
    """Return the error of the likeliest hypothesis, its repeats (T,), its times and its rate."""
    interval = float(np.median(np.diff(stamps)))
    frames = np.rint((stamps - stamps[0]) / interval).astype(int)
    best: tuple[float, np.ndarray, np.ndarray, float] | None = None
    for own, times, even in _hypotheses(stamps, frames, is_repeat, is_known, interval, rate):
        # All repeats fit a pattern, which is evidence enough to allow for some shocks.
        scales = (rms_size, largest_size) if best or not even else (median_size,)
        off = stamp_error(
            points[~own], times, np.flatnonzero(np.diff(np.flatnonzero(~own)) > 1), scales
        )
        # A later hypothesis has more freedom, so it must be clearly better.
        if best is None or off < 0.8 * best[0]:
            best = off, own, times, even
    assert best is not None
    return best


def _without_lost(noun: str, everything: Kept, points: np.ndarray, rate: float | None) -> Kept:
    """Return frames at their times where a converter left others out; the same where none did."""
    stamps = everything.stamps
    interval = float(np.median(np.diff(stamps)))
    about = {'noun': noun, 'after': 1e9 / interval}
    frames = np.rint((stamps - stamps[0]) / interval).astype(int)
    if np.abs(stamps - stamps[0] - frames * interval).max() > _OFF * interval:
        return everything
    points = points[:, :: max(1, points.shape[1] // _COLUMNS)]
    found = _pattern_of_lost(frames[:_TRIED], points[:_TRIED])
    if found != _pattern_of_lost(frames[-_TRIED:], points[-_TRIED:]):
        found = None
    if found is None:
        # Each part has a pattern of its own, as from 29.97 to 25 Hz.
        width = min(_PART, len(points) // 2)
        starts = np.linspace(0, len(points) - width, _PARTS).astype(int).tolist()
        parts = [slice(start, start + width) for start in starts]
        patterns = [_pattern_of_lost(frames[part], points[part]) for part in parts]
        if patterns.count(None) > _PARTS // 2:
            return everything
        return everything._replace(finding=Finding('lost_uneven', '', about, ERROR))
    ratio, phase = found
    taken = (frames * ratio.numerator + phase) // ratio.denominator
    length = 1e9 / rate if rate else interval / float(ratio)
    times = stamps[0] + np.rint((taken - taken[0]) * length).astype(np.int64)
    made = Finding('lost_converted', values={**about, 'before': 1e9 / length})
    return everything._replace(stamps=times, finding=made)


def _pattern_of_lost(frames: np.ndarray, points: np.ndarray) -> tuple[Fraction, int] | None:
    """
    Return pictures per frame, more than 1, and the phase, by which the motion is even.

    None if frames are even as they are, or no pattern is far better than all others.
    """
    middle = np.arange(2, len(points) - 2)
    before = stamp_error(points, frames.astype(float), middle, (rms_size,))
    if before < _OFF:
        return None
    tried = []
    ratios = {Fraction(p, q) for p in range(3, _MOST_PARTS + 1) for q in range(2, p)}
    for ratio in {one for one in ratios if one.denominator > 1}:
        for phase in range(ratio.denominator):
            numbers = (frames * ratio.numerator + phase) // ratio.denominator
            along, _, step = path_errors(points, numbers.astype(float), middle)
            tried.append((rms_size(along) / step, ratio, phase))
    tried.sort()
    off, ratio, phase = tried[0]
    return (ratio, phase) if off < _CLEARLY * min(before, tried[1][0]) else None


def conversion_fault(path: str, parts: Sequence[MarkerFrames]) -> Finding | None:
    """Return what is wrong with stamps of frames that repeat others, if anything."""
    names = list(dict.fromkeys(chain.from_iterable(part.identities for part in parts)))
    stamps = np.concatenate([part.stamps for part in parts])
    kinds = 1 if parts[0].axes is None else 3  # places, and axes of poses
    points = np.full((len(stamps), len(names), kinds, 3), np.nan)
    first = 0
    for part in parts:
        columns = [names.index(name) for name in part.identities]
        block = points[first : first + len(part.stamps)]
        block[:, columns, :1] = part.points[:, :, None]
        if part.axes is not None:
            block[:, columns, 1:] = part.axes
        first += len(part.stamps)
    is_later = np.diff(np.maximum.accumulate(stamps), prepend=-1) > 0
    stamps, points = stamps[is_later], points[is_later].reshape(is_later.sum(), -1, 3)
    kept = _kept('frames', stamps, points, None, 0.0)
    if kept.finding is None or kept.finding.level == ERROR:
        return kept.finding
    off = np.abs(kept.stamps - stamps[kept.is_kept]).max()
    if off < _OFF * np.median(np.diff(stamps)):
        return None
    import_line = f'kinpole import {shlex.quote(path)} --output NEW.mcap'
    return kept.finding._replace(fix=f'replay what `{import_line}` writes, with stamps that fit')


def _find(points: np.ndarray, least_step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which frames (T,) repeat the one before, and of which it is known."""
    is_repeat = np.zeros(len(points), bool)
    sizes = _step_sizes(points)
    windows = np.pad(np.nan_to_num(sizes), _AROUND, mode='edge')
    windows = np.lib.stride_tricks.sliding_window_view(windows, 2 * _AROUND + 1)
    # The largest step may be twice as long, over a lost frame.
    usual = np.partition(windows, -2, axis=1)[:, -2]
    usual = np.maximum(usual, _STILL * np.quantile(np.nan_to_num(sizes), 0.9))
    with np.errstate(invalid='ignore'):
        is_distinct = np.append(False, sizes >= _LARGE * usual)
        runs = list(_runs(sizes < _SMALLS[0] * usual))
        is_dip = sizes[1:-1] < _LARGE * np.minimum(sizes[:-2], sizes[2:])
    found = []
    for first, last in {*runs, *((k, k + 1) for k in (1 + np.flatnonzero(is_dip)).tolist())}:
        before, after = sizes[first - 1], sizes[last]
        ratio = sizes[first:last].max() / max(min(before, after), least_step, 1e-300)
        if last - first > _LONGEST or not ratio < _LARGE:
            continue
        if _cosine(points[first] - points[first - 1], points[last + 1] - points[last]) < _SAME_WAY:
            continue
        found.append((ratio, first, last))
    ratios = np.array([ratio for ratio, _, _ in found])
    for small in _SMALLS:
        between = ((ratios >= small) & (ratios < 2 * small)).sum()
        count = (ratios < small).sum()
        if between <= _MOST_BETWEEN * count and (count >= FEWEST_REPEATS or small == _SMALLS[0]):
            break
    else:
        return is_repeat, is_repeat
    repeats = [(first, last) for ratio, first, last in found if ratio < small]
    if go_along_paths(points, repeats[:_TRIED]):
        return is_repeat, is_repeat
    for first, last in repeats:
        is_repeat[first + 1 : last + 1] = True
    if not is_repeat.any() or _is_rounded(points):
        return np.zeros(len(points), bool), is_repeat
    # The first and the last frames may repeat others, too.
    is_repeat[1 : 1 + _edge(sizes, small)] = True
    is_repeat[len(points) - _edge(sizes[::-1], small) :] = True
    return is_repeat, is_repeat | is_distinct


def _edge(sizes: np.ndarray, small: float) -> int:
    """Return how many of the first steps are small beside the one that follows."""
    for count in range(1, min(_LONGEST + 1, len(sizes))):
        if sizes[:count].max() < small * sizes[count]:
            return count
    return 0


def _step_sizes(points: np.ndarray) -> np.ndarray:
    """Return how far points move to the next frame (T - 1,), rms; NaN where none is seen twice."""
    rows = max(1, _BLOCK // max(1, points[0].size))
    sizes = np.full(len(points) - 1, np.nan)
    for start in range(0, len(sizes), rows):
        steps = np.diff(points[start : start + rows + 1], axis=0).reshape(-1, points[0].size)
        count = np.isfinite(steps).sum(axis=1)
        total = np.nansum(steps**2, axis=1)
        sizes[start : start + rows] = np.sqrt(total / np.where(count, count, np.nan))
    return sizes


def _cosine(before: np.ndarray, after: np.ndarray) -> float:
    before, after = np.nan_to_num(before).ravel(), np.nan_to_num(after).ravel()
    lengths = np.linalg.norm(before) * np.linalg.norm(after)
    return float(before @ after / lengths) if lengths else 0.0


def _runs(is_small: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield the first and the end of each run of small steps between others."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_small, [False])).astype(int)))
    for first, last in edges.reshape(-1, 2).tolist():
        if first > 0 and last < len(is_small):
            yield first, last


def _is_rounded(points: np.ndarray) -> bool:
    """Return whether values are rounded to a good part of the usual step."""
    columns = points.reshape(len(points), -1)
    grains = []
    for column in columns.T[:: max(1, columns.shape[1] // _COLUMNS)]:
        values = np.unique(column[np.isfinite(column)])
        moved = np.abs(np.diff(column))
        moved = moved[moved > 0]
        if len(values) > 1 and len(moved):
            grains.append(float(np.diff(values).min() / np.median(moved)))
    return bool(grains) and float(np.median(grains)) > _ROUNDED


def _hypotheses(
    stamps: np.ndarray,
    frames: np.ndarray,
    is_repeat: np.ndarray,
    is_known: np.ndarray,
    interval: float,
    rate: float | None,
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """
    Yield which frames (T,) repeat, when the n others were taken (n,), ns, and their rate, Hz.

    The rate is 0 where the stamps are right: a program showed the last picture for one that was
    lost.
    """
    # The first and the last frames may stand still.
    inner = is_known.copy()
    inner[: _LONGEST + 1] = inner[-_LONGEST - 1 :] = False
    pattern = _pattern(frames, is_repeat, is_known) or _pattern(frames, is_repeat, inner)
    if pattern:
        taken, per_picture = pattern
        own = np.diff(taken, prepend=-1) == 0
        length = 1e9 / rate if rate else per_picture * interval
        yield own, (taken[~own] - taken[0]) * length, 1e9 / length
    yield is_repeat, (stamps - stamps[0])[~is_repeat].astype(float), 0.0
    # Even pictures of any rate are shown within a frame of their time.
    shown = (stamps - stamps[0])[~is_repeat].astype(float)
    number = np.arange(len(shown))
    length = float(np.polyfit(number, shown, 1)[0])
    is_even = np.ptp(shown - length * number) < _ONE_FRAME * interval
    if rate is not None or (is_even and len(stamps) > _LEAST_FRAMES):
        length = 1e9 / rate if rate else length
        yield is_repeat, number * length, 1e9 / length


def _pattern(
    frames: np.ndarray, is_repeat: np.ndarray, is_known: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """
    Return the number of the picture that each frame (T,) shows, and frames per picture.

    They are those of a converter between two even rates: the last picture that was there. None if
    no such pattern has these repeats.
    """
    distinct = 1 - is_repeat[is_known].sum() / max(is_known.sum(), 1)
    ratios = {
        Fraction(p, q) for p in range(2, _MOST_PARTS + 1) for q in range(-(-p // _LONGEST), p)
    }
    near = [ratio for ratio in ratios if abs(distinct * ratio - 1) < _NEAR_RATIO]
    for ratio in sorted(near, key=lambda one: (one.numerator, abs(distinct * one - 1))):
        for factor in (1.0, _NTSC, 1 / _NTSC):
            length = float(ratio) * factor
            phase = _phase(frames[is_known] / length, is_repeat[is_known], 1 / length)
            if phase is not None:
                return np.floor(frames / length + phase).astype(int), length
    return None


def _phase(places: np.ndarray, is_repeat: np.ndarray, step: float) -> float | None:
    """
    Return the phase at which places (n,) repeat as they do; None if there is none.

    A place does not repeat the one before if its fraction is less than `step`, which leaves an arc
    of the circle of phases for each place.
    """
    first = (np.where(is_repeat, step, 0.0) - places) % 1
    last = (np.where(is_repeat, 1.0, step) - places) % 1
    edges = np.concatenate((first, last))
    order = np.argsort(edges, kind='stable')
    change = np.repeat((1, -1), len(places))[order]
    count = np.cumsum(change) + (first > last).sum()
    widths = np.diff(edges[order], append=edges[order[0]] + 1)
    widths[count < len(places)] = 0
    widest = int(widths.argmax())
    return float(edges[order[widest]] + widths[widest] / 2) if widths[widest] > 1e-9 else None
