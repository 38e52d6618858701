"""Scenes whose motion is known exactly, as a tracker sees them, and what it must make of them."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from stretches import instants, one_frame, stretches

from kinpole_ros import planar
from kinpole_ros.mechanism import BodyMotion, load_scene, marker_positions
from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.estimate import Estimate
from kinpole_ros.tracking.frame import MarkerFrames
from kinpole_ros.tracking.reasons import TABLE
from kinpole_ros.tracking.tracker import Tracker
from kinpole_ros.tracking.values import POLE_NAMES

START, STEP = 10**18, 5_000_000
# Right-handed: the normal completes the two axes of the plane.
AXES = {'xy': (0, 1, 2), 'yz': (1, 2, 0), 'zx': (2, 0, 1)}
SCENES = ('rolling_wheel', 'cardan', 'four_bar')
PINNED = ('crank', 'rocker')
# A kite, and a rectangle, which half a turn leaves as it is.
KITE = np.array([0.13 + 0.02j, -0.03 + 0.1j, -0.12 - 0.05j, 0.05 - 0.11j])
RECTANGLE = np.array([0.1 + 0.06j, -0.1 + 0.06j, -0.1 - 0.06j, 0.1 - 0.06j])


class Record(NamedTuple):
    """A scene as seen: the frames, what moves how at any stamp, and the settings."""

    frames: list[MarkerFrames]
    truth: Any  # stamps -> {body: BodyMotion}
    values: dict[str, Any]


def record(
    scene_name: str,
    count: int = 200,
    turn: complex = 1.0,
    shift: complex = 0.0,
    noise: float = 0.0,
    drop: float = 0.0,
    shuffle: bool = False,
    plane: str = 'xy',
    step: float = STEP,
    jitter: float = 0.0,
) -> Record:
    """A scene turned and scaled by `turn`, moved by `shift`, and seen with the faults named."""
    scene = load_scene(scene_name)
    rng = np.random.default_rng(0)

    def truth(stamps: Iterable[int]) -> dict[str, BodyMotion]:
        motion = scene.motion((np.array(list(stamps), np.int64) - START) * 1e-9)
        moved = {}
        for body, (position, angle) in motion.items():
            placed, turned = turn * position, angle.copy()
            placed[0] += shift
            turned[0] += np.angle(turn)
            moved[body] = BodyMotion(placed, turned)
        return moved

    off = jitter * np.random.default_rng(1).normal(size=count)
    stamps = [START + round(step * (k + late)) for k, late in enumerate(off.tolist())]
    motion = truth(stamps)
    points = np.concatenate(
        [marker_positions(motion[body], abs(turn) * scene.markers[body]) for body in scene.markers],
        axis=1,
    )
    points = points + noise * rng.normal(size=points.shape)
    first, second, normal = AXES[plane]
    solid = np.empty((*points.shape[:2], 3))
    solid[..., first], solid[..., second], solid[..., normal] = points[..., 0], points[..., 1], 0.7
    solid[rng.random(solid.shape[:2]) < drop] = np.nan
    names = np.array([name for body in scene.markers for name in scene.marker_names[body]])
    frames = []
    for stamp, rows in zip(stamps, solid, strict=True):
        order = rng.permutation(len(names)) if shuffle else np.arange(len(names))
        frames.append(one_frame(stamp, 'world', tuple(names[order]), rows[order]))
    values: dict[str, Any] = {
        'bodies': list(scene.markers),
        'plane': plane,
        'window': 0.5,
        'lag': 0.1,
    }
    for body in scene.markers:
        values[f'{body}.markers'] = list(scene.marker_names[body])
    return Record(frames, truth, values)


def follow(
    frames: Sequence[MarkerFrames], values: dict[str, Any], order: int | None = 4, every: int = 9
) -> tuple[Tracker, list[Estimate]]:
    """Run a tracker; ask for estimates at every so manieth frame only, since they take time."""
    tracker = Tracker(settings_from(values))
    found: list[Estimate] = []
    for k in range(0, len(frames), every):
        found += instants(tracker.add(frames[k], order))
        for part in stretches(frames[k + 1 : k + every]):
            tracker.add(part, None)
    return tracker, found


def check(
    seen: Record,
    found: list[Estimate],
    poles: tuple[float, ...] = (1e-5, 1e-5, 1e-5, 1e-5),
    curvature: float = 1e-3,
) -> None:
    """All poles are there, to `poles` of the body's size, and curvature to `curvature`."""
    assert found
    truth = seen.truth(estimate.stamp for estimate in found)
    for b, body in enumerate(found[0].bodies):
        position, angle = truth[body]
        known = [k for k, estimate in enumerate(found) if not estimate.missing[b]]
        # A body of four markers is hardly ever lost, whatever is dropped.
        assert len(known) > 0.8 * len(found)
        for k in known:
            estimate, here = found[k], (position[:, k], angle[:, k])
            size = estimate.size[b]
            for order in range(1, 5):
                # As the motion of a point one size away from the pole, at 1 rev/s.
                allowed = poles[order - 1] * (2 * np.pi) ** order * 10
                assert estimate.rate(order).value[b] == pytest.approx(here[1][order], abs=allowed)
                pole = estimate.pole(order)
                assert pole.determined[b]
                error = np.abs(pole.value[b] - planar.pole(order, *here).value)
                assert error < poles[order - 1] * size, (body, POLE_NAMES[order - 1], k)
            u = estimate.icr_velocity
            assert u.determined[b]
            expected = planar.icr_velocity(*here).value
            assert np.abs(u.value[b] - expected) < 1e-3 * max(size, np.abs(expected))
            kappa = estimate.centrode_curvature
            assert kappa.determined[b] == (body not in PINNED)
            if kappa.determined[b]:
                true = planar.centrode_curvature(*here).value.real
                error = np.abs(kappa.value[b] - true)
                assert error < curvature * max(abs(true), 1 / size), (body, k)
            if not kappa.determined[b]:
                reason = TABLE['ON_PIN' if estimate.pinned[b] else 'ICR_IN_NOISE'].text
                assert estimate.reasons(b)['centrode_curvature'] == reason


def two_bodies(count: int, speed: float, jitter: float, noise: float) -> MarkerFrames:
    """The one swings and sets off to go round, the other turns by `speed`, rad/s, and slides."""
    rng = np.random.default_rng(7)
    stamps = START + STEP * np.arange(count)
    stamps += np.rint(jitter * STEP * rng.uniform(-1, 1, count)).astype(np.int64)
    t = (stamps - START) * 1e-9
    later = np.maximum(t - 0.35, 0.0)
    one = 0.3 * np.exp(1j * np.sin(5 * t))[:, None] + np.exp(20j * later**2)[:, None] * KITE
    other = (0.2 * t + 1)[:, None] + np.exp(1j * speed * t)[:, None] * RECTANGLE
    points = np.zeros((count, 8, 3))
    flat = np.concatenate((one, other), axis=1)
    points[..., 0], points[..., 1] = flat.real, flat.imag
    points[..., :2] += noise * rng.normal(size=(count, 8, 2))
    return MarkerFrames(stamps, 'world', tuple('abcdefgh'), points)
