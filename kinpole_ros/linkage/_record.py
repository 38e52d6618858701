"""
Frames of markers, whatever their layouts, as one array; and what their stamps are like.

Drivers name markers well, badly or not at all: here it is found out whether a name is an identity.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._exchanges import correct_exchanges
from kinpole_ros.linkage._near import near_pairs
from kinpole_ros.tracking.frame import MarkerFrames

# Names are counted anew in every frame by some drivers: more names than this many times the markers
# of a frame are none.
_MOST_NAMES = 3
# Share of the steps at which a marker must be nearest to where its own last two places lead.
_HELD = 0.9
# Frames that are looked at for it.
_SAMPLE = 1500
# Intervals that stamps may be uneven by for lost frames to be counted.
_UNEVEN = 0.2
# ns. A stamp that steps back so far begins another recording, as where a bag is looped.
_JUMP = 10**9


class UndiscoveredError(ValueError):
    """What keeps a linkage from being found in a record; the message ends with the fix."""


class Record(NamedTuple):
    """
    Markers of T frames: `stamps` (T,) ns, `points` (T, n, 3), NaN for none, in units of the source.

    `names` are the n columns' names, () where the columns mean nothing: points in no order.
    """

    stamps: np.ndarray
    points: np.ndarray
    names: tuple[str, ...]
    frame_id: str
    # From which frames on which two names were exchanged; here they are not.
    exchanged: tuple[tuple[int, str, str], ...] = ()
    # The columns' names where they seem to change from frame to frame.
    doubted: tuple[str, ...] = ()

    def steps(self) -> np.ndarray:
        """Number of each frame (T,), counted in intervals: one that was lost is counted too."""
        gaps = np.diff(self.stamps) / self.interval
        whole = np.ones(len(gaps)) if self.uneven else np.maximum(1, np.rint(gaps))
        return np.concatenate(([0], np.cumsum(whole))).astype(np.int64)

    @property
    def uneven(self) -> bool:
        """Whether stamps are so uneven that nobody can tell which frames were lost."""
        gaps = np.diff(self.stamps) / self.interval
        return float(np.quantile(np.abs(gaps - np.rint(gaps)), 0.9)) > _UNEVEN

    @property
    def interval(self) -> float:
        """Usual time between frames, ns."""
        steps = np.diff(self.stamps)
        return float(np.median(steps)) or float(np.mean(steps))

    @property
    def seconds(self) -> np.ndarray:
        """Times (T,) from the first frame on, s."""
        return (self.stamps - self.stamps[0]) * 1e-9


class Stamps(NamedTuple):
    """Interval and rms jitter, s; frames lost, and frames left out for a repeated stamp."""

    interval: float
    jitter: float
    lost: int
    dropped: int


def gather(parts: Sequence[MarkerFrames]) -> tuple[Record, Stamps]:
    """
    All frames as a record, in the order they came, as long as stamps do not jump back.

    Frames that are repeated, stamp and all, are left out.

    Raises UndiscoveredError where there is too little to look at.
    """
    parts = [part for part in parts if len(part.stamps)]
    count = sum(len(part.stamps) for part in parts)
    if count < 20:
        raise UndiscoveredError(
            f'{count} frames of markers are too few to find anything; fix: record 10 s or more'
        )
    usual = np.median(np.repeat([p.points.shape[1] for p in parts], [len(p.stamps) for p in parts]))
    names = tuple(dict.fromkeys(name for part in parts for name in part.identities))
    if len(names) > _MOST_NAMES * max(usual, 1) + 3:
        names = ()
    place = {name: k for k, name in enumerate(names)}
    width = len(names) or max(part.points.shape[1] for part in parts)
    points = np.full((count, width, 3), np.nan)
    stamps = np.concatenate([part.stamps for part in parts])
    first = 0
    for part in parts:
        rows = slice(first, first + len(part.stamps))
        columns = [place[name] for name in part.identities] if names else slice(len(part.points[0]))
        points[rows, columns] = part.points
        first = rows.stop
    points[~np.isfinite(points).all(axis=-1)] = np.nan
    back = np.flatnonzero(np.diff(stamps) < -_JUMP)
    end = int(back[0]) + 1 if len(back) else count
    same = (np.diff(stamps[:end]) == 0) & np.all(
        (points[1:end] == points[: end - 1]) | np.isnan(points[1:end]), axis=(1, 2)
    )
    order = np.concatenate(([True], ~same)).nonzero()[0]
    record = Record(stamps[order], points[order], names, parts[0].frame_id)
    if len(order) < 20 or record.interval <= 0:
        raise UndiscoveredError(
            f'{count} frames have {len(np.unique(stamps))} different stamps; fix: have the driver '
            'stamp each'
        )
    _check_seen(record)
    if names and not _names_hold(record):
        record = record._replace(names=(), doubted=names)
    if record.names:
        points, found = correct_exchanges(record.points, record.steps())
        named = tuple((frame, names[one], names[other]) for frame, one, other in found)
        record = record._replace(points=points, exchanged=named)
    return record, _stamps(record, count)


def _check_seen(record: Record) -> None:
    most = int(np.isfinite(record.points[..., 0]).sum(axis=1).max())
    if most < 2:
        what = 'one marker' if most else 'no marker'
        raise UndiscoveredError(
            f'there is {what} in any frame; fix: put two or more markers on each body'
        )


def _names_hold(record: Record) -> bool:
    """Whether a marker goes on where its own last two places lead, rather than any other's."""
    points = record.points
    starts = np.arange(len(points) - 2)
    starts = starts[:: max(1, len(starts) // _SAMPLE)]
    ahead = 2 * points[starts + 1] - points[starts]  # (S, n, 3)
    own = points[starts + 2]
    seen = np.isfinite(ahead[..., 0]) & np.isfinite(own[..., 0])
    is_own = np.ones(seen.shape, bool)
    for k, (leads, found) in enumerate(zip(ahead, own, strict=True)):
        off = np.linalg.norm(leads - found, axis=-1)
        one, other = near_pairs(leads, found, off)
        to_other = np.linalg.norm(leads[one] - found[other], axis=-1)
        # The first of two that are as near.
        nearer = (to_other < off[one]) | ((to_other == off[one]) & (other < one))
        is_own[k, one[nearer]] = False
    held = is_own[seen]
    return bool(len(held) == 0 or held.mean() >= _HELD)


def _stamps(record: Record, count: int) -> Stamps:
    steps, seconds = record.steps(), record.seconds
    dropped = count - len(steps)
    if record.uneven:
        # Two stamps make a step; the median leaves out those over lost frames.
        off = np.abs(np.diff(record.stamps) - record.interval)
        jitter = 1.4826 * float(np.median(off)) / 2**0.5
        return Stamps(record.interval * 1e-9, jitter * 1e-9, 0, dropped)
    line = np.polyfit(steps, seconds, 1)
    jitter = float(np.sqrt(np.mean((seconds - np.polyval(line, steps)) ** 2)))
    return Stamps(float(line[0]), jitter, int(steps[-1] + 1 - len(steps)), dropped)
