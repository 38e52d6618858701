"""From a record to rigid bodies: which marker of which frame is which, and on which body it is."""

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._body_poses import BodyPoses, fit_body, refine_groups
from kinpole_ros.linkage._motion_plane import MotionPlane, fit_plane, space_noise, track_noise
from kinpole_ros.linkage._record import MarkerRecord, UndiscoveredError
from kinpole_ros.linkage._rigid import Groups, distance_spreads, group, single_markers
from kinpole_ros.linkage._solid import SolidPose, finite_mean, out_of_plane, turn_scatter
from kinpole_ros.linkage._space import DISTANCE_FRAMES, SpaceBodies, find_bodies, soft_bodies
from kinpole_ros.linkage._unordered import order_points
from kinpole_ros.linkage.limits import PAIR_FRAMES
from kinpole_ros.planar._plane import Complex

# Noise over the size of a body, beyond which unreliable names are not trusted after all.
_MAX_NAMED_NOISE = 0.03
# A motion is planar if it leaves the plane by less than one of these: a share of its least extent
# in the plane, a share of its largest extent, a multiple of the noise.
_FLAT, _FLAT_LINE, _FLAT_NOISE = 0.01, 0.001, 3.0
# The same for soft bodies: a multiple of the residuals of their markers, a share of their turn.
_FLAT_SOFT, _FLAT_TURN = 3.0, 0.05
# A body with this share of all markers, and at least this many, stands still if it moves by less
# than the third number, as a share of its size and in rad.
_NEARLY_ALL, _MANY, _STILL = 0.9, 6, 0.05


class FoundBodies(NamedTuple):
    """
    Tracks (T, N) of all markers in the plane, complex, in units of the source, and their bodies.

    `groups` are of columns of `tracks`, `poses` those of its bodies. `labels` name the columns, ''
    where the source does not; `ordered` says whether these names are identities. `space` are the
    bodies in space if they do not move in one plane. `is_soft` says that markers move against each
    other by more than their noise, as on skin.
    """

    tracks: Complex
    groups: Groups
    poses: list[BodyPoses]
    plane: MotionPlane
    labels: list[str]
    ordered: bool
    space: SpaceBodies | None = None
    is_soft: bool = False


def identify(
    record: MarkerRecord,
    normal: np.ndarray | None = None,
    progress: Callable[[float], None] | None = None,
) -> FoundBodies:
    """
    Find the bodies of a record, in the plane with this `normal` (3,) or in that of the motion.

    Raises UndiscoveredError where nothing moves, or nothing is rigid.
    """
    if not record.names:
        try:
            tracks, plane = order_points(record, normal, progress)
            return _in_plane(tracks, plane, [''] * tracks.shape[1], False)
        except UndiscoveredError as error:
            if not record.unreliable_names:
                raise
            return _by_unreliable_names(record, normal, error)
    plane = fit_plane(record.points, normal)
    noise = space_noise(record.points)
    usual = float(np.nanmedian(noise)) if np.isfinite(noise).any() else 0.0
    if plane.spread < max(_FLAT_NOISE * usual, _FLAT * plane.across, _FLAT_LINE * plane.size):
        bodies = _in_plane(plane.project(record.points), plane, list(record.names), True)
    else:
        bodies = _in_space(record, noise, normal)
    _check_motion(bodies)
    return bodies


def _by_unreliable_names(
    record: MarkerRecord, normal: np.ndarray | None, error: UndiscoveredError
) -> FoundBodies:
    """Bodies by names that seem to change from frame to frame, if the bodies are rigid."""
    with suppress(UndiscoveredError):
        record = record._replace(names=record.unreliable_names, unreliable_names=())
        bodies = identify(record, normal)
        if all(pose.noise < _MAX_NAMED_NOISE * pose.size for pose in bodies.poses):
            return bodies
    raise UndiscoveredError(
        f'the names of the markers do not hold from frame to frame, and without them {error}'
    )


def _in_plane(tracks: Complex, plane: MotionPlane, labels: list[str], ordered: bool) -> FoundBodies:
    """Bodies that are rigid in the plane, or else soft."""
    noise = track_noise(tracks)
    is_frequent = _seen_often(tracks.real)
    frequent = np.where(is_frequent, tracks, np.nan)
    groups = group(frequent, noise)
    poses: list[BodyPoses] = []
    if groups.bodies:
        groups, poses = refine_groups(tracks, groups)
    soft = soft_bodies(frequent, noise, groups.bodies) if ordered else None
    if soft:
        single = single_markers(soft, groups.fixed, len(is_frequent))
        groups = groups._replace(bodies=soft, single=single)
        poses = [fit_body(tracks[:, body]) for body in soft]
    _check_groups(groups, tracks, is_frequent, labels)
    return FoundBodies(tracks, groups, poses, plane, labels, ordered, is_soft=bool(soft))


