"""Files of points that other programs tracked, written to bags."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinpole_ros.bags._bag_reader import Progress
from kinpole_ros.bags._bag_writer import BagWriter
from kinpole_ros.bags._files import BagError, in_place_of
from kinpole_ros.bags._repeated_frames import leave_out_repeats
from kinpole_ros.bags.formats import (
    SHARES,
    UNITS,
    Options,
    Points,
    listed,
    read_points,
    shown,
)
from kinpole_ros.messages import INPUT_TYPES, TF, marker_arrays, poses_data

_OFF_GRID = 0.15  # intervals in the mean: more are on no grid, as rows of two topics in turn
_FRAME = 'world'
_BLOCK_BYTES = 1 << 20  # of messages in memory at a time
_LONGEST = 2.0**31  # s; the seconds of a ROS stamp are an int32


@dataclass(frozen=True)
class Imported:
    """
    What was read of a file of points, and written to a bag.

    Attributes
    ----------
    format : str
        A key of `formats.FORMATS`.
    markers : tuple of str
    frames : int
        Their number.
    span : float
        s, from the first frame to the last.
    rate : float
        Hz, intervals over time, where lost frames count; NaN of one frame.
    unit : str
        As the file calls it.
    scale : float or tuple of float
        m per unit; in x and y where these are shares of a picture.
    notes : tuple of str
        What the user should know, a line each.
    bodies : tuple of str
        Those whose poses are on /tf. Markers of their names are their origins.

    """

    format: str
    markers: tuple[str, ...]
    frames: int
    span: float
    rate: float
    unit: str
    scale: float | tuple[float, float]
    notes: tuple[str, ...]
    bodies: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Say what was read: frames, markers, format, unit, span and rate."""
        at_rate = f' at {self.rate:.4g} Hz' if self.frames > 1 else ''
        unit = f'in {self.unit}' if UNITS.get(self.unit.lower()) == self.scale else ''
        length = ' x '.join(f'{one:g}' for one in np.atleast_1d(self.scale))
        return (
            f'{self.frames} frames of {len(self.markers)} markers ({self.format}, '
            f'{unit or f"1 unit = {length} m"}), {self.span:.4g} s{at_rate}'
        )


def import_points(
    path: str | Path,
    output: str | Path,
    rate: float | None = None,
    scale: float | tuple[float, float] | None = None,
    y_down: bool | None = None,
    progress: Progress | None = None,
    format: str = 'auto',
    likelihood: float | None = None,
) -> Imported:
    """
    Write the points of a file to a bag, as visualization_msgs/MarkerArray on /markers.

    A marker that was not seen in a frame is not in its message; a frame without markers becomes an
    empty array. Poses go to /tf, too. Log times are the stamps.

    Parameters
    ----------
    path : str or Path
        The file, or a folder of OpenPose or rosbag2.
    output : str or Path
        The .mcap file, replaced when all is read.
    rate : float, optional
        Hz; frames are stamped by their numbers then, the first one 0. Without it, by the times of
        the file, or from the first frame where these start before 0, and a note says so.
    scale : float or tuple of float, optional
        Length of the file's unit, m; without it, as the file says. Width and height of the picture,
        m, where coordinates are shares of these.
    y_down : bool, optional
        Whether y points down; without it, as the file says.
    progress : callable, optional
        Called with the fraction of frames written, at most some 200 times.
    format : str
        A key of `formats.FORMATS`, or 'auto'.
    likelihood : float, optional
        The least at which a point counts as seen, 0 to 1; 0.6 for DeepLabCut, else 0.

    Returns
    -------
    Imported

    Raises
    ------
    BagError
        Naming file, line and column, when the file is not of its format, or lacks what must be
        given then.

    """
    path, output = Path(path), Path(output)
    options = Options(rate, likelihood)
    _check_arguments(path, output, options, scale)
    name, read = read_points(path, format, options)
    used_scale = read.scale if scale is None or _is_other_scale(path, read, scale) else scale
    if used_scale is None or (rate is None and read.times is None):
        raise _incomplete(path, name, read, used_scale, rate)
    poses = _scale(path, read, used_scale, read.y_down if y_down is None else y_down)
    read = replace(read, poses=poses)
    stamps, stamp_notes = _stamps(path, read, rate)
    kept = leave_out_repeats(str(path), 'frames', stamps, _marks(read.points, poses))
    if kept.finding is not None:
        stamp_notes.append(f'{path}: {kept.finding.words()}')
        own = kept.is_kept
        read = replace(read, points=read.points[own], poses=None if poses is None else poses[own])
    write_points(output, read.names, kept.stamps, read.points, progress, read.bodies, read.poses)
    return _describe(name, read, kept.stamps, used_scale, stamp_notes)


