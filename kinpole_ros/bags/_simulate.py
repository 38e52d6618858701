"""
Bags with a known answer: the markers of a scene, and with them the exact motion.

On request they are as bad as those of real rigs: late stamps, a tilted plane, other units, points
without names in random order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinpole_ros.bags._bag_writer import BagWriter
from kinpole_ros.bags._files import BagError, in_place_of
from kinpole_ros.bags._marker_frames import NODE_NAME
from kinpole_ros.bags._result_columns import Column, result_columns
from kinpole_ros.messages import (
    INPUT_TYPES,
    message_class,
    poses_data,
    result_outputs,
    serialize_message,
    to_message,
)
from kinpole_ros.planar import fit_pose
from kinpole_ros.settings import POSE_TYPES
from kinpole_ros.tracking.estimate import Estimate

if TYPE_CHECKING:
    from kinpole_ros.mechanism import Scene

# Relative standard deviation of the truth: below it a pinned body's centrode is noise itself.
_EXACT = 1e-12
_FRAME = 'world'
_BLOCK_FRAMES = 1000  # written at once
_LONGEST = 2e9  # s; ROS stamps hold hardly more
_ODOMETRY = message_class('nav_msgs/msg/Odometry')
# The truth is written in messages of these types, as loci and covariances of an exact motion have
# no use. Their doubles, behind the header (and child_frame_id).
_DOUBLES = {
    _ODOMETRY: 85,
    message_class('geometry_msgs/msg/PointStamped'): 3,
    message_class('geometry_msgs/msg/Vector3Stamped'): 3,
}


@dataclass(frozen=True)
class SimulationOptions:
    """
    Options of `simulate`.

    Attributes
    ----------
    rate : float
        Frames per second (200).
    duration : float
        Length, s (5). The first frame is taken at 1 s.
    noise : float
        Standard deviation (m) of white noise on both coordinates of each marker.
    seed : int
        Of the random numbers. The noise is the same with and without the following options.
    dropout : float
        Probability that a marker is missing from a frame.
    jitter : float
        Standard deviation (s) of the instants of the frames from even intervals; the stamps give
        the true instants.
    message : str
        The type of messages, as the parameter `marker_type` ('marker_array'). Poses (pose_stamped,
        body_poses, tf) are fitted to the markers of each body, as motion capture does, if none of
        them is missing. A pose_stamped is of the first body, and frames on /tf have the names of
        the bodies.
    arrival : float
        Mean (s) of an exponential time by which stamps are late. Frames come in the order in which
        they were taken, so one that overtakes waits for those before it, and is stamped 1 ns after
        the last.
    tilt : float
        Angle (degrees) of the plane about the x axis. Its normal is (0, -sin, cos) of it, and there
        is noise along the normal too.
    scale : float
        Number of units of the markers in 1 m (1).
    unlabeled : bool
        Whether the points of a frame come in random order without names. A missing point leaves no
        gap; a marker_array counts its ids anew in each frame.

    """

    rate: float = 200.0
    duration: float = 5.0
    noise: float = 0.0
    seed: int = 0
    dropout: float = 0.0
    jitter: float = 0.0
    message: str = 'marker_array'
    arrival: float = 0.0
    tilt: float = 0.0
    scale: float = 1.0
    unlabeled: bool = False

    def check(self, scene: Scene) -> None:
        """Raise BagError for a value out of range, or a scene without markers."""
        frames, types = self.rate * self.duration, ', '.join(INPUT_TYPES)
        for name, value, allowed, is_allowed in (
            ('rate', self.rate, 'more than 0 Hz, and 1e9 Hz at most', 0 < self.rate <= 1e9),
            ('duration', self.duration, 'more than 0 s', 0 < self.duration < np.inf),
            ('noise', self.noise, '0 m or more', 0 <= self.noise < np.inf),
            ('dropout', self.dropout, 'from 0 to 1', 0 <= self.dropout <= 1),
            ('jitter', self.jitter, '0 s or more', 0 <= self.jitter < np.inf),
            ('seed', self.seed, '0 or more', self.seed >= 0),
            ('message', self.message, f'one of {types}', self.message in INPUT_TYPES),
            ('arrival', self.arrival, '0 s or more', 0 <= self.arrival < np.inf),
            ('tilt', self.tilt, 'from -180 to 180 degrees', -180 <= self.tilt <= 180),
            ('scale', self.scale, 'from 1e-9 to 1e9 units per m', 1e-9 <= self.scale <= 1e9),
            ('rate times --duration', frames, '1e8 at most', frames <= 1e8),
        ):
            if not is_allowed:
                raise BagError(f'--{name} is {value}; it must be {allowed}')
        if self.unlabeled and self.message in POSE_TYPES:
            raise BagError(
                f'--unlabeled is of markers, and --message {self.message} of poses; leave out one'
            )
        if not scene.markers:
            raise BagError(
                f'scene {scene.name} has no markers to be seen; add them, as markers: '
                '{BODY: {m1: [0, 0], m2: [0.1, 0]}}'
            )


def simulate(
    scene: Scene,
    output: str | Path,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> int:
    """
    Write a bag of the scene's markers on /markers, and its exact motion on /kinpole/truth/....

    The exact motion is that of the instant of capture under the stamp of its frame, in m, in the
    frame of the markers: tilted, poles are points of the tilted plane, vectors lie along its
    normal, and a body's own z axis too.

    Parameters
    ----------
    scene : Scene
        The scene.
    output : str or Path
        The .mcap file.
    progress : callable, optional
        Called with the fraction of frames written, 0 to 1.
    **options
        Those of `SimulationOptions`, by name.

    Returns
    -------
    int
        The number of frames.

    Raises
    ------
    BagError
        For a value out of range or an output that cannot be written.

    """
    spoil = SimulationOptions(**options)
    spoil.check(scene)
    generator = np.random.default_rng(spoil.seed)
    # These have numbers of their own: to spoil a bag one way changes nothing else in it.
    delays, heights, orders = np.random.default_rng((spoil.seed, 1)).spawn(3)
    captured, stamps = _capture_times(spoil, generator, delays)
    count, bodies = len(stamps), tuple(scene.markers)
    # The motion is that of whole ns too.
    motion = scene.motion((captured - captured[0]) * 1e-9)
    rotation = _x_rotation(np.deg2rad(spoil.tilt))
    names, seen = _seen(scene, motion, spoil, (generator, heights, orders), rotation)
    truth = _exact_arrays(scene, motion)
    with in_place_of(output) as part_file, BagWriter(part_file, name=output) as writer:
        for first in range(0, count, _BLOCK_FRAMES):
            part = slice(first, min(first + _BLOCK_FRAMES, count))
            messages = _messages(spoil, stamps[part], names, seen[part])
            exact = {name: array[..., part, :] for name, array in truth.items()}
            estimate = Estimate.of_arrays({'stamp': stamps[part], **exact}, _FRAME, bodies)
            topic = '/tf' if spoil.message == 'tf' else '/markers'
            column = topic, INPUT_TYPES[spoil.message], stamps[part].tolist(), messages
            writer.write_many([column, *_truth_columns(estimate, rotation)])
            if progress is not None:
                progress(part.stop / count)
    return count


def _truth_columns(estimate: Estimate, rotation: np.ndarray) -> Iterator[Column]:
    """Yield the messages of the exact motion, rotated by `rotation` (3, 3), about x."""
    outputs = [
        row
        for row in result_outputs(estimate.bodies, 'xy')
        if row.message_type in _DOUBLES and not row.topic.endswith('/deviation')
    ]
    is_tilted = bool((rotation != np.eye(3)).any())
    for name, kind, times, data in result_columns(
        outputs, estimate, f'/{NODE_NAME}/truth', estimate.stamp
    ):
        yield name, kind, times, _rotate_messages(kind, data, rotation) if is_tilted else data


def _capture_times(
    spoil: SimulationOptions, generator: np.random.Generator, delays: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return the instants of capture and the stamps, (T,), ns."""
    count = max(1, round(spoil.duration * spoil.rate))
    times = np.arange(count) / spoil.rate
    if spoil.jitter > 0:
        times = np.sort(times + spoil.jitter * generator.standard_normal(count))
    late = spoil.arrival * delays.standard_exponential(count)
    length = times[-1] - times[0] + late.max()
    if length > _LONGEST:
        raise BagError(
            f'--rate, --duration, --arrival and --jitter make a bag of {length:g} s; it must be at '
            f'most {_LONGEST:g} s'
        )
    captured = _increasing(np.round((1.0 + times - times[0]) * 1e9).astype(np.int64))
    return captured, _increasing(captured + np.round(late * 1e9).astype(np.int64))


