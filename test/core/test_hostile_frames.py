"""Frames with gaps, exchanges and coordinates up to 1e14 m: compiled code has finite results."""

import numpy as np
import pytest
from recordings import KITE

from kinpole_ros.settings import settings_from
from kinpole_ros.tracking.frame import MarkerFrames, part_of
from kinpole_ros.tracking.tracker import Tracker

BODIES = {'kite': list('abcd'), 'other': list('efgh')}
NAMES = tuple('abcdefgh')
EXTREMES = np.nan, 0.0, 1e-308, 1e9, -1e14, np.inf, -np.inf, 1e160, -1e300


def hostile_frames(rng: np.random.Generator, count: int) -> MarkerFrames:
    """Two bodies with gaps, jitter and noise, of which up to a fifth of the frames is spoiled."""
    gaps = (rng.random(count) < 0.02) * rng.integers(1, 400_000_000, count)
    stamps = 10**18 + np.cumsum(5_000_000 + gaps) + rng.integers(0, 2_000_000, count)
    seconds = (stamps - stamps[0]) * 1e-9
    turn = np.exp(1j * 10 ** rng.uniform(-1, 1.5) * seconds)[:, None]
    center = 0.2 * np.exp(4j * seconds)[:, None]
    flat = np.concatenate((center + turn * KITE, center + KITE / turn), axis=1)
    points = np.stack((flat.real, flat.imag, 0 * flat.real), axis=-1)
    points += 10 ** rng.uniform(-6, -2) * rng.normal(size=points.shape)
    for _ in range(int(10 ** rng.uniform(-3, -0.7) * count)):
        k, marker = rng.integers(count), rng.integers(len(NAMES))
        match rng.integers(6):
            case 0:
                points[k, marker, rng.integers(3)] = rng.choice(EXTREMES)
            case 1:
                points[k] = rng.choice(EXTREMES)
            case 2:
                points[k] = points[k, rng.permutation(len(NAMES))]
            case 3:
                points[k : k + rng.integers(1, 60), marker] = np.nan
            case 4:
                points[k] = points[k, marker]
            case _:
                points[k : k + rng.integers(1, 5), :4] += 10 ** rng.uniform(-3, 10)
    return MarkerFrames(stamps, 'world', NAMES, points)


@pytest.mark.parametrize('seed', range(4))
def test_results_of_hostile_frames_are_finite(seed: int) -> None:
    """Frame by frame, and in blocks; `make sanitize` runs this under the sanitizers."""
    frames = hostile_frames(np.random.default_rng(seed), 400)
    names = {f'{body}.markers': markers for body, markers in BODIES.items()}
    tracker = Tracker(settings_from({'lag': 0.1 * (seed % 2), 'bodies': list(BODIES), **names}))
    size = 1 if seed < 2 else 97
    for k in range(0, len(frames.stamps), size):
        for estimate in tracker.add(part_of(frames, slice(k, k + size)), 4):
            for name in ('angle', 'position', 'angle_covariance', 'position_covariance'):
                assert not np.isinf(getattr(estimate, name)).any()
