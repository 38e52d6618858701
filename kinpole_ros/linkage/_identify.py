"""From a record to bodies: which marker of which frame is which, and which are of one body."""

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._plane import Plane, fit_plane, noise_in_space, noise_of
from kinpole_ros.linkage._poses import Pose, fit_body
from kinpole_ros.linkage._record import Record, UndiscoveredError
from kinpole_ros.linkage._rigid import Groups, group
from kinpole_ros.linkage._settle import settle
from kinpole_ros.linkage._solid import SolidPose, mean_of, out_of_plane, turn_scatter
from kinpole_ros.linkage._space import SpaceBodies, distance_spreads, find_bodies, soft_bodies
from kinpole_ros.linkage._unordered import order_points

_SHAPELESS = 0.03  # noise over the size of a body by which its names are not trusted
_FEWEST = 30  # frames in which a marker must be seen
# Out of a plane a planar motion goes by less than these shares of its least and its largest extent
# in the plane, or times the noise.
_FLAT, _FLAT_LINE, _FLAT_NOISE = 0.01, 0.001, 3.0
# Where bodies are soft, times the residuals of their markers, and as a share of their turn.
_FLAT_SOFT, _FLAT_TURN = 3.0, 0.05
# One body of nearly all markers, and of many, stands still if it moves by less than this share of
# its size, and turns by less than this, rad.
_ALL, _MANY, _STILL = 0.9, 6, 0.05


class Bodies(NamedTuple):
    """
    Tracks (T, N) of all markers in the plane, complex, in units of the source, and their bodies.

    `groups` are of columns of `tracks`; `poses` are those of its bodies. `labels` name the columns,
    '' where the source does not; `ordered` says whether the source names them rightly. `space` are
    the bodies in space where they do not move in one plane. `is_soft` says that markers move
    against each other by more than their noise, as on skin.
    """

    tracks: np.ndarray
    groups: Groups
    poses: list[Pose]
    plane: Plane
    labels: list[str]
    ordered: bool
    space: SpaceBodies | None = None
    is_soft: bool = False


