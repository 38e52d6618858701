"""Bags with a known answer: the markers of a scene, and beside them the exact motion."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PointStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message

from kinpole_ros.bags._reader import BagError
from kinpole_ros.bags._replay import NODE_NAME, result_columns
from kinpole_ros.bags._writer import BagWriter
from kinpole_ros.estimate import Estimate
from kinpole_ros.mechanism import Scene, marker_positions
from kinpole_ros.messages import MARKER_TYPES, result_outputs, to_message

# Exact to so many digits: below it the answers themselves are noise (a pinned body's centrode).
_EXACT = 1e-12
_FRAME = 'world'
# Frames that are written together.
_AT_ONCE = 1000
# ROS stamps hold hardly more, in s.
_LONGEST = 2e9
# Loci and covariances of an exact motion say nothing more.
_EXACT_TYPES = (Odometry, PointStamped, Vector3Stamped)


def simulate(
    scene: Scene,
    output: str | Path,
    rate: float = 200.0,
    duration: float = 5.0,
    noise: float = 0.0,
    seed: int = 0,
    dropout: float = 0.0,
    jitter: float = 0.0,
    message: str = 'marker_array',
    progress: Callable[[float], None] | None = None,
) -> int:
    """
    Write a bag of the scene's markers on /markers, and its exact motion on /kinpole/truth/....

    `rate` in Hz, `duration` in s; `noise` is the standard deviation (m) of white noise on both
    coordinates of every marker, `dropout` the probability that a marker is missing from a frame,
    `jitter` the standard deviation (s) by which the instants of the frames leave the even beat (the
    stamps tell the true instants). The first stamp is 1 s. Returns the number of frames. Raises
    BagError for a value out of range or an output that cannot be written.
    """
    _check(rate, duration, noise, seed, dropout, jitter, message)
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
    length = times[-1] - times[0]
    if length > _LONGEST:
        raise BagError(
            f'--rate, --duration and --jitter make a bag of {length:g} s; it must be at most '
            f'{_LONGEST:g} s'
        )
    stamps = np.round((1.0 + times - times[0]) * 1e9).astype(np.int64)
    # Stamps are whole ns and all different; the motion is that of the stamps.
    stamps = np.maximum.accumulate(stamps - np.arange(count)) + np.arange(count)
    motion = scene.motion((stamps - stamps[0]) * 1e-9)
    bodies = tuple(scene.markers)
    names = [name for body in bodies for name in scene.marker_names[body]]
    flat = [marker_positions(motion[body], scene.markers[body]) for body in bodies]
    points = np.zeros((count, len(names), 3))
    points[..., :2] = np.concatenate(flat, axis=1)
    points[..., :2] += noise * generator.standard_normal((count, len(names), 2))
    points[generator.random((count, len(names))) < dropout] = np.nan

    position = np.stack([motion[body].position for body in bodies], axis=-1)  # (5, T, B)
    angle = np.stack([motion[body].angle for body in bodies], axis=-1)
    size = np.array([_diameter(scene.markers[body]) for body in bodies])
    position_covariance = _diagonal((_EXACT * (np.abs(position).max(axis=1) + size)) ** 2)
    angle_covariance = _diagonal((_EXACT * np.abs(angle).max(axis=1)) ** 2)
    outputs = [row for row in result_outputs(bodies, 'xy') if row.message_type in _EXACT_TYPES]
    with BagWriter(output) as writer:
        for first in range(0, count, _AT_ONCE):
            part = slice(first, min(first + _AT_ONCE, count))
            markers = [
                serialize_message(to_message(message, stamp, _FRAME, names, seen))
                for stamp, seen in zip(stamps[part].tolist(), points[part], strict=True)
            ]
            shape = (part.stop - part.start, len(bodies))
            wide = (5, 5, *shape)
            truth = Estimate(
                stamps[part],
                _FRAME,
                bodies,
                position[:, part],
                angle[:, part],
                np.broadcast_to(position_covariance[:, :, None], wide),
                np.broadcast_to(angle_covariance[:, :, None], wide),
                np.broadcast_to(size, shape),
                np.zeros(shape),
                np.zeros(shape),
                np.zeros(shape),
                np.full(shape, '', object),
            )
            columns = result_columns(outputs, truth, f'/{NODE_NAME}/truth', stamps[part])
            of_markers = '/markers', MARKER_TYPES[message], stamps[part].tolist(), markers
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
) -> None:
    wrong = [
        ('--rate', rate, 'more than 0 Hz, and 1e9 Hz at most', 0 < rate <= 1e9),
        ('--duration', duration, 'more than 0 s', 0 < duration < np.inf),
        ('--noise', noise, '0 m or more', 0 <= noise < np.inf),
        ('--dropout', dropout, 'from 0 to 1', 0 <= dropout <= 1),
        ('--jitter', jitter, '0 s or more', 0 <= jitter < np.inf),
        ('--seed', seed, '0 or more', seed >= 0),
        ('--message', message, f'one of {", ".join(MARKER_TYPES)}', message in MARKER_TYPES),
        ('--rate times --duration', rate * duration, '1e8 at most', rate * duration <= 1e8),
    ]
    for name, value, allowed, good in wrong:
        if not good:
            raise BagError(f'{name} is {value}; it must be {allowed}')


def _diameter(points: np.ndarray) -> float:
    """Twice the root mean square distance (m) of markers (n, 2) from their mean."""
    return 2 * float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))


def _diagonal(variances: np.ndarray) -> np.ndarray:
    """Covariances (K, K, B) of independent orders from their variances (K, B)."""
    return np.asarray(np.eye(len(variances))[..., None] * variances)
