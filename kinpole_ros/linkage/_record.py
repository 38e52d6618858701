"""
A recording of markers as one array, with names that are identities, and how even its stamps are.

Drivers name markers reliably, unreliably or not at all. Names that do not follow the markers are
dropped; names that two markers exchange from a frame on are corrected.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage.limits import RECORDING_FRAMES
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.thresholds import N_SIGMA

# Some drivers count names anew in every frame: more names than this many times the markers of a
# frame, plus 3, are no identities.
_MAX_NAME_RATIO = 3
# Share of the sampled frames in which a marker must be the nearest to its own prediction.
_MIN_OWN_SHARE = 0.9
_SAMPLED_FRAMES = 1500
# Share of an interval. Where stamps are less even than this, lost frames are not counted.
_MAX_UNEVEN = 0.2
# A stamp that steps back this far, ns, begins another recording, as in a bag that is looped.
_JUMP_NS = 10**9
# Two names are exchanged if their points are this many times nearer to the other one's prediction.
_EXCHANGE_RATIO = 10.0
# Frames that are examined at once, and frames before them from which markers are predicted.
_BLOCK, _HISTORY = 250, 250
# Fewer frames do not show how well two markers keep their distance.
_MIN_DISTANCES = 10
# Markers are of one body if their distance varies by up to this many times the least of a marker.
_MATE_RATIO = 2.5
# Share of a distance that is rounding.
_ROUNDING = 1e-9


class UndiscoveredError(ValueError):
    """Why no linkage can be found in a recording; the message ends with the fix."""


class MarkerRecord(NamedTuple):
    """
    Markers of T frames.

    `stamps` (T,) are in ns, `points` (T, n, 3) in units of the source, NaN for none. `names` are
    those of the n columns, () for points in no order; `unreliable_names` are those that were
    dropped since they change from frame to frame. `exchanged` are exchanges of two names, already
    corrected: the frame and both names.
    """

    stamps: np.ndarray
    points: np.ndarray
    names: tuple[str, ...]
    frame_id: str
    exchanged: tuple[tuple[int, str, str], ...] = ()
    unreliable_names: tuple[str, ...] = ()

    def steps(self) -> np.ndarray:
        """Number of each frame (T,), in intervals: frames that were lost are counted."""
        gaps = np.diff(self.stamps) / self.interval
        steps = np.ones(len(gaps)) if self.is_uneven else np.maximum(1, np.rint(gaps))
        return np.concatenate(([0], np.cumsum(steps))).astype(np.int64)

    @property
    def is_uneven(self) -> bool:
        """Whether stamps are too uneven to count lost frames."""
        gaps = np.diff(self.stamps) / self.interval
        return float(np.quantile(np.abs(gaps - np.rint(gaps)), 0.9)) > _MAX_UNEVEN

    @property
    def interval(self) -> float:
        """Median time between frames, ns."""
        steps = np.diff(self.stamps)
        return float(np.median(steps)) or float(np.mean(steps))

    @property
    def seconds(self) -> np.ndarray:
        """Times (T,) from the first frame on, s."""
        return (self.stamps - self.stamps[0]) * 1e-9


class Stamps(NamedTuple):
    """Interval and rms jitter, s; numbers of lost frames and of frames dropped as repeated."""

    interval: float
    jitter: float
    lost: int
    dropped: int


def gather(blocks: Sequence[MarkerFrames]) -> tuple[MarkerRecord, Stamps]:
    """
    Concatenate blocks of frames, in the order they came, up to the first stamp that jumps back.

    Repeated frames are dropped. Raises UndiscoveredError where there are too few frames or markers.
    """
    blocks = [block for block in blocks if len(block.stamps)]
    count = sum(len(block.stamps) for block in blocks)
    if count < RECORDING_FRAMES:
        raise UndiscoveredError(
            f'{count} frames of markers are too few to find anything; fix: record 10 s or more'
        )
    stamps, points, names = _concatenated_frames(blocks)
    jumps = np.flatnonzero(np.diff(stamps) < -_JUMP_NS)
    end = int(jumps[0]) + 1 if len(jumps) else count
    is_repeated = (np.diff(stamps[:end]) == 0) & np.all(
        (points[1:end] == points[: end - 1]) | np.isnan(points[1:end]), axis=(1, 2)
    )
    rows = np.concatenate(([True], ~is_repeated)).nonzero()[0]
    record = MarkerRecord(stamps[rows], points[rows], names, blocks[0].frame_id)
    if len(rows) < RECORDING_FRAMES or record.interval <= 0:
        raise UndiscoveredError(
            f'{count} frames have {len(np.unique(stamps))} different stamps; fix: have the driver '
            'stamp each'
        )
    most_markers = int(np.isfinite(record.points[..., 0]).sum(axis=1).max())
    if most_markers < 2:
        what = 'one marker' if most_markers else 'no marker'
        raise UndiscoveredError(
            f'there is {what} in any frame; fix: put two or more markers on each body'
        )
    if names and not _names_follow_markers(record):
        record = record._replace(names=(), unreliable_names=names)
    if record.names:
        points, exchanges = _correct_exchanges(record.points, record.steps())
        named = tuple((frame, names[i], names[j]) for frame, i, j in exchanges)
        record = record._replace(points=points, exchanged=named)
    return record, _stamps(record, count)


def _concatenated_frames(
    blocks: Sequence[MarkerFrames],
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Stamps (T,) and points (T, n, 3) of all frames, and names of the columns, () for none."""
    markers = [block.points.shape[1] for block in blocks]
    usual = np.median(np.repeat(markers, [len(block.stamps) for block in blocks]))
    names = tuple(dict.fromkeys(name for block in blocks for name in block.identities))
    if len(names) > _MAX_NAME_RATIO * max(usual, 1) + 3:
        names = ()
    column = {name: k for k, name in enumerate(names)}
    stamps = np.concatenate([block.stamps for block in blocks])
    points = np.full((len(stamps), len(names) or max(markers), 3), np.nan)
    first = 0
    for block, count in zip(blocks, markers, strict=True):
        rows = slice(first, first + len(block.stamps))
        columns = [column[name] for name in block.identities] if names else slice(count)
        points[rows, columns] = block.points
        first = rows.stop
    points[~np.isfinite(points).all(axis=-1)] = np.nan
    return stamps, points, names