def _increasing(stamps: np.ndarray) -> np.ndarray:
    """Delay stamps (T,), ns, such that each is later than those before it."""
    count = np.arange(len(stamps))
    return np.asarray(np.maximum.accumulate(stamps - count) + count)


def _seen(
    scene: Scene,
    motion: Any,
    spoil: SimulationOptions,
    generators: tuple[np.random.Generator, np.random.Generator, np.random.Generator],
    rotation: np.ndarray,
) -> tuple[Sequence[str], np.ndarray]:
    """
    Return names and points of markers (T, n, 3), or names and poses of bodies (T, B, 7).

    `generators` are of the noise in the plane, of that along its normal and of the order of points.
    """
    generator, heights, orders = generators
    points = _marker_points(scene, motion, spoil, generator, heights)
    if spoil.tilt:
        points = points @ rotation.T
    if spoil.message in POSE_TYPES:
        return tuple(scene.markers), _poses(scene, points, spoil, rotation)
    points *= spoil.scale
    if spoil.unlabeled:
        order = np.tile(np.arange(points.shape[1]), (len(points), 1))
        order = orders.permuted(order, axis=1)
        points = np.take_along_axis(points, order[..., None], axis=1)
    return [name for body in scene.markers for name in scene.marker_names[body]], points


def _marker_points(
    scene: Scene,
    motion: Any,
    spoil: SimulationOptions,
    generator: np.random.Generator,
    heights: np.random.Generator,
) -> np.ndarray:
    """Return the markers (T, n, 3), m, in a plane that is not tilted yet; NaN where missing."""
    from kinpole_ros.mechanism import marker_positions

    flat = [marker_positions(motion[body], markers) for body, markers in scene.markers.items()]
    xy = np.concatenate(flat, axis=1)
    points = np.zeros((*xy.shape[:2], 3))
    points[..., :2] = xy + spoil.noise * generator.standard_normal(xy.shape)
    points[generator.random(xy.shape[:2]) < spoil.dropout] = np.nan
    if spoil.tilt:
        points[..., 2] += spoil.noise * heights.standard_normal(xy.shape[:2])
    return points


