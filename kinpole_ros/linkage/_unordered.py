"""
Points in no order: bodies from where they can be followed, then followed through all the rest.

Single points are lost where they pass each other, bodies of known shape are not. So bodies are
looked for in a stretch that can be followed, found again in all frames, and what is left over is
looked through for more.
"""

from collections.abc import Callable

import numpy as np

from kinpole_ros.linkage._follow import follow
from kinpole_ros.linkage._plane import Plane, fit_plane, noise_in_space, noise_of
from kinpole_ros.linkage._poses import Pose, fit_body, off_body
from kinpole_ros.linkage._record import Record, UndiscoveredError
from kinpole_ros.linkage._rigid import group
from kinpole_ros.linkage._settle import settle
from kinpole_ros.linkage._tracks import Tracks, best_window, link
from kinpole_ros.planar._plane import Complex

# s. Bodies that move against each other do so in so long, as a rule.
_LEAST_WINDOW = 0.5
# Frames in which bodies are looked for; they are followed through all others after that.
_STRETCH = 4000
_ROUNDS = 6
# Noises, and share of the least extent in the plane, that points without names may leave it by.
_OUT_NOISE, _OUT = 10.0, 0.2
# Tracks that are looked at for more markers of a body: the longest, of so many frames or more.
_MOST_TRACKS = 200
_SHORTEST = 30
# Deviations that a point may be off a body and still be of it, seen but for a while.
_ON = 1.7
# Share of the points of a frame that may be left over.
_FEW = 0.02
# Share of the frames that a body must be seen in.
_SELDOM = 0.2


def order_points(
    record: Record, normal: np.ndarray | None, progress: Callable[[float], None] | None
) -> tuple[Complex, Plane]:
    """
    Tracks (T, N), complex, NaN for none, of a record of points in no order, and their plane.

    The plane is that with the `normal` (3,), or that of the motion.

    Raises UndiscoveredError where the points cannot be followed.
    """
    stretch = _liveliest(record.points)
    part = record._replace(stamps=record.stamps[stretch], points=record.points[stretch])
    steps = part.steps()
    least = round(_LEAST_WINDOW * 1e9 / record.interval)
    left = part.points.copy()
    flat: Complex = np.zeros(0, complex)
    shapes: list[Complex] = []
    # The numbers of each body's markers: one on the axis of a pin has one on both bodies.
    same: list[list[int]] = []
    tracks: Complex = np.zeros((len(steps), 0), complex)
    plane: Plane | None = None
    noise = 0.0
    count = np.isfinite(part.points[..., 0]).sum()
    for number in range(_ROUNDS):
        if progress is not None:
            progress(0.7 * number / _ROUNDS)
        found = link(left, steps)
        wanted = int(np.quantile(np.isfinite(left[..., 0]).sum(axis=1), 0.99))
        frames, chosen = best_window(found, wanted, steps, least)
        solid = found.dense(left, chosen, frames)
        if plane is None:
            if len(chosen) < 2:
                raise UndiscoveredError(
                    'no two points can be followed for half a second; fix: give the markers '
                    'names, or take more frames a second'
                )
            plane = fit_plane(solid, normal)
            noises = noise_in_space(solid)
            noises = noises[np.isfinite(noises)]
            usual = float(np.median(noises)) if len(noises) else 0.0
            if plane.spread > max(_OUT_NOISE * usual, _OUT * plane.across):
                raise UndiscoveredError(
                    f'the points leave any plane by {plane.spread / plane.size:.0%} of their way, '
                    'and have no names that hold: without names they are followed in a plane only; '
                    'fix: give the markers names'
                )
            flat = plane.project(part.points)
        poses, same, tracks = _found_again(_split(tracks, shapes), same, tracks)
        shapes, more = _add_markers(poses, found, plane.project(left), noise)
        for shape, numbers in zip(shapes, same, strict=True):
            numbers += [_new(same) + k for k in range(len(shape) - len(numbers))]
        grown = _grow(shapes, same, poses, plane.project(solid), frames, noise, more, len(steps))
        if grown is None:
            break
        shapes, position, angle, noise = grown
        tracks = follow(flat, steps, shapes, _numbers(same), position, angle, noise)
        used = _used(flat, tracks)
        left[used] = np.nan
        left[~used] = part.points[~used]
        if np.isfinite(left[..., 0]).sum() < _FEW * count:
            break
    if plane is None or not shapes:
        raise UndiscoveredError(
            'no two points keep their distance; fix: put two or more markers on each body, and see '
            'that they sit tight'
        )
    if len(steps) < len(record.stamps):
        rest = None if progress is None else (lambda share: progress(0.7 + 0.3 * share))
        tracks = _everywhere(record, stretch, plane, shapes, same, tracks, noise, rest)
    return _merged(tracks, shapes, same), plane