def _check_arguments(
    path: Path, output: Path, options: Options, scale: float | tuple[float, float] | None
) -> None:
    """Raise BagError for what cannot be."""
    for name, value in (('rate', options.rate), ('scale', scale)):
        numbers = [one for one in np.atleast_1d(value) if one is not None]
        if not all(math.isfinite(one) and one > 0 for one in numbers):
            raise BagError(f'{name} is {value}; fix: give a number greater than 0')
    if options.likelihood is not None and not 0 <= options.likelihood <= 1:
        raise BagError(f'likelihood is {options.likelihood}; fix: give a number from 0 to 1')
    if os.path.exists(output) and os.path.exists(path) and output.samefile(path):
        raise BagError(f'{output} is the file of points itself; fix: give another one for the bag')


def _is_other_scale(path: Path, read: Points, scale: float | tuple[float, float]) -> bool:
    """Return whether a length is given for shares of a picture, which need its two sides."""
    if isinstance(scale, tuple) and read.unit != SHARES:
        raise BagError(f'{path} is not in {SHARES}; fix: give --scale one number')
    return read.unit == SHARES and not isinstance(scale, tuple)


def _scale(
    path: Path, read: Points, scale: float | tuple[float, float], is_flipped: bool
) -> np.ndarray | None:
    """Scale the points in place, as they can be most of what is in memory; return scaled poses."""
    width, height = scale if isinstance(scale, tuple) else (scale, scale)
    factors = [width, -height if is_flipped else height, width]
    poses = read.poses
    with np.errstate(over='ignore'):
        np.multiply(read.points, factors, out=read.points)
        if poses is not None:
            # The mirror image of a rotation is one about the mirror image of its axis, backward.
            poses = poses * [*factors, *((-1, 1, -1, 1) if is_flipped else (1, 1, 1, 1))]
    if np.isinf(read.points).any():
        raise BagError(f'scale is {scale}; fix: give the length of the unit of {path} in m')
    return poses


def _marks(points: np.ndarray, poses: np.ndarray | None) -> np.ndarray:
    """Return points (T, n, 3) with the tips of two axes, 1 m long, of each pose (T, B, 7)."""
    if poses is None:
        return points
    x, y, z, w = np.moveaxis(poses[..., 3:], -1, 0)
    with np.errstate(invalid='ignore', divide='ignore'):
        square = x * x + y * y + z * z + w * w
        first = np.stack((w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)))
        second = np.stack((2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)))
        tips = [np.moveaxis(axis / square, 0, -1) for axis in (first, second)]
    return np.concatenate((points, *tips), axis=1)


def _describe(
    name: str,
    read: Points,
    stamps: np.ndarray,
    scale: float | tuple[float, float],
    stamp_notes: list[str],
) -> Imported:
    """Describe what was written."""
    notes = [*read.notes, *stamp_notes]
    is_seen = ~np.isnan(read.points).any(axis=-1).all(axis=0)
    if not is_seen.all():
        unseen = [shown(read.names[k]) for k in np.flatnonzero(~is_seen)]
        notes.append(f'seen in no frame: {listed(unseen)}')
    if read.poses is not None:
        notes.append(
            f'poses are on {TF}, to be read with marker_type: tf and marker_topic: {TF}: '
            f'{listed([shown(body) for body in read.bodies])}'
        )
    span = float(stamps[-1] - stamps[0]) * 1e-9
    return Imported(
        name,
        tuple(read.names),
        len(stamps),
        span,
        _mean_rate(stamps),
        shown(read.unit),
        scale,
        tuple(notes),
        tuple(read.bodies),
    )


def _mean_rate(stamps: np.ndarray) -> float:
    """Return intervals over time, Hz; rounded steps of a grid are whole intervals."""
    steps = np.diff(stamps)
    if not len(steps):
        return math.nan
    ratios = steps / np.median(steps)
    intervals = np.maximum(np.rint(ratios), 1)
    if np.abs(ratios - intervals).mean() > _OFF_GRID:
        intervals = np.ones(len(steps))
    return float(intervals.sum() / steps.sum() * 1e9)