def _names_follow_markers(record: MarkerRecord) -> bool:
    """Whether a marker is mostly nearer to its own prediction than any other marker is."""
    points = record.points
    starts = np.arange(len(points) - 2)
    starts = starts[:: max(1, len(starts) // _SAMPLED_FRAMES)]
    predicted = 2 * points[starts + 1] - points[starts]
    measured = points[starts + 2]
    seen = np.isfinite(predicted[..., 0]) & np.isfinite(measured[..., 0])
    is_own = np.ones(seen.shape, bool)
    for k, (before, after) in enumerate(zip(predicted, measured, strict=True)):
        to_own = np.linalg.norm(before - after, axis=-1)
        i, j = near_pairs(before, after, to_own)
        to_other = np.linalg.norm(before[i] - after[j], axis=-1)
        # Of two that are equally near, the one of the lower number.
        is_nearer = (to_other < to_own[i]) | ((to_other == to_own[i]) & (j < i))
        is_own[k, i[is_nearer]] = False
    return bool(not seen.any() or is_own[seen].mean() >= _MIN_OWN_SHARE)


def _stamps(record: MarkerRecord, count: int) -> Stamps:
    steps, seconds = record.steps(), record.seconds
    dropped = count - len(steps)
    if record.is_uneven:
        # An interval has the errors of two stamps. The median ignores gaps of lost frames.
        off = np.abs(np.diff(record.stamps) - record.interval)
        jitter = 1.4826 * float(np.median(off)) / 2**0.5
        return Stamps(record.interval * 1e-9, jitter * 1e-9, 0, dropped)
    line = np.polyfit(steps, seconds, 1)
    jitter = float(np.sqrt(np.mean((seconds - np.polyval(line, steps)) ** 2)))
    return Stamps(float(line[0]), jitter, int(steps[-1] + 1 - len(steps)), dropped)


def near_pairs(
    points: np.ndarray, candidates: np.ndarray, radius: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    List pairs of points whose first coordinates differ by no more than the `radius` (n,).

    `points` (n, d) and `candidates` (m, d) that are NaN are in no pair. Returns the numbers of the
    points and of their candidates. The time grows with the number of pairs, not with n m.
    """
    order = np.argsort(candidates[:, 0], kind='stable')
    order = order[: np.count_nonzero(~np.isnan(candidates[:, 0]))]
    ordered = candidates[order, 0]
    # A candidate exactly at the radius must not be lost to rounding.
    radius = radius * (1 + 1e-9)
    valid = np.isfinite(points[:, 0]) & np.isfinite(radius)
    at, radius = np.where(valid, points[:, 0], 0.0), np.where(valid, radius, 0.0)
    first = np.searchsorted(ordered, at - radius, side='left')
    counts = np.where(valid, np.searchsorted(ordered, at + radius, side='right') - first, 0)
    rows = np.repeat(np.arange(len(points)), counts)
    within = np.arange(len(rows)) - np.repeat(np.cumsum(counts) - counts, counts)
    return rows, order[first[rows] + within]


def _correct_exchanges(
    points: np.ndarray, steps: np.ndarray
) -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    """
    Undo exchanges of two names in `points` (T, n, 3) of frames numbered by `steps` (T,).

    Also returns the frame and both columns of each exchange. Two markers that pass each other keep
    their names. After a marker was hidden its prediction may pass another one by chance, so an
    exchange must also keep the distances within the bodies.
    """
    corrected, exchanges, first = points.copy(), [], 0
    while first < len(points):
        start = max(first - _HISTORY, 0)
        rows = slice(start, first + _BLOCK)
        exchange = _first_exchange(corrected[rows], steps[rows], first - start)
        if exchange is None:
            first += _BLOCK
            continue
        first, columns = first + exchange[0], list(exchange[1:])
        corrected[first:, columns] = corrected[first:, columns[::-1]]
        exchanges.append((first, columns[0], columns[1]))
    return corrected, exchanges


def _first_exchange(
    points: np.ndarray, steps: np.ndarray, begin: int
) -> tuple[int, int, int] | None:
    """How many frames after `begin` two names are exchanged first, and their columns."""
    predicted = _predicted(points, steps)[begin:]
    for frame, (measured, ahead) in enumerate(zip(points[begin:], predicted, strict=True)):
        to_own = np.linalg.norm(measured - ahead, axis=-1)
        i, j = near_pairs(measured, ahead, to_own / _EXCHANGE_RATIO)
        is_near = _EXCHANGE_RATIO * np.linalg.norm(measured[i] - ahead[j], axis=-1) < to_own[i]
        pairs = set(zip(i[is_near].tolist(), j[is_near].tolist(), strict=True))
        for a, b in sorted(pairs):
            # A marker that is not seen in this frame may be anywhere.
            if (b, a) not in pairs and not np.isnan(measured[b, 0]):
                continue
            columns = [min(a, b), max(a, b)]
            if _keeps_distances_better(points[: begin + frame], measured, columns):
                return frame, columns[0], columns[1]
    return None


def _keeps_distances_better(before: np.ndarray, now: np.ndarray, columns: list[int]) -> bool:
    """
    Whether the points `now` (n, 3) keep distances better with the names of two columns exchanged.

    Distances are to the markers that each of the two kept its distance to best in the frames
    `before` (F, n, 3). A body of just these two markers has no other: then the motion decides.
    """
    exchanged = now.copy()
    exchanged[columns] = now[columns[::-1]]
    excess = 0.0
    for own, partner in (columns, columns[::-1]):
        distances = np.linalg.norm(before - before[:, own, None], axis=-1)
        # Medians, so that a few frames with wrong names do not count.
        is_rare = np.isfinite(distances).sum(axis=0) < _MIN_DISTANCES
        distances[:, is_rare] = 0.0
        mean = np.nanmedian(distances, axis=0)
        spread = 1.4826 * np.nanmedian(np.abs(distances - mean), axis=0)
        spread[is_rare | (np.arange(len(now)) == own)] = np.inf
        to_partner, spread[partner] = spread[partner], np.inf
        least = float(spread.min())
        if _MATE_RATIO * to_partner < least and np.isfinite(now[columns, 0]).all():
            return True
        mates = spread < _MATE_RATIO * least
        for points, sign in ((now, 1.0), (exchanged, -1.0)):
            off = np.linalg.norm(points[mates] - points[own], axis=-1) - mean[mates]
            floor = _ROUNDING * np.maximum(mean[mates], 1e-300)
            deviations = off / np.maximum(spread[mates], floor)
            excess += sign * float(np.sum(deviations[np.isfinite(off)] ** 2))
    return excess > N_SIGMA**2


def _predicted(points: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Extrapolate each marker (T, n, 3) from the last two frames before in which it was seen."""
    seen = np.isfinite(points[..., 0])
    # The last frames before each in which a marker was seen, -1 for none.
    last = np.maximum.accumulate(np.where(seen, np.arange(len(points))[:, None], -1), axis=0)
    last = np.vstack((np.full((1, seen.shape[1]), -1), last[:-1]))
    before = np.where(last > 0, np.take_along_axis(last, np.maximum(last, 0), axis=0), -1)
    newer, older = (
        np.take_along_axis(points, np.maximum(k, 0)[..., None], axis=0) for k in (last, before)
    )
    interval = steps[np.maximum(last, 0)] - steps[np.maximum(before, 0)]
    gap = steps[:, None] - steps[np.maximum(last, 0)]
    speed = (newer - older) / np.maximum(interval, 1)[..., None]
    return np.where((before >= 0)[..., None], newer + gap[..., None] * speed, np.nan)