def _new(same: list[list[int]]) -> int:
    """The first number that no marker has."""
    return 1 + max((k for numbers in same for k in numbers), default=-1)


def _numbers(same: list[list[int]]) -> np.ndarray:
    return np.array([k for numbers in same for k in numbers])


def _merged(tracks: Complex, shapes: list[Complex], same: list[list[int]]) -> Complex:
    """Tracks with those of one marker as one, without bodies that were hardly ever seen."""
    body = np.repeat(np.arange(len(shapes)), [len(shape) for shape in shapes])
    seen = np.isfinite(tracks.real)
    often = [seen[:, body == b].mean() > _SELDOM for b in range(len(shapes))]
    columns: dict[int, Complex] = {}
    for k, number in enumerate(_numbers(same).tolist()):
        if not often[body[k]]:
            continue
        if number in columns:
            columns[number] = np.where(seen[:, k], tracks[:, k], columns[number])
        else:
            columns[number] = tracks[:, k]
    return np.stack(list(columns.values()), axis=1)


def _liveliest(points: np.ndarray) -> slice:
    """The stretch in which the points move the most."""
    if len(points) <= _STRETCH:
        return slice(0, len(points))
    with np.errstate(invalid='ignore'):
        mean = np.nanmean(points, axis=1)
        around = np.sqrt(np.nanmean((points - mean[:, None]) ** 2, axis=(1, 2)))
    best, most = 0, -1.0
    for first in range(0, len(points) - _STRETCH + 1, _STRETCH // 2):
        rows = slice(first, first + _STRETCH)
        # A frame without points counts for nothing.
        moved = float(np.nanstd(mean[rows], axis=0).max() + np.nanstd(around[rows]))
        if moved > 1.2 * most:
            best, most = first, moved
    return slice(best, best + _STRETCH)


def _split(tracks: Complex, shapes: list[Complex]) -> list[Pose]:
    """The poses of the bodies found so far, gaps filled."""
    poses = []
    first = 0
    for shape in shapes:
        pose = fit_body(tracks[:, first : first + len(shape)])
        first += len(shape)
        seen = pose.seen.nonzero()[0]
        if len(seen):
            every = np.arange(len(tracks))
            real, imag, angle = (
                np.interp(every, seen, part[seen])
                for part in (pose.position.real, pose.position.imag, pose.angle)
            )
            pose = pose._replace(position=real + 1j * imag, angle=angle)
        poses.append(pose)
    return poses


def _found_again(
    poses: list[Pose], same: list[list[int]], tracks: Complex
) -> tuple[list[Pose], list[list[int]], Complex]:
    """Bodies, numbers and tracks of the markers that were found at all, two or more of a body."""
    there = [np.isfinite(pose.shape) for pose in poses]
    there = [found & (found.sum() > 1) for found in there]
    kept = [k for k, found in enumerate(there) if found.any()]
    numbers = [np.array(same[k])[there[k]].tolist() for k in kept]
    columns = np.concatenate(there) if there else slice(None)
    shown = [poses[k]._replace(shape=poses[k].shape[there[k]]) for k in kept]
    return shown, numbers, tracks[:, columns]


def _add_markers(
    poses: list[Pose], found: Tracks, flat: Complex, noise: float
) -> tuple[list[Complex], bool]:
    """The shapes of bodies with what tracks of points (T, n) are fixed on them; whether any is."""
    shapes = [pose.shape for pose in poses]
    added = False
    length = found.last - found.first
    for track in np.argsort(-length, kind='stable')[:_MOST_TRACKS].tolist() if poses else []:
        frames = slice(int(found.first[track]), int(found.last[track]) + 1)
        if frames.stop - frames.start < _SHORTEST:
            break
        own = found.dense(flat[..., None], np.array([track]), frames)[:, 0, 0]
        fits = [
            off_body(
                pose._replace(position=pose.position[frames], angle=pose.angle[frames]), own, noise
            )
            for pose in poses
        ]
        body = min(range(len(fits)), key=lambda k: fits[k][0])
        off, place = fits[body]
        others = [fit[0] for k, fit in enumerate(fits) if k != body]
        # What may be of two bodies, by so short a track, is of neither yet.
        if off > _ON or min(others, default=np.inf) < 2 * _ON:
            continue
        if np.abs(place - shapes[body]).min() > 8 * noise:
            shapes[body] = np.append(shapes[body], place)
            added = True
    return shapes, added


def _grow(
    shapes: list[Complex],
    same: list[list[int]],
    poses: list[Pose],
    flat: Complex,
    frames: slice,
    noise: float,
    added: bool,
    frame_count: int,
) -> tuple[list[Complex], Complex, np.ndarray, float] | None:
    """
    Bodies with those that tracks (F, K) over some frames make: shapes, poses (T, B) and noise.

    None where there are no new ones and nothing was `added` to others.
    """
    of_tracks = noise_of(flat)
    free = np.ones(flat.shape[1], bool)
    for k in range(flat.shape[1]):
        for pose in poses:
            there = pose._replace(position=pose.position[frames], angle=pose.angle[frames])
            free[k] &= not off_body(there, flat[:, k], noise)[0] < _ON
    rest = flat[:, free]
    new: list[Pose] = []
    base = _new(same)
    if rest.shape[1] > 1:
        groups, _ = settle(rest, group(rest, of_tracks[free]))
        fixed = [groups.fixed] if len(groups.fixed) > 1 else []
        for body in (*groups.bodies, *fixed):
            new.append(fit_body(rest[:, body]))
            same.append([base + k for k in body])
    if not new and not added:
        return None
    noises = [pose.noise for pose in (*poses, *new) if pose.noise > 0]
    usual = float(np.median([*noises, *of_tracks[np.isfinite(of_tracks)]]))
    position = np.full((frame_count, len(poses) + len(new)), np.nan + 0j)
    angle = np.full(position.shape, np.nan)
    for k, pose in enumerate(poses):
        position[:, k], angle[:, k] = pose.position, pose.angle
    for k, pose in enumerate(new, len(poses)):
        position[frames, k], angle[frames, k] = pose.position, pose.angle
    return [*shapes, *(pose.shape for pose in new)], position, angle, usual


def _used(flat: Complex, tracks: Complex) -> np.ndarray:
    """Which of the points (T, n) are on a track (T, N)."""
    used = np.zeros(flat.shape, bool)
    for k in range(tracks.shape[1]):
        used |= flat == tracks[:, k, None]
    return used


def _everywhere(
    record: Record,
    stretch: slice,
    plane: Plane,
    shapes: list[Complex],
    same: list[list[int]],
    tracks: Complex,
    noise: float,
    progress: Callable[[float], None] | None,
) -> Complex:
    """The bodies of a stretch followed through all frames."""
    poses = _split(tracks, shapes)
    position = np.full((len(record.stamps), len(shapes)), np.nan + 0j)
    angle = np.full(position.shape, np.nan)
    position[stretch] = np.stack([pose.position for pose in poses], axis=1)
    angle[stretch] = np.stack([pose.angle for pose in poses], axis=1)
    learned = [
        np.where(np.isfinite(p.shape), p.shape, s) for p, s in zip(poses, shapes, strict=True)
    ]
    flat = plane.project(record.points)
    begin = stretch.start, stretch.stop - 1
    found = follow(
        flat, record.steps(), learned, _numbers(same), position, angle, noise, progress, begin
    )
    found[stretch] = tracks
    return found