def _exact_arrays(scene: Scene, motion: Any) -> dict[str, np.ndarray]:
    """Return the arrays (..., T, B) of an estimate of the motion, by name."""
    bodies = tuple(scene.markers)
    position = np.stack([motion[body].position for body in bodies], axis=-1)  # (5, T, B)
    angle = np.stack([motion[body].angle for body in bodies], axis=-1)
    size = np.array([_diameter(scene.markers[body]) for body in bodies])
    shape = position.shape[1:]

    def covariance(sigmas: np.ndarray) -> np.ndarray:
        """Return covariances (5, 5, T, B) of independent orders with these sigmas (5, B)."""
        diagonal = np.eye(5)[..., None] * (_EXACT * sigmas) ** 2
        return np.broadcast_to(diagonal[:, :, None], (5, 5, *shape))

    return {
        'position': position,
        'angle': angle,
        'position_covariance': covariance(np.abs(position).max(axis=1) + size),
        'angle_covariance': covariance(np.abs(angle).max(axis=1)),
        'size': np.broadcast_to(size, shape),
        **dict.fromkeys(('height', 'span', 'degree'), np.zeros(shape)),
    }


def _messages(
    spoil: SimulationOptions, stamps: np.ndarray, names: Sequence[str], seen: np.ndarray
) -> list[bytes]:
    """Return messages of what `_seen` returns; without names only of markers not missing."""
    messages = []
    for stamp, values in zip(stamps.tolist(), seen, strict=True):
        if spoil.message in POSE_TYPES:
            messages.append(poses_data(spoil.message, stamp, _FRAME, names, values))
            continue
        if spoil.unlabeled:
            values = values[np.isfinite(values[:, 0])]
            names = [''] * len(values)
        message = to_message(spoil.message, stamp, _FRAME, names, values)
        messages.append(serialize_message(message))
    return messages


