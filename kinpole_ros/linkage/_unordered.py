"""
Points in no order: bodies are found where points can be followed, then followed everywhere.

Single points are lost where they pass each other, bodies of known shape are not. So bodies are
sought in a window in which points can be followed, then followed through all frames, and the points
that remain are searched for more.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._body_poses import BodyPoses, fit_body, off_body, refine_groups
from kinpole_ros.linkage._follow import follow, stacked_shapes
from kinpole_ros.linkage._motion_plane import MotionPlane, fit_plane, space_noise, track_noise
from kinpole_ros.linkage._record import MarkerRecord, UndiscoveredError
from kinpole_ros.linkage._rigid import group
from kinpole_ros.linkage._tracks import Tracks, best_window, link
from kinpole_ros.planar._plane import Complex, Real

# Bodies usually move against each other within this time, s.
_MIN_WINDOW = 0.5
# Frames in which bodies are sought.
_SEARCHED_FRAMES = 4000
_ROUNDS = 6
# Points without names may leave their plane by this many times the noise, or by this share of the
# least extent of the motion in it.
_OUT_NOISE, _OUT_SHARE = 10.0, 0.2
# Number of the longest tracks examined as further markers of a body, and their least length.
_MAX_TRACKS, _MIN_TRACK = 200, 30
# Standard deviations that a track of some frames may be off a body and still be on it.
_ON_BODY = 1.7
# A new marker is this many times the noise away from the others.
_NEW_MARKER = 8
# Share of the points that may remain.
_REMAINING = 0.02
# Share of the frames that a body must be seen in.
_MIN_SEEN = 0.2


class _Outline(NamedTuple):
    """A body with its pose in all frames, and its markers' numbers: one marker may be on two."""

    pose: BodyPoses
    numbers: list[int]


def order_points(
    record: MarkerRecord, normal: np.ndarray | None, progress: Callable[[float], None] | None
) -> tuple[Complex, MotionPlane]:
    """
    Tracks (T, N), complex, NaN for none, of a record of points in no order, and their plane.

    The plane is that with the `normal` (3,), or that of the motion. Raises UndiscoveredError where
    the points cannot be followed.
    """
    searched = _liveliest(record.points)
    window = record._replace(stamps=record.stamps[searched], points=record.points[searched])
    steps = window.steps()
    min_steps = round(_MIN_WINDOW * 1e9 / record.interval)
    remaining = window.points.copy()
    bodies: list[_Outline] = []
    tracks: Complex = np.zeros((len(steps), 0), complex)
    plane: MotionPlane | None = None
    noise = 0.0
    count = np.isfinite(window.points[..., 0]).sum()
    for number in range(_ROUNDS):
        if progress is not None:
            progress(0.7 * number / _ROUNDS)
        linked = link(remaining, steps)
        enough = int(np.quantile(np.isfinite(remaining[..., 0]).sum(axis=1), 0.99))
        frames, chosen = best_window(linked, enough, steps, min_steps)
        points = linked.dense(remaining, chosen, frames)
        if plane is None:
            plane = _fit_plane(points, normal)
            flat = plane.project(window.points)
        bodies, tracks = _refitted(bodies, tracks)
        bodies, has_added = _with_more_markers(bodies, linked, plane.project(remaining), noise)
        in_window = plane.project(points)
        new = _new_bodies(bodies, in_window, frames, noise, len(steps))
        if not new and not has_added:
            break
        bodies += new
        noises = [body.pose.noise for body in bodies if body.pose.noise > 0]
        of_tracks = track_noise(in_window)
        noise = float(np.median([*noises, *of_tracks[np.isfinite(of_tracks)]]))
        shapes = stacked_shapes(
            [body.pose.shape for body in bodies], [body.numbers for body in bodies]
        )
        tracks = follow(flat, steps, shapes, _stacked_poses(bodies), noise)
        is_used = np.zeros(flat.shape, bool)
        for track in tracks.T:
            is_used |= flat == track[:, None]
        remaining = np.where(is_used[..., None], np.nan, window.points)
        if np.isfinite(remaining[..., 0]).sum() < _REMAINING * count:
            break
    if plane is None or not bodies:
        raise UndiscoveredError(
            'no two points keep their distance; fix: put two or more markers on each body, and see '
            'that they sit tight'
        )
    if len(steps) < len(record.stamps):
        tracks = _followed_everywhere(record, searched, plane, bodies, tracks, noise, progress)
    return _unique_tracks(bodies, tracks), plane


