"""
Bags with a known answer: the markers of a scene, and with them the exact motion.

On request they are as bad as what real rigs send: late stamps, a tilted plane, other units, points
without names in no order.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinpole_ros.bags._reader import BagError
from kinpole_ros.bags._replay import NODE_NAME, result_columns
from kinpole_ros.bags._writer import BagWriter, in_place_of
from kinpole_ros.messages import (
    INPUT_TYPES,
    message_class,
    poses_data,
    result_outputs,
    serialize_message,
    to_message,
)
from kinpole_ros.planar import fit_pose
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.parameters import POSE_TYPES

if TYPE_CHECKING:
    from kinpole_ros.mechanism import Scene

# Exact to so many digits: below it the answers themselves are noise (a pinned body's centrode).
_EXACT = 1e-12
_FRAME = 'world'
# Frames that are written at once.
_AT_ONCE = 1000
# ROS stamps hold hardly more, in s.
_LONGEST = 2e9
# Loci and covariances of an exact motion say nothing more.
# Those of which it does, and their doubles after the header (and child_frame_id).
_ODOMETRY = message_class('nav_msgs/msg/Odometry')
_DOUBLES = {
    _ODOMETRY: 85,
    message_class('geometry_msgs/msg/PointStamped'): 3,
    message_class('geometry_msgs/msg/Vector3Stamped'): 3,
}


def simulate(
    scene: 'Scene',
    output: str | Path,
    rate: float = 200.0,
    duration: float = 5.0,
    noise: float = 0.0,
    seed: int = 0,
    dropout: float = 0.0,
    jitter: float = 0.0,
    message: str = 'marker_array',
    arrival: float = 0.0,
    tilt: float = 0.0,
    scale: float = 1.0,
    unlabeled: bool = False,
    progress: Callable[[float], None] | None = None,
) -> int:
    """
    Write a bag of the scene's markers on /markers, and its exact motion on /kinpole/truth/....

    `rate` in Hz, `duration` in s; `noise` is the standard deviation (m) of white noise on both
    coordinates of every marker, `dropout` the probability that a marker is missing from a frame,
    `jitter` the standard deviation (s) of the instants of the frames from even
    intervals (the stamps give the true instants). The first frame is taken at 1 s.

    What follows spoils the bag as real rigs do; the same seed has the same noise with and without.
    `arrival`: stamps are late by an exponential time of this mean (s). Frames come in the order in
    which they were taken, so one that overtakes waits for those before it, and is stamped 1 ns
    after the last. `tilt`: the plane is turned about the x axis by so many degrees, its normal is
    (0, -sin, cos) of it, and there is noise along the normal too. `scale`: markers are in units of
    which so many make 1 m. `unlabeled`: the points of a frame come in random order without names,
    and one that is missing leaves no gap; a marker_array counts its ids anew in each frame.

    With a `message` of poses (pose_stamped, body_poses, tf) these are fitted to the markers of each
    body, as motion capture does, if none of them is missing: as noisy as that makes them. A
    pose_stamped is of the first body, and frames on /tf have the names of the bodies.

    The exact motion is that of the instant of capture under the stamp of its frame, in m, in the
    frame of the markers: tilted, poles are points of the tilted plane, vectors lie along its
    normal, and a body's own z axis too. Returns the number of frames. Raises BagError for a value
    out of range or an output that cannot be written.
    """
    from kinpole_ros.mechanism import marker_positions

    _check(rate, duration, noise, seed, dropout, jitter, message, arrival, tilt, scale)
    if unlabeled and message in POSE_TYPES:
        raise BagError(
            f'--unlabeled is of markers, and --message {message} of poses; leave out one'
        )
    if not scene.markers:
        raise BagError(
            f'scene {scene.name} has no markers to be seen; add them, as markers: '
            '{BODY: {m1: [0, 0], m2: [0.1, 0]}}'
        )
    generator = np.random.default_rng(seed)
    count = max(1, round(duration * rate))
    times = np.arange(count) / rate
    if jitter > 0:
        times = np.sort(times + jitter * generator.standard_normal(count))
    # Each has numbers of its own: to spoil a bag one way changes nothing else in it.
    delays, heights, orders = np.random.default_rng((seed, 1)).spawn(3)
    late = arrival * delays.standard_exponential(count)
    length = times[-1] - times[0] + late.max()
    if length > _LONGEST:
        raise BagError(
            f'--rate, --duration, --arrival and --jitter make a bag of {length:g} s; it must be at '
            f'most {_LONGEST:g} s'
        )
    captured = _increasing(np.round((1.0 + times - times[0]) * 1e9).astype(np.int64))
    # The motion is that of whole ns too.
    motion = scene.motion((captured - captured[0]) * 1e-9)
    stamps = _increasing(captured + np.round(late * 1e9).astype(np.int64))
    bodies = tuple(scene.markers)
    names = [name for body in bodies for name in scene.marker_names[body]]
    flat = [marker_positions(motion[body], scene.markers[body]) for body in bodies]
    points = np.zeros((count, len(names), 3))
    points[..., :2] = np.concatenate(flat, axis=1)
    points[..., :2] += noise * generator.standard_normal((count, len(names), 2))
    points[generator.random((count, len(names))) < dropout] = np.nan
    turn = _about_x(np.deg2rad(tilt))
    if tilt:
        points[..., 2] += noise * heights.standard_normal((count, len(names)))
        points = points @ turn.T
    poses = _poses(scene, points, tilt, turn, scale) if message in POSE_TYPES else None
    points *= scale
    if unlabeled:
        order = orders.permuted(np.tile(np.arange(len(names)), (count, 1)), axis=1)
        points = np.take_along_axis(points, order[..., None], axis=1)

    position = np.stack([motion[body].position for body in bodies], axis=-1)  # (5, T, B)
    angle = np.stack([motion[body].angle for body in bodies], axis=-1)
    size = np.array([_diameter(scene.markers[body]) for body in bodies])
    position_covariance = _diagonal((_EXACT * (np.abs(position).max(axis=1) + size)) ** 2)
    angle_covariance = _diagonal((_EXACT * np.abs(angle).max(axis=1)) ** 2)
    outputs = [
        row
        for row in result_outputs(bodies, 'xy')
        if row.message_type in _DOUBLES and not row.topic.endswith('/deviation')
    ]
    with in_place_of(output) as part_file, BagWriter(part_file, name=output) as writer:
        for first in range(0, count, _AT_ONCE):
            part = slice(first, min(first + _AT_ONCE, count))
            if poses is None:
                markers = [
                    serialize_message(_markers(message, stamp, None if unlabeled else names, seen))
                    for stamp, seen in zip(stamps[part].tolist(), points[part], strict=True)
                ]
            else:
                markers = [
                    poses_data(message, stamp, _FRAME, bodies, seen)
                    for stamp, seen in zip(stamps[part].tolist(), poses[part], strict=True)
                ]
            shape = (part.stop - part.start, len(bodies))
            wide = (5, 5, *shape)
            arrays = {
                'stamp': stamps[part],
                'position': position[:, part],
                'angle': angle[:, part],
                'position_covariance': np.broadcast_to(position_covariance[:, :, None], wide),
                'angle_covariance': np.broadcast_to(angle_covariance[:, :, None], wide),
                'size': np.broadcast_to(size, shape),
                **dict.fromkeys(('height', 'span', 'degree'), np.zeros(shape)),
                'missing': np.full(shape, '', object),
            }
            truth = Estimate.of_arrays(arrays, _FRAME, bodies)
            columns = result_columns(outputs, truth, f'/{NODE_NAME}/truth', stamps[part])
            if tilt:
                columns = (
                    (topic, kind, at, _turned(kind, data, turn))
                    for topic, kind, at, data in columns
                )
            topic = '/tf' if message == 'tf' else '/markers'
            of_markers = topic, INPUT_TYPES[message], stamps[part].tolist(), markers
            writer.write_many([of_markers, *columns])
            if progress is not None:
                progress(part.stop / count)
    return count


def _check(
    rate: float,
    duration: float,
    noise: float,
    seed: int,
    dropout: float,
    jitter: float,
    message: str,
    arrival: float,
    tilt: float,
    scale: float,
) -> None:
    wrong = [
        ('--rate', rate, 'more than 0 Hz, and 1e9 Hz at most', 0 < rate <= 1e9),
        ('--duration', duration, 'more than 0 s', 0 < duration < np.inf),
        ('--noise', noise, '0 m or more', 0 <= noise < np.inf),
        ('--dropout', dropout, 'from 0 to 1', 0 <= dropout <= 1),
        ('--jitter', jitter, '0 s or more', 0 <= jitter < np.inf),
        ('--seed', seed, '0 or more', seed >= 0),
        ('--message', message, f'one of {", ".join(INPUT_TYPES)}', message in INPUT_TYPES),
        ('--arrival', arrival, '0 s or more', 0 <= arrival < np.inf),
        ('--tilt', tilt, 'from -180 to 180 degrees', -180 <= tilt <= 180),
        ('--scale', scale, 'from 1e-9 to 1e9 units per m', 1e-9 <= scale <= 1e9),
        ('--rate times --duration', rate * duration, '1e8 at most', rate * duration <= 1e8),
    ]
    for name, value, allowed, good in wrong:
        if not good:
            raise BagError(f'{name} is {value}; it must be {allowed}')


def _increasing(stamps: np.ndarray) -> np.ndarray:
    """Stamps (T,), ns, all different and in order: each waits for those before it."""
    count = np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - count) + count)


def _markers(kind: str, stamp: int, names: list[str] | None, points: np.ndarray) -> Any:
    """A message of the markers (n, 3); without names, of those that are seen, under none."""
    if names is None:
        points = points[np.isfinite(points[:, 0])]
        names = [''] * len(points)
    return to_message(kind, stamp, _FRAME, names, points)


def _poses(
    scene: 'Scene', points: np.ndarray, tilt: float, turn: np.ndarray, scale: float
) -> np.ndarray:
    """
    Poses (T, B, 7) fitted to the markers (T, n, 3) of each body: points and quaternions.

    The plane of the markers is turned by `tilt`, deg, as the matrix `turn` does. NaN where a marker
    is missing.
    """
    flat = points @ turn if tilt else points
    flat = flat[..., 0] + 1j * flat[..., 1]
    found, first = np.full((len(points), len(scene.markers), 7), np.nan), 0
    for b, markers in enumerate(scene.markers.values()):
        own = flat[:, first : first + len(markers)]
        first += len(markers)
        shape = np.asarray(markers) @ (1, 1j)
        fit = fit_pose(own, shape, np.ones(len(shape)))
        place = np.stack((fit.position.real, fit.position.imag, np.zeros(len(own))), axis=1)
        found[:, b, :3] = scale * (place @ turn.T)
        half, lean = fit.angle / 2, np.deg2rad(tilt) / 2
        # About z by the angle, and then about x.
        found[:, b, 3], found[:, b, 4] = np.sin(lean) * np.cos(half), -np.sin(lean) * np.sin(half)
        found[:, b, 5], found[:, b, 6] = np.cos(lean) * np.sin(half), np.cos(lean) * np.cos(half)
    return found


def _about_x(angle: float) -> np.ndarray:
    """The matrix (3, 3) that turns vectors about the x axis by `angle`, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])