def _poses(
    scene: Scene, points: np.ndarray, spoil: SimulationOptions, rotation: np.ndarray
) -> np.ndarray:
    """
    Return poses (T, B, 7), points and quaternions, fitted to the markers (T, n, 3) of each body.

    NaN where a marker is missing. `rotation` (3, 3) tilts the plane of the markers.
    """
    flat = points @ rotation if spoil.tilt else points
    flat = flat[..., 0] + 1j * flat[..., 1]
    poses, first = np.full((len(points), len(scene.markers), 7), np.nan), 0
    for b, markers in enumerate(scene.markers.values()):
        own = flat[:, first : first + len(markers)]
        first += len(markers)
        shape = np.asarray(markers) @ (1, 1j)
        fit = fit_pose(own, shape, np.ones(len(shape)))
        position = np.stack((fit.position.real, fit.position.imag, np.zeros(len(own))), axis=1)
        poses[:, b, :3] = spoil.scale * (position @ rotation.T)
        half, lean = fit.angle / 2, np.deg2rad(spoil.tilt) / 2
        # About z by the angle, and then about x.
        poses[:, b, 3], poses[:, b, 4] = np.sin(lean) * np.cos(half), -np.sin(lean) * np.sin(half)
        poses[:, b, 5], poses[:, b, 6] = np.cos(lean) * np.sin(half), np.cos(lean) * np.cos(half)
    return poses


def _x_rotation(angle: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) about the x axis by `angle`, rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])


def _rotate_messages(kind: type, data: Sequence[bytes], rotation: np.ndarray) -> list[bytes]:
    """
    Rotate the points and vectors in messages of one topic by `rotation` (3, 3), about x.

    The body's own axes of an Odometry are rotated too, so its twist, which is along these, stays.
    """
    rows = np.frombuffer(b''.join(data), np.uint8).reshape(len(data), -1).copy()
    tail = rows[:, -8 * _DOUBLES[kind] :]
    values = tail.copy().view('<f8')
    values[:, :3] = values[:, :3] @ rotation.T
    if kind is _ODOMETRY:
        half = np.arctan2(rotation[2, 1], rotation[1, 1]) / 2
        # Quaternions: (cos half, sin half, 0, 0) times (w, x, y, z) of the body in its plane.
        x, y, z, w = values[:, 3:7].T.copy()
        cos, sin = np.cos(half), np.sin(half)
        values[:, 3:7] = np.stack(
            (cos * x + sin * w, cos * y - sin * z, cos * z + sin * y, cos * w - sin * x), axis=1
        )
        pose_rotation = np.kron(np.eye(2), rotation)
        covariance = values[:, 7:43].reshape(-1, 6, 6)
        values[:, 7:43] = (pose_rotation @ covariance @ pose_rotation.T).reshape(-1, 36)
    tail[...] = values.view(np.uint8)
    return [row.tobytes() for row in rows]


def _diameter(points: np.ndarray) -> float:
    """Return twice the root mean square distance (m) of markers (n, 2) from their mean."""
    return 2 * float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