def _in_space(record: MarkerRecord, noise: np.ndarray, normal: np.ndarray | None) -> FoundBodies:
    """Bodies that are rigid in space, projected on the plane nearest to their motion."""
    points = record.points
    is_frequent = _seen_often(points[..., 0])
    space = find_bodies(np.where(is_frequent[:, None], points, np.nan), noise)
    moved = np.sqrt(finite_mean((points - finite_mean(points)) ** 2)).max(axis=1)
    is_still = moved < np.maximum(2 * noise, 1e-9)
    solid = [pose for pose in space.solid if pose is not None]
    scatters = [(pose.size**2, turn_scatter(pose)) for pose in solid]
    out = sum((size * (np.trace(w) * np.eye(3) - w) for size, w in scatters), np.zeros((3, 3)))
    plane = fit_plane(points, normal, out / max(len(solid), 1))
    tracks = plane.project(points)
    poses = [fit_body(tracks[:, body]) for body in space.bodies]
    moving = [
        k for k, body in enumerate(space.bodies) if poses[k].seen.any() and not is_still[body].all()
    ]
    bodies, poses = [space.bodies[k] for k in moving], [poses[k] for k in moving]
    members = {k for body in bodies for k in body}
    fixed = [k for k in np.flatnonzero(is_still & is_frequent).tolist() if k not in members]
    groups = Groups(bodies, fixed, single_markers(bodies, fixed, len(is_frequent)))
    _check_groups(groups, tracks, is_frequent, list(record.names))
    is_flat = all(_is_flat(pose, plane) for pose in solid)
    residual = float(np.median([pose.noise for pose in poses]))
    return FoundBodies(
        tracks,
        groups,
        poses,
        plane,
        list(record.names),
        ordered=True,
        space=None if is_flat else space.subset(moving),
        is_soft=residual > _FLAT_SOFT * float(np.nanmedian(noise)),
    )


def _is_flat(pose: SolidPose, plane: MotionPlane) -> bool:
    """Whether a body stays in the plane, to within what its markers show."""
    off, turned, about = out_of_plane(pose, plane.normal)
    soft = _FLAT_SOFT * pose.noise
    limit = max(2 * soft / pose.size, _FLAT_TURN * about)
    return off < max(soft, _FLAT * plane.across) and turned < limit


def _check_motion(bodies: FoundBodies) -> None:
    """Raise UndiscoveredError if nearly all markers are of one body that stands still."""
    count, pose = bodies.tracks.shape[1], bodies.poses[0]
    is_one = len(bodies.poses) == 1 and len(pose.shape) >= max(_NEARLY_ALL * count, _MANY)
    if not is_one or not pose.seen.any():
        return
    turned = float(np.ptp(pose.angle[pose.seen]))
    moved = bodies.plane.size / pose.size
    if turned < _STILL and moved < _STILL:
        raise UndiscoveredError(
            f'all {count} markers keep their distances, and move by {moved:.1%} of the size of '
            'their arrangement: they stand still, as in a static trial; fix: give a recording of '
            'the motion'
        )


def _seen_often(column: np.ndarray) -> np.ndarray:
    """Which of the markers (T, n), NaN for none, are in enough frames; raises if none is."""
    is_frequent = np.isfinite(column).sum(axis=0) >= PAIR_FRAMES
    if not is_frequent.any():
        raise UndiscoveredError(
            f'none of {column.shape[1]} markers is seen in {PAIR_FRAMES} frames; fix: record '
            'longer, or see that the markers are in view'
        )
    return np.asarray(is_frequent)


def _check_groups(
    groups: Groups, tracks: Complex, is_frequent: np.ndarray, labels: list[str]
) -> None:
    """Raise UndiscoveredError if nothing moves, or no two markers are rigid."""
    if len(groups.fixed) == int(is_frequent.sum()):
        raise UndiscoveredError(
            f'none of {len(groups.fixed)} markers moves; fix: move the rig through all of its '
            'range while it is recorded'
        )
    if not groups.bodies:
        raise UndiscoveredError(
            f'no two of {tracks.shape[1]} markers keep their distance{_steadiest(tracks, labels)}; '
            'fix: put two or more markers on each body, and see that they sit tight'
        )


def _steadiest(tracks: Complex, labels: list[str]) -> str:
    """Say which two markers keep their distance best, and how well."""
    deviation, median = distance_spreads(tracks, DISTANCE_FRAMES)
    share = deviation / np.maximum(median, 1e-300)
    i, j = np.unravel_index(share.argmin(), share.shape)
    if not np.isfinite(share[i, j]) or not all(labels):
        return ''
    return (
        f': even that of {labels[i]!r} and {labels[j]!r}, the steadiest, changes by '
        f'{share[i, j]:.1%} rms'
    )