def _turned(kind: type, data: Sequence[bytes], turn: np.ndarray) -> list[bytes]:
    """
    The messages of one topic with their points and vectors turned by `turn` (3, 3), about x.

    Of an Odometry the body's own axes turn with it, so that its twist, which is in these, stays.
    """
    rows = np.frombuffer(b''.join(data), np.uint8).reshape(len(data), -1).copy()
    tail = rows[:, -8 * _DOUBLES[kind] :]
    figures = tail.copy().view('<f8')
    figures[:, :3] = figures[:, :3] @ turn.T
    if kind is _ODOMETRY:
        half = np.arctan2(turn[2, 1], turn[1, 1]) / 2
        # Quaternions: (cos half, sin half, 0, 0) times (w, x, y, z) of the body in its plane.
        x, y, z, w = (part.copy() for part in figures[:, 3:7].T)
        cos, sin = np.cos(half), np.sin(half)
        figures[:, 3:7] = np.stack(
            (cos * x + sin * w, cos * y - sin * z, cos * z + sin * y, cos * w - sin * x), axis=1
        )
        both = np.kron(np.eye(2), turn)
        covariance = figures[:, 7:43].reshape(-1, 6, 6)
        figures[:, 7:43] = (both @ covariance @ both.T).reshape(-1, 36)
    tail[...] = figures.view(np.uint8)
    return [row.tobytes() for row in rows]


def _diameter(points: np.ndarray) -> float:
    """Twice the root mean square distance (m) of markers (n, 2) from their mean."""
    return 2 * float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _diagonal(variances: np.ndarray) -> np.ndarray:
    """Covariances (K, K, B) of independent orders from their variances (K, B)."""
    return np.asarray(np.eye(len(variances))[..., None] * variances)
