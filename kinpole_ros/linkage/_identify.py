"""From a record to bodies: which marker of which frame is which, and which are of one body."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._plane import Plane, fit_plane, noise_in_space, noise_of
from kinpole_ros.linkage._poses import Pose, fit_body
from kinpole_ros.linkage._record import Record, UndiscoveredError
from kinpole_ros.linkage._rigid import Groups, group
from kinpole_ros.linkage._settle import settle
from kinpole_ros.linkage._space import (
    SolidPose,
    SpaceBodies,
    find_bodies,
    out_of_plane,
    turn_scatter,
)
from kinpole_ros.linkage._unordered import order_points

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
    the bodies in space where they do not move in one plane.
    """

    tracks: np.ndarray
    groups: Groups
    poses: list[Pose]
    plane: Plane
    labels: list[str]
    ordered: bool
    space: SpaceBodies | None = None


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
        tracks, plane = order_points(record, normal, progress)
        return _in_plane(tracks, plane, [''] * tracks.shape[1], False)
    plane = fit_plane(record.points, normal)
    noise = noise_in_space(record.points)
    usual = float(np.nanmedian(noise)) if np.isfinite(noise).any() else 0.0
    if plane.spread < max(_FLAT_NOISE * usual, _FLAT * plane.across, _FLAT_LINE * plane.size):
        found = _in_plane(plane.project(record.points), plane, list(record.names), True)
    else:
        found = _in_space(record, noise, normal)
    _check_motion(found)
    return found


def _in_plane(tracks: np.ndarray, plane: Plane, labels: list[str], ordered: bool) -> Bodies:
    noise = noise_of(tracks)
    often = _seen_often(tracks.real)
    groups = group(np.where(often, tracks, np.nan), noise)
    _check(groups, tracks, often)
    groups, poses = settle(tracks, groups)
    _check(groups, tracks, often)
    return Bodies(tracks, groups, poses, plane, labels, ordered)


def _in_space(record: Record, noise: np.ndarray, normal: np.ndarray | None) -> Bodies:
    """Bodies that are rigid in space; then the plane that they move in, or nearly so."""
    points = record.points
    often = _seen_often(points[..., 0])
    found = find_bodies(np.where(often[:, None], points, np.nan), noise)
    if not found.bodies:
        raise UndiscoveredError(_not_rigid(found.spread, list(record.names)))
    still = np.nanmax(np.nanstd(points, axis=0), axis=1) < np.maximum(2 * noise, 1e-9)
    turns = [(pose.size**2, turn_scatter(pose)) for pose in found.solid if pose is not None]
    out_of = sum((size * (np.trace(w) * np.eye(3) - w) for size, w in turns), np.zeros((3, 3)))
    plane = fit_plane(points, normal, out_of / max(len(turns), 1))
    tracks = plane.project(points)
    moving = [k for k, body in enumerate(found.bodies) if not still[body].all()]
    bodies = [found.bodies[k] for k in moving]
    poses = [fit_body(tracks[:, body]) for body in bodies]
    held = {k for body in bodies for k in body}
    fixed = [k for k in np.flatnonzero(still & often).tolist() if k not in held]
    single = [k for k in range(len(often)) if k not in held and k not in fixed]
    flat = all(_is_flat(pose, plane) for pose in found.solid if pose is not None)
    space = None if flat else found.only(moving)
    groups = Groups(bodies, fixed, single)
    _check(groups, tracks, often)
    return Bodies(tracks, groups, poses, plane, list(record.names), True, space)


def _is_flat(pose: SolidPose, plane: Plane) -> bool:
    """Whether a body stays in the plane, as far as its markers tell."""
    off, turned, about = out_of_plane(pose, plane.normal)
    soft = _FLAT_SOFT * pose.noise
    most = max(2 * soft / pose.size, _FLAT_TURN * about)
    return off < max(soft, _FLAT * plane.across) and turned < most


def _check_motion(found: Bodies) -> None:
    count, pose = found.tracks.shape[1], found.poses[0]
    if len(found.poses) > 1 or len(pose.shape) < max(_ALL * count, _MANY):
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


def _not_rigid(spread: np.ndarray, labels: list[str]) -> str:
    """Say that no two markers keep their distance, and which two do so best."""
    best = ''
    if np.isfinite(spread).any() and all(labels):
        one, other = np.unravel_index(spread.argmin(), spread.shape)
        best = f': that of {labels[one]} and {labels[other]} changes the least, by '
        best += f'{spread[one, other]:.2g} units rms'
    return (
        f'no two of {len(labels)} markers keep their distance{best}; fix: put two or more markers '
        'on each body, and see that they sit tight'
    )


def _check(groups: Groups, tracks: np.ndarray, often: np.ndarray) -> None:
    if len(groups.fixed) == int(often.sum()):
        raise UndiscoveredError(
            f'none of {len(groups.fixed)} markers moves; fix: move the rig through all of its '
            'range while it is recorded'
        )
    if not groups.bodies:
        raise UndiscoveredError(
            f'no two of {tracks.shape[1]} markers keep their distance; fix: put two or more '
            'markers on each body, and see that they sit tight'
        )