def _liveliest(points: np.ndarray) -> slice:
    """The frames in which the points (T, n, 3) move the most."""
    if len(points) <= _SEARCHED_FRAMES:
        return slice(0, len(points))
    with np.errstate(invalid='ignore'):
        mean = np.nanmean(points, axis=1)
        around = np.sqrt(np.nanmean((points - mean[:, None]) ** 2, axis=(1, 2)))
    best, most = 0, -1.0
    for first in range(0, len(points) - _SEARCHED_FRAMES + 1, _SEARCHED_FRAMES // 2):
        rows = slice(first, first + _SEARCHED_FRAMES)
        moved = float(np.nanstd(mean[rows], axis=0).max() + np.nanstd(around[rows]))
        # An earlier window is kept unless a later one is clearly better.
        if moved > 1.2 * most:
            best, most = first, moved
    return slice(best, best + _SEARCHED_FRAMES)


def _fit_plane(points: np.ndarray, normal: np.ndarray | None) -> MotionPlane:
    """The plane of tracks (F, K, 3); raises UndiscoveredError if they leave any plane."""
    if points.shape[1] < 2:
        raise UndiscoveredError(
            'no two points can be followed for half a second; fix: give the markers '
            'names, or take more frames a second'
        )
    plane = fit_plane(points, normal)
    noises = space_noise(points)
    noises = noises[np.isfinite(noises)]
    noise = float(np.median(noises)) if len(noises) else 0.0
    if plane.spread > max(_OUT_NOISE * noise, _OUT_SHARE * plane.across):
        raise UndiscoveredError(
            f'the points leave any plane by {plane.spread / plane.size:.0%} of their way, '
            'and have no names that hold: without names they are followed in a plane only; '
            'fix: give the markers names'
        )
    return plane


def _stacked_poses(bodies: list[_Outline]) -> tuple[Complex, Real]:
    """Positions and angles (T, B)."""
    return (
        np.stack([body.pose.position for body in bodies], axis=1),
        np.stack([body.pose.angle for body in bodies], axis=1),
    )


def _fit_tracks(bodies: list[_Outline], tracks: Complex) -> list[BodyPoses]:
    """Poses of the bodies fitted to their tracks (T, N), with gaps filled."""
    poses = []
    first = 0
    for body in bodies:
        pose = fit_body(tracks[:, first : first + len(body.numbers)])
        first += len(body.numbers)
        seen = pose.seen.nonzero()[0]
        if len(seen):
            real, imag, angle = (
                np.interp(np.arange(len(tracks)), seen, values[seen])
                for values in (pose.position.real, pose.position.imag, pose.angle)
            )
            pose = pose._replace(position=real + 1j * imag, angle=angle)
        poses.append(pose)
    return poses


def _refitted(bodies: list[_Outline], tracks: Complex) -> tuple[list[_Outline], Complex]:
    """Bodies and tracks of the markers that were followed at all, two or more of a body."""
    refitted, columns = [], [np.zeros(0, bool)]
    for body, pose in zip(bodies, _fit_tracks(bodies, tracks), strict=True):
        followed = np.isfinite(pose.shape)
        followed &= followed.sum() > 1
        columns.append(followed)
        if followed.any():
            numbers = np.array(body.numbers)[followed].tolist()
            refitted.append(_Outline(pose._replace(shape=pose.shape[followed]), numbers))
    return refitted, tracks[:, np.concatenate(columns)]


def _part(pose: BodyPoses, frames: slice) -> BodyPoses:
    return pose._replace(position=pose.position[frames], angle=pose.angle[frames])


def _next_number(bodies: list[_Outline]) -> int:
    return 1 + max((number for body in bodies for number in body.numbers), default=-1)


def _with_more_markers(
    bodies: list[_Outline], linked: Tracks, flat: Complex, noise: float
) -> tuple[list[_Outline], bool]:
    """Bodies with the linked points (T, n) that are fixed on them, and whether there are any."""
    shapes = [body.pose.shape for body in bodies]
    length = linked.last - linked.first
    longest = np.argsort(-length, kind='stable')[:_MAX_TRACKS] if bodies else []
    for track in longest:
        frames = slice(int(linked.first[track]), int(linked.last[track]) + 1)
        if frames.stop - frames.start < _MIN_TRACK:
            break
        points = linked.dense(flat, np.array([track]), frames)
        fits = [off_body(_part(body.pose, frames), points, noise) for body in bodies]
        off = np.concatenate([distance for distance, _ in fits])
        k = int(off.argmin())
        # A short track that may be of two bodies is of neither yet.
        if off[k] > _ON_BODY or np.delete(off, k).min(initial=np.inf) < 2 * _ON_BODY:
            continue
        position = fits[k][1][0]
        if np.abs(position - shapes[k]).min() > _NEW_MARKER * noise:
            shapes[k] = np.append(shapes[k], position)
    grown: list[_Outline] = []
    for body, shape in zip(bodies, shapes, strict=True):
        first = _next_number([*grown, *bodies])
        numbers = [*body.numbers, *range(first, first + len(shape) - len(body.numbers))]
        grown.append(_Outline(body.pose._replace(shape=shape), numbers))
    has_added = any(len(a.numbers) > len(b.numbers) for a, b in zip(grown, bodies, strict=True))
    return grown, has_added


def _new_bodies(
    bodies: list[_Outline], tracks: Complex, frames: slice, noise: float, frame_count: int
) -> list[_Outline]:
    """Bodies of tracks (F, K) in some frames that are not on any of the known `bodies`."""
    is_free = np.ones(tracks.shape[1], bool)
    for body in bodies:
        is_free &= ~(off_body(_part(body.pose, frames), tracks, noise)[0] < _ON_BODY)
    free = tracks[:, is_free]
    new: list[_Outline] = []
    if free.shape[1] < 2:
        return new
    groups, _ = refine_groups(free, group(free, track_noise(tracks)[is_free]))
    first = _next_number(bodies)
    for columns in (*groups.bodies, *([groups.fixed] if len(groups.fixed) > 1 else [])):
        pose = fit_body(free[:, columns])
        position = np.full(frame_count, np.nan + 0j)
        angle = np.full(frame_count, np.nan)
        position[frames], angle[frames] = pose.position, pose.angle
        numbers = [first + k for k in columns]
        new.append(_Outline(pose._replace(position=position, angle=angle), numbers))
    return new


def _followed_everywhere(
    record: MarkerRecord,
    searched: slice,
    plane: MotionPlane,
    bodies: list[_Outline],
    tracks: Complex,
    noise: float,
    progress: Callable[[float], None] | None,
) -> Complex:
    """Tracks of bodies in all frames, from those (F, N) in the searched frames."""
    poses = _fit_tracks(bodies, tracks)
    position = np.full((len(record.stamps), len(bodies)), np.nan + 0j)
    angle = np.full(position.shape, np.nan)
    position[searched] = np.stack([pose.position for pose in poses], axis=1)
    angle[searched] = np.stack([pose.angle for pose in poses], axis=1)
    shapes = [
        np.where(np.isfinite(pose.shape), pose.shape, body.pose.shape)
        for pose, body in zip(poses, bodies, strict=True)
    ]
    result = follow(
        plane.project(record.points),
        record.steps(),
        stacked_shapes(shapes, [body.numbers for body in bodies]),
        (position, angle),
        noise,
        None if progress is None else (lambda share: progress(0.7 + 0.3 * share)),
        (searched.start, searched.stop - 1),
    )
    result[searched] = tracks
    return result


def _unique_tracks(bodies: list[_Outline], tracks: Complex) -> Complex:
    """Tracks (T, N) with those of one marker merged, without bodies that were hardly ever seen."""
    columns: dict[int, Complex] = {}
    first = 0
    for body in bodies:
        own = tracks[:, first : first + len(body.numbers)]
        first += len(body.numbers)
        seen = np.isfinite(own.real)
        if seen.mean() <= _MIN_SEEN:
            continue
        for k, number in enumerate(body.numbers):
            previous = columns.get(number, own[:, k])
            columns[number] = np.where(seen[:, k], own[:, k], previous)
    return np.stack(list(columns.values()), axis=1)
