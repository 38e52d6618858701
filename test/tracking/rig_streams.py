"""Streams of markers of a crank and a coupler, each spoiled in one way, as real rigs spoil them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.plane import plane_along

FRAMES, RATE = 500, 100.0
NAMES = tuple('01234567')
SHAPE = np.array([0, 0.1, 0.05 + 0.07j, -0.03 + 0.04j])
PARAMETERS = {
    'bodies': ['crank', 'coupler'],
    'crank.markers': list('0123'),
    'coupler.markers': list('4567'),
    'window': 0.3,
    'lag': 0.1,
}


class Stream(NamedTuple):
    """Parameters, and frames in parts of one layout."""

    parameters: dict[str, Any]
    parts: list[MarkerFrames]

    def blocks(self, size: int) -> list[MarkerFrames]:
        """Return the frames in blocks of at most so many."""
        return [
            part_of(part, slice(k, k + size))
            for part in self.parts
            for k in range(0, len(part.stamps), size)
        ]


def markers(seed: int, noise: float = 1e-4) -> np.ndarray:
    """Markers (T, 8) of both bodies, complex, m."""
    t, rng = np.arange(FRAMES) / RATE, np.random.default_rng(seed)
    crank, coupler = np.exp(2j * np.pi * t), np.exp(0.5j * np.sin(3 * t))
    points = np.concatenate(
        (crank[:, None] * SHAPE, 0.2 * crank[:, None] + coupler[:, None] * 2 * SHAPE.conj()), axis=1
    )
    return points + noise * (rng.normal(size=(*points.shape, 2)) @ (1, 1j))


def frames(
    points: np.ndarray, stamps: np.ndarray | None = None, names: tuple[str, ...] = NAMES
) -> MarkerFrames:
    """Frames of markers (T, n) in the plane xy, at even stamps unless others are given."""
    if stamps is None:
        stamps = 1_000_000_000 + np.arange(len(points)) * round(1e9 / RATE)
    space = np.stack((points.real, points.imag, np.where(np.isnan(points), np.nan, 0.0)), axis=-1)
    return MarkerFrames(stamps, 'map', names, space)


def usual() -> Stream:
    return Stream(PARAMETERS, [frames(markers(0))])


def outliers() -> Stream:
    points, rng = markers(1), np.random.default_rng(1)
    for k in rng.choice(FRAMES, 40, replace=False):
        points[k, rng.integers(8)] += 0.03 * np.exp(2j * np.pi * rng.random())
    for k in rng.choice(FRAMES, 10, replace=False):
        points[k, rng.choice(8, 2, replace=False)] += 0.05
    return Stream(PARAMETERS, [frames(points)])


def exchanged() -> Stream:
    points = markers(2)
    for k in (200, 250, 251, 252, 300):
        points[k, [0, 1]] = points[k, [1, 0]]
    points[350:400, [1, 5]] = points[350:400, [5, 1]]
    points[420:, [4, 6]] = points[420:, [6, 4]]
    points[320:322, :4] = points[320:322, :4].conj()
    return Stream(PARAMETERS, [frames(points)])


def exchanged_at_the_start() -> Stream:
    points = markers(3)
    points[:9, [0, 1]] = points[:9, [1, 0]]
    points[12, 2] += 0.2
    return Stream(PARAMETERS, [frames(points)])


def wrong_places() -> Stream:
    points = markers(4)
    points[[200, 240, 241, 300, 301, 302], :4] += 0.2
    points[400:, :4] += 0.1
    points[350:352, 4:] *= np.exp(2.5j)
    return Stream(PARAMETERS, [frames(points)])


def hidden() -> Stream:
    points, rng = markers(5), np.random.default_rng(5)
    points[150:190, :4] = points[250:300, 5] = points[350:420] = np.nan
    for k in rng.choice(FRAMES, 60, replace=False):
        points[k, rng.integers(8)] = np.nan
    return Stream(PARAMETERS, [frames(points)])


def _late(seed: int, ordered: bool, mode: str) -> Stream:
    rng = np.random.default_rng(seed)
    late = rng.exponential(2.5e6, FRAMES)
    late[rng.choice(FRAMES, 15, replace=False)] += 1.2e7
    stamps = (1e9 + np.arange(FRAMES) * 1e9 / RATE + late).astype(np.int64)
    kept = np.sort(rng.choice(FRAMES, FRAMES - 20, replace=False))
    stamps = np.maximum.accumulate(stamps[kept]) if ordered else stamps[kept]
    return Stream(PARAMETERS | {'stamps': mode}, [frames(markers(seed)[kept], stamps)])


def late() -> Stream:
    return _late(6, True, 'auto')


def late_of_arrival() -> Stream:
    return _late(7, False, 'arrival')


def rounded() -> Stream:
    stamps = np.round(1000 + np.arange(FRAMES) * 1000 / RATE / 1.111).astype(np.int64)
    return Stream(PARAMETERS, [frames(markers(8), stamps * 1_000_000)])


def clock_jumps() -> Stream:
    stamps = 1_000_000_000 + np.arange(FRAMES) * round(1e9 / RATE)
    stamps[100] = stamps[99]
    stamps[150] -= 30_000_000
    stamps[250:] += 2_000_000_000
    stamps[400:] -= 1_500_000_000
    return Stream(PARAMETERS, [frames(markers(9), stamps)])


def without_names() -> Stream:
    points, rng = markers(10), np.random.default_rng(10)
    shapes = {'crank.shape': SHAPE, 'coupler.shape': 2 * SHAPE.conj()}
    flat = {name: shape.view(float).tolist() for name, shape in shapes.items()}
    order = np.array([rng.permutation(8) for _ in range(FRAMES)])
    points = np.take_along_axis(points, order, axis=1)
    for k in range(200, 250):
        points[k, rng.integers(8)] = np.nan
    return Stream(PARAMETERS | {'marker_identity': 'shape'} | flat, [frames(points)])


def incomplete_clouds() -> Stream:
    points = markers(11)
    fewer = frames(np.delete(points[200:300], 2, axis=1), frames(points).stamps[200:300], NAMES[:7])
    whole = frames(points)
    return Stream(PARAMETERS, [part_of(whole, slice(200)), fewer, part_of(whole, slice(300, None))])


def fitted_plane() -> Stream:
    points, rng = markers(12), np.random.default_rng(12)
    space = plane_along((0.3, 0.2, 0.9)).in_space(
        points, 0.3 + 1e-4 * rng.normal(size=points.shape)
    )
    return Stream(PARAMETERS | {'plane': 'fit'}, [frames(points)._replace(points=space)])


def tilted_poses() -> Stream:
    t, rng, tilt = np.arange(FRAMES) / RATE, np.random.default_rng(13), 0.3
    angle = np.stack((2 * np.pi * t, 0.5 * np.sin(3 * t)), 1) + 1e-3 * rng.normal(size=(FRAMES, 2))
    place = np.stack((0.2 * np.exp(2j * np.pi * t), 0.3 * np.exp(1j * t)), 1)
    place = place + 1e-4 * (rng.normal(size=(FRAMES, 2, 2)) @ (1, 1j))
    cosine, sine = np.cos(angle), np.sin(angle)
    x = np.stack((cosine, sine, 0 * cosine), -1)
    y = np.stack((-sine * np.cos(tilt), cosine * np.cos(tilt), 0 * cosine + np.sin(tilt)), -1)
    given = {'marker_type': 'body_poses', 'crank.markers': ['a'], 'coupler.markers': ['b']}
    poses = frames(place, names=('a', 'b'))._replace(axes=np.stack((x, y), 2))
    return Stream(PARAMETERS | given, [poses])


def new_markers() -> Stream:
    points = markers(14)
    whole = frames(points)
    parts = [
        frames(points[:150, :3], whole.stamps[:150], NAMES[:3]),
        frames(points[150:300, :4], whole.stamps[150:300], NAMES[:4]),
        frames(points[300:, [3, 0, 1]], whole.stamps[300:], ('3', '0', '1')),
    ]
    return Stream({'window': 0.3, 'lag': 0.1}, parts)


def listed_for_another_body() -> Stream:
    points = markers(15)
    points[:, [1, 5]] = points[:, [5, 1]]
    return Stream(PARAMETERS, [frames(points)])


def soft() -> Stream:
    points, t = markers(16), np.arange(FRAMES) / RATE
    points[:, 1] += 0.004 * np.sin(9 * t)
    points[:, 6] += 0.006 * np.cos(5 * t)
    return Stream(PARAMETERS, [frames(points)])


def noisy_marker() -> Stream:
    points, rng = markers(17), np.random.default_rng(17)
    points[:, 2] += 3e-3 * (rng.normal(size=(FRAMES, 2)) @ (1, 1j))
    return Stream(PARAMETERS, [frames(points)])


def renamed() -> Stream:
    points, names = markers(18), tuple('abcdefgh')
    stamps = frames(points).stamps
    order = [0, 2, 1, 3, 4, 5, 6, 7]
    parts = [
        frames(points[:150], stamps[:150], names),
        frames(points[150:250, order], stamps[150:250], names),
        frames(points[250:400], stamps[250:400], (*names[:3], 'z', *names[4:])),
        frames(points[400:, [4, 1, 2, 3, 0, 5, 6, 7]], stamps[400:], names),
    ]
    given = {'crank.markers': list('abcd'), 'coupler.markers': list('efgh')}
    return Stream(PARAMETERS | given, parts)


def impacts() -> Stream:
    points, t = markers(19), np.arange(FRAMES) / RATE
    points[:, 4:] += 0.5 * np.abs(np.sin(4 * t))[:, None]
    return Stream(PARAMETERS, [frames(points)])


STREAMS: tuple[Callable[[], Stream], ...] = (
    usual,
    outliers,
    exchanged,
    exchanged_at_the_start,
    wrong_places,
    hidden,
    late,
    late_of_arrival,
    rounded,
    clock_jumps,
    without_names,
    incomplete_clouds,
    fitted_plane,
    tilted_poses,
    new_markers,
    listed_for_another_body,
    soft,
    noisy_marker,
    renamed,
    impacts,
)
