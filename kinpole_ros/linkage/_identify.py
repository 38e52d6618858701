"""From a record to bodies: which marker of which frame is which, and which are of one body."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kinpole_ros.linkage._plane import Plane, fit_plane, noise_of
from kinpole_ros.linkage._poses import Pose
from kinpole_ros.linkage._record import Record, UndiscoveredError
from kinpole_ros.linkage._rigid import Groups, group
from kinpole_ros.linkage._settle import settle
from kinpole_ros.linkage._unordered import order_points


class Bodies(NamedTuple):
    """
    Tracks (T, N) of all markers in the plane, complex, in units of the source, and their bodies.

    `groups` are of columns of `tracks`; `poses` are those of its bodies. `labels` name the columns,
    '' where the source does not; `ordered` says whether the source names them rightly.
    """

    tracks: np.ndarray
    groups: Groups
    poses: list[Pose]
    plane: Plane
    noise: np.ndarray
    labels: list[str]
    ordered: bool


def identify(record: Record, progress: Callable[[float], None] | None = None) -> Bodies:
    """
    The bodies of a record.

    Raises UndiscoveredError where nothing moves, or nothing is rigid.
    """
    if record.names:
        plane = fit_plane(record.points)
        tracks = plane.project(record.points)
        labels = list(record.names)
    else:
        tracks, plane = order_points(record, progress)
        labels = [''] * tracks.shape[1]
    noise = noise_of(tracks)
    often = np.isfinite(tracks.real).sum(axis=0) >= 30
    if not often.any():
        raise UndiscoveredError(
            f'none of {tracks.shape[1]} markers is seen in 30 frames; fix: record longer, or see '
            'that the markers are in view'
        )
    groups = group(np.where(often, tracks, np.nan), noise)
    _check(groups, tracks, often)
    groups, poses = settle(tracks, groups)
    _check(groups, tracks, often)
    return Bodies(tracks, groups, poses, plane, noise, labels, bool(record.names))


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