def _incomplete(
    path: Path,
    name: str,
    read: Points,
    scale: float | tuple[float, float] | None,
    rate: float | None,
) -> BagError:
    """Return the error of a unit and times that neither the file nor the user gives."""
    faults, fixes = [], []
    if scale is None and read.unit == SHARES:
        faults.append(f'is in {SHARES}, 0 to 1')
        fixes.append(
            'give --scale WIDTH,HEIGHT, the size of the picture in m: its pixels times the m of one'
        )
    elif scale is None:
        unit = f'in {shown(read.unit)}' if read.unit else 'in a unit that the file does not say'
        faults.append(f'is {unit}')
        fixes.append(
            'give --scale, the m of one such unit: a known length in m over the same in the file '
            '(1 to keep the unit)'
        )
    if rate is None and read.times is None:
        faults.append(read.no_times or 'has no times')
        fix = 'give --rate, the frames per second'
        if name == 'table':
            fix = 'give --rate HZ, or name the column of times t'
        fixes.append(fix)
    return BagError(f'{path} ({name}) {" and ".join(faults)}; fix: {"; and ".join(fixes)}')


def write_points(
    output: str | Path,
    names: Sequence[str],
    stamps: np.ndarray,
    points: np.ndarray,
    progress: Progress | None = None,
    bodies: Sequence[str] = (),
    poses: np.ndarray | None = None,
) -> None:
    """
    Write markers to a bag, as visualization_msgs/MarkerArray on /markers, and poses to /tf.

    Parameters
    ----------
    output : str or Path
        The .mcap file, which is replaced when all is written.
    names : sequence of str
        Names of the n markers.
    stamps : ndarray
        (T,) int64, ns.
    points : ndarray
        (T, n, 3), m; NaN for a marker that is not seen.
    progress : callable, optional
        Called with the fraction of frames written, at most some 200 times.
    bodies : sequence of str
        Names of the B bodies of `poses`.
    poses : ndarray, optional
        (T, B, 7), points and quaternions x, y, z, w.

    """
    # Some 300 bytes a marker, and at most some 200 calls of `progress`.
    rows = max(1, min(math.ceil(len(stamps) / 200), _BLOCK_BYTES // (300 * len(names) + 1)))
    due = 0.0
    with in_place_of(output) as part, BagWriter(part, name=output) as bag:
        for start in range(0, len(stamps), rows):
            block = slice(start, start + rows)
            times = stamps[block].tolist()
            data = marker_arrays(stamps[block], _FRAME, names, points[block])
            columns = [('/markers', INPUT_TYPES['marker_array'], times, data)]
            if poses is not None:
                tf = [
                    poses_data('tf', stamp, _FRAME, bodies, row)
                    for stamp, row in zip(times, poses[block], strict=True)
                ]
                columns.append((TF, INPUT_TYPES['tf'], times, tf))
            bag.write_many(columns)
            done = min(1.0, (start + rows) / len(stamps))
            if progress is not None and done >= min(due, 1.0):
                due = done + 1 / 200
                progress(done)


def _stamps(path: Path, read: Points, rate: float | None) -> tuple[np.ndarray, list[str]]:
    """Return the stamps (T,), ns, and a note where they are not the times of the file."""
    if rate is not None:
        frames = read.frames - read.frames[0]
        if not 1.001 * (int(frames[-1]) + 1) / _LONGEST < rate <= 1e9:
            raise BagError(f'rate is {rate:g} for {len(frames)} frames; fix: give it in Hz')
        stamps = frames * 1e9
        stamps /= rate
        return np.rint(stamps, out=stamps).astype(np.int64), []
    if read.stamps is not None:
        return read.stamps, []
    assert read.times is not None
    seconds, notes = read.times, []
    if seconds[0] < 0:
        notes = [
            f'{path} begins at {seconds[0]:.12g} s, and no stamp in ROS is negative: '
            'times are counted from the first frame'
        ]
        seconds = seconds - seconds[0]
    if (bad := ~(np.abs(seconds) < _LONGEST)).any():
        raise _not_a_time(path, read, int(bad.argmax()), 'is not a time in seconds')
    stamps = np.rint(seconds * 1e9).astype(np.int64)
    if (bad := np.diff(stamps) <= 0).any():
        raise _not_a_time(path, read, int(bad.argmax()) + 1, 'is not later than the frame before')
    return stamps, notes


def _not_a_time(path: Path, read: Points, row: int, fault: str) -> BagError:
    assert read.times is not None
    seconds = float(read.times[row])
    cell = '' if math.isnan(seconds) else f'{seconds:.12g}'
    where = f'line {read.lines[row]}' if read.lines else f'frame {read.frames[row]}'
    return BagError(
        f"{path}, {where}, column {read.time_column}: '{cell}' {fault}; fix: give each frame its "
        'time, in order, or the file a --rate'
    )