def identify(
    record: Record,
    normal: np.ndarray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Bodies:
    """
    Find the bodies of a record, in the plane with this `normal` (3,) or in that of the motion.

    Raises UndiscoveredError where nothing moves, or nothing is rigid.
    """
    if not record.names:
        try:
            tracks, plane = order_points(record, normal, progress)
            return _in_plane(tracks, plane, [''] * tracks.shape[1], False)
        except UndiscoveredError as error:
            if not record.doubted:
                raise
            return _by_doubted_names(record, normal, error)
    plane = fit_plane(record.points, normal)
    noise = noise_in_space(record.points)
    usual = float(np.nanmedian(noise)) if np.isfinite(noise).any() else 0.0
    if plane.spread < max(_FLAT_NOISE * usual, _FLAT * plane.across, _FLAT_LINE * plane.size):
        found = _in_plane(plane.project(record.points), plane, list(record.names), True)
    else:
        found = _in_space(record, noise, normal)
    _check_motion(found)
    return found


def _by_doubted_names(
    record: Record, normal: np.ndarray | None, error: UndiscoveredError
) -> Bodies:
    """Bodies by names that seem to change from frame to frame, if they are rigid by these."""
    with suppress(UndiscoveredError):
        found = identify(record._replace(names=record.doubted, doubted=()), normal)
        if all(pose.noise < _SHAPELESS * pose.size for pose in found.poses):
            return found
    raise UndiscoveredError(
        f'the names of the markers do not hold from frame to frame, and without them {error}'
    )


def _in_plane(tracks: np.ndarray, plane: Plane, labels: list[str], ordered: bool) -> Bodies:
    noise = noise_of(tracks)
    often = _seen_often(tracks.real)
    kept = np.where(often, tracks, np.nan)
    groups = group(kept, noise)
    poses: list[Pose] = []
    if groups.bodies:
        groups, poses = settle(tracks, groups)
    soft = soft_bodies(_in_three(kept), noise, groups.bodies) if ordered else None
    if soft:
        groups = groups._replace(bodies=soft, single=_single(soft, groups.fixed, len(often)))
        poses = [fit_body(tracks[:, body]) for body in soft]
    _check(groups, tracks, often, labels)
    return Bodies(tracks, groups, poses, plane, labels, ordered, is_soft=bool(soft))


def _single(bodies: list[list[int]], fixed: list[int], count: int) -> list[int]:
    """The markers of no body that do not stand still."""
    held = {k for body in bodies for k in body}.union(fixed)
    return [k for k in range(count) if k not in held]


def _in_space(record: Record, noise: np.ndarray, normal: np.ndarray | None) -> Bodies:
    """Bodies that are rigid in space; then the plane that they move in, or nearly so."""
    points = record.points
    often = _seen_often(points[..., 0])
    found = find_bodies(np.where(often[:, None], points, np.nan), noise)
    moved = np.sqrt(mean_of((points - mean_of(points)) ** 2)).max(axis=1)
    still = moved < np.maximum(2 * noise, 1e-9)
    turns = [(pose.size**2, turn_scatter(pose)) for pose in found.solid if pose is not None]
    out_of = sum((size * (np.trace(w) * np.eye(3) - w) for size, w in turns), np.zeros((3, 3)))
    plane = fit_plane(points, normal, out_of / max(len(turns), 1))
    tracks = plane.project(points)
    poses = [fit_body(tracks[:, body]) for body in found.bodies]
    moving = [k for k, pose in enumerate(poses) if pose.seen.any()]
    moving = [k for k in moving if not still[found.bodies[k]].all()]
    bodies, poses = [found.bodies[k] for k in moving], [poses[k] for k in moving]
    held = {k for body in bodies for k in body}
    fixed = [k for k in np.flatnonzero(still & often).tolist() if k not in held]
    flat = all(_is_flat(pose, plane) for pose in found.solid if pose is not None)
    space = None if flat else found.only(moving)
    groups = Groups(bodies, fixed, _single(bodies, fixed, len(often)))
    _check(groups, tracks, often, list(record.names))
    soft = float(np.median([pose.noise for pose in poses])) > _FLAT_SOFT * float(
        np.nanmedian(noise)
    )
    return Bodies(tracks, groups, poses, plane, list(record.names), True, space, soft)


def _is_flat(pose: SolidPose, plane: Plane) -> bool:
    """Whether a body stays in the plane, as far as its markers tell."""
    off, turned, about = out_of_plane(pose, plane.normal)
    soft = _FLAT_SOFT * pose.noise
    most = max(2 * soft / pose.size, _FLAT_TURN * about)
    return off < max(soft, _FLAT * plane.across) and turned < most


def _check_motion(found: Bodies) -> None:
    count, pose = found.tracks.shape[1], found.poses[0]
    if len(found.poses) > 1 or len(pose.shape) < max(_ALL * count, _MANY) or not pose.seen.any():
        return
    turned = float(np.ptp(pose.angle[pose.seen]))
    moved = found.plane.size / pose.size
    if turned < _STILL and moved < _STILL:
        raise UndiscoveredError(
            f'all {count} markers keep their distances, and move by {moved:.1%} of the size of '
            'their arrangement: they stand still, as in a static trial; fix: give a recording of '
            'the motion'
        )


def _seen_often(column: np.ndarray) -> np.ndarray:
    """Which of the markers (T, n), NaN for none, are seen in enough frames; there must be one."""
    often = np.isfinite(column).sum(axis=0) >= _FEWEST
    if not often.any():
        raise UndiscoveredError(
            f'none of {column.shape[1]} markers is seen in {_FEWEST} frames; fix: record longer, '
            'or see that the markers are in view'
        )
    return np.asarray(often)


def _check(groups: Groups, tracks: np.ndarray, often: np.ndarray, labels: list[str]) -> None:
    if len(groups.fixed) == int(often.sum()):
        raise UndiscoveredError(
            f'none of {len(groups.fixed)} markers moves; fix: move the rig through all of its '
            'range while it is recorded'
        )
    if not groups.bodies:
        raise UndiscoveredError(
            f'no two of {tracks.shape[1]} markers keep their distance{_steadiest(tracks, labels)}; '
            'fix: put two or more markers on each body, and see that they sit tight'
        )


def _steadiest(tracks: np.ndarray, labels: list[str]) -> str:
    """Say which two markers keep their distance best, and how badly."""
    spread, usual = distance_spreads(_in_three(tracks))
    share = spread / np.maximum(usual, 1e-300)
    one, other = np.unravel_index(share.argmin(), share.shape)
    if not np.isfinite(share[one, other]) or not all(labels):
        return ''
    return (
        f': even that of {labels[one]!r} and {labels[other]!r}, the steadiest, changes by '
        f'{share[one, other]:.1%} rms'
    )


def _in_three(tracks: np.ndarray) -> np.ndarray:
    """Tracks (T, n), complex, as points (T, n, 3)."""
    return np.stack((tracks.real, tracks.imag, 0 * tracks.real), axis=-1)
